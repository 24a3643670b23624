//! Encodes a trained scene as coarsely as its photographs allow, unless a person asks to stop.

use anyhow::{Context, Result, bail};
use codec_core::ShDegree;
use trainer_host::{
    Scene,
    encode::{self, Decisions, EncodeError, EncodeOptions, Encoded, Protection, QuantiserSteps, Target},
    scene::{Attributes, Epoch, Track},
    train::{self, Dataset, DynamicScene},
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
const ATTEMPTS: usize = 6;
/// Steps that differ by less than this factor are not distinguished by the loss.
const NARROW: f64 = 1.1;
/// Range of the factor on quantiser steps.
const COARSENESS: (f64, f64) = (0.05, 4.0);
/// A loss above this share of what is allowed is near enough to it.
const NEAR: f64 = 0.6;
/// The share of what is allowed that the next attempt is meant to take.
const AIM: f64 = 0.85;

/// A stream of what was trained.
pub(super) struct Written {
    pub(super) encoded: Encoded,
    /// What encoding took from the PSNR of the views that it was chosen by, dB, where it was chosen so.
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
    /// What encoding took from the PSNR of the views, dB.
    lost_db: f64,
}

impl Attempt {
    /// Whether this is what was asked for rather than `other`: a loss that is allowed before one that is not,
    /// then the coarser of allowed ones, the finer of others.
    fn beats(&self, other: &Self, allowed_db: f64) -> bool {
        match (self.lost_db <= allowed_db, other.lost_db <= allowed_db) {
            (true, true) => self.coarseness > other.coarseness,
            (false, false) => self.coarseness < other.coarseness,
            (is_allowed, _) => is_allowed,
        }
    }

    /// Steps for the next attempt: loss in dB grows with their square while it is small.
    fn next_coarseness(&self, allowed_db: f64) -> f64 {
        let ratio = (AIM * allowed_db / self.lost_db.max(1e-3 * allowed_db)).sqrt();
        (self.coarseness * ratio.clamp(0.3, 2.0)).clamp(COARSENESS.0, COARSENESS.1)
    }
}

/// Bracket of the coarsest steps whose loss is allowed, as factors on quantiser steps.
#[derive(Clone, Copy, Debug, Default)]
struct Bracket {
    /// The coarsest that are allowed.
    allowed: Option<f64>,
    /// The finest that are not.
    refused: Option<f64>,
}

impl Bracket {
    /// Learns whether steps of `coarseness` are allowed, and gives those to try next: the `guess`, or the
    /// geometric middle where the guess is outside of the bracket or at its ends; none once it is narrow.
    fn next(&mut self, coarseness: f64, is_allowed: bool, guess: f64) -> Option<f64> {
        if is_allowed {
            self.allowed = Some(self.allowed.map_or(coarseness, |most| most.max(coarseness)));
        } else {
            self.refused = Some(self.refused.map_or(coarseness, |least| least.min(coarseness)));
        }
        match (self.allowed, self.refused) {
            (Some(low), Some(high)) if high <= NARROW * low => None,
            // The loss is no smooth function of steps: where a guess fails, bisection goes on.
            (Some(low), Some(high)) if !(1.02 * low..0.98 * high).contains(&guess) => {
                Some((low * high).sqrt())
            }
            // At the ends of what is allowed a guess stays where it was.
            _ => (guess != coarseness).then_some(guess),
        }
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
    let (reduced, background) = (trained.reduced, trained.options.background);
    let psnr_db = |shown: &dyn DynamicScene| -> Result<f64> {
        let mut psnr_db = f64::NAN;
        if !dataset.validation.is_empty() {
            psnr_db = train::evaluate(shown, &dataset.validation.sample(VIEWS), reduced, background)?.psnr_db;
        }
        // Views of which masks leave nothing have none; some view to train on has one.
        if psnr_db.is_nan() {
            let sample = dataset.train.sample(VIEWS);
            psnr_db = train::evaluate(shown, &*trained.neutral_views(&sample)?, reduced, background)?.psnr_db;
        }
        if psnr_db.is_nan() {
            let views = trained.neutral_views(&dataset.train)?;
            psnr_db = train::evaluate(shown, &*views, reduced, background)?.psnr_db;
        }
        Ok(psnr_db)
    };
    // Where frames are fewer than photographs have times, encoding does not answer for that.
    let trained_db = psnr_db(&trained.shown_in_frames())?;
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
        let shown_db = psnr_db(&decoded(&encoded)?)?;
        Ok(Attempt { encoded, coarseness, lost_db: trained_db - shown_db })
    };
    let allowed = args.encoding_loss;
    let mut best = attempt(1, 1.0)?;
    let mut bracket = Bracket::default();
    let mut next_after = |found: &Attempt| {
        bracket.next(found.coarseness, found.lost_db <= allowed, found.next_coarseness(allowed))
    };
    // Of a scene that was rounded while it stands still no steps are left to choose.
    let has_choice =
        decisions.is_none() || scene.epochs().iter().any(|epoch| !epoch.attributes().is_constant());
    let mut next = next_after(&best).filter(|_| has_choice);
    for number in 2..=ATTEMPTS {
        let Some(coarseness) = next else { break };
        if (NEAR * allowed..=allowed).contains(&best.lost_db) {
            break;
        }
        let found = attempt(number, coarseness)?;
        next = next_after(&found);
        if found.beats(&best, allowed) {
            best = found;
        }
    }
    let Attempt { encoded, lost_db, .. } = best;
    let over = (lost_db > allowed).then(|| {
        format!(
            "encoding takes {lost_db:.3} dB from the PSNR of the views it is judged by; --encoding-loss is \
             {allowed}"
        )
    });
    Ok(Written { encoded, lost_db: Some(lost_db), notes: over.into_iter().collect() })
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
    fn steps_are_sought_between_those_that_are_allowed_and_those_that_are_not() {
        let mut bracket = Bracket::default();
        assert_eq!(bracket.next(1.0, true, 1.7), Some(1.7), "nothing is refused yet");
        assert_eq!(bracket.next(1.7, false, 1.5), Some(1.5), "a guess in between");
        // One that leads back to what was tried already is none.
        assert_eq!(bracket.next(1.5, false, 0.4), Some(1.5f64.sqrt()));
        assert_eq!(bracket.next(1.2, true, 2.4), Some((1.2f64 * 1.5).sqrt()));
        assert_eq!(bracket.next(1.35, true, 1.4), Some(1.4));
        assert_eq!(bracket.next(1.4, false, 1.38), None, "as near as that");
        assert_eq!(Bracket::default().next(4.0, true, 4.0), None, "none are coarser");
    }

    #[test]
    fn an_encoding_says_which_of_how_many_it_is_and_how_coarse() {
        assert_eq!(attempt_in_words(1, 1.0, false), "encoding 1 of at most 6, steps x 1.00");
        assert_eq!(attempt_in_words(3, 0.346, true), "encoding 3 of at most 6, steps of motion x 0.35");
    }
}
