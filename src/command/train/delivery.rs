//! Fine-tunes a scene for what delivery leaves of it: `dgs train --delivery`.

use std::ops::ControlFlow;

use anyhow::{Context, Result, bail};
use serde_json::json;
use trainer_host::{
    Scene,
    encode::{Encoded, Protection, write},
    train::{
        self, Dataset,
        delivery::{DeliveryOptions, Record, Reference, fine_tune},
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

/// Refuses before the training what would end it afterwards.
pub(super) fn check(args: &Train, dataset: &Dataset, options: &DeliveryOptions) -> Result<()> {
    if let Some(path) = options.recorded.as_deref().filter(|path| !path.is_file()) {
        bail!("recorded: {}: no such file", path.display());
    }
    let found = dataset.train.photographs().len().min(args.references);
    let needed = if options.validation.candidates == 0 { 1 } else { options.validation.every };
    if found < needed {
        bail!("{found} training views; at least {needed}, one of them for validation, are needed");
    }
    Ok(())
}

/// What is typed of a training, and means nothing where the scene is there already.
fn unused(args: &Train) -> Vec<&'static str> {
    let of_training = [
        ("--steps", args.steps.is_some()),
        ("--minutes", args.minutes.is_some()),
        ("--gaussians", args.gaussians.is_some()),
        ("--nodes", args.nodes.is_some()),
        ("--sh-degree", args.sh_degree.is_some()),
        ("--density", args.density.is_some()),
        ("--rigidity", args.rigidity.is_some()),
        ("--canonical-time", args.canonical_time.is_some()),
        ("--options", args.options.is_some()),
    ];
    of_training.into_iter().filter(|(_, typed)| *typed).map(|(name, _)| name).collect()
}

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
    let (tuned, record) = fine_tuned(args, folder, scene, (dataset, background), options, stop, quiet)?;
    let updates = record.objective.len();
    let interrupted = updates < options.updates;
    let bytes = tuned.stream.to_bytes()?;
    files::write(&folder.stream, &bytes)?;
    let before = train::evaluate(&decoded(&plain)?, &dataset.test, 1, background)?;
    let after = train::evaluate(&decoded(&tuned)?, &dataset.test, 1, background)?;
    let text = format!(
        "{}: fine-tuned for delivery{}\n{}{}{}  {} bytes, in {}\n",
        args.input,
        if interrupted { ", interrupted" } else { "" },
        outcome(&record, options),
        figure("held-out views, all packets, before", &before),
        figure("held-out views, all packets, fine-tuned", &after),
        bytes.len(),
        folder.stream.display()
    );
    let mut notes = Vec::new();
    let unused = unused(args);
    if !unused.is_empty() {
        let named = unused.join(", ");
        notes.push(format!("{}: is a scene; not used, being for training one: {named}", args.input));
    }
    let text = notes.iter().fold(text, |text, note| text + &format!("  note: {note}\n"));
    let json = json!({
        "input": args.input,
        "notes": notes,
        "updates": updates,
        "taken": record.before_and_taken().map(|(_, taken)| taken.updates),
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
) -> Result<(Encoded, Record)> {
    let options = DeliveryOptions {
        seed: args.scene.seed.unwrap_or(options.seed),
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
    Ok((stream, tuned.record))
}

/// What came of it, for people: which updates were taken, and what that gives where packets are lost.
pub(super) fn outcome(record: &Record, options: &DeliveryOptions) -> String {
    let mut text = format!(
        "  {} of {} updates for delivery, {}\n",
        record.objective.len(),
        options.updates,
        options.variant.name()
    );
    let Some((before, taken)) = record.before_and_taken() else { return text };
    if taken.updates == 0 {
        text += "  none of them was better where packets are lost: the scene is as it was given\n";
        return text;
    }
    text += &format!(
        "  taken after update {}: with lost packets, worst tenth {:.2} → {:.2} dB; with all of them {:.2} → \
         {:.2} dB; {} → {} bytes on the wire\n",
        taken.updates,
        before.p10_db,
        taken.p10_db,
        before.clean_db,
        taken.clean_db,
        before.wire_bytes,
        taken.wire_bytes
    );
    text
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
