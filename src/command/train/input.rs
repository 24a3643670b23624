//! Reads what a training learns from, and says what a person should know of it.

use std::path::Path;

use anyhow::{Result, bail};
use trainer_host::{
    Scene,
    train::{
        Dataset, PosedPhotograph, Trimmed,
        dataset::{self, rendered},
    },
};

use crate::{args::train::Train, output, pipeline};

/// Share of a clip before the first photograph, or after the last, of which nothing is said.
const UNSEEN: f32 = 0.05;

/// What a training learns from.
pub(super) struct Input {
    /// Where it was a scene.
    pub(super) scene: Option<Scene>,
    pub(super) dataset: Dataset,
    /// Whether only a part of the file was read.
    pub(super) damaged: bool,
    /// What a person should know.
    pub(super) notes: Vec<String>,
}

impl Input {
    /// The dataset that was named; if it was a scene, with the scene.
    ///
    /// # Errors
    /// What reading it, importing it or rendering it refuses.
    pub(super) fn load(args: &Train, max_side: u32) -> Result<Self> {
        let path = Path::new(&args.input);
        let mut unknown = None;
        if path.is_dir() && !args.input.starts_with("synth:") {
            match dataset::read_reduced(path, max_side) {
                Err(error @ dataset::DatasetError::Unknown { .. }) => unknown = Some(error),
                found => return Ok(photographs(args, found?)),
            }
        }
        let loaded = match (pipeline::import(&args.input, &args.scene), unknown) {
            (Err(error), Some(unknown)) => bail!("{unknown}; nor is it a scene: {error:#}"),
            (loaded, _) => loaded?,
        };
        if let Some(damage) = &loaded.damage {
            output::print_status(&format!("warning: {damage}"));
        }
        let options = rendered::RenderedOptions {
            cameras: args.cameras,
            side: args.side,
            ..rendered::RenderedOptions::default()
        };
        let dataset = rendered::rendered(&loaded.scene, &loaded.name, &options)?;
        let notes = harmonics_that_change(&args.input, &loaded.scene).into_iter().collect();
        Ok(Self { scene: Some(loaded.scene), dataset, damaged: loaded.damage.is_some(), notes })
    }

    /// Frames per second of what is trained: of a scene its own, else what was typed, what a training that
    /// goes on was `begun` with, or the default.
    pub(super) fn frames_per_second(&self, args: &Train, begun: Option<f64>) -> f64 {
        let usual = args.scene.frames_per_second();
        // Where a source does not say, a scene has what was typed, or the default.
        let own = self.scene.as_ref().map(Scene::frames_per_second);
        let own = own.filter(|&rate| rate != usual || args.scene.fps.is_some());
        own.or(args.scene.fps).or(begun).unwrap_or(usual)
    }
}

/// That frames have harmonics of different degrees, which a moving scene has not.
fn harmonics_that_change(input: &str, scene: &Scene) -> Option<String> {
    let degrees = scene.epochs().iter().map(|epoch| epoch.attributes().sh_degree.get());
    let (least, most) = (degrees.clone().min()?, degrees.max()?);
    (least < most).then(|| {
        format!(
            "{input}: harmonics are of degree {least} at some frames and of degree {most} at others; those \
             of a moving scene are the same at all. `dgs convert {input} FOLDER --sh-degree {least}` makes \
             frames alike"
        )
    })
}

/// Photographs as they are trained on.
fn photographs(args: &Train, (mut dataset, trimmed): (Dataset, Option<Trimmed>)) -> Input {
    let mut notes = Vec::new();
    dataset.up = args.scene.up.map_or(dataset.up, Into::into);
    let applies = ["--fps", "--seed"];
    let usual = rendered::RenderedOptions::default();
    let of_renders = [("--cameras", args.cameras != usual.cameras), ("--side", args.side != usual.side)];
    let of_renders = of_renders.into_iter().filter(|(_, typed)| *typed).map(|(name, _)| name);
    let of_scenes = args.scene.scene_only().into_iter().filter(|name| !applies.contains(name));
    let unused: Vec<&str> = of_scenes.chain(of_renders).collect();
    if !unused.is_empty() {
        notes.push(format!(
            "{}: are photographs; not used, being for scenes: {}",
            args.input,
            unused.join(", ")
        ));
    }
    if dataset.test.is_empty() {
        notes.push(format!(
            "{}: no photographs are for testing; figures are of those that are trained on",
            args.input
        ));
    }
    notes.extend(chosen_on_tests(args, &dataset));
    notes.extend(beyond_the_photographs(args, &dataset));
    notes.extend(trimmed.map(|trimmed| {
        let ((width, height), (to_width, to_height)) = (trimmed.before, trimmed.after);
        format!(
            "{} photographs of {width} x {height} pixels are cut to {to_width} x {to_height}, which can be \
             halved{}",
            trimmed.photographs,
            if trimmed.other_sizes > 0 { ", and those of other sizes likewise" } else { "" }
        )
    }));
    Input { scene: None, dataset, damaged: false, notes }
}

/// That photographs are both for choosing quantiser steps and for testing, as the lists of a dataset may say.
fn chosen_on_tests(args: &Train, dataset: &Dataset) -> Option<String> {
    // Different photographs may have one name.
    let is_test = |view: &PosedPhotograph| {
        let mut tests = dataset.test.photographs().iter();
        tests.any(|test| (&test.name, test.time, &test.camera) == (&view.name, view.time, &view.camera))
    };
    let validation = dataset.validation.photographs();
    let both = validation.iter().filter(|view| is_test(view)).count();
    (both > 0).then(|| {
        format!(
            "{}: {both} of {} photographs for validation are also for testing; quantiser steps are chosen on \
             them",
            args.input,
            validation.len()
        )
    })
}

/// That part of the clip is of times that no photograph shows.
fn beyond_the_photographs(args: &Train, dataset: &Dataset) -> Option<String> {
    let times = dataset.train.photographs().iter().map(|view| view.time);
    let (first, last) = times.fold((1.0f32, 0.0f32), |(first, last), t| (first.min(t), last.max(t)));
    let is_seen = first <= UNSEEN && last >= 1.0 - UNSEEN;
    (dataset.frames > 1 && !is_seen).then(|| {
        format!(
            "{}: photographs are of times {first} to {last}; the clip is of 0 to 1, and what it shows \
             besides is guessed",
            args.input
        )
    })
}

#[cfg(test)]
mod tests {
    use codec_core::ShDegree;
    use trainer_host::scene::{Attributes, Epoch};

    use super::{super::encoding::one_gaussian, *};

    /// A Gaussian in one frame each, of these degrees.
    fn frames(degrees: &[u8]) -> Scene {
        let epoch = |&degree: &u8| {
            let sh_degree = ShDegree::new(degree).unwrap();
            let sh_rest = vec![0.0; sh_degree.rest_len()];
            let attributes = Attributes { sh_degree, sh_rest, ..one_gaussian() };
            Epoch::new(1, attributes).unwrap()
        };
        Scene::new(degrees.iter().map(epoch).collect(), 30.0).unwrap()
    }

    #[test]
    fn frames_whose_harmonics_differ_are_said() {
        let note = harmonics_that_change("clip", &frames(&[3, 0, 0])).unwrap();
        assert!(note.contains("degree 0 at some frames and of degree 3 at others"), "{note}");
        assert!(note.contains("dgs convert clip FOLDER --sh-degree 0"), "{note}");
        assert_eq!(harmonics_that_change("clip", &frames(&[2, 2])), None);
    }
}
