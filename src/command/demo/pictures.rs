//! Measures what every scheduler showed, a few frames at a time: figures of all frames are kept, pictures
//! only of those that the page shows.

use anyhow::Result;
use codec_core::internals::receiver::Content;
use rayon::prelude::*;
use render_host::{
    Backend, Camera, Image, Settings,
    metric::{self, distortion::STRUCTURE_WEIGHT},
};
use trainer_host::{
    Scene,
    evaluator::{self, PSNR_CAP_DB, Score},
};

use crate::{
    delivery::ShownState,
    figures::mean,
    report::{Picture, Strip},
};

/// Frames shown in strips.
const STRIPS: usize = 4;
/// Error maps reach full scale at this absolute error.
const ERROR_SCALE: f32 = 0.25;
/// Bytes of the source's pictures of one chunk of frames, unless one per thread takes more.
const CHUNK_BYTES: usize = 256 << 20;

/// What is rendered, from where, by what.
pub(super) struct Rendering<'a> {
    pub(super) scene: &'a Scene,
    /// All of the stream.
    pub(super) content: &'a Content<'a>,
    pub(super) camera: &'a Camera,
    pub(super) settings: Settings,
    pub(super) backend: Backend,
}

/// What a scheduler is called, and what it showed of frames.
pub(super) type ShownBy<'a> = (&'a str, &'a [ShownState]);

/// Figures of all frames, and the pictures of some.
pub(super) struct Measured {
    /// PSNR of the complete stream against the source, per frame, dB.
    pub(super) complete_psnr_db: Vec<f64>,
    /// One per scheduler.
    pub(super) runs: Vec<Seen>,
    pub(super) strips: Vec<Strip>,
}

/// Figures of what one scheduler showed.
#[derive(Debug, Default, PartialEq)]
pub(super) struct Seen {
    /// Per frame.
    pub(super) scores: Vec<Score>,
    /// Per frame, as [`metric::distortion()`].
    distortions: Vec<f64>,
    /// Flicker of every frame but the first against the one before.
    changes: Vec<f64>,
    /// The last picture that was added.
    last: Option<Image>,
}

impl Seen {
    /// Adds `images` of frames that follow, against `references`, which begin with that of the frame before
    /// where there is one.
    fn add(&mut self, images: Vec<Image>, references: &[Image]) -> Result<()> {
        let mut images: Vec<Image> = self.last.take().into_iter().chain(images).collect();
        let before = usize::from(!self.scores.is_empty());
        let pairs = images[before..].par_iter().zip(&references[before..]);
        let measured: Result<Vec<(Score, f64)>> = pairs.map(|(a, b)| measured(a, b)).collect();
        let (scores, distortions): (Vec<Score>, Vec<f64>) = measured?.into_iter().unzip();
        self.scores.extend(scores);
        self.distortions.extend(distortions);
        let pairs = images.par_windows(2).zip(references.par_windows(2));
        let changes: Result<Vec<f64>, _> = pairs.map(|(a, b)| metric::flicker(a, b)).collect();
        self.changes.extend(changes?);
        self.last = images.pop();
        Ok(())
    }

    /// Mean of [`metric::distortion()`] over all frames; NaN if there are none.
    pub(super) fn distortion(&self) -> f64 {
        mean(&self.distortions)
    }

    /// As [`metric::flicker`] of all pictures.
    pub(super) fn flicker(&self) -> f64 {
        // The sum of nothing is -0.
        (self.changes.iter().sum::<f64>() + 0.0) / self.changes.len().max(1) as f64
    }
}

/// PSNR and SSIM of `image` against `reference`, and [`metric::distortion()`] of the same SSIM, which takes
/// most of the time.
fn measured(image: &Image, reference: &Image) -> Result<(Score, f64)> {
    let score = evaluator::score(image, reference)?;
    let distortion = metric::mse(image, reference)? + STRUCTURE_WEIGHT * (1.0 - score.ssim);
    Ok((score, distortion))
}

impl Rendering<'_> {
    /// Renders and measures the complete stream and what schedulers showed; `report` gets the number of
    /// frames that are done.
    ///
    /// # Errors
    /// What the renderer refuses.
    pub(super) fn measure(&self, shown: &[ShownBy<'_>], report: &dyn Fn(usize)) -> Result<Measured> {
        let bytes = self.camera.width() as usize * self.camera.height() as usize * size_of::<[f32; 3]>();
        self.measure_by((CHUNK_BYTES / bytes.max(1)).max(rayon::current_num_threads()), shown, report)
    }

    /// As [`Rendering::measure`], by chunks of so many frames, at least 1: figures do not depend on it.
    fn measure_by(
        &self,
        chunk_frames: usize,
        shown: &[ShownBy<'_>],
        report: &dyn Fn(usize),
    ) -> Result<Measured> {
        let Self { scene, content, camera, settings, backend } = self;
        let count = scene.frames();
        let frames: Vec<u32> = (0..count as u32).collect();
        let picked = strip_frames(count);
        let mut complete_psnr_db = Vec::with_capacity(count);
        let mut runs: Vec<Seen> = shown.iter().map(|_| Seen::default()).collect();
        let mut strips: Vec<Strip> = Vec::new();
        let mut references: Vec<Image> = Vec::new();
        for chunk in frames.chunks(chunk_frames) {
            references.drain(..references.len().saturating_sub(1));
            let before = references.len();
            references.extend(evaluator::references(scene, chunk, camera, settings, backend)?);
            let complete: Vec<(u32, Option<&[u8]>)> =
                chunk.iter().map(|&frame| (frame, Some(content.blocks))).collect();
            let images = evaluator::renders(content, &complete, camera, settings, backend)?;
            let pairs = images.par_iter().zip(&references[before..]);
            let psnr_db: Result<Vec<f64>> =
                pairs.map(|(a, b)| Ok(metric::psnr(a, b)?.min(PSNR_CAP_DB))).collect();
            complete_psnr_db.extend(psnr_db?);
            drop(images);
            let in_chunk = |frame: &u32| Some((*frame, chunk.iter().position(|other| other == frame)?));
            let here: Vec<(u32, usize)> = picked.iter().filter_map(in_chunk).collect();
            let first = strips.len();
            for &(frame, at) in &here {
                let image = small(&references[before + at])?;
                let reference = Picture { caption: "source".into(), image, error: None, psnr_db: None };
                strips.push(Strip { frame, reference, shown: Vec::new() });
            }
            for ((policy, states), seen) in shown.iter().zip(&mut runs) {
                let mut of_chunk: Vec<(u32, Option<&[u8]>)> =
                    chunk.iter().map(|&frame| (frame, None)).collect();
                for state in *states {
                    let at = state.frame.checked_sub(chunk[0]).map(|at| at as usize);
                    if let Some(slot) = at.and_then(|at| of_chunk.get_mut(at)) {
                        slot.1 = Some(&state.state);
                    }
                }
                let images = evaluator::renders(content, &of_chunk, camera, settings, backend)?;
                for (&(_, at), strip) in here.iter().zip(&mut strips[first..]) {
                    let image = small(&images[at])?;
                    let error = metric::heat(&image, &strip.reference.image, ERROR_SCALE)?;
                    let psnr_db = metric::psnr(&images[at], &references[before + at])?.min(PSNR_CAP_DB);
                    let caption = (*policy).to_owned();
                    strip.shown.push(Picture { caption, image, error: Some(error), psnr_db: Some(psnr_db) });
                }
                seen.add(images, &references)?;
            }
            report(complete_psnr_db.len());
        }
        Ok(Measured { complete_psnr_db, runs, strips })
    }
}

/// Frames spread over the clip, the first and last left out where there are enough.
fn strip_frames(frames: usize) -> Vec<u32> {
    let count = STRIPS.min(frames);
    (0..count).map(|i| ((2 * i + 1) * frames / (2 * count)) as u32).collect()
}

/// At most 256 pixels wide, for the page.
fn small(image: &Image) -> Result<Image> {
    if image.width() <= 256 {
        return Ok(image.clone());
    }
    let height = (u64::from(image.height()) * 256 / u64::from(image.width())).max(1) as u32;
    Ok(image.resized_box(256, height)?)
}

#[cfg(test)]
mod tests {
    use trainer_host::{
        encode,
        import::synth,
        viewpoint::{Framing, Ring},
    };

    use super::*;

    /// Figures and pictures of the page are those of all frames at once, whatever the chunks.
    #[test]
    fn frames_by_the_few_are_measured_as_all_at_once() {
        let kind = synth::SynthKind::Balls;
        let options = synth::SynthOptions { kind, gaussians: 1000, frames: 7, ..Default::default() };
        let scene = synth::make(&options, &Default::default()).unwrap();
        let options = encode::EncodeOptions { pictures: 0, ..Default::default() };
        let encoded = encode::encode(&scene, &options, &encode::no_progress).unwrap();
        let received = encoded.stream.receive().unwrap();
        let content = received.content();
        let camera = &Framing::of(&scene).ring(Ring::HeldOut, 3, (32, 24)).unwrap()[0];
        let (settings, backend) = (Settings::default(), Backend::Cpu);
        // Some frames are complete, some have bases alone, one was never shown.
        let levels = |frame: u32| if frame.is_multiple_of(2) { 1 } else { 15 };
        let state = |frame: u32| content.blocks.iter().map(|mask| mask & levels(frame)).collect();
        let states = [0, 1, 2, 3, 5, 6].map(|frame| ShownState { frame, state: state(frame) });
        let frames: Vec<u32> = (0..7).collect();
        let references = evaluator::references(&scene, &frames, camera, &settings, &backend).unwrap();
        let mut all: Vec<(u32, Option<&[u8]>)> = frames.iter().map(|&frame| (frame, None)).collect();
        states.iter().for_each(|state| all[state.frame as usize].1 = Some(&state.state));
        let images = evaluator::renders(&content, &all, camera, &settings, &backend).unwrap();
        let flicker = metric::flicker(&images, &references).unwrap();
        let scores: Vec<Score> =
            images.iter().zip(&references).map(|(a, b)| evaluator::score(a, b).unwrap()).collect();
        let distortions = images.iter().zip(&references).map(|(a, b)| metric::distortion(a, b).unwrap());
        let distortions: Vec<f64> = distortions.collect();
        assert!(distortions[0] > 0.0);

        let rendering = Rendering { scene: &scene, content: &content, camera, settings, backend };
        for chunk_frames in [1, 2, 3, 7, 100] {
            let Measured { complete_psnr_db, runs, strips } =
                rendering.measure_by(chunk_frames, &[("layered", &states), ("none", &[])], &|_| ()).unwrap();
            assert_eq!((complete_psnr_db.len(), runs.len()), (7, 2));
            assert_eq!(runs[0].scores, scores, "{chunk_frames} at once");
            assert_eq!(runs[0].flicker().to_bits(), flicker.to_bits(), "{chunk_frames} at once");
            assert_eq!(runs[0].distortions, distortions, "{chunk_frames} at once");
            assert_eq!(runs[0].distortion().to_bits(), mean(&distortions).to_bits());
            assert!(runs[1].scores[0].psnr_db < scores[0].psnr_db);
            assert_eq!(strips.iter().map(|strip| strip.frame).collect::<Vec<_>>(), [0, 2, 4, 6]);
            for strip in &strips {
                let at = strip.frame as usize;
                assert!(strip.reference.image == references[at] && strip.shown[0].image == images[at]);
                assert_eq!(strip.shown[0].psnr_db, Some(scores[at].psnr_db));
                assert_eq!(strip.shown[1].caption, "none");
            }
        }
    }
}
