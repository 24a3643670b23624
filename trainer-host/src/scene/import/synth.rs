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
mod disc;
mod figure;
mod options;
mod paint;

pub use cloth::MODES as CLOTH_MODES;
pub use options::{SynthKind, SynthOptions};

use super::{
    Limits,
    error::{Format, ImportError},
    snapshot::scene_error,
};
use crate::scene::Scene;

/// Makes a scene.
///
/// # Errors
/// A count outside 1,000..=1,000,000, no frames, more than `limits` hold, or a bad frame rate.
pub fn make(options: &SynthOptions, limits: &Limits) -> Result<Scene, ImportError> {
    const FORMAT: Format = Format::Unknown;
    if !(1_000..=1_000_000).contains(&options.gaussians) {
        return Err(FORMAT.malformed("Gaussians", options.gaussians, "1000 to 1000000"));
    }
    limits.gaussians(FORMAT, options.gaussians as u64)?;
    // Positions and rotations are stored per frame; cloth and births need more for a while.
    let bytes = (options.gaussians as u64 * 56).saturating_mul(options.frames as u64);
    limits.bytes(FORMAT, "Gaussians x frames", bytes)?;
    let epochs = match options.kind {
        SynthKind::Balls => balls::make(options).map(|e| vec![e]),
        SynthKind::Figure => figure::make(options).map(|e| vec![e]),
        SynthKind::Cloth => cloth::make(options).map(|e| vec![e]),
        SynthKind::Births => births::make(options),
    };
    let mut scene = epochs
        .and_then(|epochs| Scene::new(epochs, options.frames_per_second))
        .map_err(|e| scene_error(FORMAT, &e))?;
    scene.notes.push(format!("synthetic {}, seed {}, y up", options.kind.name(), options.seed));
    Ok(scene)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn small(kind: SynthKind) -> SynthOptions {
        SynthOptions { kind, gaussians: 2_000, frames: 20, ..SynthOptions::default() }
    }

    #[test]
    fn the_same_options_give_the_same_scene() {
        for kind in SynthKind::ALL {
            let make = |seed| make(&SynthOptions { seed, ..small(kind) }, &Limits::default()).unwrap();
            assert_eq!(make(7).epochs(), make(7).epochs(), "{kind:?}");
            assert_ne!(make(7).epochs(), make(8).epochs(), "{kind:?}");
            assert_eq!(SynthKind::from_name(kind.name()), Some(kind));
        }
    }

    #[test]
    fn scenes_have_the_given_size_and_stay_near_the_origin() {
        for kind in SynthKind::ALL {
            let scene = make(&small(kind), &Limits::default()).unwrap();
            assert_eq!(scene.frames(), 20, "{kind:?}");
            assert_eq!(scene.epochs()[0].count(), 2_000, "{kind:?}");
            for frame in 0..20 {
                for g in scene.instant(frame).unwrap().gaussians {
                    assert!(g.position.iter().all(|v| v.abs() <= 2.05), "{kind:?}: {:?}", g.position);
                    let colour = g.sh0.map(|c| 0.5 + crate::scene::activation::SH_C0 * c);
                    assert!(colour.iter().all(|c| (-1e-5..=1.0 + 1e-5).contains(c)), "{kind:?}: {colour:?}");
                }
            }
        }
    }

    #[test]
    fn births_have_two_epochs_of_different_size_and_opacities_that_move() {
        let scene = make(&small(SynthKind::Births), &Limits::default()).unwrap();
        assert_eq!(scene.epochs().len(), 2);
        assert_ne!(scene.epochs()[0].count(), scene.epochs()[1].count());
        assert!(!scene.epochs()[0].attributes().opacity_logits.is_constant());
    }

    #[test]
    fn requests_out_of_range_are_refused() {
        let few = SynthOptions { gaussians: 10, ..SynthOptions::default() };
        assert!(make(&few, &Limits::default()).unwrap_err().to_string().contains("1000 to 1000000"));
        assert!(make(&SynthOptions { frames: 0, ..small(SynthKind::Cloth) }, &Limits::default()).is_err());
        let many = SynthOptions { gaussians: 1_000_000, frames: usize::MAX, ..SynthOptions::default() };
        assert!(make(&many, &Limits::default()).is_err());
    }
}
