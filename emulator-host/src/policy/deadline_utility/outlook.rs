//! Predicts when a packet sent now arrives, and what a piece then still adds.

use super::config::DeadlineUtilityConfig;
use crate::{
    clock::Nanos,
    graph::pieces::{Addition, FrameSums},
    policy::{SenderView, probability::mean_arrival},
};

/// The forecast of one moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Outlook {
    /// Seconds until the first byte sent now arrives.
    first_byte_s: f64,
    /// Seconds per byte after it.
    per_byte_s: f64,
    /// Scale of the error, without that of the sending time.
    spread_s: f64,
    /// When frame 0 is shown, seconds from now; may be negative.
    start_s: f64,
    interval_s: f64,
    /// First frame that is still to come.
    next_frame: u32,
    /// Chance that one datagram is lost.
    pub loss: f64,
    base_weight: f64,
    delay_weight: f64,
    delay_s: f64,
}

/// Bytes that the path spends on a datagram beside the packet.
pub(super) const OVERHEAD_BYTES: u32 = 58;

impl Outlook {
    pub(super) fn new(view: &SenderView<'_>, config: &DeadlineUtilityConfig, now: Nanos) -> Self {
        let back = view.minimum_rtt.as_s() / 2.0;
        // Before the first sample nothing is known but the assumed round trip.
        let sampled = view.minimum_rtt > Nanos::ZERO;
        let (first_byte_s, queue_s) = if config.arrival_from_queue && sampled {
            (
                back + view.queueing().min(Nanos::from_s(60)).as_s(),
                view.queueing().min(Nanos::from_s(60)).as_s(),
            )
        } else {
            (view.smoothed_rtt.as_s() - back, 0.0)
        };
        let interval = view.graph.frame_interval();
        let played = now - view.playout_start;
        let next = if now < view.playout_start { 0 } else { played.0 / interval.0 + 1 };
        Self {
            first_byte_s,
            per_byte_s: 8.0 / (view.rate.0 as f64).max(1.0),
            spread_s: view.rtt_variation.as_s() + 0.25 * queue_s,
            start_s: view.playout_start.as_s() - now.as_s(),
            interval_s: interval.as_s(),
            next_frame: u32::try_from(next).unwrap_or(u32::MAX),
            loss: view.loss,
            base_weight: config.base_weight,
            delay_weight: config.delay_weight,
            delay_s: config.delay.as_s(),
        }
    }

    /// What `parts` are expected to add if `bytes` of theirs are sent from now on, losses aside; and,
    /// weighted, how much less it is after a delay.
    pub(super) fn value(&self, parts: &[Addition], sums: &FrameSums, bytes: u32) -> f64 {
        let (soon, late) = self.soon_and_late(parts, sums, bytes, self.delay_s);
        soon + self.delay_weight * (soon - late)
    }

    /// The score of a value that any delay would cost.
    pub(super) fn urgent(&self, value: f64) -> f64 {
        (1.0 + self.delay_weight) * value
    }

    /// What `parts` are expected to add if sending starts now, and if it starts `delay_s` seconds from now.
    pub(super) fn soon_and_late(
        &self,
        parts: &[Addition],
        sums: &FrameSums,
        bytes: u32,
        delay_s: f64,
    ) -> (f64, f64) {
        let sending = f64::from(bytes) * self.per_byte_s;
        let expected = self.first_byte_s + sending;
        let spread = self.spread_s + 0.5 * sending;
        let (mut soon, mut late) = (0.0, 0.0);
        for part in parts {
            let (utility, base) = sums.gain(part, self.next_frame);
            let gain = utility + self.base_weight * base;
            if gain > 0.0 {
                let first = self.shown_in(part.first.max(self.next_frame)) - expected;
                let last = self.shown_in(part.last) - expected;
                soon += gain * mean_arrival(first, last, 0.0, spread);
                late += gain * mean_arrival(first, last, delay_s, spread);
            }
        }
        (soon, late)
    }

    /// Chance that a packet of `bytes` sent now, and again whenever it is lost and time allows, arrives
    /// before `frame` is shown.
    pub(super) fn chance(&self, bytes: u32, frame: u32, round_trip_s: f64) -> f64 {
        let expected = self.first_byte_s + f64::from(bytes) * self.per_byte_s;
        let deadline = self.shown_in(frame);
        let mut chance = 0.0;
        let mut reached = 1.0;
        for round in 0..4 {
            let late = f64::from(round) * (1.125 * round_trip_s + self.first_byte_s);
            chance += reached
                * (1.0 - self.loss)
                * mean_arrival(deadline, deadline, expected + late, self.spread_s);
            reached *= self.loss;
        }
        chance.min(1.0)
    }

    /// Seconds until `frame` is shown.
    fn shown_in(&self, frame: u32) -> f64 {
        self.start_s + f64::from(frame) * self.interval_s
    }

    /// First frame that is still to come.
    pub(super) fn next_frame(&self) -> u32 {
        self.next_frame
    }
}
