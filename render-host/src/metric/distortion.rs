//! The distortion that encoders and schedulers minimise: squared error with a share of structure.

use super::{mse, ssim};
use crate::image::{Image, ImageError};

/// Weight of `1 - SSIM`. Source: the paper's distortion.
pub const STRUCTURE_WEIGHT: f64 = 0.20;

/// `MSE + 0.20 (1 - SSIM)`: 0 for equal images, data range 1.
///
/// # Errors
/// Different sizes.
pub fn distortion(test: &Image, reference: &Image) -> Result<f64, ImageError> {
    Ok(mse(test, reference)? + STRUCTURE_WEIGHT * (1.0 - ssim(test, reference)?))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_is_the_sum_of_its_parts_and_sees_one_pixel() {
        let a = Image::filled(16, 16, [0.5; 3]).unwrap();
        assert_eq!(distortion(&a, &a).unwrap(), 0.0);
        let mut b = a.clone();
        b.rgb_mut()[400] = 0.9;
        let parts = mse(&b, &a).unwrap() + 0.2 * (1.0 - ssim(&b, &a).unwrap());
        let whole = distortion(&b, &a).unwrap();
        assert!(whole > 1e-4 && whole == parts, "{whole} {parts}");
        assert!(distortion(&a, &Image::filled(8, 16, [0.5; 3]).unwrap()).is_err());
    }
}
