//! Rows hold the gradients of all Gaussians, field by field, as `adjoint/project.wgsl` writes them.

use crate::{
    adjoint::{DensityStatistics, SplatGradient},
    harmonics::count,
};

/// Rows of gradients before those of higher bands.
const FIELDS: usize = 16;
/// Rows after those of higher bands: statistics, and whether a gradient overflowed.
const STATISTICS: usize = 4;
/// Rows of the pose, which come first.
pub(super) const POSE_ROWS: usize = 6;

/// Where each number is.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) struct Rows {
    gaussians: usize,
    /// Values of higher bands per Gaussian: those rendered, and those that the scene has.
    rendered: usize,
    each: usize,
}

impl Rows {
    /// Rows of `gaussians` Gaussians with harmonics of degree `has`, of which degree `rendered` is rendered.
    pub(super) fn new(gaussians: usize, has: u8, rendered: u8) -> Self {
        Self { gaussians, rendered: 3 * count(rendered), each: 3 * count(has) }
    }

    /// Length of a row of the pose.
    pub(super) fn pose_stride(&self) -> usize {
        self.gaussians.next_multiple_of(256)
    }

    /// Numbers in all.
    pub(super) fn len(&self) -> usize {
        POSE_ROWS * self.pose_stride() + (FIELDS + self.rendered + STATISTICS) * self.gaussians
    }

    /// Bytes of all numbers.
    pub(super) fn bytes(&self) -> u64 {
        4 * self.len() as u64
    }

    /// Row `row` of the fields in `values`, one number per Gaussian.
    fn row<'v>(&self, values: &'v [f32], row: usize) -> &'v [f32] {
        &values[POSE_ROWS * self.pose_stride() + row * self.gaussians..][..self.gaussians]
    }

    /// Gradients of fields, one per Gaussian, into `out`.
    pub(super) fn splats(&self, values: &[f32], out: &mut Vec<SplatGradient>) {
        let rows: [&[f32]; FIELDS] = std::array::from_fn(|row| self.row(values, row));
        let of = |i: usize| SplatGradient {
            position: [0, 1, 2].map(|row| rows[row][i]),
            log_scale: [3, 4, 5].map(|row| rows[row][i]),
            rotation: [6, 7, 8, 9].map(|row| rows[row][i]),
            opacity_logit: rows[10][i],
            sh0: [11, 12, 13].map(|row| rows[row][i]),
            image_mean: [14, 15].map(|row| rows[row][i]),
        };
        out.clear();
        out.extend((0..self.gaussians).map(of));
    }

    /// Gradients of higher bands, laid out as in [`crate::Splats`], into `out`; 0 above the degree rendered.
    pub(super) fn sh_rest(&self, values: &[f32], out: &mut Vec<f32>) {
        out.clear();
        out.resize(self.gaussians * self.each, 0.0);
        for k in 0..self.rendered {
            let row = self.row(values, FIELDS + k);
            for (rest, &value) in out.chunks_exact_mut(self.each).zip(row) {
                rest[k] = value;
            }
        }
    }

    /// Statistics, one per Gaussian, into `out`.
    pub(super) fn statistics(&self, values: &[f32], out: &mut Vec<DensityStatistics>) {
        let [gradient, weight, pixels] = [0, 1, 2].map(|row| self.row(values, FIELDS + self.rendered + row));
        // A whole number, exact up to 2²⁴.
        let of = |i: usize| DensityStatistics {
            gradient: gradient[i],
            weight: weight[i],
            pixels: pixels[i] as u32,
        };
        out.clear();
        out.extend((0..self.gaussians).map(of));
    }

    /// Gaussians whose gradient overflowed and counts as 0.
    pub(super) fn overflowed(&self, values: &[f32]) -> u64 {
        let row = self.row(values, FIELDS + self.rendered + 3);
        row.iter().filter(|&&v| v != 0.0).count() as u64
    }
}
