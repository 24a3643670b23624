//! Trains a clip in parts where that was found to be better, each in a folder of its own.

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use serde::{Deserialize, Serialize};
use trainer_host::{
    Scene,
    train::{
        Dataset, TrainOptions,
        dataset::rendered,
        epochs::{Parts, SplitOptions, part},
    },
};

use super::{
    folder::{Folder, epoch_folder},
    interruption::Interruption,
    log::Log,
    page::Ended,
    trained::Trained,
    training::{
        DEFAULT_STEPS, begin, check_length, check_options, fit, options, options_of_file, resumed, with_typed,
    },
};
use crate::{args::train::Train, files, pipeline::Quiet, progress::Progress};

/// How a training in parts was begun: what `--resume` goes on with.
#[derive(Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    #[serde(flatten)]
    pub(super) parts: Parts,
    /// Steps of all of them together.
    steps: u32,
    /// Options of all of them together, but for what follows from how the result is encoded.
    options: TrainOptions,
}

impl Plan {
    /// The plan that the folder of `args` holds, or that trials lead to; nothing where nothing was tried.
    ///
    /// # Errors
    /// A trial that fails, a file that is no plan, or other options than those of the plan.
    pub(super) fn of(
        args: &Train,
        folder: &Folder,
        scene: &Scene,
        dataset: &Dataset,
        stop: &Interruption,
        quiet: Quiet,
    ) -> Result<Option<Self>> {
        let path = &folder.epochs;
        if args.resume {
            if !path.is_file() {
                return Ok(None);
            }
            let failed = || path.display().to_string();
            let plan: Self =
                serde_json::from_slice(&std::fs::read(path).with_context(failed)?).with_context(failed)?;
            let last = plan.parts.frames.last().map_or(0, |frames| frames.end);
            if last != scene.frames() {
                bail!("{}: of {last} frames; the scene has {}", path.display(), scene.frames());
            }
            check_options(args, &plan.options).with_context(failed)?;
            return Ok(Some(plan));
        }
        if args.split == 0.0 || args.frames.is_some() {
            return Ok(None);
        }
        let bar = Progress::new("look for epochs", quiet.0);
        let options = options(args)?;
        let found = part(
            scene,
            dataset,
            &options,
            SplitOptions { gain_db: args.split, ..SplitOptions::default() },
            &mut |trial| {
                stop.leave("nothing was written");
                bar.stage(&format!("trial {trial} of where the clip changes"), 0.0);
            },
        )?;
        drop(bar);
        if found.trials.is_empty() {
            return Ok(None);
        }
        let plan = Self {
            parts: found,
            steps: args.steps.unwrap_or(DEFAULT_STEPS),
            options: TrainOptions { finish: options_of_file(args)?.finish, ..options },
        };
        if plan.is_parted() {
            files::write(path, serde_json::to_string_pretty(&plan)?.as_bytes())?;
        }
        Ok(Some(plan))
    }

    /// Whether the clip has more than one epoch.
    pub(super) fn is_parted(&self) -> bool {
        self.parts.frames.len() > 1
    }

    /// For people.
    pub(super) fn text(&self) -> String {
        let frames = |range: &Range<usize>| format!("{} to {}", range.start, range.end - 1);
        let parts: Vec<String> = self.parts.frames.iter().map(frames).collect();
        let mut text = format!("  epochs: frames {}\n", parts.join(", "));
        for trial in &self.parts.trials {
            text += &format!(
                "  trial: frames {} in two from frame {}: {:.2} dB, as one {:.2} dB\n",
                frames(&trial.frames),
                trial.at,
                trial.parts_db,
                trial.whole_db
            );
        }
        text
    }

    /// Trains every part; of the whole, what it led to, its log and how it ended. Nothing where a person
    /// asked to stop: `--resume` goes on.
    ///
    /// # Errors
    /// As those of each training; a typed length that it cannot take.
    pub(super) fn train(
        &self,
        args: &Train,
        scene: &Scene,
        dataset: &Dataset,
        stop: &Interruption,
        quiet: Quiet,
    ) -> Result<Option<(Trained, Log, Ended)>> {
        let backend = render_host::Backend::open(args.device.into()).context("--device")?;
        let mut whole: Option<(Trained, Log)> = None;
        let (typed, mut is_complete) = (args, true);
        for (index, frames) in self.parts.frames.iter().enumerate() {
            let out = epoch_folder(&typed.out, index);
            let (args, folder) = (self.args_of(typed, &out, frames.len(), dataset.frames), Folder::of(&out));
            let _opened = folder.open(&args)?;
            let part = rendered::part(dataset, scene, frames.clone());
            let resumed = resumed(&args, &folder)?;
            let options = with_typed(self.options.clone(), &args);
            let (mut trainer, begun) = begin(&args, &folder, resumed, &options, &part, &backend)?;
            is_complete &= begun >= 1.0;
            if let (Some(all), Some(share)) = (typed.steps, args.steps)
                && begun < 1.0
                && share <= trainer.steps()
            {
                bail!(
                    "--steps is {all}, {share} of them for {}; the checkpoint there has taken {}: more are \
                     needed",
                    out.display(),
                    trainer.steps()
                );
            }
            let mut log =
                if args.resume { Log::resumed(&folder.log, trainer.steps())? } else { Log::default() };
            let ended = fit(&args, &folder, &part, &mut trainer, begun, &mut log, stop, quiet)?;
            if ended.interrupted {
                return Ok(None);
            }
            let trained = Trained::of(&trainer, &part, &args)?;
            whole = Some(match whole {
                None => (trained, log),
                Some((before, of_before)) => (before.followed_by(trained)?, of_before.followed_by(log)),
            });
        }
        let (trained, log) = whole.context("a plan without epochs")?;
        if is_complete {
            check_length(typed, trained.steps, 1.0)?;
        }
        let ended = Ended { seconds: log.seconds(), interrupted: false };
        Ok(Some((trained, log, ended)))
    }

    /// The checkpoint of each part.
    pub(super) fn checkpoints(&self, args: &Train) -> Vec<PathBuf> {
        (0..self.parts.frames.len())
            .map(|index| Folder::of(&epoch_folder(&args.out, index)).checkpoint)
            .collect()
    }

    /// What the training of a part of `frames` frames is asked for.
    fn args_of(&self, args: &Train, out: &Path, frames: usize, all: usize) -> Train {
        let share = frames as f64 / all.max(1) as f64;
        // The bound is that of all parts together, as it was in the trials.
        let gaussians = (self.options.max_gaussians as f64 * share) as usize;
        let mut args = args.clone();
        args.gaussians = Some(gaussians.max(1));
        let steps = f64::from(args.steps.unwrap_or(self.steps));
        args.steps = args.minutes.is_none().then_some(((steps * share).round() as u32).max(1));
        args.minutes = args.minutes.map(|minutes| minutes * share);
        args.codec.target_bytes = args.codec.target_bytes.map(|bytes| (bytes as f64 * share) as u64);
        args.resume &= Folder::of(out).checkpoint.is_file();
        out.clone_into(&mut args.out);
        args
    }
}
