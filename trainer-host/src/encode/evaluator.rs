//! Evaluates how close a decoded state is to its source, in pictures from validation cameras.

use codec_core::internals::receiver::Content;
use rayon::prelude::*;
use render_host::{
    Backend, BackendError, Camera, CameraError, Image, ImageError, RenderError, Settings, Splats,
    SplatsError, adjoint::AdjointError, metric,
};

use crate::{
    scene::{Instant, Scene},
    stream::{Player, Stream},
    viewpoint::{Framing, Ring},
};

mod drawing;
mod pictures;
mod segments;

pub use pictures::{Score, flip, references, render, renders, score, worst_tenth};
pub use segments::{Point, Segment, segments};

/// PSNR counts up to this, dB: beyond it images are equal to the eye and to 8 bits.
pub const PSNR_CAP_DB: f64 = 99.0;

/// Width and height of the pictures of [`Evaluator::validation`], pixels.
const SIZE: (u32, u32) = (256, 256);
/// Cameras of [`Evaluator::validation`].
const CAMERAS: usize = 3;

/// Why a state cannot be evaluated.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EvaluationError {
    /// A frame past the end.
    #[error("cannot evaluate frame {frame}: the scene has frames 0..{frames}")]
    Frame {
        /// The frame asked for.
        frame: u32,
        /// Frames of the scene.
        frames: usize,
    },
    /// The stream does not decode.
    #[error("cannot evaluate a stream that does not decode: {0}")]
    Decode(#[from] codec_core::Error),
    /// No such camera.
    #[error("cannot place a validation camera: {0}")]
    Camera(#[from] CameraError),
    /// Gaussians that cannot be rendered.
    #[error("cannot render the Gaussians: {0}")]
    Splats(#[from] SplatsError),
    /// A picture that cannot be rendered.
    #[error("cannot render a picture: {0}")]
    Render(#[from] RenderError),
    /// A picture that the chosen device cannot make.
    #[error("cannot render a picture: {0}")]
    Device(#[from] BackendError),
    /// Gradients that cannot be computed.
    #[error("cannot compute gradients of a picture: {0}")]
    Gradients(#[from] AdjointError),
    /// Pictures that cannot be compared.
    #[error("cannot compare pictures: {0}")]
    Compare(#[from] ImageError),
}

/// The pictures that a PSNR is a mean over, each weighed by the share of it that the scene covers.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct MeasuredViews {
    /// Cameras.
    pub cameras: usize,
    /// Frames, each seen from every camera.
    pub frames: usize,
    /// Width of the widest picture, pixels.
    pub width: u32,
    /// Height of the highest picture, pixels.
    pub height: u32,
    /// Share of the pictures that the scene covers, 0 to 1: what is left shows the background, and is equal
    /// in any encoding.
    pub covered: f64,
}

/// Frame `frame` of `scene`.
pub(super) fn instant_at(scene: &Scene, frame: u32) -> Result<Instant, EvaluationError> {
    scene.instant(frame as usize).ok_or(EvaluationError::Frame { frame, frames: scene.frames() })
}

/// The source's own pictures of some frames from some cameras.
///
/// # Examples
/// ```
/// use trainer_host::{
///     encode::{EncodeOptions, encode},
///     evaluator::{Evaluator, spread},
///     import::{Limits, synth},
/// };
///
/// let options = synth::SynthOptions { gaussians: 1000, frames: 2, ..Default::default() };
/// let scene = synth::make(&options, &Limits::default())?;
/// let options = EncodeOptions { pictures: 0, ..Default::default() };
/// let encoded = encode(&scene, &options, &trainer_host::encode::no_progress)?;
/// let evaluator = Evaluator::validation(&scene, spread(0, 2, 1))?;
/// assert!(evaluator.whole(&encoded.stream)? > 30.0, "dB");
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug)]
pub struct Evaluator {
    cameras: Vec<Camera>,
    frames: Vec<u32>,
    settings: Settings,
    backend: Backend,
    /// Frame by frame, one per camera.
    references: Vec<Image>,
    /// The share of each that the scene covers, 0 to 1.
    covered: Vec<f64>,
}

impl Evaluator {
    /// Renders `frames` of `scene` from `cameras` on `backend`, with its footprint.
    ///
    /// # Errors
    /// A frame past the end, or what the renderer refuses.
    pub fn new(
        scene: &Scene,
        cameras: Vec<Camera>,
        frames: Vec<u32>,
        settings: &Settings,
        backend: &Backend,
    ) -> Result<Self, EvaluationError> {
        // One picture is one task.
        let settings = Settings { parallel: false, ..settings.clone() }.with_footprint(scene.footprint);
        let reference = |renderer: &mut drawing::Drawing, &(frame, camera): &(u32, usize)| {
            let instant = instant_at(scene, frame)?;
            let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
            Ok(drawing::with_coverage(renderer, &splats, &cameras[camera], &settings)?)
        };
        let views = views(&frames, cameras.len());
        let pictures: Result<Vec<(Image, f64)>, EvaluationError> =
            views.par_iter().map_init(|| backend.frames(), reference).collect();
        let (references, covered) = pictures?.into_iter().unzip();
        Ok(Self { references, covered, cameras, frames, settings, backend: backend.clone() })
    }

    /// An evaluator that renders `frames` from the validation ring, never from held-out cameras.
    ///
    /// # Errors
    /// As [`Evaluator::new`].
    pub fn validation(scene: &Scene, frames: Vec<u32>) -> Result<Self, EvaluationError> {
        Self::validation_on(scene, frames, &Backend::Cpu)
    }

    /// As [`Evaluator::validation`], with pictures drawn by `backend`.
    ///
    /// # Errors
    /// As [`Evaluator::new`].
    pub fn validation_on(
        scene: &Scene,
        frames: Vec<u32>,
        backend: &Backend,
    ) -> Result<Self, EvaluationError> {
        let framing = Framing::of(scene);
        let cameras = framing.ring(Ring::Validation, CAMERAS, SIZE)?;
        Self::new(scene, cameras, frames, &Settings::default(), backend)
    }

    /// What its pictures are.
    pub(super) fn measured(&self) -> MeasuredViews {
        let pixels = |picture: &Image| f64::from(picture.width()) * f64::from(picture.height());
        let sizes: Vec<f64> = self.references.iter().map(pixels).collect();
        MeasuredViews {
            cameras: self.cameras.len(),
            frames: self.frames.len(),
            width: self.cameras.iter().map(Camera::width).max().unwrap_or(0),
            height: self.cameras.iter().map(Camera::height).max().unwrap_or(0),
            covered: weighted_mean(&self.covered, &sizes),
        }
    }

    /// The frames it renders.
    pub fn frames(&self) -> &[u32] {
        &self.frames
    }

    /// PSNR of `content` in `state` per frame of [`Evaluator::frames`]: mean over the cameras, dB, each
    /// picture at most [`PSNR_CAP_DB`].
    ///
    /// # Errors
    /// A frame past the end, or what the renderer refuses.
    pub fn psnr(&self, content: &Content<'_>, state: &[u8]) -> Result<Vec<f64>, EvaluationError> {
        let each = self.psnr_of_pictures(content, state)?;
        let mean = |of_frame: &Vec<f64>| of_frame.iter().sum::<f64>() / of_frame.len().max(1) as f64;
        Ok(each.iter().map(mean).collect())
    }

    /// PSNR of `content` in `state` per frame and camera, dB, at most [`PSNR_CAP_DB`].
    fn psnr_of_pictures(
        &self,
        content: &Content<'_>,
        state: &[u8],
    ) -> Result<Vec<Vec<f64>>, EvaluationError> {
        let content = content.with_state(state);
        let cameras = self.cameras.len().max(1);
        let frames = self.frames.par_iter().zip(self.references.par_chunks(cameras));
        let evaluated = frames.map_init(
            || (Player::new(content.manifest), self.backend.frames()),
            |(player, renderer), (&frame, references)| {
                let shown = player.show(&content, frame)?;
                let splats = Splats::new(shown.gaussians, shown.sh_rest, shown.sh_degree)?;
                let of_camera = |(camera, reference): (&Camera, &Image)| -> Result<f64, EvaluationError> {
                    let picture = drawing::next(renderer, &splats, camera, &self.settings)?;
                    Ok(metric::psnr(&picture, reference)?.min(PSNR_CAP_DB))
                };
                self.cameras
                    .iter()
                    .zip(references)
                    .map(of_camera)
                    .collect::<Result<Vec<f64>, EvaluationError>>()
            },
        );
        evaluated.collect()
    }

    /// Mean over frames and cameras of the PSNR of all of `stream`, dB, each picture at most [`PSNR_CAP_DB`]
    /// and weighed by the share of it that the scene covers: where little is seen, little can be wrong.
    ///
    /// # Errors
    /// A stream that does not decode; otherwise as [`Evaluator::psnr`].
    pub fn whole(&self, stream: &Stream) -> Result<f64, EvaluationError> {
        let received = stream.receive()?;
        let content = received.content();
        let each = self.psnr_of_pictures(&content, content.blocks)?;
        Ok(weighted_mean(&each.concat(), &self.covered))
    }
}

/// The mean of `values`, each weighed by its weight, 0 or more; where all weights are 0, the plain mean.
fn weighted_mean(values: &[f64], weights: &[f64]) -> f64 {
    let all: f64 = weights.iter().sum();
    if all > 0.0 {
        values.iter().zip(weights).map(|(value, weight)| value * weight).sum::<f64>() / all
    } else {
        values.iter().sum::<f64>() / values.len().max(1) as f64
    }
}

fn views(frames: &[u32], cameras: usize) -> Vec<(u32, usize)> {
    frames.iter().flat_map(|&frame| (0..cameras).map(move |camera| (frame, camera))).collect()
}

/// Up to `count` of the frames `first..first + frames`, each in the middle of an equal part.
pub fn spread(first: u32, frames: u32, count: u32) -> Vec<u32> {
    let count = count.min(frames);
    (0..count).map(|k| first + (2 * k + 1) * frames / (2 * count)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode::{EncodeOptions, QuantiserSteps, encode},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
    };

    #[test]
    fn frames_are_spread_and_distinct() {
        assert_eq!(spread(10, 4, 9), [10, 11, 12, 13]);
        assert_eq!(spread(0, 60, 3), [10, 30, 50]);
        assert_eq!((spread(0, 1, 4), spread(7, 0, 4)), (vec![0], vec![]));
    }

    #[test]
    fn pictures_count_by_the_share_that_the_scene_covers() {
        assert_eq!(weighted_mean(&[30.0, 40.0], &[0.5, 0.5]), 35.0);
        assert_eq!(weighted_mean(&[30.0, 40.0], &[0.75, 0.25]), 32.5);
        assert_eq!(weighted_mean(&[30.0, 40.0], &[0.0, 0.0]), 35.0);

        let options =
            synth::SynthOptions { gaussians: 1000, frames: 2, kind: SynthKind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let coarse = QuantiserSteps::default().scaled(4.0);
        let options = EncodeOptions { quality: coarse, pictures: 0, ..EncodeOptions::default() };
        let stream = encode(&scene, &options, &crate::encode::no_progress).unwrap().stream;
        let framing = Framing::of(&scene);
        let camera = |radius: f64| {
            let framing = Framing { radius, ..framing };
            framing.ring(Ring::Validation, 1, (96, 96)).unwrap().remove(0)
        };
        let (near, far) = (camera(framing.radius), camera(8.0 * framing.radius));
        // PSNR of all, the plain mean over the pictures, and how much of them is covered.
        let marks = |cameras: Vec<Camera>| {
            let evaluator =
                Evaluator::new(&scene, cameras, vec![0], &Settings::default(), &Backend::Cpu).unwrap();
            let received = stream.receive().unwrap();
            let content = received.content();
            let plain = evaluator.psnr(&content, content.blocks).unwrap()[0];
            (evaluator.whole(&stream).unwrap(), plain, evaluator.measured().covered)
        };
        let (alone, of_near, covered_near) = marks(vec![near.clone()]);
        assert!((alone - of_near).abs() < 1e-9);
        let (even, plain, covered) = marks(vec![near.clone(), near.clone()]);
        assert!((even - plain).abs() < 1e-9 && (even - of_near).abs() < 1e-9, "{even}: {plain}, {of_near}");
        assert!((covered - covered_near).abs() < 1e-9);
        let (_, of_far, covered_far) = marks(vec![far.clone()]);
        assert!(of_far > of_near + 3.0 && covered_far < 0.2 * covered_near, "{of_far}, {of_near}");
        let (weighed, plain, _) = marks(vec![near, far]);
        assert!((plain - 0.5 * (of_near + of_far)).abs() < 1e-9);
        let expected = (covered_near * of_near + covered_far * of_far) / (covered_near + covered_far);
        assert!((weighed - expected).abs() < 1e-9 && weighed < plain - 1.0, "{weighed}, {plain}");
    }

    #[test]
    fn coarser_steps_and_missing_levels_are_evaluated_worse() {
        let options =
            synth::SynthOptions { gaussians: 1000, frames: 6, kind: SynthKind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let evaluator = Evaluator::validation(&scene, spread(0, 6, 2)).unwrap();
        let stream = |factor: f32| {
            let options = EncodeOptions {
                quality: QuantiserSteps::default().scaled(factor),
                ..EncodeOptions::default()
            };
            encode(&scene, &options, &crate::encode::no_progress).unwrap().stream
        };
        let (fine, coarse) = (stream(1.0), stream(8.0));
        let found = evaluator.whole(&fine).unwrap();
        assert!(found > evaluator.whole(&coarse).unwrap() + 3.0);
        let received = fine.receive().unwrap();
        let content = received.content();
        let base: Vec<u8> = content.blocks.iter().map(|m| m & 1).collect();
        assert!(evaluator.psnr(&content, &base).unwrap().iter().all(|&db| db < found - 3.0));
        assert!(Evaluator::validation(&scene, vec![6]).is_err());
    }
}
