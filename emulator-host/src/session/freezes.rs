//! Counts freezes: what is shown stands still for so long that people notice.

use crate::clock::Nanos;

/// A frame of whose base less than this share is there shows no motion of its own.
const MIN_BASE: f64 = 0.5;
/// Frames without motion in a row are a freeze once they last longer than this and a frame. Source: the W3C's
/// Identifiers for WebRTC's Statistics API, `freezeCount`.
const NOTICED: Nanos = Nanos::from_ms(150);

/// The freezes of a playout, frame by frame. Playout never waits once it has begun: what has not come shows
/// as a freeze.
///
/// ```
/// use emulator_host::{Nanos, session::Freezes};
///
/// let mut freezes = Freezes::new(Nanos::from_ms(40));
/// [1.0, 0.2, 0.2, 0.2, 0.2, 0.2, 1.0].iter().for_each(|base| freezes.show(*base));
/// assert_eq!((freezes.count(), freezes.frames()), (1, 5), "200 ms in a row");
/// ```
#[derive(Clone, Copy, Debug)]
pub struct Freezes {
    /// Frames in a row that go unnoticed.
    unnoticed: u64,
    /// Frames without motion up to now.
    still: u64,
    count: u64,
    frames: u64,
}

impl Freezes {
    /// None yet, where each frame is shown for `interval`.
    pub fn new(interval: Nanos) -> Self {
        Self { unnoticed: NOTICED.0 / interval.0.max(1) + 1, still: 0, count: 0, frames: 0 }
    }

    /// A frame is shown, and `base` of its base is there, 0 to 1.
    pub fn show(&mut self, base: f64) {
        self.still = if base < MIN_BASE { self.still + 1 } else { 0 };
        if self.still == self.unnoticed + 1 {
            self.count += 1;
            self.frames += self.still;
        } else if self.still > self.unnoticed {
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
        // A hole of five frames is none; ten and twenty are two.
        assert_eq!(clip(std::slice::from_ref(&(5..10))), (0, 0));
        assert_eq!(clip(&[5..10, 100..110, 400..420]), (2, 30));
        assert_eq!(clip(std::slice::from_ref(&(0..900))), (1, 900));
    }
}
