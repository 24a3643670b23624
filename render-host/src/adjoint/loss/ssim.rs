//! `1 - SSIM`, value and gradient in one sweep over bands of rows, with the windows of
//! [`crate::metric::ssim()`].
//!
//! With `e = x - y` the difference from the target, similarity falls from 1 by terms that all go to 0
//! with `e`: nothing of order 1 cancels, so f32 is enough where moments of `x` itself would need f64.
//! For a window with means `m·` and variances `v·`:
//!
//! ```text
//! vₑ = E[e²] - mₑ²    cov(y, e) = E[ye] - m_y·mₑ    m_x = m_y + mₑ
//! a₁ = 2·m_x·m_y + C₁    b₁ = a₁ + mₑ²    a₂ = 2(v_y + cov(y, e)) + C₂    b₂ = a₂ + vₑ
//! 1 - SSIM = vₑ/b₂ + (a₂/b₂)·mₑ²/b₁
//! ```
//!
//! The moments `e`, `e²`, `ye` of every window and, after it, what the loss changes with each, are
//! filtered along and then down; a ring of 11 rows holds what the filter down still needs, so a band
//! stays in the cache and no picture-sized temporary is made. Rows of a band's neighbours that it needs
//! are done again.

use std::{ops::Range, sync::Mutex};

use super::definition::Loss;
use crate::{
    image::{Image, ImageError, same_size},
    metric::ssim::{Windows, similarity},
    parallel,
};

use self::{
    rows::MARGIN,
    sweep::{Parts, Strip, Sweep, SweepMemory},
};
pub(crate) use rows::MIDDLE;
#[cfg(feature = "gpu")]
pub(crate) use sweep::FARTHEST;

pub(super) mod rows;
pub(super) mod sweep;

/// Rows in a band, about; part of the order of sums.
const BAND: usize = 64;

/// How unlike a target a picture is in structure.
///
/// A value further than 10⁶ from the target counts as that far.
#[derive(Debug)]
pub struct Dissimilarity {
    target: Image,
    windows: Windows,
    /// Weights by distance from the middle, 0 beyond the window.
    along: [f32; MIDDLE + 1],
    down: [f32; MIDDLE + 1],
    /// 1 where a window can be centred in a row, else 0: as long as a padded row.
    mask: Vec<f32>,
    /// Mean less ½ and variance of the target around each pixel, padded row by padded row.
    mean: Vec<f32>,
    variance: Vec<f32>,
    /// Scratch memory, passed from band to band; what it held does not matter.
    pool: Mutex<Vec<SweepMemory>>,
}

impl Dissimilarity {
    /// The distance from `target`. From an empty image every picture is refused.
    pub fn new(target: Image) -> Self {
        let (width, height) = (target.width() as usize, target.height() as usize);
        let windows = Windows::new(width.max(1), height.max(1));
        let halves = |weights: &[f64]| -> [f32; MIDDLE + 1] {
            std::array::from_fn(|k| weights.get(weights.len() / 2 + k).map_or(0.0, |&w| w as f32))
        };
        let (along, down) = (halves(&windows.along), halves(&windows.down));
        let padded = (3 * width.max(1)).next_multiple_of(MARGIN);
        let border = 3 * (windows.along.len() / 2);
        let mut mask = vec![0.0; padded];
        mask[border..][..3 * windows.columns].fill(1.0);
        let (mut mean, mut variance) = (vec![0.0; padded * height], vec![0.0; padded * height]);
        let mut rows: Vec<_> = mean.chunks_mut(padded).zip(variance.chunks_mut(padded)).collect();
        let radius = windows.down.len() / 2;
        let inside = rows.get_mut(radius..radius + windows.rows).unwrap_or_default();
        parallel::for_each(true, inside, |row, (mean, variance)| {
            let (means, squares) = target_moments(&target, &windows, row);
            for (i, (m, yy)) in means.iter().zip(&squares).enumerate() {
                (mean[border + i], variance[border + i]) = ((m - 0.5) as f32, (yy - m * m) as f32);
            }
        });
        Self { target, windows, along, down, mask, mean, variance, pool: Mutex::default() }
    }

    pub(super) fn target(&self) -> &Image {
        &self.target
    }

    /// The values of both parts; `weight` times their gradients go to `gradient`.
    pub(super) fn sweep(
        &self,
        image: &Image,
        parallel: bool,
        weight: Parts,
        gradient: &mut [f32],
    ) -> Result<Parts, ImageError> {
        let (width, height) = same_size(image, &self.target)?;
        let values = 3 * width * height;
        let rows = height.div_ceil((height / BAND).max(1));
        let scale = [
            (2.0 * weight.mse / values as f64) as f32,
            (weight.structure / self.windows.count() as f64) as f32,
        ];
        let mut bands: Vec<_> =
            gradient.chunks_mut(3 * width * rows).map(|out| (out, Parts::default())).collect();
        parallel::for_each(parallel, &mut bands, |index, (out, sums)| {
            let first = index * rows;
            let strip = Strip {
                x: image.rgb(),
                y: self.target.rgb(),
                size: [width, height],
                rows: first..(first + rows).min(height),
                centres: self.centres(),
                along: &self.along,
                down: &self.down,
                mask: &self.mask,
                mean: &self.mean,
                variance: &self.variance,
                scale,
            };
            let mut room = self.pool.lock().ok().and_then(|mut pool| pool.pop()).unwrap_or_default();
            *sums = pulp::Arch::new().dispatch(Sweep { strip, room: &mut room, out });
            if let Ok(mut pool) = self.pool.lock() {
                pool.push(room);
            }
        });
        let mut sums = Parts::default();
        for (_, band) in &bands {
            sums.mse += band.mse;
            sums.structure += band.structure;
        }
        Ok(Parts { mse: sums.mse / values as f64, structure: sums.structure / self.windows.count() as f64 })
    }

    /// Rows on which a window can be centred.
    fn centres(&self) -> Range<usize> {
        let radius = self.windows.down.len() / 2;
        radius..radius + self.windows.rows
    }
}

/// What the device's twin is told.
#[cfg(feature = "gpu")]
impl Dissimilarity {
    pub(crate) fn windows(&self) -> &Windows {
        &self.windows
    }

    /// Along and down, by distance from the middle, 0 beyond the window.
    pub(crate) fn weights(&self) -> [&[f32; MIDDLE + 1]; 2] {
        [&self.along, &self.down]
    }

    /// Columns and rows on which a window can be centred.
    pub(crate) fn columns_and_rows(&self) -> [Range<usize>; 2] {
        let radius = self.windows.along.len() / 2;
        [radius..radius + self.windows.columns, self.centres()]
    }

    /// Mean less ½ and variance of the target around each pixel: three planes, row by row; 0 where no
    /// window can be centred.
    pub(crate) fn target_planes(&self) -> Vec<[f32; 2]> {
        let (width, height) = (self.target.width() as usize, self.target.height() as usize);
        let padded = self.mask.len();
        let mut out = Vec::with_capacity(3 * width * height);
        for channel in 0..3 {
            for row in 0..height {
                let first = row * padded + channel;
                out.extend((0..width).map(|x| first + 3 * x).map(|at| [self.mean[at], self.variance[at]]));
            }
        }
        out
    }
}

impl Loss for Dissimilarity {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        let weight = Parts { mse: 0.0, structure: 1.0 };
        self.sweep(image, parallel, weight, gradient).map(|found| found.structure)
    }

    fn exact(&self, rgb: &[f64]) -> f64 {
        let target: Vec<f64> = self.target.rgb().iter().map(|&y| f64::from(y)).collect();
        exact(&self.windows, self.target.width() as usize, rgb, &target)
    }
}

/// `1 - SSIM` of x and y, r g b per pixel of rows of `width` pixels: every window, every weight.
pub(super) fn exact(windows: &Windows, width: usize, x: &[f64], y: &[f64]) -> f64 {
    let Windows { along, down, columns, rows } = windows;
    let mut sum = 0.0;
    for c in 0..3 {
        for row in 0..*rows {
            for column in 0..*columns {
                let mut moments = [0.0; 5];
                for (j, v) in down.iter().enumerate() {
                    for (i, u) in along.iter().enumerate() {
                        let at = 3 * ((row + j) * width + column + i) + c;
                        let (x, y) = (x[at], y[at]);
                        let values = [x, y, x * x, y * y, x * y];
                        moments.iter_mut().zip(values).for_each(|(m, value)| *m += u * v * value);
                    }
                }
                sum += similarity(moments);
            }
        }
    }
    1.0 - sum / windows.count() as f64
}

/// Moments y and y² of the windows of one row.
fn target_moments(target: &Image, windows: &Windows, row: usize) -> (Vec<f64>, Vec<f64>) {
    let side = 3 * target.width() as usize;
    let (mut tall, mut tall2) = (vec![0.0; side], vec![0.0; side]);
    for (source, weight) in target.rgb()[side * row..].chunks_exact(side).zip(&windows.down) {
        for ((sum, sum2), &y) in tall.iter_mut().zip(&mut tall2).zip(source) {
            let y = f64::from(y);
            *sum += weight * y;
            *sum2 += weight * y * y;
        }
    }
    let filter = |tall: &[f64]| -> Vec<f64> {
        let mut out = vec![0.0; 3 * windows.columns];
        for (k, weight) in windows.along.iter().enumerate() {
            out.iter_mut().zip(&tall[3 * k..]).for_each(|(sum, v)| *sum += weight * v);
        }
        out
    };
    (filter(&tall), filter(&tall2))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_empty_target_refuses_every_picture() {
        let loss = Dissimilarity::new(Image::default());
        let weight = Parts { mse: 1.0, structure: 1.0 };
        for image in [Image::default(), Image::filled(4, 4, [0.5; 3]).unwrap()] {
            let mut gradient = vec![0.0; image.rgb().len()];
            assert!(loss.sweep(&image, false, weight, &mut gradient).is_err());
        }
    }
}
