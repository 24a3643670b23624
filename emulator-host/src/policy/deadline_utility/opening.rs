//! Chooses what to send before playout: what the startup rule counts, by count per byte.

use std::{cmp::Ordering, collections::BinaryHeap};

use crate::{
    clock::Nanos,
    graph::{GroupIndex, PacketGraph, PacketIndex, csr::Csr},
    policy::{PacketStatus, SenderView, first_of_closure},
    startup::{Awaited, StartupRule},
};

/// The group that is being completed, and what the rule counts, once it has been asked for.
#[derive(Clone, Debug, Default)]
pub(super) struct Opening {
    target: Option<GroupIndex>,
    counted: Option<Counted>,
}

/// The groups that a rule counts, and what each still lacks.
#[derive(Clone, Debug)]
struct Counted {
    rule: StartupRule,
    awaited: Awaited,
    /// For each group of the graph, the places in `awaited` of those that need it, itself included.
    needed_by: Csr,
    /// Of each awaited group, the packets of its closure that wait, and their bytes.
    left: Vec<(u32, u32)>,
    /// Awaited groups by count per byte left; those whose bytes have changed since are passed over.
    ranks: BinaryHeap<Ranked>,
}

/// An awaited group with the rank that it had once.
#[derive(Clone, Copy, Debug)]
struct Ranked {
    rank: f64,
    /// Among the awaited groups; of equals the first is taken.
    place: u32,
}

impl Ord for Ranked {
    fn cmp(&self, other: &Self) -> Ordering {
        self.rank.total_cmp(&other.rank).then(other.place.cmp(&self.place))
    }
}

impl PartialOrd for Ranked {
    fn partial_cmp(&self, other: &Self) -> Option<Ordering> {
        Some(self.cmp(other))
    }
}

impl PartialEq for Ranked {
    fn eq(&self, other: &Self) -> bool {
        self.cmp(other) == Ordering::Equal
    }
}

impl Eq for Ranked {}

impl Opening {
    /// The next packet of what the rule still lacks; `None` once all that it asks for is on its way.
    pub(super) fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        loop {
            let target = match self.target {
                Some(target) => target,
                None => self.choose(view)?,
            };
            self.target = Some(target);
            if let Some(packet) = first_of_closure(view, target, now) {
                return Some(packet);
            }
            self.target = None;
            if left(view, target).0 > 0 {
                // Something of it waits and may not be sent: the rule cannot be met this way.
                return None;
            }
        }
    }

    /// The status of `packet` has changed from the first of `change` to the second.
    pub(super) fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        let [waited, waits] = change.map(|status| status == PacketStatus::Waiting);
        if let Some(counted) = self.counted.as_mut().filter(|_| waited != waits) {
            counted.count(graph, packet, waits);
        }
    }

    /// The group that counts most per byte that it still lacks, unless enough is on its way.
    fn choose(&mut self, view: &SenderView<'_>) -> Option<GroupIndex> {
        view.startup.share()?;
        self.counted = self.counted.take().filter(|counted| counted.rule == view.startup);
        let counted = self.counted.get_or_insert_with(|| Counted::new(view));
        let Counted { awaited, left, .. } = counted;
        if awaited.is_enough(|place, _| left[place].0 == 0) {
            return None;
        }
        let best = counted.best().filter(|best| best.rank > 0.0)?;
        Some(counted.awaited.groups()[best.place as usize].0)
    }
}

impl Counted {
    fn new(view: &SenderView<'_>) -> Self {
        let mut awaited = Awaited::new(view.startup, view.graph);
        let left: Vec<_> = awaited.groups().iter().map(|(group, _)| left(view, *group)).collect();
        let mut needs = Vec::new();
        for (place, (group, _)) in (0u32..).zip(awaited.groups()) {
            needs.extend(view.graph.closure(*group).map(|member| (member.0, place)));
        }
        let needed_by = Csr::from_pairs(view.graph.groups().len(), &needs);
        for (place, (waiting, _)) in left.iter().enumerate() {
            if *waiting == 0 {
                awaited.set(place, true);
            }
        }
        let mut counted = Self { rule: view.startup, awaited, needed_by, left, ranks: BinaryHeap::new() };
        counted.ranks = (0..counted.left.len()).filter_map(|place| counted.ranked(place)).collect();
        counted
    }

    /// `packet` waits, or no longer does.
    fn count(&mut self, graph: &PacketGraph, packet: PacketIndex, waits: bool) {
        let size = u32::from(graph.wire_bytes(packet));
        for member in graph.groups_of(packet) {
            for at in 0..self.needed_by.row(member.at()).len() {
                let place = self.needed_by.row(member.at())[at] as usize;
                let (waiting, bytes) = &mut self.left[place];
                let was_on_its_way = *waiting == 0;
                if waits {
                    (*waiting, *bytes) = (*waiting + 1, *bytes + size);
                } else {
                    (*waiting, *bytes) = (*waiting - 1, *bytes - size);
                }
                let is_on_its_way = *waiting == 0;
                if is_on_its_way != was_on_its_way {
                    self.awaited.set(place, is_on_its_way);
                }
                self.ranks.extend(self.ranked(place));
            }
        }
    }

    /// The group at `place` with its rank; `None` if all of it is on its way.
    fn ranked(&self, place: usize) -> Option<Ranked> {
        let (waiting, bytes) = self.left[place];
        let weight = self.awaited.groups()[place].1;
        (waiting > 0).then(|| Ranked { rank: weight / f64::from(bytes), place: place as u32 })
    }

    /// The group that counts most per byte left, the first of equals.
    fn best(&mut self) -> Option<Ranked> {
        while let Some(best) = self.ranks.peek().copied() {
            if self.ranked(best.place as usize) == Some(best) {
                return Some(best);
            }
            self.ranks.pop();
        }
        None
    }
}

/// Packets of the closure of `group` that wait, and their bytes.
fn left(view: &SenderView<'_>, group: GroupIndex) -> (u32, u32) {
    let closure = view.graph.closure(group).flat_map(|member| view.graph.packets_of(member));
    let waiting = closure.filter(|packet| view.status[packet.at()] == PacketStatus::Waiting);
    waiting
        .fold((0, 0), |(count, bytes), packet| (count + 1, bytes + u32::from(view.graph.wire_bytes(packet))))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        graph::{ClosureRule, Synthetic, Utilities},
        policy::deadline_utility::tests::view,
        rng::stream,
    };

    /// The choice by its definition, over all groups and their closures.
    fn plain(view: &SenderView<'_>) -> Option<GroupIndex> {
        let groups = view.startup.opening(view.graph);
        let total: f64 = groups.iter().map(|(_, weight)| weight).sum();
        let mut there = 0.0;
        let mut best: Option<(f64, GroupIndex)> = None;
        for (group, weight) in &groups {
            let (waiting, bytes) = left(view, *group);
            if waiting == 0 {
                there += weight;
                continue;
            }
            let rank = weight / f64::from(bytes);
            if best.is_none_or(|(other, _)| rank > other) {
                best = Some((rank, *group));
            }
        }
        let wanted = view.startup.share()? * total;
        best.filter(|(rank, _)| there < wanted && *rank > 0.0).map(|(_, group)| group)
    }

    /// Packets of one size and a flat table make every choice one among equals.
    #[test]
    fn choices_are_those_of_the_definition_whatever_is_sent_and_lost() {
        for (profile, utilities) in [
            (ClosureRule::AllOrNothing, Utilities::Unequal),
            (ClosureRule::Sliced, Utilities::Unequal),
            (ClosureRule::AllOrNothing, Utilities::Flat),
        ] {
            let spec = Synthetic { frames: 30, clusters: 30, profile, utilities, ..Synthetic::default() };
            let mut parts = spec.build(1).unwrap().parts().clone();
            if utilities == Utilities::Flat {
                parts.packets.iter_mut().for_each(|packet| packet.wire_bytes = 700);
            }
            let graph = PacketGraph::new(parts).unwrap();
            for rule in [StartupRule::BaseGroups(0.95), StartupRule::BaseUtility(0.9)] {
                let mut status = vec![PacketStatus::Waiting; graph.packets().len()];
                let sent_at = vec![Nanos::ZERO; graph.packets().len()];
                let mut random = stream(1, "opening");
                let mut opening = Opening::default();
                let (mut choices, mut enough) = (0, false);
                for _ in 0..2_000 {
                    let seen = SenderView { startup: rule, ..view(&graph, &status, &sent_at) };
                    let chosen = opening.choose(&seen);
                    assert_eq!(chosen, plain(&seen));
                    choices += u32::from(chosen.is_some());
                    enough |= chosen.is_none();
                    let first = chosen.and_then(|target| first_of_closure(&seen, target, Nanos::ZERO));
                    let any = PacketIndex(random.up_to(graph.packets().len() as u64 - 1) as u32);
                    let after = [PacketStatus::Waiting, PacketStatus::InFlight, PacketStatus::Delivered];
                    let after = after[random.up_to(2) as usize];
                    for (packet, after) in
                        first.map(|first| (first, PacketStatus::InFlight)).into_iter().chain([(any, after)])
                    {
                        let before = std::mem::replace(&mut status[packet.at()], after);
                        opening.on_status(&graph, packet, [before, after]);
                    }
                }
                assert!(choices > 20 && enough, "{profile:?} {rule:?}: {choices}");
            }
        }
    }
}
