//! Says what the viewer of one run saw: pictures against the source's, and when playout stood still.

use anyhow::{Context, Result};
use emulator_host::{Nanos, Report};
use render_host::{
    Image,
    metric::{self, Lpips},
};
use trainer_host::evaluator;

use crate::setup::Setup;

/// A frame of whose base less than this share is there shows no motion of its own.
const MIN_BASE: f64 = 0.5;
/// Frames without motion in a row are a freeze once they last longer than this and a frame (the threshold of
/// webrtc-stats).
const NOTICED: Nanos = Nanos::from_ms(150);

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
        let base: Vec<f64> = report.frames.iter().map(|row| 1.0 - row.base_miss).collect();
        let (freezes, frozen) = freezes(&base, interval);
        Ok(Self {
            utility: report.utility,
            base_miss: report.base_miss_rate,
            distortion,
            psnr_db: dgs::figures::mean(&psnr),
            worst_tenth_db: evaluator::worst_tenth(&psnr),
            ssim,
            flicker,
            lpips,
            freezes,
            frozen,
        })
    }
}

/// Freezes per minute, and the share of the frames in them, where `base` is the share of each frame's base
/// that was there.
fn freezes(base: &[f64], interval: Nanos) -> (f64, f64) {
    let least = (NOTICED.0 / interval.0.max(1) + 1) as usize;
    let still = base.chunk_by(|a, b| (*a < MIN_BASE) == (*b < MIN_BASE));
    let still = still.filter(|run| run[0] < MIN_BASE && run.len() > least).map(<[f64]>::len);
    let (count, frames) = still.fold((0, 0), |(count, frames), run| (count + 1, frames + run));
    let minutes = interval.times(base.len() as u64).as_s() / 60.0;
    (f64::from(count) / minutes.max(1e-9), frames as f64 / base.len().max(1) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_freeze_is_long_enough_to_be_noticed() {
        let interval = Nanos(33_333_333);
        let clip = |still: &[std::ops::Range<usize>]| {
            let base: Vec<f64> = (0..900)
                .map(|at| if still.iter().any(|run| run.contains(&at)) { 0.4 } else { 0.9 })
                .collect();
            freezes(&base, interval)
        };
        // A hole of five frames is none; ten and twenty are two in half a minute.
        assert_eq!(clip(std::slice::from_ref(&(5..10))), (0.0, 0.0));
        let (count, share) = clip(&[5..10, 100..110, 400..420]);
        assert!((count - 4.0).abs() < 1e-6 && (share - 30.0 / 900.0).abs() < 1e-9, "{count} {share}");
        let (count, share) = clip(std::slice::from_ref(&(0..900)));
        assert!((count - 2.0).abs() < 1e-6 && share == 1.0);
    }

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
