//! Computes the exponential of the blend.

/// 2ˣ for x ≤ 0, with a relative error below 2e-7; 2⁻¹²⁶ for anything smaller and for NaN.
///
/// x = n + f with |f| ≤ 1/2; 2ᶠ by a minimax polynomial, 2ⁿ by exponent bits.
#[inline(always)]
pub(crate) fn exp2(x: f32) -> f32 {
    // Adding 1.5 · 2²³ leaves the nearest integer in the low bits.
    const ROUND: f32 = 12_582_912.0;
    let x = if x > -126.0 { x } else { -126.0 };
    let shifted = x + ROUND;
    let f = x - (shifted - ROUND);
    let p = POLY[6] * f + POLY[5];
    let p = p * f + POLY[4];
    let p = p * f + POLY[3];
    let p = p * f + POLY[2];
    let p = p * f + POLY[1];
    let p = p * f + POLY[0];
    p * f32::from_bits(shifted.to_bits().wrapping_add(127) << 23)
}

/// 2ᶠ on ±1/2, lowest power first: Remez, relative error 1.9e-9 before rounding to f32.
const POLY: [f32; 7] = [
    1.0,
    std::f32::consts::LN_2,
    0.240_226_47,
    0.055_503_29,
    0.009_618_489,
    0.001_339_993_1,
    0.000_153_458_12,
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn exp2_is_good_to_two_in_ten_million() {
        let mut worst = 0.0f64;
        for i in 0..=126_000 {
            let x = -(i as f32) / 1000.0;
            let exact = f64::from(x).exp2();
            worst = worst.max((f64::from(exp2(x)) / exact - 1.0).abs());
        }
        assert!(worst < 2e-7, "{worst}");
        assert_eq!(exp2(0.0).to_bits(), 1.0f32.to_bits());
        for x in [f32::NAN, f32::NEG_INFINITY, -1e30, -126.0] {
            assert!((exp2(x) / f32::MIN_POSITIVE - 1.0).abs() < 1e-6, "{x}");
        }
    }
}
