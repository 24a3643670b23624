//! One band of rows: filters in rings of rows, written so that the compiler makes vectors of them.
//!
//! A row is interleaved r g b, padded to whole vectors. Nothing is fused or reordered, so every vector
//! width gives the same bits.

use std::ops::Range;

use super::rows::{MARGIN, MIDDLE, Pack, Ring, down, filter, total};
use crate::metric::ssim::{C1, C2, WINDOW};

/// Largest difference that counts.
pub(crate) const FARTHEST: f32 = 1e6;
/// Filtered quantities: three moments, then three slopes.
const KINDS: usize = 3;

/// Scratch memory of a band.
#[derive(Debug, Default)]
pub(super) struct SweepMemory {
    moments: Ring,
    slopes: Ring,
    /// Rows to be filtered along, with margins of zeros.
    flat: [Vec<f32>; KINDS],
}

/// What a sweep adds up, and how much of each goes to the gradient.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Parts {
    /// Mean squared error.
    pub(crate) mse: f64,
    /// `1 - SSIM`.
    pub(crate) structure: f64,
}

/// What a band is made from.
pub(super) struct Strip<'a> {
    pub(super) x: &'a [f32],
    pub(super) y: &'a [f32],
    /// Width and height, pixels.
    pub(super) size: [usize; 2],
    /// Rows whose gradient is wanted.
    pub(super) rows: Range<usize>,
    /// Rows on which a window can be centred.
    pub(super) centres: Range<usize>,
    pub(super) along: &'a [f32; MIDDLE + 1],
    pub(super) down: &'a [f32; MIDDLE + 1],
    pub(super) mask: &'a [f32],
    pub(super) mean: &'a [f32],
    pub(super) variance: &'a [f32],
    /// Of the squared error and of `1 - SSIM`.
    pub(super) scale: [f32; 2],
}

/// Writes the gradient of the band to `out`; yields sums over its pixels and its windows. A value, so
/// that it can be compiled once per vector width.
pub(super) struct Sweep<'a> {
    pub(super) strip: Strip<'a>,
    pub(super) room: &'a mut SweepMemory,
    pub(super) out: &'a mut [f32],
}

impl pulp::NullaryFnOnce for Sweep<'_> {
    type Output = Parts;

    #[inline(always)]
    fn call(self) -> Parts {
        self.strip.sweep(self.room, self.out)
    }
}

impl Strip<'_> {
    #[inline(always)]
    fn sweep(&self, room: &mut SweepMemory, out: &mut [f32]) -> Parts {
        let side = 3 * self.size[0];
        let packs = side.div_ceil(MARGIN);
        let SweepMemory { moments, slopes, flat } = room;
        moments.open(KINDS, packs);
        slopes.open(KINDS, packs);
        for flat in flat.iter_mut() {
            flat.clear();
            flat.resize((packs + 2) * MARGIN, 0.0);
        }
        let mut sums = Parts::default();
        let (first, past) = (self.rows.start as isize, self.rows.end as isize);
        let reach = MIDDLE as isize;
        for row in first - 2 * reach..past + 2 * reach {
            if let Some(row) = usize::try_from(row).ok().filter(|&row| row < self.size[1]) {
                self.moments(row, flat);
                filter(flat.each_ref().map(Vec::as_slice), self.along, moments.slot(row as isize));
            } else {
                moments.clear(row);
            }
            let centre = row - reach;
            if (first - reach..past + reach).contains(&centre) {
                if let Some(at) = usize::try_from(centre).ok().filter(|at| self.centres.contains(at)) {
                    let sum = self.slopes(&moments.around(centre), at, flat);
                    sums.structure += if self.rows.contains(&at) { sum } else { 0.0 };
                    filter(flat.each_ref().map(Vec::as_slice), self.along, slopes.slot(centre));
                } else {
                    slopes.clear(centre);
                }
            }
            let done = centre - reach;
            if (first..past).contains(&done) {
                let out = &mut out[(done - first) as usize * side..][..side];
                sums.mse += self.gradient(&slopes.around(done), done as usize, out);
            }
        }
        sums
    }

    /// Row `row` of both pictures.
    #[inline(always)]
    fn pixels(&self, row: usize) -> (&[f32], &[f32]) {
        let side = 3 * self.size[0];
        (&self.x[row * side..][..side], &self.y[row * side..][..side])
    }

    /// e, e² and ye of one row of pixels.
    #[inline(always)]
    fn moments(&self, row: usize, flat: &mut [Vec<f32>; KINDS]) {
        let (x, y) = self.pixels(row);
        let n = x.len();
        let [e, ee, ye] = flat;
        let (e, ee, ye) = (&mut e[MARGIN..][..n], &mut ee[MARGIN..][..n], &mut ye[MARGIN..][..n]);
        for i in 0..n {
            let d = difference(x[i], y[i]);
            e[i] = d;
            ee[i] = d * d;
            ye[i] = (y[i] - 0.5) * d;
        }
        // What was left of the last row of slopes.
        for flat in flat {
            flat[MARGIN + n..].fill(0.0);
        }
    }

    /// From moments to how the loss changes with each; returns the row's sum of `1 - SSIM`.
    #[inline(always)]
    fn slopes(&self, rows: &[&[Pack]; WINDOW], centre: usize, flat: &mut [Vec<f32>; KINDS]) -> f64 {
        let packs = rows[0].len() / KINDS;
        let (mask, _) = self.mask.as_chunks::<MARGIN>();
        let (mean, _) = self.mean[centre * MARGIN * packs..][..MARGIN * packs].as_chunks::<MARGIN>();
        let (variance, _) = self.variance[centre * MARGIN * packs..][..MARGIN * packs].as_chunks::<MARGIN>();
        let (mask, mean, variance) = (&mask[..packs], &mean[..packs], &variance[..packs]);
        let [by_e, by_ee, by_ye] = flat;
        let (by_e, by_ee, by_ye) = (middle(by_e, packs), middle(by_ee, packs), middle(by_ye, packs));
        let (c1, c2) = (C1 as f32, C2 as f32);
        let mut sums = [0.0f64; MARGIN];
        for at in 0..packs {
            let me = down(rows, at, self.down);
            let ee = down(rows, packs + at, self.down);
            let ye = down(rows, 2 * packs + at, self.down);
            let (mask, centred, vy) = (&mask[at], &mean[at], &variance[at]);
            let (by_e, by_ee, by_ye) = (&mut by_e[at], &mut by_ee[at], &mut by_ye[at]);
            for i in 0..MARGIN {
                let my = centred[i] + 0.5;
                let (me, me2) = (me[i], me[i] * me[i]);
                let ve = ee[i] - me2;
                let cov = ye[i] - centred[i] * me;
                let a1 = 2.0 * (my + me) * my + c1;
                let a2 = 2.0 * (vy[i] + cov) + c2;
                let (b1, b2) = (1.0 / (a1 + me2), 1.0 / (a2 + ve));
                let (l, s) = (a1 * b1, a2 * b2);
                let (unlike, apart) = (ve * b2, me2 * b1);
                let by_variance = mask[i] * (l * s * b2);
                let by_cov = mask[i] * (-2.0 * l * b2 * unlike);
                let by_mean = mask[i] * (2.0 * s * b1 * (l * me - my * apart));
                by_e[i] = by_mean - 2.0 * me * by_variance - centred[i] * by_cov;
                by_ee[i] = by_variance;
                by_ye[i] = by_cov;
                sums[i] += f64::from(mask[i] * (unlike + s * apart));
            }
        }
        total(sums)
    }

    /// Gradient of one row; returns its sum of squared errors.
    #[inline(always)]
    fn gradient(&self, rows: &[&[Pack]; WINDOW], row: usize, out: &mut [f32]) -> f64 {
        let (x, y) = self.pixels(row);
        let packs = rows[0].len() / KINDS;
        let mut sums = [0.0f64; MARGIN];
        let (x_packs, x_rest) = x.as_chunks::<MARGIN>();
        let (y_packs, y_rest) = y.as_chunks::<MARGIN>();
        let (out_packs, out_rest) = out.as_chunks_mut::<MARGIN>();
        for (at, ((x, y), out)) in x_packs.iter().zip(y_packs).zip(out_packs).enumerate() {
            self.pack(rows, at, [x, y], out, &mut sums);
        }
        if !x_rest.is_empty() {
            let [mut x, mut y, mut out] = [[0.0; MARGIN]; 3];
            x[..x_rest.len()].copy_from_slice(x_rest);
            y[..x_rest.len()].copy_from_slice(y_rest);
            self.pack(rows, packs - 1, [&x, &y], &mut out, &mut sums);
            out_rest.copy_from_slice(&out[..x_rest.len()]);
        }
        total(sums)
    }

    /// Gradient of one pack of a row; adds its squared errors to `sums`.
    #[inline(always)]
    fn pack(
        &self,
        rows: &[&[Pack]; WINDOW],
        at: usize,
        [x, y]: [&Pack; 2],
        out: &mut Pack,
        sums: &mut [f64; MARGIN],
    ) {
        let packs = rows[0].len() / KINDS;
        let [of_mse, of_structure] = self.scale;
        let by_e = down(rows, at, self.down);
        let by_ee = down(rows, packs + at, self.down);
        let by_ye = down(rows, 2 * packs + at, self.down);
        for i in 0..MARGIN {
            let e = difference(x[i], y[i]);
            let structure = by_e[i] + 2.0 * e * by_ee[i] + (y[i] - 0.5) * by_ye[i];
            out[i] = of_mse * (x[i] - y[i]) + of_structure * structure;
            let d = f64::from(x[i]) - f64::from(y[i]);
            sums[i] += d * d;
        }
    }
}

/// The row between the margins.
#[inline(always)]
fn middle(flat: &mut [f32], packs: usize) -> &mut [Pack] {
    &mut flat[MARGIN..][..MARGIN * packs].as_chunks_mut::<MARGIN>().0[..packs]
}

#[inline(always)]
fn difference(x: f32, y: f32) -> f32 {
    (x - y).clamp(-FARTHEST, FARTHEST)
}
