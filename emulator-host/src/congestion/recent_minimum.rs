//! Keeps the smallest round trip of the last seconds, so that a path that has become longer is followed.
//!
//! RFC 9002 keeps the smallest of the whole connection (5.2), which a route that grows longer never raises.
//! Loss recovery stays with that one; this filter is for what a sender expects of the path, as the one of BBR
//! (draft-ietf-ccwg-bbr, MinRTTFilterLen).

use std::collections::VecDeque;

use crate::clock::Nanos;

/// Age from which the smallest round trip is to be measured anew (draft-ietf-ccwg-bbr, MinRTTFilterLen).
const STALE_AFTER: Nanos = Nanos::from_s(10);
/// How long a round trip counts: a second is left to measure it anew before it is forgotten.
const WINDOW: Nanos = Nanos::from_s(11);

/// A round trip confirms the smallest if it is longer by no more than one such part: acknowledgements wait
/// for a second datagram now and then, and a queue that matters is longer.
const CONFIRMING_PART: u64 = 16;

/// Minimum of the round trips of the last eleven seconds. One that is hardly longer makes the smallest as new
/// as itself, so that it is old only where the path has become longer or is never empty.
///
/// # Examples
/// ```
/// use emulator_host::{Nanos, congestion::RecentMinimum};
///
/// let mut recent = RecentMinimum::new();
/// recent.take(Nanos::from_ms(40), Nanos::ZERO);
/// recent.take(Nanos::from_ms(90), Nanos::from_s(5));
/// assert_eq!(recent.get(), Nanos::from_ms(40));
/// recent.take(Nanos::from_ms(95), Nanos::from_s(12));
/// assert_eq!(recent.get(), Nanos::from_ms(90));
/// ```
#[derive(Clone, Debug, Default)]
pub struct RecentMinimum {
    /// When each was measured, and how long it was. Both rise from front to back: the front is the smallest.
    rising: VecDeque<(Nanos, Nanos)>,
    newest: Option<(Nanos, Nanos)>,
    has_forgotten: bool,
}

impl RecentMinimum {
    /// No sample.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a sample at `now`, which never falls, and forgets what is too old.
    pub fn take(&mut self, round_trip: Nanos, now: Nanos) {
        self.newest = Some((now, round_trip));
        let least = self.get();
        if round_trip >= least && round_trip <= least + Nanos(least.0 / CONFIRMING_PART) {
            self.rising.clear();
            self.rising.push_back((now, least));
            return;
        }
        while self.rising.back().is_some_and(|(_, other)| *other >= round_trip) {
            self.rising.pop_back();
        }
        self.rising.push_back((now, round_trip));
        while self.rising.front().is_some_and(|(at, _)| *at + WINDOW < now) {
            self.rising.pop_front();
            self.has_forgotten = true;
        }
    }

    /// The smallest round trip; zero before the first sample.
    pub fn get(&self) -> Nanos {
        self.rising.front().map_or(Nanos::ZERO, |(_, round_trip)| *round_trip)
    }

    /// When that was measured; `None` before the first sample.
    pub fn measured_at(&self) -> Option<Nanos> {
        self.rising.front().map(|(at, _)| *at)
    }

    /// How long ago, at `now`, that was measured; zero before the first sample.
    pub fn age(&self, now: Nanos) -> Nanos {
        self.measured_at().map_or(Nanos::ZERO, |at| now - at)
    }

    /// Whether a smallest round trip has become too old. Until then this is the smallest of all samples.
    pub fn has_forgotten(&self) -> bool {
        self.has_forgotten
    }

    /// Whether a smallest round trip of this `age` is to be measured anew.
    pub fn is_stale(age: Nanos) -> bool {
        age >= STALE_AFTER
    }

    /// Only the newest sample still counts.
    pub fn keep_newest(&mut self) {
        self.rising = self.newest.into_iter().collect();
    }

    /// Time counts anew: what is known counts as measured at `now`.
    pub fn restart(&mut self, now: Nanos) {
        let at_now = |sample: (Nanos, Nanos)| (now, sample.1);
        let (least, newest) = (self.rising.front().copied().map(at_now), self.newest.map(at_now));
        *self = Self { rising: least.into_iter().collect(), newest, has_forgotten: false };
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn ms(ms: u64) -> Nanos {
        Nanos::from_ms(ms)
    }

    #[test]
    fn a_path_that_grows_longer_after_fifteen_seconds_is_followed_within_the_window() {
        let mut recent = RecentMinimum::new();
        for at in 0..300 {
            let round_trip = if at < 150 { 40 } else { 120 };
            recent.take(ms(round_trip), ms(100 * at));
            let expected = if at < 150 + 110 { 40 } else { 120 };
            assert_eq!(recent.get(), ms(expected), "after {at} tenths of a second");
        }
        assert!(recent.has_forgotten());
    }

    #[test]
    fn within_the_window_it_is_the_smallest_of_all() {
        let mut recent = RecentMinimum::new();
        assert_eq!((recent.get(), recent.age(ms(7))), (Nanos::ZERO, Nanos::ZERO));
        let mut least = Nanos::MAX;
        for at in 0..100 {
            let round_trip = ms(40 + at * 37 % 50);
            least = least.min(round_trip);
            recent.take(round_trip, ms(100 * at));
            assert_eq!(recent.get(), least);
        }
        assert!(!recent.has_forgotten());
    }

    #[test]
    fn a_sample_that_is_hardly_longer_makes_the_minimum_new_and_never_raises_it() {
        let mut recent = RecentMinimum::new();
        recent.take(ms(40), Nanos::ZERO);
        recent.take(ms(45), Nanos::from_s(9));
        assert!(RecentMinimum::is_stale(recent.age(Nanos::from_s(10))));
        recent.take(ms(42), Nanos::from_s(10));
        assert_eq!((recent.get(), recent.age(Nanos::from_s(11))), (ms(40), Nanos::from_s(1)));
        for second in 11..100 {
            recent.take(ms(42), Nanos::from_s(second));
        }
        assert_eq!(recent.get(), ms(40));
    }

    #[test]
    fn after_a_restart_what_is_known_is_as_new_as_the_clock() {
        let mut recent = RecentMinimum::new();
        recent.take(ms(40), Nanos::from_s(3));
        recent.take(ms(60), Nanos::from_s(4));
        recent.restart(Nanos::ZERO);
        assert_eq!((recent.get(), recent.age(ms(1))), (ms(40), ms(1)));
        recent.take(ms(90), ms(2));
        recent.keep_newest();
        assert_eq!(recent.get(), ms(90));
    }
}
