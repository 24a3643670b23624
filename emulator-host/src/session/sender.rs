//! Sends over the modelled transport: numbers, recovery, pacing, control chunks, the own serialiser.

use super::{
    IP_UDP_BYTES, QUIC_OVERHEAD_BYTES, SessionConfig,
    control::ControlSender,
    datagram::{Acknowledgement, Content},
    delivery_log::{DeliveryLog, LogReader},
    feedback::Reported,
    media_sender::MediaSender,
    view_state::PathFacts,
};
use crate::{
    clock::{Bytes, Nanos},
    congestion::{AckOutcome, Recovery, TimerOutcome},
    graph::PacketGraph,
    link::Datagram,
    policy::Scheduler,
    report::{SenderCounts, SenderRow},
};

pub(super) struct Sender<'a> {
    config: &'a SessionConfig,
    graph: &'a PacketGraph,
    heard: LogReader,
    media: MediaSender<&'a PacketGraph, &'a mut dyn Scheduler>,
    recovery: Recovery,
    control: ControlSender,
    contents: Vec<Content>,
    datagram_bytes: u64,
    serialising: Option<(Content, u32, Nanos)>,
    pace_at: Nanos,
    /// Before this time the path is full, unless something is learnt.
    full_until: Nanos,
    dirty: bool,
    outcome: AckOutcome,
    counts: SenderCounts,
}

impl<'a> Sender<'a> {
    pub(super) fn new(
        graph: &'a PacketGraph,
        config: &'a SessionConfig,
        scheduler: &'a mut dyn Scheduler,
    ) -> Self {
        let datagram_bytes = widest_datagram(graph);
        let controller = config.controller.build(datagram_bytes);
        let mut recovery = Recovery::new(controller, datagram_bytes, config.max_ack_delay);
        if let Some(round_trip) = config.handshake_rtt {
            recovery.on_handshake(round_trip, Nanos::ZERO);
        }
        let path = facts(&recovery, datagram_bytes, Nanos::ZERO);
        Self {
            config,
            graph,
            heard: LogReader::default(),
            media: MediaSender::new(graph, scheduler, config.sending(), path, Nanos::ZERO),
            control: ControlSender::new(graph.manifest_bytes()),
            contents: Vec::with_capacity(graph.packets().len()),
            datagram_bytes,
            serialising: None,
            pace_at: Nanos::MAX,
            full_until: Nanos::ZERO,
            dirty: true,
            outcome: AckOutcome::default(),
            counts: SenderCounts::default(),
            recovery,
        }
    }

    pub(super) fn media(&self) -> &MediaSender<&'a PacketGraph, &'a mut dyn Scheduler> {
        &self.media
    }

    pub(super) fn controller(&self) -> &'static str {
        self.recovery.controller().name()
    }

    pub(super) fn counts(&self) -> SenderCounts {
        self.counts.plus(self.media.counts())
    }

    pub(super) fn content(&self, number: u64) -> Content {
        self.contents[number as usize]
    }

    pub(super) fn row(&self, now: Nanos) -> SenderRow {
        SenderRow {
            time_ns: now,
            window_bytes: self.recovery.controller().window(),
            in_flight_bytes: self.recovery.in_flight(),
            smoothed_rtt_ns: self.recovery.rtt().smoothed(),
            rate_bps: self.media.path().rate.0,
        }
    }

    pub(super) fn is_dirty(&self) -> bool {
        self.dirty
    }

    /// When the pacer, or the own serialiser, lets the next datagram out; [`Nanos::MAX`]: not before
    /// something is learnt.
    pub(super) fn next_send(&self) -> Nanos {
        self.pace_at.min(self.serialising.map_or(Nanos::MAX, |(_, _, at)| at))
    }

    /// When [`Self::on_timer`] is due.
    pub(super) fn timer(&self) -> Nanos {
        self.recovery.timer()
    }

    /// When [`Self::advance`] brings more of the clip within the horizon.
    pub(super) fn horizon_moves_at(&self) -> Nanos {
        self.media.horizon_moves_at()
    }

    /// A datagram of feedback has arrived: the transport's acknowledgement, and a receipt that reports some
    /// of `news`.
    pub(super) fn on_feedback(
        &mut self,
        ack: Acknowledgement<'_>,
        reported: Reported,
        news: &DeliveryLog,
        now: Nanos,
    ) {
        let mut outcome = std::mem::take(&mut self.outcome);
        outcome.clear();
        self.recovery.on_ack(ack.ranges, ack.ack_delay, now, &mut outcome);
        self.settle(&outcome, now);
        self.outcome = outcome;
        let media = &mut self.media;
        self.heard.hear(reported, news, self.graph, |packet| media.on_acked(packet));
        media.on_playout(reported.playout_start());
        reported.pose.into_iter().for_each(|said| media.on_pose(said));
        self.media.look(facts(&self.recovery, self.datagram_bytes, now), now);
        self.dirty = true;
    }

    pub(super) fn on_timer(&mut self, now: Nanos) {
        if self.recovery.timer() > now {
            return;
        }
        let mut outcome = std::mem::take(&mut self.outcome);
        outcome.clear();
        match self.recovery.on_timer(now, &mut outcome) {
            TimerOutcome::NotDue => {}
            TimerOutcome::Loss => {
                self.settle(&outcome, now);
                self.media.look(facts(&self.recovery, self.datagram_bytes, now), now);
                self.dirty = true;
            }
            TimerOutcome::Probe => {
                self.counts.probe_timeouts += 1;
                self.dirty = true;
            }
        }
        self.outcome = outcome;
    }

    /// Time has come to `now`: more of the clip may be within the horizon.
    pub(super) fn advance(&mut self, now: Nanos) {
        self.media.advance(now);
    }

    /// The next datagram that leaves at `now`.
    pub(super) fn poll(&mut self, now: Nanos) -> Option<Datagram> {
        loop {
            let has_learnt = std::mem::take(&mut self.dirty);
            if let Some((content, bytes, at)) = self.serialising {
                if at > now {
                    return None;
                }
                self.serialising = None;
                return Some(self.leave(content, bytes, now));
            }
            if !has_learnt && now < self.full_until {
                // The pacer counts whole bytes whenever it is asked: how often that is is part of the run.
                self.recovery.pacing_ready_at(self.datagram_bytes, now);
                return None;
            }
            self.full_until = Nanos::ZERO;
            let probe = self.recovery.probes_owed() > 0;
            self.pace_at = Nanos::MAX;
            if !probe && !self.may_send(now) {
                return None;
            }
            if !probe
                && !self.control.has_pending()
                && let Some(until) = self.media.full_until(now)
            {
                (self.pace_at, self.full_until) = (until, until);
                self.recovery.on_path_filled();
                return None;
            }
            let Some((content, media_bytes)) = self.pick(probe, now) else {
                self.recovery.on_app_limited();
                return None;
            };
            let bytes = media_bytes + QUIC_OVERHEAD_BYTES;
            match self.config.access_rate {
                None => return Some(self.leave(content, bytes, now)),
                Some(rate) => {
                    let span = rate.time_for(Bytes(u64::from(bytes + IP_UDP_BYTES)));
                    self.serialising = Some((content, bytes, now + span));
                }
            }
        }
    }

    fn may_send(&mut self, now: Nanos) -> bool {
        if !self.recovery.window_allows(self.datagram_bytes) {
            self.recovery.on_window_limited();
            return false;
        }
        let ready = self.recovery.pacing_ready_at(self.datagram_bytes, now);
        if ready > now {
            self.pace_at = ready;
        }
        ready <= now
    }

    /// The datagram is through the sender's own serialiser: from here on it is in flight and its timers run.
    fn leave(&mut self, content: Content, bytes: u32, now: Nanos) -> Datagram {
        let number = self.recovery.on_sent(bytes, true, now);
        self.contents.push(content);
        self.counts.datagrams += 1;
        if let Content::Media(packet) = content {
            self.media.on_sent(packet, number, now);
        }
        self.media.on_datagram_sent(self.recovery.in_flight(), now);
        Datagram { tag: number, bytes: bytes + IP_UDP_BYTES }
    }

    /// Control first, then media, then a ping if a probe is owed.
    fn pick(&mut self, probe: bool, now: Nanos) -> Option<(Content, u32)> {
        if let Some(chunk) = self.control.next(probe) {
            self.counts.control += 1;
            return Some((Content::Control(chunk), self.control.bytes(chunk)));
        }
        if let Some(packet) = self.media.next(now) {
            let bytes = self.media.graph().wire_bytes(packet);
            return Some((Content::Media(packet), u32::from(bytes)));
        }
        self.counts.pings += u64::from(probe);
        probe.then_some((Content::Ping, 1))
    }

    fn settle(&mut self, outcome: &AckOutcome, now: Nanos) {
        self.counts.spurious += outcome.spurious.len() as u64;
        self.media.on_acks_and_losses(outcome.acked.len(), outcome.lost.len(), now);
        outcome.acked.iter().for_each(|number| self.media.on_fate(*number, false, now));
        outcome.lost.iter().for_each(|number| self.media.on_fate(*number, true, now));
        for number in outcome.acked.iter().chain(&outcome.spurious) {
            match self.content(*number) {
                Content::Media(packet) => self.media.on_acked(packet),
                Content::Control(chunk) => self.control.on_acked(chunk),
                Content::Ping => {}
            }
        }
        for number in &outcome.lost {
            self.counts.lost += 1;
            match self.content(*number) {
                Content::Media(packet) => self.media.on_lost(packet, *number, now),
                Content::Control(chunk) => self.control.on_lost(chunk),
                Content::Ping => {}
            }
        }
    }
}

/// UDP payload of the widest packet of `graph`, at least the 1200 bytes that every path carries.
fn widest_datagram(graph: &PacketGraph) -> u64 {
    let widest = graph.packets().iter().map(|packet| u64::from(packet.wire_bytes)).max().unwrap_or(0);
    (widest + u64::from(QUIC_OVERHEAD_BYTES)).max(1200)
}

/// What is known of the path at `now`.
fn facts(recovery: &Recovery, datagram_bytes: u64, now: Nanos) -> PathFacts {
    let rtt = recovery.rtt();
    let expected = PathFacts::expected_round_trip(rtt.smoothed(), rtt.latest());
    PathFacts {
        rate: recovery.rate(expected),
        smoothed_rtt: expected,
        rtt_variation: rtt.variation().min(expected),
        minimum_rtt: rtt.recent().get(),
        minimum_rtt_age: rtt.recent().age(now),
        in_flight: recovery.in_flight(),
        datagram_bytes,
    }
}
