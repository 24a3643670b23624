//! Covers surfaces with discs, and makes an epoch of discs that move.

use codec_core::ShDegree;
use glam::{DQuat, DVec3};

use crate::scene::{
    Attributes, Epoch, SceneError, Track,
    import::snapshot::{logit, sh0_of_colour},
};

/// Opacity of every disc.
pub(super) const OPACITY: f32 = 0.92;
/// Disc radius over disc spacing: three neighbours leave no hole.
pub(super) const COVER: f64 = 0.62;
/// Thickness of a disc over its radius.
pub(super) const THINNESS: f64 = 0.1;

/// A disc at rest: where it is, which way it faces, how large, what colour.
#[derive(Clone, Copy, Debug)]
pub(super) struct Disc {
    pub position: DVec3,
    pub normal: DVec3,
    pub sigma: f64,
    pub colour: [f32; 3],
}

impl Disc {
    pub fn rotation(&self) -> DQuat {
        DQuat::from_rotation_arc(DVec3::Z, self.normal)
    }
}

/// The epoch of discs that keep size, colour and opacity while `pose` moves them.
pub(super) fn epoch_of(
    discs: &[Disc],
    frames: usize,
    mut pose: impl FnMut(usize, usize, &Disc) -> (DVec3, DQuat),
) -> Result<Epoch, SceneError> {
    let mut positions = Vec::with_capacity(discs.len() * frames);
    let mut rotations: Vec<[f32; 4]> = Vec::with_capacity(discs.len() * frames);
    for frame in 0..frames {
        for (i, disc) in discs.iter().enumerate() {
            let (p, q) = pose(frame, i, disc);
            positions.push(p.as_vec3().to_array());
            let mut q = wxyz(q);
            // Signs follow the frame before, so that no quaternion jumps to its negative.
            if let Some(before) = rotations.len().checked_sub(discs.len())
                && (0..4).map(|c| rotations[before][c] * q[c]).sum::<f32>() < 0.0
            {
                q = q.map(|v| -v);
            }
            rotations.push(q);
        }
    }
    Epoch::new(
        frames,
        Attributes {
            positions: Track::PerFrame(positions),
            rotations: Track::PerFrame(rotations),
            log_scales: Track::Constant(log_scales(discs)),
            opacity_logits: Track::Constant(vec![logit(OPACITY); discs.len()]),
            sh0: Track::Constant(discs.iter().map(|d| d.colour.map(sh0_of_colour)).collect()),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        },
    )
}

pub(super) fn wxyz(q: DQuat) -> [f32; 4] {
    [q.w, q.x, q.y, q.z].map(|v| v as f32)
}

pub(super) fn log_scales(discs: &[Disc]) -> Vec<[f32; 3]> {
    discs.iter().map(|d| [d.sigma, d.sigma, d.sigma * THINNESS].map(|s| s.ln() as f32)).collect()
}

/// Point `i` of `n` spread evenly over the unit sphere.
pub(super) fn on_sphere(i: usize, n: usize) -> DVec3 {
    let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
    let turn = i as f64 * golden_angle();
    let r = (1.0 - z * z).max(0.0).sqrt();
    DVec3::new(r * turn.cos(), z, r * turn.sin())
}

/// Point `i` of `n` spread evenly over the unit disc in x and z.
pub(super) fn on_disc(i: usize, n: usize) -> DVec3 {
    let r = ((i as f64 + 0.5) / n as f64).sqrt();
    let turn = i as f64 * golden_angle();
    DVec3::new(r * turn.cos(), 0.0, r * turn.sin())
}

pub(super) fn golden_angle() -> f64 {
    std::f64::consts::PI * (3.0 - 5f64.sqrt())
}

/// Standard deviation of a disc when `n` of them cover `area`.
pub(super) fn sigma_of(area: f64, n: usize) -> f64 {
    COVER * (2.0 * area / (3f64.sqrt() * n.max(1) as f64)).sqrt()
}

/// Splits `n` in proportion to `areas`; every part gets at least one.
pub(super) fn shares(n: usize, areas: &[f64]) -> Vec<usize> {
    let total: f64 = areas.iter().sum();
    let mut before = 0;
    let mut sum = 0.0;
    let mut parts: Vec<usize> = areas
        .iter()
        .map(|a| {
            sum += a;
            let end = (n as f64 * sum / total).round() as usize;
            std::mem::replace(&mut before, end).abs_diff(end)
        })
        .collect();
    // Exactly n in all, whatever the rounding did.
    if let Some(last) = parts.last_mut() {
        *last = n - (before - *last);
    }
    parts
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn shares_add_up() {
        assert_eq!(shares(10, &[1.0, 1.0, 2.0]), [3, 2, 5]);
        for n in [1000, 1001, 77_777] {
            assert_eq!(shares(n, &[0.3, 0.01, 2.0, 0.7]).iter().sum::<usize>(), n);
        }
    }
}
