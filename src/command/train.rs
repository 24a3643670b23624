//! `dgs train`: photographs, or the renders of a scene, to a moving scene and its stream.

mod delivery;
mod encoder_options;
mod encoding;
mod epochs;
mod figures;
mod finishing;
mod folder;
mod input;
mod interruption;
mod log;
mod page;
mod trained;
mod training;
mod utility;

use anyhow::{Context, Result, bail};
use render_host::{Backend, metric::Lpips};
use serde_json::json;
use trainer_host::{
    Scene,
    train::{self, Checkpoint, Dataset, DynamicScene, Test, Views, delivery::DeliveryOptions},
};

use self::{
    delivery::Pictures,
    encoder_options::{EncoderOptions, Rounded},
    encoding::{Written, check_size, steps_are_typed, within_loss},
    epochs::Plan,
    figures::{Figure, decoded, lpips},
    finishing::Finished,
    folder::Folder,
    input::Input,
    interruption::Interruption,
    log::Log,
    page::{Ended, Page},
    trained::Trained,
    training::{GLANCE_VIEWS, begin, check_length, fit, options, resumed},
};
use crate::{
    args::train::{REFERENCES, Train},
    figures::Machine,
    files,
    output::VerbOutput,
    pipeline::{self, Quiet},
    progress::Progress,
};

/// What is left where a person leaves before the scene is encoded, and after.
const TRAINED: &str = "the checkpoint is whole; --resume encodes it";
const ENCODED: &str = "checkpoint and stream are whole; the report is not there";
/// What a person hears whose wish to stop was heard, before work that may take minutes.
const STOPPED: &str =
    "interrupted: the checkpoint is whole; its stream and report follow, or not if interrupted again";

/// Shortest side of pictures that are still worth a figure, pixels.
const MIN_SIDE: u32 = 32;

/// Runs the verb.
pub fn run(args: &Train, quiet: Quiet) -> Result<VerbOutput> {
    let delivery = args.delivery.as_deref().map(delivery::read).transpose()?;
    let typed = options(args)?;
    typed.validate()?;
    let folder = Folder::of(&args.out);
    folder.check(args)?;
    let resumed = resumed(args, &folder)?;
    let max_side = resumed.as_ref().map_or(typed.max_side, |checkpoint| checkpoint.options().max_side);
    let backend = Backend::open(args.device.into()).context("--device")?;
    let loading = Progress::new("read the dataset", quiet.0);
    let mut input = Input::load(args, max_side, resumed.as_ref())?;
    drop(loading);
    if args.delivery.is_none() && args.references != REFERENCES {
        input.notes.push("not used, being for --delivery: --references".to_owned());
    }
    let unused = args.codec.unused();
    if !unused.is_empty() {
        input.notes.push(format!("not used, being for --profile dgs1: {}", unused.join(", ")));
    }
    let mut output = train(args, &input, resumed, delivery.as_ref(), &backend, quiet)?;
    if let Some(bytes) = Machine::peak_memory_bytes("self") {
        output.text += &format!("  peak memory {:.0} MB\n", bytes as f64 / 1e6);
        output.json["peak_memory_bytes"] = json!(bytes);
    }
    Ok(VerbOutput { damaged: input.damaged || output.damaged, ..output })
}

fn train(
    args: &Train,
    input: &Input,
    resumed: Option<Checkpoint>,
    delivery: Option<&DeliveryOptions>,
    backend: &Backend,
    quiet: Quiet,
) -> Result<VerbOutput> {
    let Input { scene, dataset, .. } = input;
    let folder = Folder::of(&args.out);
    if scene.is_some() && delivery.is_some() && (args.utility || args.lpips.is_some()) {
        bail!(
            "--utility, --lpips: for trained photographs; fine-tuning a scene for delivery measures neither"
        );
    }
    let network = args.lpips.as_deref().map(lpips).transpose()?;
    if network.is_some() {
        check_sides(dataset)?;
    }
    let is_there = scene.is_some() || resumed.as_ref().is_some_and(|checkpoint| checkpoint.progress() >= 1.0);
    let frames = scene.as_ref().map_or(args.frames.unwrap_or(dataset.frames), Scene::frames);
    let check = |options| delivery::check(args, dataset, options, (frames, is_there));
    let of_delivery = delivery.map(check).transpose().context("--delivery")?.flatten();
    if scene.is_some() && delivery.is_some() && args.resume && !folder.has_fine_tuning() {
        bail!(
            "--delivery: fine-tunes {} as it is, not what {} holds of its training; the checkpoint of that \
             is a scene to fine-tune, into another --out",
            args.input,
            args.out.display()
        );
    }
    let begun = if args.resume { Plan::begun(&folder)? } else { None };
    if let (None, Some(plan)) = (&resumed, &begun) {
        plan.check_frames(args)?;
    }
    let trained_for = match (&resumed, &begun) {
        (Some(checkpoint), _) => checkpoint.options().finish.target_bytes,
        (None, Some(plan)) => plan.target_bytes(args),
        (None, None) => options(args)?.finish.target_bytes,
    };
    let begun_at = match (&resumed, &begun) {
        (Some(checkpoint), _) => Some(checkpoint.frames_per_second),
        (None, Some(plan)) => plan.frames_per_second,
        (None, None) => None,
    };
    let rate = input.frames_per_second(args, begun_at);
    // A scene that is there is encoded before it is fine-tuned.
    if scene.is_none() || delivery.is_none() {
        check_size(args, trained_for, (args.frames.unwrap_or(dataset.frames), rate))?;
    }
    let opened = folder.open(args)?;
    let stop = Interruption::watch();
    if let (Some(scene), Some(options)) = (scene, delivery) {
        let notes: Vec<String> = input.notes.iter().cloned().chain(of_delivery).collect();
        let known = (dataset, notes.as_slice());
        return delivery::run(args, &folder, scene, known, (options, backend), &stop, quiet);
    }
    let rounded = match (&resumed, &begun) {
        // A fine-tuning encodes anew.
        _ if steps_are_typed(args) || delivery.is_some() => Rounded::Nothing,
        (Some(checkpoint), _) if checkpoint.has_rounded() => Rounded::All,
        (None, Some(plan)) => plan.rounded(args)?,
        (Some(_), _) | (None, None) => Rounded::Nothing,
    };
    let encoder = EncoderOptions::of(args, trained_for);
    let (encoder, changes) = encoder.taken_up(&folder.encoder, args.resume, rounded, dataset.frames)?;
    let with = (delivery.map(|options| (options, backend)), &encoder, network.as_ref());
    let plan = match scene {
        Some(scene) => Plan::of(args, (&folder, &opened), scene, (dataset, rate), &stop, quiet)?,
        None => None,
    };
    let parted = plan.as_ref().filter(|plan| plan.is_parted());
    let mut output = if let (Some(plan), Some(scene)) = (parted, scene) {
        let Some((trained, mut log, ended)) = plan.train(args, scene, (dataset, rate), &stop, quiet)? else {
            return Ok(left(args, plan));
        };
        files::write(&folder.log, log.csv().as_bytes())?;
        log.notes.extend_from_slice(&input.notes);
        log.notes.extend(changes);
        let with = (None, with.1, with.2);
        let mut output = finish(args, &folder, dataset, (&trained, &log, ended), with, &stop, quiet)?;
        output.json["checkpoint"] = plan.checkpoints(args).iter().map(|path| files::shown(path)).collect();
        output
    } else {
        if args.resume && resumed.is_none() {
            bail!("{}: no such checkpoint; train without --resume first", folder.checkpoint.display());
        }
        let (mut trainer, begun) = begin((args, rate), &folder, resumed, &options(args)?, dataset, backend)?;
        check_length(args, trainer.steps(), begun)?;
        let mut log = if args.resume { Log::resumed(&folder.log, trainer.steps())? } else { Log::default() };
        log.notes.extend_from_slice(&input.notes);
        log.notes.extend(changes);
        log.notes.extend(of_delivery);
        log.notes.extend(delivery.and_then(delivery::tail_in_words));
        let ended = fit(args, &folder, dataset, &mut trainer, begun, &mut log, &stop, quiet)?;
        let trained = Trained::of(&trainer, dataset, args)?;
        finish(args, &folder, dataset, (&trained, &log, ended), with, &stop, quiet)?
    };
    if let Some(plan) = &plan {
        output.text += &plan.text();
    }
    output.json["epochs"] = json!(plan.map(|plan| plan.parts));
    output.json["device"] = json!(backend.name());
    Ok(output)
}

/// What the verb says where a person left before every epoch was trained.
fn left(args: &Train, plan: &Plan) -> VerbOutput {
    let text = format!("{}: interrupted: --resume goes on\n{}", args.input, plan.text());
    let json = json!({ "input": args.input, "interrupted": true, "epochs": plan.parts });
    VerbOutput { text, json, damaged: true, ..VerbOutput::default() }
}

/// Encodes the scene, measures it, and writes the pages.
#[allow(clippy::too_many_arguments, reason = "each is another thing that is written")]
fn finish(
    args: &Train,
    folder: &Folder,
    dataset: &Dataset,
    (trained, log, mut ended): (&Trained, &Log, Ended),
    (delivery, encoder, network): (Option<(&DeliveryOptions, &Backend)>, &EncoderOptions, Option<&Lpips>),
    stop: &Interruption,
    quiet: Quiet,
) -> Result<VerbOutput> {
    if ended.interrupted {
        eprintln!("{STOPPED}");
    }
    let (mut tuning, mut section) = (None, None);
    let mut is_short = false;
    let written = match delivery.filter(|_| !ended.interrupted) {
        Some((options, backend)) => {
            let (background, max_side) = (trained.options.background, trained.options.max_side);
            let references = Pictures { dataset, background, max_side, trained: Some(trained) };
            let with = (options, backend);
            let sized = &with_size(args, trained);
            let tuned = delivery::fine_tuned(sized, folder, &trained.scene, references, with, stop, quiet)?;
            is_short = tuned.record.objective.len() < options.updates;
            ended.interrupted |= is_short && tuned.record.stopped.is_none();
            let mut written = Written::plainly(tuned.encoded);
            written.notes = tuned.notes;
            tuning = Some((options, tuned.record, tuned.choice));
            section = Some(tuned.section);
            written
        }
        None => within_loss(args, dataset, trained, stop, TRAINED, quiet).context(TRAINED)?,
    };
    let Written { encoded: written, lost_db, mut notes } = written;
    let bytes = written.stream.to_bytes()?;
    notes.extend(EncoderOptions::replaced(args, folder, &bytes));
    files::write(&folder.stream, &bytes)?;
    encoder.write(&folder.encoder)?;

    let figures = measured(dataset, trained, &decoded(&written)?, network, stop, quiet)?;
    let audits = if args.utility {
        stop.leave_at_once(ENCODED);
        let (audits, table) = utility::audits(&written.stream, dataset, trained, &folder.utility, quiet)?;
        if let Some(table) = table {
            files::write(&folder.stream, &pipeline::file_by_utility(&written.stream, &table)?)?;
        }
        audits
    } else {
        Vec::new()
    };

    let delivery = section.as_deref();
    let page = Page { dataset, trained, log, figures: &figures, bytes: bytes.len(), ended: &ended, delivery };
    let preview = page.preview()?;
    files::write(&folder.preview, &preview.to_png()?)?;
    files::write(&folder.report, page.html()?.as_bytes())?;
    let sizes = (bytes.len(), written.stream.wire_bytes());
    let mut output = said(args, folder, trained, log, &figures, sizes, &ended);
    let finished = Finished::of(trained, &written);
    output.text += &finished.text();
    output.json["finishing"] = json!(finished);
    output.json["encoding_loss_db"] = json!(lost_db);
    output.warnings.extend(notes);
    output.warnings.extend(log.fall().map(|(best, last)| {
        format!(
            "{}: pictures were {best:.1} dB close during the training and are {last:.1} dB at its end: lower \
             the rates (--options)",
            args.input
        )
    }));
    if let Some((options, record, choice)) = tuning {
        output.text += &delivery::outcome(&record, options, choice.as_ref());
        output.json["rank"] = json!(choice);
        output.json["updates"] = json!(record.objective.len());
        output.damaged |= is_short;
        output.json["stopped"] = json!(record.stopped);
        output.json["taken"] = json!(record.before_and_taken().map(|(_, taken)| taken.updates));
        output.json["registration"] = json!(files::shown(&folder.registration));
        output.json["delivery"] = json!(files::shown(&folder.delivery));
        output.json["delivery_log"] = json!(files::shown(&folder.delivery_log));
    }
    for audit in &audits {
        output.text += &audit.text();
    }
    output.json["utility"] = json!(audits);
    Ok(output)
}

/// Refuses test views that are too small for LPIPS, before they are trained for.
fn check_sides(dataset: &Dataset) -> Result<()> {
    let sides = dataset.test.photographs().iter().map(|view| view.camera.width().min(view.camera.height()));
    match sides.min().map(|side| side / dataset.test_scale) {
        Some(side) if side < Lpips::SMALLEST_SIDE => bail!(
            "--lpips: test views are {side} pixels at their shortest; {} are needed",
            Lpips::SMALLEST_SIDE
        ),
        _ => Ok(()),
    }
}

/// `args` with the size that a scene was `trained` for, unless a size or steps were typed.
fn with_size(args: &Train, trained: &Trained) -> Train {
    let mut args = args.clone();
    let bytes = trained.options.finish.target_bytes;
    if bytes > 0 && !steps_are_typed(&args) {
        args.codec.target_bytes.get_or_insert(bytes);
    }
    args
}

/// How close the pictures of what was `trained` are to photographs, before and after encoding, at several
/// sizes; between two of them a person may leave.
fn measured(
    dataset: &Dataset,
    trained: &Trained,
    decoded: &dyn DynamicScene,
    network: Option<&Lpips>,
    stop: &Interruption,
    quiet: Quiet,
) -> Result<Vec<Figure>> {
    let (reduced, of_test) = (trained.reduced, trained.reduced * dataset.test_scale);
    let plain = trained.options.background;
    let other = plain.map(|v| 1.0 - v);
    let mut figures: Vec<Figure> = Vec::new();
    let measuring = Progress::new("measure the result", quiet.0);
    let mut measure = |what: &str, scene: &dyn DynamicScene, background: [f32; 3]| -> Result<()> {
        stop.leave(ENCODED);
        measuring.stage(&format!("measure {what}"), 0.1 + 0.2 * figures.len() as f64);
        if !dataset.test.is_empty() {
            let found = train::evaluate(scene, &dataset.test, of_test, background)?;
            let seen = train::perceptual(scene, &dataset.test, of_test, background, network)?;
            figures.push(Figure { what: what.to_owned(), found, seen: Some(seen) });
        }
        Ok(())
    };
    let shown = trained.shown();
    measure("test views, as trained", &shown, plain)?;
    measure("test views, as decoded from scene.dgs", decoded, plain)?;
    if dataset.has_alpha {
        measure("test views, as trained, opposite background", &shown, other)?;
    }
    // A window has the size that a person gives it.
    for (what, reduced) in [
        ("at half the size", 2 * of_test),
        ("at twice the size", if of_test.is_multiple_of(2) { of_test / 2 } else { 0 }),
    ] {
        if is_size(&dataset.test, reduced) {
            stop.leave(ENCODED);
            let what = format!("test views, as decoded, {what}");
            measuring.stage(&format!("measure {what}"), 0.8);
            let found = train::evaluate(decoded, &dataset.test, reduced, plain)?;
            figures.push(Figure { what, found, seen: None });
        }
    }
    let seen = dataset.train.sample(dataset.test.photographs().len().max(GLANCE_VIEWS));
    figures.push(Figure {
        what: training_views(seen.photographs().len(), dataset.train.photographs().len()),
        found: train::evaluate(&shown, &seen, reduced, plain)?,
        seen: None,
    });
    Ok(figures)
}

/// The title of the figure of `count` training views of `all`.
fn training_views(count: usize, all: usize) -> String {
    let share = if count < all { format!(" ({count} of {all})") } else { String::new() };
    format!("training views{share}, as trained")
}

/// Whether there are views, and pictures of all of them can be `reduced` times smaller.
fn is_size(views: &Views<Test>, reduced: u32) -> bool {
    let fits = |side: u32| side.is_multiple_of(reduced) && side / reduced >= MIN_SIDE;
    let photographs = views.photographs();
    reduced > 0
        && !photographs.is_empty()
        && photographs.iter().all(|view| fits(view.camera.width()) && fits(view.camera.height()))
}

/// What the verb says.
#[allow(clippy::too_many_arguments, reason = "each is a figure that is said")]
fn said(
    args: &Train,
    folder: &Folder,
    trained: &Trained,
    log: &Log,
    figures: &[Figure],
    (bytes, wire_bytes): (usize, usize),
    ended: &Ended,
) -> VerbOutput {
    let frames = trained.scene.frames();
    let mut text = format!(
        "{}: {} steps, {:.1} min, {} Gaussians, {} nodes{}\n",
        args.input,
        trained.steps,
        ended.seconds / 60.0,
        trained.gaussians,
        trained.nodes,
        if ended.interrupted { ", interrupted: --resume goes on" } else { "" },
    );
    for figure in figures {
        text += &figure.line();
    }
    if args.lpips.is_none() {
        text += "  LPIPS: no weights given\n";
    }
    text += &format!(
        "  {bytes} bytes, {wire_bytes} on the wire, {frames} frames, in {}\n{}\n",
        folder.stream.display(),
        folder.report.display()
    );
    let json = json!({
        "input": args.input,
        "steps": trained.steps,
        "seconds": ended.seconds,
        "interrupted": ended.interrupted,
        "gaussians": trained.gaussians,
        "nodes": trained.nodes,
        "options": trained.options,
        "figures": figures,
        "stream": files::shown(&folder.stream),
        "bytes": bytes,
        "wire_bytes": wire_bytes,
        "frames": frames,
        "checkpoint": files::shown(&folder.checkpoint),
        "log": files::shown(&folder.log),
        "report": files::shown(&folder.report),
        "notes": log.notes,
    });
    VerbOutput { text, json, warnings: log.notes.clone(), damaged: ended.interrupted }
}

/// What `dgs train` is asked for by these arguments.
#[cfg(test)]
fn parsed<'a>(args: impl IntoIterator<Item = &'a str>) -> Train {
    #[derive(Debug, clap::Parser)]
    struct Typed {
        #[command(flatten)]
        train: Train,
    }
    let all = ["train"].into_iter().chain(args);
    <Typed as clap::Parser>::try_parse_from(all).unwrap_or_else(|error| panic!("{error}")).train
}
