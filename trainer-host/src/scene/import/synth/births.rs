//! Makes Gaussians that come and go, then another set of them.
//!
//! First half: a turning ring, and puffs that rise from the floor, each fading in and out by opacity on
//! its own schedule. Half way the topology changes: the ring becomes three balls, and the scene goes on
//! as a second epoch with fewer Gaussians. Nothing in the second epoch is anything in the first.

use codec_core::ShDegree;
use glam::{DQuat, DVec3};
use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};

use super::{
    disc::{Disc, OPACITY, golden_angle, log_scales, on_disc, on_sphere, shares, sigma_of, wxyz},
    options::SynthOptions,
    paint,
};
use crate::scene::{
    Attributes, Epoch, SceneError, Track,
    import::snapshot::{logit, sh0_of_colour},
};

const FLOOR: f64 = -1.0;
const FLOOR_RADIUS: f64 = 1.7;
const RING: (f64, f64) = (0.75, 0.24);
const PUFFS: usize = 12;
const TAU: f64 = std::f64::consts::TAU;

/// What moves a disc: the still floor, a turning body, or a puff with its own life.
#[derive(Clone, Copy)]
enum Owner {
    Floor,
    Body { centre: DVec3 },
    Puff { foot: DVec3, birth: f64, life: f64 },
}

/// A disc with its owner; positions are relative to what moves it.
type Placed = (Disc, Owner);

pub(super) fn make(options: &SynthOptions) -> Result<Vec<Epoch>, SceneError> {
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let hue = (rng.random::<f64>() * 8.0) as usize;
    let half = (options.frames / 2).max(1);
    let seconds = options.frames as f64 / options.frames_per_second;
    let puffs: Vec<Owner> = (0..PUFFS)
        .map(|p| {
            let angle = TAU * (p as f64 + 0.8 * rng.random::<f64>()) / PUFFS as f64;
            let reach = 0.9 + 0.5 * rng.random::<f64>();
            Owner::Puff {
                foot: DVec3::new(angle.cos() * reach, FLOOR + 0.1, angle.sin() * reach),
                birth: (rng.random::<f64>() - 0.2) * seconds,
                life: (0.2 + 0.3 * rng.random::<f64>()) * seconds,
            }
        })
        .collect();
    let n = options.gaussians;
    let first =
        floor_and_puffs(n - n / 2, &puffs, hue).into_iter().chain(ring(n / 2, hue)).collect::<Vec<_>>();
    let mut epochs = vec![epoch(&first, 0, half, options)?];
    if options.frames > half {
        let m = n * 3 / 4;
        let second: Vec<_> =
            floor_and_puffs(m / 2, &puffs, hue).into_iter().chain(three(m - m / 2, hue)).collect();
        epochs.push(epoch(&second, half, options.frames, options)?);
    }
    Ok(epochs)
}

fn floor_and_puffs(n: usize, puffs: &[Owner], hue: usize) -> Vec<Placed> {
    let area = std::f64::consts::PI * FLOOR_RADIUS * FLOOR_RADIUS;
    let mut areas = vec![0.25; PUFFS];
    areas.push(area * 0.6);
    let parts = shares(n, &areas);
    let mut out = Vec::with_capacity(n);
    for (p, owner) in puffs.iter().enumerate() {
        let colour = paint::mix(paint::PALETTE[(hue + p) % 8], [1.0; 3], 0.35);
        for i in 0..parts[p] {
            let normal = on_sphere(i, parts[p]);
            let sigma = sigma_of(4.0 * std::f64::consts::PI * 0.0196, parts[p]);
            let disc = Disc { position: normal * 0.14, normal, sigma, colour: paint::lit(colour, normal) };
            out.push((disc, *owner));
        }
    }
    let n = parts[PUFFS];
    for i in 0..n {
        let p = on_disc(i, n) * FLOOR_RADIUS;
        let ring = ((p.length() * 5.0).floor() % 2.0) as f32;
        let colour = paint::mix([0.86, 0.84, 0.80], [0.50, 0.53, 0.58], ring);
        let sigma = sigma_of(area, n);
        out.push((Disc { position: p + DVec3::Y * FLOOR, normal: DVec3::Y, sigma, colour }, Owner::Floor));
    }
    out
}

/// A ring (torus) lying in the x-y plane, evenly covered: the angle round the tube is spread by its
/// share of area, so the outside is no thinner than the inside.
fn ring(n: usize, hue: usize) -> Vec<Placed> {
    let (large, small) = RING;
    let area = TAU * TAU * large * small;
    (0..n)
        .map(|i| {
            let around = i as f64 * golden_angle();
            let share = (i as f64 + 0.5) / n as f64;
            let mut tube = TAU * share;
            for _ in 0..20 {
                tube = TAU * share - small / large * tube.sin();
            }
            let out = DVec3::new(around.cos(), around.sin(), 0.0);
            let normal = (out * tube.cos() + DVec3::Z * tube.sin()).normalize();
            let stripe = ((around / TAU).rem_euclid(1.0) * 12.0).floor() % 2.0;
            let colour = paint::mix(paint::PALETTE[hue % 8], paint::PALETTE[(hue + 1) % 8], stripe as f32);
            let position = out * large + normal * small;
            let disc =
                Disc { position, normal, sigma: sigma_of(area, n), colour: paint::lit(colour, normal) };
            (disc, Owner::Body { centre: DVec3::Y * 0.25 })
        })
        .collect()
}

fn three(n: usize, hue: usize) -> Vec<Placed> {
    let radius = 0.36;
    let parts = shares(n, &[1.0; 3]);
    let mut out = Vec::with_capacity(n);
    for (b, &n) in parts.iter().enumerate() {
        let angle = TAU * b as f64 / 3.0 + TAU / 4.0;
        let centre = DVec3::new(angle.cos(), angle.sin(), 0.0) * RING.0;
        for i in 0..n {
            let normal = on_sphere(i, n);
            let band = ((normal.y * 3.0).floor().rem_euclid(2.0)) as f32;
            let colour = paint::mix(paint::PALETTE[(hue + b) % 8], [1.0; 3], 0.4 * band);
            let sigma = sigma_of(4.0 * std::f64::consts::PI * radius * radius, n);
            let position = centre + normal * radius;
            let disc = Disc { position, normal, sigma, colour: paint::lit(colour, normal) };
            out.push((disc, Owner::Body { centre: DVec3::Y * 0.25 }));
        }
    }
    out
}

/// Opacity of a puff `age` seconds into a life of `life`: up in a fifth of it, down in two fifths.
fn presence(age: f64, life: f64) -> f64 {
    let smooth = |t: f64| {
        let t = t.clamp(0.0, 1.0);
        t * t * (3.0 - 2.0 * t)
    };
    let t = age / life;
    smooth(t * 5.0) * smooth((1.0 - t) * 2.5)
}

fn epoch(placed: &[Placed], start: usize, end: usize, options: &SynthOptions) -> Result<Epoch, SceneError> {
    let (n, frames) = (placed.len(), end - start);
    let mut positions = Vec::with_capacity(n * frames);
    let mut rotations = Vec::with_capacity(n * frames);
    let mut opacity_logits = Vec::with_capacity(n * frames);
    for frame in start..end {
        let seconds = frame as f64 / options.frames_per_second;
        let turn = DQuat::from_rotation_y(0.9 * seconds);
        for (disc, owner) in placed {
            let (p, q, presence) = match *owner {
                Owner::Floor => (disc.position, disc.rotation(), 1.0),
                Owner::Body { centre } => (centre + turn * disc.position, turn * disc.rotation(), 1.0),
                Owner::Puff { foot, birth, life } => {
                    let age = seconds - birth;
                    let rise = DVec3::Y * (0.7 * (age / life).clamp(0.0, 1.0));
                    (foot + rise + disc.position, disc.rotation(), presence(age, life))
                }
            };
            positions.push(p.as_vec3().to_array());
            rotations.push(wxyz(q));
            opacity_logits.push(logit(OPACITY * presence as f32));
        }
    }
    let discs: Vec<Disc> = placed.iter().map(|p| p.0).collect();
    Epoch::new(
        frames,
        Attributes {
            positions: Track::PerFrame(positions),
            rotations: Track::PerFrame(rotations),
            log_scales: Track::Constant(log_scales(&discs)),
            opacity_logits: Track::PerFrame(opacity_logits),
            sh0: Track::Constant(discs.iter().map(|d| d.colour.map(sh0_of_colour)).collect()),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        },
    )
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn puffs_are_born_live_and_die() {
        assert_eq!(presence(-0.1, 1.0), 0.0);
        assert_eq!(presence(0.4, 1.0), 1.0);
        assert!((0.0..1.0).contains(&presence(0.1, 1.0)));
        assert_eq!(presence(1.0, 1.0), 0.0);
    }
}
