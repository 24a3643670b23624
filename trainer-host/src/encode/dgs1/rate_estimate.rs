//! Estimates what a coefficient costs: bits plus distortion in bits, at the slope of its quantiser.
//!
//! At high rate a uniform quantiser of step Δ has distortion D = Δ²/12 and dD/dR = −2 ln 2 · D, so
//! that one D of squared error weighs 1 / (2 ln 2) = 0.72 bits.

/// Bits that a squared error of one D is worth.
pub(in crate::encode) const PER_D: f64 = 0.721;
/// Bits of a coefficient that quantises to zero among others that do.
const ZERO_BITS: f64 = 0.3;
/// Bits of sign and of the shape of the distribution, beyond ½ log₂(c²/D).
const NONZERO_BITS: f64 = 1.2;

/// What coefficients of one quantiser cost.
#[derive(Clone, Copy, Debug)]
pub(super) struct RateEstimate {
    /// D, the quantiser's own mean squared error.
    d: f64,
}

impl RateEstimate {
    /// Of a quantiser of `step`.
    pub fn of_step(step: f32) -> Self {
        Self { d: f64::from(step).powi(2) / 12.0 }
    }

    /// Of leaving out coefficients of `energy` (a sum of squares).
    pub fn of_loss(&self, energy: f64) -> f64 {
        PER_D * energy / self.d
    }

    /// Of coding coefficient `c`.
    pub fn of(&self, c: f64) -> f64 {
        let ratio = c * c / self.d;
        // Up to half a step, c² = 3 D, a coefficient quantises to zero.
        if ratio < 3.0 { ZERO_BITS + PER_D * ratio } else { 0.5 * ratio.log2() + NONZERO_BITS + PER_D }
    }

    /// Of `row` in the orthonormal basis `vectors`, each coefficient coded or left out as is cheaper; at most
    /// `most` are coded, those that save most.
    pub fn of_row(&self, row: &[f64], vectors: &[Vec<f64>], most: usize) -> f64 {
        let energy = dot(row, row);
        if energy < self.d {
            return self.of_loss(energy);
        }
        let (mut cost, mut savings) = (0.0, Vec::new());
        for v in vectors {
            let c = dot(row, v);
            let (lost, coded) = (self.of_loss(c * c), self.of(c));
            cost += lost.min(coded);
            if coded < lost {
                savings.push(lost - coded);
            }
        }
        // Beyond `most`, coefficients that it would save to code are left out after all.
        savings.sort_by(|a, b| b.total_cmp(a));
        cost + savings.get(most..).unwrap_or_default().iter().sum::<f64>()
    }
}

/// The scalar product of `a` and `b`.
pub(super) fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn coding_pays_from_about_a_step_on_and_rates_rise_with_size() {
        let estimate = RateEstimate::of_step(1.0);
        for c in [0.0, 0.2, 0.4] {
            assert!(estimate.of_loss(c * c) < estimate.of(c), "{c}");
        }
        for c in [1.0, 3.0, 100.0] {
            assert!(estimate.of_loss(c * c) > estimate.of(c), "{c}");
        }
        assert!(estimate.of(8.0) - estimate.of(4.0) > 0.99 && estimate.of(8.0) - estimate.of(4.0) < 1.01);
    }

    #[test]
    fn a_row_costs_the_same_as_its_coefficients() {
        let s = 0.5f64.sqrt();
        let vectors = vec![vec![s, s], vec![s, -s]];
        let estimate = RateEstimate::of_step(0.1);
        let row = [3.0, 1.0];
        let both = estimate.of(4.0 * s) + estimate.of(2.0 * s);
        let of_row = |most: usize| estimate.of_row(&row, &vectors, most);
        assert!((of_row(2) - both).abs() < 1e-9 && of_row(2) == of_row(9));
        assert!((of_row(1) - estimate.of(4.0 * s) - estimate.of_loss(2.0)).abs() < 1e-9);
        assert!((of_row(0) - estimate.of_loss(10.0)).abs() < 1e-9);
        assert!(estimate.of_row(&[0.0, 0.0], &vectors, 2) == 0.0);
    }
}
