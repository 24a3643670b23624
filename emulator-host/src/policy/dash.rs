//! Fills segment budgets in the manner of DASH: for each second of content, choose what fits the estimated
//! rate, then send it.
//!
//! A segment is [`Dash::SEGMENT_FRAMES_S`] of frames. When its turn comes, levels are added from the base up,
//! and within a level cluster by cluster (a cluster is a tile), while the bytes fit 90 % of what the path is
//! expected to move in a segment's time; the base is always taken. The choice is then sent in order, whatever
//! happens meanwhile. The first segment's turn is at once. One segment is prefetched: the turn of another
//! comes when the playout of the segment before it starts.
//!
//! Whenever the fate of all that was chosen is known, the next segment's turn has not come and the rate is
//! measured higher than at the last choice, what did not fit is offered once more, within what the budget by
//! that rate leaves: a player that finds its connection faster than it expected fetches a segment again in a
//! better quality. Without that, the first segment, which is chosen before anything is measured, would stay
//! at its base on any link. Long-lived groups that still did not fit are offered to later segments.

use super::{PacketStatus, Scheduler, SenderView};
use crate::{
    clock::{Nanos, Rate},
    graph::{GroupIndex, PacketGraph, PacketIndex},
};

/// The policy's state.
#[derive(Clone, Debug)]
pub struct Dash {
    segment_frames: u32,
    /// Groups of each segment by (level, cluster, index).
    segments: Vec<Vec<GroupIndex>>,
    /// The next segment to choose for.
    turn: usize,
    chosen: Vec<PacketIndex>,
    /// By packet: whether it is among them. One that carries several groups is paid for once.
    is_chosen: Vec<bool>,
    /// The next of `chosen` to send.
    cursor: usize,
    /// The first of `chosen` that is not known to have passed or not.
    settled: usize,
    /// Bytes chosen in this turn.
    spent: u64,
    /// Rate by which was last chosen.
    rate: Rate,
    leftovers: Vec<GroupIndex>,
}

impl Dash {
    /// Length of a segment in seconds.
    pub const SEGMENT_FRAMES_S: u64 = 1;

    /// For `graph`.
    pub fn new(graph: &PacketGraph) -> Self {
        let interval = graph.frame_interval().0.max(1);
        let frames = (Nanos::from_s(Self::SEGMENT_FRAMES_S).0 + interval / 2) / interval;
        let segment_frames = u32::try_from(frames).unwrap_or(u32::MAX).max(1);
        let count = graph.frames().div_ceil(segment_frames) as usize;
        let mut segments = vec![Vec::new(); count];
        for (at, group) in graph.groups().iter().enumerate() {
            segments[(group.first_frame / segment_frames) as usize].push(GroupIndex(at as u32));
        }
        for segment in &mut segments {
            segment.sort_by_key(|index| {
                let group = &graph.groups()[index.at()];
                (group.level(), group.id.cluster, *index)
            });
        }
        Self {
            segment_frames,
            segments,
            turn: 0,
            chosen: Vec::new(),
            is_chosen: vec![false; graph.packets().len()],
            cursor: 0,
            settled: 0,
            spent: 0,
            rate: Rate(0),
            leftovers: Vec::new(),
        }
    }

    /// Whether there is another segment and its turn has come: it is the first, or the one before it plays.
    fn is_due(&self, view: &SenderView<'_>, now: Nanos) -> bool {
        let before = self.turn.saturating_sub(1) as u32 * self.segment_frames;
        let plays = || view.playing && now >= view.playout_at(before);
        self.turn < self.segments.len() && (self.turn == 0 || plays())
    }

    /// Chooses for the next segment; long-lived groups of those before come after its own.
    fn begin_segment(&mut self, view: &SenderView<'_>, now: Nanos) {
        let first = self.turn as u32 * self.segment_frames;
        let mut candidates = std::mem::take(&mut self.segments[self.turn]);
        let reaches = |index: &mut GroupIndex| view.graph.groups()[index.at()].last_frame >= first;
        candidates.extend(self.leftovers.extract_if(.., reaches));
        self.turn += 1;
        self.spent = 0;
        self.choose(candidates, view, now);
    }

    /// Whether what did not fit may be offered once more: the path has shown by all that was chosen what it
    /// moves, and that is more than was expected.
    fn may_revise(&mut self, view: &SenderView<'_>) -> bool {
        let in_flight = |packet: &PacketIndex| view.status[packet.at()] == PacketStatus::InFlight;
        let known = self.chosen[self.settled..].iter().take_while(|packet| !in_flight(packet)).count();
        self.settled += known;
        !self.leftovers.is_empty() && self.settled == self.chosen.len() && view.rate > self.rate
    }

    /// Chooses among `candidates` what still fits the budget of this turn by the rate at `now`.
    fn choose(&mut self, candidates: Vec<GroupIndex>, view: &SenderView<'_>, now: Nanos) {
        let span = view.graph.frame_interval().times(u64::from(self.segment_frames));
        let budget = view.rate.scaled(9, 10).bytes_in(span).0;
        self.rate = view.rate;
        self.chosen.drain(..).for_each(|packet| self.is_chosen[packet.at()] = false);
        (self.cursor, self.settled) = (0, 0);
        let mut skipped_level = u8::MAX;
        for index in candidates {
            let group = &view.graph.groups()[index.at()];
            if view.is_past(group.last_frame, now) {
                continue;
            }
            let is_new = |packet: &PacketIndex| {
                view.status[packet.at()] == PacketStatus::Waiting && !self.is_chosen[packet.at()]
            };
            let added: Vec<PacketIndex> = view.graph.packets_of(index).filter(is_new).collect();
            let bytes: u64 = added.iter().map(|&packet| u64::from(view.graph.wire_bytes(packet))).sum();
            // A tile that does not fit does not stop its neighbours of the same level, only all levels above.
            let fits = group.level() <= skipped_level && self.spent + bytes <= budget;
            if group.level() == 0 || fits {
                self.spent += bytes;
                added.iter().for_each(|packet| self.is_chosen[packet.at()] = true);
                self.chosen.extend(added);
            } else {
                skipped_level = skipped_level.min(group.level());
                self.leftovers.push(index);
            }
        }
    }
}

impl Scheduler for Dash {
    fn name(&self) -> &'static str {
        "dash"
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        loop {
            while let Some(packet) = self.chosen.get(self.cursor).copied() {
                if view.is_sendable(packet, now) {
                    return Some(packet);
                }
                let too_early = view.graph.needed_from(packet) >= view.horizon_frame;
                if too_early && view.status[packet.at()] == PacketStatus::Waiting {
                    return None;
                }
                self.cursor += 1;
            }
            if self.is_due(view, now) {
                self.begin_segment(view, now);
            } else if self.may_revise(view) {
                let candidates = std::mem::take(&mut self.leftovers);
                self.choose(candidates, view, now);
            } else {
                return None;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeMap;

    use crate::{
        Nanos, PolicyKind, Rate, SessionConfig,
        graph::{ClosureRule, Group, GroupIndex, PacketGraph, PacketIndex, Synthetic},
        link::{Capacity, PathConfig},
        session::{Startup, StartupRule},
        simulate,
    };

    /// A clip of 5 Mbit/s in which each packet carries one group.
    fn clip(frames: u32) -> PacketGraph {
        Synthetic { frames, ..Synthetic::default() }.build(1).unwrap()
    }

    /// The same bytes in packets each of which carries pieces of 16 clusters, as slices do.
    fn shared(graph: &PacketGraph) -> PacketGraph {
        let mut parts = graph.parts().clone();
        let class = |group: &Group| (group.id.span, group.level(), group.id.cluster.0 / 16);
        let mut classes: BTreeMap<_, (Vec<GroupIndex>, Vec<PacketIndex>)> = BTreeMap::new();
        for (at, group) in parts.groups.iter().enumerate() {
            let (groups, packets) = classes.entry(class(group)).or_default();
            groups.push(GroupIndex(at as u32));
            packets.extend(&group.packets);
        }
        for group in &mut parts.groups {
            group.packets.clone_from(&classes[&class(group)].1);
        }
        for (groups, packets) in classes.values() {
            packets.iter().for_each(|packet| parts.packets[packet.at()].groups.clone_from(groups));
        }
        parts.profile = ClosureRule::Sliced;
        PacketGraph::new(parts).unwrap()
    }

    /// Share of groups missing of a clip over 100 Mbit/s, 5 ms one way.
    fn missing(graph: &PacketGraph, rule: StartupRule) -> f64 {
        let wide = Capacity::Constant(Rate::from_mbps(100));
        let forward = PathConfig { capacity: wide, delay: Nanos::from_ms(5), ..PathConfig::default() };
        let startup = Startup { rule, max_wait: Nanos::from_ms(500) };
        let mut config =
            SessionConfig { forward, startup, policy: PolicyKind::Dash, ..SessionConfig::default() };
        config.reverse.delay = Nanos::from_ms(5);
        simulate(graph, &config).unwrap().miss_rate
    }

    /// On a link with room for everything, next to nothing is missing, however short the clip.
    #[test]
    fn a_wide_link_delivers_short_clips() {
        for frames in [30, 60, 240] {
            let found = missing(&clip(frames), StartupRule::AfterWait);
            assert!(found < 0.05, "{frames} frames: {found}");
        }
        // Where playout starts as soon as the base is there, its first frames have little else.
        let found = missing(&clip(60), StartupRule::BaseGroups(0.95));
        assert!(found < 0.08, "{found}");
    }

    /// A packet that several clusters share takes its bytes from the budget once.
    #[test]
    fn a_wide_link_delivers_packets_that_clusters_share() {
        let found = missing(&shared(&clip(240)), StartupRule::AfterWait);
        assert!(found < 0.05, "{found}");
    }
}
