//! Estimates how losses cluster: the share of lost datagrams among those whose predecessor was lost.
//!
//! This is what a chain of two states (Gilbert's, with a bad state that loses everything) needs beside the
//! share of losses: the mean length of a burst is 1 ÷ (1 − that share). Pairs of the last ten seconds count,
//! with sixteen in advance that are lost as often as any datagram: a few losses side by side are no law, and
//! without any the estimate is that of independent losses.

use std::collections::VecDeque;

use super::recent_counts::{Counts, RecentCounts};
use crate::clock::Nanos;

/// Tenths of a second that count.
const BUCKETS: usize = 100;
/// Pairs in advance; a power of two, so that without others the share of losses comes out to the bit.
const PRIOR_PAIRS: f64 = 16.0;
/// Datagrams whose fate is remembered.
const MEMORY: usize = 1024;
/// How far the first of another count may be overtaken by later ones.
const OVERTAKEN: u64 = 64;

/// The estimator.
#[derive(Debug)]
pub(super) struct LossBursts {
    /// Whether each datagram from `first` on was lost, where that is known.
    fates: VecDeque<Option<bool>>,
    first: u64,
    /// Pairs of successive datagrams of which the first was lost, and those of which both were.
    pairs: RecentCounts<BUCKETS>,
}

/// A pair whose first datagram was lost.
fn pair(second_lost: bool) -> Counts {
    Counts { all: 1, lost: u32::from(second_lost) }
}

impl LossBursts {
    pub(super) fn new() -> Self {
        Self { fates: VecDeque::new(), first: 0, pairs: RecentCounts::new() }
    }

    /// The datagram `number`, counted in the order of sending, was found at `now` to be `lost` or to have
    /// arrived. What is said first of a datagram counts.
    pub(super) fn settle(&mut self, number: u64, lost: bool, now: Nanos) {
        let Some(at) = self.place(number) else { return };
        if self.fates[at].is_some() {
            return;
        }
        self.fates[at] = Some(lost);
        let mut pairs = Counts::default();
        if at > 0 && self.fates[at - 1] == Some(true) {
            pairs.add(pair(lost));
        }
        if lost && let Some(next_lost) = self.fates.get(at + 1).copied().flatten() {
            pairs.add(pair(next_lost));
        }
        if pairs.all > 0 {
            self.pairs.add(pairs, now);
        }
    }

    /// The share of datagrams that are lost among those whose predecessor was, where `loss` of all are:
    /// `loss` if losses do not cluster, below 1.
    pub(super) fn share_after_loss(&mut self, loss: f64, now: Nanos) -> f64 {
        let pairs = self.pairs.sum(now);
        let lost = f64::from(pairs.lost) + PRIOR_PAIRS * loss;
        (lost / (f64::from(pairs.all) + PRIOR_PAIRS)).max(loss)
    }

    /// Where the fate of the datagram `number` is kept; `None` if that is forgotten.
    fn place(&mut self, number: u64) -> Option<usize> {
        let mut ahead = number.checked_sub(self.first)?;
        if ahead >= (self.fates.len() + MEMORY) as u64 {
            self.fates.clear();
            self.first = number.saturating_sub(OVERTAKEN);
            ahead = number - self.first;
        }
        let mut at = usize::try_from(ahead).ok()?;
        while self.fates.len() <= at {
            self.fates.push_back(None);
        }
        while self.fates.len() > MEMORY {
            self.fates.pop_front();
            self.first += 1;
            at -= 1;
        }
        Some(at)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Settles `count` datagrams of which those are lost that `lost` says, a millisecond apart, from `first`
    /// on.
    fn settle(bursts: &mut LossBursts, first: u64, count: u64, lost: impl Fn(u64) -> bool) -> Nanos {
        for number in first..first + count {
            bursts.settle(number, lost(number), Nanos::from_ms(number));
        }
        Nanos::from_ms(first + count)
    }

    #[test]
    fn losses_apart_from_each_other_are_independent_to_the_bit() {
        let mut bursts = LossBursts::new();
        assert_eq!(bursts.share_after_loss(0.0371, Nanos::ZERO).to_bits(), 0.0371f64.to_bits());
        let now = settle(&mut bursts, 0, 4000, |number| number % 20 == 7);
        assert_eq!(bursts.share_after_loss(0.05, now).to_bits(), 0.05f64.to_bits());
    }

    #[test]
    fn the_length_of_bursts_is_found() {
        for length in [2, 3, 5] {
            let mut bursts = LossBursts::new();
            let now = settle(&mut bursts, 0, 9000, |number| number % 60 < length);
            let found = 1.0 / (1.0 - bursts.share_after_loss(length as f64 / 60.0, now));
            assert!((found / length as f64 - 1.0).abs() < 0.1, "{found} of {length}");
        }
    }

    #[test]
    fn the_order_in_which_fates_become_known_does_not_matter() {
        let lost = |number: u64| number % 40 < 3;
        let (mut ascending, mut shuffled) = (LossBursts::new(), LossBursts::new());
        let now = settle(&mut ascending, 0, 800, lost);
        for block in 0..100 {
            for number in (8 * block..8 * block + 8).rev() {
                shuffled.settle(number, lost(number), Nanos::from_ms(number));
                // A loss that turns out to be spurious stays one.
                shuffled.settle(number, !lost(number), Nanos::from_ms(number));
            }
        }
        assert_eq!(ascending.share_after_loss(0.075, now), shuffled.share_after_loss(0.075, now));
    }

    #[test]
    fn bursts_of_ten_seconds_ago_are_forgotten() {
        let mut bursts = LossBursts::new();
        let now = settle(&mut bursts, 0, 2000, |number| number % 50 < 4);
        assert!(bursts.share_after_loss(0.08, now) > 0.6);
        assert_eq!(bursts.share_after_loss(0.01, Nanos::from_s(13)), 0.01);
        // Another sender may count from anywhere.
        settle(&mut bursts, 1 << 40, 10, |_| true);
        bursts.settle(3, true, Nanos::from_s(14));
        bursts.settle(u64::MAX, true, Nanos::from_s(14));
    }
}
