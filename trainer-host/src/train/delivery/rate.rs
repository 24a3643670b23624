//! Estimates the bits of quantised values by a model of their distribution, with its slope.
//!
//! A cluster's values of one component are modelled as Laplace about their mean with their mean distance as
//! scale, which are measured once per encoding and then stay. A value costs the logarithm of the probability
//! of its quantiser's cell, at the value itself instead of the cell's centre, so that the estimate has a
//! slope.

use std::f64::consts::LN_2;

/// A Laplace distribution over cells of one quantiser.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(in crate::train) struct Laplace {
    mean: f64,
    /// Mean distance from the mean, at least a twentieth of a step: no cell is certain.
    scale: f64,
    step: f64,
}

impl Laplace {
    /// The distribution of `values` in cells of `step`, positive and in the values' unit.
    pub(in crate::train) fn of(values: impl Iterator<Item = f64> + Clone, step: f64) -> Self {
        let count = values.clone().count().max(1) as f64;
        let mean = values.clone().sum::<f64>() / count;
        let distance = values.map(|v| (v - mean).abs()).sum::<f64>() / count;
        Self { mean, scale: distance.max(0.05 * step), step }
    }

    /// The distribution about 0 of whole numbers, in cells of 1, whose cells have their mean distance.
    pub(in crate::train) fn of_cells(values: impl Iterator<Item = f64>) -> Self {
        let (mut count, mut sum) = (0.0, 0.0);
        for value in values {
            count += 1.0;
            sum += value.abs();
        }
        // Cells of a scale s have the mean distance 1 / (2 sinh(1 / 2s)).
        let distance = sum / f64::max(count, 1.0);
        let scale = if distance > 0.0 { 0.5 / (0.5 / distance).asinh() } else { 0.0 };
        Self { mean: 0.0, scale: scale.max(0.05), step: 1.0 }
    }

    /// Bits of a cell about `value`, and their slope per unit of the value.
    pub(in crate::train) fn bits(&self, value: f64) -> (f64, f64) {
        let (distance, sign) = ((value - self.mean).abs(), (value - self.mean).signum());
        let half = 0.5 * self.step;
        if distance >= half {
            // P = exp(−d / s) · sinh(h / s)
            let ratio = half / self.scale;
            let log_sinh = ratio + (-(-2.0 * ratio).exp_m1() / 2.0).ln();
            return ((distance / self.scale - log_sinh) / LN_2, sign / (self.scale * LN_2));
        }
        // The cell holds the mean: P = 1 − exp(−h / s) · cosh(d / s)
        let low = (-half / self.scale).exp();
        let probability = 1.0 - low * (distance / self.scale).cosh();
        let slope = low * (distance / self.scale).sinh() / self.scale / probability;
        (-probability.log2(), sign * slope / LN_2)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn probabilities_of_all_cells_sum_to_one() {
        let model = Laplace { mean: 0.3, scale: 0.7, step: 0.25 };
        let cells = (-400..400).map(|q| 2f64.powf(-model.bits(0.25 * f64::from(q)).0));
        assert!((cells.sum::<f64>() - 1.0).abs() < 1e-9);
    }

    #[test]
    fn slopes_are_differences_and_a_wrong_slope_is_found() {
        let model = Laplace { mean: -0.1, scale: 0.4, step: 0.3 };
        for value in [-2.0, -0.3, -0.12, 0.0, 0.04, 0.7, 3.0] {
            let h = 1e-6;
            let numeric = (model.bits(value + h).0 - model.bits(value - h).0) / (2.0 * h);
            let found = model.bits(value).1;
            assert!((found - numeric).abs() < 1e-5, "{value}: {found} {numeric}");
            assert!((0.9 * found - numeric).abs() > 1e-5 || found.abs() < 1e-3);
        }
    }

    #[test]
    fn cells_of_a_distribution_have_the_distance_it_was_made_from() {
        for distance in [0.1, 0.5, 3.0] {
            let model = Laplace::of_cells([distance, -distance].into_iter());
            let mean = (-400..400).map(|q| f64::from(q).abs() * 2f64.powf(-model.bits(f64::from(q)).0));
            let mean: f64 = mean.sum();
            assert!((mean - distance).abs() < 1e-6, "{mean} {distance}");
        }
        assert!(Laplace::of_cells([0.0, 0.0].into_iter()).bits(0.0).0 < 1e-3);
    }

    /// Bits of symbols that follow the model are their entropy, within sampling.
    #[test]
    fn it_is_the_entropy_of_symbols() {
        let step = 0.2;
        let values: Vec<f64> = (0..20_000)
            .map(|i| {
                let u = (f64::from(i) + 0.5) / 20_000.0 - 0.5;
                -0.5 * u.signum() * (1.0 - 2.0 * u.abs()).ln()
            })
            .collect();
        let model = Laplace::of(values.iter().copied(), step);
        let mut counts = std::collections::BTreeMap::new();
        let mut estimate = 0.0;
        for value in &values {
            let q = (value / step).round();
            *counts.entry(q as i64).or_insert(0.0) += 1.0;
            estimate += model.bits(q * step).0;
        }
        let n = values.len() as f64;
        let entropy: f64 = counts.values().map(|c: &f64| -c * (c / n).log2()).sum();
        assert!((estimate / entropy - 1.0).abs() < 0.01, "{estimate} {entropy}");
        let coarse = Laplace::of(values.iter().copied(), 2.0 * step);
        assert!(coarse.bits(1.0).0 < model.bits(1.0).0, "coarser cells cost less");
    }
}
