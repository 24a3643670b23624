//! A frame rate is held as a fraction, so that times of pictures are exact.

use crate::error::VideoError;

/// Pictures per second, `numerator / denominator`, both at most `i32::MAX`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct FrameRate {
    /// Ticks of a clock per second.
    pub numerator: u32,
    /// Ticks from one picture to the next.
    pub denominator: u32,
}

/// How far a fraction may be from the rate that it stands for, as a share of it.
const TOLERANCE: f64 = 1e-12;

impl FrameRate {
    /// The shortest fraction that is `frames_per_second` as far as numbers of 64 bits tell them apart.
    ///
    /// # Errors
    /// A rate below 0.001 or above 10000.
    pub fn of(frames_per_second: f64) -> Result<Self, VideoError> {
        if !(0.001..=10_000.0).contains(&frames_per_second) {
            return Err(VideoError::Rate(frames_per_second));
        }
        // Convergents of the continued fraction: each is the best of its length.
        let (mut before, mut last) = ((0, 1), (1, 0));
        let mut rest = frames_per_second;
        loop {
            let whole = rest.floor();
            let next = (whole as i64 * last.0 + before.0, whole as i64 * last.1 + before.1);
            if next.0.max(next.1) > i64::from(i32::MAX) {
                break;
            }
            (before, last) = (last, next);
            let error = (last.0 as f64 / last.1 as f64 / frames_per_second - 1.0).abs();
            rest = 1.0 / (rest - whole);
            if error <= TOLERANCE || !(1.0..=f64::from(i32::MAX)).contains(&rest) {
                break;
            }
        }
        Ok(Self { numerator: last.0 as u32, denominator: last.1 as u32 })
    }

    /// When picture `index` is shown, in ticks of `per_second`, rounded to the nearest.
    pub fn ticks(self, index: u64, per_second: u64) -> u64 {
        let numerator = u128::from(self.numerator);
        let ticks = u128::from(index) * u128::from(self.denominator) * u128::from(per_second);
        ((ticks + numerator / 2) / numerator) as u64
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rates_are_the_shortest_fractions() {
        for (rate, fraction) in [
            (30.0, (30, 1)),
            (12.5, (25, 2)),
            (29.97, (2997, 100)),
            (30_000.0 / 1001.0, (30_000, 1001)),
            (0.001, (1, 1000)),
            (10_000.0, (10_000, 1)),
            (1.0 / 3.0, (1, 3)),
        ] {
            let found = FrameRate::of(rate).unwrap();
            assert_eq!((found.numerator, found.denominator), fraction, "{rate}");
        }
        for rate in [0.7, std::f64::consts::PI, 59.123_456_789, 9_999.999_9, 0.001_234_567_8] {
            let found = FrameRate::of(rate).unwrap();
            let error = (f64::from(found.numerator) / f64::from(found.denominator) / rate - 1.0).abs();
            assert!(error < 1e-9, "{rate}: {found:?}");
        }
        for rate in [0.0, -1.0, f64::NAN, f64::INFINITY, 10_001.0] {
            assert!(FrameRate::of(rate).unwrap_err().to_string().contains("0.001 to 10000"), "{rate}");
        }
    }

    #[test]
    fn times_do_not_drift() {
        let rate = FrameRate::of(30_000.0 / 1001.0).unwrap();
        assert_eq!(rate.ticks(30_000, 1000), 1_001_000);
        assert_eq!(rate.ticks(1, 1000), 33);
        assert_eq!(rate.ticks(2, 1000), 67);
    }
}
