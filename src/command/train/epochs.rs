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
        Checkpoint, Dataset, Finish, TrainOptions,
        dataset::rendered,
        epochs::{Parts, SplitOptions, part},
    },
};

use super::{
    encoder_options::Rounded,
    folder::{Folder, Opened, epoch_folder},
    interruption::Interruption,
    log::Log,
    page::Ended,
    trained::Trained,
    training::{
        Begun, DEFAULT_STEPS, begin, check_length, check_options, fit, options, options_of_file, resumed,
        with_typed,
    },
};
use crate::{args::train::Train, files, pipeline::Quiet, progress::Progress};

/// How a training in parts was begun: what `--resume` goes on with.
#[derive(Clone, Debug, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Plan {
    #[serde(flatten)]
    pub(super) parts: Parts,
    /// Steps of all of them together, where no time was given.
    steps: u32,
    /// Minutes of all of them together, if a time was given.
    minutes: Option<f64>,
    /// Of the clip; of a plan of before it was kept, nothing.
    pub(super) frames_per_second: Option<f64>,
    /// Options of all of them together, but for what follows from how steps are typed.
    options: TrainOptions,
}

impl Plan {
    /// The plan by which the training of `folder` was begun, if that was in parts.
    ///
    /// # Errors
    /// A file that is no plan.
    pub(super) fn begun(folder: &Folder) -> Result<Option<Self>> {
        let path = &folder.epochs;
        if !path.is_file() {
            return Ok(None);
        }
        let failed = || path.display().to_string();
        Ok(Some(serde_json::from_slice(&std::fs::read(path).with_context(failed)?).with_context(failed)?))
    }

    /// Refuses other frames than those of the source: which ones an epoch has is known.
    ///
    /// # Errors
    /// Frames that were typed.
    pub(super) fn check_frames(&self, args: &Train) -> Result<()> {
        let last = self.parts.frames.last().map_or(0, |frames| frames.end);
        if let Some(frames) = args.frames {
            bail!(
                "--frames is {frames}; the training is of a clip in epochs, which has the {last} of its \
                 source: leave it out"
            );
        }
        Ok(())
    }

    /// The plan that the folder of `args` holds, or that trials lead to; nothing where nothing was tried. The
    /// clip has so many frames per second.
    ///
    /// # Errors
    /// A trial that fails, a file that is no plan, or other options than those of the plan.
    pub(super) fn of(
        args: &Train,
        (folder, opened): (&Folder, &Opened),
        scene: &Scene,
        (dataset, rate): (&Dataset, f64),
        stop: &Interruption,
        quiet: Quiet,
    ) -> Result<Option<Self>> {
        let path = &folder.epochs;
        if args.resume {
            let Some(plan) = Self::begun(folder)? else { return Ok(None) };
            let last = plan.parts.frames.last().map_or(0, |frames| frames.end);
            if last != scene.frames() {
                bail!("{}: of {last} frames; the scene has {}", path.display(), scene.frames());
            }
            check_options(args, &plan.options).with_context(|| path.display().to_string())?;
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
                stop.leave_after("nothing was trained yet", || opened.remove_bare());
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
            minutes: args.minutes,
            frames_per_second: Some(rate),
            options: TrainOptions {
                finish: Finish { target_bytes: options.finish.target_bytes, ..options_of_file(args)?.finish },
                ..options
            },
        };
        if plan.is_parted() {
            plan.write(path)?;
        }
        Ok(Some(plan))
    }

    fn write(&self, path: &Path) -> Result<()> {
        files::write(path, serde_json::to_string_pretty(self)?.as_bytes())
    }

    /// The plan with the length that was typed, if one was: that is what `--resume` goes on with next.
    fn of_length(&self, args: &Train) -> Self {
        let mut plan = self.clone();
        if let Some(steps) = args.steps {
            (plan.steps, plan.minutes) = (steps, None);
        } else if args.minutes.is_some() {
            plan.minutes = args.minutes;
        }
        plan
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
        (dataset, rate): (&Dataset, f64),
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
            let part = rendered::part(dataset, scene, frames.clone(), self.options.canonical_time);
            let resumed = resumed(&args, &folder)?;
            let options = with_typed(self.options.clone(), &args);
            let (mut trainer, begun) = begin((&args, rate), &folder, resumed, &options, &part, &backend)?;
            let args = self.timed(args, begun.progress, frames.len() as f64 / dataset.frames as f64);
            let has_ended = begun.progress >= 1.0;
            is_complete &= has_ended;
            if let (Some(all), Some(share)) = (typed.steps, args.steps)
                && !has_ended
                && share <= trainer.steps()
            {
                bail!(
                    "--steps is {all}, {share} of them for {}; the checkpoint there has taken {}: more are \
                     needed",
                    out.display(),
                    trainer.steps()
                );
            }
            if typed.resume && !has_ended {
                self.of_length(typed).write(&Folder::of(&typed.out).epochs)?;
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
        let (mut trained, log) = whole.context("a plan without epochs")?;
        // Those of the whole, not the share of the first part.
        trained.options.finish.target_bytes = self.target_bytes(typed);
        trained.options.max_gaussians = self.options.max_gaussians;
        trained.options.initial_gaussians = self.options.initial_gaussians;
        if is_complete {
            check_length(typed, trained.steps, Begun::COMPLETE)?;
        }
        let ended = Ended { seconds: log.seconds(), interrupted: false };
        Ok(Some((trained, log, ended)))
    }

    /// `args` of a part with its `share` of the minutes that were given at the start, where it begins now and
    /// no other length was typed. One that had `begun` has what is left.
    fn timed(&self, args: Train, begun: f64, share: f64) -> Train {
        let is_due = begun <= 0.0 && args.steps.is_none() && args.minutes.is_none();
        let minutes = self.minutes.filter(|_| is_due).map(|minutes| minutes * share);
        Train { minutes: minutes.or(args.minutes), ..args }
    }

    /// Bytes that all parts together are to have at most: what was typed now, or else at the start; 0:
    /// whatever they lead to.
    pub(super) fn target_bytes(&self, args: &Train) -> u64 {
        args.codec.target_bytes.unwrap_or(self.options.finish.target_bytes)
    }

    /// How many parts have begun to round their values.
    ///
    /// # Errors
    /// A checkpoint that cannot be read.
    pub(super) fn rounded(&self, args: &Train) -> Result<Rounded> {
        let paths = self.checkpoints(args);
        let mut rounded = 0;
        for path in paths.iter().filter(|path| path.is_file()) {
            let failed = || path.display().to_string();
            let checkpoint =
                Checkpoint::from_bytes(&std::fs::read(path).with_context(failed)?).with_context(failed)?;
            rounded += usize::from(checkpoint.has_rounded());
        }
        Ok(match rounded {
            0 => Rounded::Nothing,
            some if some < paths.len() => Rounded::SomeEpochs,
            _ => Rounded::All,
        })
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
        let is_timed = args.minutes.or(self.minutes.filter(|_| args.steps.is_none())).is_some();
        let steps = f64::from(args.steps.unwrap_or(self.steps));
        args.steps = (!is_timed).then_some(((steps * share).round() as u32).max(1));
        args.minutes = args.minutes.map(|minutes| minutes * share);
        let bytes = self.target_bytes(&args);
        args.codec.target_bytes = (bytes > 0).then_some(((bytes as f64 * share) as u64).max(1));
        args.resume &= Folder::of(out).checkpoint.is_file();
        out.clone_into(&mut args.out);
        args
    }
}

#[cfg(test)]
mod tests {
    use super::{super::parsed, *};

    /// A clip of 30 frames in two epochs, of which the first, of 10, is asked for this by `typed`.
    fn first_part(plan: &Plan, typed: &str) -> Train {
        plan.args_of(
            &parsed(["scene"].into_iter().chain(typed.split_whitespace())),
            Path::new("out/epoch-0"),
            10,
            30,
        )
    }

    #[test]
    fn a_part_has_its_share_of_size_and_length() {
        let finish = Finish { target_bytes: 900, ..Finish::default() };
        let mut plan = Plan {
            parts: Parts { frames: vec![0..10, 10..30], trials: Vec::new() },
            steps: 3000,
            minutes: None,
            frames_per_second: None,
            options: TrainOptions { max_gaussians: 600, finish, ..TrainOptions::default() },
        };
        let args = first_part(&plan, "");
        assert_eq!((args.gaussians, args.steps, args.minutes), (Some(200), Some(1000), None));
        assert_eq!(args.codec.target_bytes, Some(300));
        assert_eq!(first_part(&plan, "--target-bytes 600").codec.target_bytes, Some(200));
        let args = first_part(&plan, "--minutes 6");
        assert_eq!((args.steps, args.minutes), (None, Some(2.0)));
        // Begun with a time: what begins now has its share of it, what had begun what is left.
        plan.minutes = Some(3.0);
        let args = first_part(&plan, "");
        assert_eq!((args.steps, args.minutes), (None, None));
        assert_eq!(plan.timed(args.clone(), 0.0, 1.0 / 3.0).minutes, Some(1.0));
        assert_eq!(plan.timed(args, 0.5, 1.0 / 3.0).minutes, None);
        let args = first_part(&plan, "--steps 60");
        assert_eq!(args.steps, Some(20));
        assert_eq!(plan.timed(args, 0.0, 1.0 / 3.0).minutes, None);
        plan.options.finish.target_bytes = 0;
        assert_eq!(first_part(&plan, "").codec.target_bytes, None);

        // What was typed last is what goes on.
        let length = |typed: &str| {
            let plan = plan.of_length(&parsed(["scene"].into_iter().chain(typed.split_whitespace())));
            (plan.steps, plan.minutes)
        };
        assert_eq!(length(""), (3000, Some(3.0)));
        assert_eq!(length("--steps 60"), (60, None));
        assert_eq!(length("--minutes 9").1, Some(9.0));
    }
}
