//! Tracks what was sent and what became of it: acknowledgement, loss detection, probes, bytes in flight (RFC
//! 9002, 6 and A).
//!
//! Packets enter when the sender's own serialiser is through with them, so loss timers start then (paper,
//! "Congestion control and pacing"). Packet numbers count up from 0 without gaps.

use std::collections::VecDeque;

use super::{Acked, Controller, DeliveryRate, DeliverySample, Pacer, Rtt, rtt::GRANULARITY};
use crate::clock::{Bytes, Nanos, Rate};

/// Reordering threshold in packets (RFC 9002, 6.1.1).
const PACKET_THRESHOLD: u64 = 3;
/// Persistent congestion threshold in probe timeouts (RFC 9002, 7.6.1).
const PERSISTENT_THRESHOLD: u64 = 3;
/// Probes per probe timeout; RFC 9002, 6.2.4 allows one or two.
const PROBES: u32 = 2;

/// What is remembered about a packet.
#[derive(Clone, Copy, Debug)]
pub struct Sent {
    /// When it left.
    pub at: Nanos,
    /// UDP payload bytes.
    pub bytes: u32,
    /// Whether it must be acknowledged, and counts in flight.
    pub eliciting: bool,
    app_limited: bool,
    source_limited: bool,
    state: State,
    delivered: u64,
    delivered_at: Nanos,
    first_sent_at: Nanos,
}

#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum State {
    Outstanding,
    Acked,
    Lost,
}

/// Packet numbers whose fate became known.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct AckOutcome {
    /// Newly acknowledged.
    pub acked: Vec<u64>,
    /// Newly declared lost.
    pub lost: Vec<u64>,
    /// Declared lost before, acknowledged now: the loss was spurious. They left flight when they were
    /// declared lost.
    pub spurious: Vec<u64>,
}

impl AckOutcome {
    /// Empties all lists.
    pub fn clear(&mut self) {
        self.acked.clear();
        self.lost.clear();
        self.spurious.clear();
    }
}

/// What the timer was for.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum TimerOutcome {
    /// Not due.
    NotDue,
    /// Time-threshold losses were declared.
    Loss,
    /// A probe timeout: probes are owed.
    Probe,
}

/// The sender's side of loss recovery.
#[derive(Debug)]
pub struct Recovery {
    sent: VecDeque<Sent>,
    base: u64,
    in_flight: u64,
    eliciting_out: u32,
    largest_acked: Option<u64>,
    rtt: Rtt,
    controller: Box<dyn Controller>,
    pacer: Pacer,
    path: DeliveryRate,
    delivered: u64,
    delivered_at: Nanos,
    first_sent_at: Nanos,
    loss_at: Option<Nanos>,
    last_eliciting: Nanos,
    probe_count: u32,
    probes_owed: u32,
    entry_credit: bool,
    app_limited: bool,
    source_limited: bool,
}

impl Recovery {
    /// Nothing sent. `datagram_bytes` is the largest UDP payload; `max_ack_delay` the peer's promise.
    pub fn new(controller: Box<dyn Controller>, datagram_bytes: u64, max_ack_delay: Nanos) -> Self {
        let rtt = Rtt::new(max_ack_delay);
        let mut pacer = Pacer::new(datagram_bytes);
        pacer.set_rate(controller.pacing_rate(&rtt), Nanos::ZERO);
        Self {
            sent: VecDeque::new(),
            base: 0,
            in_flight: 0,
            eliciting_out: 0,
            largest_acked: None,
            rtt,
            controller,
            pacer,
            path: DeliveryRate::new(),
            delivered: 0,
            delivered_at: Nanos::ZERO,
            first_sent_at: Nanos::ZERO,
            loss_at: None,
            last_eliciting: Nanos::ZERO,
            probe_count: 0,
            probes_owed: 0,
            entry_credit: false,
            app_limited: false,
            source_limited: false,
        }
    }

    /// A handshake that ended at `now` has measured the round trip.
    pub fn on_handshake(&mut self, round_trip: Nanos, now: Nanos) {
        self.rtt.update(round_trip, Nanos::ZERO, now);
        self.pace(now);
    }

    /// Round-trip estimator.
    pub fn rtt(&self) -> &Rtt {
        &self.rtt
    }

    /// Congestion controller.
    pub fn controller(&self) -> &dyn Controller {
        &*self.controller
    }

    /// UDP payload bytes in flight.
    pub fn in_flight(&self) -> u64 {
        self.in_flight
    }

    /// Consecutive probe timeouts without an acknowledgement.
    pub fn probe_count(&self) -> u32 {
        self.probe_count
    }

    /// Probes that may be sent whatever the window says.
    pub fn probes_owed(&self) -> u32 {
        self.probes_owed
    }

    /// Estimated rate of the path, r̂_path; `None` before the first sample.
    pub fn path_rate(&self) -> Option<Rate> {
        self.path.estimate()
    }

    /// min(cwnd/rtt, r̂_path): what a sender can count on whose round trips take `rtt`.
    pub fn rate(&self, rtt: Nanos) -> Rate {
        let window = Rate::over(Bytes(self.controller.window()), rtt);
        self.path_rate().map_or(window, |path| window.min(path))
    }

    /// Whether the window lets `bytes` out. One packet is let out on entry to recovery (RFC 9002, 7.3.2).
    pub fn window_allows(&self, bytes: u64) -> bool {
        self.in_flight + bytes <= self.controller.window() || self.entry_credit
    }

    /// When pacing lets `bytes` out.
    pub fn pacing_ready_at(&mut self, bytes: u64, now: Nanos) -> Nanos {
        self.pacer.ready_at(bytes, now)
    }

    /// The application has nothing to send although the window and the pacer would let it: from here on the
    /// window does not grow until it is filled again (RFC 9002, 7.8). Waiting for the pacer neither sets nor
    /// clears this.
    pub fn on_app_limited(&mut self) {
        self.app_limited = true;
        self.source_limited = true;
    }

    /// The sender holds back because what is in flight already fills the path. The window must not grow, for
    /// it is not filled; but what is acknowledged does measure the path.
    pub fn on_path_filled(&mut self) {
        self.app_limited = true;
        self.source_limited = false;
    }

    /// The window, not the application, holds the sender back.
    pub fn on_window_limited(&mut self) {
        self.source_limited = false;
        self.app_limited = false;
    }

    /// A packet has left at `now`; returns its number.
    pub fn on_sent(&mut self, bytes: u32, eliciting: bool, now: Nanos) -> u64 {
        let number = self.base + self.sent.len() as u64;
        if self.in_flight == 0 {
            self.first_sent_at = now;
            self.delivered_at = now;
        }
        self.sent.push_back(Sent {
            at: now,
            bytes,
            eliciting,
            app_limited: self.app_limited,
            source_limited: self.source_limited,
            state: State::Outstanding,
            delivered: self.delivered,
            delivered_at: self.delivered_at,
            first_sent_at: self.first_sent_at,
        });
        if eliciting {
            if self.probes_owed > 0 {
                self.probes_owed -= 1;
            } else if self.in_flight + u64::from(bytes) > self.controller.window() {
                self.entry_credit = false;
            }
            self.in_flight += u64::from(bytes);
            self.eliciting_out += 1;
            self.last_eliciting = now;
            self.pacer.spend(u64::from(bytes), now);
        }
        number
    }

    /// An acknowledgement of inclusive `ranges`, newest first, held back by the peer for `ack_delay`. One
    /// that names packets never sent is ignored. The order is that of A.7: round trip, losses, then growth of
    /// the window.
    pub fn on_ack(&mut self, ranges: &[(u64, u64)], ack_delay: Nanos, now: Nanos, out: &mut AckOutcome) {
        let next = self.base + self.sent.len() as u64;
        let already = out.acked.len();
        let Some(largest) = ranges.first().map(|(_, last)| *last).filter(|last| *last < next) else { return };
        let largest_is_new = self.get(largest).is_some_and(|sent| sent.state != State::Acked);
        let largest_sent_at = self.get(largest).map(|sent| sent.at);
        let mut newest: Option<Sent> = None;
        let mut any_eliciting = false;
        for (first, last) in ranges {
            for number in (*first).max(self.base)..=(*last).min(next - 1) {
                let Some(sent) = self.ack_one(number, now, out) else { continue };
                any_eliciting |= sent.eliciting;
                if newest.is_none_or(|best| best.at <= sent.at) {
                    newest = Some(sent);
                }
            }
        }
        self.largest_acked = Some(self.largest_acked.map_or(largest, |old| old.max(largest)));
        if newest.is_none() {
            return;
        }
        if largest_is_new
            && any_eliciting
            && let Some(sent_at) = largest_sent_at
        {
            self.rtt.update(now - sent_at, ack_delay, now);
        }
        self.detect_losses(now, out);
        for number in &out.acked[already..] {
            let Some(sent) = self.get(*number).copied().filter(|sent| sent.eliciting) else { continue };
            let acked =
                Acked { bytes: u64::from(sent.bytes), sent_at: sent.at, app_limited: sent.app_limited };
            self.controller.on_ack(acked, &self.rtt, now);
        }
        self.probe_count = 0;
        self.probes_owed = 0;
        let sample = newest.and_then(|sent| self.sample(sent, now));
        if let Some(sample) = sample {
            self.path.take(sample, self.rtt.smoothed().times(10), now);
        }
        self.controller.on_ack_end(sample, self.in_flight, &self.rtt, now);
        self.forget();
        self.pace(now);
    }

    /// When [`Self::on_timer`] is due: the loss timer if set, else the probe timeout while anything is in
    /// flight.
    pub fn timer(&self) -> Nanos {
        if let Some(at) = self.loss_at {
            return at;
        }
        if self.eliciting_out == 0 {
            return Nanos::MAX;
        }
        let backoff = 1u64.checked_shl(self.probe_count.min(40)).unwrap_or(1 << 40);
        self.last_eliciting + self.rtt.probe_timeout().times(backoff)
    }

    /// Handles the timer if it is due.
    pub fn on_timer(&mut self, now: Nanos, out: &mut AckOutcome) -> TimerOutcome {
        if self.timer() > now {
            return TimerOutcome::NotDue;
        }
        if self.loss_at.is_some() {
            self.detect_losses(now, out);
            self.forget();
            self.pace(now);
            return TimerOutcome::Loss;
        }
        self.probe_count += 1;
        self.probes_owed = PROBES;
        TimerOutcome::Probe
    }

    fn get(&self, number: u64) -> Option<&Sent> {
        self.sent.get(usize::try_from(number.checked_sub(self.base)?).ok()?)
    }

    fn ack_one(&mut self, number: u64, now: Nanos, out: &mut AckOutcome) -> Option<Sent> {
        let at = usize::try_from(number.checked_sub(self.base)?).ok()?;
        let sent = self.sent.get_mut(at)?;
        let before = std::mem::replace(&mut sent.state, State::Acked);
        let sent = *sent;
        match before {
            State::Acked => return None,
            State::Lost => out.spurious.push(number),
            State::Outstanding => {
                out.acked.push(number);
                if sent.eliciting {
                    self.in_flight -= u64::from(sent.bytes);
                    self.eliciting_out -= 1;
                }
            }
        }
        self.delivered += u64::from(sent.bytes);
        self.delivered_at = now;
        Some(sent)
    }

    /// RFC 9002, A.10 and B.8. Sets the loss timer for what is not yet late enough.
    fn detect_losses(&mut self, now: Nanos, out: &mut AckOutcome) {
        self.loss_at = None;
        let Some(largest) = self.largest_acked else { return };
        let delay = self.rtt.loss_delay();
        let (mut lost_bytes, mut latest) = (0u64, None::<Nanos>);
        let mut persistent = false;
        let mut run_start: Option<Nanos> = None;
        let duration = self.rtt.probe_timeout().times(PERSISTENT_THRESHOLD);
        let first_sample = self.rtt.first_sample_at();
        for (at, sent) in self.sent.iter_mut().enumerate() {
            let number = self.base + at as u64;
            if number >= largest {
                break;
            }
            match sent.state {
                State::Acked => run_start = None,
                State::Lost => {}
                State::Outstanding if sent.at + delay <= now || largest >= number + PACKET_THRESHOLD => {
                    sent.state = State::Lost;
                    out.lost.push(number);
                    if !sent.eliciting {
                        continue;
                    }
                    self.in_flight -= u64::from(sent.bytes);
                    self.eliciting_out -= 1;
                    lost_bytes += u64::from(sent.bytes);
                    latest = Some(sent.at);
                    if first_sample.is_some_and(|first| sent.at > first) {
                        let start = *run_start.get_or_insert(sent.at);
                        persistent |= sent.at - start > duration;
                    }
                }
                State::Outstanding => {
                    let at = (sent.at + delay).max(now + Nanos(1));
                    self.loss_at = Some(self.loss_at.map_or(at, |earlier| earlier.min(at)));
                }
            }
        }
        if let Some(sent_at) = latest {
            self.entry_credit |= self.controller.on_congestion(sent_at, lost_bytes, self.in_flight, now);
        }
        if persistent {
            self.controller.on_persistent_congestion();
            self.rtt.on_persistent_congestion();
        }
    }

    fn sample(&mut self, sent: Sent, now: Nanos) -> Option<DeliverySample> {
        self.first_sent_at = sent.at;
        let sending = sent.at - sent.first_sent_at;
        let acking = now - sent.delivered_at;
        let span = sending.max(acking);
        if span < self.rtt.minimum().max(GRANULARITY) {
            return None;
        }
        let rate = Rate::over(Bytes(self.delivered - sent.delivered), span);
        Some(DeliverySample { rate, app_limited: sent.source_limited })
    }

    /// r_send = min(r_cwnd, headroom × r̂_path), with [`Controller::headroom`].
    fn pace(&mut self, now: Nanos) {
        let (numerator, denominator) = self.controller.headroom();
        let window = self.controller.pacing_rate(&self.rtt);
        let cap = self.path_rate().map_or(Rate::MAX, |path| path.scaled(numerator, denominator));
        self.pacer.set_rate(window.min(cap), now);
    }

    /// Drops settled packets from the old end. Lost ones are kept for a while, so that a late acknowledgement
    /// is seen to be one: at most 64 behind the largest acknowledged.
    fn forget(&mut self) {
        let keep_from = self.largest_acked.unwrap_or(0).saturating_sub(64);
        while let Some(front) = self.sent.front() {
            let settled = match front.state {
                State::Acked => true,
                State::Lost => self.base < keep_from,
                State::Outstanding => false,
            };
            if !settled {
                return;
            }
            self.sent.pop_front();
            self.base += 1;
        }
    }
}
