//! Renders states and sources, and scores one against the other.

use codec_core::internals::receiver::Content;
use rayon::prelude::*;
use render_host::{Backend, Camera, Image, Renderer, Settings, Splats, metric};

use super::{EvaluationError, PSNR_CAP_DB, drawing::next, instant_at};
use crate::{
    scene::{Instant, Scene},
    stream::Player,
};

/// Renders one instant.
///
/// # Errors
/// Splats or settings the renderer refuses.
pub fn render(instant: &Instant, camera: &Camera, settings: &Settings) -> Result<Image, EvaluationError> {
    let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
    let rendered = Renderer::new().render(&splats, camera, settings)?;
    Ok(rendered.image)
}

/// The source's own renders of `frames` on `backend`, in order, in parallel over frames, with its footprint.
///
/// # Errors
/// As [`render`]; a frame past the end.
pub fn references(
    scene: &Scene,
    frames: &[u32],
    camera: &Camera,
    settings: &Settings,
    backend: &Backend,
) -> Result<Vec<Image>, EvaluationError> {
    let serial = Settings { parallel: false, ..settings.clone() }.with_footprint(scene.footprint);
    frames
        .par_iter()
        .with_min_len(run_length(frames.len()))
        .map_init(
            || backend.frames(),
            |renderer, &frame| {
                let instant = instant_at(scene, frame)?;
                let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
                Ok(next(renderer, &splats, camera, &serial)?)
            },
        )
        .collect()
}

/// Frames that one renderer draws in a row: long enough to profit from the frame before, short enough to
/// keep all threads busy. Pictures do not depend on it.
fn run_length(frames: usize) -> usize {
    (frames / (2 * rayon::current_num_threads())).clamp(1, 16)
}

/// Renders `content` on `backend` in each (frame, state), in order, in parallel, with its footprint; no state
/// gives the background.
///
/// # Errors
/// As [`render`]; a frame past the end.
pub fn renders(
    content: &Content<'_>,
    shown: &[(u32, Option<&[u8]>)],
    camera: &Camera,
    settings: &Settings,
    backend: &Backend,
) -> Result<Vec<Image>, EvaluationError> {
    let footprint = content.manifest.footprint();
    let settings = Settings { parallel: false, ..settings.clone() }.with_footprint(footprint);
    shown
        .par_iter()
        .with_min_len(run_length(shown.len()))
        .map_init(
            || (Player::new(content.manifest), backend.frames()),
            |(player, renderer), (frame, state)| {
                let Some(state) = state else {
                    let Settings { background, .. } = settings;
                    return Ok(Image::filled(camera.width(), camera.height(), background.map(|c| c as _))?);
                };
                let shown = player.show(&content.with_state(state), *frame)?;
                let splats = Splats::new(shown.gaussians, shown.sh_rest, shown.sh_degree)?;
                Ok(next(renderer, &splats, camera, &settings)?)
            },
        )
        .collect()
}

/// Image metrics of one image against its reference.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Score {
    /// PSNR, dB, capped at [`PSNR_CAP_DB`].
    pub psnr_db: f64,
    /// SSIM, 11×11 Gaussian window.
    pub ssim: f64,
}

/// PSNR and SSIM of `image` against `reference`.
///
/// # Errors
/// Images of different sizes.
pub fn score(image: &Image, reference: &Image) -> Result<Score, EvaluationError> {
    let psnr = metric::psnr(image, reference)?;
    let ssim = metric::ssim(image, reference)?;
    Ok(Score { psnr_db: psnr.min(PSNR_CAP_DB), ssim })
}

/// Mean FLIP of `image` against `reference` at the default viewing distance.
///
/// # Errors
/// Images of different sizes.
pub fn flip(image: &Image, reference: &Image) -> Result<f64, EvaluationError> {
    Ok(metric::flip(image, reference, metric::flip::PIXELS_PER_DEGREE)?.mean)
}

/// Mean of the worst tenth (at least one) of `values`.
pub fn worst_tenth(values: &[f64]) -> f64 {
    let mut sorted = values.to_vec();
    sorted.sort_by(f64::total_cmp);
    sorted.truncate(values.len().div_ceil(10).max(1));
    sorted.iter().sum::<f64>() / sorted.len().max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Frames out of order and twice, on any number of threads, are what each is alone.
    #[test]
    fn frames_in_a_row_are_what_they_are_alone() {
        let options = crate::import::synth::SynthOptions {
            kind: crate::import::synth::SynthKind::Balls,
            gaussians: 1500,
            frames: 12,
            ..Default::default()
        };
        let scene = crate::import::synth::make(&options, &Default::default()).unwrap();
        let framing = crate::viewpoint::Framing::of(&scene);
        let camera = &framing.ring(crate::viewpoint::Ring::HeldOut, 3, (64, 48)).unwrap()[0];
        let settings = Settings::default();
        let frames = [0, 1, 2, 3, 3, 7, 4, 5, 11, 10];
        let expected: Vec<Image> = frames
            .iter()
            .map(|&f| render(&scene.instant(f as usize).unwrap(), camera, &settings).unwrap())
            .collect();
        for threads in [1, 3] {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            let got = pool.install(|| references(&scene, &frames, camera, &settings, &Backend::Cpu).unwrap());
            assert!(got == expected, "{threads} threads");
        }
        assert_ne!(expected[0], expected[5], "the frames differ, or this test says nothing");
    }

    #[test]
    fn the_worst_tenth_is_the_lowest() {
        let values: Vec<f64> = (0..20).map(f64::from).collect();
        assert_eq!(worst_tenth(&values), 0.5);
        assert_eq!(worst_tenth(&[3.0]), 3.0);
    }
}
