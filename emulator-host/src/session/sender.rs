//! Sends what the scheduler chooses whenever a datagram may leave, and learns from receipts.

use std::collections::VecDeque;

use super::{
    IP_UDP_BYTES, QUIC_OVERHEAD_BYTES, SessionConfig, StartupRule,
    control::ControlSender,
    datagram::{Acknowledgement, Content},
    feedback,
    forecast::Forecasts,
    loss_share::LossShare,
    outlook::Outlook,
};
use crate::{
    clock::{Bytes, Nanos},
    congestion::{AckOutcome, Recovery, TimerOutcome},
    graph::{PacketGraph, PacketIndex},
    link::Datagram,
    policy::{PacketStatus, Scheduler, Service},
    report::{SenderCounts, SenderRow},
};

pub(super) struct Sender<'a> {
    graph: &'a PacketGraph,
    config: &'a SessionConfig,
    scheduler: &'a mut dyn Scheduler,
    recovery: Recovery,
    control: ControlSender,
    status: Vec<PacketStatus>,
    service: Service,
    sent_times: Vec<u8>,
    sent_at: Vec<Nanos>,
    last_number: Vec<u64>,
    contents: Vec<Content>,
    again: VecDeque<PacketIndex>,
    parity: VecDeque<PacketIndex>,
    /// Parity that the scheduler did not want when its set was sent.
    later_parity: Vec<PacketIndex>,
    /// Members of each repair set that were never sent.
    set_waiting: Vec<u32>,
    /// Level-0 bytes of frame 0 that were never sent.
    first_base_bytes: u64,
    outlook: Outlook,
    known_start: Option<Nanos>,
    datagram_bytes: u64,
    serialising: Option<(Content, u32, Nanos)>,
    pace_at: Nanos,
    last_sent_at: Nanos,
    starved: bool,
    dirty: bool,
    outcome: AckOutcome,
    counts: SenderCounts,
    loss: LossShare,
    forecasts: Forecasts,
}

impl<'a> Sender<'a> {
    pub(super) fn new(
        graph: &'a PacketGraph,
        config: &'a SessionConfig,
        scheduler: &'a mut dyn Scheduler,
    ) -> Self {
        let widest = graph.packets().iter().map(|packet| u64::from(packet.wire_bytes)).max().unwrap_or(0);
        let datagram_bytes = (widest + u64::from(QUIC_OVERHEAD_BYTES)).max(1200);
        let controller = config.controller.build(datagram_bytes);
        let recovery = Recovery::new(controller, datagram_bytes, config.max_ack_delay);
        let first = graph.groups().iter().filter(|group| group.level() == 0 && group.first_frame == 0);
        let first_base = first.flat_map(|group| &group.packets);
        let mut sender = Self {
            graph,
            config,
            service: scheduler.service(),
            scheduler,
            control: ControlSender::new(graph.manifest_bytes()),
            status: vec![PacketStatus::Waiting; graph.packets().len()],
            sent_times: vec![0; graph.packets().len()],
            sent_at: vec![Nanos::ZERO; graph.packets().len()],
            last_number: vec![u64::MAX; graph.packets().len()],
            contents: Vec::with_capacity(graph.packets().len()),
            again: VecDeque::new(),
            parity: VecDeque::new(),
            later_parity: Vec::new(),
            set_waiting: graph.repair_sets().iter().map(|set| set.members.len() as u32).collect(),
            first_base_bytes: first_base
                .map(|packet| u64::from(graph.packets()[packet.at()].wire_bytes))
                .sum(),
            outlook: Outlook {
                playout_start: Nanos::ZERO,
                playing: false,
                horizon_frame: 0,
                rate: recovery.rate(),
                smoothed_rtt: recovery.rtt().smoothed(),
                rtt_variation: recovery.rtt().variation(),
                minimum_rtt: Nanos::ZERO,
                loss: 0.0,
                in_flight: 0,
                retransmissions: config.retransmissions,
                startup: config.startup.rule,
            },
            known_start: None,
            datagram_bytes,
            serialising: None,
            pace_at: Nanos::MAX,
            last_sent_at: Nanos::ZERO,
            starved: false,
            dirty: true,
            outcome: AckOutcome::default(),
            counts: SenderCounts::default(),
            loss: LossShare::new(),
            forecasts: Forecasts::default(),
            recovery,
        };
        sender.look(Nanos::ZERO);
        sender
    }

    pub(super) fn policy(&self) -> &'static str {
        self.scheduler.name()
    }

    pub(super) fn controller(&self) -> &'static str {
        self.recovery.controller().name()
    }

    pub(super) fn counts(&self) -> SenderCounts {
        self.counts
    }

    pub(super) fn forecasts(&self) -> &Forecasts {
        &self.forecasts
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
            rate_bps: self.outlook.rate.0,
        }
    }

    pub(super) fn is_dirty(&self) -> bool {
        self.dirty
    }

    pub(super) fn next_time(&self, now: Nanos) -> Nanos {
        if self.dirty {
            return now;
        }
        let serialised = self.serialising.map_or(Nanos::MAX, |(_, _, at)| at);
        self.recovery.timer().min(self.pace_at).min(serialised)
    }

    /// A datagram of feedback has arrived: the transport's acknowledgement and the bytes of a receipt.
    pub(super) fn on_feedback(&mut self, ack: Acknowledgement<'_>, receipt: &[u8], now: Nanos) {
        let mut outcome = std::mem::take(&mut self.outcome);
        outcome.clear();
        self.recovery.on_ack(ack.ranges, ack.ack_delay, now, &mut outcome);
        self.settle(&outcome, now);
        self.outcome = outcome;
        match feedback::read(receipt, self.graph) {
            Ok(feedback) => {
                for packet in feedback.received {
                    self.set_status(packet, PacketStatus::Delivered);
                }
                // Until playout starts, what is worth sending follows from what is known to be there.
                self.starved &= self.known_start.is_some();
                if self.known_start.is_none() && feedback.playout_start.is_some() {
                    self.known_start = feedback.playout_start;
                }
            }
            Err(_) => self.counts.refused_receipts += 1,
        }
        self.look(now);
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
                self.look(now);
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
        let before = self.outlook.horizon_frame;
        self.outlook.horizon_frame = self.horizon(now);
        self.starved &= self.outlook.horizon_frame == before;
    }

    /// The next datagram that leaves at `now`.
    pub(super) fn poll(&mut self, now: Nanos) -> Option<Datagram> {
        loop {
            self.dirty = false;
            if let Some((content, bytes, at)) = self.serialising {
                if at > now {
                    return None;
                }
                self.serialising = None;
                return Some(self.leave(content, bytes, now));
            }
            let probe = self.recovery.probes_owed() > 0;
            self.pace_at = Nanos::MAX;
            if !probe && !self.may_send(now) {
                return None;
            }
            if !probe && !self.control.has_pending() && self.fills_the_path(now) {
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

    /// Whether another datagram would only lengthen the sender's own queue on the path. Two may always be
    /// out, and one more leaves after every silence of twice the queue: what is in flight may be lost, and
    /// without an acknowledgement of something later nothing but the probe timeout would tell.
    fn fills_the_path(&mut self, now: Nanos) -> bool {
        let Some(own_queue) = self.service.own_queue.filter(|_| self.outlook.minimum_rtt > Nanos::ZERO)
        else {
            return false;
        };
        let in_flight = self.recovery.in_flight();
        if in_flight < 2 * self.datagram_bytes {
            return false;
        }
        let drain = self.outlook.rate.time_for(Bytes(in_flight));
        // A path of many milliseconds needs as many more to be probed for its rate.
        if drain <= self.outlook.minimum_rtt + own_queue.max(self.outlook.minimum_rtt) {
            return false;
        }
        let silence_ends = self.last_sent_at + own_queue.times(2);
        if now < silence_ends {
            self.pace_at = silence_ends;
        }
        now < silence_ends
    }

    /// The datagram is through the sender's own serialiser: from here on it is in flight and its timers run.
    fn leave(&mut self, content: Content, bytes: u32, now: Nanos) -> Datagram {
        let number = self.recovery.on_sent(bytes, true, now);
        self.contents.push(content);
        self.last_sent_at = now;
        self.counts.datagrams += 1;
        if let Content::Media(packet) = content {
            self.last_number[packet.at()] = number;
            self.sent_at[packet.at()] = now;
        }
        self.outlook.in_flight = self.recovery.in_flight();
        Datagram { tag: number, bytes: bytes + IP_UDP_BYTES }
    }

    /// Control first, then what was lost, then parity, then what the scheduler says.
    fn pick(&mut self, probe: bool, now: Nanos) -> Option<(Content, u32)> {
        if let Some(chunk) = self.control.next(probe) {
            self.counts.control += 1;
            return Some((Content::Control(chunk), self.control.bytes(chunk)));
        }
        let view = self.outlook.view(self.graph, &self.status, &self.sent_at);
        let mut packet = None;
        while let Some(lost) = self.again.pop_front() {
            if self.status[lost.at()] != PacketStatus::InFlight {
                continue;
            }
            if view.is_expired(lost, now) {
                self.set_status(lost, PacketStatus::Abandoned);
                return self.pick(probe, now);
            }
            self.counts.retransmitted += 1;
            packet = Some(lost);
            break;
        }
        while packet.is_none()
            && let Some(parity) = self.parity.pop_front()
        {
            if view.is_expired(parity, now) {
                continue;
            }
            if self.scheduler.wants_parity(&view, parity, now) {
                packet = Some(parity);
            } else {
                self.later_parity.push(parity);
            }
        }
        if packet.is_none() && !self.starved {
            packet = self.scheduler.next(&view, now);
            if packet.is_some_and(|packet| {
                !view.is_sendable(packet, now) || self.graph.packets()[packet.at()].parity_of.is_some()
            }) {
                self.counts.refused_choices += 1;
                packet = None;
            }
            if packet.is_none() {
                // With nothing else to send, parity that was not worth its bytes may be, while what it
                // protects is on its way.
                let (graph, status) = (self.graph, &self.status);
                self.later_parity.retain(|parity| {
                    let sets = graph.sets_of(*parity).iter();
                    let mut members = sets.flat_map(|set| &graph.repair_sets()[*set as usize].members);
                    !view.is_expired(*parity, now)
                        && members.any(|member| status[member.at()] == PacketStatus::InFlight)
                });
                let scheduler = &mut self.scheduler;
                let wanted =
                    self.later_parity.iter().position(|parity| scheduler.wants_parity(&view, *parity, now));
                packet = wanted.map(|at| self.later_parity.swap_remove(at));
            }
            self.starved = packet.is_none();
            let parity = packet.is_some_and(|packet| self.graph.packets()[packet.at()].parity_of.is_some());
            let again = packet.is_some_and(|packet| self.sent_times[packet.at()] > 0);
            self.counts.retransmitted += u64::from(again);
            self.counts.media += u64::from(packet.is_some() && !again && !parity);
            if let Some(packet) = packet.filter(|_| !again && !parity)
                && let Some((chance, frame)) = self.scheduler.forecast(&view, packet, now)
            {
                self.forecasts.note(packet, chance, frame);
            }
        }
        match packet {
            Some(packet) => {
                let is_parity = self.graph.packets()[packet.at()].parity_of.is_some();
                self.counts.parity += u64::from(is_parity);
                let first = self.sent_times[packet.at()] == 0;
                self.sent_times[packet.at()] = self.sent_times[packet.at()].saturating_add(1);
                self.set_status(packet, PacketStatus::InFlight);
                if first {
                    self.first_send(packet);
                }
                Some((Content::Media(packet), u32::from(self.graph.packets()[packet.at()].wire_bytes)))
            }
            None if probe => {
                self.counts.pings += 1;
                Some((Content::Ping, 1))
            }
            None => None,
        }
    }

    fn first_send(&mut self, packet: PacketIndex) {
        let facts = &self.graph.packets()[packet.at()];
        let groups = self.graph.groups();
        if facts.groups.iter().any(|g| groups[g.at()].level() == 0 && groups[g.at()].first_frame == 0) {
            self.first_base_bytes = self.first_base_bytes.saturating_sub(u64::from(facts.wire_bytes));
        }
        if facts.parity_of.is_some() {
            return;
        }
        for set in self.graph.sets_of(packet) {
            self.set_waiting[*set as usize] -= 1;
            if self.set_waiting[*set as usize] == 0 {
                self.parity.extend(self.graph.parity(*set));
            }
        }
    }

    fn settle(&mut self, outcome: &AckOutcome, now: Nanos) {
        self.counts.spurious += outcome.spurious.len() as u64;
        self.loss.settle(outcome.acked.len(), outcome.lost.len(), now);
        for number in outcome.acked.iter().chain(&outcome.spurious) {
            match self.content(*number) {
                Content::Media(packet) => self.set_status(packet, PacketStatus::Delivered),
                Content::Control(chunk) => self.control.on_acked(chunk),
                Content::Ping => {}
            }
        }
        for number in &outcome.lost {
            self.counts.lost += 1;
            match self.content(*number) {
                Content::Media(packet) => self.on_media_lost(packet, *number, now),
                Content::Control(chunk) => self.control.on_lost(chunk),
                Content::Ping => {}
            }
        }
    }

    fn on_media_lost(&mut self, packet: PacketIndex, number: u64, now: Nanos) {
        if self.status[packet.at()] != PacketStatus::InFlight || self.last_number[packet.at()] != number {
            return;
        }
        let view = self.outlook.view(self.graph, &self.status, &self.sent_at);
        if self.service.lost_compete && self.graph.packets()[packet.at()].parity_of.is_none() {
            let expired = view.is_expired(packet, now);
            self.set_status(packet, if expired { PacketStatus::Abandoned } else { PacketStatus::Waiting });
            self.starved = false;
            return;
        }
        let budget = u32::from(self.sent_times[packet.at()]) <= self.config.retransmissions;
        let facts = &self.graph.packets()[packet.at()];
        let canonical = facts.groups.iter().any(|g| self.graph.groups()[g.at()].is_canonical());
        let protected = facts.parity_of.is_none()
            && (self.graph.level(packet) < self.config.retransmit_levels
                || (self.config.retransmit_canonical && canonical));
        if budget && protected && !view.is_expired(packet, now) {
            self.again.push_back(packet);
        } else {
            self.set_status(packet, PacketStatus::Abandoned);
        }
    }

    fn set_status(&mut self, packet: PacketIndex, after: PacketStatus) {
        let before = std::mem::replace(&mut self.status[packet.at()], after);
        if before != after {
            self.scheduler.on_status(
                &self.outlook.view(self.graph, &self.status, &self.sent_at),
                packet,
                before,
            );
        }
    }

    /// Renews what the scheduler sees of path and playout. Before playout has started, the sender expects it
    /// to start when the rest of the first base could be there.
    fn look(&mut self, now: Nanos) {
        let rtt = self.recovery.rtt();
        let sampled = rtt.first_sample_at().is_some();
        self.outlook.rate = self.recovery.rate();
        self.outlook.smoothed_rtt = rtt.smoothed();
        self.outlook.rtt_variation = rtt.variation();
        self.outlook.minimum_rtt = if sampled { rtt.minimum() } else { Nanos::ZERO };
        self.outlook.loss = self.loss.share(now);
        self.outlook.in_flight = self.recovery.in_flight();
        self.outlook.playing = self.known_start.is_some();
        self.outlook.playout_start = self.known_start.unwrap_or_else(|| {
            let latest = self.config.startup.max_wait.max(now);
            let base = self.outlook.rate.time_for(Bytes(self.first_base_bytes));
            match self.config.startup.rule {
                StartupRule::AfterWait => latest,
                _ => (now + rtt.smoothed() + base).min(latest),
            }
        });
        self.outlook.horizon_frame = self.horizon(now);
    }

    fn horizon(&self, now: Nanos) -> u32 {
        let played = self.known_start.map_or(Nanos::ZERO, |start| now - start);
        let frames = (played + self.config.lookahead).0 / self.graph.frame_interval().0 + 1;
        u32::try_from(frames).unwrap_or(u32::MAX)
    }
}
