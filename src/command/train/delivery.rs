//! Fine-tunes a scene for what delivery leaves of it: `dgs train --delivery`.

use anyhow::{Context, Result};
use serde_json::json;
use trainer_host::{
    Scene,
    encode::{self, Encoded, Protection},
    train::{
        self, Dataset,
        delivery::{DeliveryOptions, Reference, fine_tune},
    },
};

use super::{
    figures::{decoded, figure},
    folder::Folder,
};
use crate::{
    args::train::Train,
    files,
    output::VerbOutput,
    pipeline::{self, Quiet},
    progress::Progress,
};

/// Background of the pictures that fine-tuning compares.
const BACKGROUND: [f32; 3] = [0.0; 3];

/// Runs the verb on a scene that is there.
pub(super) fn run(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    dataset: &Dataset,
    options: &DeliveryOptions,
    quiet: Quiet,
) -> Result<VerbOutput> {
    let encode = pipeline::encode_options(&args.codec, Protection::NONE);
    let plain = pipeline::encode(scene, &encode, quiet)?;
    let tuned = fine_tuned(args, folder, scene, dataset, options, quiet)?;
    let bytes = tuned.stream.to_bytes()?;
    files::write(&folder.stream, &bytes)?;
    let before = train::evaluate(&decoded(&plain, dataset)?, &dataset.test, 1, BACKGROUND)?;
    let after = train::evaluate(&decoded(&tuned, dataset)?, &dataset.test, 1, BACKGROUND)?;
    let text = format!(
        "{}: fine-tuned by {} updates, {}\n{}{}  {} bytes, in {}\n",
        args.input,
        options.updates,
        options.variant.name(),
        figure("held-out views, all packets, before", &before),
        figure("held-out views, all packets, fine-tuned", &after),
        bytes.len(),
        folder.stream.display()
    );
    let json = json!({
        "input": args.input,
        "before": before,
        "fine_tuned": after,
        "bytes": bytes.len(),
        "stream": folder.stream,
        "registration": folder.registration,
        "delivery": folder.delivery,
    });
    Ok(VerbOutput { text, json, ..VerbOutput::default() })
}

/// The stream of `scene`, fine-tuned towards the training views of `dataset`.
pub(super) fn fine_tuned(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    dataset: &Dataset,
    options: &DeliveryOptions,
    quiet: Quiet,
) -> Result<Encoded> {
    let options = DeliveryOptions {
        seed: args.scene.seed,
        registration: Some(folder.registration.clone()),
        encode: pipeline::encode_options(&args.codec, Protection::NONE),
        ..options.clone()
    };
    let references = references(dataset, scene.frames(), args.references)?;
    let bar = Progress::new("fine-tune for delivery", quiet.0);
    let tuned = fine_tune(scene, &references, &options, &|update| {
        bar.at(update.updates as f64 / update.of.max(1) as f64);
    })?;
    drop(bar);
    files::write(&folder.delivery, serde_json::to_string_pretty(&tuned.record)?.as_bytes())?;
    Ok(encode::write(&tuned.scene, &tuned.decisions, &|_, _| {})?)
}

/// Up to `count` training views as pictures of frames, evenly spread.
fn references(dataset: &Dataset, frames: usize, count: usize) -> Result<Vec<Reference>> {
    let views = dataset.train.sample(count);
    let last = frames.saturating_sub(1) as f64;
    let reference = |view: &train::PosedPhotograph| {
        let by = (view.camera.width().min(view.camera.height()) / 400).max(1);
        let (width, height) = (view.camera.width() / by, view.camera.height() / by);
        let picture = view.photograph.over(BACKGROUND).resized_box(width, height)?;
        let camera = view.camera.resized(width, height).context("--references")?;
        Ok(Reference { frame: (f64::from(view.time) * last).round() as u32, camera, picture })
    };
    views.photographs().iter().map(reference).collect()
}
