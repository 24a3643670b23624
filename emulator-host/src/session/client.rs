//! The receiving end: acknowledges, starts playout, and shows frames on time.

use super::control::ControlReceiver;
use super::metrics::Metrics;
use super::sender::Content;
use super::{IP_UDP_BYTES, SessionConfig, StartupRule};
use crate::clock::Nanos;
use crate::graph::{GroupIndex, PacketGraph, PacketIndex};
use crate::link::Datagram;
use crate::receiver::{Endpoint, Snapshot};

/// Most ranges remembered; older ones are forgotten.
const RANGES: usize = 32;
/// Numbers behind the largest that a receipt still reports. A peer that heard that its receipts arrived would forget at that
/// point (RFC 9000, 13.2.4); a fixed reach stands in for it, or every hole would be reported for ever.
const REACH: u64 = 256;
/// Receipts in which a recovered packet is reported, so that a lost receipt does no harm.
const REPEATS: u8 = 4;
/// Short header, tag and fixed part of an acknowledgement.
const RECEIPT_BYTES: u32 = 35;

/// What the sender learns.
#[derive(Clone, Copy, Debug)]
pub(super) struct Receipt<'a> {
    /// Inclusive, newest first.
    pub(super) ranges: &'a [(u64, u64)],
    pub(super) ack_delay: Nanos,
    pub(super) recovered: &'a [PacketIndex],
    pub(super) playout_start: Option<Nanos>,
}

/// A receipt under way; its lists lie in shared tables.
#[derive(Clone, Copy, Debug)]
struct Record {
    ranges: (u32, u32),
    recovered: (u32, u32),
    ack_delay: Nanos,
    playout_start: Option<Nanos>,
}

pub(super) struct Client<'a> {
    graph: &'a PacketGraph,
    config: &'a SessionConfig,
    endpoint: &'a mut dyn Endpoint,
    control: ControlReceiver,
    /// Received numbers, inclusive, oldest first.
    ranges: Vec<(u64, u64)>,
    largest_at: Nanos,
    unacked: u32,
    ack_at: Nanos,
    reports: Vec<(PacketIndex, u8)>,
    recovered: Vec<PacketIndex>,
    records: Vec<Record>,
    record_ranges: Vec<(u64, u64)>,
    record_recovered: Vec<PacketIndex>,
    first_base: Vec<(GroupIndex, f64)>,
    changed: bool,
    start: Option<Nanos>,
    reached: bool,
    next_frame: u32,
}

impl<'a> Client<'a> {
    pub(super) fn new(
        graph: &'a PacketGraph,
        config: &'a SessionConfig,
        endpoint: &'a mut dyn Endpoint,
    ) -> Self {
        let weight = |utility: f64| match config.startup.rule {
            StartupRule::BaseGroups(_) => 1.0,
            StartupRule::BaseUtility(_) => utility.max(0.0),
        };
        let groups =
            (0u32..).zip(graph.groups()).filter(|(_, group)| group.level == 0 && group.first_frame == 0);
        let first_base = groups.map(|(at, group)| (GroupIndex(at), weight(group.utility))).collect();
        let control = ControlReceiver::new(graph.manifest_bytes());
        if control.is_complete() {
            endpoint.control(0, true, &mut Vec::new());
        }
        Self {
            graph,
            config,
            endpoint,
            control,
            ranges: Vec::with_capacity(RANGES + 1),
            largest_at: Nanos::ZERO,
            unacked: 0,
            ack_at: Nanos::MAX,
            reports: Vec::new(),
            recovered: Vec::new(),
            records: Vec::new(),
            record_ranges: Vec::new(),
            record_recovered: Vec::new(),
            first_base,
            changed: true,
            start: None,
            reached: false,
            next_frame: 0,
        }
    }

    pub(super) fn playout_start(&self) -> Option<Nanos> {
        self.start
    }

    pub(super) fn threshold_reached(&self) -> bool {
        self.reached
    }

    pub(super) fn is_over(&self) -> bool {
        self.next_frame >= self.graph.frames()
    }

    pub(super) fn next_time(&self) -> Nanos {
        let playout = match self.start {
            None => self.config.startup.max_wait,
            Some(start) => start + self.graph.frame_interval().times(u64::from(self.next_frame)),
        };
        playout.min(self.ack_at)
    }

    pub(super) fn receive(&mut self, number: u64, content: Content, now: Nanos, metrics: &mut Metrics<'_>) {
        let in_order = self.enter_number(number);
        if in_order {
            self.largest_at = now;
        }
        self.unacked += 1;
        let due = self.unacked >= self.config.ack_every || !in_order;
        self.ack_at = if due { now } else { self.ack_at.min(now + self.config.max_ack_delay) };
        self.changed = true;
        match content {
            Content::Media(packet) => {
                let arrival = self.endpoint.media(packet, now, &mut self.recovered);
                metrics.arrive(packet, arrival, self.next_frame);
            }
            Content::Control(chunk) => {
                if let Some((bytes, complete)) = self.control.on_chunk(chunk) {
                    self.endpoint.control(bytes, complete, &mut self.recovered);
                }
            }
            Content::Ping => {}
        }
        for packet in self.recovered.drain(..) {
            metrics.recover(packet);
            self.reports.push((packet, REPEATS));
        }
    }

    /// Starts playout if the threshold is reached or the wait is over.
    pub(super) fn start_if_ready(&mut self, now: Nanos) {
        if self.start.is_some() || !(self.changed || now >= self.config.startup.max_wait) {
            return;
        }
        self.changed = false;
        let (StartupRule::BaseGroups(share) | StartupRule::BaseUtility(share)) = self.config.startup.rule;
        let snapshot = self.endpoint.snapshot(0);
        let total: f64 = self.first_base.iter().map(|(_, weight)| weight).sum();
        let usable: f64 = self
            .first_base
            .iter()
            .filter(|(group, _)| snapshot.has_group(*group))
            .map(|(_, weight)| weight)
            .sum();
        self.reached = self.control.is_complete() && usable >= share * total;
        if self.reached || now >= self.config.startup.max_wait {
            self.start = Some(now);
            // The sender needs the playout time now.
            self.ack_at = now;
        }
    }

    /// The next frame to show, if its time has come.
    pub(super) fn frame_due(&mut self, now: Nanos) -> Option<u32> {
        let start = self.start?;
        let frame = self.next_frame;
        if self.is_over() || start + self.graph.frame_interval().times(u64::from(frame)) > now {
            return None;
        }
        self.next_frame += 1;
        Some(frame)
    }

    pub(super) fn snapshot(&mut self, frame: u32) -> &Snapshot {
        self.endpoint.snapshot(frame)
    }

    /// A receipt that leaves at `now`.
    pub(super) fn poll(&mut self, now: Nanos) -> Option<Datagram> {
        if self.ack_at > now {
            return None;
        }
        self.ack_at = Nanos::MAX;
        self.unacked = 0;
        let first_range = self.record_ranges.len() as u32;
        let oldest = self.ranges.last().map_or(0, |(_, last)| last.saturating_sub(REACH));
        let recent = self.ranges.iter().rev().take_while(|(_, last)| *last >= oldest);
        self.record_ranges.extend(recent.take(RANGES / 2));
        let first_recovered = self.record_recovered.len() as u32;
        for (packet, left) in &mut self.reports {
            self.record_recovered.push(*packet);
            *left -= 1;
        }
        self.reports.retain(|(_, left)| *left > 0);
        let record = Record {
            ranges: (first_range, self.record_ranges.len() as u32),
            recovered: (first_recovered, self.record_recovered.len() as u32),
            ack_delay: now - self.largest_at,
            playout_start: self.start,
        };
        let lists = 4 * (record.ranges.1 - record.ranges.0) + 4 * (record.recovered.1 - record.recovered.0);
        let playout = if self.start.is_some() { 8 } else { 0 };
        self.records.push(record);
        Some(Datagram {
            tag: self.records.len() as u64 - 1,
            bytes: RECEIPT_BYTES + lists + playout + IP_UDP_BYTES,
        })
    }

    pub(super) fn receipt(&self, tag: u64) -> Receipt<'_> {
        let record = self.records[tag as usize];
        Receipt {
            ranges: &self.record_ranges[record.ranges.0 as usize..record.ranges.1 as usize],
            recovered: &self.record_recovered[record.recovered.0 as usize..record.recovered.1 as usize],
            ack_delay: record.ack_delay,
            playout_start: record.playout_start,
        }
    }

    /// Enters a number; whether it is the next after the largest.
    fn enter_number(&mut self, number: u64) -> bool {
        match self.ranges.last_mut() {
            Some((_, last)) if *last + 1 == number => {
                *last = number;
                return true;
            }
            None => {
                self.ranges.push((number, number));
                return number == 0;
            }
            Some(_) => {}
        }
        let place = self.ranges.partition_point(|(_, last)| *last < number);
        let joins_next = self.ranges.get(place).is_some_and(|(first, _)| *first == number + 1);
        let joins_last = place > 0 && self.ranges[place - 1].1 + 1 == number;
        match (joins_last, joins_next) {
            (true, true) => {
                self.ranges[place - 1].1 = self.ranges[place].1;
                self.ranges.remove(place);
            }
            (true, false) => self.ranges[place - 1].1 = number,
            (false, true) => self.ranges[place].0 = number,
            (false, false) => self.ranges.insert(place, (number, number)),
        }
        if self.ranges.len() > RANGES {
            self.ranges.remove(0);
        }
        false
    }
}
