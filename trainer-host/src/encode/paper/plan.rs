//! Quantises the clusters of an epoch: equation 1 of the paper, its residuals and attributes as symbols.

use codec_core::internals::{ids::Level, layout::paper as layout, quant::Class, wire::manifest::Quant};
use rayon::prelude::*;

use crate::{
    encode::{
        EncodeError,
        decisions::PaperEpochDecisions,
        factorise::{fit_pose, mean_turn, temporal_basis},
    },
    scene::{Epoch, activation::sigmoid},
};

/// One epoch, quantised.
pub(super) struct EpochPlan {
    pub first_frame: usize,
    pub frames: usize,
    pub origin: [f32; 3],
    pub quant: Quant,
    /// Frame-major, `frames × rank`.
    pub basis: Vec<f32>,
    pub rank: usize,
    pub members: Vec<Vec<u32>>,
    pub cells: Vec<Cell>,
}

/// One cluster: transforms (frames × 12) and the symbols of its four groups.
pub(super) struct Cell {
    pub transforms: Vec<f32>,
    pub levels: [Vec<i16>; Level::COUNT],
    pub saturated: u64,
}

/// Fits transforms and a basis to `epoch`, which begins at `first_frame`, and quantises what they leave.
///
/// # Errors
/// Quantisers that the format does not hold.
pub(super) fn plan(
    epoch: &Epoch,
    first_frame: usize,
    decided: &PaperEpochDecisions,
) -> Result<EpochPlan, EncodeError> {
    let (members, origin) = (decided.clusters.clone(), decided.origin);
    let quant = decided.quantisers.quant()?;
    let (n, frames, a) = (epoch.count(), epoch.frames(), epoch.attributes());
    let position = quant.canonical[Class::Position.index()];
    let step = position.step(Level::ALL[3]);
    let index = |i: usize, d: usize| {
        position.index(a.positions.frame(0, n)[i][d] - origin[d]).clamp(-32_768, 32_767) as i16
    };
    let still = |i: usize| [0, 1, 2].map(|d| origin[d] + f32::from(index(i, d)) * step);

    // Affine per cluster and frame, absolute coordinates as in equation 1, and what it leaves.
    let fits: Vec<(Vec<f32>, Vec<Vec<f64>>)> = members
        .par_iter()
        .map(|members| {
            let p0: Vec<[f32; 3]> = members.iter().map(|&i| still(i as usize)).collect();
            let before: Vec<[f32; 4]> =
                members.iter().map(|&i| a.rotations.frame(0, n)[i as usize]).collect();
            let wide: Vec<[f64; 3]> = p0.iter().map(|p| p.map(f64::from)).collect();
            let count = wide.len().max(1) as f64;
            let centre = [0, 1, 2].map(|d| wide.iter().map(|p| p[d]).sum::<f64>() / count);
            let mut transforms = Vec::with_capacity(frames * 12);
            let mut left: Vec<Vec<f64>> = vec![Vec::new(); members.len() * 3];
            let mut turn = [1.0, 0.0, 0.0, 0.0];
            for t in 0..frames {
                let truth = a.positions.frame(t, n);
                let target: Vec<[f64; 3]> =
                    members.iter().map(|&i| truth[i as usize].map(f64::from)).collect();
                let after: Vec<[f32; 4]> =
                    members.iter().map(|&i| a.rotations.frame(t, n)[i as usize]).collect();
                turn = mean_turn(&before, &after, turn);
                let fit = fit_pose(&wide, &target, centre, turn);
                let c = nalgebra::Vector3::from(centre);
                let shift = c + fit.translation - fit.linear * c;
                let start = transforms.len();
                for row in 0..3 {
                    (0..3).for_each(|column| transforms.push(fit.linear[(row, column)] as f32));
                    transforms.push(shift[row] as f32);
                }
                let at = &transforms[start..];
                for (i, (p, x)) in p0.iter().zip(&target).enumerate() {
                    for d in 0..3 {
                        let row = &at[4 * d..4 * d + 4];
                        let moved = row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3];
                        left[3 * i + d].push(x[d] - f64::from(moved));
                    }
                }
            }
            (transforms, left)
        })
        .collect();
    let rank = decided.rank.min(frames);
    let rows = fits.iter().flat_map(|(_, left)| left).map(Vec::as_slice);
    let (vectors, _) = temporal_basis(rows, frames, rank);
    let rank = vectors.len();
    let basis: Vec<f32> = (0..frames).flat_map(|t| vectors.iter().map(move |v| v[t] as f32)).collect();
    let cells = fits
        .into_par_iter()
        .zip(&members)
        .map(|((transforms, left), members)| {
            let mut symbols = ClusterSymbols::new(epoch, members, &quant, rank);
            symbols.positions(&index);
            symbols.motion(&left, &basis);
            symbols.attributes();
            symbols.harmonics();
            Cell { transforms, levels: symbols.levels, saturated: symbols.saturated }
        })
        .collect();
    Ok(EpochPlan { first_frame, frames, origin, quant, basis, rank, members, cells })
}

/// A cluster whose symbols are chosen, in the order of [`layout`].
struct ClusterSymbols<'a> {
    epoch: &'a Epoch,
    members: &'a [u32],
    quant: &'a Quant,
    rank: usize,
    levels: [Vec<i16>; Level::COUNT],
    /// Values beyond what a symbol holds.
    saturated: u64,
}

impl<'a> ClusterSymbols<'a> {
    /// Of zeros.
    fn new(epoch: &'a Epoch, members: &'a [u32], quant: &'a Quant, rank: usize) -> Self {
        let rest = epoch.attributes().sh_degree.rest_len();
        let levels = layout::symbols(members.len(), epoch.frames(), rank, rest).map(|len| vec![0; len]);
        Self { epoch, members, quant, rank, levels, saturated: 0 }
    }

    /// The nearest symbol.
    fn quantise(&mut self, value: f64, step: f32) -> i16 {
        let q = (value / f64::from(step)).round();
        if q.abs() > 32_767.0 {
            self.saturated += 1;
        }
        q.clamp(-32_768.0, 32_767.0) as i16
    }

    /// Canonical positions: `index` says those of each Gaussian and axis.
    fn positions(&mut self, index: &(dyn Fn(usize, usize) -> i16 + Sync)) {
        let n = self.members.len();
        for (i, &g) in self.members.iter().enumerate() {
            for d in 0..3 {
                self.levels[0][d * n + i] = index(g as usize, d);
            }
        }
    }

    /// What the cluster's transform leaves of each member's motion, axis by axis: coefficients of `basis`,
    /// then residuals per frame.
    fn motion(&mut self, left: &[Vec<f64>], basis: &[f32]) {
        let (n, frames, rank) = (self.members.len(), self.epoch.frames(), self.rank);
        let motion = self.quant.motion[Class::Position.index()];
        let steps = [1, 2, 3].map(|l| motion.step(Level::ALL[l]));
        for (row, left) in left.iter().enumerate() {
            let (i, d) = (row / 3, row % 3);
            let mut after = left.clone();
            for r in 0..rank {
                let q: f64 = (0..frames).map(|t| left[t] * f64::from(basis[t * rank + r])).sum();
                let symbol = self.quantise(q, steps[0]);
                self.levels[1][(3 * r + d) * n + i] = symbol;
                let sent = f64::from(f32::from(symbol) * steps[0]);
                (0..frames).for_each(|t| after[t] -= sent * f64::from(basis[t * rank + r]));
            }
            for (t, value) in after.iter().enumerate() {
                let at = (t * (3 + layout::ATTRIBUTES) + d) * n + i;
                let coarse = self.quantise(*value, steps[1]);
                self.levels[2][at] = coarse;
                self.levels[3][at] = self.quantise(value - f64::from(f32::from(coarse) * steps[1]), steps[2]);
            }
        }
    }

    /// Value of attribute `c` of member `i` at frame `t`.
    fn attribute(&self, t: usize, i: usize, c: usize) -> f64 {
        let (count, a) = (self.epoch.count(), self.epoch.attributes());
        let g = self.members[i] as usize;
        f64::from(match c {
            0..=2 => a.log_scales.frame(t, count)[g][c],
            3..=6 => a.rotations.frame(t, count)[g][c - 3],
            7 => sigmoid(a.opacity_logits.frame(t, count)[g]),
            _ => a.sh0.frame(t, count)[g][c - 8],
        })
    }

    /// All attributes but positions and higher bands: the first frame's, then what each frame differs by.
    fn attributes(&mut self) {
        let (n, frames) = (self.members.len(), self.epoch.frames());
        let refinement1 = layout::refinement1(n, self.rank);
        for c in 0..layout::ATTRIBUTES {
            let quantiser = self.quant.canonical[class(c).index()];
            let steps = Level::ALL.map(|l| quantiser.step(l));
            for i in 0..n {
                let base = self.quantise(self.attribute(0, i, c), steps[0]);
                self.levels[0][(3 + c) * n + i] = base;
                let base = f64::from(f32::from(base) * steps[0]);
                for t in 0..frames {
                    let mut value = self.attribute(t, i, c);
                    // Quaternion signs may flip between frames; refinements follow the base's.
                    if (3..=6).contains(&c) {
                        let dot: f64 =
                            (3..=6).map(|k| self.attribute(0, i, k) * self.attribute(t, i, k)).sum();
                        value *= if dot < 0.0 { -1.0 } else { 1.0 };
                    }
                    let mut rest = value - base;
                    for (level, &step) in steps.iter().enumerate().skip(1) {
                        let symbol = self.quantise(rest, step);
                        rest -= f64::from(f32::from(symbol) * step);
                        let at = match level {
                            1 => refinement1 + (t * layout::ATTRIBUTES + c) * n + i,
                            _ => (t * (3 + layout::ATTRIBUTES) + 3 + c) * n + i,
                        };
                        self.levels[level][at] = symbol;
                    }
                }
            }
        }
    }

    /// Higher bands, which do not change over time.
    fn harmonics(&mut self) {
        let (n, a) = (self.members.len(), self.epoch.attributes());
        let rest = a.sh_degree.rest_len();
        let step = self.quant.canonical[Class::Sh1.index()].step(Level::ALL[3]);
        let offset = layout::rest(n, self.epoch.frames(), self.rank);
        for (i, &g) in self.members.iter().enumerate() {
            for j in 0..rest {
                let value = a.sh_rest[g as usize * rest + j];
                self.levels[1][offset + j * n + i] = self.quantise(f64::from(value), step);
            }
        }
    }
}

/// The class of an attribute of [`layout`].
fn class(attribute: usize) -> Class {
    match attribute {
        0..=2 => Class::Scale,
        3..=6 => Class::Rotation,
        7 => Class::Opacity,
        _ => Class::Sh0,
    }
}

/// The quantisation profile of an epoch; the manifest's check refuses more than 256 of them.
pub(super) fn quant_index(quants: &[Quant], plan: &EpochPlan) -> u8 {
    quants.iter().position(|q| *q == plan.quant).unwrap_or(0).min(255) as u8
}
