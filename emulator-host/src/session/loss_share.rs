//! Estimates the share of datagrams that the path loses now.
//!
//! A share over the whole life of a connection mixes the overshoot of slow start with the present. Here the
//! larger of the shares of the last second and of the last ten counts, each with one loss in fifty added
//! in advance (a Beta(1, 50) prior), so that one early loss is not taken for a law.

use crate::clock::Nanos;

/// Width of a bucket.
const BUCKET: Nanos = Nanos::from_ms(100);
/// Buckets of the long span; the short span is a tenth of it.
const LONG: usize = 100;
const SHORT: usize = 10;
/// What the estimate is drawn towards: so many datagrams without loss and one lost.
const PRIOR_DATAGRAMS: f64 = 51.0;

/// Fewer settled datagrams in a second say too little: then the long span alone counts.
const ENOUGH: u32 = 20;

/// Datagrams whose fate became known.
#[derive(Clone, Copy, Debug, Default)]
struct Fates {
    settled: u32,
    lost: u32,
}

impl Fates {
    fn add(&mut self, other: Self) {
        self.settled += other.settled;
        self.lost += other.lost;
    }

    fn remove(&mut self, other: Self) {
        self.settled -= other.settled;
        self.lost -= other.lost;
    }

    fn share(self) -> f64 {
        (f64::from(self.lost) + 1.0) / (f64::from(self.settled) + PRIOR_DATAGRAMS)
    }
}

/// The estimator.
#[derive(Debug)]
pub(super) struct LossShare {
    buckets: [Fates; LONG],
    /// Number of the newest bucket since the start.
    newest: u64,
    long: Fates,
    short: Fates,
}

impl LossShare {
    pub(super) fn new() -> Self {
        Self { buckets: [Fates::default(); LONG], newest: 0, long: Fates::default(), short: Fates::default() }
    }

    /// `acked` and `lost` datagrams settled at `now`.
    pub(super) fn settle(&mut self, acked: usize, lost: usize, now: Nanos) {
        self.advance(now);
        let fates = Fates { settled: (acked + lost) as u32, lost: lost as u32 };
        self.buckets[place(self.newest)].add(fates);
        self.long.add(fates);
        self.short.add(fates);
    }

    /// The share at `now`, above 0 and below 1.
    pub(super) fn share(&mut self, now: Nanos) -> f64 {
        self.advance(now);
        let long = self.long.share();
        if self.short.settled >= ENOUGH { self.short.share().max(long) } else { long }
    }

    /// Empties the buckets between the newest and that of `now`.
    fn advance(&mut self, now: Nanos) {
        let number = now.0 / BUCKET.0;
        if number >= self.newest + LONG as u64 {
            *self = Self { newest: number, ..Self::new() };
        }
        while self.newest < number {
            self.newest += 1;
            self.long.remove(std::mem::take(&mut self.buckets[place(self.newest)]));
            self.short.remove(self.buckets[place(self.newest + (LONG - SHORT) as u64)]);
        }
    }
}

fn place(number: u64) -> usize {
    (number % LONG as u64) as usize
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
