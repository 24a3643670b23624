//! What came of packets: counters, and the answer to each one that was accepted.

use crate::{
    error::{Error, ErrorKind},
    ids::PacketId,
    limits::MAX_REPAIR_PARITY,
};

/// What happened to packets, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Media packets accepted and decoded.
    pub media: u32,
    /// Parity packets accepted.
    pub parity: u32,
    /// Packets buffered before the manifest.
    pub early: u32,
    /// Packets recovered by repair.
    pub recovered: u32,
    /// Repaired packets that failed their own checks.
    pub repair_failed: u32,
    /// Packets refused, by [`ErrorKind::index`].
    pub refused: [u32; ErrorKind::COUNT],
}

impl Counters {
    /// Counts a refusal.
    pub(crate) fn refuse(&mut self, error: &Error) {
        let [short, illegal, unknown, checksum, contradiction, duplicate, capacity] = &mut self.refused;
        let count = match error.kind {
            ErrorKind::Short => short,
            ErrorKind::Illegal => illegal,
            ErrorKind::Unknown => unknown,
            ErrorKind::Checksum => checksum,
            ErrorKind::Contradiction => contradiction,
            ErrorKind::Duplicate => duplicate,
            ErrorKind::Capacity => capacity,
        };
        *count = count.saturating_add(1);
    }
}

/// A packet that was decoded or, for parity, taken into account.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// The packet.
    pub id: PacketId,
    /// Packets of its repair set that this one made recoverable.
    pub recovered: Recovered,
}

/// The packets that one arrival made known, ascending.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    /// One place for each packet that a set's parity can give back.
    pub(super) ids: [Option<PacketId>; MAX_REPAIR_PARITY],
}

impl Recovered {
    /// The packets.
    pub fn iter(&self) -> impl Iterator<Item = PacketId> + use<> {
        self.ids.into_iter().flatten()
    }
}
