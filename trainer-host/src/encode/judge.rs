//! How close a decoded state is to its source, in pictures: for choices the encoder makes.

use codec_core::internals::receiver::Content;
use rayon::prelude::*;
use render_host::{Camera, Image, Renderer, Settings, Splats, metric};

use crate::{
    scene::Scene,
    stream::{Player, Stream},
    viewpoint::{Framing, Ring},
};

mod segments;

pub use segments::{Point, Segment, segments};

/// PSNR counts up to this, dB: beyond it images are equal to the eye and to 8 bits.
pub const PSNR_CAP_DB: f64 = 99.0;

/// Width and height of the pictures of [`Judge::measuring`], pixels.
const SIZE: (u32, u32) = (256, 256);
/// Cameras of [`Judge::measuring`].
const CAMERAS: usize = 3;

/// Why a state cannot be judged.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error("cannot judge: {0}")]
pub struct JudgeError(String);

pub(crate) fn failed(error: impl std::fmt::Display) -> JudgeError {
    JudgeError(error.to_string())
}

/// The source's own pictures of some frames from some cameras.
#[derive(Debug)]
pub struct Judge {
    cameras: Vec<Camera>,
    frames: Vec<u32>,
    settings: Settings,
    /// Frame by frame, one per camera.
    references: Vec<Image>,
}

impl Judge {
    /// Renders `frames` of `scene` from `cameras`.
    ///
    /// # Errors
    /// A frame past the end, or what the renderer refuses.
    pub fn new(
        scene: &Scene,
        cameras: Vec<Camera>,
        frames: Vec<u32>,
        settings: &Settings,
    ) -> Result<Self, JudgeError> {
        // One picture is one task.
        let settings = Settings { parallel: false, ..settings.clone() };
        let reference = |&(frame, camera): &(u32, usize)| {
            let instant = scene.instant(frame as usize).ok_or_else(|| failed(format!("no frame {frame}")))?;
            let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree);
            let splats = splats.map_err(failed)?;
            let rendered = Renderer::new().render(&splats, &cameras[camera], &settings);
            rendered.map(|r| r.image).map_err(failed)
        };
        let shots = shots(&frames, cameras.len());
        let references: Result<Vec<Image>, JudgeError> = shots.par_iter().map(reference).collect();
        let references = references?;
        Ok(Self { cameras, frames, settings, references })
    }

    /// A judge that looks at `frames` from the measuring ring, never from held-out cameras.
    ///
    /// # Errors
    /// As [`Judge::new`].
    pub fn measuring(scene: &Scene, frames: Vec<u32>) -> Result<Self, JudgeError> {
        let framing = Framing::of(scene);
        let cameras = framing.ring(Ring::Measuring, CAMERAS, SIZE).map_err(failed)?;
        Self::new(scene, cameras, frames, &Settings::default())
    }

    /// The frames it looks at.
    pub fn frames(&self) -> &[u32] {
        &self.frames
    }

    /// PSNR of `content` in `state` per frame of [`Judge::frames`]: mean over the cameras, dB, each
    /// picture at most [`PSNR_CAP_DB`].
    ///
    /// # Errors
    /// A frame past the end, or what the renderer refuses.
    pub fn psnr(&self, content: &Content<'_>, state: &[u8]) -> Result<Vec<f64>, JudgeError> {
        let content = content.with_state(state);
        let cameras = self.cameras.len().max(1);
        let frames = self.frames.par_iter().zip(self.references.par_chunks(cameras));
        let judged = frames.map_init(
            || Player::new(&content.manifest),
            |player, (&frame, references)| {
                let shown = player.show(&content, frame).map_err(failed)?;
                let splats = Splats::new(shown.gaussians, shown.sh_rest, shown.sh_degree).map_err(failed)?;
                let mut sum = 0.0;
                for (camera, reference) in self.cameras.iter().zip(references) {
                    let rendered = Renderer::new().render(&splats, camera, &self.settings).map_err(failed)?;
                    sum += metric::psnr(&rendered.image, reference).map_err(failed)?.min(PSNR_CAP_DB);
                }
                Ok(sum / cameras as f64)
            },
        );
        judged.collect()
    }

    /// Mean over frames and cameras of the PSNR of all of `stream`, dB.
    ///
    /// # Errors
    /// A stream that does not decode; otherwise as [`Judge::psnr`].
    pub fn whole(&self, stream: &Stream) -> Result<f64, JudgeError> {
        let received = stream.receive().map_err(failed)?;
        let content = received.content();
        let each = self.psnr(&content, content.blocks)?;
        Ok(each.iter().sum::<f64>() / each.len().max(1) as f64)
    }
}

fn shots(frames: &[u32], cameras: usize) -> Vec<(u32, usize)> {
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
        encode::{Options, Quality, encode},
        import::{
            Limits,
            synth::{self, Kind},
        },
    };

    #[test]
    fn frames_are_spread_and_distinct() {
        assert_eq!(spread(10, 4, 9), [10, 11, 12, 13]);
        assert_eq!(spread(0, 60, 3), [10, 30, 50]);
        assert_eq!((spread(0, 1, 4), spread(7, 0, 4)), (vec![0], vec![]));
    }

    #[test]
    fn coarser_steps_and_missing_levels_are_judged_worse() {
        let options = synth::Options { gaussians: 1000, frames: 6, kind: Kind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let judge = Judge::measuring(&scene, spread(0, 6, 2)).unwrap();
        let stream = |factor: f32| {
            let options = Options { quality: Quality::default().scaled(factor), ..Options::default() };
            encode(&scene, &options, &|_, _| {}).unwrap().stream
        };
        let (fine, coarse) = (stream(1.0), stream(8.0));
        let found = judge.whole(&fine).unwrap();
        assert!(found > judge.whole(&coarse).unwrap() + 3.0);
        let received = fine.receive().unwrap();
        let content = received.content();
        let base: Vec<u8> = content.blocks.iter().map(|m| m & 1).collect();
        assert!(judge.psnr(&content, &base).unwrap().iter().all(|&db| db < found - 3.0));
        assert!(Judge::measuring(&scene, vec![6]).is_err());
    }
}
