//! Stores colour and shape of a splat in 16 bits each, for the setting `half_attributes`.
//!
//! What f16 cannot hold goes to its nearest finite value, and what must stay above 0 to its smallest one,
//! so that a rounded splat is a splat.

use half::f16;

/// Ellipses are kept apart from no ellipse: the smallest f16 above 0.
const LEAST: f64 = 5.960_464_477_539_063e-8;

/// The nearest finite f16.
fn nearest(value: f64) -> f64 {
    let most = f64::from(f16::MAX);
    f16::from_f64(value.clamp(-most, most)).to_f64()
}

/// A display colour, ≥ 0 and finite.
pub(super) fn colour(colour: [f32; 3]) -> [f32; 3] {
    colour.map(|c| nearest(f64::from(c)) as f32)
}

/// The factor of a splat, `[xx, xy, yy]`.
pub(super) fn root([xx, xy, yy]: [f64; 3]) -> [f64; 3] {
    [nearest(xx).max(LEAST), nearest(xy), nearest(yy).max(LEAST)]
}

/// Variances along x and y, pixels², of the ellipse with this factor.
pub(super) fn variance([xx, xy, yy]: [f64; 3]) -> [f64; 2] {
    let unit = 0.5 * std::f64::consts::LOG2_E;
    let skew = xy / yy;
    [unit * (1.0 + skew * skew) / (xx * xx), unit / (yy * yy)]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn rounding_is_that_of_ten_bits_and_stays_in_range() {
        for v in [1.0f32, 0.1, 3.7, 123.4, 1e-3] {
            let got = colour([v; 3])[0];
            assert!((got / v - 1.0).abs() <= 1.0 / 2048.0 && got.to_bits() & 0x1fff == 0, "{v} {got}");
        }
        assert_eq!(colour([1e30, 0.0, 1e-30]), [65504.0, 0.0, 0.0]);
        assert_eq!(root([1e-30, -1e30, 0.0]), [LEAST, -65504.0, LEAST]);
        assert_eq!(f16::from_bits(1).to_f64(), LEAST);
    }

    #[test]
    fn variance_undoes_the_factor() {
        // Σ = ½ log₂e (RᵀR)⁻¹ with R = [[xx, xy], [0, yy]].
        let [xx, xy, yy] = [0.7, -0.4, 0.3f64];
        let (a, b, c) = (xx * xx, xx * xy, xy * xy + yy * yy);
        let (det, unit) = (a * c - b * b, 0.5 * std::f64::consts::LOG2_E);
        let [x, y] = variance([xx, xy, yy]);
        assert!((x - unit * c / det).abs() < 1e-12 && (y - unit * a / det).abs() < 1e-12);
    }
}
