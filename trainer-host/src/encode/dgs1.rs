//! Decides how a scene is represented and coded in profile `dgs1`.

pub(super) mod canonical;
pub(super) mod canonical_rotation;
pub(super) mod indices;
mod levels_sent;
mod manifest_body;
mod motion;
mod order;
mod proxy;
mod pruning;
pub(super) mod rate_estimate;
mod symbols;
mod track;
mod write;

use codec_core::internals::ids::Level;
use rayon::prelude::*;

pub(super) use write::write;

use self::symbols::{quantise, quantise_epoch, spans, symbol_runs};
use super::{
    EncodeError, EncodeOptions, Progress,
    analysis::Analysis,
    cluster,
    decisions::{CanonicalRotation, DecisionInputs, Dgs1Decisions, EpochDecisions, Quantisers, digits},
    packetise::CellSymbols,
    progress::{no_progress, part, report},
    quantiser_class::EpochClasses,
    statistics::{Model, Streams},
};
use crate::scene::{Epoch, Scene};

/// Share of deciding that is done before entropy tables are, about.
const DECIDE: f64 = 0.85;
/// Share of deciding an epoch that goes to the trial of forms of rotation, about.
const TRIAL: f64 = 0.3;

/// Decides everything for the scene of `analysis`.
///
/// # Errors
/// Steps or tables that the format does not hold.
pub(super) fn decide(
    analysis: &Analysis<'_>,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<Dgs1Decisions, EncodeError> {
    let scene = analysis.scene;
    let mut epochs = Vec::new();
    let share_of_epoch = DECIDE / scene.epochs().len() as f64;
    for (e, epoch) in scene.epochs().iter().enumerate() {
        let begun = e as f64 * share_of_epoch;
        let progress = &part(progress, begun, begun + share_of_epoch);
        report(progress, "decide", 0.0)?;
        let classes = &analysis.classes.of_epoch(e, &options.quality);
        let mut clusters = classes.sets.to_vec();
        if !options.keep_invisible {
            clusters = pruning::drawn(epoch, clusters);
        }
        let rotation = cheapest_rotation(epoch, &clusters, classes, scene, options)?;
        let epoch = canonical_rotation::reduced(epoch, &clusters, rotation);
        let progress = &part(progress, TRIAL, 1.0);
        epochs.push(decide_epoch(&epoch, rotation, clusters, classes, scene, options, progress)?);
    }
    if epochs.iter().all(|epoch| epoch.clusters.is_empty()) {
        return Err(EncodeError::NeverDrawn);
    }
    let mut decisions = Dgs1Decisions {
        made_from: DecisionInputs {
            quality: options.quality,
            quantiser_classes: analysis.classes.shares(&options.quality),
            clustering: options.cluster,
            epoch_gaussians: scene.epochs().iter().map(Epoch::count).collect(),
        },
        block_len: options.block_len,
        packet_bytes: options.packet_bytes,
        proxies: options.proxies,
        repair: options.repair,
        epochs,
        tables: Vec::new(),
        table_sets: Vec::new(),
    };
    report(progress, "entropy-code", DECIDE)?;
    decide_tables(scene, &mut decisions, options.table_choices)?;
    Ok(decisions)
}

/// Decides that cells are sent up to the levels `highest` (see [`super::with_levels`]).
///
/// # Errors
/// As [`decide`].
pub(super) fn with_levels(
    scene: &Scene,
    mut decisions: Dgs1Decisions,
    highest: &[Level],
    table_choices: usize,
) -> Result<Dgs1Decisions, EncodeError> {
    levels_sent::decide(&mut decisions, highest);
    decide_tables(scene, &mut decisions, table_choices)?;
    Ok(decisions)
}

/// Decides motion and tables of `scene` anew, with steps of motion `motion` times as long; what was decided
/// of canonical values stays, but for bands that have become zero.
///
/// # Errors
/// As [`decide`].
pub(super) fn reencode(
    scene: &Scene,
    mut decisions: Dgs1Decisions,
    motion: f32,
    options: &EncodeOptions,
) -> Result<Dgs1Decisions, EncodeError> {
    let block_len = decisions.block_len;
    for (epoch, decided) in scene.epochs().iter().zip(&mut decisions.epochs) {
        let epoch = symbols::in_canonical_rotation(epoch, decided);
        let of_motion = decided.quantisers.iter_mut().flat_map(|quantisers| &mut quantisers.motion);
        of_motion.for_each(|quantiser| quantiser.step *= motion);
        let quants: Result<Vec<_>, EncodeError> = decided.quantisers.iter().map(Quantisers::quant).collect();
        let quants = quants?;
        for cluster in &mut decided.clusters {
            let indices =
                indices::indices(&epoch, &cluster.gaussians, &quants[cluster.quantisers], decided.origin);
            cluster.harmonic_degree = pruning::degree_in_use(&indices, cluster.harmonic_degree);
        }
        let as_sent = canonical::quantise(&epoch, decided, &quants, block_len)?;
        decided.windows = motion::decide(&epoch, decided, &as_sent, scene.frames_per_second(), options);
    }
    (decisions.packet_bytes, decisions.repair) = (options.packet_bytes, options.repair);
    decide_tables(scene, &mut decisions, options.table_choices)?;
    Ok(decisions)
}

/// Decides order, quantisers, harmonic degrees and motion of one epoch, whose rotations are in form
/// `rotation`.
fn decide_epoch(
    epoch: &Epoch,
    rotation: CanonicalRotation,
    clusters: Vec<Vec<u32>>,
    classes: &EpochClasses<'_>,
    scene: &Scene,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<EpochDecisions, EncodeError> {
    report(progress, "decide", 0.0)?;
    let members = in_sending_order(epoch, clusters, classes, options)?;
    report(progress, "decide", 0.4)?;
    let (quants, clusters, origin) = canonical::decide(epoch, members, classes, options)?;
    let mut decisions = EpochDecisions {
        origin,
        canonical_rotation: rotation,
        quantisers: quants.iter().map(Quantisers::of).collect(),
        clusters,
        windows: Vec::new(),
        proxy_changes: Vec::new(),
    };
    // Closed loop: motion is decided on canonical values as they are sent.
    let as_sent = canonical::quantise(epoch, &decisions, &quants, options.block_len)?;
    report(progress, "decide", 0.6)?;
    decisions.windows = motion::decide(epoch, &decisions, &as_sent, scene.frames_per_second(), options);
    Ok(decisions)
}

/// Clusters that a trial takes, about.
const TRIAL_CLUSTERS: usize = 16;

/// The form of rotations and scales that takes the fewest bits in a trial on some clusters.
fn cheapest_rotation(
    epoch: &Epoch,
    clusters: &[Vec<u32>],
    classes: &EpochClasses<'_>,
    scene: &Scene,
    options: &EncodeOptions,
) -> Result<CanonicalRotation, EncodeError> {
    let every = (clusters.len() / TRIAL_CLUSTERS).max(1);
    let some: Vec<Vec<u32>> = clusters.iter().step_by(every).cloned().collect();
    let mut best = (f64::INFINITY, CanonicalRotation::AsGiven);
    for &rotation in canonical_rotation::candidates(epoch) {
        let epoch = canonical_rotation::reduced(epoch, &some, rotation);
        let decisions = decide_epoch(&epoch, rotation, some.clone(), classes, scene, options, &no_progress)?;
        let symbols = [quantise_epoch(&epoch, &decisions, options.block_len, false)?];
        let mut streams = Streams::default();
        for (_, cells) in spans(&symbols) {
            cells.iter().for_each(|cell| add_runs_but_tracks(cell, &mut streams));
        }
        let bits = streams.entropy_bits();
        if bits < best.0 {
            best = (bits, rotation);
        }
    }
    Ok(best.1)
}

/// Tracks do not depend on the form of rotations.
fn add_runs_but_tracks<'c>(cell: &'c CellSymbols, streams: &mut Streams<'c>) {
    symbol_runs(cell, |level, stream, run| {
        if !cell.shape.is_whole(level) {
            streams.add(stream, run);
        }
    });
}

/// The Gaussians of each cluster in the order in which they are sent.
fn in_sending_order(
    epoch: &Epoch,
    clusters: Vec<Vec<u32>>,
    classes: &EpochClasses<'_>,
    options: &EncodeOptions,
) -> Result<Vec<Vec<u32>>, EncodeError> {
    let positions = epoch.attributes().positions.frame(0, epoch.count());
    let in_blocks: Vec<Vec<u32>> = clusters
        .into_par_iter()
        .map(|set| cluster::block_order(&set, positions, options.block_len))
        .collect();
    let (quants, grid) = canonical::plain(epoch, &in_blocks, classes, options)?;
    Ok(order::arrange(epoch, in_blocks, |set| &quants[classes.of(set)], grid.origin, options.block_len))
}

/// Decides entropy tables, table sets of at most `most` tables, and the table of every symbol run.
fn decide_tables(scene: &Scene, decisions: &mut Dgs1Decisions, most: usize) -> Result<(), EncodeError> {
    let symbols = quantise(scene, decisions)?;
    let model = symbols::streams(&symbols).model(most)?;
    (decisions.tables, decisions.table_sets) = model.decisions();
    for (epoch, symbols) in decisions.epochs.iter_mut().zip(&symbols) {
        for (cluster, cell) in epoch.clusters.iter_mut().zip(&symbols.cells) {
            cluster.table_indices = cheapest_tables(cell, &model);
        }
        for (window, symbols) in epoch.windows.iter_mut().zip(&symbols.windows) {
            for (motion, cell) in window.motions.iter_mut().zip(&symbols.cells) {
                motion.table_indices = cheapest_tables(cell, &model);
            }
        }
    }
    Ok(())
}

/// Per level, the table of each symbol run of a cell that takes the fewest bits.
fn cheapest_tables(cell: &CellSymbols, model: &Model) -> [String; Level::COUNT] {
    let mut indices: [Vec<u8>; Level::COUNT] = Default::default();
    symbol_runs(cell, |level, stream, run| {
        indices[level.index()].push(model.choose(stream, run) as u8);
    });
    indices.map(|indices| digits(&indices))
}
