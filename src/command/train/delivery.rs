//! Fine-tunes a scene for what delivery leaves of it: `dgs train --delivery`.

use std::ops::ControlFlow;

use anyhow::{Context, Result};
use serde_json::json;
use trainer_host::{
    Scene,
    encode::{Encoded, Protection, write},
    train::{
        self, Dataset,
        delivery::{DeliveryOptions, Reference, fine_tune},
    },
};

use super::{
    encoding::encoded,
    figures::{decoded, figure},
    folder::Folder,
    interruption::Interruption,
};
use crate::{
    args::train::Train,
    files,
    output::VerbOutput,
    pipeline::{self, Quiet},
    progress::Progress,
};

/// Background of the pictures of a scene where nothing is said.
const BACKGROUND: [f32; 3] = [0.0; 3];

/// Runs the verb on a scene that is there.
pub(super) fn run(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    dataset: &Dataset,
    options: &DeliveryOptions,
    stop: &Interruption,
    quiet: Quiet,
) -> Result<VerbOutput> {
    let background = args.background.unwrap_or(BACKGROUND);
    let plain = encoded(args, scene, stop, "nothing was written", quiet)?;
    let (tuned, updates) = fine_tuned(args, folder, scene, (dataset, background), options, stop, quiet)?;
    let interrupted = updates < options.updates;
    let bytes = tuned.stream.to_bytes()?;
    files::write(&folder.stream, &bytes)?;
    let before = train::evaluate(&decoded(&plain)?, &dataset.test, 1, background)?;
    let after = train::evaluate(&decoded(&tuned)?, &dataset.test, 1, background)?;
    let text = format!(
        "{}: fine-tuned by {updates} updates, {}{}\n{}{}  {} bytes, in {}\n",
        args.input,
        options.variant.name(),
        if interrupted { ", interrupted" } else { "" },
        figure("held-out views, all packets, before", &before),
        figure("held-out views, all packets, fine-tuned", &after),
        bytes.len(),
        folder.stream.display()
    );
    let json = json!({
        "input": args.input,
        "updates": updates,
        "interrupted": interrupted,
        "before": before,
        "fine_tuned": after,
        "bytes": bytes.len(),
        "stream": files::shown(&folder.stream),
        "registration": files::shown(&folder.registration),
        "delivery": files::shown(&folder.delivery),
    });
    Ok(VerbOutput { text, json, damaged: interrupted, ..VerbOutput::default() })
}

/// The stream of `scene`, fine-tuned towards training views over a background until a person asks to stop;
/// and how many updates were made.
pub(super) fn fine_tuned(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    (dataset, background): (&Dataset, [f32; 3]),
    options: &DeliveryOptions,
    stop: &Interruption,
    quiet: Quiet,
) -> Result<(Encoded, usize)> {
    let options = DeliveryOptions {
        seed: args.scene.seed(),
        registration: Some(folder.registration.clone()),
        encode: pipeline::encode_options(&args.codec, Protection::NONE),
        ..options.clone()
    };
    let references = references(dataset, scene.frames(), args.references, background)?;
    let bar = Progress::new("fine-tune for delivery", quiet.0);
    let tuned = fine_tune(scene, &references, &options, &|update| {
        bar.at(update.updates as f64 / update.of.max(1) as f64);
        if stop.take() { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    })?;
    drop(bar);
    files::write(&folder.delivery, serde_json::to_string_pretty(&tuned.record)?.as_bytes())?;
    let progress = |_: &'static str, _: f64| {
        stop.leave("delivery.json is whole; the stream is not there");
        ControlFlow::Continue(())
    };
    let stream = write(&tuned.scene, &tuned.decisions, &progress)?;
    Ok((stream, tuned.record.objective.len()))
}

/// Up to `count` training views as pictures of frames over `background`, evenly spread.
fn references(
    dataset: &Dataset,
    frames: usize,
    count: usize,
    background: [f32; 3],
) -> Result<Vec<Reference>> {
    let views = dataset.train.sample(count);
    let last = frames.saturating_sub(1) as f64;
    let reference = |view: &train::PosedPhotograph| {
        let by = (view.camera.width().min(view.camera.height()) / 400).max(1);
        let (width, height) = (view.camera.width() / by, view.camera.height() / by);
        let picture = view.photograph.over(background).resized_box(width, height)?;
        let camera = view.camera.resized(width, height).context("--references")?;
        let frame = (f64::from(view.time) * last).round() as u32;
        Ok(Reference { frame, camera, background, picture })
    };
    views.photographs().iter().map(reference).collect()
}
