//! Sends level by level: all of level 0 within the horizon in time order, then level 1, and so on; clusters
//! in order.
//!
//! The conventional scheduler and the paper's first baseline. It does not look at deadlines beyond not
//! sending what has expired, nor at whether a group can still be completed.

use super::{PacketStatus, Scheduler, SenderView};
use crate::{
    clock::Nanos,
    graph::{PacketGraph, PacketIndex},
};

/// The policy's state.
#[derive(Clone, Debug)]
pub struct Layered {
    /// Packets of each level by (frame needed from, cluster, index).
    levels: Vec<Vec<PacketIndex>>,
    /// Everything before the cursor was sent or has expired.
    cursors: Vec<usize>,
}

impl Layered {
    /// For `graph`.
    pub fn new(graph: &PacketGraph) -> Self {
        // One integer per packet of a level, frame needed from and index; only packets of one frame are then
        // put in order of cluster. Sorting is a good part of a short run.
        let mut keyed: Vec<Vec<u64>> = Vec::new();
        for at in 0..graph.packets().len() as u32 {
            let index = PacketIndex(at);
            if graph.is_parity(index) {
                continue;
            }
            let level = usize::from(graph.level(index));
            if keyed.len() <= level {
                keyed.resize(level + 1, Vec::new());
            }
            keyed[level].push(u64::from(graph.needed_from(index)) << 32 | u64::from(at));
        }
        let cluster = |key: &u64| {
            let groups = graph.groups_of(PacketIndex(*key as u32));
            groups.map(|group| graph.groups()[group.at()].id.cluster).min()
        };
        for level in &mut keyed {
            level.sort();
            for of_one_frame in level.chunk_by_mut(|one, other| one >> 32 == other >> 32) {
                of_one_frame.sort_by_cached_key(cluster);
            }
        }
        let packets = |level: Vec<u64>| level.into_iter().map(|key| PacketIndex(key as u32)).collect();
        let levels: Vec<Vec<PacketIndex>> = keyed.into_iter().map(packets).collect();
        let cursors = vec![0; levels.len()];
        Self { levels, cursors }
    }
}

impl Scheduler for Layered {
    fn name(&self) -> &'static str {
        "layered"
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        for (level, cursor) in self.levels.iter().zip(&mut self.cursors) {
            while let Some(packet) = level.get(*cursor).copied() {
                if view.status[packet.at()] != PacketStatus::Waiting || view.is_expired(packet, now) {
                    *cursor += 1;
                } else if view.is_sendable(packet, now) {
                    return Some(packet);
                } else {
                    break;
                }
            }
        }
        None
    }
}
