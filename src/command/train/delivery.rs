//! Fine-tunes a scene for what delivery leaves of it: `dgs train --delivery`.

mod damage;
mod log;
mod outcome;
mod page;
mod pictures;
mod rank;

use std::{cell::RefCell, io::IsTerminal as _, ops::ControlFlow, time::Instant as Clock};

use anyhow::{Context, Result, bail};
use render_host::Backend;
use serde_json::json;
use trainer_host::{
    Scene,
    encode::{Decisions, EncodeOptions, Encoded, Protection, write},
    train::{
        self, Dataset,
        delivery::{
            DeliveryError, DeliveryOptions, FineTuned, RankChoice, Record, Recording, Tuning, Update,
            Variant, resume,
        },
    },
};

use self::{
    damage::Damage,
    log::{DeliveryLog, line},
    pictures::References,
};
pub(super) use self::{outcome::outcome, pictures::Pictures};
use super::{
    figures::{decoded, figure},
    folder::Folder,
    interruption::Interruption,
    page::document,
    training::options as typed,
};
use crate::{
    args::train::{ENCODING_LOSS, EVALUATIONS, SPLIT, Train},
    files,
    output::VerbOutput,
    pipeline::{self, Quiet},
    progress::Progress,
};

/// Most updates between two checkpoints: each takes as long as many steps of a training.
const CHECKPOINT_EVERY: usize = 20;
/// Lines about a whole fine-tuning where no bar is shown.
const LINES: usize = 10;
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

/// Refuses before the training what would end it afterwards, of a clip of so many `frames`; `is_there` says
/// whether the scene is there already. Gives what a person should know.
pub(super) fn check(
    args: &Train,
    dataset: &Dataset,
    options: &DeliveryOptions,
    (frames, is_there): (usize, bool),
) -> Result<Option<String>> {
    if options.recorded.is_some() && !is_there {
        let (input, out) = (&args.input, args.out.display());
        bail!(
            "recorded: names states of a stream, and {input} is not trained yet: train without --delivery, \
             then dgs encode {out}/checkpoint.dgst -o ck.dgs, dgs stream ck.dgs --states FILE, and dgs train \
             {input} -o {out} --resume --delivery CONFIG"
        );
    }
    rank::check(args, options)?;
    options.recorded.as_deref().map(Recording::read).transpose().context("recorded")?;
    pictures::check(args, dataset, options, frames)
}

/// That the tail holds more than the fraction of worlds that `options` name, where that is less than one.
pub(super) fn tail_in_words(options: &DeliveryOptions) -> Option<String> {
    let counts = matches!(options.variant, Variant::BurstCvar | Variant::Combined);
    let (fraction, worlds) = (options.weights.cvar_fraction, options.worlds);
    let is_less = fraction * (worlds as f64) < 1.0;
    (counts && options.weights.cvar > 0.0 && is_less).then(|| {
        format!(
            "--delivery: weights.cvar_fraction is {fraction}, less than one of {worlds} worlds per update; \
             the tail is the worst world, 1/{worlds} of them"
        )
    })
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
        ("--frames", args.frames.is_some()),
        ("--split", args.split != SPLIT),
        ("--evaluations", args.evaluations != EVALUATIONS),
        ("--encoding-loss", args.encoding_loss != ENCODING_LOSS),
    ];
    of_training.into_iter().filter(|(_, typed)| *typed).map(|(name, _)| name).collect()
}

/// Runs the verb on a scene that is there, of which `said` is known; updates are made on the backend.
pub(super) fn run(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    (dataset, said): (&Dataset, &[String]),
    (options, backend): (&DeliveryOptions, &Backend),
    stop: &Interruption,
    quiet: Quiet,
) -> Result<VerbOutput> {
    let background = args.background.unwrap_or(BACKGROUND);
    let pictures = Pictures { dataset, background, max_side: typed(args)?.max_side, trained: None };
    let Tuned { encoded: tuned, given, record, section, choice, notes: of_tuning } =
        fine_tuned(args, folder, scene, pictures, (options, backend), stop, quiet)?;
    let updates = record.objective.len();
    let interrupted = updates < options.updates && record.stopped.is_none();
    let bytes = tuned.stream.to_bytes()?;
    files::write(&folder.stream, &bytes)?;
    let bar = Progress::new("encode, as given", quiet.0);
    let given =
        write(scene, &given, &|stage, share| bar.heard(&format!("encode, as given: {stage}"), share))?;
    drop(bar);
    let before = train::evaluate(&decoded(&given)?, &dataset.test, 1, background)?;
    let after = train::evaluate(&decoded(&tuned)?, &dataset.test, 1, background)?;
    let lead = format!("{} bytes as scene.dgs.", bytes.len());
    let page = document(&format!("Fine-tuning of {} for delivery", dataset.name), &lead, &section);
    files::write(&folder.report, page.as_bytes())?;
    let text = format!(
        "{}: fine-tuned for delivery{}\n{}{}{}  {} bytes, in {}\n{}\n",
        args.input,
        if interrupted { ", interrupted: --resume goes on" } else { "" },
        outcome(&record, options, choice.as_ref()),
        figure("held-out views, all packets, before", &before),
        figure("held-out views, all packets, fine-tuned", &after),
        bytes.len(),
        folder.stream.display(),
        folder.report.display()
    );
    let mut notes = said.to_vec();
    notes.extend(of_tuning);
    notes.extend(tail_in_words(options));
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
        "stopped": record.stopped,
        "device": record.device,
        "before": before,
        "fine_tuned": after,
        "bytes": bytes.len(),
        "stream": files::shown(&folder.stream),
        "rank": choice,
        "registration": files::shown(&folder.registration),
        "delivery": files::shown(&folder.delivery),
        "log": files::shown(&folder.delivery_log),
        "report": files::shown(&folder.report),
    });
    Ok(VerbOutput { text, json, damaged: updates < options.updates, ..VerbOutput::default() })
}

/// What a fine-tuning led to.
pub(super) struct Tuned {
    pub(super) encoded: Encoded,
    /// What the encoder chose for the scene as it was given.
    given: Decisions,
    pub(super) record: Record,
    /// What a page says of it, as HTML.
    pub(super) section: String,
    /// The rank that was chosen for it, if one was.
    pub(super) choice: Option<RankChoice>,
    /// What a person should know.
    pub(super) notes: Vec<String>,
}

/// The stream of `scene`, fine-tuned on a backend towards `pictures` until a person asks to stop; and how
/// many updates were made.
pub(super) fn fine_tuned(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    pictures: Pictures<'_>,
    (options, backend): (&DeliveryOptions, &Backend),
    stop: &Interruption,
    quiet: Quiet,
) -> Result<Tuned> {
    // That of the training, unless the file of options has one: who goes on need not type it again.
    let seed = match pictures.trained {
        Some(trained) if options.seed == DeliveryOptions::default().seed => trained.options.seed,
        _ => options.seed,
    };
    let options = DeliveryOptions {
        seed: args.scene.seed.unwrap_or(seed),
        registration: Some(folder.registration.clone()),
        encode: pipeline::encode_options(&args.codec, Protection::NONE),
        ..options.clone()
    };
    let references = pictures.references(scene, args.references, options.validation.every)?;
    let chosen = || rank::chosen(args, folder, scene, &references, (&options, backend), stop, quiet);
    let choice = args.choose_rank.then(chosen).transpose()?;
    let options = match &choice {
        Some(RankChoice { rank, .. }) => {
            DeliveryOptions { encode: EncodeOptions { rank: *rank, ..options.encode.clone() }, ..options }
        }
        None => options,
    };
    let (tuned, seconds) = updated(args, folder, scene, &references, (&options, backend), stop, quiet)?;
    files::write(&folder.delivery, serde_json::to_string_pretty(&tuned.record)?.as_bytes())?;
    let bar = Progress::new("encode, fine-tuned", quiet.0);
    let progress = |stage: &'static str, share: f64| {
        stop.leave("delivery.json is whole; the stream is not there");
        bar.heard(&format!("encode, fine-tuned: {stage}"), share)
    };
    let encoded = write(&tuned.scene, &tuned.decisions, &progress)?;
    drop(bar);
    let damage = Damage::of(scene, &tuned, &pictures.unseen(scene)?)?;
    let section = page::section(&tuned.record, seconds, &damage)?;
    let bytes = encoded.report.ledger.wire() as u64;
    let notes = outcome::missed(options.encode.target, &tuned.record, bytes);
    let notes = notes.into_iter().collect();
    Ok(Tuned { encoded, given: tuned.given, record: tuned.record, section, choice, notes })
}

/// Makes the updates, from the checkpoint on where there is one, and keeps their log; and how many seconds
/// they took.
fn updated(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    references: &References,
    (options, backend): (&DeliveryOptions, &Backend),
    stop: &Interruption,
    quiet: Quiet,
) -> Result<(FineTuned, f64)> {
    let begun = begun(args, folder)?;
    let made = begun.as_ref().map_or(0, Tuning::updates);
    let log = RefCell::new(DeliveryLog::resumed(&folder.delivery_log, made));
    let before = log.borrow().seconds();
    let every = CHECKPOINT_EVERY.min(args.checkpoint_every as usize);
    let unsaved = RefCell::new(None);
    let bar = Progress::new("fine-tune for delivery", quiet.0);
    let clock = Clock::now();
    let References { training, validation } = references;
    let tuned = resume(scene, (training, validation), options, backend, begun, &|update, tuning| {
        let seconds = clock.elapsed().as_secs_f64();
        log.borrow_mut().add(before + seconds);
        say(&bar, update, tuning, (made, seconds), quiet);
        // After the last update there is nothing to stop, and what comes next answers who asks.
        let interrupted = update.updates < update.of && stop.take();
        let is_due = interrupted || update.updates == update.of || update.updates.is_multiple_of(every);
        if is_due && let Err(error) = save(folder, tuning, &log.borrow()) {
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
    let (log, Record { objective, terms, candidates, .. }) = (log.into_inner(), &tuned.record);
    files::write(&folder.delivery_log, log.csv(objective, terms, candidates).as_bytes())?;
    Ok((tuned, log.seconds()))
}

/// Says how far the updates are: `made` of them before this run, which has taken so many seconds.
fn say(bar: &Progress, update: &Update, tuning: &Tuning, (made, seconds): (usize, f64), quiet: Quiet) {
    let Update { updates, of, .. } = *update;
    let left = seconds * (of - updates) as f64 / (updates - made).max(1) as f64;
    let line = line(update, tuning.candidates(), left);
    bar.stage(&line, updates as f64 / of.max(1) as f64);
    // Where no bar is shown, a line for every tenth.
    let is_due = updates * LINES / of.max(1) > (updates - 1) * LINES / of.max(1);
    if is_due && !quiet.0 && !std::io::stderr().is_terminal() {
        bar.say(&line);
    }
}

fn save(folder: &Folder, tuning: &Tuning, log: &DeliveryLog) -> Result<()> {
    files::write(&folder.tuning, &tuning.to_bytes()?)?;
    let csv = log.csv(tuning.objective(), tuning.terms(), tuning.candidates());
    files::write(&folder.delivery_log, csv.as_bytes())
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

#[cfg(test)]
mod tests {
    use trainer_host::train::delivery::Weights;

    use super::*;

    #[test]
    fn a_tail_of_less_than_one_world_is_said_where_it_counts() {
        let of = |variant, worlds, weights| {
            tail_in_words(&DeliveryOptions { worlds, weights, ..DeliveryOptions::of(variant) })
        };
        let plain = Weights::default();
        let words = of(Variant::Combined, 16, plain).unwrap();
        assert!(words.contains("cvar_fraction is 0.05") && words.contains("1/16 of them"), "{words}");
        assert!(of(Variant::BurstCvar, 19, plain).is_some());
        assert_eq!(of(Variant::Combined, 20, plain), None, "one world exactly");
        assert_eq!(of(Variant::Iid, 16, plain), None, "without a tail");
        assert_eq!(of(Variant::Combined, 16, Weights { cvar: 0.0, ..plain }), None);
        assert_eq!(of(Variant::Combined, 16, Weights { cvar_fraction: 0.1, ..plain }), None);
    }
}
