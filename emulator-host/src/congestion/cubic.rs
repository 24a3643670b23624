//! Sets the window by CUBIC (RFC 9438), counting bytes, in integers.
//!
//! Numbers in comments are sections of RFC 9438. Slow start and recovery periods are those of RFC 9002. The
//! window grows by at most half a window per round trip, as 4.2 bounds the target.

use super::{Acked, Controller, DeliverySample, Rtt, initial_window, minimum_window};
use crate::clock::{Bytes, Nanos, Rate};

/// β as a fraction (4.6).
const BETA: (u64, u64) = (7, 10);
/// α of the Reno-friendly region, 3 (1 − β) ÷ (1 + β), as a fraction (4.3).
const ALPHA: (u64, u64) = (9, 17);
/// C in segments per second cubed, as a fraction (5.1).
const C: (i128, i128) = (4, 10);
/// Longest time that enters the cubic: a longer one would overflow, and no window grows that long.
const LONGEST: i128 = 200_000_000_000;
/// Parts of a byte in which windows are counted.
const PARTS: u64 = 1024;

/// The controller.
#[derive(Clone, Debug)]
pub struct Cubic {
    datagram: u64,
    /// In parts of a byte, as is `estimate`.
    window: u64,
    threshold: u64,
    /// Window before the last reduction, lowered by fast convergence; bytes.
    most: u64,
    /// Window just before the last reduction; bytes.
    prior: u64,
    /// What Reno would have by now.
    estimate: u64,
    /// When the cubic started, and how long it takes back to `most`.
    epoch: Option<(Nanos, Nanos)>,
    /// Since when the application has sent too little, if it does: the cubic waits for it.
    limited_since: Option<Nanos>,
    recovery_start: Option<Nanos>,
}

impl Cubic {
    /// Initial window, no threshold.
    pub fn new(datagram_bytes: u64) -> Self {
        Self {
            datagram: datagram_bytes,
            window: initial_window(datagram_bytes) * PARTS,
            threshold: u64::MAX,
            most: 0,
            prior: 0,
            estimate: 0,
            epoch: None,
            limited_since: None,
            recovery_start: None,
        }
    }

    fn in_recovery(&self, sent_at: Nanos) -> bool {
        self.recovery_start.is_some_and(|start| sent_at <= start)
    }

    /// K: how long the cubic takes from the window to `most` (4.2).
    fn rise(&self) -> Nanos {
        let missing = u128::from(self.most.saturating_sub(self.window()));
        let (numerator, denominator) = (C.1.unsigned_abs(), C.0.unsigned_abs() * u128::from(self.datagram));
        // Seconds cubed in nanoseconds cubed: windows of less than 10⁹ bytes do not overflow.
        let cubed = missing.min(1_000_000_000) * numerator * 1_000_000_000_000_000_000 / denominator;
        Nanos(cube_root(cubed.saturating_mul(1_000_000_000)))
    }

    /// W_cubic at `since` the start of the cubic, bytes (4.2).
    fn cubic(&self, since: Nanos, rise: Nanos) -> u64 {
        let span = (i128::from(since.0) - i128::from(rise.0)).clamp(-LONGEST, LONGEST);
        let segments = span * span * span / 1_000_000_000_000_000_000;
        let bytes = segments * C.0 * i128::from(self.datagram) / C.1 / 1_000_000_000;
        u64::try_from(i128::from(self.most) + bytes).unwrap_or(0)
    }

    /// Congestion avoidance (4.2 to 4.5).
    fn avoid(&mut self, bytes: u64, rtt: &Rtt, now: Nanos) {
        let (start, rise) = match self.epoch {
            Some(epoch) => epoch,
            // After persistent congestion the cubic starts from the window, with K = 0 (4.8).
            None => {
                self.estimate = self.window;
                self.most = self.window();
                *self.epoch.insert((now, Nanos::ZERO))
            }
        };
        let since = now - start;
        let window = self.window().max(1);
        // Reno's step is one segment per window once it has the window of before the reduction (4.3).
        let (numerator, denominator) = if self.estimate / PARTS < self.prior { ALPHA } else { (1, 1) };
        self.estimate += PARTS * self.datagram * bytes / window * numerator / denominator;
        if self.cubic(since, rise) < self.estimate / PARTS {
            self.window = self.window.max(self.estimate);
            return;
        }
        let target = self.cubic(since + rtt.smoothed(), rise).clamp(window, window + window / 2);
        self.window += PARTS * (target - window) * bytes / window;
    }
}

impl Controller for Cubic {
    fn name(&self) -> &'static str {
        "cubic"
    }

    fn on_ack(&mut self, acked: Acked, rtt: &Rtt, now: Nanos) {
        if self.in_recovery(acked.sent_at) {
            return;
        }
        if acked.app_limited {
            self.limited_since.get_or_insert(now);
            return;
        }
        // The cubic does not run while the application sends too little (5.8).
        if let (Some(since), Some((start, _))) = (self.limited_since.take(), &mut self.epoch) {
            *start += now - since;
        }
        if self.window() < self.threshold {
            self.window += acked.bytes * PARTS;
        } else {
            self.avoid(acked.bytes, rtt, now);
        }
    }

    fn on_ack_end(&mut self, _sample: Option<DeliverySample>, _in_flight: u64, _rtt: &Rtt, _now: Nanos) {}

    fn on_congestion(&mut self, sent_at: Nanos, _lost_bytes: u64, _in_flight: u64, now: Nanos) -> bool {
        if self.in_recovery(sent_at) {
            return false;
        }
        self.recovery_start = Some(now);
        let window = self.window();
        // Fast convergence (4.7): a flow that has had to give way before leaves room for others.
        self.most = if window < self.most { window * (BETA.0 + BETA.1) / (2 * BETA.1) } else { window };
        self.prior = window;
        self.threshold = (window * BETA.0 / BETA.1).max(minimum_window(self.datagram));
        self.window = self.threshold * PARTS;
        self.estimate = self.window;
        self.epoch = Some((now, self.rise()));
        self.limited_since = None;
        true
    }

    fn on_persistent_congestion(&mut self) {
        self.window = minimum_window(self.datagram) * PARTS;
        self.recovery_start = None;
        self.epoch = None;
        self.limited_since = None;
    }

    fn window(&self) -> u64 {
        self.window / PARTS
    }

    /// 1.25 windows per round trip (RFC 9002, 7.7).
    fn pacing_rate(&self, rtt: &Rtt) -> Rate {
        Rate::over(Bytes(self.window()), rtt.smoothed()).scaled(5, 4)
    }

    fn is_probing(&self) -> bool {
        self.window() < self.threshold
    }
}

/// The largest whole number whose cube is at most `value`.
fn cube_root(value: u128) -> u64 {
    let mut root = 0u128;
    for bit in (0..42).rev() {
        let higher = root | 1 << bit;
        if higher * higher * higher <= value {
            root = higher;
        }
    }
    u64::try_from(root).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use super::*;

    const DATAGRAM: u64 = 1000;

    /// A controller whose window of 100 datagrams was reduced at 1 s.
    fn reduced() -> Cubic {
        let mut cubic = Cubic::new(DATAGRAM);
        cubic.window = 100 * DATAGRAM * PARTS;
        assert!(cubic.on_congestion(Nanos::ZERO, 0, 0, Nanos::from_s(1)));
        cubic
    }

    fn round_trip(ms: u64) -> Rtt {
        let mut rtt = Rtt::new(Nanos::from_ms(25));
        rtt.update(Nanos::from_ms(ms), Nanos::ZERO, Nanos::ZERO);
        rtt
    }

    /// One window is acknowledged per round trip.
    fn go_on(cubic: &mut Cubic, ms: u64, until: Nanos, app_limited: bool) {
        let rtt = round_trip(ms);
        let mut now = Nanos::from_s(1) + Nanos::from_ms(ms);
        while now <= until {
            for _ in 0..cubic.window() / DATAGRAM {
                let acked = Acked { bytes: DATAGRAM, sent_at: now, app_limited };
                cubic.on_ack(acked, &rtt, now);
            }
            now += Nanos::from_ms(ms);
        }
    }

    #[test]
    fn cube_roots_are_exact() {
        assert_eq!(cube_root(0), 0);
        for root in [1u64, 2, 999, 123_456_789, 4_000_000_000_000] {
            let cube = u128::from(root).pow(3);
            assert_eq!([cube - 1, cube, cube + 1].map(cube_root), [root - 1, root, root]);
        }
    }

    #[test]
    fn rfc9438_4_6_a_loss_takes_three_tenths_and_one_per_recovery_period() {
        let mut cubic = reduced();
        assert_eq!(cubic.window(), 70 * DATAGRAM);
        assert!(!cubic.on_congestion(Nanos::from_s(1), 0, 0, Nanos::from_s(2)));
        assert_eq!(cubic.window(), 70 * DATAGRAM);
        cubic.on_persistent_congestion();
        assert_eq!(cubic.window(), 2 * DATAGRAM);
        assert!(cubic.is_probing());
    }

    /// K = ∛(30 / 0.4) = 4.217 s, whatever the round trip.
    #[test]
    fn rfc9438_4_2_the_window_is_back_after_k_and_flat_there() {
        let (_, rise) = reduced().epoch.unwrap();
        assert!(rise.abs_diff(Nanos::from_ms(4217)) < Nanos::from_ms(1), "{rise}");
        for ms in [100, 200] {
            let mut cubic = reduced();
            go_on(&mut cubic, ms, Nanos::from_s(1) + rise, false);
            let window = cubic.window();
            assert!((98 * DATAGRAM..=100 * DATAGRAM).contains(&window), "{ms} ms: {window}");
            go_on(&mut cubic, ms, Nanos::from_s(9) + rise, false);
            assert!(cubic.window() > 200 * DATAGRAM, "{ms} ms: {}", cubic.window());
        }
    }

    /// On a short path Reno is faster: a window grows by α segments per round trip.
    #[test]
    fn rfc9438_4_3_short_paths_get_what_reno_would_get() {
        let mut cubic = reduced();
        go_on(&mut cubic, 10, Nanos::from_ms(1410), false);
        // 41 round trips of 9/17 segments.
        let window = cubic.window();
        assert!((90 * DATAGRAM..=92 * DATAGRAM).contains(&window), "{window}");
    }

    #[test]
    fn rfc9438_5_8_the_cubic_waits_while_the_application_sends_little() {
        let mut cubic = reduced();
        go_on(&mut cubic, 100, Nanos::from_s(20), true);
        assert_eq!(cubic.window(), 70 * DATAGRAM);
        let acked = Acked { bytes: DATAGRAM, sent_at: Nanos::from_s(20), app_limited: false };
        cubic.on_ack(acked, &round_trip(100), Nanos::from_s(20));
        assert!(cubic.window() < 72 * DATAGRAM, "{}", cubic.window());
    }

    /// Slow start ends at 70 segments; from there W_cubic(t) = 70 + 0.4 t³, whatever the window was before.
    #[test]
    fn rfc9438_4_8_after_persistent_congestion_the_cubic_starts_from_the_window() {
        let mut cubic = reduced();
        cubic.on_persistent_congestion();
        cubic.window = cubic.threshold * PARTS;
        let begin = Nanos::from_s(10);
        let acked = Acked { bytes: DATAGRAM, sent_at: begin, app_limited: false };
        cubic.on_ack(acked, &round_trip(100), begin);
        assert_eq!((cubic.most, cubic.epoch), (70 * DATAGRAM, Some((begin, Nanos::ZERO))));
        assert_eq!(cubic.cubic(Nanos::from_s(5), Nanos::ZERO), 120 * DATAGRAM);
    }

    #[test]
    fn rfc9438_4_7_a_second_loss_below_the_last_lowers_the_goal() {
        let mut cubic = reduced();
        cubic.on_congestion(Nanos::from_s(2), 0, 0, Nanos::from_s(3));
        assert_eq!((cubic.most, cubic.window()), (59_500, 49 * DATAGRAM));
    }
}
