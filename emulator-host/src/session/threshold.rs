//! Says when enough of what playout waits for can be shown.

use crate::{
    graph::PacketGraph,
    receiver::Snapshot,
    startup::{Awaited, StartupRule},
};

/// The groups that playout waits for, by the words of a [`Snapshot`] that say of them.
#[derive(Debug)]
pub(super) struct Threshold {
    awaited: Awaited,
    words: Vec<Word>,
}

/// Some awaited groups that lie in one word.
#[derive(Debug)]
struct Word {
    /// Place of the word in a snapshot.
    at: usize,
    /// Bits of the awaited groups, and of those that were there.
    awaited: u64,
    there: u64,
    /// Place of the first of the groups among all awaited ones.
    first: usize,
}

impl Threshold {
    /// Nothing is there.
    pub(super) fn new(rule: StartupRule, graph: &PacketGraph) -> Self {
        let awaited = Awaited::new(rule, graph);
        let mut words: Vec<Word> = Vec::new();
        for (first, (group, _)) in awaited.groups().iter().enumerate() {
            let (at, bit) = (group.at() / 64, 1 << (group.at() % 64));
            match words.last_mut().filter(|word| word.at == at) {
                Some(word) => word.awaited |= bit,
                None => words.push(Word { at, awaited: bit, there: 0, first }),
            }
        }
        Self { awaited, words }
    }

    /// Whether `snapshot` has enough; what an earlier one had is still there.
    pub(super) fn is_reached(&mut self, snapshot: &Snapshot) -> bool {
        for word in &mut self.words {
            let now = snapshot.groups.get(word.at).copied().unwrap_or(0);
            let mut fresh = now & word.awaited & !word.there;
            word.there |= fresh;
            while fresh != 0 {
                let below = (1 << fresh.trailing_zeros()) - 1;
                self.awaited.set(word.first + (word.awaited & below).count_ones() as usize, true);
                fresh &= fresh - 1;
            }
        }
        self.awaited.is_enough(|_, group| snapshot.has_group(group))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{graph::Synthetic, rng::stream};

    #[test]
    fn it_is_reached_when_the_sum_over_all_groups_is() {
        let graph = Synthetic { frames: 60, clusters: 70, ..Synthetic::default() }.build(1).unwrap();
        for rule in [StartupRule::BaseGroups(0.95), StartupRule::BaseUtility(0.4)] {
            let opening = rule.opening(&graph);
            let total: f64 = opening.iter().map(|(_, weight)| weight).sum();
            let mut threshold = Threshold::new(rule, &graph);
            let mut snapshot = Snapshot::default();
            let mut random = stream(1, "threshold");
            let mut order: Vec<usize> = (0..opening.len()).collect();
            for at in (1..order.len()).rev() {
                order.swap(at, random.up_to(at as u64) as usize);
            }
            for place in order {
                snapshot.insert_group(opening[place].0);
                let there = opening.iter().filter(|(group, _)| snapshot.has_group(*group));
                let usable: f64 = there.map(|(_, weight)| weight).sum();
                let expected = usable >= rule.share().unwrap() * total;
                assert_eq!(threshold.is_reached(&snapshot), expected, "{rule:?}: {usable} of {total}");
            }
        }
    }
}
