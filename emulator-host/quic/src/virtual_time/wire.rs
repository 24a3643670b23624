//! Carries the bytes of datagrams over one direction of an emulated path.

use bytes::BytesMut;
use emulator_host::{
    Nanos,
    link::{BoxOutput, Chain, Datagram, LinkBox},
    session::IP_UDP_BYTES,
};

/// One direction: boxes that know sizes, and the bytes of what is inside them.
pub(super) struct Wire {
    chain: Chain,
    /// Bytes by tag; empty once delivered. Those of dropped datagrams stay until the end.
    payloads: Vec<BytesMut>,
}

impl Wire {
    pub(super) fn new(chain: Chain) -> Self {
        Self { chain, payloads: Vec::new() }
    }

    pub(super) fn chain(&self) -> &Chain {
        &self.chain
    }

    pub(super) fn next_wake(&self) -> Nanos {
        self.chain.next_wake()
    }

    /// Puts `payload` on the wire, or nothing, at `now`; what arrives at once comes out. To be called again
    /// with nothing until nothing comes out.
    pub(super) fn step(&mut self, payload: Option<&[u8]>, now: Nanos) -> Option<BytesMut> {
        let input = payload.map(|payload| {
            self.payloads.push(BytesMut::from(payload));
            Datagram { tag: self.payloads.len() as u64 - 1, bytes: payload.len() as u32 + IP_UDP_BYTES }
        });
        match self.chain.step(input, now) {
            BoxOutput::Datagram(datagram) => {
                let place = usize::try_from(datagram.tag).ok()?;
                self.payloads.get_mut(place).map(std::mem::take)
            }
            BoxOutput::Wake(_) | BoxOutput::Idle => None,
        }
    }
}
