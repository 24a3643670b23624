//! Estimates the share of datagrams that the path loses now.
//!
//! A share over the whole life of a connection mixes the overshoot of slow start with the present. Here the
//! larger of the shares of the last second and of the last ten counts, each with one loss in fifty added
//! in advance (a Beta(1, 50) prior), so that one early loss is not taken for a law.

use super::recent_counts::{Counts, RecentCounts};
use crate::clock::Nanos;

/// Tenths of a second of either span.
const LONG: usize = 100;
const SHORT: usize = 10;
/// What the estimate is drawn towards: so many datagrams without loss and one lost.
const PRIOR_DATAGRAMS: f64 = 51.0;

/// Fewer settled datagrams in a second say too little: then the long span alone counts.
const ENOUGH: u32 = 20;

/// The estimator.
#[derive(Debug)]
pub(super) struct LossShare {
    long: RecentCounts<LONG>,
    short: RecentCounts<SHORT>,
}

impl LossShare {
    pub(super) fn new() -> Self {
        Self { long: RecentCounts::new(), short: RecentCounts::new() }
    }

    /// `acked` and `lost` datagrams settled at `now`.
    pub(super) fn settle(&mut self, acked: usize, lost: usize, now: Nanos) {
        let settled = Counts { all: (acked + lost) as u32, lost: lost as u32 };
        self.long.add(settled, now);
        self.short.add(settled, now);
    }

    /// The share at `now`, above 0 and below 1.
    pub(super) fn share(&mut self, now: Nanos) -> f64 {
        let (long, short) = (share(self.long.sum(now)), self.short.sum(now));
        if short.all >= ENOUGH { share(short).max(long) } else { long }
    }
}

fn share(settled: Counts) -> f64 {
    (f64::from(settled.lost) + 1.0) / (f64::from(settled.all) + PRIOR_DATAGRAMS)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_old_burst_is_forgotten_and_a_new_one_is_seen_at_once() {
        let mut share = LossShare::new();
        share.settle(40, 60, Nanos::from_ms(50));
        assert!(share.share(Nanos::from_ms(60)) > 0.3);
        for second in 1..20 {
            share.settle(100, 0, Nanos::from_s(second));
        }
        let calm = share.share(Nanos::from_s(20));
        assert!(calm < 0.002, "{calm}");
        share.settle(80, 20, Nanos::from_s(21));
        let burst = share.share(Nanos::from_s(21));
        assert!(burst > 0.1, "{burst}");
    }

    #[test]
    fn one_loss_among_few_is_no_law() {
        let mut share = LossShare::new();
        share.settle(1, 1, Nanos::from_ms(10));
        assert!(share.share(Nanos::from_ms(10)) < 0.05);
    }
}
