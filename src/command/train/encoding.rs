//! Encodes a trained scene as coarsely as its photographs allow, unless a person asks to stop.

use anyhow::{Context, Result, bail};
use codec_core::ShDegree;
use rayon::prelude::*;
use render_host::metric;
use trainer_host::{
    Scene,
    encode::{self, Decisions, EncodeError, EncodeOptions, Encoded, Protection, QuantiserSteps, Target},
    scene::{Attributes, Epoch, Track},
    train::{self, Dataset, DynamicScene, PixelMask, PosedPhotograph, Training, Validation, Views},
};

use super::{figures::decoded, interruption::Interruption, trained::Trained};
use crate::{
    args::{ProfileName, train::Train},
    pipeline::{self, Quiet},
    progress::Progress,
};

/// Views that the loss is measured on.
const VIEWS: usize = 20;
/// Encodings at most.
const ATTEMPTS: usize = 4;
/// Squared error below which a picture is its photograph: PSNR of 100 dB.
const LEAST_ERROR: f64 = 1e-10;
/// Range of the factor on quantiser steps.
const COARSENESS: (f64, f64) = (0.05, 4.0);
/// A loss above this share of what is allowed is near enough to it.
const NEAR: f64 = 0.6;
/// The share of what is allowed that the next attempt is meant to take.
const AIM: f64 = 0.85;

/// A stream of what was trained.
pub(super) struct Written {
    pub(super) encoded: Encoded,
    /// What encoding took from the PSNR of the views that it was chosen by, dB, as measured, where it was
    /// chosen so.
    pub(super) lost_db: Option<f64>,
    /// What a person should know.
    pub(super) notes: Vec<String>,
}

impl Written {
    pub(super) fn plainly(encoded: Encoded) -> Self {
        Self { encoded, lost_db: None, notes: Vec::new() }
    }
}

/// A stream, and how it was made.
struct Attempt {
    encoded: Encoded,
    /// Factor on quantiser steps.
    coarseness: f64,
    loss: Loss,
}

/// What encoding takes from the PSNR of views, dB.
#[derive(Clone, Copy, Debug)]
struct Loss {
    measured: f64,
    /// What is expected where its errors have nothing to do with those that pictures had before. In few views
    /// they add up or cancel by chance, which steps cannot be chosen by.
    expected: f64,
}

impl Loss {
    /// What is allowed is more than either.
    fn larger(self) -> f64 {
        self.measured.max(self.expected)
    }
}

impl Attempt {
    /// Whether this is what was asked for rather than `other`: a loss that is allowed before one that is not,
    /// then the coarser of allowed ones, the finer of others.
    fn beats(&self, other: &Self, allowed_db: f64) -> bool {
        match (self.loss.larger() <= allowed_db, other.loss.larger() <= allowed_db) {
            (true, true) => self.coarseness > other.coarseness,
            (false, false) => self.coarseness < other.coarseness,
            (is_allowed, _) => is_allowed,
        }
    }

    /// Steps for the next attempt: loss in dB grows with their square while it is small.
    fn next_coarseness(&self, allowed_db: f64) -> f64 {
        let ratio = (AIM * allowed_db / self.loss.larger().max(1e-3 * allowed_db)).sqrt();
        (self.coarseness * ratio.clamp(0.3, 2.0)).clamp(COARSENESS.0, COARSENESS.1)
    }
}

/// Refuses before a training a size that no stream of it can have, that of `args` or else the `trained_for`
/// (0: none) of options; streams are of so many `frames`, so many a second.
pub(super) fn check_size(args: &Train, trained_for: u64, (frames, rate): (usize, f64)) -> Result<()> {
    let bytes = match (args.codec.target_bytes, steps_are_typed(args)) {
        (Some(bytes), _) => bytes,
        (None, false) if trained_for > 0 => trained_for,
        _ => return Ok(()),
    };
    let least = least_bytes(args, frames, rate)?;
    if bytes < least {
        bail!(
            "--target-bytes is {bytes}; {least} and more are allowed: so much does a stream of {frames} \
             frames take that holds one Gaussian and no motion"
        );
    }
    Ok(())
}

/// Bytes on the wire of the least that a training can lead to: one Gaussian that stands still.
fn least_bytes(args: &Train, frames: usize, frames_per_second: f64) -> Result<u64> {
    let scene = Scene::new(vec![Epoch::new(frames, one_gaussian())?], frames_per_second)?;
    let options = pipeline::encode_options(&args.codec, Protection::NONE);
    let quality = QuantiserSteps::default().scaled(encode::COARSENESS.1);
    let options = EncodeOptions { quality, target: None, pictures: 0, search: 0, ..options };
    let encoded = encode::encode(&scene, &options, &encode::no_progress).context("cannot encode")?;
    Ok(encoded.stream.wire_bytes() as u64)
}

/// One Gaussian that stands still.
pub(super) fn one_gaussian() -> Attributes {
    Attributes {
        positions: Track::Constant(vec![[0.0; 3]]),
        rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]]),
        log_scales: Track::Constant(vec![[0.0; 3]]),
        opacity_logits: Track::Constant(vec![0.0]),
        sh0: Track::Constant(vec![[0.0; 3]]),
        sh_rest: Vec::new(),
        sh_degree: ShDegree::ZERO,
    }
}

/// Whether `args` say how fine steps are, so that a training must not choose them.
pub(super) fn steps_are_typed(args: &Train) -> bool {
    let codec = &args.codec;
    let by_goal = codec.target_bits_per_gaussian.is_some() || codec.target_psnr.is_some();
    by_goal || codec.coarseness != 1.0 || codec.profile != ProfileName::Dgs1
}

/// The stream of what was trained. Unless its size or steps were typed, steps are the coarsest of a few that
/// take at most `--encoding-loss` from the PSNR of validation views (of training views where there are none),
/// or else the finest of them. Where the training has made the encoder's choices its own, steps of motion
/// are.
pub(super) fn within_loss(
    args: &Train,
    dataset: &Dataset,
    trained: &Trained,
    stop: &Interruption,
    what_is_left: &str,
    quiet: Quiet,
) -> Result<Written> {
    let mut options = pipeline::encode_options(&args.codec, Protection::NONE);
    let decisions = trained.decisions.as_ref().filter(|_| !steps_are_typed(args));
    let bytes = trained.options.finish.target_bytes;
    if bytes > 0 && !steps_are_typed(args) {
        options.target = options.target.or(Some(Target::Bytes(bytes)));
    }
    let bar = &Progress::new("encode", quiet.0);
    // There may be several encodings: a stage is said with the one that it is of.
    let named = |name: String| {
        move |stage: &'static str, share: f64| {
            stop.leave(what_is_left);
            bar.heard(&format!("{name}: {stage}"), share)
        }
    };
    let scene = &trained.scene;
    if let Some(decisions) = decisions.filter(|_| options.target.is_some()) {
        let of_motion = named("encode, steps of motion".to_owned());
        let of_all = named("encode, all steps".to_owned());
        return to_size(scene, decisions, &options, &of_motion, &of_all);
    }
    if options.target.is_some() || steps_are_typed(args) {
        let progress = named("encode".to_owned());
        return Ok(Written::plainly(encode::encode(scene, &options, &progress).context("cannot encode")?));
    }
    // Where frames are fewer than photographs have times, encoding does not answer for that.
    let shown = trained.shown_in_frames();
    let trial = Trial::of(dataset, trained, &shown)?;
    let attempt = |number: usize, coarseness: f64| -> Result<Attempt> {
        let progress = named(attempt_in_words(number, coarseness, decisions.is_some()));
        let encoded = match decisions {
            Some(decisions) => encode::reencode(scene, decisions, coarseness as f32, &options, &progress),
            None => {
                let quality = QuantiserSteps::default().scaled(coarseness as f32);
                encode::encode(scene, &EncodeOptions { quality, ..options.clone() }, &progress)
            }
        };
        let encoded = encoded.context("cannot encode")?;
        let loss = trial.loss(&decoded(&encoded)?)?;
        Ok(Attempt { encoded, coarseness, loss })
    };
    let allowed = args.encoding_loss;
    let mut best = attempt(1, 1.0)?;
    let mut next = best.next_coarseness(allowed);
    for number in 2..=ATTEMPTS {
        if (NEAR * allowed..=allowed).contains(&best.loss.larger()) {
            break;
        }
        let found = attempt(number, next)?;
        next = found.next_coarseness(allowed);
        if found.beats(&best, allowed) {
            best = found;
        }
    }
    let Attempt { encoded, loss: Loss { measured: lost_db, .. }, .. } = best;
    let over = (lost_db > allowed).then(|| {
        format!(
            "encoding takes {lost_db:.3} dB from the PSNR of the views it is judged by; --encoding-loss is \
             {allowed}"
        )
    });
    Ok(Written { encoded, lost_db: Some(lost_db), notes: over.into_iter().collect() })
}

/// Views that steps are chosen by, and what was trained.
struct Trial<'t> {
    views: Views<Validation>,
    shown: &'t dyn DynamicScene,
    reduced: u32,
    background: [f32; 3],
}

impl<'t> Trial<'t> {
    /// Validation views, or training views where there are none, of `shown`, which `trained` is before it is
    /// encoded.
    fn of(dataset: &Dataset, trained: &Trained, shown: &'t dyn DynamicScene) -> Result<Self> {
        let neutral = |views: &Views<Training>| -> Vec<PosedPhotograph> {
            views.photographs().iter().map(|view| trained.neutral(view).into_owned()).collect()
        };
        let (reduced, background) = (trained.reduced, trained.options.background);
        // Views of which masks leave nothing do not count; some view to train on does.
        let of = |mut views: Vec<PosedPhotograph>| -> Result<Self> {
            let counts = |mask: &PixelMask| mask.reduced(reduced).values().contains(&255);
            views.retain(|view| view.counted.as_ref().is_none_or(counts));
            Ok(Self { views: Views::new(views)?, shown, reduced, background })
        };
        let validation = of(dataset.validation.sample(VIEWS).photographs().to_vec())?;
        if !validation.views.is_empty() {
            return Ok(validation);
        }
        let sample = of(neutral(&dataset.train.sample(VIEWS)))?;
        if sample.views.is_empty() { of(neutral(&dataset.train)) } else { Ok(sample) }
    }

    /// What is lost where `decoded` is shown.
    fn loss(&self, decoded: &dyn DynamicScene) -> Result<Loss> {
        let of_view = |index: usize| -> Result<[f64; 2]> {
            let seen = |scene| train::compare(scene, &self.views, index, self.reduced, self.background);
            let [before, after] = [seen(self.shown)?, seen(decoded)?];
            let photograph = &before.photograph;
            let [before, after] = [before.where_counted()?, after.where_counted()?];
            let error = metric::mse(&before, photograph)?.max(LEAST_ERROR);
            let decibels = |error_now: f64| 10.0 * (error_now.max(LEAST_ERROR) / error).log10();
            let coding = metric::mse(&after, &before)?;
            Ok([decibels(metric::mse(&after, photograph)?), decibels(error + coding)])
        };
        let count = self.views.photographs().len();
        let of_views: Result<Vec<[f64; 2]>> = (0..count).into_par_iter().map(of_view).collect();
        let of_views = of_views?;
        let mean = |k: usize| of_views.iter().map(|loss| loss[k]).sum::<f64>() / count.max(1) as f64;
        Ok(Loss { measured: mean(0), expected: mean(1) })
    }
}

/// Which of the attempts is made, the first is 1, and with steps how long: those of motion alone, or all.
fn attempt_in_words(number: usize, coarseness: f64, of_motion: bool) -> String {
    let steps = if of_motion { "steps of motion" } else { "steps" };
    format!("encoding {number} of at most {ATTEMPTS}, {steps} x {coarseness:.2}")
}

/// The stream of the size that `options` name: with the steps that the training has rounded by, or where
/// steps of motion alone do not lead there, with steps of the encoder's own choice. Each way has a progress
/// of its own.
fn to_size(
    scene: &Scene,
    decisions: &Decisions,
    options: &EncodeOptions,
    of_motion: encode::Progress<'_>,
    of_all: encode::Progress<'_>,
) -> Result<Written> {
    let error = match encode::reencode_to_size(scene, decisions, options, of_motion) {
        Ok(encoded) => return Ok(Written::plainly(encoded)),
        Err(error) => error,
    };
    if !matches!(error, EncodeError::UnreachableByMotion { .. } | EncodeError::BlockTooLarge { .. }) {
        return Err(error).context("cannot encode");
    }
    let encoded = encode::encode(scene, options, of_all).context("cannot encode")?;
    let notes = vec![format!("{error}; all steps are chosen anew for the size")];
    Ok(Written { notes, ..Written::plainly(encoded) })
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn an_encoding_says_which_of_how_many_it_is_and_how_coarse() {
        assert_eq!(attempt_in_words(1, 1.0, false), "encoding 1 of at most 4, steps x 1.00");
        assert_eq!(attempt_in_words(3, 0.346, true), "encoding 3 of at most 4, steps of motion x 0.35");
    }
}
