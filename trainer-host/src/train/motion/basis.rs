//! A temporal basis describes how anything changes over time by a few numbers.

use serde::{Deserialize, Serialize};

/// Most splines side by side.
const MOST_SPLINES: usize = 8;
/// Most functions of a spline.
const MOST_FUNCTIONS: usize = 1024;

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
        (1..=MOST_SPLINES).contains(&self.splines.len())
            && self.splines.iter().all(|count| (4..=MOST_FUNCTIONS).contains(count))
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

    /// Coefficients of the functions whose sum is nearest to samples at even times from 0 to 1, by least
    /// squares: `samples[s]` holds as many values as every other; the answer has one list per function.
    pub(super) fn fit(&self, samples: &[Vec<f64>]) -> Vec<Vec<f64>> {
        let (count, width) = (self.len(), samples.first().map_or(0, Vec::len));
        let last = samples.len().saturating_sub(1).max(1) as f32;
        // Normal equations; the splines overlap, so a little weight on small coefficients decides.
        let mut matrix = vec![vec![0.0f64; count]; count];
        let mut right = vec![vec![0.0f64; width]; count];
        for (index, sample) in samples.iter().enumerate() {
            let values = self.at(index as f32 / last);
            for (a, &of_a) in values.iter().enumerate().filter(|(_, v)| **v != 0.0) {
                for (sum, &of_b) in matrix[a].iter_mut().zip(&values) {
                    *sum += f64::from(of_a) * f64::from(of_b);
                }
                right[a].iter_mut().zip(sample).for_each(|(sum, v)| *sum += f64::from(of_a) * v);
            }
        }
        (0..count).for_each(|a| matrix[a][a] += 1e-4);
        solve(matrix, right)
    }
}

/// Solves a symmetric positive system for several right sides by elimination.
fn solve(mut matrix: Vec<Vec<f64>>, mut right: Vec<Vec<f64>>) -> Vec<Vec<f64>> {
    let count = matrix.len();
    for a in 0..count {
        let (done, below) = matrix.split_at_mut(a + 1);
        let (done_right, below_right) = right.split_at_mut(a + 1);
        for (row, values) in below.iter_mut().zip(below_right) {
            let factor = row[a] / done[a][a];
            row.iter_mut().zip(&done[a]).for_each(|(v, d)| *v -= factor * d);
            values.iter_mut().zip(&done_right[a]).for_each(|(v, d)| *v -= factor * d);
        }
    }
    for a in (0..count).rev() {
        let (above, known) = right.split_at_mut(a + 1);
        for (k, known) in known.iter().enumerate() {
            let factor = matrix[a][a + 1 + k];
            above[a].iter_mut().zip(known).for_each(|(v, d)| *v -= factor * d);
        }
        above[a].iter_mut().for_each(|v| *v /= matrix[a][a]);
    }
    right
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn fitted_coefficients_give_the_samples_back() {
        let basis = TemporalBasis::default();
        let sample = |t: f64| vec![0.5 - t, (3.0 * t).sin(), t * t];
        let samples: Vec<Vec<f64>> = (0..112).map(|s| sample(f64::from(s) / 111.0)).collect();
        let found = basis.fit(&samples);
        for t in [0.0f32, 0.21, 0.77, 1.0] {
            let values = basis.at(t);
            for (k, expected) in sample(f64::from(t)).into_iter().enumerate() {
                let sum: f64 = values.iter().zip(&found).map(|(&v, c)| f64::from(v) * c[k]).sum();
                assert!((sum - expected).abs() < 2e-3, "{t} {k}: {sum} {expected}");
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
