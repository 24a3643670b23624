//! Makes a dataset of a scene by rendering it: training then gives it one identity over all frames.
//!
//! A sequence of splats whose identity is not stored costs an epoch per frame to send. Its own renders,
//! without noise and from any camera, are photographs that a moving scene can be fitted to.

use std::ops::Range;

use rayon::prelude::*;
use render_host::{
    Camera, RenderError, Renderer, Settings, Splats, SplatsError, adjoint::loss::photograph::Photograph,
    camera::CameraError,
};

use crate::{
    scene::{
        Scene,
        viewpoint::{Framing, Ring},
    },
    train::views::{Dataset, FreeSpace, PosedPhotograph, Start, Views, ViewsError},
};

/// How a scene is looked at.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct RenderedOptions {
    /// Cameras all around per frame, for training.
    pub cameras: usize,
    /// Cameras on the held-out ring, for testing, each at every frame.
    pub test_cameras: usize,
    /// Side of the square images, pixels.
    pub side: u32,
    /// Time of the frame whose Gaussians a training starts with, 0 to 1, as
    /// [`TrainOptions::canonical_time`](crate::train::TrainOptions::canonical_time).
    pub canonical_time: f32,
}

impl Default for RenderedOptions {
    fn default() -> Self {
        Self { cameras: 24, test_cameras: 4, side: 400, canonical_time: 0.5 }
    }
}

/// A scene that cannot be rendered.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum RenderedError {
    /// Nothing that a picture could show.
    #[error("{name}: none of its {frames} frames has Gaussians; at least one Gaussian is needed")]
    Empty {
        /// What the scene is called.
        name: String,
        /// Frames of the scene.
        frames: usize,
    },
    /// A side that the camera refuses.
    #[error("side: {0}")]
    Camera(#[from] CameraError),
    /// A frame with values that no picture can show.
    #[error("frame {frame}: {source}")]
    Splats {
        /// The frame.
        frame: usize,
        /// What is wrong.
        source: SplatsError,
    },
    /// A picture that cannot be made.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Pictures that do not fit together.
    #[error(transparent)]
    Views(#[from] ViewsError),
}

/// Renders `scene`, called `name`. Cameras for testing stand at least 6 degrees from all others.
///
/// # Errors
/// A side that is out of range, a frame that no picture can show, or no frame that has Gaussians.
pub fn rendered(scene: &Scene, name: &str, options: &RenderedOptions) -> Result<Dataset, RenderedError> {
    if scene.max_count() == 0 {
        return Err(RenderedError::Empty { name: name.to_owned(), frames: scene.frames() });
    }
    let framing = Framing::of(scene);
    let size = (options.side, options.side);
    let train = photographs(scene, &framing.around(options.cameras, size)?)?;
    let test = photographs(scene, &framing.ring(Ring::HeldOut, options.test_cameras, size)?)?;
    Ok(Dataset {
        name: name.to_owned(),
        train: Views::new(train)?,
        validation: Views::new(Vec::new())?,
        test: Views::new(test)?,
        test_scale: 1,
        start: start(scene, 0..scene.frames(), options.canonical_time),
        free_space: FreeSpace::default(),
        has_alpha: true,
        frames: scene.frames(),
        up: scene.up,
        footprint: scene.footprint,
    })
}

/// `frames` of what was rendered of `scene`, as a clip of their own, whose training starts with the Gaussians
/// at `canonical_time` of it.
pub fn part(dataset: &Dataset, scene: &Scene, frames: Range<usize>, canonical_time: f32) -> Dataset {
    Dataset {
        name: dataset.name.clone(),
        train: dataset.train.part(dataset.frames, &frames),
        validation: dataset.validation.part(dataset.frames, &frames),
        test: dataset.test.part(dataset.frames, &frames),
        test_scale: dataset.test_scale,
        start: start(scene, frames.clone(), canonical_time),
        free_space: dataset.free_space.clone(),
        has_alpha: dataset.has_alpha,
        frames: frames.len(),
        up: dataset.up,
        footprint: dataset.footprint,
    }
}

/// The Gaussians of the frame nearest to `time` of `frames` that has some: a sequence may be empty at some
/// frames.
fn start(scene: &Scene, frames: Range<usize>, time: f32) -> Start {
    let wanted = frames.start + (f64::from(time) * frames.len().saturating_sub(1) as f64).round() as usize;
    let count = |frame: usize| scene.locate(frame).map_or(0, |(epoch, _)| scene.epochs()[epoch].count());
    let shown = (0..scene.frames()).filter(|&frame| count(frame) > 0);
    let nearest = shown.min_by_key(|frame| frame.abs_diff(wanted)).unwrap_or(wanted);
    let instant = scene.instant(nearest).unwrap_or_default();
    let degree = instant.sh_degree;
    Start::Gaussians(instant, degree)
}

/// What every camera sees of every frame.
fn photographs(scene: &Scene, cameras: &[Camera]) -> Result<Vec<PosedPhotograph>, RenderedError> {
    let frames = scene.frames();
    let settings = Settings { parallel: false, ..Settings::default() }.with_footprint(scene.footprint);
    let of_frame = |frame: usize| -> Result<Vec<PosedPhotograph>, RenderedError> {
        let instant = scene.instant(frame).unwrap_or_default();
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)
            .map_err(|source| RenderedError::Splats { frame, source })?;
        let mut renderer = Renderer::new();
        let time = frame as f32 / frames.saturating_sub(1).max(1) as f32;
        let view = |(index, camera): (usize, &Camera)| {
            let picture = renderer.render(&splats, camera, &settings)?;
            let byte = |v: f32| (v.clamp(0.0, 1.0) * 255.0).round() as u8;
            let pixels = picture.image.rgb().chunks_exact(3).zip(&picture.transmittance);
            // Over black a picture is premultiplied by its alpha. Colours brighter than white are cut at it.
            let rgba = pixels.flat_map(|(rgb, clear)| {
                let alpha = byte(1.0 - clear);
                [byte(rgb[0]).min(alpha), byte(rgb[1]).min(alpha), byte(rgb[2]).min(alpha), alpha]
            });
            let photograph = Photograph::new(camera.width(), camera.height(), rgba.collect())
                .map_err(RenderError::from)?;
            let name = format!("frame {frame}, camera {index}");
            Ok(PosedPhotograph {
                name,
                camera: camera.clone(),
                time,
                photograph,
                foreground: None,
                counted: None,
            })
        };
        cameras.iter().enumerate().map(view).collect()
    };
    let all: Vec<Vec<PosedPhotograph>> =
        (0..frames).into_par_iter().map(of_frame).collect::<Result<_, _>>()?;
    Ok(all.into_iter().flatten().collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        import::{Limits, synth},
        scene::Epoch,
    };

    /// A clip of some balls, a frame each, with Gaussians where `shown` says so.
    fn clip(shown: &[bool]) -> Scene {
        let options = synth::SynthOptions {
            kind: synth::SynthKind::Balls,
            gaussians: 1000,
            frames: 1,
            ..synth::SynthOptions::default()
        };
        let balls = synth::make(&options, &Limits::default()).unwrap();
        let epoch = |&shown: &bool| if shown { balls.epochs()[0].clone() } else { Epoch::empty() };
        Scene::new(shown.iter().map(epoch).collect(), 30.0).unwrap()
    }

    fn started(dataset: &Dataset) -> usize {
        match &dataset.start {
            Start::Gaussians(instant, _) => instant.gaussians.len(),
            _ => 0,
        }
    }

    #[test]
    fn a_start_is_of_a_frame_that_has_gaussians() {
        let options = RenderedOptions { cameras: 1, test_cameras: 1, side: 16, ..Default::default() };
        let scene = clip(&[false, true, false, false]);
        let dataset = rendered(&scene, "clip", &options).unwrap();
        let count = scene.max_count();
        assert!(count > 0 && started(&dataset) == count, "{} of {count}", started(&dataset));
        assert_eq!(started(&part(&dataset, &scene, 0..2, 0.5)), count);
        assert_eq!(started(&part(&dataset, &scene, 2..4, 0.5)), count, "of the part before");
        let first = scene.epochs()[1].clone();
        let more = synth::SynthOptions { gaussians: 1500, frames: 1, ..synth::SynthOptions::default() };
        let last = synth::make(&more, &Limits::default()).unwrap().epochs()[0].clone();
        let two = Scene::new(vec![first, Epoch::empty(), last], 30.0).unwrap();
        let counts = [0.0, 1.0].map(|canonical_time| {
            started(&rendered(&two, "clip", &RenderedOptions { canonical_time, ..options }).unwrap())
        });
        assert_eq!(counts, [two.epochs()[0].count(), two.epochs()[2].count()]);
        assert_ne!(counts[0], counts[1]);
        let error = rendered(&clip(&[false; 3]), "clip", &options).unwrap_err().to_string();
        assert_eq!(error, "clip: none of its 3 frames has Gaussians; at least one Gaussian is needed");
    }
}
