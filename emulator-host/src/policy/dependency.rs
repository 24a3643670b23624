//! Sends whole closures, regardless of utility, by (deadline, level), one group finished before the
//! next starts.
//!
//! The paper's third baseline: it wastes nothing on groups that cannot be completed, and starts late because
//! it completes refinements of the first frames before it moves on.

use super::{Scheduler, SenderView, first_of_closure};
use crate::{
    clock::Nanos,
    graph::{GroupIndex, PacketGraph, PacketIndex},
};

/// The policy's state.
#[derive(Clone, Debug)]
pub struct Dependency {
    /// Groups by (first frame, level, cluster, index).
    order: Vec<GroupIndex>,
    /// Everything before the cursor is sent, dead or expired.
    cursor: usize,
}

impl Dependency {
    /// For `graph`.
    pub fn new(graph: &PacketGraph) -> Self {
        let mut order: Vec<GroupIndex> = (0..graph.groups().len() as u32).map(GroupIndex).collect();
        order.sort_by_key(|index| {
            let group = &graph.groups()[index.at()];
            (group.first_frame, group.level(), group.id.cluster, *index)
        });
        Self { order, cursor: 0 }
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
            let hopeless = view.is_past(facts.last_frame, now)
                || view.graph.closure(group).any(|member| view.is_dead(member));
            if !hopeless && let Some(packet) = first_of_closure(view, group, now) {
                return Some(packet);
            }
            self.cursor += 1;
        }
        None
    }
}
