//! Sends by the paper's score: S(g) = P_g · Ũ_g · U_g ÷ Σ_{p ∈ C(g)} B_p.
//!
//! - C(g): packets of g and of its transitive closure that are not acknowledged; B_p their wire bytes.
//! - P_g: [`mean_arrival`] over the frames at which g changes pixels. Expected arrival is the smoothed round
//!   trip less the way back, plus what of C(g) is not yet sent at the path's rate; its spread is the round
//!   trip's deviation plus half of that sending time. The result is multiplied by the chance that no packet
//!   of it is lost, counting the retransmissions that a base packet has.
//! - Ũ_g: the group's risk-adjusted utility per frame times the frames on which it shows; with P_g the mean
//!   over those frames, the product is what the group is expected to add to all frames together. Groups with
//!   none, or less, are never targets.
//! - U_g = ½ (1 + f), with f the share of g's own bytes that is under way or there: it rises as g nears
//!   completion.
//!
//! The score is the paper's; what is around it is not, for the text leaves it open.
//!
//! Until playout has started, the base of the first frame comes before everything else, in order of S.
//!
//! Infeasible groups are skipped: abandoned (a packet in the closure is lost for good), expired, or with P_g
//! below a floor. The best groups are ranked together and served in turn; the ranking is renewed when they
//! are done, after [`DeadlineUtilityPaperConfig::refresh`], or when something in it died. A group once begun
//! is finished first.
//!
//! A flat utility table leaves P_g · U_g ÷ bytes: the score holds as it is. That is not the order of
//! [`super::Dependency`]: P_g is larger for later frames, so that of two groups of one size the later one
//! comes first (11 % of the pairs of a test are out of order). The default scheduler's score has the urgency
//! that the conventional order needs (1.6 %).

use super::{PacketStatus, Scheduler, SenderView, first_of_closure, probability::mean_arrival};
use crate::{
    clock::Nanos,
    graph::{ClosureRule, GroupIndex, PacketGraph, PacketIndex},
};

/// Settings.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DeadlineUtilityPaperConfig {
    /// Groups with a smaller P_g are infeasible, 0..=1.
    pub least_probability: f64,
    /// Longest time that a ranking is used.
    pub refresh: Nanos,
    /// Groups ranked at a time, at least 1.
    pub batch: usize,
}

impl Default for DeadlineUtilityPaperConfig {
    fn default() -> Self {
        Self { least_probability: 0.05, refresh: Nanos::from_ms(100), batch: 16 }
    }
}

/// The policy's state.
#[derive(Debug)]
pub struct DeadlineUtilityPaper {
    config: DeadlineUtilityPaperConfig,
    tallies: Vec<Tally>,
    /// Groups by (first frame, index), and how many of them have come within the horizon.
    by_time: Vec<GroupIndex>,
    entered: usize,
    candidates: Vec<GroupIndex>,
    /// Best first from the back.
    ranking: Vec<(f64, GroupIndex)>,
    ranked_at: Nanos,
    target: Option<GroupIndex>,
}

/// What is left of one group.
#[derive(Clone, Copy, Debug, Default)]
struct Tally {
    total_bytes: u32,
    waiting_bytes: u32,
    waiting: u32,
    unacked_bytes: u32,
    abandoned: u32,
}

/// What is left of a closure.
#[derive(Clone, Copy, Debug, Default)]
struct Need {
    unacked_bytes: u64,
    waiting_bytes: u64,
    waiting_base: u32,
    waiting_refined: u32,
}

impl DeadlineUtilityPaper {
    /// For `graph`.
    pub fn new(graph: &PacketGraph, config: DeadlineUtilityPaperConfig) -> Self {
        let mut tallies = vec![Tally::default(); graph.groups().len()];
        for packet in graph.packets() {
            for group in &packet.groups {
                let tally = &mut tallies[group.at()];
                tally.total_bytes += u32::from(packet.wire_bytes);
                tally.count(PacketStatus::Waiting, u32::from(packet.wire_bytes), u32::wrapping_add);
            }
        }
        let mut by_time: Vec<GroupIndex> = (0..graph.groups().len() as u32).map(GroupIndex).collect();
        by_time.sort_by_key(|index| (graph.groups()[index.at()].first_frame, *index));
        Self {
            config,
            tallies,
            by_time,
            entered: 0,
            candidates: Vec::new(),
            ranking: Vec::new(),
            ranked_at: Nanos::ZERO,
            target: None,
        }
    }

    /// S(g) at `now`; `None` if g is infeasible or has nothing left to send. Public so that tests can
    /// compare.
    #[doc(hidden)]
    pub fn score(&self, view: &SenderView<'_>, group: GroupIndex, now: Nanos) -> Option<f64> {
        self.score_above(view, group, now, 0.0)
    }

    /// The score, or `None` also if it cannot exceed `floor`; the bound P ≤ 1 saves most of the work.
    fn score_above(&self, view: &SenderView<'_>, group: GroupIndex, now: Nanos, floor: f64) -> Option<f64> {
        let facts = &view.graph.groups()[group.at()];
        if facts.risk_adjusted <= 0.0 {
            return None;
        }
        let need = self.need(view, group)?;
        if need.waiting_base + need.waiting_refined == 0 {
            return None;
        }
        let own = &self.tallies[group.at()];
        let begun = 1.0 - f64::from(own.waiting_bytes) / f64::from(own.total_bytes);
        // Utility is per frame shown, so a group that shows on more frames is worth more.
        let frames = f64::from(facts.last_frame - facts.first_frame + 1);
        let bound = facts.risk_adjusted * frames * 0.5 * (1.0 + begun) / need.unacked_bytes as f64;
        if bound <= floor {
            return None;
        }
        let probability = self.probability(view, facts.first_frame, facts.last_frame, need, now);
        if probability < self.config.least_probability {
            return None;
        }
        let score = probability * bound;
        (score > floor).then_some(score)
    }

    fn probability(&self, view: &SenderView<'_>, first: u32, last: u32, need: Need, now: Nanos) -> f64 {
        let seconds = |frame: u32| view.playout_at(frame).as_s() - now.as_s();
        let sending = need.waiting_bytes as f64 * 8.0 / (view.rate.0 as f64).max(1.0);
        // Queues stand on the way there: the way back takes half of the smallest round trip.
        let expected = view.smoothed_rtt.as_s() - view.minimum_rtt.as_s() / 2.0 + sending;
        let spread = view.rtt_variation.as_s() + 0.5 * sending;
        let refined = power(1.0 - view.loss, need.waiting_refined);
        let base = power(1.0 - power(view.loss, view.retransmissions + 1), need.waiting_base);
        base * refined * mean_arrival(seconds(first), seconds(last), expected, spread)
    }

    /// `None` if something in the closure is lost for good.
    fn need(&self, view: &SenderView<'_>, group: GroupIndex) -> Option<Need> {
        let mut need = Need::default();
        let mortal = view.graph.profile() == ClosureRule::AllOrNothing;
        if view.graph.closure_shares_packets(group) {
            return self.need_by_packet(view, group, mortal);
        }
        for member in view.graph.closure(group) {
            let tally = &self.tallies[member.at()];
            if mortal && tally.abandoned > 0 {
                return None;
            }
            need.unacked_bytes += u64::from(tally.unacked_bytes);
            need.waiting_bytes += u64::from(tally.waiting_bytes);
            if view.graph.groups()[member.at()].level() == 0 {
                need.waiting_base += tally.waiting;
            } else {
                need.waiting_refined += tally.waiting;
            }
        }
        Some(need)
    }

    /// The slow way, for closures in which groups share packets: every packet counts once.
    fn need_by_packet(&self, view: &SenderView<'_>, group: GroupIndex, mortal: bool) -> Option<Need> {
        let groups = view.graph.groups();
        let mut packets: Vec<PacketIndex> = view
            .graph
            .closure(group)
            .flat_map(|member| groups[member.at()].packets.iter().copied())
            .collect();
        packets.sort_unstable();
        packets.dedup();
        let mut need = Need::default();
        for packet in packets {
            let bytes = u64::from(view.graph.wire_bytes(packet));
            match view.status[packet.at()] {
                PacketStatus::Delivered => {}
                PacketStatus::Abandoned if mortal => return None,
                PacketStatus::Abandoned => {}
                PacketStatus::InFlight => need.unacked_bytes += bytes,
                PacketStatus::Waiting => {
                    need.unacked_bytes += bytes;
                    need.waiting_bytes += bytes;
                    let base = view.graph.level(packet) == 0;
                    need.waiting_base += u32::from(base);
                    need.waiting_refined += u32::from(!base);
                }
            }
        }
        Some(need)
    }

    fn rank(&mut self, view: &SenderView<'_>, now: Nanos) {
        while let Some(group) = self.by_time.get(self.entered).copied() {
            if view.graph.groups()[group.at()].first_frame >= view.horizon_frame {
                break;
            }
            if view.graph.groups()[group.at()].risk_adjusted > 0.0 {
                self.candidates.push(group);
            }
            self.entered += 1;
        }
        let mut candidates = std::mem::take(&mut self.candidates);
        let (groups, tallies) = (view.graph.groups(), &self.tallies);
        candidates.retain(|group| {
            tallies[group.at()].waiting > 0 && !view.is_past(groups[group.at()].last_frame, now)
        });
        self.ranking.clear();
        let batch = self.config.batch.max(1);
        let mut floor = 0.0;
        // Before playout no deadline runs, and what the first frame's base lacks delays everything.
        let opening = |group: &GroupIndex| {
            let facts = &groups[group.at()];
            facts.level() == 0 && facts.first_frame == 0
        };
        let only_opening = !view.playing && candidates.iter().any(opening);
        for group in &candidates {
            if only_opening && !opening(group) {
                continue;
            }
            let Some(score) = self.score_above(view, *group, now, floor) else { continue };
            // Ascending by score; of equals the earlier group in time is served first and lies nearer to the
            // back.
            let place = self.ranking.partition_point(|(other, _)| *other < score);
            self.ranking.insert(place, (score, *group));
            if self.ranking.len() > batch {
                self.ranking.remove(0);
                floor = self.ranking[0].0;
            }
        }
        self.candidates = candidates;
        self.ranked_at = now;
    }

    /// The next sendable packet of the target, while the target is worth it.
    fn go_on(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        let target = self.target?;
        let packet = self.score(view, target, now).and_then(|_| first_of_closure(view, target, now));
        if packet.is_none() {
            self.target = None;
        }
        packet
    }
}

impl Scheduler for DeadlineUtilityPaper {
    fn name(&self) -> &'static str {
        "deadline-utility-paper"
    }

    fn next(&mut self, view: &SenderView<'_>, now: Nanos) -> Option<PacketIndex> {
        let mut fresh = false;
        loop {
            if let Some(packet) = self.go_on(view, now) {
                return Some(packet);
            }
            if self.ranking.is_empty() || now >= self.ranked_at + self.config.refresh {
                if fresh {
                    return None;
                }
                self.rank(view, now);
                fresh = true;
            }
            self.target = self.ranking.pop().map(|(_, group)| group);
            self.target?;
        }
    }

    fn on_status(&mut self, graph: &PacketGraph, packet: PacketIndex, change: [PacketStatus; 2]) {
        let [before, after] = change;
        let bytes = u32::from(graph.wire_bytes(packet));
        for group in graph.groups_of(packet) {
            let tally = &mut self.tallies[group.at()];
            tally.count(before, bytes, u32::wrapping_sub);
            tally.count(after, bytes, u32::wrapping_add);
        }
        if after == PacketStatus::Abandoned {
            self.ranking.clear();
        }
    }
}

impl Tally {
    /// Enters or strikes out one packet of this status.
    fn count(&mut self, status: PacketStatus, bytes: u32, entry: fn(u32, u32) -> u32) {
        match status {
            PacketStatus::Waiting => {
                self.waiting = entry(self.waiting, 1);
                self.waiting_bytes = entry(self.waiting_bytes, bytes);
                self.unacked_bytes = entry(self.unacked_bytes, bytes);
            }
            PacketStatus::InFlight => self.unacked_bytes = entry(self.unacked_bytes, bytes),
            PacketStatus::Delivered => {}
            PacketStatus::Abandoned => self.abandoned = entry(self.abandoned, 1),
        }
    }
}

/// Whole powers by squaring, in a fixed order.
fn power(mut base: f64, mut exponent: u32) -> f64 {
    let mut product = 1.0;
    while exponent > 0 {
        if exponent & 1 == 1 {
            product *= base;
        }
        base *= base;
        exponent >>= 1;
    }
    product
}
