//! Repairs a set when no more of its members are missing than parity packets of it have arrived.
//!
//! Only indices are tracked here. An [`crate::Endpoint`] that owns bytes must check that what it recovers
//! passes the original CRC (paper, "Selective recovery and receiver closure").

use crate::graph::{PacketGraph, PacketIndex};

/// What each repair set still lacks.
#[derive(Clone, Debug)]
pub struct Repair {
    known: Vec<bool>,
    sets: Vec<Lack>,
}

#[derive(Clone, Copy, Debug)]
struct Lack {
    /// Members that are not known.
    missing: u32,
    /// Parity packets that have arrived.
    parity: u32,
    /// Nothing is missing, or what is missing has been told.
    done: bool,
}

impl Repair {
    /// Nothing has arrived.
    pub fn new(graph: &PacketGraph) -> Self {
        let lack = |members: &[PacketIndex]| Lack {
            missing: members.len() as u32,
            parity: 0,
            done: members.is_empty(),
        };
        Self {
            known: vec![false; graph.packets().len()],
            sets: graph.repair_sets().iter().map(|set| lack(&set.members)).collect(),
        }
    }

    /// `packet` is there for the first time, arrived or recovered. Calls `recovered` for each media packet
    /// that this makes known; the caller passes it back in if it did not have it yet.
    pub fn on_packet(
        &mut self,
        graph: &PacketGraph,
        packet: PacketIndex,
        mut recovered: impl FnMut(PacketIndex),
    ) {
        let sets = graph.sets_of(packet);
        if sets.is_empty() {
            return;
        }
        self.known[packet.at()] = true;
        let is_parity = graph.is_parity(packet);
        for set in sets {
            let lack = &mut self.sets[*set as usize];
            if is_parity {
                lack.parity += 1;
            } else {
                lack.missing -= 1;
            }
            if !lack.done && lack.missing <= lack.parity {
                lack.done = true;
                let members = &graph.repair_sets()[*set as usize].members;
                members
                    .iter()
                    .filter(|member| !self.known[member.at()])
                    .for_each(|member| recovered(*member));
            }
        }
    }
}
