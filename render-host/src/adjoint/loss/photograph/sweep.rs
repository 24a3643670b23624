//! A sweep compares one area of a picture with a photograph, row by row, in rings of rows.
//!
//! As the sweep of `1 - SSIM` beside it (see there for the formulas), but the photograph's moments are
//! filtered on the way, from values less ½, in f32: in an even patch the variance is wrong by about 3e-8,
//! where C₂ is 9e-4.

use std::ops::Range;

use super::source::put_over;
use crate::{
    adjoint::loss::ssim::{
        rows::{MARGIN, MIDDLE, Pack, Ring, down, filter, total},
        sweep::FARTHEST,
    },
    metric::ssim::{C1, C2},
};

/// Filtered moments, with e the error and y the photograph less ½: e, e², ye, y, y².
const MOMENTS: usize = 5;
/// Filtered slopes: what the loss changes with e, e² and ye.
const SLOPES: usize = 3;
/// Values kept of each pixel until its gradient is made: e, y.
const VALUES: usize = 2;
/// Half-width of the rounded tip of the absolute error.
const TIP: f32 = 1e-3;

/// Scratch memory of a sweep.
#[derive(Debug, Default)]
pub(super) struct Memory {
    values: Ring,
    moments: Ring,
    slopes: Ring,
    /// Rows to be filtered along, with margins of zeros.
    flat: [Vec<f32>; MOMENTS],
    /// One row of the photograph.
    photograph: Vec<f32>,
    /// 1 where a window that is compared can be centred, else 0; and where it is one of the area's own.
    centred: Vec<Pack>,
    own_centred: Vec<Pack>,
    /// 1 where a value is one of the area's own.
    own: Vec<Pack>,
}

/// Sums over the values or windows of an area.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Sums {
    pub(super) absolute: f64,
    pub(super) squared: f64,
    /// Of `1 - SSIM`.
    pub(super) structure: f64,
}

impl Sums {
    pub(super) fn add(&mut self, other: &Self) {
        self.absolute += other.absolute;
        self.squared += other.squared;
        self.structure += other.structure;
    }
}

/// What a sweep is made from.
pub(super) struct Compared<'a> {
    /// r g b per pixel.
    pub(super) picture: &'a [f32],
    /// r g b a per pixel; the picture's first pixel lies at `corner`.
    pub(super) photograph: &'a [u8],
    pub(super) photograph_width: usize,
    pub(super) corner: [usize; 2],
    /// One per pixel of the photograph.
    pub(super) pixel_weights: Option<&'a [u8]>,
    pub(super) background: [f32; 3],
    /// Width and height of the picture, pixels.
    pub(super) size: [usize; 2],
    /// The area.
    pub(super) rows: Range<usize>,
    pub(super) columns: Range<usize>,
    /// Columns and rows on which a window can be centred.
    pub(super) centres: [Range<usize>; 2],
    /// Weights by distance from the middle, 0 beyond the window.
    pub(super) along: &'a [f32; MIDDLE + 1],
    pub(super) down: &'a [f32; MIDDLE + 1],
    /// Of the slope of the absolute error, of the error, and of `1 - SSIM`.
    pub(super) scale: [f32; 3],
}

/// Writes the gradient of the area to `gradient`, which begins with the first of its rows and is as wide as
/// the picture; yields sums over its values and windows. A value, so that it can be compiled once per
/// vector width.
pub(super) struct Sweep<'a> {
    pub(super) compared: Compared<'a>,
    pub(super) memory: &'a mut Memory,
    pub(super) gradient: &'a mut [f32],
}

impl pulp::NullaryFnOnce for Sweep<'_> {
    type Output = Sums;

    #[inline(always)]
    fn call(self) -> Sums {
        self.compared.sweep(self.memory, self.gradient)
    }
}

impl Compared<'_> {
    #[inline(always)]
    fn sweep(&self, memory: &mut Memory, gradient: &mut [f32]) -> Sums {
        let reach = if self.scale[2] == 0.0 { 0 } else { MIDDLE };
        let read =
            self.columns.start.saturating_sub(2 * reach)..(self.columns.end + 2 * reach).min(self.size[0]);
        let packs = (3 * read.len()).div_ceil(MARGIN);
        memory.open(packs);
        let near = self.columns.start.saturating_sub(reach)..self.columns.end + reach;
        let [across, centre_rows] = &self.centres;
        mark(&mut memory.centred, &read, near.start.max(across.start)..near.end.min(across.end));
        mark(&mut memory.own, &read, self.columns.clone());
        let own = self.columns.start.max(across.start)..self.columns.end.min(across.end);
        mark(&mut memory.own_centred, &read, own);
        let mut sums = Sums::default();
        let (first, past, reach) = (self.rows.start as isize, self.rows.end as isize, reach as isize);
        for row in first - 2 * reach..past + 2 * reach {
            match usize::try_from(row).ok().filter(|&row| row < self.size[1]) {
                Some(at) => {
                    self.values(at, &read, memory);
                    if reach > 0 {
                        moments(memory, row);
                        filter(
                            memory.flat.each_ref().map(Vec::as_slice),
                            self.along,
                            memory.moments.slot(row),
                        );
                    }
                }
                None => memory.moments.clear(row),
            }
            let centre = row - reach;
            if reach > 0 && (first - reach..past + reach).contains(&centre) {
                if usize::try_from(centre).is_ok_and(|at| centre_rows.contains(&at)) {
                    let sum = self.slopes(memory, centre);
                    sums.structure += if (first..past).contains(&centre) { sum } else { 0.0 };
                    let [by_e, by_ee, by_ye, ..] = &memory.flat;
                    filter([by_e, by_ee, by_ye].map(Vec::as_slice), self.along, memory.slopes.slot(centre));
                } else {
                    memory.slopes.clear(centre);
                }
            }
            let done = centre - reach;
            if (first..past).contains(&done) {
                let width = self.size[0];
                let out = &mut gradient[3 * (done - first) as usize * width..][..3 * width];
                let out = &mut out[3 * self.columns.start..3 * self.columns.end];
                self.gradient(memory, done, self.columns.start - read.start, out, &mut sums);
            }
        }
        sums
    }

    /// Errors and photograph of row `row`, columns `read`, to the ring of values.
    #[inline(always)]
    fn values(&self, row: usize, read: &Range<usize>, memory: &mut Memory) {
        let Memory { values, photograph, .. } = memory;
        let n = 3 * read.len();
        let first = (self.corner[1] + row) * self.photograph_width + self.corner[0] + read.start;
        photograph.resize(n, 0.0);
        put_over(&self.photograph[4 * first..4 * (first + read.len())], self.background, photograph);
        let x = &self.picture[3 * (row * self.size[0] + read.start)..][..n];
        let slot = values.slot(row as isize).as_flattened_mut();
        let (e, y) = slot.split_at_mut(slot.len() / VALUES);
        let (e, y, photograph) = (&mut e[..n], &mut y[..n], &photograph[..n]);
        for i in 0..n {
            e[i] = (x[i] - photograph[i]).clamp(-FARTHEST, FARTHEST);
            y[i] = photograph[i] - 0.5;
        }
        if let Some(weights) = self.pixel_weights {
            let weights = &weights[first..first + read.len()];
            for (e, &weight) in e.as_chunks_mut::<3>().0.iter_mut().zip(weights) {
                *e = e.map(|e| share(weight) * e);
            }
        }
    }

    /// From moments around `centre` to how the loss changes with each, in `flat`; returns the sum of
    /// `1 - SSIM` over the area's own columns.
    #[inline(always)]
    fn slopes(&self, memory: &mut Memory, centre: isize) -> f64 {
        let Memory { moments, flat, centred, own_centred, .. } = memory;
        let rows = &moments.around(centre);
        let packs = centred.len();
        let [by_e, by_ee, by_ye, ..] = flat;
        let (by_e, by_ee, by_ye) = (middle(by_e, packs), middle(by_ee, packs), middle(by_ye, packs));
        let (c1, c2) = (C1 as f32, C2 as f32);
        let mut sums = [0.0; MARGIN];
        for at in 0..packs {
            let me = down(rows, at, self.down);
            let ee = down(rows, packs + at, self.down);
            let ye = down(rows, 2 * packs + at, self.down);
            let mean = down(rows, 3 * packs + at, self.down);
            let yy = down(rows, 4 * packs + at, self.down);
            let (centred, own) = (&centred[at], &own_centred[at]);
            let (by_e, by_ee, by_ye) = (&mut by_e[at], &mut by_ee[at], &mut by_ye[at]);
            for i in 0..MARGIN {
                let (mean, my) = (mean[i], mean[i] + 0.5);
                let vy = (yy[i] - mean * mean).max(0.0);
                let (me, me2) = (me[i], me[i] * me[i]);
                let ve = ee[i] - me2;
                let cov = ye[i] - mean * me;
                let a1 = 2.0 * (my + me) * my + c1;
                let a2 = 2.0 * (vy + cov) + c2;
                let (b1, b2) = (1.0 / (a1 + me2), 1.0 / (a2 + ve));
                let (l, s) = (a1 * b1, a2 * b2);
                let (unlike, apart) = (ve * b2, me2 * b1);
                let by_variance = centred[i] * (l * s * b2);
                let by_cov = centred[i] * (-2.0 * l * b2 * unlike);
                let by_mean = centred[i] * (2.0 * s * b1 * (l * me - my * apart));
                by_e[i] = by_mean - 2.0 * me * by_variance - mean * by_cov;
                by_ee[i] = by_variance;
                by_ye[i] = by_cov;
                sums[i] += own[i] * (unlike + s * apart);
            }
        }
        total(sums.map(f64::from))
    }

    /// Gradient of row `row` from column `skip` of what is read on; adds its errors to `sums`.
    #[inline(always)]
    fn gradient(&self, memory: &mut Memory, row: isize, skip: usize, out: &mut [f32], sums: &mut Sums) {
        let Memory { values, slopes, own, flat, .. } = memory;
        let packs = own.len();
        let values = values.around(row)[MIDDLE];
        let (e, y) = values.split_at(packs);
        let rows = &slopes.around(row);
        let [absolute, squared, structure] = self.scale;
        let all = middle(&mut flat[0], packs);
        let (mut absolutes, mut squares) = ([0.0; MARGIN], [0.0; MARGIN]);
        for at in 0..packs {
            let (e, y, own, out) = (&e[at], &y[at], &own[at], &mut all[at]);
            for i in 0..MARGIN {
                let ee = e[i] * e[i];
                let length = (ee + TIP * TIP).sqrt();
                out[i] = absolute * (e[i] / length) + squared * e[i];
                absolutes[i] += own[i] * (ee / (length + TIP));
                squares[i] += own[i] * ee;
            }
            if structure != 0.0 {
                let by_e = down(rows, at, self.down);
                let by_ee = down(rows, packs + at, self.down);
                let by_ye = down(rows, 2 * packs + at, self.down);
                for i in 0..MARGIN {
                    out[i] += structure * (by_e[i] + 2.0 * e[i] * by_ee[i] + y[i] * by_ye[i]);
                }
            }
        }
        sums.absolute += total(absolutes.map(f64::from));
        sums.squared += total(squares.map(f64::from));
        out.copy_from_slice(&all.as_flattened()[3 * skip..][..out.len()]);
        if let Some(weights) = self.pixel_weights {
            let first = (self.corner[1] + row as usize) * self.photograph_width + self.corner[0];
            let weights = &weights[first + self.columns.start..first + self.columns.end];
            for (out, &weight) in out.as_chunks_mut::<3>().0.iter_mut().zip(weights) {
                *out = out.map(|out| share(weight) * out);
            }
        }
    }
}

impl Memory {
    /// Makes room for rows of `packs` packs.
    fn open(&mut self, packs: usize) {
        self.values.open(VALUES, packs);
        self.moments.open(MOMENTS, packs);
        self.slopes.open(SLOPES, packs);
        for flat in &mut self.flat {
            flat.clear();
            flat.resize((packs + 2) * MARGIN, 0.0);
        }
        for marks in [&mut self.centred, &mut self.own_centred, &mut self.own] {
            marks.clear();
            marks.resize(packs, [0.0; MARGIN]);
        }
    }
}

/// Moments of row `row` to rows to be filtered along.
#[inline(always)]
fn moments(memory: &mut Memory, row: isize) {
    let Memory { values, flat, own, .. } = memory;
    let packs = own.len();
    let slot = values.slot(row);
    let (errors, photograph) = slot.split_at(packs);
    let [e, ee, ye, y, yy] = flat;
    let (e, ee, ye) = (middle(e, packs), middle(ee, packs), middle(ye, packs));
    let (y, yy) = (middle(y, packs), middle(yy, packs));
    for at in 0..packs {
        for i in 0..MARGIN {
            let (error, value) = (errors[at][i], photograph[at][i]);
            e[at][i] = error;
            ee[at][i] = error * error;
            ye[at][i] = value * error;
            y[at][i] = value;
            yy[at][i] = value * value;
        }
    }
}

/// The row between the margins.
#[inline(always)]
fn middle(flat: &mut [f32], packs: usize) -> &mut [Pack] {
    &mut flat[MARGIN..][..MARGIN * packs].as_chunks_mut::<MARGIN>().0[..packs]
}

/// Marks the values of columns `columns` in a row that begins with column `read.start`.
fn mark(packs: &mut [Pack], read: &Range<usize>, columns: Range<usize>) {
    let inside = columns.start.max(read.start)..columns.end.min(read.end);
    if inside.start < inside.end {
        let (first, past) = (inside.start - read.start, inside.end - read.start);
        packs.as_flattened_mut()[3 * first..3 * past].fill(1.0);
    }
}

/// The share of the picture in what is compared, from the weight of a pixel.
#[inline(always)]
fn share(weight: u8) -> f32 {
    f32::from(weight) / 255.0
}
