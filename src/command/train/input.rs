//! Reads what a training learns from, and says what a person should know of it.

use std::path::Path;

use anyhow::{Result, bail};
use trainer_host::{
    Scene,
    train::{
        Checkpoint, Dataset, PosedPhotograph, Trimmed,
        dataset::{self, rendered},
    },
};

use super::training::options;
use crate::{
    args::train::{SPLIT, Train},
    output, pipeline,
};

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
    /// The dataset that was named, for a training that goes on from `resumed` where it does; if it was a
    /// scene, with the scene.
    ///
    /// # Errors
    /// What reading it, importing it or rendering it refuses.
    pub(super) fn load(args: &Train, max_side: u32, resumed: Option<&Checkpoint>) -> Result<Self> {
        let path = Path::new(&args.input);
        let mut unknown = None;
        if path.is_dir() && !args.input.starts_with("synth:") {
            match dataset::read_reduced(path, max_side) {
                Err(error @ dataset::DatasetError::Unknown { .. }) => unknown = Some(error),
                found => {
                    let (mut dataset, report) = found?;
                    let typed = args.scene.up.map(Into::into);
                    dataset.up = typed.or(resumed.map(Checkpoint::up)).unwrap_or(dataset.up);
                    let mut input = photographs(args, dataset, report.trimmed);
                    input.notes.extend(sizes_in_words(args, max_side, report.much_reduced, report.too_long));
                    return Ok(input);
                }
            }
        }
        let loaded = match (pipeline::import(&args.input, &args.scene), unknown) {
            (Err(error), Some(unknown)) => bail!("{unknown}; nor is it a scene: {error:#}"),
            (loaded, _) => loaded?,
        };
        if let Some(damage) = &loaded.damage {
            output::print_status(&format!("warning: {damage}"));
        }
        let views = rendered::RenderedOptions {
            cameras: args.cameras,
            side: args.side,
            canonical_time: match resumed {
                Some(checkpoint) => checkpoint.options().canonical_time,
                None => options(args)?.canonical_time,
            },
            ..rendered::RenderedOptions::default()
        };
        let dataset = rendered::rendered(&loaded.scene, &loaded.name, &views)?;
        let notes = of_import(&args.input, &loaded.scene);
        let notes = notes.chain(harmonics_that_change(&args.input, &loaded.scene)).collect();
        Ok(Self { scene: Some(loaded.scene), dataset, damaged: loaded.damage.is_some(), notes })
    }

    /// Frames per second of what is trained: of a scene its own, else what was typed, what a training that
    /// goes on was `begun` with, or the default.
    pub(super) fn frames_per_second(&self, args: &Train, begun: Option<f64>) -> f64 {
        // An import says whether what was typed or what the source says holds.
        let own = self.scene.as_ref().map(Scene::frames_per_second);
        match args.scene.fps {
            Some(typed) => own.unwrap_or(typed),
            None => begun.or(own).unwrap_or_else(|| args.scene.frames_per_second()),
        }
    }
}

/// What the import of `input` says, without what is otherwise in a training: all frames get one identity,
/// cameras are placed around the scene, and how a scene is made was typed.
fn of_import(input: &str, scene: &Scene) -> impl Iterator<Item = String> {
    const OTHERWISE: [&str; 3] = ["identity is not stored", "no cameras: ", "synthetic "];
    let applies = |note: &&String| !OTHERWISE.iter().any(|start| note.starts_with(*start));
    scene.notes.iter().filter(applies).map(move |note| format!("{input}: {note}"))
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
fn photographs(args: &Train, dataset: Dataset, trimmed: Option<Trimmed>) -> Input {
    let mut notes = Vec::new();
    let applies = ["--fps", "--seed", "--up", "--footprint"];
    let usual = rendered::RenderedOptions::default();
    let of_renders = [("--cameras", args.cameras != usual.cameras), ("--side", args.side != usual.side)];
    let of_renders = of_renders.into_iter().chain([("--split", args.split != SPLIT)]);
    let of_renders = of_renders.filter(|(_, typed)| *typed).map(|(name, _)| name);
    let of_scenes = args.scene.given().into_iter().filter(|name| !applies.contains(name));
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
    notes.extend(trained_and_tested(args, &dataset));
    notes.extend(chosen_on_tests(args, &dataset));
    notes.extend(without_pixels(args, &dataset));
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

/// How many of `views` are among `others`: at the same time from the same place, with the same name or the
/// same pixels. A name alone says nothing, since different photographs may have one; nor does a camera, since
/// photographs for testing may be larger.
fn shared(views: &[PosedPhotograph], others: &[PosedPhotograph]) -> usize {
    let place = |view: &PosedPhotograph| (view.time, view.camera.rotation(), view.camera.translation());
    let name = |view: &PosedPhotograph| view.name.trim_start_matches("./").to_owned();
    let is_other = |view: &&PosedPhotograph| {
        let mut there = others.iter().filter(|other| place(other) == place(view));
        there.any(|other| name(other) == name(view) || other.photograph == view.photograph)
    };
    views.iter().filter(is_other).count()
}

/// That photographs are both for training and for testing, as a list of tests that was copied would have it.
fn trained_and_tested(args: &Train, dataset: &Dataset) -> Option<String> {
    let test = dataset.test.photographs();
    let both = shared(test, dataset.train.photographs());
    (both > 0).then(|| {
        format!(
            "{}: {both} of {} photographs for testing are also trained on; figures of test views are better \
             than those of views that are not",
            args.input,
            test.len()
        )
    })
}

/// That masks leave no pixel of some photographs.
fn without_pixels(args: &Train, dataset: &Dataset) -> Vec<String> {
    let splits = [
        ("to train on", dataset.train.photographs(), "nothing is learnt from them"),
        ("for validation", dataset.validation.photographs(), "figures are without them"),
        ("for testing", dataset.test.photographs(), "figures are without them"),
    ];
    let note = |(what, views, so): (&str, &[PosedPhotograph], &str)| {
        let is_left_out =
            |view: &&PosedPhotograph| view.counted.as_ref().is_some_and(|mask| !mask.values().contains(&255));
        let none = views.iter().filter(is_left_out).count();
        (none > 0).then(|| {
            let (input, all) = (&args.input, views.len());
            format!("{input}: masks leave no pixel of {none} of {all} photographs {what}; {so}")
        })
    };
    splits.into_iter().filter_map(note).collect()
}

/// That photographs are trained on much smaller than was allowed (sizes before and after), or larger (the
/// longest side), pixels, since one number reduces all.
fn sizes_in_words(
    args: &Train,
    max_side: u32,
    much_reduced: Option<[(u32, u32); 2]>,
    too_long: Option<u32>,
) -> Vec<String> {
    let input = &args.input;
    let small = much_reduced.map(|[(width, height), (to_width, to_height)]| {
        format!(
            "{input}: photographs of {width} x {height} pixels are trained on at {to_width} x {to_height}, \
             since all are reduced by one whole number; --max-side is {max_side}"
        )
    });
    let large = too_long.map(|side| {
        format!(
            "{input}: photographs are trained on with sides of up to {side} pixels; --max-side is \
             {max_side}, but no whole number up to 64 reduces all of them to that"
        )
    });
    small.into_iter().chain(large).collect()
}

/// That photographs are both for choosing quantiser steps and for testing, as the lists of a dataset may say.
fn chosen_on_tests(args: &Train, dataset: &Dataset) -> Option<String> {
    let validation = dataset.validation.photographs();
    let both = shared(validation, dataset.test.photographs());
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

    use super::{
        super::{encoding::one_gaussian, parsed},
        *,
    };

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

    /// What is said of the dataset in `folder`, with sides of at most `max_side` pixels.
    fn said(folder: &Path, max_side: u32) -> String {
        let folder = folder.display().to_string();
        Input::load(&parsed([folder.as_str()]), max_side, None).unwrap().notes.join("\n")
    }

    /// A file of the frames of a split: names, and how far its cameras stand, scene units.
    fn transforms(frames: &[(&str, u32)], more: &str) -> String {
        let frame = |(name, z): &(&str, u32)| {
            format!(
                r#"{{"file_path": "{name}", {more} "transform_matrix":
                [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, {z}], [0, 0, 0, 1]]}}"#
            )
        };
        let frames: Vec<String> = frames.iter().map(frame).collect();
        format!(r#"{{"camera_angle_x": 0.7, "frames": [{}]}}"#, frames.join(","))
    }

    /// Writes pictures of these sizes, each of another grey.
    fn write_pictures(folder: &Path, pictures: &[(&str, u32, u32)]) {
        for (at, (name, width, height)) in pictures.iter().enumerate() {
            let picture = render_host::Image::filled(*width, *height, [0.1 * (at + 1) as f32; 3]).unwrap();
            std::fs::write(folder.join(name), picture.to_png().unwrap()).unwrap();
        }
    }

    #[test]
    fn photographs_that_are_trained_and_tested_on_are_said() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        write_pictures(at, &[("a.png", 32, 32), ("b.png", 32, 32), ("c.png", 32, 32)]);
        let write = |split: &str, frames: &[(&str, u32)]| {
            std::fs::write(at.join(format!("transforms_{split}.json")), transforms(frames, "")).unwrap();
        };
        write("train", &[("./a", 4), ("./b", 5)]);
        let both = "also trained on";
        write("test", &[("./c", 4), ("./c", 6)]);
        assert!(!said(at, 800).contains(both), "{}", said(at, 800));
        // Of one name, but from elsewhere.
        write("test", &[("./a", 6)]);
        assert!(!said(at, 800).contains(both), "{}", said(at, 800));
        write("test", &[("a", 4), ("./c", 6)]);
        assert!(said(at, 800).contains("1 of 2 photographs for testing are also trained on"));
        // Larger than those that are trained on, and under another name.
        assert!(said(at, 16).contains("1 of 2 photographs for testing are also trained on"));
        std::fs::copy(at.join("a.png"), at.join("d.png")).unwrap();
        write("test", &[("./d", 4)]);
        assert!(said(at, 800).contains("1 of 1 photographs for testing are also trained on"));
    }

    #[test]
    fn sizes_that_are_far_from_what_is_allowed_are_said() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        write_pictures(at, &[("a.png", 640, 640), ("b.png", 64, 64)]);
        std::fs::write(at.join("transforms_train.json"), transforms(&[("a", 4), ("b", 5)], "")).unwrap();
        assert_eq!(said(at, 800).matches("--max-side").count(), 0);
        let small = "photographs of 64 x 64 pixels are trained on at 4 x 4, since all are reduced by one";
        assert!(said(at, 64).contains(small), "{}", said(at, 64));
        write_pictures(at, &[("a.png", 500, 3), ("b.png", 500, 3)]);
        let large = "with sides of up to 500 pixels; --max-side is 64, but no whole number up to 64";
        assert!(said(at, 64).contains(large), "{}", said(at, 64));
    }

    #[test]
    fn masks_that_leave_nothing_of_some_photographs_are_said() {
        let folder = tempfile::tempdir().unwrap();
        let at = folder.path();
        write_pictures(at, &[("a.png", 32, 32), ("b.png", 32, 32)]);
        let black = render_host::Image::filled(32, 32, [0.0; 3]).unwrap();
        std::fs::write(at.join("black.png"), black.to_png().unwrap()).unwrap();
        let mask = r#""mask_path": "black.png","#;
        std::fs::write(at.join("transforms_train.json"), transforms(&[("a", 4)], "")).unwrap();
        std::fs::write(at.join("transforms_test.json"), transforms(&[("b", 5)], mask)).unwrap();
        let said = said(at, 800);
        assert!(said.contains("masks leave no pixel of 1 of 1 photographs for testing; figures"), "{said}");
        assert!(!said.contains("to train on"), "{said}");
    }

    /// Two frames of one Gaussian each, as files of a sequence.
    #[test]
    fn what_an_import_says_is_said_unless_training_makes_it_otherwise() {
        let folder = tempfile::tempdir().unwrap();
        let fields = "x y z f_dc_0 f_dc_1 f_dc_2 opacity scale_0 scale_1 scale_2 rot_0 rot_1 rot_2 rot_3";
        let properties: String = fields.split(' ').map(|name| format!("property float {name}\n")).collect();
        for frame in [0, 1] {
            let text = format!(
                "ply\nformat ascii 1.0\nelement vertex 1\n{properties}end_header\n\
                 {frame} 0 0 1 0 0 2 -1 -1 -1 1 0 0 0\n"
            );
            std::fs::write(folder.path().join(format!("frame_{frame}.ply")), text).unwrap();
        }
        let input = folder.path().display().to_string();
        let args = parsed([input.as_str(), "--side", "16", "--cameras", "1"]);
        let loaded = pipeline::import(&input, &args.scene).unwrap();
        assert!(loaded.scene.notes.iter().any(|note| note.starts_with("identity is not stored")));
        let notes = Input::load(&args, 800, None).unwrap().notes;
        assert!(notes.iter().any(|note| note.contains("up is taken to be")), "{notes:?}");
        assert!(!notes.iter().any(|note| note.contains("identity")), "{notes:?}");
        let typed = parsed(["synth:balls:1000:1", "--side", "16", "--cameras", "1"]);
        assert_eq!(Input::load(&typed, 800, None).unwrap().notes, Vec::<String>::new());
    }
}
