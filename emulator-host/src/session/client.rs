//! Receives datagrams, acknowledges them, starts playout, and shows frames on time.

use super::{
    IP_UDP_BYTES, SessionConfig,
    control::ControlReceiver,
    datagram::{Acknowledgement, Content},
    feedback::ReceiptWriter,
    metrics::Metrics,
};
use crate::{
    clock::Nanos,
    graph::{GroupIndex, PacketGraph, PacketIndex},
    link::Datagram,
    receiver::{Arrival, Endpoint, Snapshot},
};

/// Most ranges remembered; older ones are forgotten.
const RANGES: usize = 32;
/// Numbers behind the largest that an acknowledgement still reports. A peer that heard that its
/// acknowledgements arrived would forget at that point (RFC 9000, 13.2.4); a fixed reach stands in for it, or
/// every hole would be reported for ever.
const REACH: u64 = 256;
/// Short header, tag and fixed part of an acknowledgement, and the frame header of the receipt behind it.
const ACK_BYTES: u32 = 35 + 3;

/// A datagram of feedback under way; its lists and bytes lie in shared tables.
#[derive(Clone, Copy, Debug)]
struct Sent {
    ranges: (usize, usize),
    receipt: (usize, usize),
    ack_delay: Nanos,
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
    recovered: Vec<PacketIndex>,
    receipts: ReceiptWriter,
    sent: Vec<Sent>,
    sent_ranges: Vec<(u64, u64)>,
    sent_receipts: Vec<u8>,
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
        let first_base = config.startup.rule.opening(graph);
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
            recovered: Vec::new(),
            receipts: ReceiptWriter::new(graph),
            sent: Vec::new(),
            sent_ranges: Vec::new(),
            sent_receipts: Vec::new(),
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
        // Delay is reported for the largest number, whether or not a gap lies before it (RFC 9000, 13.2.5).
        if self.ranges.last().is_none_or(|(_, largest)| number > *largest) {
            self.largest_at = now;
        }
        let in_order = self.enter_number(number);
        self.unacked += 1;
        let due = self.unacked >= self.config.ack_every || !in_order;
        self.ack_at = if due { now } else { self.ack_at.min(now + self.config.max_ack_delay) };
        self.changed = true;
        match content {
            Content::Media(packet) => {
                let arrival = self.endpoint.media(packet, now, &mut self.recovered);
                metrics.arrive(packet, arrival, self.next_frame);
                if arrival != Arrival::Refused {
                    self.receipts.on_arrived(self.graph, packet);
                }
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
            self.receipts.on_recovered(self.graph, packet);
        }
    }

    /// Starts playout if the threshold is reached or the wait is over.
    pub(super) fn start_if_ready(&mut self, now: Nanos) {
        if self.start.is_some() || !(self.changed || now >= self.config.startup.max_wait) {
            return;
        }
        self.changed = false;
        let snapshot = self.endpoint.snapshot(0);
        let total: f64 = self.first_base.iter().map(|(_, weight)| weight).sum();
        let usable: f64 = self
            .first_base
            .iter()
            .filter(|(group, _)| snapshot.has_group(*group))
            .map(|(_, weight)| weight)
            .sum();
        let share = self.config.startup.rule.share();
        self.reached = self.control.is_complete() && share.is_some_and(|share| usable >= share * total);
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
        let snapshot = self.endpoint.snapshot(frame);
        self.receipts.on_complete(self.graph, &snapshot.groups);
        snapshot
    }

    /// Feedback that leaves at `now`.
    pub(super) fn poll(&mut self, now: Nanos) -> Option<Datagram> {
        if self.ack_at > now {
            return None;
        }
        self.ack_at = Nanos::MAX;
        self.unacked = 0;
        let first_range = self.sent_ranges.len();
        let oldest = self.ranges.last().map_or(0, |(_, last)| last.saturating_sub(REACH));
        let recent = self.ranges.iter().rev().take_while(|(_, last)| *last >= oldest);
        self.sent_ranges.extend(recent.take(RANGES / 2));
        let first_byte = self.sent_receipts.len();
        self.receipts.write(self.start, &mut self.sent_receipts);
        let sent = Sent {
            ranges: (first_range, self.sent_ranges.len()),
            receipt: (first_byte, self.sent_receipts.len()),
            ack_delay: now - self.largest_at,
        };
        let range_bytes = 4 * (sent.ranges.1 - sent.ranges.0) as u32;
        let receipt_bytes = (sent.receipt.1 - sent.receipt.0) as u32;
        self.sent.push(sent);
        Some(Datagram {
            tag: self.sent.len() as u64 - 1,
            bytes: ACK_BYTES + range_bytes + receipt_bytes + IP_UDP_BYTES,
        })
    }

    /// What the datagram `tag` carries: the transport's acknowledgement and a receipt.
    pub(super) fn feedback(&self, tag: u64) -> (Acknowledgement<'_>, &[u8]) {
        let sent = self.sent[tag as usize];
        let ranges = &self.sent_ranges[sent.ranges.0..sent.ranges.1];
        let receipt = &self.sent_receipts[sent.receipt.0..sent.receipt.1];
        (Acknowledgement { ranges, ack_delay: sent.ack_delay }, receipt)
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{graph::Synthetic, receiver::GraphReceiver};

    #[test]
    fn the_delay_of_an_acknowledgement_starts_at_the_largest_number_even_behind_a_gap() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let config = SessionConfig::default();
        let mut endpoint = GraphReceiver::new(&graph, 16);
        let mut client = Client::new(&graph, &config, &mut endpoint);
        let mut metrics = Metrics::new(&graph);
        client.receive(0, Content::Ping, Nanos::from_ms(1), &mut metrics);
        // Number 1 is missing when 2 arrives: the receipt leaves at once, and 2 waited for nothing.
        client.receive(2, Content::Ping, Nanos::from_ms(20), &mut metrics);
        let sent = client.poll(Nanos::from_ms(20)).unwrap();
        assert_eq!(client.feedback(sent.tag).0.ack_delay, Nanos::ZERO);
        // Number 1 comes late: the delay is still that of number 2.
        client.receive(1, Content::Ping, Nanos::from_ms(23), &mut metrics);
        let sent = client.poll(Nanos::from_ms(23)).unwrap();
        assert_eq!(client.feedback(sent.tag).0.ack_delay, Nanos::from_ms(3));
    }
}
