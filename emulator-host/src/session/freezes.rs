//! Counts freezes: what is shown stands still for so long that people notice.

use crate::clock::Nanos;

/// A frame of whose base less than this share is there shows no motion of its own.
const MIN_BASE: f64 = 0.5;
/// A picture is a freeze if it stands for so much longer than an interval, and for three intervals at least.
/// Source: the W3C's Identifiers for WebRTC's Statistics API, `freezeCount`.
const NOTICED: Nanos = Nanos::from_ms(150);
/// Intervals beyond its own that it stands at least: it is shown for one, and again for each still frame.
const LEAST_STILL: u64 = 2;

/// The freezes of a playout, frame by frame. Playout never waits once it has begun: what has not come shows
/// as a freeze.
///
/// ```
/// use emulator_host::{Nanos, session::Freezes};
///
/// let mut freezes = Freezes::new(Nanos::from_ms(40));
/// [1.0, 0.2, 0.2, 0.2, 0.2, 1.0].iter().for_each(|base| freezes.show(*base));
/// assert_eq!((freezes.count(), freezes.frames()), (1, 4), "160 ms beyond the first picture's own 40");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Freezes {
    /// Frames without motion in a row that are a freeze.
    noticed: u64,
    /// Frames without motion up to now.
    still: u64,
    count: u64,
    frames: u64,
}

impl Freezes {
    /// None yet, where each frame is shown for `interval`.
    pub fn new(interval: Nanos) -> Self {
        // An interval is cut to whole nanoseconds: nine of a sixtieth of a second are 150 ms.
        let noticed = NOTICED.0.div_ceil(interval.0.saturating_add(1)).max(LEAST_STILL);
        Self { noticed, still: 0, count: 0, frames: 0 }
    }

    /// A frame is shown, and `base` of its base is there, 0 to 1.
    pub fn show(&mut self, base: f64) {
        self.still = if base < MIN_BASE { self.still + 1 } else { 0 };
        if self.still == self.noticed {
            self.count += 1;
            self.frames += self.still;
        } else if self.still > self.noticed {
            self.frames += 1;
        }
    }

    /// Freezes so far.
    pub fn count(&self) -> u64 {
        self.count
    }

    /// Frames in them.
    pub fn frames(&self) -> u64 {
        self.frames
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_freeze_is_long_enough_to_be_noticed() {
        let clip = |still: &[std::ops::Range<usize>]| {
            let mut freezes = Freezes::new(Nanos(33_333_333));
            (0..900)
                .map(|at| if still.iter().any(|run| run.contains(&at)) { 0.4 } else { 0.9 })
                .for_each(|base| freezes.show(base));
            (freezes.count(), freezes.frames())
        };
        // A hole of four frames is none; five, ten and twenty are three.
        assert_eq!(clip(std::slice::from_ref(&(5..9))), (0, 0));
        assert_eq!(clip(&[5..9, 20..25, 100..110, 400..420]), (3, 35));
        assert_eq!(clip(std::slice::from_ref(&(0..900))), (1, 900));
    }

    /// A picture and n frames without motion are (n + 1) intervals between pictures that move: a freeze from
    /// max(3 intervals, an interval + 150 ms) on.
    #[test]
    fn a_freeze_is_as_long_as_the_w3c_has_it() {
        for (per_second, least) in [(120, 18), (60, 9), (30, 5), (25, 4), (24, 4), (20, 3), (10, 2), (1, 2)] {
            for interval in [1_000_000_000u64 / per_second, 1_000_000_000u64.div_ceil(per_second)] {
                let count = |still: usize| {
                    let mut freezes = Freezes::new(Nanos(interval));
                    (0..still).for_each(|_| freezes.show(0.0));
                    (freezes.count(), freezes.frames())
                };
                assert_eq!(count(least - 1), (0, 0), "{per_second} frames per second");
                assert_eq!(count(least), (1, least as u64), "{per_second} frames per second");
            }
        }
    }
}
