//! XOR repair: when all but one packet of a set have arrived, the missing one is known.
//!
//! Only indices are tracked here. An [`crate::Endpoint`] that owns bytes must check that what it recovers passes the
//! original CRC (paper, "Selective recovery and receiver closure").

use crate::graph::{PacketGraph, PacketIndex};

/// What each repair set still lacks.
#[derive(Clone, Debug)]
pub struct Repair {
    sets: Vec<Lack>,
}

/// The last missing member is known without a list: it is the sum of what is missing.
#[derive(Clone, Copy, Debug)]
struct Lack {
    count: u32,
    sum: u64,
}

impl Repair {
    /// Nothing has arrived.
    pub fn new(graph: &PacketGraph) -> Self {
        let sets = graph.repair_sets().iter().zip(0u32..).map(|(set, at)| {
            let all = set.members.iter().copied().chain([graph.parity(at)]);
            Lack { count: set.members.len() as u32 + 1, sum: all.map(|packet| u64::from(packet.0)).sum() }
        });
        Self { sets: sets.collect() }
    }

    /// `packet` is there for the first time, arrived or recovered. Calls `recovered` for each media packet that this makes
    /// known; the caller passes it back in if it did not have it yet.
    pub fn on_packet(
        &mut self,
        graph: &PacketGraph,
        packet: PacketIndex,
        mut recovered: impl FnMut(PacketIndex),
    ) {
        for set in graph.sets_of(packet) {
            let lack = &mut self.sets[*set as usize];
            lack.count -= 1;
            lack.sum -= u64::from(packet.0);
            if lack.count == 1 {
                let missing = PacketIndex(lack.sum as u32);
                if graph.packets()[missing.at()].parity_of.is_none() {
                    recovered(missing);
                }
            }
        }
    }
}
