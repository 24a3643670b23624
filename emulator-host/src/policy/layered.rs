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
        // One integer per packet: level, frame needed from, cluster, index. Sorting it is a good part of a
        // short run.
        let mut keyed: Vec<u128> = Vec::with_capacity(graph.packets().len());
        for (at, packet) in graph.packets().iter().enumerate() {
            let index = PacketIndex(at as u32);
            let clusters = packet.groups.iter().map(|group| graph.groups()[group.at()].id.cluster);
            if let Some(cluster) = clusters.min() {
                let time = u128::from(graph.level(index)) << 32 | u128::from(graph.needed_from(index));
                keyed.push(time << 64 | u128::from(cluster.0) << 32 | u128::from(index.0));
            }
        }
        keyed.sort_unstable();
        let count = keyed.last().map_or(0, |key| (key >> 96) as usize + 1);
        let mut levels = vec![Vec::new(); count];
        for key in keyed {
            levels[(key >> 96) as usize].push(PacketIndex(key as u32));
        }
        Self { levels, cursors: vec![0; count] }
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
