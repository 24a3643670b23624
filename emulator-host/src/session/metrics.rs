//! Counts what happens during a run, and makes the report.

use super::{IP_UDP_BYTES, QUIC_OVERHEAD_BYTES, forecast::Forecasts};
use crate::{
    clock::{Bytes, Nanos, Rate},
    graph::{ClosureRule, GroupIndex, PacketGraph, PacketIndex},
    link::Counts,
    receiver::{Arrival, Snapshot, take_fresh},
    report::{BoxRow, FrameRow, Report, SenderCounts, SenderRow, Waste},
};

const NEVER: u32 = u32::MAX;
/// Bytes that the link spends on the datagram of a packet beside the packet.
const OVERHEAD_BYTES: u64 = (QUIC_OVERHEAD_BYTES + IP_UDP_BYTES) as u64;

/// A group that changes pixels now.
#[derive(Clone, Copy, Debug)]
struct Active {
    group: GroupIndex,
    last_frame: u32,
    base: bool,
    utility: f64,
}

/// Sums over the active groups; renewed only when the set changes, because most snapshots change few groups.
#[derive(Clone, Copy, Debug, Default)]
struct Sums {
    bases: usize,
    /// Groups of positive utility.
    positive: usize,
    utility: f64,
    positive_utility: f64,
}

pub(super) struct Metrics<'a> {
    graph: &'a PacketGraph,
    by_first: Vec<GroupIndex>,
    entered: usize,
    active: Vec<Active>,
    /// Smallest last frame of the active groups.
    first_to_leave: u32,
    sums: Sums,
    /// Those of the active groups that were not usable at the last snapshot.
    missing: Vec<Active>,
    shown: Snapshot,
    usable_bytes: u64,
    /// Usable bytes and all bytes of each group ([`ClosureRule::Sliced`] only).
    group_bytes: Vec<(u32, u32)>,
    /// First frame that was still to come when a packet arrived.
    arrived: Vec<u32>,
    /// First frame in whose snapshot a packet was usable.
    used: Vec<u32>,
    /// Packets recovered from each repair set: as many of its parity packets were of use.
    set_used: Vec<u32>,
    frames: Vec<FrameRow>,
    /// Σ over the frames shown of the missing share of the groups of positive utility.
    positive_misses: f64,
    samples: Vec<SenderRow>,
    has_manifest: bool,
    media_bytes: u64,
    /// The same with the headers of datagrams.
    link_bytes: u64,
    /// [`Report::arrived_bytes`].
    arrived_bytes: Vec<u64>,
    buffered: u64,
    recovered: u64,
    waste: Waste,
}

impl<'a> Metrics<'a> {
    pub(super) fn new(graph: &'a PacketGraph) -> Self {
        let mut by_first: Vec<GroupIndex> = (0..graph.groups().len() as u32).map(GroupIndex).collect();
        by_first.sort_by_key(|index| (graph.groups()[index.at()].first_frame, *index));
        let mut group_bytes = Vec::new();
        if graph.profile() == ClosureRule::Sliced {
            let bytes = |packet: &PacketIndex| u32::from(graph.packets()[packet.at()].wire_bytes);
            group_bytes.extend(graph.groups().iter().map(|group| (0, group.packets.iter().map(bytes).sum())));
        }
        Self {
            graph,
            by_first,
            entered: 0,
            active: Vec::new(),
            first_to_leave: NEVER,
            sums: Sums::default(),
            missing: Vec::new(),
            shown: Snapshot::empty(graph),
            usable_bytes: 0,
            group_bytes,
            arrived: vec![NEVER; graph.packets().len()],
            used: vec![NEVER; graph.packets().len()],
            set_used: vec![0; graph.repair_sets().len()],
            frames: Vec::with_capacity(graph.frames() as usize),
            positive_misses: 0.0,
            samples: Vec::new(),
            has_manifest: false,
            media_bytes: 0,
            link_bytes: 0,
            arrived_bytes: Vec::with_capacity(graph.frames() as usize),
            buffered: 0,
            recovered: 0,
            waste: Waste::default(),
        }
    }

    pub(super) fn sample(&mut self, row: SenderRow) {
        self.samples.push(row);
    }

    /// The manifest is complete: from here on, what has arrived can be shown.
    pub(super) fn on_manifest(&mut self) {
        self.has_manifest = true;
    }

    pub(super) fn arrive(&mut self, packet: PacketIndex, arrival: Arrival, next_frame: u32) {
        let bytes = u64::from(self.graph.wire_bytes(packet));
        self.media_bytes += bytes;
        self.link_bytes += bytes + OVERHEAD_BYTES;
        match arrival {
            Arrival::Duplicate => self.waste.duplicate_bytes += bytes,
            Arrival::Refused => self.waste.refused_bytes += bytes,
            Arrival::Fresh => self.arrived[packet.at()] = next_frame,
            Arrival::Buffered => {
                self.arrived[packet.at()] = next_frame;
                self.buffered += 1;
            }
        }
    }

    /// All sets of a recovered packet are taken to have helped.
    pub(super) fn recover(&mut self, packet: PacketIndex) {
        self.recovered += 1;
        for set in self.graph.sets_of(packet) {
            self.set_used[*set as usize] += 1;
        }
    }

    /// Frame `frame` is shown with what `snapshot` holds.
    pub(super) fn show(&mut self, frame: u32, now: Nanos, snapshot: &Snapshot) {
        self.enter_packets(frame, snapshot);
        self.renew_active(frame);
        let (mut lacking, mut bases_missed, mut positive_missed) = (0.0, 0, 0);
        self.missing.retain(|active| {
            let is_missing = !snapshot.has_group(active.group);
            if is_missing {
                let part = self.group_bytes.get(active.group.at());
                let there = part.map_or(0.0, |(part, all)| f64::from(*part) / f64::from(*all));
                lacking += active.utility * (1.0 - there);
                bases_missed += usize::from(active.base);
                positive_missed += usize::from(active.utility > 0.0);
            }
            is_missing
        });
        let share = |part: usize, all: usize| if all == 0 { 0.0 } else { part as f64 / all as f64 };
        let sums = self.sums;
        self.positive_misses += share(positive_missed, sums.positive);
        self.arrived_bytes.push(if self.has_manifest { self.link_bytes } else { 0 });
        self.frames.push(FrameRow {
            time_ns: now,
            frame,
            usable_bytes: self.usable_bytes,
            utility: if sums.positive_utility > 0.0 {
                (sums.utility - lacking) / sums.positive_utility
            } else {
                1.0
            },
            miss: share(self.missing.len(), self.active.len()),
            base_miss: share(bases_missed, sums.bases),
        });
    }

    /// Groups come and go with the frames. After a change everything active counts as missing until looked
    /// up.
    fn renew_active(&mut self, frame: u32) {
        let before = (self.entered, self.active.len());
        while let Some(group) = self.by_first.get(self.entered).copied() {
            let facts = &self.graph.groups()[group.at()];
            if facts.first_frame > frame {
                break;
            }
            let base = facts.level() == 0;
            self.active.push(Active { group, last_frame: facts.last_frame, base, utility: facts.utility });
            self.entered += 1;
        }
        if frame > self.first_to_leave {
            self.active.retain(|active| active.last_frame >= frame);
        }
        if before == (self.entered, self.active.len()) {
            return;
        }
        self.first_to_leave = self.active.iter().map(|active| active.last_frame).min().unwrap_or(NEVER);
        self.missing.clone_from(&self.active);
        self.sums = Sums::default();
        for active in &self.active {
            self.sums.bases += usize::from(active.base);
            self.sums.positive += usize::from(active.utility > 0.0);
            self.sums.utility += active.utility;
            self.sums.positive_utility += active.utility.max(0.0);
        }
    }

    /// Notes the packets that have become usable since the last snapshot.
    fn enter_packets(&mut self, frame: u32, snapshot: &Snapshot) {
        take_fresh(&mut self.shown.packets, &snapshot.packets, |index| {
            let packet = PacketIndex(index);
            let bytes = u32::from(self.graph.wire_bytes(packet));
            self.used[packet.at()] = frame;
            self.usable_bytes += u64::from(bytes);
            if !self.group_bytes.is_empty() {
                self.graph.groups_of(packet).for_each(|group| self.group_bytes[group.at()].0 += bytes);
            }
        });
    }

    /// Sorts what arrived into used and wasted, and takes the means.
    pub(super) fn report(
        mut self,
        now: Nanos,
        forecasts: &Forecasts,
        boxes: Vec<(String, Counts)>,
    ) -> Report {
        let forecast = forecasts.score(&self.arrived, self.frames.len() as u32);
        let mut used_bytes = 0;
        for at in 0..self.arrived.len() {
            let index = PacketIndex(at as u32);
            if self.arrived[at] == NEVER {
                continue;
            }
            let bytes = u64::from(self.graph.wire_bytes(index));
            let until = self.graph.useful_until(index);
            let parity_of =
                if self.graph.is_parity(index) { self.graph.packets()[at].parity_of } else { None };
            if let Some(set) = parity_of {
                if let Some(left) = self.set_used[set as usize].checked_sub(1) {
                    self.set_used[set as usize] = left;
                    used_bytes += bytes;
                } else {
                    self.waste.unused_repair_bytes += bytes;
                }
            } else if self.used[at] <= until {
                used_bytes += bytes;
            } else if self.arrived[at] > until {
                self.waste.late_bytes += bytes;
            } else {
                self.waste.outside_closure_bytes += bytes;
            }
        }
        let count = f64::from(self.graph.frames());
        let unshown = count - self.frames.len() as f64;
        let mean = |of: fn(&FrameRow) -> f64, rest: f64| {
            (self.frames.iter().map(of).sum::<f64>() + rest * unshown) / count
        };
        Report {
            policy: String::new(),
            controller: String::new(),
            seed: 0,
            startup_ms: None,
            startup_reached: false,
            miss_rate: mean(|row| row.miss, 1.0),
            base_miss_rate: mean(|row| row.base_miss, 1.0),
            positive_miss_rate: (self.positive_misses + unshown) / count,
            utility: mean(|row| row.utility, 0.0),
            duration_ns: now,
            goodput_bps: rate(self.media_bytes, now),
            usable_goodput_bps: rate(used_bytes, now),
            media_bytes: self.media_bytes,
            buffered_before_manifest: self.buffered,
            recovered: self.recovered,
            waste: self.waste,
            sender: SenderCounts::default(),
            forecast,
            frames: self.frames,
            arrived_bytes: self.arrived_bytes,
            samples: self.samples,
            boxes: boxes.into_iter().map(|(label, counts)| BoxRow { label, counts }).collect(),
            one_way_delay: None,
            digest: 0,
        }
    }
}

fn rate(bytes: u64, span: Nanos) -> f64 {
    if span == Nanos::ZERO { 0.0 } else { Rate::over(Bytes(bytes), span).0 as f64 }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Synthetic;

    /// Everything of `graph` but the groups of which `lacks` is true.
    fn snapshot(graph: &PacketGraph, lacks: impl Fn(usize) -> bool) -> Snapshot {
        let mut snapshot = Snapshot::empty(graph);
        for at in (0..graph.groups().len()).filter(|at| !lacks(*at)) {
            snapshot.insert_group(GroupIndex(at as u32));
        }
        snapshot
    }

    #[test]
    fn groups_without_positive_utility_are_no_misses_of_positive_utility() {
        let mut parts =
            Synthetic { frames: 2, clusters: 8, ..Synthetic::default() }.build(1).unwrap().parts().clone();
        // Two of the four levels: one harms, and one changes nothing.
        for group in &mut parts.groups {
            group.utility = [1.0, 0.5, 0.0, -0.2][usize::from(group.level())];
        }
        let graph = PacketGraph::new(parts).unwrap();
        let level = |at: usize| graph.groups()[at].level();
        let rates = |lacks: &dyn Fn(usize) -> bool| {
            let mut metrics = Metrics::new(&graph);
            metrics.show(0, Nanos::ZERO, &snapshot(&graph, lacks));
            metrics.show(1, Nanos::from_ms(33), &snapshot(&graph, lacks));
            let report = metrics.report(Nanos::from_ms(66), &Forecasts::default(), Vec::new());
            (report.miss_rate, report.positive_miss_rate)
        };
        assert_eq!(rates(&|_| false), (0.0, 0.0));
        assert_eq!(rates(&|at| level(at) >= 2), (0.5, 0.0));
        assert_eq!(rates(&|at| level(at) >= 1), (0.75, 0.5));
        assert_eq!(rates(&|_| true), (1.0, 1.0));
        // Of two frames the second is never shown: all of it is missed.
        let mut metrics = Metrics::new(&graph);
        metrics.show(0, Nanos::ZERO, &snapshot(&graph, |_| false));
        let report = metrics.report(Nanos::from_ms(33), &Forecasts::default(), Vec::new());
        assert_eq!((report.miss_rate, report.positive_miss_rate), (0.5, 0.5));
    }

    #[test]
    fn bytes_that_arrived_count_once_the_manifest_is_there_and_with_their_headers() {
        let graph = Synthetic { frames: 3, ..Synthetic::default() }.build(1).unwrap();
        let mut metrics = Metrics::new(&graph);
        let nothing = Snapshot::empty(&graph);
        let bytes = |packet: u32| u64::from(graph.wire_bytes(PacketIndex(packet))) + 58;
        metrics.arrive(PacketIndex(0), Arrival::Buffered, 0);
        metrics.show(0, Nanos::ZERO, &nothing);
        metrics.on_manifest();
        metrics.show(1, Nanos::from_ms(33), &nothing);
        // Bytes that arrive in vain could have been others.
        metrics.arrive(PacketIndex(1), Arrival::Fresh, 2);
        metrics.arrive(PacketIndex(1), Arrival::Duplicate, 2);
        metrics.show(2, Nanos::from_ms(66), &nothing);
        let report = metrics.report(Nanos::from_ms(100), &Forecasts::default(), Vec::new());
        assert_eq!(report.arrived_bytes, [0, bytes(0), bytes(0) + 2 * bytes(1)]);
    }
}
