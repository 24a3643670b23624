//! Estimates the round-trip time (RFC 9002, 5 and A.7).

use super::RecentMinimum;
use crate::clock::Nanos;

/// Round trip assumed before the first sample (RFC 9002, 6.2.2).
const INITIAL: Nanos = Nanos::from_ms(333);
/// Timer granularity (RFC 9002, A.2).
pub(super) const GRANULARITY: Nanos = Nanos::from_ms(1);

/// The estimator.
#[derive(Clone, Debug)]
pub struct Rtt {
    latest: Nanos,
    without_ack_delay: Nanos,
    smoothed: Nanos,
    variation: Nanos,
    minimum: Nanos,
    recent: RecentMinimum,
    max_ack_delay: Nanos,
    first_sample_at: Option<Nanos>,
}

impl Rtt {
    /// No sample yet. `max_ack_delay` is what the peer promises not to exceed.
    pub fn new(max_ack_delay: Nanos) -> Self {
        Self {
            latest: Nanos::ZERO,
            without_ack_delay: Nanos::ZERO,
            smoothed: INITIAL,
            variation: Nanos(INITIAL.0 / 2),
            minimum: Nanos::ZERO,
            recent: RecentMinimum::new(),
            max_ack_delay,
            first_sample_at: None,
        }
    }

    /// Takes a sample at `now`: the time since the largest newly acknowledged packet was sent, and how long
    /// the peer says that it held the acknowledgement. Order of the lines as in A.7: the variation uses the
    /// old smoothed value.
    pub fn update(&mut self, latest: Nanos, ack_delay: Nanos, now: Nanos) {
        self.latest = latest;
        self.recent.take(latest, now);
        if self.first_sample_at.is_none() {
            self.first_sample_at = Some(now);
            self.minimum = latest;
            self.without_ack_delay = latest;
            self.smoothed = latest;
            self.variation = Nanos(latest.0 / 2);
            return;
        }
        self.minimum = self.minimum.min(latest);
        let ack_delay = ack_delay.min(self.max_ack_delay);
        let adjusted = if latest >= self.minimum + ack_delay { latest - ack_delay } else { latest };
        self.without_ack_delay = adjusted;
        let deviation = self.smoothed.abs_diff(adjusted);
        self.variation = weighted(self.variation, deviation, 4);
        self.smoothed = weighted(self.smoothed, adjusted, 8);
    }

    /// After persistent congestion the minimum starts again from the newest sample (RFC 9002, 5.2).
    pub fn on_persistent_congestion(&mut self) {
        self.minimum = self.latest;
        self.recent.keep_newest();
    }

    /// Times of later samples count from a new zero, which is now; what is known stays.
    pub fn restart_clock(&mut self) {
        self.recent.restart(Nanos::ZERO);
    }

    /// Smoothed round trip, or 333 ms before the first sample.
    pub fn smoothed(&self) -> Nanos {
        self.smoothed
    }

    /// Mean deviation.
    pub fn variation(&self) -> Nanos {
        self.variation
    }

    /// Smallest sample of the connection (RFC 9002, 5.2); zero before the first.
    pub fn minimum(&self) -> Nanos {
        self.minimum
    }

    /// Smallest sample of late, for what a sender expects of the path.
    pub fn recent(&self) -> &RecentMinimum {
        &self.recent
    }

    /// Newest sample; zero before the first.
    pub fn latest(&self) -> Nanos {
        self.latest
    }

    /// Newest sample less what the peer held the acknowledgement back, where that does not make it smaller
    /// than the smallest; zero before the first.
    pub fn without_ack_delay(&self) -> Nanos {
        self.without_ack_delay
    }

    /// When the first sample was taken.
    pub fn first_sample_at(&self) -> Option<Nanos> {
        self.first_sample_at
    }

    /// SRTT + max(4 RTTVAR, 1 ms) + max_ack_delay, without backoff (RFC 9002, 6.2.1; paper, "Congestion
    /// control and pacing").
    pub fn probe_timeout(&self) -> Nanos {
        self.smoothed + self.variation.times(4).max(GRANULARITY) + self.max_ack_delay
    }

    /// 9/8 max(smoothed, latest), at least 1 ms (RFC 9002, 6.1.2).
    pub fn loss_delay(&self) -> Nanos {
        let longest = self.smoothed.max(self.latest);
        (longest + Nanos(longest.0 / 8)).max(GRANULARITY)
    }
}

/// The mean of `before`, which counts `parts` less one times, and `sample`; of any values without overflow.
fn weighted(before: Nanos, sample: Nanos, parts: u64) -> Nanos {
    let sum = u128::from(before.0) * u128::from(parts - 1) + u128::from(sample.0);
    Nanos((sum / u128::from(parts)) as u64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn what_a_sender_expects_follows_a_longer_path_and_what_recovery_uses_does_not() {
        let mut rtt = Rtt::new(Nanos::from_ms(25));
        for second in 0..40 {
            let sample = Nanos::from_ms(if second < 15 { 40 } else { 100 });
            rtt.update(sample, Nanos::ZERO, Nanos::from_s(second));
        }
        assert_eq!((rtt.minimum(), rtt.recent().get()), (Nanos::from_ms(40), Nanos::from_ms(100)));
        rtt.update(Nanos::from_ms(300), Nanos::ZERO, Nanos::from_s(40));
        rtt.on_persistent_congestion();
        assert_eq!((rtt.minimum(), rtt.recent().get()), (Nanos::from_ms(300), Nanos::from_ms(300)));
    }

    #[test]
    fn samples_of_any_length_are_taken() {
        let mut rtt = Rtt::new(Nanos::from_ms(25));
        for _ in 0..3 {
            rtt.update(Nanos::MAX, Nanos::ZERO, Nanos::ZERO);
        }
        assert_eq!((rtt.smoothed(), rtt.minimum()), (Nanos::MAX, Nanos::MAX));
        assert_eq!((rtt.probe_timeout(), rtt.loss_delay()), (Nanos::MAX, Nanos::MAX));
    }
}
