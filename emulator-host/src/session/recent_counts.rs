//! Counts what was lost of what became known lately.

use crate::clock::Nanos;

/// Width of a bucket.
const BUCKET: Nanos = Nanos::from_ms(100);

/// So many of something, and how many of them were lost.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(super) struct Counts {
    pub(super) all: u32,
    pub(super) lost: u32,
}

impl Counts {
    pub(super) fn add(&mut self, other: Self) {
        self.all += other.all;
        self.lost += other.lost;
    }

    fn remove(&mut self, other: Self) {
        self.all -= other.all;
        self.lost -= other.lost;
    }
}

/// Counts of the last `BUCKETS` tenths of a second, the present one included.
#[derive(Debug)]
pub(super) struct RecentCounts<const BUCKETS: usize> {
    buckets: [Counts; BUCKETS],
    /// Number of the newest bucket since the start.
    newest: u64,
    sum: Counts,
}

impl<const BUCKETS: usize> RecentCounts<BUCKETS> {
    pub(super) fn new() -> Self {
        Self { buckets: [Counts::default(); BUCKETS], newest: 0, sum: Counts::default() }
    }

    /// Adds what became known at `now`.
    pub(super) fn add(&mut self, counts: Counts, now: Nanos) {
        self.advance(now);
        self.buckets[place::<BUCKETS>(self.newest)].add(counts);
        self.sum.add(counts);
    }

    /// What became known lately, at `now`.
    pub(super) fn sum(&mut self, now: Nanos) -> Counts {
        self.advance(now);
        self.sum
    }

    /// Empties the buckets between the newest and that of `now`.
    fn advance(&mut self, now: Nanos) {
        let number = now.0 / BUCKET.0;
        if number >= self.newest + BUCKETS as u64 {
            *self = Self { newest: number, ..Self::new() };
        }
        while self.newest < number {
            self.newest += 1;
            self.sum.remove(std::mem::take(&mut self.buckets[place::<BUCKETS>(self.newest)]));
        }
    }
}

fn place<const BUCKETS: usize>(number: u64) -> usize {
    (number % BUCKETS as u64) as usize
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_bucket_counts_until_as_many_have_come_after_it() {
        let mut recent = RecentCounts::<10>::new();
        let one = Counts { all: 3, lost: 1 };
        recent.add(one, Nanos::from_ms(250));
        assert_eq!(recent.sum(Nanos::from_ms(1_199)), one);
        assert_eq!(recent.sum(Nanos::from_ms(1_200)), Counts::default());
        recent.add(one, Nanos::from_ms(1_200));
        recent.add(one, Nanos::from_ms(1_900));
        assert_eq!(recent.sum(Nanos::from_ms(2_199)), Counts { all: 6, lost: 2 });
        assert_eq!(recent.sum(Nanos::from_ms(2_200)), one);
        assert_eq!(recent.sum(Nanos::from_s(60)), Counts::default());
    }
}
