//! Sets the window by the paper's model of BBR: delivery rate, minimum round trip, two bandwidth-delay
//! products in flight, and a ceiling learned from bursts of loss. An ablation for scheduler sensitivity, no
//! implementation of any BBR version.
//!
//! - Rate: maximum delivery rate over ten round trips, from acknowledged bytes.
//! - Round trip: minimum over the whole run.
//! - Window: twice their product, at least four datagrams; before the first sample, the initial window.
//! - Ceiling: when a round trip loses more than 2 % of what it acknowledged, the window is held to 7/8 of
//!   what was in flight, no lower than one product; each following round trip without such loss raises the
//!   ceiling by a sixteenth.
//! - Start: while the rate still grows by a quarter per round trip, pace at twice the rate; then at 5/4 of
//!   it.
//!
//! Where it differs from the text, which paces at min(r_cwnd, r̂_path) exactly: the rate of the path is
//! what was delivered, never more than what was sent, so that exactly that much stays what the initial window
//! measured. [`BbrModel::paper`] keeps to the text nevertheless: r_cwnd is the window over the smoothed round
//! trip, and neither it nor r̂_path has headroom at any time.

use super::{Acked, Controller, DeliverySample, Rtt, delivery::DeliveryRate, initial_window, minimum_window};
use crate::clock::{Bytes, Nanos, Rate};

/// The model's state.
#[derive(Clone, Debug)]
pub struct BbrModel {
    datagram: u64,
    rate: DeliveryRate,
    minimum_rtt: Nanos,
    ceiling: Option<u64>,
    round_end: Nanos,
    round_acked: u64,
    round_lost: u64,
    round_app_limited: bool,
    starting: bool,
    rate_at_round: Rate,
    flat_rounds: u32,
    collapsed: bool,
    /// Whether the pace is min(r_cwnd, r̂_path) exactly.
    is_exact: bool,
}

impl BbrModel {
    /// No measurement yet.
    pub fn new(datagram_bytes: u64) -> Self {
        Self {
            datagram: datagram_bytes,
            rate: DeliveryRate::new(),
            minimum_rtt: Nanos::MAX,
            ceiling: None,
            round_end: Nanos::ZERO,
            round_acked: 0,
            round_lost: 0,
            round_app_limited: false,
            starting: true,
            rate_at_round: Rate(0),
            flat_rounds: 0,
            collapsed: false,
            is_exact: false,
        }
    }

    /// The same, paced at min(r_cwnd, r̂_path) exactly, as the paper's text says.
    pub fn paper(datagram_bytes: u64) -> Self {
        Self { is_exact: true, ..Self::new(datagram_bytes) }
    }

    fn product(&self) -> Option<u64> {
        self.rate.estimate().map(|rate| rate.bytes_in(self.minimum_rtt).0)
    }

    fn end_round(&mut self, rtt: &Rtt, now: Nanos) {
        if self.round_lost * 50 <= self.round_acked
            && let Some(ceiling) = &mut self.ceiling
        {
            *ceiling = ceiling.saturating_add((*ceiling / 16).max(self.datagram));
        }
        let rate = self.rate.estimate().unwrap_or(Rate(0));
        if rate >= self.rate_at_round.scaled(5, 4) {
            self.rate_at_round = rate;
            self.flat_rounds = 0;
        } else if !self.round_app_limited {
            // Only a round that tried to send more shows that there is no more.
            self.flat_rounds += 1;
        }
        self.starting &= self.flat_rounds < 3;
        self.round_acked = 0;
        self.round_lost = 0;
        self.round_app_limited = false;
        self.round_end = now + rtt.smoothed();
    }
}

impl Controller for BbrModel {
    fn name(&self) -> &'static str {
        if self.is_exact { "bbr-paper" } else { "bbr-model" }
    }

    fn on_ack(&mut self, acked: Acked, rtt: &Rtt, _now: Nanos) {
        self.round_acked += acked.bytes;
        self.round_app_limited |= acked.app_limited;
        if rtt.first_sample_at().is_some() {
            self.minimum_rtt = self.minimum_rtt.min(rtt.latest());
        }
        self.collapsed = false;
    }

    fn on_ack_end(&mut self, sample: Option<DeliverySample>, _in_flight: u64, rtt: &Rtt, now: Nanos) {
        if let Some(sample) = sample {
            self.rate.take(sample, rtt.smoothed().times(10), now);
        }
        if now >= self.round_end {
            self.end_round(rtt, now);
        }
    }

    fn on_congestion(&mut self, _sent_at: Nanos, lost_bytes: u64, in_flight: u64, _now: Nanos) -> bool {
        let before = self.round_lost * 50 > self.round_acked;
        self.round_lost += lost_bytes;
        let burst = self.round_lost * 50 > self.round_acked && self.round_lost > 2 * self.datagram;
        if !burst || before {
            return false;
        }
        self.starting = false;
        let floor = self.product().unwrap_or(0).max(4 * self.datagram);
        self.ceiling = Some(((in_flight + lost_bytes) * 7 / 8).max(floor));
        true
    }

    fn on_persistent_congestion(&mut self) {
        self.collapsed = true;
        self.starting = true;
        self.flat_rounds = 0;
    }

    fn window(&self) -> u64 {
        if self.collapsed {
            return minimum_window(self.datagram);
        }
        let Some(product) = self.product() else { return initial_window(self.datagram) };
        let target = (2 * product).max(4 * self.datagram);
        let target = if self.starting { target.max(initial_window(self.datagram)) } else { target };
        self.ceiling.map_or(target, |ceiling| target.min(ceiling))
    }

    fn pacing_rate(&self, rtt: &Rtt) -> Rate {
        if self.is_exact {
            return Rate::over(Bytes(self.window()), rtt.smoothed());
        }
        match self.rate.estimate() {
            Some(rate) if self.starting => rate.scaled(2, 1),
            Some(rate) => rate.scaled(5, 4),
            None => Rate::over(Bytes(self.window()), rtt.smoothed()).scaled(5, 4),
        }
    }

    fn is_probing(&self) -> bool {
        self.starting
    }

    fn headroom(&self) -> (u64, u64) {
        match (self.is_exact, self.starting) {
            (true, _) => (1, 1),
            (false, true) => (3, 1),
            (false, false) => (5, 4),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn fed(samples: &[(u64, u64)]) -> (BbrModel, Rtt) {
        let mut rtt = Rtt::new(Nanos::from_ms(25));
        let mut model = BbrModel::new(1200);
        for (ms, mbps) in samples {
            let now = Nanos::from_ms(*ms);
            rtt.update(Nanos::from_ms(40), Nanos::ZERO, now);
            model.on_ack(Acked { bytes: 1200, sent_at: now, app_limited: false }, &rtt, now);
            let sample = DeliverySample { rate: Rate::from_mbps(*mbps), app_limited: false };
            model.on_ack_end(Some(sample), 0, &rtt, now);
        }
        (model, rtt)
    }

    #[test]
    fn the_window_is_two_bandwidth_delay_products() {
        let (model, rtt) = fed(&[(100, 8), (150, 8), (200, 8), (250, 8), (300, 8)]);
        assert_eq!(model.window(), 80_000);
        assert!(!model.is_probing());
        assert_eq!(model.pacing_rate(&rtt), Rate::from_mbps(10));
    }

    #[test]
    fn the_papers_pace_is_the_window_over_a_round_trip_or_the_path_and_never_more() {
        let (begun, begun_rtt) = fed(&[(100, 8)]);
        let begun = BbrModel { is_exact: true, ..begun };
        assert!(begun.is_probing());
        assert_eq!((begun.name(), begun.headroom()), ("bbr-paper", (1, 1)));
        let window = Bytes(begun.window());
        assert_eq!(begun.pacing_rate(&begun_rtt), Rate::over(window, Nanos::from_ms(40)));
        let (settled, _) = fed(&[(100, 8), (150, 8), (200, 8), (250, 8), (300, 8)]);
        assert_eq!(settled.headroom(), (5, 4));
        assert_eq!(BbrModel { is_exact: true, ..settled }.headroom(), (1, 1));
    }

    #[test]
    fn a_burst_of_loss_sets_a_ceiling_that_rises_again() {
        let (mut model, rtt) = fed(&[(100, 8), (150, 8), (200, 8), (250, 8), (300, 8)]);
        assert!(model.on_congestion(Nanos::from_ms(300), 6000, 50_000, Nanos::from_ms(310)));
        assert_eq!(model.window(), 49_000);
        for ms in (350..1000).step_by(50) {
            let now = Nanos::from_ms(ms);
            model.on_ack(Acked { bytes: 40_000, sent_at: now, app_limited: false }, &rtt, now);
            model.on_ack_end(None, 0, &rtt, now);
        }
        assert_eq!(model.window(), 80_000);
    }
}
