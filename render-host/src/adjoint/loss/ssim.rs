//! `1 - SSIM`, forward and backward in two sweeps, with the window of [`crate::metric::ssim()`].
//!
//! The first sweep filters the moments x, x², xy of each window row (those of the target are kept),
//! yields the sum and three coefficients per window: how the similarity changes with each moment. The
//! second filters these back. Both work on interleaved rows, down first and then along, in f64.

use std::sync::Mutex;

use super::Loss;
use crate::image::{Image, ImageError, same_size};
use crate::metric::ssim::{C1, C2, window};
use crate::parallel;

/// How unlike a target a picture is in structure.
#[derive(Debug)]
pub struct Dissimilarity {
    target: Image,
    /// Windows along and down, with their weights.
    along: Vec<f64>,
    down: Vec<f64>,
    /// Moments y and y² of every window: rows of y, then y².
    moments: Vec<f64>,
    /// Memory of the last sweep, to be used again; what it holds does not matter.
    scratch: Mutex<Vec<f64>>,
}

/// Samples filtered at a time, so that sums stay in the nearest cache.
const BLOCK: usize = 128;

/// Moments that depend on the picture.
const MOMENTS: usize = 3;

impl Dissimilarity {
    /// The distance from `target`.
    pub fn new(target: Image) -> Self {
        let (width, height) = (target.width() as usize, target.height() as usize);
        let (along, down) = (window(width), window(height));
        let (columns, rows) = (width + 1 - along.len(), height + 1 - down.len());
        let mut moments = vec![0.0; 2 * 3 * columns * rows];
        let values = target.rgb();
        parallel::for_each_chunk(true, &mut moments, 2 * 3 * columns, |row, out| {
            let sweep = Sweep { x: values, y: values, width, row, along: &along, down: &down };
            let [y, yy, _] = pulp::Arch::new().dispatch(sweep);
            out[..3 * columns].copy_from_slice(&y);
            out[3 * columns..].copy_from_slice(&yy);
        });
        Self { target, along, down, moments, scratch: Mutex::default() }
    }

    /// Adds `weight` times the gradient to `gradient`; returns the value without the weight.
    pub(super) fn add(
        &self,
        image: &Image,
        parallel: bool,
        weight: f64,
        gradient: &mut [f32],
    ) -> Result<f64, ImageError> {
        let (width, height) = same_size(image, &self.target)?;
        let Self { along, down, .. } = self;
        let (columns, rows) = (width + 1 - along.len(), height + 1 - down.len());
        let (x, y) = (image.rgb(), self.target.rgb());
        let windows = (3 * columns * rows) as f64;
        // Per window row: three runs of coefficients and the sum.
        let mut found = self.scratch.lock().map(|mut kept| std::mem::take(&mut *kept)).unwrap_or_default();
        found.resize(rows * (MOMENTS * 3 * columns + 1), 0.0);
        parallel::for_each_chunk(parallel, &mut found, MOMENTS * 3 * columns + 1, |row, out| {
            let arch = pulp::Arch::new();
            let moments = arch.dispatch(Sweep { x, y, width, row, along, down });
            let target = &self.moments[row * 2 * 3 * columns..][..2 * 3 * columns];
            arch.dispatch(|| similarity(&moments, target, out));
        });
        parallel::for_each_chunk(parallel, gradient, 3 * width, |row, out| {
            let (x, y) = (&x[3 * width * row..][..3 * width], &y[3 * width * row..][..3 * width]);
            let scale = -weight / windows;
            pulp::Arch::new()
                .dispatch(|| spread(&found, [columns, rows], row, [along, down], [x, y], scale, out));
        });
        let sums = found.chunks_exact(MOMENTS * 3 * columns + 1).map(|row| row[MOMENTS * 3 * columns]);
        let value = 1.0 - sums.sum::<f64>() / windows;
        if let Ok(mut kept) = self.scratch.lock() {
            *kept = found;
        }
        Ok(value)
    }
}

impl Loss for Dissimilarity {
    fn differentiate(&self, image: &Image, parallel: bool, gradient: &mut [f32]) -> Result<f64, ImageError> {
        gradient.fill(0.0);
        self.add(image, parallel, 1.0, gradient)
    }

    /// Every window, every weight.
    fn exact(&self, rgb: &[f64]) -> f64 {
        let (width, height) = (self.target.width() as usize, self.target.height() as usize);
        let (columns, rows) = (width + 1 - self.along.len(), height + 1 - self.down.len());
        let mut sum = 0.0;
        for c in 0..3 {
            for row in 0..rows {
                for column in 0..columns {
                    let [mut mx, mut my, mut xx, mut yy, mut xy] = [0.0; 5];
                    for (j, v) in self.down.iter().enumerate() {
                        for (i, u) in self.along.iter().enumerate() {
                            let at = 3 * ((row + j) * width + column + i) + c;
                            let (w, x, y) = (u * v, rgb[at], f64::from(self.target.rgb()[at]));
                            mx += w * x;
                            my += w * y;
                            xx += w * x * x;
                            yy += w * y * y;
                            xy += w * x * y;
                        }
                    }
                    let (vx, vy, cov) = (xx - mx * mx, yy - my * my, xy - mx * my);
                    sum +=
                        (2.0 * mx * my + C1) * (2.0 * cov + C2) / ((mx * mx + my * my + C1) * (vx + vy + C2));
                }
            }
        }
        1.0 - sum / (3 * columns * rows) as f64
    }
}

/// Moments x, x², xy of the windows of one row.
struct Sweep<'a> {
    x: &'a [f32],
    y: &'a [f32],
    width: usize,
    row: usize,
    along: &'a [f64],
    down: &'a [f64],
}

impl pulp::NullaryFnOnce for Sweep<'_> {
    type Output = [Vec<f64>; MOMENTS];

    #[inline(always)]
    fn call(self) -> Self::Output {
        let side = 3 * self.width;
        let mut tall: [Vec<f64>; MOMENTS] = std::array::from_fn(|_| vec![0.0; side]);
        let [m, xx, xy] = &mut tall;
        for first in (0..side).step_by(BLOCK) {
            let block = first..side.min(first + BLOCK);
            let (m, xx, xy) = (&mut m[block.clone()], &mut xx[block.clone()], &mut xy[block.clone()]);
            for (k, &weight) in self.down.iter().enumerate() {
                let start = (self.row + k) * side;
                let (x, y) = (&self.x[start..][block.clone()], &self.y[start..][block.clone()]);
                let sums = m.iter_mut().zip(xx.iter_mut()).zip(xy.iter_mut());
                for (((m, xx), xy), (&x, &y)) in sums.zip(x.iter().zip(y)) {
                    let (x, y) = (f64::from(x), f64::from(y));
                    let part = weight * x;
                    *m += part;
                    *xx += part * x;
                    *xy += part * y;
                }
            }
        }
        let columns = self.width + 1 - self.along.len();
        tall.map(|tall| {
            let mut out = vec![0.0; 3 * columns];
            filter(&tall, self.along, &mut out);
            out
        })
    }
}

/// `out[i] = Σ weights[k] · source[i + 3k]`.
#[inline(always)]
fn filter(source: &[f64], weights: &[f64], out: &mut [f64]) {
    for (block, out) in out.chunks_mut(BLOCK).enumerate() {
        for (k, &weight) in weights.iter().enumerate() {
            let source = &source[BLOCK * block + 3 * k..][..out.len()];
            for (out, source) in out.iter_mut().zip(source) {
                *out += weight * source;
            }
        }
    }
}

/// From moments to the sum of similarities and how it changes with x, x² and xy.
#[inline(always)]
fn similarity([mx, xx, xy]: &[Vec<f64>; MOMENTS], target: &[f64], out: &mut [f64]) {
    let n = mx.len();
    let (my, yy) = target.split_at(n);
    let (by_x, rest) = out.split_at_mut(n);
    let (by_xx, rest) = rest.split_at_mut(n);
    let (by_xy, last) = rest.split_at_mut(n);
    let (xx, xy, yy) = (&xx[..n], &xy[..n], &yy[..n]);
    let mut sum = 0.0;
    for i in 0..n {
        let (x, y) = (mx[i], my[i]);
        let (vx, vy, cov) = (xx[i] - x * x, yy[i] - y * y, xy[i] - x * y);
        let (a1, a2) = (2.0 * x * y + C1, 2.0 * cov + C2);
        let (b1, b2) = (x * x + y * y + C1, vx + vy + C2);
        let s = a1 * a2 / (b1 * b2);
        let (d_cov, d_vx) = (2.0 * a1 / (b1 * b2), -s / b2);
        by_x[i] = 2.0 * y * a2 / (b1 * b2) - 2.0 * x * s / b1 - 2.0 * x * d_vx - y * d_cov;
        by_xx[i] = d_vx;
        by_xy[i] = d_cov;
        sum += s;
    }
    last[0] = sum;
}

/// Adds `scale` times the gradient of the sum of similarities to one row of pixels.
#[inline(always)]
fn spread(
    found: &[f64],
    [columns, rows]: [usize; 2],
    row: usize,
    [along, down]: [&[f64]; 2],
    [x, y]: [&[f32]; 2],
    scale: f64,
    out: &mut [f32],
) {
    let n = 3 * columns;
    let border = 3 * (along.len() - 1);
    let mut wide: [Vec<f64>; MOMENTS] = std::array::from_fn(|_| vec![0.0; n + 2 * border]);
    let mut flat: [Vec<f64>; MOMENTS] = std::array::from_fn(|_| vec![0.0; out.len()]);
    for (k, &weight) in down.iter().enumerate() {
        let Some(from) = row.checked_sub(k).filter(|&from| from < rows) else { continue };
        let source = &found[from * (MOMENTS * n + 1)..][..MOMENTS * n];
        for (wide, source) in wide.iter_mut().zip(source.chunks_exact(n)) {
            for (sum, source) in wide[border..][..n].iter_mut().zip(source) {
                *sum += weight * source;
            }
        }
    }
    // The window is symmetric, so filtering forwards is filtering backwards.
    flat.iter_mut().zip(&wide).for_each(|(flat, wide)| filter(wide, along, flat));
    let [by_x, by_xx, by_xy] = &flat;
    for i in 0..out.len() {
        let (vx, vy) = (f64::from(x[i]), f64::from(y[i]));
        out[i] += (scale * (by_x[i] + 2.0 * vx * by_xx[i] + vy * by_xy[i])) as f32;
    }
}
