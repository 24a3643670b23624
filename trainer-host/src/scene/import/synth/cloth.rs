//! Makes a hanging sheet whose displacement has exactly four modes.
//!
//! With `u, v` in -1..=1 across and down the sheet, the position at time `s` is
//!
//! ```text
//! p(u, v, s) = (1.6 u, -1.2 v + 0.2, 0) + sum over k = 0..3 of b_k(s) f_k(u, v)
//!
//! f_0 = w · sin(1.5 u + 1) · z          b_0 = 0.28 sin(2π 0.50 s + φ0)
//! f_1 = w · sin(3 u + 2 v) · z          b_1 = 0.16 sin(2π 0.83 s + φ1)
//! f_2 = w · cos(5 u - v) · z            b_2 = 0.07 sin(2π 1.30 s + φ2)
//! f_3 = w² · (0.6 x + 0.2 sin(2u) y)    b_3 = 0.12 sin(2π 0.37 s + φ3)
//! w   = (1 + v) / 2: the top edge is held
//! ```
//!
//! so the matrix of displacements, 3N by T, has rank four; phases come from the seed. Orientation
//! follows the exact normal, which does not have four modes: that is the point of it.

use glam::{DQuat, DVec3};
use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};

use super::{
    disc::{Disc, epoch_of, sigma_of},
    options::SynthOptions,
    paint,
};
use crate::scene::{Epoch, SceneError};

/// Modes of the sheet's displacement.
pub const MODES: usize = 4;
const WIDTH: f64 = 1.6;
const HEIGHT: f64 = 1.2;
const TAU: f64 = std::f64::consts::TAU;

/// The displacement fields at `(u, v)`.
fn fields(u: f64, v: f64) -> [DVec3; MODES] {
    let w = (1.0 + v) / 2.0;
    [
        DVec3::Z * w * (1.5 * u + 1.0).sin(),
        DVec3::Z * w * (3.0 * u + 2.0 * v).sin(),
        DVec3::Z * w * (5.0 * u - v).cos(),
        DVec3::new(0.6, 0.2 * (2.0 * u).sin(), 0.0) * w * w,
    ]
}

/// Derivatives of [`fields`] along `u` and along `v`.
fn slopes(u: f64, v: f64) -> [(DVec3, DVec3); MODES] {
    let w = (1.0 + v) / 2.0;
    let (a, b, c) = (1.5 * u + 1.0, 3.0 * u + 2.0 * v, 5.0 * u - v);
    [
        (DVec3::Z * w * 1.5 * a.cos(), DVec3::Z * 0.5 * a.sin()),
        (DVec3::Z * w * 3.0 * b.cos(), DVec3::Z * (0.5 * b.sin() + 2.0 * w * b.cos())),
        (DVec3::Z * w * -5.0 * c.sin(), DVec3::Z * (0.5 * c.cos() + w * c.sin())),
        (DVec3::Y * 0.4 * (2.0 * u).cos() * w * w, DVec3::new(0.6, 0.2 * (2.0 * u).sin(), 0.0) * w),
    ]
}

pub(super) fn make(options: &SynthOptions) -> Result<Epoch, SceneError> {
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let phases: [f64; MODES] = std::array::from_fn(|_| rng.random::<f64>() * TAU);
    let hue = (rng.random::<f64>() * 8.0) as usize % 8;
    let (main, second) = (paint::PALETTE[hue], paint::PALETTE[(hue + 2) % 8]);

    // The R2 sequence: even at any count, and no rows that would show.
    let g = 1.324_717_957_244_746_f64;
    let n = options.gaussians;
    let places: Vec<(f64, f64)> = (0..n)
        .map(|i| {
            let i = i as f64;
            (2.0 * (0.5 + i / g).fract() - 1.0, 2.0 * (0.5 + i / (g * g)).fract() - 1.0)
        })
        .collect();
    let sigma = sigma_of(4.0 * WIDTH * HEIGHT, n);
    let discs: Vec<Disc> = places
        .iter()
        .map(|&(u, v)| Disc {
            position: DVec3::new(WIDTH * u, -HEIGHT * v + 0.2, 0.0),
            normal: DVec3::Z,
            sigma,
            colour: weave(u, v, main, second),
        })
        .collect();
    epoch_of(&discs, options.frames, |frame, i, disc| {
        let seconds = frame as f64 / options.frames_per_second;
        let (u, v) = places[i];
        let pace = [(0.28, 0.5), (0.16, 0.83), (0.07, 1.3), (0.12, 0.37)];
        let amounts: [f64; MODES] =
            std::array::from_fn(|k| pace[k].0 * (TAU * pace[k].1 * seconds + phases[k]).sin());
        let moved: DVec3 = fields(u, v).iter().zip(amounts).map(|(f, b)| *f * b).sum();
        let (mut along_u, mut along_v) = (DVec3::X * WIDTH, DVec3::Y * -HEIGHT);
        for ((du, dv), b) in slopes(u, v).into_iter().zip(amounts) {
            along_u += du * b;
            along_v += dv * b;
        }
        // Down × across would face back; the front is +z.
        let normal = along_v.cross(along_u).normalize_or(DVec3::Z);
        (disc.position + moved, DQuat::from_rotation_arc(DVec3::Z, normal))
    })
}

/// A tartan of two colours with thin light lines and a border.
fn weave(u: f64, v: f64, main: [f32; 3], second: [f32; 3]) -> [f32; 3] {
    let stripe = |t: f64| (t * 3.0).rem_euclid(1.0);
    let (a, b) = (stripe(u), stripe(v));
    let both = usize::from(a < 0.5) + usize::from(b < 0.5);
    let base = paint::mix(main, second, both as f32 * 0.5);
    let line = a < 0.06 || b < 0.06;
    let border = u.abs() > 0.95 || v.abs() > 0.95;
    let colour = if line || border { paint::mix(base, [0.97, 0.95, 0.90], 0.8) } else { base };
    colour.map(|c| c * 0.95)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::synth::SynthKind;

    #[test]
    fn displacement_has_rank_four() {
        let options =
            SynthOptions { kind: SynthKind::Cloth, gaussians: 1_000, frames: 24, ..SynthOptions::default() };
        let epoch = make(&options).unwrap();
        let (n, a) = (epoch.count(), epoch.attributes());
        // Displacement from frame 0 over the first 200 Gaussians.
        let matrix = nalgebra::DMatrix::from_fn(600, 23, |row, t| {
            let at = |t: usize| f64::from(a.positions.frame(t, n)[row / 3][row % 3]);
            at(t + 1) - at(0)
        });
        let values = matrix.svd(false, false).singular_values;
        assert!(values[3] > 1e-2, "fourth mode {}", values[3]);
        assert!(values[4] < 1e-4, "fifth mode, rounding of f32 only: {}", values[4]);
    }

    #[test]
    fn slopes_are_the_derivatives_of_fields() {
        let h = 1e-6;
        for (u, v) in [(0.3, -0.4), (-0.9, 0.8), (0.0, 1.0)] {
            for k in 0..MODES {
                let du = (fields(u + h, v)[k] - fields(u - h, v)[k]) / (2.0 * h);
                let dv = (fields(u, v + h)[k] - fields(u, v - h)[k]) / (2.0 * h);
                assert!((du - slopes(u, v)[k].0).length() < 1e-8, "field {k} along u");
                assert!((dv - slopes(u, v)[k].1).length() < 1e-8, "field {k} along v");
            }
        }
    }
}
