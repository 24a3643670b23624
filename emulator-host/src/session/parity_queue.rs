//! Queues parity until every packet it protects was sent, and sends it once its expected gain is high enough.

use std::collections::VecDeque;

use crate::{
    clock::Nanos,
    graph::{PacketGraph, PacketIndex},
    policy::{PacketStatus, Scheduler, SenderView},
};

/// Parity of a graph that was not sent yet.
#[derive(Debug)]
pub(super) struct ParityQueue {
    /// Of sets whose members have all left, or are there.
    ready: VecDeque<PacketIndex>,
    /// Of such sets, but the scheduler did not want it.
    refused: Vec<PacketIndex>,
    /// Members of each repair set that wait for their first sending.
    waiting: Vec<u32>,
}

impl ParityQueue {
    pub(super) fn new(graph: &PacketGraph) -> Self {
        let waiting = graph.repair_sets().iter().map(|set| set.members.len() as u32).collect();
        Self { ready: VecDeque::new(), refused: Vec::new(), waiting }
    }

    /// Whether none is ready that the scheduler was not asked about.
    pub(super) fn is_empty(&self) -> bool {
        self.ready.is_empty()
    }

    /// `packet` no longer waits for its first sending: it left, or the receiver has it. Once for each packet.
    pub(super) fn count_off(&mut self, graph: &PacketGraph, packet: PacketIndex) {
        if graph.is_parity(packet) {
            return;
        }
        for set in graph.sets_of(packet) {
            self.waiting[*set as usize] -= 1;
            if self.waiting[*set as usize] == 0 {
                self.ready.extend(graph.parity(*set));
            }
        }
    }

    /// The next that is ready and that the scheduler wants.
    pub(super) fn next<S: Scheduler>(
        &mut self,
        scheduler: &mut S,
        view: &SenderView<'_>,
        now: Nanos,
    ) -> Option<PacketIndex> {
        while let Some(parity) = self.ready.pop_front() {
            let waits = view.status[parity.at()] == PacketStatus::Waiting;
            let useful =
                members(view.graph, parity).any(|member| view.status[member] != PacketStatus::Delivered);
            if !waits || !useful || view.is_expired(parity, now) {
                continue;
            }
            if scheduler.wants_parity(view, parity, now) {
                return Some(parity);
            }
            self.refused.push(parity);
        }
        None
    }

    /// One that the scheduler refused before and wants now, while what it protects is on its way.
    pub(super) fn next_of_refused<S: Scheduler>(
        &mut self,
        scheduler: &mut S,
        view: &SenderView<'_>,
        now: Nanos,
    ) -> Option<PacketIndex> {
        self.refused.retain(|parity| {
            !view.is_expired(*parity, now)
                && members(view.graph, *parity).any(|member| view.status[member] == PacketStatus::InFlight)
        });
        let wanted = self.refused.iter().position(|parity| scheduler.wants_parity(view, *parity, now));
        wanted.map(|at| self.refused.swap_remove(at))
    }
}

/// Places of the packets that `parity` protects.
fn members(graph: &PacketGraph, parity: PacketIndex) -> impl Iterator<Item = usize> {
    let sets = graph.sets_of(parity).iter();
    sets.flat_map(|set| &graph.repair_sets()[*set as usize].members).map(|member| member.at())
}
