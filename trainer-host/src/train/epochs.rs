//! Splits a clip into epochs where one set of Gaussians cannot follow it.
//!
//! Where pictures of the same cameras change at once, a trial trains the clip whole, and its two parts with
//! as many Gaussians and steps in all; it is split there if its PSNR is higher then, and so are its parts.
//! A clip without such a change costs one look at its pictures.

use std::ops::Range;

use serde::{Deserialize, Serialize};

use super::{
    error::TrainError, evaluation::evaluate, options::TrainOptions, trainer::Trainer, views::Dataset,
};
use crate::{scene::Scene, train::dataset::rendered};

/// A change this many times the usual one is tried.
const SUDDEN: f64 = 3.0;
/// Frames that a part has at least: with fewer changes none is usual.
const FEWEST: usize = 4;
/// Gaussians of a trial, at most.
const TRIAL_GAUSSIANS: usize = 4000;
/// Longest side of the pictures of a trial, pixels.
const TRIAL_SIDE: u32 = 128;
/// Views that a trial is judged by.
const TRIAL_VIEWS: usize = 24;

/// How clips are parted.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct SplitOptions {
    /// What parts must gain in PSNR over the whole, dB.
    pub gain_db: f64,
    /// Steps of a trial of all frames; of fewer frames as many fewer.
    pub steps: u32,
}

impl Default for SplitOptions {
    fn default() -> Self {
        Self { gain_db: 0.5, steps: 600 }
    }
}

/// A trial of one place.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Trial {
    /// Frames that were tried.
    pub frames: Range<usize>,
    /// The frame that the second part would begin with.
    pub at: usize,
    /// PSNR of the frames trained as one, dB.
    pub whole_db: f64,
    /// PSNR of the two parts, dB.
    pub parts_db: f64,
}

/// A clip in parts.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Parts {
    /// Frames of each, in order: they cover the clip.
    pub frames: Vec<Range<usize>>,
    /// What was tried.
    pub trials: Vec<Trial>,
}

/// Where `dataset`, rendered of `scene`, is parted; `observe` hears of each trial that begins.
///
/// # Errors
/// As those of a training.
pub fn part(
    scene: &Scene,
    dataset: &Dataset,
    train: &TrainOptions,
    options: SplitOptions,
    observe: &mut dyn FnMut(usize),
) -> Result<Parts, TrainError> {
    let train = TrainOptions {
        max_gaussians: train.max_gaussians.min(TRIAL_GAUSSIANS),
        initial_gaussians: train.initial_gaussians.min(TRIAL_GAUSSIANS),
        max_side: train.max_side.min(TRIAL_SIDE),
        // What a trial compares is how well motion follows.
        finish: super::Finish { prune_at: [1.0; 2], round_from: 1.0, ..train.finish },
        ..train.clone()
    };
    let changes = changes(dataset);
    let mut parts = Parts { frames: Vec::new(), trials: Vec::new() };
    let mut open = Vec::from([Range { start: 0, end: dataset.frames }]);
    while let Some(frames) = open.pop() {
        let Some(at) = sudden(&changes, &frames) else {
            parts.frames.push(frames);
            continue;
        };
        observe(parts.trials.len() + 1);
        let trial = tried(scene, dataset, &train, options.steps, frames.clone(), at)?;
        let gain_db = trial.parts_db - trial.whole_db;
        parts.trials.push(trial);
        if gain_db >= options.gain_db {
            // The earlier one is next.
            open.push(at..frames.end);
            open.push(frames.start..at);
        } else {
            parts.frames.push(frames);
        }
    }
    Ok(parts)
}

/// Per frame but the first, how much pictures differ from those before: mean squared error over all cameras,
/// of bytes. Zero where a frame has no pictures.
fn changes(dataset: &Dataset) -> Vec<f64> {
    let views = dataset.train.photographs();
    let frames: Vec<_> = views.chunk_by(|a, b| a.time == b.time).collect();
    let mut changes = vec![0.0; dataset.frames];
    let last = dataset.frames.saturating_sub(1) as f64;
    for pair in frames.windows(2) {
        let bytes = |k: usize| pair[k].iter().flat_map(|view| view.photograph.rgba());
        let count = bytes(0).count().max(1) as f64;
        let squares = bytes(0).zip(bytes(1)).map(|(a, b)| f64::from(a.abs_diff(*b)).powi(2));
        let frame = (f64::from(pair[1][0].time) * last).round() as usize;
        changes[frame.min(dataset.frames - 1)] = squares.sum::<f64>() / count;
    }
    changes
}

/// The frame of the largest change in `frames`, if it is sudden.
fn sudden(changes: &[f64], frames: &Range<usize>) -> Option<usize> {
    if frames.len() < FEWEST {
        return None;
    }
    let inner = &changes[frames.start + 1..frames.end];
    let (at, largest) = inner.iter().enumerate().max_by(|a, b| a.1.total_cmp(b.1))?;
    let mut sorted = inner.to_vec();
    sorted.sort_by(f64::total_cmp);
    let usual = sorted[(sorted.len() - 1) / 2];
    (*largest > SUDDEN * usual).then_some(frames.start + 1 + at)
}

/// Trains `frames` whole, and parted `at` a frame.
fn tried(
    scene: &Scene,
    dataset: &Dataset,
    train: &TrainOptions,
    steps: u32,
    frames: Range<usize>,
    at: usize,
) -> Result<Trial, TrainError> {
    let of = |range: Range<usize>| -> Result<f64, TrainError> {
        let share = range.len() as f64 / frames.len() as f64;
        let steps = f64::from(steps) * range.len() as f64 / dataset.frames as f64;
        let gaussians = |count: usize| ((count as f64 * share) as usize).max(1);
        let train = TrainOptions {
            max_gaussians: gaussians(train.max_gaussians),
            initial_gaussians: gaussians(train.initial_gaussians),
            ..train.clone()
        };
        shown_db(&rendered::part(dataset, scene, range, train.canonical_time), &train, steps)
    };
    let whole_db = of(frames.clone())?;
    let (first, second) = (frames.start..at, at..frames.end);
    let of_parts = first.len() as f64 * of(first.clone())? + second.len() as f64 * of(second)?;
    Ok(Trial { at, whole_db, parts_db: of_parts / frames.len() as f64, frames })
}

/// PSNR on training views after so many steps, dB.
fn shown_db(dataset: &Dataset, train: &TrainOptions, steps: f64) -> Result<f64, TrainError> {
    let mut trainer = Trainer::new(dataset, train)?;
    let steps = steps.round().max(1.0);
    while f64::from(trainer.steps()) < steps {
        trainer.step(f64::from(trainer.steps()) / steps)?;
    }
    let views = dataset.train.sample(TRIAL_VIEWS);
    Ok(evaluate(&*trainer.model(), &views, trainer.reduced(), train.background)?.psnr_db)
}

#[cfg(test)]
mod tests;
