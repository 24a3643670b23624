//! Datagrams carry content to the receiver and acknowledgements back.

use crate::{clock::Nanos, graph::PacketIndex};

/// What a datagram carries.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Content {
    Media(PacketIndex),
    Control(u32),
    Ping,
}

/// What the transport acknowledges (RFC 9000, 19.3).
#[derive(Clone, Copy, Debug)]
pub(super) struct Acknowledgement<'a> {
    /// Datagram numbers, inclusive, newest first.
    pub(super) ranges: &'a [(u64, u64)],
    pub(super) ack_delay: Nanos,
}
