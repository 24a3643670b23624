//! Numbers spans of a repeating clip by the clock on the wall, so that a publisher that starts again goes on
//! where the clip would be.
//!
//! Numbers count the spans since 1970 as if the clip had been repeated ever since. So they grow for ever,
//! and a number says which span of the clip it is without another word.

use codec_core::internals::wire::manifest::Manifest;
use emulator_host::Nanos;

use crate::socket::{middle_us, starts};

/// How long before it is shown a window is published.
pub(super) const LEAD: Nanos = Nanos::from_s(2);

/// Spans of a clip that follow each other without gaps: its windows, or its epochs.
#[derive(Clone, Debug)]
pub(super) struct Spans {
    /// First frames, ascending, the first of them 0.
    firsts: Vec<u32>,
    frames: u32,
    interval: Nanos,
}

impl Spans {
    /// Spans that begin at `firsts` of a clip of `frames`; `None` where there is no clip to repeat.
    pub(super) fn new(firsts: Vec<u32>, frames: u32, interval: Nanos) -> Option<Self> {
        let ascending = firsts.first() == Some(&0) && firsts.is_sorted_by(|a, b| a < b);
        let inside = firsts.last().is_some_and(|last| *last < frames);
        (ascending && inside && interval.0 > 0).then_some(Self { firsts, frames, interval })
    }

    /// The windows and the epochs of a stream; `None` where there is no clip to repeat.
    pub(super) fn of(manifest: &Manifest<'_>) -> Option<(Self, Self)> {
        let frames = manifest.head().frames;
        let interval = Nanos((1e9 / manifest.frames_per_second()).round() as u64);
        let epochs = manifest.epochs().map(|epoch| epoch.first_frame).collect();
        let epochs = Self::new(epochs, frames, interval)?;
        Some((Self::new(starts(manifest), frames, interval)?, epochs))
    }

    /// Their first frames, ascending.
    pub(super) fn firsts(&self) -> &[u32] {
        &self.firsts
    }

    /// Time that the clip takes.
    fn clip(&self) -> u64 {
        self.interval.0.saturating_mul(self.frames.into()).max(1)
    }

    fn count(&self) -> u64 {
        self.firsts.len() as u64
    }

    /// The place in the clip of span `number`.
    pub(super) fn place(&self, number: u64) -> usize {
        // There is at least one span.
        (number % self.count().max(1)) as usize
    }

    /// The first frame of span `number`.
    pub(super) fn first(&self, number: u64) -> u32 {
        self.firsts.get(self.place(number)).copied().unwrap_or(0)
    }

    /// When span `number` begins, since 1970.
    pub(super) fn begins(&self, number: u64) -> Nanos {
        let round = number / self.count().max(1);
        let into = self.interval.times(self.first(number).into());
        Nanos(round.saturating_mul(self.clip())) + into
    }

    /// The span of the time `at`, since 1970.
    pub(super) fn at(&self, at: Nanos) -> u64 {
        let (round, into) = (at.0 / self.clip(), at.0 % self.clip());
        let frame = into / self.interval.0.max(1);
        let after = self.firsts.partition_point(|first| u64::from(*first) <= frame);
        round.saturating_mul(self.count()) + (after as u64).saturating_sub(1)
    }

    /// The span of `frame` of a clip that is shown once.
    pub(super) fn of_frame(&self, frame: u32) -> u64 {
        (self.firsts.partition_point(|first| *first <= frame) as u64).saturating_sub(1)
    }

    /// Whether span `number` is of a clip that is shown once: nothing that repeats is in its first round
    /// since 1970.
    pub(super) fn is_shown_once(&self, number: u64) -> bool {
        number < self.count()
    }

    /// The longest span.
    pub(super) fn longest(&self) -> Nanos {
        let ends = self.firsts.iter().skip(1).copied().chain([self.frames]);
        let frames = self.firsts.iter().zip(ends).map(|(first, end)| end - first).max();
        self.interval.times(frames.unwrap_or(0).into())
    }

    /// Whether the clip is one span.
    pub(super) fn is_one(&self) -> bool {
        self.firsts.len() == 1
    }

    /// The time of the middle of `frame`, microseconds.
    pub(super) fn middle_us(&self, frame: u32) -> u64 {
        middle_us(frame, self.interval)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn spans() -> Spans {
        Spans::new(vec![0, 30, 60], 80, Nanos(33_333_333)).unwrap()
    }

    #[test]
    fn a_number_is_the_span_at_its_time_in_any_round() {
        let spans = spans();
        for number in [0, 1, 2, 3, 5, 3_000_000_001, 3_000_000_002] {
            let begins = spans.begins(number);
            assert_eq!((spans.at(begins), spans.at(begins + Nanos(600_000_000))), (number, number));
            assert_eq!(spans.at(begins - Nanos(1)), number.saturating_sub(1));
            assert_eq!(spans.first(number), [0, 30, 60][(number % 3) as usize]);
            assert_eq!(spans.is_shown_once(number), number < 3);
        }
        assert_eq!(spans.longest(), Nanos(33_333_333 * 30));
        assert_eq!([0, 29, 30, 79].map(|frame| spans.of_frame(frame)), [0, 0, 1, 2]);
        // The last one is shorter: the clip begins again where it ends.
        assert_eq!(spans.begins(3).0 - spans.begins(2).0, 33_333_333 * 20);
    }

    #[test]
    fn what_is_no_clip_has_no_spans() {
        for (firsts, frames, interval) in
            [(vec![], 9, 1), (vec![1], 9, 1), (vec![0, 9], 9, 1), (vec![0, 3, 3], 9, 1), (vec![0], 9, 0)]
        {
            assert!(Spans::new(firsts, frames, Nanos(interval)).is_none());
        }
    }
}
