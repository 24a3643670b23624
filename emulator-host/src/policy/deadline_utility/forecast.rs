//! Predicts when a packet sent now arrives, and what a piece then still adds.

use super::config::DeadlineUtilityConfig;
use crate::{
    clock::Nanos,
    graph::{
        PacketGraph,
        pieces::{Contribution, FrameSums},
    },
    policy::{SenderView, probability::mean_arrival},
};

/// The forecast of one moment.
#[derive(Clone, Copy, Debug)]
pub(super) struct Forecast {
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
    /// Probability that one datagram is lost.
    pub loss: f64,
    base_weight: f64,
    delay_weight: f64,
    error_growth: f64,
    frame_share: bool,
    /// Seconds until the next window is half over; `None` if none begins before the horizon.
    wait_s: Option<f64>,
}

/// Windows that begin within this time of each other count as one, seconds.
const SHORTEST_WINDOW_S: f64 = 0.5;

/// Bytes that the path spends on a datagram beside the packet.
pub(super) const OVERHEAD_BYTES: u32 = 58;

impl Forecast {
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
        let forecast = Self {
            first_byte_s,
            per_byte_s: 8.0 / (view.rate.0 as f64).max(1.0),
            spread_s: view.rtt_variation.as_s() + 0.25 * queue_s,
            start_s: view.playout_start.as_s() - now.as_s(),
            interval_s: interval.as_s(),
            next_frame: u32::try_from(next).unwrap_or(u32::MAX),
            loss: view.loss,
            base_weight: config.base_weight,
            delay_weight: config.delay_weight,
            error_growth: config.error_growth,
            frame_share: config.frame_share,
            wait_s: None,
        };
        Self { wait_s: forecast.wait(view.graph, view.horizon_frame), ..forecast }
    }

    /// Seconds until a packet that is sent then arrives in the middle of the next window before `horizon`.
    ///
    /// By waiting for so long, what shows now loses its frames until then, the next window half of its own,
    /// and later windows nothing. Before playout the next window is that of frame 0.
    fn wait(&self, graph: &PacketGraph, horizon: u32) -> Option<f64> {
        let sent_for = |frame: u32| self.shown_in(frame) - self.first_byte_s;
        let starts = graph.starts();
        let near = starts.partition_point(|start| *start < self.next_frame);
        let mut ahead = starts[near..].iter().map(|start| sent_for(*start)).filter(|sent| *sent > 0.0);
        let begin = ahead.next()?;
        let last = sent_for(horizon.min(graph.frames()));
        if begin >= last {
            return None;
        }
        let end = ahead.find(|end| *end >= begin + SHORTEST_WINDOW_S).map_or(last, |end| end.min(last));
        Some(0.5 * (begin + end))
    }

    /// What `parts` are expected to add if `bytes` of theirs are sent from now on, losses aside; and,
    /// weighted, how much less it is once the next window is half over. With none to come, waiting loses all.
    pub(super) fn value(&self, parts: &[Contribution], sums: &FrameSums, bytes: u32) -> f64 {
        match self.wait_s {
            Some(wait) => {
                let (soon, late) = self.soon_and_late(parts, sums, bytes, wait);
                soon + self.delay_weight * (soon - late)
            }
            None => self.urgent(self.soon_and_late(parts, sums, bytes, 0.0).0),
        }
    }

    /// The score of a value that any delay would cost.
    pub(super) fn urgent(&self, value: f64) -> f64 {
        (1.0 + self.delay_weight) * value
    }

    /// What `parts` are expected to add if sending starts now, and if it starts `delay_s` seconds from now.
    pub(super) fn soon_and_late(
        &self,
        parts: &[Contribution],
        sums: &FrameSums,
        bytes: u32,
        delay_s: f64,
    ) -> (f64, f64) {
        let sending = f64::from(bytes) * self.per_byte_s;
        let expected = self.first_byte_s + sending;
        let spread = self.spread_s + 0.5 * sending;
        let late_spread = spread + self.error_growth * delay_s;
        let (mut soon, mut late) = (0.0, 0.0);
        for part in parts {
            let (utility, base) = if self.frame_share {
                sums.gain(part, self.next_frame)
            } else {
                sums.even_gain(part, self.next_frame)
            };
            let gain = utility + self.base_weight * base;
            if gain > 0.0 {
                let first = self.shown_in(part.first.max(self.next_frame)) - expected;
                let last = self.shown_in(part.last) - expected;
                soon += gain * mean_arrival(first, last, 0.0, spread);
                late += gain * mean_arrival(first, last, delay_s, late_spread);
            }
        }
        (soon, late)
    }

    /// Probability that a packet of `bytes` sent now, and again whenever it is lost and time allows, arrives
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        graph::{GroupIndex, Synthetic, pieces::Division},
        policy::{PacketStatus, deadline_utility::tests::view},
    };

    /// Windows of a second, of which frame 0 is shown at `start_ms`, over 1 Mbit/s and 20 ms one way.
    fn at(graph: &PacketGraph, start_ms: u64, horizon_frame: u32, now_ms: u64) -> Forecast {
        let count = graph.packets().len();
        let (status, sent_at) = (vec![PacketStatus::Waiting; count], vec![Nanos::ZERO; count]);
        let view = SenderView {
            playout_start: Nanos::from_ms(start_ms),
            playing: now_ms >= start_ms,
            horizon_frame,
            smoothed_rtt: Nanos::from_ms(40),
            rtt_variation: Nanos::from_ms(2),
            ..view(graph, &status, &sent_at)
        };
        Forecast::new(&view, &DeadlineUtilityConfig::default(), Nanos::from_ms(now_ms))
    }

    fn clip() -> PacketGraph {
        Synthetic { frames: 120, window_frames: 30, ..Synthetic::default() }.build(1).unwrap()
    }

    #[test]
    fn waiting_ends_in_the_middle_of_the_next_window_before_the_horizon() {
        let graph = clip();
        assert_eq!(graph.starts(), [0, 30, 60, 90]);
        let wait = |start_ms, horizon, now_ms| at(&graph, start_ms, horizon, now_ms).wait_s;
        let close = |found: Option<f64>, wanted: f64| (found.unwrap() - wanted).abs() < 2e-3;
        // Frame 0 in 2 s: what is sent in 1.98 s is there; window 0 is half over half a second later.
        assert!(close(wait(2000, 120, 0), 2.48));
        // Playing at frame 10: the next window begins in 20 frames.
        assert!(close(wait(0, 120, 333), 0.667 - 0.02 + 0.5));
        // Of the next window the horizon holds 10 frames only.
        assert!(close(wait(0, 40, 333), 0.667 - 0.02 + 0.167));
        assert_eq!(wait(0, 30, 333), None);
        assert_eq!(wait(0, 120, 3500), None);
    }

    /// Before playout a second's window loses half by waiting until then, and all later ones next to nothing;
    /// with no window to come, waiting would lose all.
    #[test]
    fn what_begins_later_scores_little_until_waiting_would_cost_it() {
        let graph = clip();
        let division: &Division = &graph.division();
        let part = |first, last| Contribution { group: GroupIndex(0), first, last, utility: 1.0, base: 0.0 };
        let score = |start_ms, now_ms, first, last| {
            let forecast = at(&graph, start_ms, 120, now_ms);
            forecast.value(&[part(first, last)], &division.sums, 1000)
        };
        let [near, far] = [score(2000, 0, 0, 29), score(2000, 0, 30, 59)];
        assert!(near > 4.0 * far && far > 0.0, "{near} {far}");
        // A second later in the clip the same window is the near one.
        assert!(score(0, 500, 30, 59) > 4.0 * score(0, 500, 60, 89));
        // The last window plays: whatever is left of it is worth the same wherever it begins.
        let urgent = at(&graph, 0, 120, 3500).urgent(1.0);
        let left = at(&graph, 0, 120, 3500).soon_and_late(&[part(90, 119)], &division.sums, 1000, 0.0).0;
        assert!((score(0, 3500, 90, 119) / left / urgent - 1.0).abs() < 1e-9);
    }
}
