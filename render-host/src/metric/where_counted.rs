//! Compares pictures where their pixels count: a mask leaves the others out.
//!
//! A pixel that does not count is taken as equal to the reference, in the windows of its neighbours too, as
//! [`crate::adjoint::loss::photograph::PhotographLoss::with_pixel_weights`] has it.

use super::ssim::target::{Planes, Scratch, Target};
use crate::image::{Image, ImageError, same_size};

/// `test` with the pixels of `reference` where `counted`, one value per pixel, row by row, is 0.
///
/// # Errors
/// Different sizes, or not one value per pixel.
pub fn where_counted(test: &Image, reference: &Image, counted: &[u8]) -> Result<Image, ImageError> {
    same_size(test, reference)?;
    check(reference, counted)?;
    let mut out = test.clone();
    let pixels = out.rgb_mut().as_chunks_mut::<3>().0.iter_mut().zip(reference.rgb().as_chunks::<3>().0);
    for ((pixel, reference), _) in pixels.zip(counted).filter(|(_, counted)| **counted == 0) {
        *pixel = *reference;
    }
    Ok(out)
}

/// Structural similarity where pixels count: [`super::ssim()`] of [`where_counted()`], but the mean only over
/// windows whose middle counts. 1 where there is no such window.
///
/// # Errors
/// As [`where_counted`].
pub fn ssim_where_counted(test: &Image, reference: &Image, counted: &[u8]) -> Result<f64, ImageError> {
    let test = where_counted(test, reference, counted)?;
    let target = Target::new(reference);
    let (all, windows) = (target.all(), target.windows());
    let planes: Planes = std::array::from_fn(|c| test.rgb()[c..].iter().step_by(3).copied().collect());
    let mut similarities = vec![0.0; all.len()];
    target.similarities(&planes, &all, &mut Scratch::default(), &mut similarities);
    let middle = [windows.along.len() / 2, windows.down.len() / 2];
    let (mut sum, mut count) = (0.0, 0usize);
    for (at, similarity) in similarities.iter().enumerate() {
        let (x, y) = (at % all.columns.len() + middle[0], at / all.columns.len() + middle[1]);
        if counted[y * test.width() as usize + x] > 0 {
            sum += similarity;
            count += 3;
        }
    }
    Ok(if count > 0 { sum / count as f64 } else { 1.0 })
}

/// Refuses another number of values than `image` has pixels.
pub(crate) fn check(image: &Image, counted: &[u8]) -> Result<(), ImageError> {
    let (width, height) = image.size();
    let (found, needed) = (counted.len(), width as usize * height as usize);
    if found == needed { Ok(()) } else { Err(ImageError::Length { width, height, found, needed }) }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::metric::ssim;

    fn noise(seed: u32) -> Image {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        Image::new(40, 24, (0..3 * 40 * 24).map(|_| next()).collect()).unwrap()
    }

    #[test]
    fn what_does_not_count_is_equal_and_what_counts_is_compared() {
        let (a, b) = (noise(1), noise(2));
        let full = ssim_where_counted(&a, &b, &[255; 960]).unwrap();
        assert!((full - ssim(&a, &b).unwrap()).abs() < 1e-14);
        assert_eq!(ssim_where_counted(&a, &b, &[0; 960]).unwrap(), 1.0);
        // The left half counts, where pictures differ; on the right they may be anything.
        let left: Vec<u8> = (0..960).map(|at| u8::from(at % 40 < 20)).collect();
        let found = ssim_where_counted(&a, &b, &left).unwrap();
        let mut other = a.clone();
        for (at, pixel) in other.rgb_mut().chunks_mut(3).enumerate() {
            if at % 40 >= 20 {
                pixel.fill(7.0);
            }
        }
        assert_eq!(ssim_where_counted(&other, &b, &left).unwrap(), found);
        // Windows around uncounted pixels are not averaged in: they would be nearly equal.
        let diluted = ssim(&where_counted(&a, &b, &left).unwrap(), &b).unwrap();
        assert!(found < 0.5 && diluted > found + 0.2, "{found} {diluted}");
        assert!(where_counted(&a, &b, &left[1..]).unwrap_err().to_string().contains("found 959"));
        assert!(ssim_where_counted(&a, &Image::filled(24, 40, [0.0; 3]).unwrap(), &left).is_err());
    }
}
