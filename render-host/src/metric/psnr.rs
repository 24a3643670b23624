//! Mean squared error and peak signal-to-noise ratio, data range 1.

use crate::image::{Image, ImageError, same_size};

/// Mean of squared differences over all channels of all pixels. Values are compared as they are, not
/// clamped. 0 for equal images; NaN when either holds one.
///
/// # Errors
/// Different sizes.
pub fn mse(test: &Image, reference: &Image) -> Result<f64, ImageError> {
    let (width, height) = same_size(test, reference)?;
    let squares = |a: &[f32], b: &[f32]| -> f64 {
        a.iter().zip(b).map(|(&a, &b)| (f64::from(a) - f64::from(b)).powi(2)).sum()
    };
    // Row sums first: fixed order, and better rounding than one long sum.
    let rows = test.rgb().chunks_exact(3 * width).zip(reference.rgb().chunks_exact(3 * width));
    let sum: f64 = rows.map(|(a, b)| squares(a, b)).sum();
    Ok(sum / (3 * width * height) as f64)
}

/// `-10 log₁₀(mse)`, dB, data range 1. Infinite for equal images.
///
/// # Errors
/// Different sizes.
pub fn psnr(test: &Image, reference: &Image) -> Result<f64, ImageError> {
    Ok(-10.0 * mse(test, reference)?.log10())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn known_values() {
        let a = Image::filled(10, 10, [0.5; 3]).unwrap();
        let b = Image::filled(10, 10, [0.6; 3]).unwrap();
        assert!((mse(&a, &b).unwrap() - 0.01).abs() < 1e-8);
        assert!((psnr(&a, &b).unwrap() - 20.0).abs() < 1e-5);
        assert_eq!(psnr(&a, &a).unwrap(), f64::INFINITY);
    }

    #[test]
    fn one_changed_value_shows_and_sizes_are_named() {
        let a = Image::filled(10, 10, [0.5; 3]).unwrap();
        let mut b = a.clone();
        b.rgb_mut()[17] += 0.5;
        assert!((mse(&b, &a).unwrap() - 0.25 / 300.0).abs() < 1e-12);
        b.rgb_mut()[17] = f32::NAN;
        assert!(mse(&b, &a).unwrap().is_nan());
        let wide = Image::filled(20, 5, [0.5; 3]).unwrap();
        let error = psnr(&a, &wide).unwrap_err().to_string();
        assert!(error.contains("10 x 10") && error.contains("20 x 5"), "{error}");
    }
}
