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

/// The groups that a start waits for, and how much of what they count is there.
#[derive(Clone, Debug)]
pub(crate) struct Awaited {
    groups: Vec<(GroupIndex, f64)>,
    /// What all of them count, and the share of it that is enough; `None` if only time counts.
    total: f64,
    share: Option<f64>,
    /// What those count that are there, but for rounding.
    there: f64,
    /// Additions to it and subtractions, each of which rounds.
    changes: usize,
}

impl Awaited {
    /// None is there.
    pub(crate) fn new(rule: StartupRule, graph: &PacketGraph) -> Self {
        let groups = rule.opening(graph);
        let total = groups.iter().map(|(_, weight)| weight).sum();
        Self { groups, total, share: rule.share(), there: 0.0, changes: 0 }
    }

    /// The groups, ascending, each with what it counts.
    pub(crate) fn groups(&self) -> &[(GroupIndex, f64)] {
        &self.groups
    }

    /// The group at `place` has come, or is not there after all.
    pub(crate) fn set(&mut self, place: usize, is_there: bool) {
        let weight = self.groups[place].1;
        self.there += if is_there { weight } else { -weight };
        self.changes += 1;
    }

    /// Whether enough is there, by the sum over the groups in their order. `is_there` says it of a place and
    /// its group, as [`Self::set`] was given it: where rounding might decide, the groups are added up again.
    pub(crate) fn is_enough(&mut self, is_there: impl Fn(usize, GroupIndex) -> bool) -> bool {
        let Some(share) = self.share else { return false };
        let wanted = share * self.total;
        let doubt = self.total * f64::EPSILON * (self.changes + self.groups.len()) as f64;
        if (self.there - wanted).abs() <= doubt {
            let groups = self.groups.iter().enumerate();
            let there = groups.filter(|(place, (group, _))| is_there(*place, *group));
            self.there = there.fold(0.0, |sum, (_, (_, weight))| sum + weight);
            self.changes = self.groups.len();
        }
        self.there >= wanted
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{graph::Synthetic, rng::stream};

    /// In whatever order groups come and go, and however their weights round.
    #[test]
    fn enough_is_there_when_the_sum_in_order_says_so() {
        let graph = Synthetic { frames: 30, clusters: 40, ..Synthetic::default() }.build(1).unwrap();
        for rule in [0.0, 0.3, 0.95, 1.0].map(StartupRule::BaseUtility) {
            let mut awaited = Awaited::new(rule, &graph);
            awaited.groups.iter_mut().enumerate().for_each(|(at, (_, weight))| *weight = 0.1 * at as f64);
            awaited.total = awaited.groups.iter().map(|(_, weight)| weight).sum();
            let mut there = vec![false; awaited.groups.len()];
            let mut random = stream(1, "awaited");
            for step in 0..5_000 {
                let place = random.up_to(there.len() as u64 - 1) as usize;
                // Before some come and go, and after it, all come.
                let is_there = !there[place] || !(1_000..4_000).contains(&step);
                if is_there != there[place] {
                    there[place] = is_there;
                    awaited.set(place, is_there);
                }
                let weights = awaited.groups.iter().zip(&there).filter(|(_, there)| **there);
                let sum = weights.fold(0.0, |sum, ((_, weight), _)| sum + weight);
                let expected = sum >= rule.share().unwrap() * awaited.total;
                assert_eq!(awaited.is_enough(|place, _| there[place]), expected, "{rule:?} {step}");
            }
        }
        assert!(!Awaited::new(StartupRule::AfterWait, &graph).is_enough(|_, _| true));
    }
}
