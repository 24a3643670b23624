//! Fine-tunes a scene for what delivery leaves of it: `dgs train --delivery`.

use std::{cell::RefCell, ops::ControlFlow};

use anyhow::{Context, Result, bail};
use serde_json::json;
use trainer_host::{
    Scene,
    encode::{Encoded, Protection, write},
    train::{
        self, Dataset,
        delivery::{DeliveryError, DeliveryOptions, Record, Recording, Reference, Tuning, resume},
    },
};

use super::{
    encoding::encoded,
    figures::{decoded, figure},
    folder::Folder,
    interruption::Interruption,
    training::options as typed,
};
use crate::{
    args::train::Train,
    files,
    output::VerbOutput,
    pipeline::{self, Quiet},
    progress::Progress,
};

/// Most updates between two checkpoints: each takes as long as many steps of a training.
const CHECKPOINT_EVERY: usize = 20;
/// Background of the pictures of a scene where nothing is said.
const BACKGROUND: [f32; 3] = [0.0; 3];

/// The options that `config` names or that its file holds.
pub(super) fn read(config: &str) -> Result<DeliveryOptions> {
    DeliveryOptions::read(config).map_err(|error| {
        let context = match error {
            DeliveryError::File { .. } => {
                "--delivery: reconstruction, iid, burst-cvar, mixed, or a JSON file is allowed".to_owned()
            }
            DeliveryError::Content { .. } => "--delivery".to_owned(),
            // What is wrong with a value does not say where it stands.
            _ => format!("--delivery {config}"),
        };
        anyhow::Error::from(error).context(context)
    })
}

/// Refuses before the training what would end it afterwards; `is_there` says whether the scene is there
/// already.
pub(super) fn check(
    args: &Train,
    dataset: &Dataset,
    options: &DeliveryOptions,
    is_there: bool,
) -> Result<()> {
    if options.recorded.is_some() && !is_there {
        let (input, out) = (&args.input, args.out.display());
        bail!(
            "recorded: names states of a stream, and {input} is not trained yet: train without --delivery, \
             then dgs encode {out}/checkpoint.dgst -o ck.dgs, dgs stream ck.dgs --states FILE, and dgs train \
             {input} -o {out} --resume --delivery CONFIG"
        );
    }
    options.recorded.as_deref().map(Recording::read).transpose().context("recorded")?;
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
    let pictures = (dataset, background, typed(args)?.max_side);
    let (tuned, record) = fine_tuned(args, folder, scene, pictures, options, stop, quiet)?;
    let updates = record.objective.len();
    let interrupted = updates < options.updates;
    let bytes = tuned.stream.to_bytes()?;
    files::write(&folder.stream, &bytes)?;
    let before = train::evaluate(&decoded(&plain)?, &dataset.test, 1, background)?;
    let after = train::evaluate(&decoded(&tuned)?, &dataset.test, 1, background)?;
    let text = format!(
        "{}: fine-tuned for delivery{}\n{}{}{}  {} bytes, in {}\n",
        args.input,
        if interrupted { ", interrupted: --resume goes on" } else { "" },
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

/// The stream of `scene`, fine-tuned towards training views over a background, no side longer than the third
/// says, until a person asks to stop; and how many updates were made.
pub(super) fn fine_tuned(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    (dataset, background, max_side): (&Dataset, [f32; 3], u32),
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
    let references = references(dataset, scene, (args.references, max_side), background)?;
    let begun = begun(args, folder)?;
    let every = CHECKPOINT_EVERY.min(args.checkpoint_every as usize);
    let unsaved = RefCell::new(None);
    let bar = Progress::new("fine-tune for delivery", quiet.0);
    let tuned = resume(scene, &references, &options, begun, &|update, tuning| {
        bar.at(update.updates as f64 / update.of.max(1) as f64);
        let interrupted = stop.take();
        let is_due = interrupted || update.updates == update.of || update.updates.is_multiple_of(every);
        if is_due && let Err(error) = save(folder, tuning) {
            unsaved.replace(Some(error));
            return ControlFlow::Break(());
        }
        if interrupted { ControlFlow::Break(()) } else { ControlFlow::Continue(()) }
    });
    drop(bar);
    if let Some(error) = unsaved.into_inner() {
        return Err(error);
    }
    let tuned = tuned.map_err(|error| match error {
        DeliveryError::Resumed { .. } => {
            let path = folder.tuning.display();
            anyhow::Error::from(error).context(format!("{path}: without this file it begins anew"))
        }
        error => error.into(),
    })?;
    files::write(&folder.delivery, serde_json::to_string_pretty(&tuned.record)?.as_bytes())?;
    let progress = |_: &'static str, _: f64| {
        stop.leave("delivery.json is whole; the stream is not there");
        ControlFlow::Continue(())
    };
    let stream = write(&tuned.scene, &tuned.decisions, &progress)?;
    Ok((stream, tuned.record))
}

fn save(folder: &Folder, tuning: &Tuning) -> Result<()> {
    files::write(&folder.tuning, &tuning.to_bytes()?)
}

/// The fine-tuning to go on with, if there is one.
fn begun(args: &Train, folder: &Folder) -> Result<Option<Tuning>> {
    let path = &folder.tuning;
    if !args.resume || !path.is_file() {
        return Ok(None);
    }
    let failed = || path.display().to_string();
    Ok(Some(Tuning::from_bytes(&std::fs::read(path).with_context(failed)?).with_context(failed)?))
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

/// Up to `count` training views as pictures of frames over `background`, evenly spread; no side of them is
/// longer than `max_side` pixels.
fn references(
    dataset: &Dataset,
    scene: &Scene,
    (count, max_side): (usize, u32),
    background: [f32; 3],
) -> Result<Vec<Reference>> {
    let views = dataset.train.sample(count);
    let reference = |view: &train::PosedPhotograph| {
        let (shortest, longest) = {
            let (width, height) = (view.camera.width(), view.camera.height());
            (width.min(height), width.max(height))
        };
        // By a whole number, as photographs are reduced; one that leaves something of the shorter side.
        let by = (shortest / 400).max(longest.div_ceil(max_side)).clamp(1, shortest);
        Reference::of_photograph(view, scene, by, background).context("--references")
    };
    views.photographs().iter().map(reference).collect()
}
