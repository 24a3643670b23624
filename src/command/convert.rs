//! Converts a scene to another format, edited on the way: `dgs convert`.

pub(super) mod format;

use std::path::Path;

use anyhow::{Context, Result};
use codec_core::{ShDegree, internals::ids::Level};
use serde_json::json;
use trainer_host::{
    Scene,
    edit::{self, Similarity, turn_between},
    scene::Up,
    stream::decoded,
};

use self::format::{FrameRun, FrameToWrite, SceneOutput, WrittenScene};
use crate::{
    args::{Convert, SceneArgs},
    figures::counted,
    files,
    output::VerbOutput,
    pipeline::{Frames, LeftOut, Quiet, UP_HINT, note_of},
    progress::Progress,
};

/// Share of the work that is done when editing begins, about.
const EDITING: f64 = 0.3;
/// And when it ends.
const EDITED: f64 = 0.5;
/// And when it ends with a decimation, which takes longer than the rest.
const DECIMATED: f64 = 0.8;

/// Runs the verb.
pub fn run(args: &Convert, quiet: Quiet) -> Result<VerbOutput> {
    let output = SceneOutput::of(&args.out)?;
    let inputs: Vec<&Path> = std::iter::once(&args.input).chain(&args.merge).map(Path::new).collect();
    output.check(&args.out, args.overwrite, &inputs)?;
    let only = output.only(args.frame)?;
    let progress = Progress::new("convert", quiet.0);
    let mut warnings = Vec::new();
    let (alone, only) = (alone(args, output).then_some(only), only);
    let (scene, alone_of) = read(&args.input, &args.scene, alone, &progress, &mut |w| warnings.push(w))?;
    progress.stage("editing", EDITING);
    let before = (scene.max_count(), scene.frames());
    let scene = edited(args, scene, &progress, &mut warnings)?;
    let damaged = !warnings.is_empty();
    let done = if args.decimate.is_some() { DECIMATED } else { EDITED };
    progress.stage("turning", done);
    let (scene, turned) = turned(args, scene, output.default_up())?;
    progress.stage("writing", done + 0.1);
    let degree = scene.epochs().iter().map(|epoch| epoch.attributes().sh_degree).max().unwrap_or_default();
    warnings.extend(output.losses(degree, scene.footprint));
    let count = alone_of.unwrap_or(scene.frames() as u32);
    let frame = |number: u32| {
        let found = scene.locate(if alone_of.is_some() { 0 } else { number as usize });
        let last = count - 1;
        let (epoch, t) = found.with_context(|| format!("--frame is {number}; 0 to {last} are allowed"))?;
        let epoch = &scene.epochs()[epoch];
        Ok(FrameToWrite { epoch, t, has_rows_of_last: t > 0 })
    };
    let wrote = match output {
        SceneOutput::FourDgs => format::write_clip(&scene, &args.out)?,
        _ => {
            let Scene { footprint, .. } = scene;
            let run = FrameRun {
                overwrite: args.overwrite,
                only,
                count,
                footprint,
                frames_per_second: scene.frames_per_second(),
            };
            output.write(&args.out, run, &progress, frame)?
        }
    };
    drop(progress);
    let WrittenScene { mut text, notes } = wrote;
    // First what was read, then what that is written as.
    let notes: Vec<&String> = scene.notes.iter().chain(&notes).collect();
    if before != (scene.max_count(), scene.frames()) {
        text += &format!(
            "  {} in {} became {} in {}\n",
            counted(before.0, "Gaussian"),
            counted(before.1, "frame"),
            scene.max_count(),
            scene.frames()
        );
    }
    text += &format!("  {turned}\n");
    for note in &notes {
        text += &format!("  note: {note}\n");
    }
    // A file holds one frame, and its Gaussians.
    let (only, gaussians) = match output {
        SceneOutput::File(_) => (Some(only), frame(only)?.epoch.count()),
        SceneOutput::Folder | SceneOutput::FourDgs => (None, scene.max_count()),
    };
    let length = |path: &Path| {
        std::fs::metadata(path).ok().filter(std::fs::Metadata::is_file).map(|found| found.len())
    };
    let buffer = output.buffer_path(&args.out);
    let bytes = length(&args.out).map(|bytes| bytes + buffer.as_deref().and_then(length).unwrap_or(0));
    let json = json!({
        "input": args.input, "out": files::shown(&args.out),
        "buffer": buffer.as_deref().map(files::shown),
        "gaussians": gaussians, "frame": only, "frames": count,
        "bytes": bytes, "axes": turned, "notes": notes, "warnings": warnings,
    });
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// Whether one frame is written that depends on no other: what is chosen is chosen over all frames.
fn alone(args: &Convert, output: SceneOutput) -> bool {
    let chooses = args.crop.is_some() || !args.filter.is_empty() || args.decimate.is_some();
    matches!(output, SceneOutput::File(_)) && args.merge.is_empty() && args.frames.is_none() && !chooses
}

/// The scene of `input`; a stream is decoded, of which only frame `only` if that is all that is needed: then
/// the scene is that frame alone, and how many frames the stream has comes with it.
fn read(
    input: &str,
    args: &SceneArgs,
    only: Option<u32>,
    progress: &Progress,
    warn: &mut dyn FnMut(String),
) -> Result<(Scene, Option<u32>)> {
    let last = Level::HIGHEST;
    let mut frames = match Frames::open(input, args, last, warn)? {
        Frames::Scene(scene) => return Ok((*scene, None)),
        stream @ Frames::Stream { .. } => stream,
    };
    let starts = match &frames {
        Frames::Scene(_) => Vec::new(),
        Frames::Stream { received, .. } => decoded::epoch_starts(received.content().manifest),
    };
    let mut shown = Vec::new();
    let mut left_out = LeftOut::default();
    // One that is not there is refused by its number later.
    let only = only.filter(|only| *only < frames.count());
    let decoded = only.map_or(0..frames.count(), |only| only..only + 1);
    for frame in decoded.clone() {
        progress.step("decoding", (frame - decoded.start) as usize, decoded.len());
        let instant = frames.instant(frame)?;
        let snapshot = decoded::snapshot(&instant)?;
        let count = instant.gaussians.len();
        left_out.add(count - snapshot.rows.len(), count);
        shown.push(snapshot);
    }
    let mut scene = decoded::joined(shown, &starts, frames.frames_per_second())?;
    scene.up = frames.up();
    scene.footprint = frames.footprint();
    scene.notes = frames.notes().to_vec();
    scene.notes.extend(left_out.sentence(&frames));
    Ok((scene, only.map(|_| frames.count())))
}

/// The scene with what is typed done to it, in the order of the help.
fn edited(
    args: &Convert,
    mut scene: Scene,
    progress: &Progress,
    warnings: &mut Vec<String>,
) -> Result<Scene> {
    if let Some(range) = args.frames {
        let range = range.within(scene.frames() as u32)?;
        scene = edit::frames(&scene, range.start as usize, range.end as usize - 1)?;
    }
    if !args.merge.is_empty() {
        scene.notes.iter_mut().for_each(|note| *note = note_of(&args.input, note));
    }
    // What these say of the input is not so of other files.
    let as_written =
        SceneArgs { up: None, clip: None, footprint: None, identity_stored: false, ..args.scene.clone() };
    for other in &args.merge {
        let (mut other_scene, _) =
            read(other, &as_written, None, progress, &mut |w| warnings.push(w)).context("--merge")?;
        // The option is of the input.
        let said = |note: &str| note_of(other, note.trim_end_matches(UP_HINT));
        other_scene.notes.iter_mut().for_each(|note| *note = said(note));
        let turn = turn_between(other_scene.up, scene.up);
        let other_scene =
            edit::transform(&other_scene, &Similarity { rotation: turn, ..Similarity::default() })?;
        scene = edit::merged(&scene, &other_scene).with_context(|| format!("--merge {other}"))?;
    }
    if let Some(bounds) = &args.crop {
        scene = edit::crop(&scene, bounds)?;
    }
    for condition in &args.filter {
        scene = edit::filter(&scene, condition)?;
    }
    if let Some(share) = args.decimate {
        let mut heard = |done: f64| progress.stage("decimating", EDITING + (DECIMATED - EDITING) * done);
        scene = edit::decimate(&scene, share, &mut heard)?;
    }
    if let Some(by) = &args.transform {
        // What was up stays up in the numbers that follow: a turn is meant to be seen.
        let up = scene.up;
        scene = edit::transform(&scene, by)?;
        scene.up = up;
    }
    if let Some(degree) = args.sh_degree.and_then(ShDegree::new) {
        scene = edit::sh_degree(&scene, degree)?;
    }
    Ok(scene)
}

/// The scene with `up` up, and what was done for that.
fn turned(args: &Convert, scene: Scene, up: Up) -> Result<(Scene, String)> {
    let from = scene.up;
    if args.keep_axes {
        return Ok((scene, format!("axes are kept, with {from} up")));
    }
    if from == up {
        return Ok((scene, format!("axes are kept: {from} is up, as usual in the format")));
    }
    let rotation = turn_between(from, up);
    let scene = edit::transform(&scene, &Similarity { rotation, ..Similarity::default() })?;
    Ok((scene, format!("turned: {from} was up, {up} is, as usual in the format")))
}
