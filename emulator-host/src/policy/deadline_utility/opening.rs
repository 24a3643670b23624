//! Chooses what to send before playout: what the startup rule counts, by count per byte.

use crate::{
    clock::Nanos,
    graph::{GroupIndex, PacketIndex},
    policy::{PacketStatus, SenderView, first_of_closure},
    startup::StartupRule,
};

/// The group that is being completed, and what the rule counts, once it has been asked for.
#[derive(Clone, Debug, Default)]
pub(super) struct Opening {
    target: Option<GroupIndex>,
    counted: Option<Counted>,
}

/// The groups that a rule counts, each with what it counts.
#[derive(Clone, Debug)]
struct Counted {
    rule: StartupRule,
    groups: Vec<(GroupIndex, f64)>,
    total: f64,
}

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

    /// The group that counts most per byte that it still lacks, unless enough is on its way.
    fn choose(&mut self, view: &SenderView<'_>) -> Option<GroupIndex> {
        let share = view.startup.share()?;
        self.counted = self.counted.take().filter(|counted| counted.rule == view.startup);
        let counted = self.counted.get_or_insert_with(|| {
            let groups = view.startup.opening(view.graph);
            let total = groups.iter().map(|(_, weight)| weight).sum();
            Counted { rule: view.startup, groups, total }
        });
        let mut there = 0.0;
        let mut best: Option<(f64, GroupIndex)> = None;
        for (group, weight) in &counted.groups {
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
        best.filter(|(rank, _)| there < share * counted.total && *rank > 0.0).map(|(_, group)| group)
    }
}

/// Packets of the closure of `group` that wait, and their bytes.
fn left(view: &SenderView<'_>, group: GroupIndex) -> (u32, u32) {
    let closure = view.graph.closure(group).flat_map(|member| view.graph.packets_of(member));
    let waiting = closure.filter(|packet| view.status[packet.at()] == PacketStatus::Waiting);
    waiting
        .fold((0, 0), |(count, bytes), packet| (count + 1, bytes + u32::from(view.graph.wire_bytes(packet))))
}
