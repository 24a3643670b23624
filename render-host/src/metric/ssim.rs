//! Structural similarity (Wang et al. 2004): Gaussian window of 11 × 11, σ = 1.5, K₁ = 0.01, K₂ = 0.03,
//! data range 1, mean over channels.
//!
//! Only windows wholly inside the image count (the paper's valid region). On an image with a side below
//! 11 the window shrinks along that side to the largest odd size that fits, and its weights are
//! normalised again, so every image has a value.
//!
//! The window is separable: five moments are filtered along rows, then along columns, in f64.

use crate::{
    image::{Image, ImageError, same_size},
    parallel,
};

pub(crate) mod target;

/// Side of the window, pixels.
pub const WINDOW: usize = 11;
/// Standard deviation of the window, pixels.
pub const SIGMA: f64 = 1.5;
pub(crate) const C1: f64 = 0.01 * 0.01;
pub(crate) const C2: f64 = 0.03 * 0.03;
/// x, y, x², y², xy.
const MOMENTS: usize = 5;

/// Mean structural similarity, at most 1; exactly 1 for equal images.
///
/// # Errors
/// Different sizes.
pub fn ssim(test: &Image, reference: &Image) -> Result<f64, ImageError> {
    let (width, height) = same_size(test, reference)?;
    let windows = Windows::new(width, height);
    let Windows { along, down, columns, rows } = &windows;
    let (columns, rows) = (*columns, *rows);
    let mut total = 0.0;
    for channel in 0..3 {
        let plane = |image: &Image| -> Vec<f64> {
            image.rgb()[channel..].iter().step_by(3).map(|&v| f64::from(v)).collect()
        };
        let (x, y) = (plane(test), plane(reference));
        let mut wide = vec![0.0; MOMENTS * columns * height];
        parallel::for_each_chunk(true, &mut wide, MOMENTS * columns, |row, out| {
            moments_along(&x[row * width..][..width], &y[row * width..][..width], along, out);
        });
        let mut sums = vec![0.0; rows];
        parallel::for_each_chunk(true, &mut sums, 1, |row, sum| {
            let mut moments = vec![0.0; MOMENTS * columns];
            for (k, weight) in down.iter().enumerate() {
                let source = &wide[(row + k) * MOMENTS * columns..][..MOMENTS * columns];
                moments.iter_mut().zip(source).for_each(|(m, s)| *m += weight * s);
            }
            sum[0] = (0..columns)
                .map(|i| similarity(std::array::from_fn(|moment| moments[moment * columns + i])))
                .sum();
        });
        total += sums.iter().sum::<f64>();
    }
    Ok(total / windows.count() as f64)
}

/// Weighted moments of every window position of one row: five runs of `out.len() / 5` values.
fn moments_along(x: &[f64], y: &[f64], weights: &[f64], out: &mut [f64]) {
    let columns = out.len() / MOMENTS;
    for (k, &weight) in weights.iter().enumerate() {
        let (x, y) = (&x[k..k + columns], &y[k..k + columns]);
        let mut add = |moment: usize, value: &dyn Fn(f64, f64) -> f64| {
            let out = &mut out[moment * columns..][..columns];
            for ((sum, &x), &y) in out.iter_mut().zip(x).zip(y) {
                *sum += weight * value(x, y);
            }
        };
        add(0, &|x, _| x);
        add(1, &|_, y| y);
        add(2, &|x, _| x * x);
        add(3, &|_, y| y * y);
        add(4, &|x, y| x * y);
    }
}

/// Similarity of two windows from their weighted moments x, y, x², y², xy.
#[inline(always)]
pub(crate) fn similarity([mx, my, xx, yy, xy]: [f64; MOMENTS]) -> f64 {
    let (vx, vy, cov) = (xx - mx * mx, yy - my * my, xy - mx * my);
    (2.0 * mx * my + C1) * (2.0 * cov + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2))
}

/// The windows of an image.
#[derive(Clone, Debug)]
pub(crate) struct Windows {
    /// Weights along a row, an odd number of them with sum 1.
    pub(crate) along: Vec<f64>,
    /// Weights down a column, likewise.
    pub(crate) down: Vec<f64>,
    /// Positions along a row.
    pub(crate) columns: usize,
    /// Positions down a column.
    pub(crate) rows: usize,
}

impl Windows {
    /// Of an image with sides of at least 1 pixel.
    pub(crate) fn new(width: usize, height: usize) -> Self {
        let (along, down) = (weights(width), weights(height));
        let (columns, rows) = (width + 1 - along.len(), height + 1 - down.len());
        Self { along, down, columns, rows }
    }

    /// Windows of all three channels.
    pub(crate) fn count(&self) -> usize {
        3 * self.columns * self.rows
    }
}

/// Normalised Gaussian weights of the largest odd window up to [`WINDOW`] that fits `side` pixels.
fn weights(side: usize) -> Vec<f64> {
    let radius = (WINDOW.min(side) - 1) / 2;
    let weight = |i: usize| (-0.5 * ((i as f64 - radius as f64) / SIGMA).powi(2)).exp();
    let weights: Vec<f64> = (0..=2 * radius).map(weight).collect();
    let sum: f64 = weights.iter().sum();
    weights.into_iter().map(|w| w / sum).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn noise(width: u32, height: u32, seed: u32) -> Image {
        let mut state = seed;
        let mut next = || {
            state = state.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            (state >> 8) as f32 / (1u32 << 24) as f32
        };
        Image::new(width, height, (0..3 * width * height).map(|_| next()).collect()).unwrap()
    }

    /// The definition: every window, every weight, two passes of moments about the mean.
    fn direct(a: &Image, b: &Image) -> f64 {
        let (w, h) = (a.width() as usize, a.height() as usize);
        let (wx, wy) = (weights(w), weights(h));
        let (mut sum, mut n) = (0.0, 0);
        for c in 0..3 {
            for y in 0..=h - wy.len() {
                for x in 0..=w - wx.len() {
                    let sample = |image: &Image, i: usize, j: usize| {
                        f64::from(image.rgb()[3 * ((y + j) * w + x + i) + c])
                    };
                    let mean = |f: &dyn Fn(usize, usize) -> f64| {
                        let mut m = 0.0;
                        for (j, v) in wy.iter().enumerate() {
                            for (i, u) in wx.iter().enumerate() {
                                m += u * v * f(i, j);
                            }
                        }
                        m
                    };
                    let (ma, mb) = (mean(&|i, j| sample(a, i, j)), mean(&|i, j| sample(b, i, j)));
                    let va = mean(&|i, j| (sample(a, i, j) - ma).powi(2));
                    let vb = mean(&|i, j| (sample(b, i, j) - mb).powi(2));
                    let cov = mean(&|i, j| (sample(a, i, j) - ma) * (sample(b, i, j) - mb));
                    sum +=
                        (2.0 * ma * mb + C1) / (ma * ma + mb * mb + C1) * (2.0 * cov + C2) / (va + vb + C2);
                    n += 1;
                }
            }
        }
        sum / n as f64
    }

    #[test]
    fn it_equals_the_definition_on_every_shape() {
        for (w, h) in [(23, 17), (11, 11), (12, 5), (4, 30), (1, 1), (2, 11)] {
            let (a, b) = (noise(w, h, 1), noise(w, h, 2));
            let (fast, slow) = (ssim(&a, &b).unwrap(), direct(&a, &b));
            assert!((fast - slow).abs() < 1e-12, "{w} {h}: {fast} {slow}");
        }
    }

    #[test]
    fn equal_is_one_and_a_changed_pixel_is_not() {
        let a = noise(32, 24, 3);
        assert_eq!(ssim(&a, &a).unwrap(), 1.0);
        let mut b = a.clone();
        b.rgb_mut()[3 * (12 * 32 + 16)] += 0.2;
        let changed = ssim(&a, &b).unwrap();
        assert!(changed < 0.9999, "{changed}");
        assert_eq!(changed, ssim(&b, &a).unwrap(), "symmetric");
        let error = ssim(&a, &noise(24, 32, 3)).unwrap_err().to_string();
        assert!(error.contains("32 x 24") && error.contains("24 x 32"), "{error}");
    }

    #[test]
    fn flat_images_have_the_luminance_term_alone() {
        let a = Image::filled(20, 20, [0.4; 3]).unwrap();
        let b = Image::filled(20, 20, [0.6; 3]).unwrap();
        let expected = (2.0 * 0.24 + C1) / (0.16 + 0.36 + C1);
        assert!((ssim(&a, &b).unwrap() - expected).abs() < 1e-6);
    }
}
