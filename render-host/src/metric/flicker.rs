//! Temporal error: change from frame to frame that the reference does not have.
//!
//! With `Δ` the difference of consecutive frames, flicker is the mean of `|Δtest - Δreference|` over all
//! channels, pixels and frame pairs. A constant error does not count; an error that comes and goes does,
//! twice. 0 for equal sequences, and for sequences of fewer than two frames.

use crate::image::{Image, ImageError, same_size};

/// Mean absolute difference of frame-to-frame changes, in display values per frame pair.
///
/// # Errors
/// Sequences of different lengths, or images of different sizes.
pub fn flicker(test: &[Image], reference: &[Image]) -> Result<f64, ImageError> {
    if test.len() != reference.len() {
        return Err(ImageError::Lengths { a: test.len(), b: reference.len() });
    }
    for image in test.iter().chain(reference) {
        same_size(image, &test[0])?;
    }
    let pairs = test.windows(2).zip(reference.windows(2));
    let changes = pairs.map(|(t, r)| {
        let values = t[0].rgb().iter().zip(t[1].rgb()).zip(r[0].rgb().iter().zip(r[1].rgb()));
        let sum: f64 = values
            .map(|((&t0, &t1), (&r0, &r1))| {
                let (dt, dr) = (f64::from(t1) - f64::from(t0), f64::from(r1) - f64::from(r0));
                (dt - dr).abs()
            })
            .sum();
        sum / t[0].rgb().len() as f64
    });
    let count = test.len().saturating_sub(1).max(1) as f64;
    // The sum of nothing is -0.
    Ok((changes.sum::<f64>() + 0.0) / count)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn frames(values: &[f32]) -> Vec<Image> {
        values.iter().map(|&v| Image::filled(4, 3, [v; 3]).unwrap()).collect()
    }

    #[test]
    fn one_picture_and_none_do_not_flicker() {
        for count in [0, 1] {
            let found = flicker(&frames(&vec![0.5; count]), &frames(&vec![0.1; count])).unwrap();
            assert_eq!(found.to_bits(), 0.0f64.to_bits(), "{count}: {found}");
        }
    }

    #[test]
    fn a_constant_error_does_not_flicker_and_a_flash_counts_twice() {
        let reference = frames(&[0.1, 0.2, 0.3, 0.4]);
        assert_eq!(flicker(&reference, &reference).unwrap(), 0.0);
        let shifted = frames(&[0.15, 0.25, 0.35, 0.45]);
        assert!(flicker(&shifted, &reference).unwrap() < 1e-7);
        let flash = frames(&[0.1, 0.2, 0.6, 0.4]);
        assert!((flicker(&flash, &reference).unwrap() - 0.2).abs() < 1e-6);
    }

    #[test]
    fn one_pixel_shows_and_shapes_are_checked() {
        let reference = frames(&[0.1, 0.1]);
        let mut test = reference.clone();
        test[1].rgb_mut()[7] += 0.36;
        assert!((flicker(&test, &reference).unwrap() - 0.01).abs() < 1e-6);
        let error = flicker(&test[..1], &reference).unwrap_err().to_string();
        assert!(error.contains("1 and 2"), "{error}");
        test[1] = Image::filled(3, 4, [0.0; 3]).unwrap();
        let error = flicker(&test, &reference).unwrap_err().to_string();
        assert!(error.contains("3 x 4") && error.contains("4 x 3"), "{error}");
        assert_eq!(flicker(&[], &[]).unwrap(), 0.0);
    }
}
