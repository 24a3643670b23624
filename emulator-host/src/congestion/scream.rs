//! Sets the window by SCReAMv2 (RFC 8298bis), for media that has only so much to send, in integers.
//!
//! The window follows the delay that the own queue adds. It shrinks while the average queue delay exceeds
//! half of a target, the more the nearer it comes to the target (by half in a round trip there), and by three
//! tenths at a loss; it grows by a datagram per round trip, faster the longer nothing was congested, and
//! never far beyond what is really in flight: a source that sends little learns nothing of the path.
//!
//! Where it differs from the text (draft-ietf-ccwg-rfc8298bis-screamv2-01):
//! - queue delay is that of the round trip less its smallest value in ten minutes, because receipts carry no
//!   times of arrival;
//! - it begins with the initial window of RFC 9002 and grows by what is acknowledged until the queue delay
//!   first passes half the target, or a loss; its least window is that of RFC 9002, too;
//! - losses take effect once per recovery period of RFC 9002;
//! - the window does not grow while the average queue delay exceeds half the target; that delay holds back
//!   growth by the window's own share as a loss does; and the average falls to a shorter delay at once;
//! - a window that was not filled for a hundred round trips shrinks then, not at the next congestion;
//! - ECN, and what the text has optionally against jitter, are not modelled.

use std::collections::VecDeque;

use super::{Acked, Controller, DeliverySample, Rtt, initial_window, minimum_window};
use crate::clock::{Bytes, Nanos, Rate};

/// Least and largest target of the queue delay.
const TARGET_LOW: Nanos = Nanos::from_ms(60);
const TARGET_HIGH: Nanos = Nanos::from_ms(400);
/// Reactions to delay are no closer than this, or a round trip if that is shorter; over shorter round trips
/// the window grows as slowly as over this one.
const VIRTUAL_RTT: Nanos = Nanos::from_ms(25);
/// What a loss leaves of the window.
const BETA_LOSS: (u64, u64) = (7, 10);
/// What may be in flight beyond the window, so that a frame leaves at once; and how fast.
const OVERHEAD: (u64, u64) = (3, 2);
/// The window grows up to so many times what was in flight.
const HEADROOM: (u64, u64) = (3, 2);
/// Round trips after a congestion until the window grows by its own share.
const CALM_ROUNDS: u64 = 100;
/// The share of the window by which it then grows per round trip, as 1/50.
const MULTIPLICATIVE: u64 = 50;
/// Round trips over which other flows are looked for: of so many the delay varies, and of the newest the mean
/// is taken.
const HISTORY: usize = 200;
const HISTORY_OF_MEAN: usize = 50;
/// The smallest round trip is taken over so many spans of a minute.
const BASE_SPANS: usize = 10;
const BASE_SPAN: Nanos = Nanos::from_s(60);
/// Fractions are counted in so many parts.
const PARTS: u64 = 1024;

/// The controller.
#[derive(Clone, Debug)]
pub struct Scream {
    datagram: u64,
    /// Reference window in parts of a byte.
    reference: u64,
    /// Reference window at the last congestion before which it had grown; bytes.
    inflexion: u64,
    has_grown: bool,
    target: Nanos,
    base: BaseDelay,
    delay: Nanos,
    average_delay: Nanos,
    averaged_at: Nanos,
    reacted_at: Nanos,
    congested_at: Nanos,
    recovery_start: Option<Nanos>,
    starting: bool,
    acked: u64,
    /// Most bytes in flight in this round trip and in the one before.
    most_in_flight: [u64; 2],
    round_end: Nanos,
    round_lost: bool,
    others: OtherFlows,
}

impl Scream {
    /// Initial window; no delay is known.
    pub fn new(datagram_bytes: u64) -> Self {
        Self {
            datagram: datagram_bytes,
            reference: initial_window(datagram_bytes) * PARTS,
            inflexion: 1,
            has_grown: true,
            target: TARGET_LOW,
            base: BaseDelay::default(),
            delay: Nanos::ZERO,
            average_delay: Nanos::ZERO,
            averaged_at: Nanos::ZERO,
            reacted_at: Nanos::ZERO,
            congested_at: Nanos::ZERO,
            recovery_start: None,
            starting: true,
            acked: 0,
            most_in_flight: [0; 2],
            round_end: Nanos::ZERO,
            round_lost: false,
            others: OtherFlows::default(),
        }
    }

    /// Target of the queue delay.
    pub fn target(&self) -> Nanos {
        self.target
    }

    fn reference(&self) -> u64 {
        self.reference / PARTS
    }

    fn reduce_to(&mut self, parts: u64) {
        self.reference = parts.max(minimum_window(self.datagram) * PARTS);
    }

    /// Slow attack, quick decay; no more often than round trips, or virtual ones, follow each other.
    fn average(&mut self, rtt: &Rtt, now: Nanos) {
        let latest = rtt.without_ack_delay();
        self.delay = latest - self.base.take(latest, now);
        if self.delay < self.average_delay {
            self.average_delay = self.delay;
        } else if now >= self.averaged_at + VIRTUAL_RTT.min(rtt.smoothed()) {
            self.average_delay = Nanos((3 * self.average_delay.0 + self.delay.0) / 4);
            self.averaged_at = now;
        }
    }

    /// How far the average delay is between half the target (0) and the target ([`PARTS`]).
    fn pressure(&self) -> u64 {
        let half = self.target.0 / 2;
        ((self.average_delay.0.saturating_sub(half)) * PARTS / half.max(1)).min(PARTS)
    }

    /// The queue is too long: by up to a half per round trip, in portions of virtual round trips.
    fn back_off(&mut self, pressure: u64, rtt: &Rtt, now: Nanos) {
        if now < self.reacted_at + VIRTUAL_RTT.min(rtt.smoothed()) {
            return;
        }
        self.reacted_at = now;
        self.on_congested(now);
        let whole = self.reference / 2 / PARTS * pressure;
        let portion =
            u128::from(whole) * u128::from(VIRTUAL_RTT.0) / u128::from(rtt.smoothed().max(VIRTUAL_RTT).0);
        self.reduce_to(self.reference - u64::try_from(portion).unwrap_or(0));
    }

    fn on_congested(&mut self, now: Nanos) {
        self.starting = false;
        self.congested_at = now;
        if std::mem::take(&mut self.has_grown) {
            self.inflexion = self.reference().max(1);
        }
    }

    /// How far the window is from that of the last congestion: from a tenth near it to all ([`PARTS`]) an
    /// eighth away.
    fn distance(&self) -> u64 {
        let apart = self.reference().abs_diff(self.inflexion) * 8 * PARTS / self.inflexion;
        (apart.min(PARTS).pow(2) / PARTS).max(PARTS / 10)
    }

    /// The queue grows: what was added in the last round trip was too much. The average would tell a round
    /// trip or two later, each of which doubles the window.
    fn end_start(&mut self, now: Nanos) {
        self.on_congested(now);
        self.reacted_at = now;
        self.reduce_to(self.reference / 2);
    }

    fn grow(&mut self, acked: u64, rtt: &Rtt, now: Nanos) {
        let [this, last] = self.most_in_flight;
        let most = self.datagram + this.max(last) * HEADROOM.0 / HEADROOM.1;
        if self.reference() > most {
            return;
        }
        if self.starting {
            self.reference += acked * PARTS;
            return;
        }
        // A datagram per window acknowledged.
        let window = self.reference().max(1);
        let additive = self.datagram * acked / window * PARTS;
        let additive = additive + self.datagram * acked % window * PARTS / window;
        // The longer nothing was congested, the more by the window's own share.
        let distance = self.distance();
        let share = u128::from((now - self.congested_at).0) * u128::from(PARTS) / u128::from(calm(rtt).0);
        let share = u64::try_from(share).unwrap_or(PARTS).min(PARTS);
        let own = acked * share / MULTIPLICATIVE * distance / PARTS;
        // Less near the window of the last congestion, and over short round trips.
        let slowed = u128::from((additive + own) * distance.max(PARTS / 4) / PARTS);
        let slowed = slowed * u128::from(rtt.smoothed().min(VIRTUAL_RTT).0) / u128::from(VIRTUAL_RTT.0);
        self.reference += u64::try_from(slowed).unwrap_or(0);
        self.has_grown |= slowed > 0;
    }

    fn end_round(&mut self, rtt: &Rtt, now: Nanos) {
        let [this, last] = self.most_in_flight;
        let most = (self.datagram + this.max(last) * HEADROOM.0 / HEADROOM.1) * PARTS;
        // What was never filled for long is no measure of the path any more.
        if now >= self.congested_at + calm(rtt) && self.reference > most {
            self.reduce_to(most.max(initial_window(self.datagram) * PARTS));
        }
        self.most_in_flight = [0, this];
        self.others.take(self.delay, std::mem::take(&mut self.round_lost));
        self.target = self.others.target(self.target);
        self.round_end = now + rtt.smoothed();
    }

    fn in_recovery(&self, sent_at: Nanos) -> bool {
        self.recovery_start.is_some_and(|start| sent_at <= start)
    }
}

impl Controller for Scream {
    fn name(&self) -> &'static str {
        "scream"
    }

    fn on_ack(&mut self, acked: Acked, _rtt: &Rtt, _now: Nanos) {
        self.acked += acked.bytes;
    }

    fn on_ack_end(&mut self, _sample: Option<DeliverySample>, in_flight: u64, rtt: &Rtt, now: Nanos) {
        let acked = std::mem::take(&mut self.acked);
        self.most_in_flight[0] = self.most_in_flight[0].max(in_flight + acked);
        if rtt.first_sample_at().is_some() {
            self.average(rtt, now);
        }
        if self.starting && self.delay > Nanos(self.target.0 / 2) {
            self.end_start(now);
        }
        match self.pressure() {
            0 => self.grow(acked, rtt, now),
            pressure => self.back_off(pressure, rtt, now),
        }
        if now >= self.round_end {
            self.end_round(rtt, now);
        }
    }

    fn on_congestion(&mut self, sent_at: Nanos, _lost_bytes: u64, _in_flight: u64, now: Nanos) -> bool {
        self.round_lost = true;
        if self.in_recovery(sent_at) {
            return false;
        }
        self.recovery_start = Some(now);
        self.on_congested(now);
        self.reacted_at = now;
        self.reduce_to(self.reference / BETA_LOSS.1 * BETA_LOSS.0);
        true
    }

    fn on_persistent_congestion(&mut self) {
        self.reduce_to(0);
        self.recovery_start = None;
    }

    fn window(&self) -> u64 {
        if self.starting { self.reference() } else { self.reference() * OVERHEAD.0 / OVERHEAD.1 }
    }

    fn pacing_rate(&self, rtt: &Rtt) -> Rate {
        let factor = if self.starting { (2, 1) } else { OVERHEAD };
        Rate::over(Bytes(self.reference()), rtt.smoothed()).scaled(factor.0, factor.1)
    }

    fn is_probing(&self) -> bool {
        self.starting
    }
}

/// How long after a congestion the window grows by its own share.
fn calm(rtt: &Rtt) -> Nanos {
    rtt.smoothed().max(VIRTUAL_RTT).times(CALM_ROUNDS)
}

/// The smallest round trip of the last ten minutes.
#[derive(Clone, Debug, Default)]
struct BaseDelay {
    /// Start of each span and its minimum, oldest first.
    spans: VecDeque<(Nanos, Nanos)>,
}

impl BaseDelay {
    /// Takes a round trip; the smallest.
    fn take(&mut self, latest: Nanos, now: Nanos) -> Nanos {
        match self.spans.back_mut() {
            Some((start, least)) if now < *start + BASE_SPAN => *least = latest.min(*least),
            _ => self.spans.push_back((now, latest)),
        }
        if self.spans.len() > BASE_SPANS {
            self.spans.pop_front();
        }
        self.spans.iter().map(|(_, least)| *least).min().unwrap_or(latest)
    }
}

/// What tells of flows that keep the queue long: the target follows them (RFC 8298, 4.1.2.2).
#[derive(Clone, Debug, Default)]
struct OtherFlows {
    /// Queue delay over the least target, in parts, and whether the round trip had a loss.
    rounds: VecDeque<(u64, bool)>,
}

impl OtherFlows {
    fn take(&mut self, delay: Nanos, lost: bool) {
        // A delay of minutes says no more than one of the largest target.
        let parts = delay.min(TARGET_HIGH.times(4)).0 * PARTS / TARGET_LOW.0;
        self.rounds.push_back((parts, lost));
        if self.rounds.len() > HISTORY {
            self.rounds.pop_front();
        }
    }

    /// The target after `before`.
    fn target(&self, before: Nanos) -> Nanos {
        let count = self.rounds.len() as u64;
        if count < HISTORY as u64 / 10 {
            return before;
        }
        let newest = self.rounds.iter().rev().take(HISTORY_OF_MEAN).map(|(parts, _)| parts);
        let newest = newest.sum::<u64>() / count.min(HISTORY_OF_MEAN as u64);
        let mean = self.rounds.iter().map(|(parts, _)| parts).sum::<u64>() / count;
        let squares = self.rounds.iter().map(|(parts, _)| parts.abs_diff(mean).pow(2)).sum::<u64>();
        let variance = squares / count;
        let wanted = Nanos((newest + variance.isqrt()) * (TARGET_LOW.0 / PARTS));
        // More than two round trips in a thousand with a loss.
        let losses = self.rounds.iter().filter(|(_, lost)| *lost).count() as u64;
        let target = if losses * 500 > count {
            Nanos(wanted.0 * 3 / 2)
        } else if variance < PARTS * PARTS / 5 {
            wanted
        } else if wanted < TARGET_LOW {
            Nanos(before.0 / 2).max(wanted)
        } else {
            Nanos(before.0 / 10 * 9)
        };
        target.clamp(TARGET_LOW, TARGET_HIGH)
    }
}

#[cfg(test)]
mod tests;
