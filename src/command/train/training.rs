//! Takes the steps of a training: from its start or its checkpoint until the budget is spent or a person asks
//! to stop.

use std::{io::IsTerminal, time::Instant as Clock};

use anyhow::{Context, Result, bail};
use render_host::Backend;
use trainer_host::{
    encode::{EncodeOptions, Protection},
    train::{self, Checkpoint, Dataset, DensityControl, Encoding, Trainer},
};

use super::{
    encoding::steps_are_typed,
    folder::Folder,
    interruption::Interruption,
    log::{Log, Sample},
    page::Ended,
};
use crate::{
    args::train::{DensityName, Train},
    files,
    pipeline::{self, Quiet},
    progress::Progress,
};

/// Steps between two lines of the log.
const LOG_EVERY: u32 = 100;
/// Steps of a training where nothing is said.
pub(super) const DEFAULT_STEPS: u32 = 15_000;
/// Views that quality during training is measured on, at most.
pub(super) const GLANCE_VIEWS: usize = 8;

/// The checkpoint to go on from, if one is; it has the options that are typed.
pub(super) fn resumed(args: &Train, folder: &Folder) -> Result<Option<Checkpoint>> {
    // A clip in several epochs has one in the folder of each.
    if !args.resume || folder.epochs.is_file() {
        return Ok(None);
    }
    let path = &folder.checkpoint;
    // A scene that is fine-tuned is not trained.
    if !path.is_file() && folder.has_fine_tuning() && args.delivery.is_some() {
        return Ok(None);
    }
    if !path.is_file() {
        bail!("{}: no such checkpoint; train without --resume first", path.display());
    }
    let failed = || path.display().to_string();
    let checkpoint =
        Checkpoint::from_bytes(&std::fs::read(path).with_context(failed)?).with_context(failed)?;
    check_options(args, checkpoint.options())?;
    Ok(Some(checkpoint))
}

/// How a training stood before it went on.
#[derive(Clone, Copy)]
pub(super) struct Begun {
    /// How far it had come, 0 to 1.
    pub(super) progress: f64,
    /// Steps that all of it is to take, where steps end it and a checkpoint says how many.
    length: Option<u32>,
}

impl Begun {
    /// A training of which nothing is left.
    pub(super) const COMPLETE: Self = Self { progress: 1.0, length: None };
}

/// A trainer on `backend`, at its checkpoint or with `options` at its start, and how far it had come; of a
/// clip of so many frames per second.
pub(super) fn begin<'d>(
    (args, rate): (&Train, f64),
    folder: &Folder,
    resumed: Option<Checkpoint>,
    options: &train::TrainOptions,
    dataset: &'d Dataset,
    backend: &Backend,
) -> Result<(Trainer<'d>, Begun)> {
    let most = resumed.as_ref().map_or(options, |checkpoint| checkpoint.options()).max_gaussians;
    // A checkpoint is of the dataset's frames, a stream of those that are typed.
    let frames = args.frames.map_or(dataset.frames, |frames| frames.max(dataset.frames));
    if most.saturating_mul(frames) > Checkpoint::MAX_POSED {
        bail!(
            "--gaussians is {most} over {frames} frames; up to {} in all frames together are allowed",
            Checkpoint::MAX_POSED
        );
    }
    if let Some(checkpoint) = resumed {
        let failed = || folder.checkpoint.display().to_string();
        let begun = Begun { progress: checkpoint.progress(), length: checkpoint.length() };
        let trainer = checkpoint.resume(dataset).with_context(failed)?.on(backend)?;
        return Ok((trainer.encoded_by(encoding_of(args, dataset, rate)), begun));
    }
    let trainer = Trainer::new(dataset, options)?.on(backend)?;
    let begun = Begun { progress: 0.0, length: None };
    Ok((trainer.encoded_by(encoding_of(args, dataset, rate)), begun))
}

/// Refuses options that are others than those that the checkpoint goes on with.
pub(super) fn check_options(args: &Train, resumed: &train::TrainOptions) -> Result<()> {
    let typed = options(args)?;
    let number = |typed: Option<f64>, resumed: f32| typed.is_some_and(|typed| typed as f32 != resumed);
    // What the trainer fills in, and what follows from how the result is encoded.
    let filled = train::TrainOptions {
        initial_gaussians: resumed.initial_gaussians,
        nodes: if resumed.nodes == 0 { 0 } else { typed.nodes },
        footprint: typed.footprint.or(resumed.footprint),
        finish: train::Finish {
            target_bytes: resumed.finish.target_bytes,
            round_from: resumed.finish.round_from,
            ..typed.finish
        },
        ..typed.clone()
    };
    let others = [
        ("--gaussians", args.gaussians.is_some_and(|typed| typed != resumed.max_gaussians)),
        ("--nodes", args.nodes.is_some() && filled.nodes != resumed.nodes),
        ("--sh-degree", args.sh_degree.is_some_and(|typed| typed != resumed.sh_degree)),
        ("--max-side", args.max_side.is_some_and(|typed| typed != resumed.max_side)),
        ("--background", args.background.is_some_and(|typed| typed != resumed.background)),
        ("--canonical-time", number(args.canonical_time, resumed.canonical_time)),
        ("--rigidity", number(args.rigidity, resumed.rigidity)),
        ("--density", args.density.is_some() && typed.density != resumed.density),
        ("--seed", args.scene.seed.is_some_and(|typed| typed != resumed.seed)),
        ("--footprint", args.scene.footprint.is_some() && filled.footprint != resumed.footprint),
    ];
    let mut others: Vec<&str> =
        others.into_iter().filter(|(_, other)| *other).map(|(name, _)| name).collect();
    if others.is_empty() && args.options.is_some() && filled != *resumed {
        others.push("--options");
    }
    if !others.is_empty() {
        bail!(
            "{}: not as in the checkpoint that --resume goes on from; leave out, or type as before",
            others.join(", ")
        );
    }
    Ok(())
}

/// Refuses a length that a training that had `begun`, with `taken` steps, cannot take.
pub(super) fn check_length(args: &Train, taken: u32, begun: Begun) -> Result<()> {
    let Begun { progress, length } = begun;
    if args.resume && progress <= 0.0 && length.or(args.steps).is_none() && args.minutes.is_none() {
        bail!(
            "--resume: the checkpoint is of the start of a training that some time was to end, and does not \
             say which: type --steps or --minutes"
        );
    }
    if progress >= 1.0 && (args.minutes.is_some() || args.steps.is_some_and(|steps| steps > taken)) {
        bail!(
            "--resume: the training is complete, after {taken} steps; rates and stages follow the length \
             that it was begun with, so --steps and --minutes cannot prolong it"
        );
    }
    if progress < 1.0 && args.steps.is_some_and(|steps| steps <= taken) {
        bail!("--steps is {}; the checkpoint has taken {taken}: more are needed", args.steps.unwrap_or(0));
    }
    Ok(())
}

/// The options of the file, if there is one, and what was typed besides.
pub(super) fn options(args: &Train) -> Result<train::TrainOptions> {
    Ok(with_typed(options_of_file(args)?, args))
}

/// The options of the file; the defaults where there is none.
pub(super) fn options_of_file(args: &Train) -> Result<train::TrainOptions> {
    let Some(path) = &args.options else { return Ok(train::TrainOptions::default()) };
    let text = std::fs::read_to_string(path).with_context(|| path.display().to_string())?;
    if !text.trim_start().starts_with('{') {
        bail!("{}: an object, {{\"max_gaussians\": …}}, is needed", path.display());
    }
    serde_json::from_str(&text).with_context(|| path.display().to_string())
}

/// `options`, and what was typed besides.
pub(super) fn with_typed(mut options: train::TrainOptions, args: &Train) -> train::TrainOptions {
    options.seed = args.scene.seed.unwrap_or(options.seed);
    options.footprint = args.scene.footprint.map(Into::into).or(options.footprint);
    let set = |to: &mut f32, typed: Option<f64>| *to = typed.map_or(*to, |v| v as f32);
    set(&mut options.canonical_time, args.canonical_time);
    set(&mut options.rigidity, args.rigidity);
    options.max_gaussians = args.gaussians.unwrap_or(options.max_gaussians);
    options.initial_gaussians = options.initial_gaussians.min(options.max_gaussians);
    options.nodes = args.nodes.unwrap_or(options.nodes);
    options.sh_degree = args.sh_degree.unwrap_or(options.sh_degree);
    options.max_side = args.max_side.unwrap_or(options.max_side);
    options.background = args.background.unwrap_or(options.background);
    options.finish.target_bytes = args.codec.target_bytes.unwrap_or(options.finish.target_bytes);
    if steps_are_typed(args) || args.delivery.is_some() {
        options.finish.round_from = 1.0;
    }
    if let Some(density) = args.density {
        options.density = match density {
            DensityName::Split => DensityControl::Split,
            DensityName::SplitBySum => DensityControl::SplitBySum,
            DensityName::Relocate => DensityControl::Relocate,
        };
    }
    options
}

/// Takes steps until the budget is spent or a person asks to stop.
#[allow(clippy::too_many_arguments, reason = "each is another thing that a step touches")]
pub(super) fn fit(
    args: &Train,
    folder: &Folder,
    dataset: &Dataset,
    trainer: &mut Trainer,
    begun: Begun,
    log: &mut Log,
    stop: &Interruption,
    quiet: Quiet,
) -> Result<Ended> {
    let bar = Progress::new("train", quiet.0);
    let clock = Clock::now();
    let before = log.seconds();
    let steps = steps(args, trainer, begun);
    let length = args.minutes.is_none().then_some(steps as u32);
    let begun = begun.progress;
    let mut first = trainer.steps();
    let mut progress = begun;
    // Of another length than before, a training stays where it was left until its steps have come so far.
    let mut least = begun;
    let glances = f64::from(args.evaluations);
    let after = |progress: f64| ((progress * glances).floor() + 1.0) / glances;
    let mut next_glance = if begun > 0.0 { after(begun) } else { 0.0 };
    let mut interrupted = false;
    let mut last = None;
    while progress < 1.0 && !interrupted {
        let report = match trainer.step(progress) {
            Ok(report) => report,
            Err(error) => {
                // What was reached before is kept.
                save(folder, dataset, trainer, (trainer.progress(), length))?;
                files::write(&folder.log, log.csv().as_bytes())?;
                return Err(error).with_context(|| {
                    format!(
                        "{}: holds what was reached, and --resume keeps its options; others are for a new \
                         training (--overwrite)",
                        folder.checkpoint.display()
                    )
                });
            }
        };
        let seconds = clock.elapsed().as_secs_f64();
        if report.rollback.is_some() {
            // It may have fallen back to before where it was left.
            least = least.min(trainer.progress());
            first = first.min(report.step);
        }
        progress = match args.minutes {
            None => (f64::from(report.step) / steps).max(least),
            Some(minutes) => begun + seconds / (60.0 * minutes),
        };
        if let Some((step, what)) = &report.rollback {
            let note = format!("step {step}: {what}; fell back to step {}, with half the rates", report.step);
            if !quiet.0 {
                bar.say(&format!("warning: {note}"));
            }
            log.notes.push(note);
        }
        let due = glances > 0.0 && progress >= next_glance;
        if due {
            next_glance = after(progress);
        }
        if due || report.step.is_multiple_of(LOG_EVERY) {
            let psnr_db = if due { glance(trainer, dataset) } else { None };
            log.samples.push(Sample::of(&report, before + seconds, psnr_db));
            let left = match args.minutes {
                // Of another length than before, progress stands still at first; steps do not.
                None => {
                    seconds * (steps - f64::from(report.step)).max(0.0)
                        / f64::from(report.step.saturating_sub(first)).max(1.0)
                }
                Some(minutes) => 60.0 * minutes * (1.0 - progress),
            };
            bar.stage(&log.line(left), progress);
            if due && !quiet.0 && !std::io::stderr().is_terminal() {
                bar.say(&format!("step {}: {}", report.step, log.line(left)));
            }
        }
        interrupted = stop.take();
        last = Some(Sample::of(&report, before + seconds, None));
        if interrupted || report.step.is_multiple_of(args.checkpoint_every) {
            save(folder, dataset, trainer, (progress, length))?;
            files::write(&folder.log, log.csv().as_bytes())?;
        }
    }
    if !interrupted {
        save(folder, dataset, trainer, (1.0, length))?;
    }
    // Where a training ends is in its log.
    log.end(last);
    files::write(&folder.log, log.csv().as_bytes())?;
    Ok(Ended { seconds: before + clock.elapsed().as_secs_f64(), interrupted })
}

/// Steps of the whole training: as typed, else as many as the checkpoint was part of.
fn steps(args: &Train, trainer: &Trainer, begun: Begun) -> f64 {
    match args.steps.or(begun.length) {
        Some(steps) => f64::from(steps),
        None if begun.progress > 0.0 => (f64::from(trainer.steps()) / begun.progress).round(),
        None => f64::from(DEFAULT_STEPS),
    }
}

/// Writes the checkpoint of a training at its `progress` of so many steps, if steps end it.
fn save(
    folder: &Folder,
    dataset: &Dataset,
    trainer: &Trainer,
    (progress, length): (f64, Option<u32>),
) -> Result<()> {
    let checkpoint = Checkpoint::of(trainer, dataset, progress.min(1.0)).of_length(length);
    files::write(&folder.checkpoint, &checkpoint.to_bytes()?)
}

/// PSNR (dB) on a few validation or test views, for display only: nothing is chosen by it.
fn glance(trainer: &Trainer, dataset: &Dataset) -> Option<f64> {
    let (reduced, background) = (trainer.reduced(), trainer.options().background);
    let found = if dataset.validation.is_empty() {
        train::evaluate(
            &*trainer.model(),
            &dataset.test.sample(GLANCE_VIEWS),
            reduced * dataset.test_scale,
            background,
        )
    } else {
        train::evaluate(&*trainer.model(), &dataset.validation.sample(GLANCE_VIEWS), reduced, background)
    };
    // Views of which a mask leaves nothing have none.
    found.ok().map(|found| found.psnr_db).filter(|psnr_db| psnr_db.is_finite())
}

/// How the end of a training on `dataset` encodes, at so many frames per second.
fn encoding_of(args: &Train, dataset: &Dataset, frames_per_second: f64) -> Encoding {
    let options = pipeline::encode_options(&args.codec, Protection::NONE);
    // A training makes up for its own rounding, whichever Gaussian it is of: where steps followed what shows,
    // it would do so twice.
    let pictures = args.codec.pictures.unwrap_or(0);
    Encoding {
        options: EncodeOptions { pictures, ..options },
        frames: args.frames.unwrap_or(dataset.frames),
        frames_per_second,
        up: dataset.up,
    }
}
