//! Sends whole closures, regardless of utility, by (deadline, level), one group finished before the
//! next starts.
//!
//! The paper's third baseline: it wastes nothing on groups that cannot be completed, and starts late because
//! it completes refinements of the first frames before it moves on.

use super::{PacketStatus, Scheduler, SenderView};
use crate::{
    clock::Nanos,
    graph::{ClosureRule, GroupIndex, PacketGraph, PacketIndex},
};

/// The policy's state.
#[derive(Clone, Debug)]
pub struct Dependency {
    /// Groups by (first frame, level, cluster, index).
    order: Vec<GroupIndex>,
    /// Everything before the cursor is sent, dead or expired.
    cursor: usize,
    /// Packets at the front of the closure at the cursor of which none waits; none ever waits again.
    done: usize,
    /// Packets of each group that were abandoned: without them it can never be complete.
    abandoned: Vec<u32>,
}

impl Dependency {
    /// For `graph`.
    pub fn new(graph: &PacketGraph) -> Self {
        let mut order: Vec<GroupIndex> = (0..graph.groups().len() as u32).map(GroupIndex).collect();
        order.sort_by_key(|index| {
            let group = &graph.groups()[index.at()];
            (group.first_frame, group.level(), group.id.cluster, *index)
        });
        Self { order, cursor: 0, done: 0, abandoned: vec![0; graph.groups().len()] }
    }
}

impl Dependency {
    /// Whether `group` can never be shown because a packet of its closure was abandoned. Slices stay useful
    /// one by one.
    fn is_dead(&self, graph: &PacketGraph, group: GroupIndex) -> bool {
        graph.profile() == ClosureRule::AllOrNothing
            && graph.closure(group).any(|member| self.abandoned[member.at()] > 0)
    }

    /// The first sendable packet of the closure of `group`, which is that at the cursor, needed groups first.
    fn next_of(&mut self, group: GroupIndex, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        let packets = view.graph.closure(group).flat_map(|member| view.graph.packets_of(member));
        let waits = |packet: &PacketIndex| view.status[packet.at()] == PacketStatus::Waiting;
        let mut left =
            packets.enumerate().skip(self.done).skip_while(|(_, packet)| !waits(packet)).peekable();
        self.done = left.peek()?.0;
        left.map(|(_, packet)| packet).find(|packet| view.is_sendable(*packet, now))
    }
}

impl Scheduler for Dependency {
    fn name(&self) -> &'static str {
        "dependency"
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        while let Some(group) = self.order.get(self.cursor).copied() {
            let facts = &view.graph.groups()[group.at()];
            if facts.first_frame >= view.horizon_frame {
                return None;
            }
            let hopeless = view.is_past(facts.last_frame, now) || self.is_dead(view.graph, group);
            if !hopeless && let Some(packet) = self.next_of(group, view, now) {
                return Some(packet);
            }
            self.cursor += 1;
            self.done = 0;
        }
        None
    }

    fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        let [was, is] = change.map(|status| u32::from(status == PacketStatus::Abandoned));
        for group in graph.groups_of(packet) {
            self.abandoned[group.at()] += is;
            self.abandoned[group.at()] -= was;
        }
    }
}
