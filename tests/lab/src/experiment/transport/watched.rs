//! Says what the viewer of one run saw: pictures against the source's, and when playout stood still.

use anyhow::{Context, Result};
use emulator_host::{Nanos, Report, session::Freezes};
use render_host::{
    Image,
    metric::{self, Lpips},
};
use trainer_host::evaluator;

use crate::setup::Setup;

/// Frames to render: some, spread over the clip, of which every fourth is followed by its successor, so that
/// flicker can be seen.
pub(super) struct Frames {
    /// Ascending, each once.
    pub(super) all: Vec<u32>,
    /// Which of them are rated.
    rated: Vec<usize>,
    /// Where a frame and its successor are.
    pairs: Vec<(usize, usize)>,
}

impl Frames {
    /// `spread` out over a clip of `frames`, ascending.
    pub(super) fn new(spread: &[u32], frames: u32) -> Self {
        let first = |frame: &u32| frame + 1 < frames;
        let paired: Vec<u32> = spread.iter().step_by(4).copied().filter(first).collect();
        let mut all = [spread, &paired.iter().map(|frame| frame + 1).collect::<Vec<_>>()].concat();
        all.sort_unstable();
        all.dedup();
        let place = |frame: u32| all.binary_search(&frame).ok();
        let rated = spread.iter().filter_map(|frame| place(*frame)).collect();
        let pairs = paired.iter().filter_map(|frame| place(*frame).zip(place(frame + 1))).collect();
        Self { all, rated, pairs }
    }
}

/// What one run showed.
#[derive(Clone, Copy, Debug)]
pub(super) struct Seen {
    pub(super) utility: f64,
    pub(super) base_miss: f64,
    pub(super) distortion: f64,
    pub(super) psnr_db: f64,
    pub(super) worst_tenth_db: f64,
    pub(super) ssim: f64,
    pub(super) flicker: f64,
    /// NaN without weights.
    pub(super) lpips: f64,
    /// Freezes per minute, and the share of the time that they last.
    pub(super) freezes: f64,
    pub(super) frozen: f64,
}

/// The network of LPIPS, where its weights are given.
///
/// # Errors
/// A file that is none.
pub(super) fn network(setup: &Setup) -> Result<Option<Lpips>> {
    let read = |path: &std::path::PathBuf| {
        let failed = || format!("--lpips {}", path.display());
        Lpips::from_safetensors(&std::fs::read(path).with_context(failed)?).with_context(failed)
    };
    setup.lpips.as_ref().map(read).transpose()
}

impl Seen {
    /// Rates `images` of `frames` against `references`.
    ///
    /// # Errors
    /// Images of different sizes.
    pub(super) fn new(
        report: &Report,
        frames: &Frames,
        (images, references): (&[Image], &[Image]),
        (interval, network): (Nanos, Option<&Lpips>),
    ) -> Result<Self> {
        let count = frames.rated.len().max(1) as f64;
        let (mut distortion, mut ssim, mut lpips, mut psnr) = (0.0, 0.0, 0.0, Vec::new());
        for at in &frames.rated {
            let (image, reference) = (&images[*at], &references[*at]);
            let score = evaluator::score(image, reference)?;
            let structure = metric::distortion::STRUCTURE_WEIGHT * (1.0 - score.ssim);
            distortion += (metric::mse(image, reference)? + structure) / count;
            ssim += score.ssim / count;
            psnr.push(score.psnr_db);
            let distance = network.map(|network| network.distance(image, reference)).transpose()?;
            lpips += distance.unwrap_or(f64::NAN) / count;
        }
        let mut flicker = 0.0;
        for (frame, next) in &frames.pairs {
            let both = |of: &[Image]| [of[*frame].clone(), of[*next].clone()];
            flicker += metric::flicker(&both(images), &both(references))? / frames.pairs.len() as f64;
        }
        let mut freezes = Freezes::new(interval);
        report.frames.iter().for_each(|row| freezes.show(1.0 - row.base_miss));
        let minutes = interval.times(report.frames.len() as u64).as_s() / 60.0;
        Ok(Self {
            utility: report.utility,
            base_miss: report.base_miss_rate,
            distortion,
            psnr_db: dgs::figures::mean(&psnr),
            worst_tenth_db: evaluator::worst_tenth(&psnr),
            ssim,
            flicker,
            lpips,
            freezes: freezes.count() as f64 / minutes.max(1e-9),
            frozen: freezes.frames() as f64 / report.frames.len().max(1) as f64,
        })
    }
}

#[cfg(test)]
impl Seen {
    /// A run with this utility, D the rest to 1, and without LPIPS.
    pub(super) fn of_utility(utility: f64) -> Self {
        Self {
            utility,
            base_miss: 0.0,
            distortion: 1.0 - utility,
            psnr_db: 30.0,
            worst_tenth_db: 20.0,
            ssim: utility,
            flicker: 1e-3,
            lpips: f64::NAN,
            freezes: 1.0,
            frozen: 0.1,
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_fourth_frame_is_followed_by_its_successor() {
        let frames = Frames::new(&[0, 7, 14, 21, 29], 30);
        assert_eq!(
            (frames.all.as_slice(), frames.rated.as_slice()),
            (&[0, 1, 7, 14, 21, 29][..], &[0, 2, 3, 4, 5][..])
        );
        assert_eq!(frames.pairs, [(0, 1)]);
    }
}
