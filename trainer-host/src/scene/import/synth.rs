//! Makes scenes from formulas: no file, no download, and the true motion is known.
//!
//! The same options give the same scene. All scenes are y up (right-handed), lie within 2 units of the
//! origin, stand on the plane y = -1 where they stand, and are made of opaque flat discs spaced evenly
//! over surfaces, so that they show no holes.
//!
//! | kind | motion | what it is for |
//! | --- | --- | --- |
//! | `Balls` | five rigid bodies bouncing and spinning over a still floor | rigid and static clusters |
//! | `Figure` | a walking figure of fourteen capsules | articulated motion |
//! | `Cloth` | a sheet whose displacement has exactly four modes | low-rank motion, rank known |
//! | `Births` | growth and decay by opacity, then another set of Gaussians | opacity, epochs |

mod balls;
mod births;
mod cloth;
mod figure;
mod paint;

pub use cloth::MODES as CLOTH_MODES;

use codec_core::ShDegree;
use glam::{DQuat, DVec3};

use super::{
    Limits,
    error::{Format, ImportError},
    snapshot::{logit, scene_error, sh0_of_colour},
};
use crate::scene::{Attributes, Epoch, Scene, SceneError, Track};

/// Which scene.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum Kind {
    /// Rigid textured balls bouncing over a still chequered floor.
    Balls,
    /// A figure walking on the spot.
    Figure,
    /// A hanging sheet that waves in four modes.
    Cloth,
    /// Blobs that appear and fade; half way, one ring becomes three balls: a second epoch.
    Births,
}

impl Kind {
    /// All kinds.
    pub const ALL: [Self; 4] = [Self::Balls, Self::Figure, Self::Cloth, Self::Births];

    /// The kind called `name`, one of `balls`, `figure`, `cloth`, `births`.
    pub fn from_name(name: &str) -> Option<Self> {
        Self::ALL.into_iter().find(|k| k.name() == name)
    }

    /// Its name.
    pub fn name(self) -> &'static str {
        match self {
            Self::Balls => "balls",
            Self::Figure => "figure",
            Self::Cloth => "cloth",
            Self::Births => "births",
        }
    }
}

/// How to make a scene.
#[derive(Clone, Debug, PartialEq)]
pub struct Options {
    /// Which scene.
    pub kind: Kind,
    /// Gaussians in all, 1,000 to 1,000,000; a scene holds exactly as many (births: its first epoch).
    pub gaussians: usize,
    /// Frames.
    pub frames: usize,
    /// Frames per second.
    pub frames_per_second: f64,
    /// Seed of everything that varies: positions, colours, phases.
    pub seed: u64,
}

impl Default for Options {
    fn default() -> Self {
        Self { kind: Kind::Balls, gaussians: 20_000, frames: 60, frames_per_second: 30.0, seed: 1 }
    }
}

/// Makes a scene.
///
/// # Errors
/// A count outside 1,000..=1,000,000, no frames, more than `limits` hold, or a bad frame rate.
pub fn make(options: &Options, limits: &Limits) -> Result<Scene, ImportError> {
    const FORMAT: Format = Format::Unknown;
    if !(1_000..=1_000_000).contains(&options.gaussians) {
        return Err(FORMAT.malformed("Gaussians", options.gaussians, "1000 to 1000000"));
    }
    limits.gaussians(FORMAT, options.gaussians as u64)?;
    // Positions and rotations are stored per frame; cloth and births need more for a while.
    let held = (options.gaussians as u64 * 56).saturating_mul(options.frames as u64);
    limits.bytes(FORMAT, "Gaussians x frames", held)?;
    let epochs = match options.kind {
        Kind::Balls => balls::make(options).map(|e| vec![e]),
        Kind::Figure => figure::make(options).map(|e| vec![e]),
        Kind::Cloth => cloth::make(options).map(|e| vec![e]),
        Kind::Births => births::make(options),
    };
    let mut scene = epochs
        .and_then(|epochs| Scene::new(epochs, options.frames_per_second))
        .map_err(|e| scene_error(FORMAT, &e))?;
    scene.notes.push(format!("synthetic {}, seed {}, y up", options.kind.name(), options.seed));
    Ok(scene)
}

/// Opacity of every disc.
const OPACITY: f32 = 0.92;
/// Disc radius over disc spacing: three neighbours leave no hole.
const COVER: f64 = 0.62;
/// Thickness of a disc over its radius.
const THINNESS: f64 = 0.1;

/// A disc at rest: where it is, which way it faces, how large, what colour.
#[derive(Clone, Copy, Debug)]
struct Disc {
    position: DVec3,
    normal: DVec3,
    sigma: f64,
    colour: [f32; 3],
}

impl Disc {
    fn rotation(&self) -> DQuat {
        DQuat::from_rotation_arc(DVec3::Z, self.normal)
    }
}

/// The epoch of discs that keep size, colour and opacity while `pose` moves them.
fn epoch_of(
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

fn wxyz(q: DQuat) -> [f32; 4] {
    [q.w, q.x, q.y, q.z].map(|v| v as f32)
}

fn log_scales(discs: &[Disc]) -> Vec<[f32; 3]> {
    discs.iter().map(|d| [d.sigma, d.sigma, d.sigma * THINNESS].map(|s| s.ln() as f32)).collect()
}

/// Point `i` of `n` spread evenly over the unit sphere.
fn on_sphere(i: usize, n: usize) -> DVec3 {
    let z = 1.0 - (2.0 * i as f64 + 1.0) / n as f64;
    let turn = i as f64 * golden_angle();
    let r = (1.0 - z * z).max(0.0).sqrt();
    DVec3::new(r * turn.cos(), z, r * turn.sin())
}

/// Point `i` of `n` spread evenly over the unit disc in x and z.
fn on_disc(i: usize, n: usize) -> DVec3 {
    let r = ((i as f64 + 0.5) / n as f64).sqrt();
    let turn = i as f64 * golden_angle();
    DVec3::new(r * turn.cos(), 0.0, r * turn.sin())
}

fn golden_angle() -> f64 {
    std::f64::consts::PI * (3.0 - 5f64.sqrt())
}

/// Standard deviation of a disc when `n` of them cover `area`.
fn sigma_of(area: f64, n: usize) -> f64 {
    COVER * (2.0 * area / (3f64.sqrt() * n.max(1) as f64)).sqrt()
}

/// Splits `n` in proportion to `areas`; every part gets at least one.
fn shares(n: usize, areas: &[f64]) -> Vec<usize> {
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

    fn small(kind: Kind) -> Options {
        Options { kind, gaussians: 2_000, frames: 20, ..Options::default() }
    }

    #[test]
    fn the_same_options_give_the_same_scene() {
        for kind in Kind::ALL {
            let make = |seed| make(&Options { seed, ..small(kind) }, &Limits::default()).unwrap();
            assert_eq!(make(7).epochs(), make(7).epochs(), "{kind:?}");
            assert_ne!(make(7).epochs(), make(8).epochs(), "{kind:?}");
            assert_eq!(Kind::from_name(kind.name()), Some(kind));
        }
    }

    #[test]
    fn scenes_have_the_size_asked_for_and_stay_near_the_origin() {
        for kind in Kind::ALL {
            let scene = make(&small(kind), &Limits::default()).unwrap();
            assert_eq!(scene.frames(), 20, "{kind:?}");
            assert_eq!(scene.epochs()[0].count(), 2_000, "{kind:?}");
            for frame in 0..20 {
                for g in scene.instant(frame).unwrap().gaussians {
                    assert!(g.position.iter().all(|v| v.abs() <= 2.05), "{kind:?}: {:?}", g.position);
                    let colour = g.sh0.map(|c| 0.5 + 0.282_094_8 * c);
                    assert!(colour.iter().all(|c| (-1e-5..=1.0 + 1e-5).contains(c)), "{kind:?}: {colour:?}");
                }
            }
        }
    }

    #[test]
    fn births_have_two_epochs_of_different_size_and_opacities_that_move() {
        let scene = make(&small(Kind::Births), &Limits::default()).unwrap();
        assert_eq!(scene.epochs().len(), 2);
        assert_ne!(scene.epochs()[0].count(), scene.epochs()[1].count());
        assert!(!scene.epochs()[0].attributes().opacity_logits.is_constant());
    }

    #[test]
    fn requests_out_of_range_are_refused() {
        let few = Options { gaussians: 10, ..Options::default() };
        assert!(make(&few, &Limits::default()).unwrap_err().to_string().contains("1000 to 1000000"));
        assert!(make(&Options { frames: 0, ..small(Kind::Cloth) }, &Limits::default()).is_err());
        let many = Options { gaussians: 1_000_000, frames: usize::MAX, ..Options::default() };
        assert!(make(&many, &Limits::default()).is_err());
    }

    #[test]
    fn shares_add_up() {
        assert_eq!(shares(10, &[1.0, 1.0, 2.0]), [3, 2, 5]);
        for n in [1000, 1001, 77_777] {
            assert_eq!(shares(n, &[0.3, 0.01, 2.0, 0.7]).iter().sum::<usize>(), n);
        }
    }
}
