//! A temporal basis describes how anything changes over time by a few numbers.

use serde::{Deserialize, Serialize};

/// Most splines side by side.
const MAX_SPLINES: usize = 8;
/// Most functions of a spline.
const MAX_FUNCTIONS: usize = 1024;

/// Functions over time 0 to 1: uniform cubic B-splines of several numbers of knots, side by side. The coarse
/// ones learn the large motion from few views, the fine ones add to it.
///
/// ```
/// let basis = trainer_host::train::motion::TemporalBasis::default();
/// assert_eq!(basis.len(), 28);
/// let (values, sum) = (basis.at(0.3), basis.at(0.3).iter().sum::<f32>());
/// // Each of the three splines is a partition of one.
/// assert!(values.len() == 28 && (sum - 3.0).abs() < 1e-5);
/// ```
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct TemporalBasis {
    /// Functions of each spline, at least 4.
    splines: Vec<usize>,
}

impl Default for TemporalBasis {
    fn default() -> Self {
        Self::new(&[4, 8, 16])
    }
}

impl TemporalBasis {
    /// Splines of so many functions each; fewer than 4 become 4.
    pub fn new(splines: &[usize]) -> Self {
        Self { splines: splines.iter().map(|&count| count.max(4)).collect() }
    }

    /// The same splines and one of `count` functions, at least 4, besides.
    pub(super) fn with(&self, count: usize) -> Self {
        Self { splines: self.splines.iter().copied().chain([count.max(4)]).collect() }
    }

    /// Functions of the finest spline.
    pub(super) fn finest(&self) -> usize {
        self.splines.iter().copied().max().unwrap_or(0)
    }

    /// Whether [`TemporalBasis::new`] could have made this: what was read from a file need not be.
    pub(super) fn is_sound(&self) -> bool {
        (1..=MAX_SPLINES).contains(&self.splines.len())
            && self.splines.iter().all(|count| (4..=MAX_FUNCTIONS).contains(count))
    }

    /// Number of functions.
    pub fn len(&self) -> usize {
        self.splines.iter().sum()
    }

    /// Whether there is no function.
    pub fn is_empty(&self) -> bool {
        self.splines.is_empty()
    }

    /// Every function at `time`, which is clamped to 0..=1.
    pub fn at(&self, time: f32) -> Vec<f32> {
        let mut values = Vec::with_capacity(self.len());
        for &count in &self.splines {
            let place = time.clamp(0.0, 1.0) * (count - 3) as f32;
            let first = (place as usize).min(count - 4);
            let x = place - first as f32;
            let y = 1.0 - x;
            let start = values.len();
            values.resize(start + count, 0.0);
            values[start + first..][..4].copy_from_slice(&[
                y * y * y / 6.0,
                (3.0 * x * x * x - 6.0 * x * x + 4.0) / 6.0,
                (3.0 * y * y * y - 6.0 * y * y + 4.0) / 6.0,
                x * x * x / 6.0,
            ]);
        }
        values
    }

    /// The second derivative over time of every function at `time`, which is clamped to 0..=1.
    pub(super) fn accelerations_at(&self, time: f32) -> Vec<f32> {
        let mut values = Vec::with_capacity(self.len());
        for &count in &self.splines {
            let knots = (count - 3) as f32;
            let place = time.clamp(0.0, 1.0) * knots;
            let first = (place as usize).min(count - 4);
            let x = place - first as f32;
            let start = values.len();
            values.resize(start + count, 0.0);
            let of_knots = [1.0 - x, 3.0 * x - 2.0, 1.0 - 3.0 * x, x];
            values[start + first..][..4].copy_from_slice(&of_knots.map(|v| v * knots * knots));
        }
        values
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn accelerations_are_second_differences() {
        let basis = TemporalBasis::new(&[4, 8, 16]);
        let step = 1e-2;
        // Inside one piece of every spline, where all are cubic: second differences are exact.
        for time in [0.02f32, 0.22, 0.5 - 0.02, 0.98] {
            let [before, at, after] = [time - step, time, time + step].map(|time| basis.at(time));
            for (index, found) in basis.accelerations_at(time).into_iter().enumerate() {
                let expected = (before[index] - 2.0 * at[index] + after[index]) / (step * step);
                assert!((found - expected).abs() < 0.02, "{time}, {index}: {found} {expected}");
            }
        }
    }

    #[test]
    fn times_outside_are_those_of_the_ends() {
        let basis = TemporalBasis::new(&[4, 8]);
        assert_eq!(basis.at(-3.0), basis.at(0.0));
        assert_eq!(basis.at(7.0), basis.at(1.0));
    }
}
