//! Lists the scenes of the bench with the evaluator of each: cameras nothing was tuned on, and pictures that
//! the uncompressed source gives there.

use anyhow::Result;
use rayon::prelude::*;
use render_host::{Backend, Camera, Image, Settings};
use trainer_host::{
    Instant, Scene, evaluator,
    viewpoint::{Framing, Ring},
};

use crate::{
    figures::{Bench, mean},
    setup::{Setup, load, spread, synth},
};

/// A scene by name.
pub struct Named {
    /// Key of its figures.
    pub key: String,
    /// The scene.
    pub scene: Scene,
    /// Whether means over scenes count it: not for a second encoding of a scene that is there already.
    pub counts: bool,
}

/// Calls `each` with one scene after the other; those that are absent are named in `bench.skipped`.
///
/// # Errors
/// What importing or `each` says.
pub fn for_each(
    setup: &Setup,
    bench: &mut Bench,
    mut each: impl FnMut(&mut Bench, Named) -> Result<()>,
) -> Result<()> {
    let samples = if setup.quick { 500 } else { 10_000 };
    for (key, path, counts) in [
        ("fox", "scenes/gltf-fox/Fox.glb", true),
        ("cesium-man", "scenes/gltf-cesium-man/CesiumMan.glb", true),
        ("biker-spz", "scenes/splat-biker/biker.spz", true),
        ("biker-ply", "scenes/splat-biker/biker.compressed.ply", false),
        ("human", "scenes/splat-seq-human", true),
    ] {
        let Some(path) = setup.data(path, bench)? else { continue };
        if setup.quick && !matches!(key, "fox" | "cesium-man") {
            bench.skipped.push(format!("{key}: left out by --quick"));
            continue;
        }
        each(bench, Named { key: key.to_owned(), scene: load(&path, samples)?, counts })?;
    }
    let (kinds, n, frames): (&[&str], usize, usize) = if setup.quick {
        (&["figure"], 1000, 8)
    } else {
        (&["balls", "figure", "cloth", "births"], 6_000, 60)
    };
    for kind in kinds {
        let scene = synth(kind, n, frames)?;
        each(bench, Named { key: format!("synth-{kind}"), scene, counts: true })?;
    }
    Ok(())
}

/// Mean and worst quality over all pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct QualityScores {
    /// Mean PSNR, each picture's capped, dB.
    pub psnr: f64,
    /// Lowest PSNR, dB.
    pub psnr_min: f64,
    /// Mean SSIM.
    pub ssim: f64,
    /// Mean FLIP.
    pub flip: f64,
}

/// Cameras, frames, and the source's pictures.
pub struct Evaluator {
    cameras: Vec<Camera>,
    /// Frames looked at.
    pub frames: Vec<u32>,
    /// Per camera, per frame.
    references: Vec<Vec<Image>>,
}

impl Evaluator {
    /// Three held-out cameras of `size` squared, up to `shown` frames spread over the clip.
    ///
    /// # Errors
    /// What the renderer refuses.
    pub fn of(scene: &Scene, size: u32, shown: usize) -> Result<Self> {
        let cameras = Framing::of(scene).ring(Ring::HeldOut, 3, (size, size))?;
        let frames = spread(scene.frames(), shown);
        let settings = Settings::default();
        let references: Result<Vec<_>, _> = cameras
            .iter()
            .map(|c| evaluator::references(scene, &frames, c, &settings, &Backend::Cpu))
            .collect();
        Ok(Self { cameras, frames, references: references? })
    }

    /// Marks of `shown`, the decoded [`Evaluator::frames`] in order. FLIP is that of the first camera: it
    /// takes as long as all else together.
    ///
    /// # Errors
    /// What the renderer refuses.
    pub fn marks(&self, shown: &[Instant]) -> Result<QualityScores> {
        anyhow::ensure!(shown.len() == self.frames.len(), "{} frames were decoded", shown.len());
        let settings = Settings { parallel: false, ..Settings::default() };
        let pairs: Vec<(usize, usize)> =
            (0..self.cameras.len()).flat_map(|c| (0..shown.len()).map(move |f| (c, f))).collect();
        let scores: Result<Vec<(evaluator::Score, Option<f64>)>> = pairs
            .par_iter()
            .map(|&(c, f)| {
                let image = evaluator::render(&shown[f], &self.cameras[c], &settings)?;
                let reference = &self.references[c][f];
                let flip = (c == 0).then(|| evaluator::flip(&image, reference)).transpose()?;
                Ok((evaluator::score(&image, reference)?, flip))
            })
            .collect();
        let scores = scores?;
        let psnr: Vec<f64> = scores.iter().map(|s| s.0.psnr_db).collect();
        let ssim: Vec<f64> = scores.iter().map(|s| s.0.ssim).collect();
        let flip: Vec<f64> = scores.iter().filter_map(|s| s.1).collect();
        let psnr_min = psnr.iter().copied().fold(f64::MAX, f64::min);
        Ok(QualityScores { psnr: mean(&psnr), psnr_min, ssim: mean(&ssim), flip: mean(&flip) })
    }
}
