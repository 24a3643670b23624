//! Says when playout starts, and which groups that start waits for.

use crate::{
    clock::Nanos,
    graph::{Group, GroupIndex, PacketGraph},
};

/// What must be there before playout starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StartupRule {
    /// Share of the level-0 groups active at frame 0.
    BaseGroups(f64),
    /// The same, weighted by positive utility.
    BaseUtility(f64),
    /// Nothing: playout starts after the wait, whatever is there. Schedulers are compared so.
    AfterWait,
}

/// When playout starts.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Startup {
    /// What must be usable, 0..=1. The manifest is always needed.
    pub rule: StartupRule,
    /// Playout starts after this long in any case.
    pub max_wait: Nanos,
}

impl StartupRule {
    /// Share of what the start waits for that must be usable; `None` if only time counts.
    pub fn share(self) -> Option<f64> {
        match self {
            Self::BaseGroups(share) | Self::BaseUtility(share) => Some(share),
            Self::AfterWait => None,
        }
    }

    /// The groups that the start waits for, each with what it counts.
    pub(crate) fn opening(self, graph: &PacketGraph) -> Vec<(GroupIndex, f64)> {
        let weight = |group: &Group| match self {
            Self::BaseGroups(_) => 1.0,
            Self::BaseUtility(_) => group.utility.max(0.0),
            Self::AfterWait => 0.0,
        };
        let first =
            (0u32..).zip(graph.groups()).filter(|(_, group)| group.level() == 0 && group.first_frame == 0);
        first.map(|(at, group)| (GroupIndex(at), weight(group))).collect()
    }
}
