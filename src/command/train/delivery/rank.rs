//! Chooses the rank of the shared temporal basis by validation before a scene is fine-tuned: `--choose-rank`.

use std::ops::{ControlFlow, RangeInclusive};

use anyhow::{Context, Result, anyhow, bail};
use render_host::Backend;
use serde::{Deserialize, Serialize};
use trainer_host::{
    Scene,
    train::delivery::{DeliveryOptions, RankChoice, RankResult, choose_rank, input_hashes, measure_rank},
};

use super::{
    super::{folder::Folder, interruption::Interruption},
    pictures::References,
};
use crate::{args::train::Train, files, pipeline::Quiet, progress::Progress};

/// Ranks that are tried.
const RANKS: RangeInclusive<usize> = 0..=8;
/// Each with these seeds.
const SEEDS: [u64; 3] = [1, 2, 3];
/// A rank is measured after this part of the updates: ranks are compared, and none of these scenes is kept.
const PART_OF_UPDATES: usize = 2;

/// The file of what was measured, for people and to go on with.
#[derive(Debug, Serialize, Deserialize)]
struct Measured {
    /// What it depends on: input, scene, references and options.
    of: String,
    /// What came of each rank with each seed so far.
    results: Vec<RankResult>,
    /// The rank that was taken, and why; none before all are measured.
    #[serde(skip_deserializing)]
    choice: Option<RankChoice>,
}

/// Refuses before the training what could not be chosen by.
pub(super) fn check(args: &Train, options: &DeliveryOptions) -> Result<()> {
    if args.choose_rank && options.recorded.is_some() {
        bail!("--choose-rank: recorded names states of a stream of one rank; name none, or type --rank");
    }
    if args.choose_rank && options.validation.states == 0 {
        bail!("--choose-rank: validation.states is 0; at least 1, by which ranks are compared, is needed");
    }
    Ok(())
}

/// The rank for `scene` under `options`: trained on `references` for training and compared on those for
/// validation, or where there are none on some of the former. What is
/// measured is kept in the folder at once; with `--resume` it is not measured again.
pub(super) fn chosen(
    args: &Train,
    folder: &Folder,
    scene: &Scene,
    references: &References,
    (options, backend): (&DeliveryOptions, &Backend),
    stop: &Interruption,
    quiet: Quiet,
) -> Result<RankChoice> {
    let every = options.validation.every;
    let (mut training, mut validation) = (Vec::new(), references.validation.clone());
    let is_shared = validation.is_empty();
    for (at, reference) in references.training.iter().enumerate() {
        let is_for_validation = is_shared && at % every == every - 1;
        let part = if is_for_validation { &mut validation } else { &mut training };
        part.push(reference.clone());
    }
    let options = DeliveryOptions { updates: options.updates.div_ceil(PART_OF_UPDATES), ..options.clone() };
    let [scene_hash, pictures] = input_hashes(scene, &training);
    let [_, compared] = input_hashes(scene, &validation);
    let of = format!(
        "{}, scene {scene_hash}, {} pictures {pictures}, {} for validation {compared}, options {:016x}",
        args.input,
        training.len(),
        validation.len(),
        options.hash()
    );
    let runs: Vec<(usize, u64)> = RANKS.flat_map(|rank| SEEDS.map(|seed| (rank, seed))).collect();
    let mut measured = begun(args, folder, of, &runs)?;
    let bar = Progress::new("choose the rank", quiet.0);
    for (at, &(rank, seed)) in runs.iter().enumerate().skip(measured.results.len()) {
        let run = (rank, seed);
        let result = measure_rank(scene, &training, &validation, &options, run, backend, &|update| {
            stop.leave("ranks.json has the ranks that were measured: --resume goes on");
            let share = update.updates as f64 / update.of.max(1) as f64;
            let stage = format!("rank {rank}, seed {seed}: {} of {}", at + 1, runs.len());
            bar.stage(&stage, (at as f64 + share) / runs.len() as f64);
            ControlFlow::Continue(())
        })?;
        measured.results.extend(result);
        measured.keep(folder)?;
    }
    let choice = choose_rank(&measured.results).context("no rank was measured")?;
    measured.choice = Some(choice.clone());
    measured.keep(folder)?;
    Ok(choice)
}

/// What was measured before, the first of `runs`, if this goes on with it; `of` is what it depends on.
fn begun(args: &Train, folder: &Folder, of: String, runs: &[(usize, u64)]) -> Result<Measured> {
    let path = &folder.ranks;
    if !args.resume || !path.is_file() {
        return Ok(Measured { of, results: Vec::new(), choice: None });
    }
    let named = || format!("{}: without this file ranks are measured anew", path.display());
    let measured: Measured =
        serde_json::from_slice(&std::fs::read(path).with_context(named)?).with_context(named)?;
    if measured.of != of {
        return Err(anyhow!("of {:?}; now it would be of {of:?}", measured.of)).with_context(named);
    }
    let found: Vec<_> = measured.results.iter().map(|result| (result.rank, result.seed)).collect();
    if !runs.starts_with(&found) {
        return Err(anyhow!("results are not of ranks and seeds in their order")).with_context(named);
    }
    Ok(measured)
}

impl Measured {
    fn keep(&self, folder: &Folder) -> Result<()> {
        files::write(&folder.ranks, serde_json::to_string_pretty(self)?.as_bytes())
    }
}

/// The choice, for people.
pub(super) fn said(choice: &RankChoice) -> String {
    let RankChoice { rank, p10_db, rule } = choice;
    format!("  rank {rank} of 0 to 8, each with three seeds: {p10_db:.2} dB ({rule})\n")
}
