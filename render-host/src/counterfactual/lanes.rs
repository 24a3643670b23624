//! The kernel of all fast modes: one block of pixels under many sets of groups, a set per vector lane.
//!
//! Per pixel, run and vector: `w = T & mask; C += w·c; T += w·hidden`. A lane whose set lacks the run's
//! group has `w = 0` and passes unchanged. There is no division and no early stop.

use super::runs::Runs;
use super::squares::Planes;
use pulp::Simd;
use std::ops::Range;

/// Lanes are padded to a multiple of this.
pub(super) const WIDTH: usize = 16;
/// All bits set: `x & PRESENT` is `x`.
const PRESENT: f32 = f32::from_bits(u32::MAX);

/// Which groups each lane holds, and what the kernel found.
#[derive(Debug, Default)]
pub(super) struct Lanes {
    /// Rows of `stride` masks, a row per group of the tile: [`PRESENT`] or 0.
    masks: Vec<f32>,
    stride: usize,
    count: usize,
    errors: Vec<f32>,
}

impl Lanes {
    /// Makes `count` lanes over a tile of `groups` groups. Masks are unspecified until [`Lanes::row`].
    pub(super) fn reset(&mut self, count: usize, groups: usize) {
        self.count = count;
        self.stride = count.next_multiple_of(WIDTH);
        let needed = self.stride * groups;
        if self.masks.len() < needed {
            self.masks.resize(needed, 0.0);
        }
        self.errors.resize(self.stride, 0.0);
    }

    /// Says for every lane whether it holds group `local`.
    #[inline(always)]
    pub(super) fn row(&mut self, local: usize, mut holds: impl FnMut(usize) -> bool) {
        let row = &mut self.masks[local * self.stride..][..self.count];
        for (lane, mask) in row.iter_mut().enumerate() {
            *mask = if holds(lane) { PRESENT } else { 0.0 };
        }
    }

    /// As [`Lanes::row`]: all lanes alike, then those of `except` flipped.
    pub(super) fn row_except(&mut self, local: usize, holds: bool, except: impl Iterator<Item = usize>) {
        let mask = |holds: bool| if holds { PRESENT } else { 0.0 };
        let row = &mut self.masks[local * self.stride..][..self.count];
        row.fill(mask(holds));
        except.for_each(|lane| row[lane] = mask(!holds));
    }

    /// Squared error of the block `xs × ys` in every lane.
    pub(super) fn composite(
        &mut self,
        runs: &Runs,
        [xs, ys]: [Range<usize>; 2],
        reference: &Planes,
        background: [f32; 3],
    ) {
        pulp::Arch::new().dispatch(Composite { runs, xs, ys, reference, background, lanes: self });
    }

    /// Squared error of the last block in every lane.
    pub(super) fn errors(&self) -> &[f32] {
        &self.errors[..self.count]
    }
}

struct Composite<'a> {
    runs: &'a Runs,
    xs: Range<usize>,
    ys: Range<usize>,
    reference: &'a Planes,
    background: [f32; 3],
    lanes: &'a mut Lanes,
}

impl pulp::WithSimd for Composite<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(mut self, simd: S) {
        let vectors = self.lanes.stride / S::F32_LANES;
        // Four vectors of state (T, C, error) fit 32 registers, two fit 16.
        let widest = if S::F32_LANES >= WIDTH { 4 } else { 2 };
        let mut at = 0;
        while at < vectors {
            let left = (vectors - at).min(widest);
            match left {
                4 => self.pass::<S, 4>(simd, at),
                3 => self.pass::<S, 3>(simd, at),
                2 => self.pass::<S, 2>(simd, at),
                _ => self.pass::<S, 1>(simd, at),
            }
            at += left;
        }
    }
}

impl Composite<'_> {
    /// Lanes of vectors `at..at + V`.
    #[inline(always)]
    fn pass<S: Simd, const V: usize>(&mut self, simd: S, at: usize) {
        let Self { runs, xs, ys, reference, background, lanes } = self;
        let (first, stride) = (at * S::F32_LANES, lanes.stride);
        let (zero, one) = (simd.splat_f32s(0.0), simd.splat_f32s(1.0));
        let mut error = [zero; V];
        for y in ys.clone() {
            for x in xs.clone() {
                let mut t = [one; V];
                let [mut r, mut g, mut b] = [[zero; V]; 3];
                for run in runs.at(x, y) {
                    let start = run.local as usize * stride + first;
                    let masks = S::as_simd_f32s(&lanes.masks[start..start + V * S::F32_LANES]).0;
                    let [cr, cg, cb] = run.colour.map(|c| simd.splat_f32s(c));
                    let hidden = simd.splat_f32s(run.hidden);
                    for v in 0..V {
                        let w = simd.and_f32s(t[v], masks[v]);
                        r[v] = simd.mul_add_e_f32s(w, cr, r[v]);
                        g[v] = simd.mul_add_e_f32s(w, cg, g[v]);
                        b[v] = simd.mul_add_e_f32s(w, cb, b[v]);
                        t[v] = simd.mul_add_e_f32s(w, hidden, t[v]);
                    }
                }
                for (c, sum) in [r, g, b].iter().enumerate() {
                    let back = simd.splat_f32s(background[c]);
                    let wanted = simd.splat_f32s(reference[y][c][x]);
                    for v in 0..V {
                        let d = simd.sub_f32s(simd.mul_add_e_f32s(t[v], back, sum[v]), wanted);
                        error[v] = simd.mul_add_e_f32s(d, d, error[v]);
                    }
                }
            }
        }
        let out = S::as_mut_simd_f32s(&mut lanes.errors[first..first + V * S::F32_LANES]).0;
        out.copy_from_slice(&error);
    }
}
