//! Makes a figure of fourteen capsules that walks on the spot on a round floor.
//!
//! Each capsule is rigid and hangs from its parent at a joint; thighs, shins, feet, upper arms and
//! forearms swing in the plane of the walk, once per [`STRIDE`] seconds; the body bobs twice. Joints
//! overlap, so that no gap opens when they bend.

use glam::{DQuat, DVec3};
use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};

use super::{
    disc::{Disc, epoch_of, golden_angle, on_disc, shares, sigma_of},
    options::SynthOptions,
    paint,
};
use crate::scene::{Epoch, SceneError};

const FLOOR: f64 = -1.0;
const FLOOR_RADIUS: f64 = 1.4;
/// Seconds per two steps.
const STRIDE: f64 = 1.2;

/// A capsule: `length` along -y from the joint at its parent's `joint`, and how it swings.
struct Bone {
    parent: Option<usize>,
    /// Joint in the parent's axes.
    joint: DVec3,
    length: f64,
    radius: f64,
    /// Swing about x: mean and amplitude in radians, and phase in turns of the stride.
    swing: (f64, f64, f64),
    colour: [f32; 3],
}

fn skeleton(cloth: [f32; 3], trousers: [f32; 3]) -> Vec<Bone> {
    let skin = [0.86, 0.66, 0.53];
    let shoe = [0.20, 0.19, 0.22];
    let bone = |parent, joint: [f64; 3], length, radius, swing, colour| Bone {
        parent,
        joint: DVec3::from_array(joint),
        length,
        radius,
        swing,
        colour,
    };
    let mut bones = vec![
        bone(None, [0.0, 0.02, 0.0], 0.06, 0.17, (0.0, 0.0, 0.0), trousers),
        bone(Some(0), [0.0, 0.50, 0.0], 0.38, 0.19, (0.04, 0.03, 0.5), cloth),
        bone(Some(1), [0.0, 0.20, 0.0], 0.10, 0.075, (0.0, 0.0, 0.0), skin),
        bone(Some(2), [0.0, 0.20, 0.0], 0.05, 0.15, (0.0, 0.05, 0.25), skin),
    ];
    for (side, phase) in [(-1.0, 0.0), (1.0, 0.5)] {
        let thigh = bones.len();
        bones.push(bone(Some(0), [0.11 * side, -0.06, 0.0], 0.40, 0.095, (-0.08, 0.5, phase), trousers));
        bones.push(bone(Some(thigh), [0.0, -0.40, 0.0], 0.38, 0.075, (0.45, 0.42, phase + 0.3), trousers));
        bones.push(bone(Some(thigh + 1), [0.0, -0.38, -0.02], 0.14, 0.06, (-1.45, 0.15, phase), shoe));
        let arm = bones.len();
        bones.push(bone(Some(1), [0.25 * side, 0.10, 0.0], 0.30, 0.07, (0.05, 0.45, phase + 0.5), cloth));
        bones.push(bone(Some(arm), [0.0, -0.30, 0.0], 0.28, 0.058, (-0.45, 0.2, phase + 0.5), skin));
    }
    bones
}

impl Bone {
    fn area(&self) -> f64 {
        std::f64::consts::TAU * self.radius * (self.length + 2.0 * self.radius)
    }

    /// Point and normal `i` of `n` over the capsule: a sphere's spiral, with a cylinder let in at the
    /// equator. Equal steps along the axis are equal areas on both.
    fn surface(&self, i: usize, n: usize) -> (DVec3, DVec3) {
        let span = self.length + 2.0 * self.radius;
        let along = (i as f64 + 0.5) / n as f64 * span - self.radius;
        let beyond = along - along.clamp(0.0, self.length);
        let turn = i as f64 * golden_angle();
        let ring = (1.0 - (beyond / self.radius).powi(2)).max(0.0).sqrt();
        let normal = DVec3::new(ring * turn.cos(), -beyond / self.radius, ring * turn.sin()).normalize();
        (DVec3::new(0.0, -along.clamp(0.0, self.length), 0.0) + normal * self.radius, normal)
    }
}

/// Joint and turn of every bone at `seconds`.
fn pose(bones: &[Bone], seconds: f64) -> Vec<(DVec3, DQuat)> {
    let stride = seconds / STRIDE;
    let wave = |phase: f64| (std::f64::consts::TAU * (stride + phase)).sin();
    let bob = 0.025 * (2.0 * std::f64::consts::TAU * stride).cos();
    let mut out: Vec<(DVec3, DQuat)> = Vec::with_capacity(bones.len());
    for bone in bones {
        let (mean, amplitude, phase) = bone.swing;
        let turn = DQuat::from_rotation_x(mean + amplitude * wave(phase));
        out.push(match bone.parent {
            None => (bone.joint + DVec3::Y * bob, turn),
            Some(parent) => {
                let (origin, rotation) = out[parent];
                (origin + rotation * bone.joint, rotation * turn)
            }
        });
    }
    out
}

pub(super) fn make(options: &SynthOptions) -> Result<Epoch, SceneError> {
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let pick = (rng.random::<f64>() * 8.0) as usize % 8;
    let start = rng.random::<f64>() * STRIDE;
    let bones = skeleton(paint::PALETTE[pick], paint::mix(paint::PALETTE[(pick + 3) % 8], [0.2; 3], 0.4));
    let floor_area = std::f64::consts::PI * FLOOR_RADIUS * FLOOR_RADIUS;
    let mut areas: Vec<f64> = bones.iter().map(|b| 2.0 * b.area()).collect();
    areas.push(floor_area * 0.5);
    let parts = shares(options.gaussians, &areas);

    let mut discs = Vec::with_capacity(options.gaussians);
    let mut owner = Vec::with_capacity(options.gaussians);
    for (b, bone) in bones.iter().enumerate() {
        for i in 0..parts[b] {
            let (position, normal) = bone.surface(i, parts[b]);
            let band = (position.y * 14.0).floor().rem_euclid(2.0) as f32;
            let colour = paint::mix(bone.colour, [1.0; 3], 0.12 * band);
            let sigma = sigma_of(bone.area(), parts[b]);
            discs.push(Disc { position, normal, sigma, colour: paint::lit(colour, normal) });
            owner.push(b);
        }
    }
    let n = parts[bones.len()];
    for i in 0..n {
        let p = on_disc(i, n) * FLOOR_RADIUS;
        let colour = paint::tiles(p.x, p.z, 0.35);
        let sigma = sigma_of(floor_area, n);
        discs.push(Disc { position: p + DVec3::Y * FLOOR, normal: DVec3::Y, sigma, colour });
        owner.push(bones.len());
    }

    let poses: Vec<_> =
        (0..options.frames).map(|f| pose(&bones, start + f as f64 / options.frames_per_second)).collect();
    epoch_of(&discs, options.frames, |frame, i, disc| match poses[frame].get(owner[i]) {
        None => (disc.position, disc.rotation()),
        Some(&(origin, turn)) => (origin + turn * disc.position, turn * disc.rotation()),
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bones_hang_together_and_feet_stay_near_the_floor() {
        let bones = skeleton([0.5; 3], [0.5; 3]);
        assert_eq!(bones.len(), 14);
        let mut lowest = f64::INFINITY;
        for step in 0..60 {
            let posed = pose(&bones, step as f64 / 50.0);
            for (bone, (joint, _)) in bones.iter().zip(&posed) {
                if let Some(parent) = bone.parent {
                    let (origin, turn) = posed[parent];
                    assert!((origin + turn * bone.joint - *joint).length() < 1e-12);
                }
            }
            for (bone, (joint, turn)) in bones.iter().zip(&posed) {
                let tip = *joint + *turn * DVec3::new(0.0, -bone.length, 0.0);
                lowest = lowest.min(tip.y.min(joint.y) - bone.radius);
            }
        }
        assert!((-1.06..=-0.9).contains(&lowest), "lowest point of the walk {lowest}");
    }
}
