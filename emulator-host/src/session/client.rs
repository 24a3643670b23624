//! Receives over the modelled transport: acknowledges datagrams, and hands what they carry to the viewer.

use super::{
    IP_UDP_BYTES, SessionConfig,
    control::ControlReceiver,
    datagram::{Acknowledgement, Content},
    delivery_log::DeliveryLog,
    feedback::Reported,
    viewer::Viewer,
};
use crate::{clock::Nanos, graph::PacketGraph, link::Datagram, receiver::Endpoint};

/// Most ranges remembered; older ones are forgotten.
const RANGES: usize = 32;
/// Numbers behind the largest that an acknowledgement still reports. A peer that heard that its
/// acknowledgements arrived would forget at that point (RFC 9000, 13.2.4); a fixed reach stands in for it, or
/// every hole would be reported for ever.
const REACH: u64 = 256;
/// Short header, tag and fixed part of an acknowledgement, and the frame header of the receipt behind it.
const ACK_BYTES: u32 = 35 + 3;

/// A datagram of feedback under way; its ranges lie in a shared table.
#[derive(Clone, Copy, Debug)]
struct Sent {
    ranges: (u32, u32),
    reported: Reported,
    ack_delay: Nanos,
}

pub(super) struct Client<'a> {
    config: &'a SessionConfig,
    viewer: Viewer<'a>,
    control: ControlReceiver,
    /// Received numbers, inclusive, oldest first.
    ranges: Vec<(u64, u64)>,
    largest_at: Nanos,
    unacked: u32,
    ack_at: Nanos,
    sent: Vec<Sent>,
    sent_ranges: Vec<(u64, u64)>,
}

impl<'a> Client<'a> {
    pub(super) fn new(
        graph: &'a PacketGraph,
        config: &'a SessionConfig,
        endpoint: &'a mut dyn Endpoint,
    ) -> Self {
        Self {
            config,
            viewer: Viewer::new(graph, config, endpoint),
            control: ControlReceiver::new(graph.manifest_bytes()),
            ranges: Vec::with_capacity(RANGES + 1),
            largest_at: Nanos::ZERO,
            unacked: 0,
            ack_at: Nanos::MAX,
            sent: Vec::with_capacity(graph.packets().len() / 2),
            sent_ranges: Vec::with_capacity(graph.packets().len() / 2),
        }
    }

    pub(super) fn viewer(&mut self) -> &mut Viewer<'a> {
        &mut self.viewer
    }

    pub(super) fn into_viewer(self) -> Viewer<'a> {
        self.viewer
    }

    pub(super) fn is_over(&self) -> bool {
        self.viewer.playout().is_over()
    }

    pub(super) fn next_time(&self) -> Nanos {
        self.viewer.playout().next_time().min(self.ack_at)
    }

    pub(super) fn receive(&mut self, number: u64, content: Content, now: Nanos) {
        // Delay is reported for the largest number, whether or not a gap lies before it (RFC 9000, 13.2.5).
        if self.ranges.last().is_none_or(|(_, largest)| number > *largest) {
            self.largest_at = now;
        }
        let in_order = self.enter_number(number);
        self.unacked += 1;
        let due = self.unacked >= self.config.ack_every || !in_order;
        self.ack_at = if due { now } else { self.ack_at.min(now + self.config.max_ack_delay) };
        match content {
            Content::Media(packet) => self.viewer.media(packet, now),
            Content::Control(chunk) => {
                if let Some((bytes, complete)) = self.control.on_chunk(chunk) {
                    self.viewer.control(bytes, complete);
                }
            }
            Content::Ping => {}
        }
    }

    /// Starts playout if the threshold is reached or the wait is over.
    pub(super) fn start_if_ready(&mut self, now: Nanos) {
        if self.viewer.start_if_ready(now) {
            // The sender needs the playout time now.
            self.ack_at = now;
        }
    }

    /// Feedback that leaves at `now`.
    pub(super) fn poll(&mut self, now: Nanos) -> Option<Datagram> {
        if self.ack_at > now {
            return None;
        }
        self.ack_at = Nanos::MAX;
        self.unacked = 0;
        let first_range = self.sent_ranges.len() as u32;
        let oldest = self.ranges.last().map_or(0, |(_, last)| last.saturating_sub(REACH));
        let recent = self.ranges.iter().rev().take_while(|(_, last)| *last >= oldest);
        self.sent_ranges.extend(recent.take(RANGES / 2));
        let (receipt_bytes, reported) = self.viewer.receipt_and_news();
        let ranges = (first_range, self.sent_ranges.len() as u32);
        let range_bytes = 4 * (ranges.1 - ranges.0);
        self.sent.push(Sent { ranges, reported, ack_delay: now - self.largest_at });
        Some(Datagram {
            tag: self.sent.len() as u64 - 1,
            bytes: ACK_BYTES + range_bytes + receipt_bytes + IP_UDP_BYTES,
        })
    }

    /// What the datagram `tag` carries: the transport's acknowledgement, and what its receipt reports.
    pub(super) fn feedback(&self, tag: u64) -> (Acknowledgement<'_>, Reported) {
        let sent = self.sent[tag as usize];
        let ranges = &self.sent_ranges[sent.ranges.0 as usize..sent.ranges.1 as usize];
        (Acknowledgement { ranges, ack_delay: sent.ack_delay }, sent.reported)
    }

    /// What the news of receipts are.
    pub(super) fn news(&self) -> &DeliveryLog {
        self.viewer.news()
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
        client.receive(0, Content::Ping, Nanos::from_ms(1));
        // Number 1 is missing when 2 arrives: the receipt leaves at once, and 2 waited for nothing.
        client.receive(2, Content::Ping, Nanos::from_ms(20));
        let sent = client.poll(Nanos::from_ms(20)).unwrap();
        assert_eq!(client.feedback(sent.tag).0.ack_delay, Nanos::ZERO);
        // Number 1 comes late: the delay is still that of number 2.
        client.receive(1, Content::Ping, Nanos::from_ms(23));
        let sent = client.poll(Nanos::from_ms(23)).unwrap();
        assert_eq!(client.feedback(sent.tag).0.ack_delay, Nanos::from_ms(3));
    }

    #[test]
    fn rfc9000_26_a_datagram_by_itself_is_acknowledged_within_25_ms_and_the_second_at_once() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let mut config = SessionConfig::default();
        for (ack_every, next_at) in [(2, None), (10, Some(Nanos::from_ms(20)))] {
            config.ack_every = ack_every;
            let mut endpoint = GraphReceiver::new(&graph, 16);
            let mut client = Client::new(&graph, &config, &mut endpoint);
            client.receive(0, Content::Ping, Nanos::from_ms(1));
            // Where more than two are waited for, another that comes meanwhile does not put it off.
            next_at.into_iter().for_each(|at| client.receive(1, Content::Ping, at));
            let due = Nanos::from_ms(1 + 25);
            assert_eq!((client.next_time(), client.poll(due - Nanos(1))), (due, None));
            let sent = client.poll(due).unwrap();
            let waited = due - next_at.unwrap_or(Nanos::from_ms(1));
            assert_eq!(client.feedback(sent.tag).0.ack_delay, waited);
            // It is acknowledged once: what is due next is playout.
            assert_eq!((client.next_time(), client.poll(due)), (config.startup.max_wait, None));
        }
        config.ack_every = 2;
        let mut endpoint = GraphReceiver::new(&graph, 16);
        let mut client = Client::new(&graph, &config, &mut endpoint);
        for number in 0..2 {
            assert_eq!(client.poll(Nanos::from_ms(1)), None);
            client.receive(number, Content::Ping, Nanos::from_ms(1));
        }
        assert!(client.poll(Nanos::from_ms(1)).is_some());
    }

    #[test]
    fn rfc9002_23_acknowledgements_are_not_paced() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let config = SessionConfig::default();
        let mut endpoint = GraphReceiver::new(&graph, 16);
        let mut client = Client::new(&graph, &config, &mut endpoint);
        let now = Nanos::from_ms(1);
        // Every second number is missing: each that comes is acknowledged in the instant in which it does.
        for number in (1..2000).step_by(2) {
            client.receive(number, Content::Ping, now);
            assert!(client.poll(now).is_some(), "{number}");
        }
    }
}
