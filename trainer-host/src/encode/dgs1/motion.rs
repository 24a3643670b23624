//! Quantises motion to symbols: a track per cluster and window, then coefficients per Gaussian.
//!
//! Closed loop: what a coarser term leaves over is measured after that term has been quantised
//! and reconstructed by the decoder's own functions, so errors do not add up. Each term is sent
//! only where leaving it out would exceed the tolerance: a cluster that does not move costs
//! nothing.

use std::ops::Range;

use codec_core::internals::{
    decode::motion::cosine,
    ids::Level,
    layout::Shape,
    math,
    quant::{Class, recorrelate},
    wire::manifest::{Motion, Quant, Track},
};
use glam::Vec3;
use rayon::prelude::*;

use super::{
    super::{
        EncodeError, EncodeOptions,
        decisions::{EpochDecisions, MotionDecisions, TrackForm, WindowDecisions, misfit},
        factorise::temporal_basis,
        packetise::CellSymbols,
    },
    canonical::{Canonical, to_symbol},
    rate_estimate::{RateEstimate, dot},
    track::{self, Chosen, Member},
};
use crate::scene::{Epoch, activation::sigmoid};

/// What a cluster's track leaves per moving class: one trajectory per Gaussian and component, none where
/// nothing is left.
type Leftover = [Vec<Vec<f64>>; Class::MOVING];

/// One window, quantised.
pub(super) struct WindowSymbols {
    pub frames: usize,
    pub first_frame: usize,
    pub cells: Vec<CellSymbols>,
    pub saturated: u64,
}

/// Rates of a moving class's coefficients.
fn rate_of(quant: &Quant, class: Class) -> RateEstimate {
    RateEstimate::of_step(quant.motion[class.index()].step(Level::ALL[3]))
}

/// Chooses windows, tracks, bases and ranks for the clusters of `decisions`, of which `canonical` are the
/// canonical values as sent. No windows if nothing moves.
pub(super) fn decide(
    epoch: &Epoch,
    decisions: &EpochDecisions,
    canonical: &Canonical,
    frames_per_second: f64,
    options: &EncodeOptions,
) -> Vec<WindowDecisions> {
    if epoch.attributes().is_constant() {
        return Vec::new();
    }
    let second = (frames_per_second.round() as usize).clamp(1, 64);
    let most = options.window_frames.unwrap_or(second);
    let count = epoch.frames().div_ceil(most);
    let edge = |w: usize| epoch.frames() * w / count;
    (0..count).map(|w| decide_window(epoch, edge(w)..edge(w + 1), decisions, canonical, options)).collect()
}

fn decide_window(
    epoch: &Epoch,
    frames: Range<usize>,
    decisions: &EpochDecisions,
    canonical: &Canonical,
    options: &EncodeOptions,
) -> WindowDecisions {
    let cosines = cosine_vectors(frames.len());
    let most_bits = 7.0 * (options.packet_bytes as f64 - 80.0);
    let tracked: Vec<(Motion, Leftover)> = decisions
        .clusters
        .par_iter()
        .zip(&canonical.cells)
        .map(|(cluster, cell)| {
            let member = member(epoch, frames.clone(), &cluster.gaussians, cell, canonical.origin);
            let quant = &cell.shape.quant;
            let rates = [rate_of(quant, Class::Position), rate_of(quant, Class::Rotation)];
            let bounds = (most_bits, options.rank);
            let track = track::choose(&member, &motionless(cell, frames.len()), &rates, &cosines, bounds);
            let leftover = leftover(epoch, &member, &track, cell, canonical.origin);
            (track.motion, leftover)
        })
        .collect();
    let mut basis = learned_basis(tracked.iter().map(|(_, leftover)| leftover), frames.len(), options.rank);
    let learned = basis_vectors(&basis);
    let motions: Vec<MotionDecisions> = tracked
        .par_iter()
        .zip(&canonical.cells)
        .map(|((motion, leftover), cell)| MotionDecisions {
            track: match motion.class() {
                Track::Static => TrackForm::Static,
                Track::Rigid => TrackForm::Rigid,
                Track::Affine => TrackForm::Affine,
            },
            track_shift: motion.track_shift,
            ranks: cheapest_ranks(leftover, &cell.shape.quant, &learned, &cosines),
            highest_level: 3,
            table_indices: Default::default(),
        })
        .collect();
    let used = motions.iter().map(|m| usize::from(m.ranks[Class::Position.index()])).max().unwrap_or(0);
    basis.truncate(used);
    WindowDecisions { frames: frames.len(), basis, motions }
}

/// The temporal basis of what positions lack after tracks: at most `most` vectors, in 1/16384.
fn learned_basis<'l>(
    leftovers: impl Iterator<Item = &'l Leftover>,
    frames: usize,
    most: usize,
) -> Vec<Vec<i16>> {
    let rows = leftovers.flat_map(|left| &left[Class::Position.index()]).map(Vec::as_slice);
    let (vectors, energy) = temporal_basis(rows, frames, most.min(frames));
    let mut basis = Vec::new();
    for (vector, _) in vectors.iter().zip(&energy).take_while(|(_, energy)| **energy > 0.0) {
        basis.push(vector.iter().map(|x| (x * BASIS_UNITS).round() as i16).collect());
    }
    basis
}

/// A basis vector's entries are counted in one over this.
const BASIS_UNITS: f64 = 16_384.0;

/// The basis as the decoder has it.
fn basis_vectors(basis: &[Vec<i16>]) -> Vec<Vec<f64>> {
    basis.iter().map(|v| v.iter().map(|&x| f64::from(x) / BASIS_UNITS).collect()).collect()
}

/// Per moving class, how many coefficients per Gaussian and component cost least.
fn cheapest_ranks(
    leftover: &Leftover,
    quant: &Quant,
    learned: &[Vec<f64>],
    cosines: &[Vec<f64>],
) -> [u8; Class::MOVING] {
    let mut ranks = [0; Class::MOVING];
    for class in Class::ALL.into_iter().take(Class::MOVING) {
        let rows = &leftover[class.index()];
        let vectors = if class == Class::Position { learned } else { cosines };
        let projections: Vec<Vec<f64>> =
            rows.iter().map(|row| vectors.iter().map(|v| dot(row, v)).collect()).collect();
        ranks[class.index()] = cheapest_rank(rows, &projections, rate_of(quant, class)) as u8;
    }
    ranks
}

/// Quantises the motion of window `index` of `epoch` as `decisions` say; `first_frame` is the window's
/// first frame within the epoch. Every level is there.
///
/// # Errors
/// A track that is too fine for its symbols.
pub(super) fn quantise(
    epoch: &Epoch,
    (index, first_frame): (usize, usize),
    decisions: &EpochDecisions,
    canonical: &Canonical,
) -> Result<WindowSymbols, EncodeError> {
    let window = &decisions.windows[index];
    let frames = first_frame..first_frame + window.frames;
    let cosines = cosine_vectors(window.frames);
    let learned = basis_vectors(&window.basis);
    let quantised: Result<Vec<(CellSymbols, u64)>, EncodeError> = (0..decisions.clusters.len())
        .into_par_iter()
        .map(|c| {
            let (cluster, cell) = (&decisions.clusters[c], &canonical.cells[c]);
            let motion = &window.motions[c];
            let member = member(epoch, frames.clone(), &cluster.gaussians, cell, canonical.origin);
            let track = track::follow(&member, &motionless(cell, window.frames), motion, &cosines);
            let track = track.ok_or_else(|| {
                let place = format_args!("window {index}, cluster {c}").to_string();
                misfit(place, "track_shift", motion.track_shift, "a step coarse enough for i16 symbols")
            })?;
            let leftover = leftover(epoch, &member, &track, cell, canonical.origin);
            Ok(coefficients(track, &leftover, motion, cell, &learned, &cosines))
        })
        .collect();
    let quantised = quantised?;
    let saturated = quantised.iter().map(|(_, saturated)| saturated).sum();
    let cells = quantised.into_iter().map(|(cell, _)| cell).collect();
    Ok(WindowSymbols { frames: window.frames, first_frame, cells, saturated })
}

/// The cosine basis as vectors over time.
fn cosine_vectors(frames: usize) -> Vec<Vec<f64>> {
    let at: Vec<_> = (0..frames).map(|t| cosine(frames as u32, t as u32)).collect();
    (0..frames).map(|k| at.iter().map(|weights| f64::from(weights[k])).collect()).collect()
}

/// The shape of a cluster's motion cell in a window of `frames` in which it does not move.
fn motionless(cell: &CellSymbols, frames: usize) -> Shape {
    let Shape { cluster, quant, block_len, .. } = cell.shape;
    Shape::dgs1(cluster, quant, Some(Motion::default()), frames as u32, block_len)
}

/// A cluster over `frames` of its epoch, as the decoder has it when nothing moves.
fn member<'e>(
    epoch: &'e Epoch,
    frames: Range<usize>,
    members: &'e [u32],
    cell: &CellSymbols,
    origin: [f32; 3],
) -> Member<'e> {
    let decoded = |class: Class| -> Vec<[f32; 3]> {
        (0..members.len()).map(|i| dequantised(cell, class, i, origin)).collect()
    };
    let base = cell.shape.quant.canonical[Class::Position.index()].step(Level::BASE);
    let record = cell.shape.cluster;
    let centre = [record.centre_x, record.centre_y, record.centre_z];
    let rotations = decoded(Class::Rotation).into_iter();
    Member {
        attributes: epoch.attributes(),
        count: epoch.count(),
        frames,
        members,
        still: decoded(Class::Position),
        rest: rotations.map(|m| math::normalised(math::quat_from_mrp(m))).collect(),
        centre: Vec3::from_array([0, 1, 2].map(|d| origin[d] + f32::from(centre[d]) * base)),
    }
}

/// What the Gaussians of `member` do that `track` does not.
fn leftover(
    epoch: &Epoch,
    member: &Member<'_>,
    track: &Chosen,
    cell: &CellSymbols,
    origin: [f32; 3],
) -> Leftover {
    let (n, a) = (epoch.count(), epoch.attributes());
    let mut left = Leftover::default();
    for i in 0..member.members.len() {
        let rows = member.leftover(&track.poses, i);
        for (d, row) in rows.into_iter().enumerate() {
            left[if d < 3 { Class::Position.index() } else { Class::Rotation.index() }].push(row);
        }
    }
    for (class, constant) in [
        (Class::Scale, a.log_scales.is_constant()),
        (Class::Opacity, a.opacity_logits.is_constant()),
        (Class::Sh0, a.sh0.is_constant()),
    ] {
        if constant {
            continue;
        }
        for (i, &g) in member.members.iter().enumerate() {
            let (g, still) = (g as usize, dequantised(cell, class, i, origin));
            for (d, &still) in still.iter().enumerate().take(class.components()) {
                let value = |t: usize| match class {
                    Class::Scale => a.log_scales.frame(t, n)[g][d],
                    Class::Opacity => sigmoid(a.opacity_logits.frame(t, n)[g]),
                    _ => a.sh0.frame(t, n)[g][d],
                };
                let row = member.frames.clone().map(|t| f64::from(value(t) - still)).collect();
                left[class.index()].push(row);
            }
        }
    }
    left
}

/// Values of Gaussian `i` of a cell as the decoder gets them at level 3 (Rodrigues parameters
/// for rotation).
fn dequantised(cell: &CellSymbols, class: Class, i: usize, origin: [f32; 3]) -> [f32; 3] {
    let shape = &cell.shape;
    let block_len = shape.block_len.get() as usize;
    let (block, within) = (i / block_len, i % block_len);
    let n = shape.block_gaussians(block);
    let quantiser = shape.quant.canonical[class.index()];
    let step = quantiser.step(Level::ALL[3]);
    let centre = [shape.cluster.centre_x, shape.cluster.centre_y, shape.cluster.centre_z];
    let mut out = [0f32; 3];
    for (d, out) in out.iter_mut().enumerate().take(class.components()) {
        let mut q = 0i32;
        for level in Level::ALL {
            if !quantiser.has_symbol(level, class.first_level()) {
                q = quantiser.refine(q, 0, level);
                continue;
            }
            let earlier: usize =
                shape.components(level).take_while(|&(c, ..)| c != class).map(|(.., dims)| dims).sum();
            let (level_start, _) = shape.range(level, 0..0);
            let from = shape.range(level, block..block + 1).0 - level_start + (earlier + d) * n;
            let run = &cell.levels[level.index()][from..from + n];
            if level == class.first_level() {
                let start = if class == Class::Position { i32::from(centre[d]) } else { 0 };
                q = start
                    + if quantiser.predicted() {
                        run[..=within].iter().map(|&s| i32::from(s)).sum::<i32>()
                    } else {
                        i32::from(run[within])
                    };
            } else {
                q = quantiser.refine(q, run[within], level);
            }
        }
        let origin = if class == Class::Position { origin[d] } else { 0.0 };
        *out = origin + q as f32 * step;
    }
    if quantiser.decorrelated() { recorrelate(out) } else { out }
}

/// Symbols of a cluster's track and of its Gaussians' coefficients, and how many were clamped.
fn coefficients(
    track: Chosen,
    leftover: &Leftover,
    decided: &MotionDecisions,
    cell: &CellSymbols,
    learned: &[Vec<f64>],
    cosines: &[Vec<f64>],
) -> (CellSymbols, u64) {
    // Of a class of which nothing is left there is nothing to code.
    let rank = |class: Class| match leftover[class.index()].is_empty() {
        true => 0,
        false => decided.ranks[class.index()],
    };
    let motion = Motion {
        position: rank(Class::Position),
        scale: rank(Class::Scale),
        rotation: rank(Class::Rotation),
        opacity: rank(Class::Opacity),
        sh0: rank(Class::Sh0),
        ..track.motion
    };
    let mut saturated = 0;
    let quant = &cell.shape.quant;
    let frames = cosines.len() as u32;
    let shape = Shape::dgs1(cell.shape.cluster, *quant, Some(motion), frames, cell.shape.block_len);
    let mut levels: [Vec<i16>; Level::COUNT] = Default::default();
    levels[0] = track.symbols;
    for level in Level::ALL.into_iter().skip(1) {
        let out = &mut levels[level.index()];
        for block in 0..shape.blocks() {
            let first = shape.first_of(block);
            for (class, k, dims) in shape.components(level) {
                let quantiser = quant.motion[class.index()];
                let vector = if class == Class::Position { &learned[k] } else { &cosines[k] };
                for d in 0..dims {
                    let mut previous = 0;
                    for i in first..first + shape.block_gaussians(block) {
                        let value = dot(&leftover[class.index()][dims * i + d], vector);
                        let symbols = quantiser.split(quantiser.index(value as f32), Level::ALL[1]);
                        let mut symbol = symbols[level.index()];
                        if level == Level::ALL[1] && quantiser.predicted() {
                            (symbol, previous) = (symbol - previous, symbol);
                        }
                        out.push(to_symbol(symbol, &mut saturated));
                    }
                }
            }
        }
    }
    (CellSymbols { shape, levels, table_indices: Default::default() }, saturated)
}

/// How many of the basis' vectors are coded for all Gaussians of a cluster: where bits and what is
/// left out together cost least.
fn cheapest_rank(rows: &[Vec<f64>], projections: &[Vec<f64>], rate: RateEstimate) -> usize {
    let mut energy: f64 = rows.iter().map(|r| dot(r, r)).sum();
    let (mut bits, mut best) = (0.0, (rate.of_loss(energy), 0));
    for rank in 0..projections.first().map_or(0, Vec::len) {
        for p in projections {
            energy -= p[rank] * p[rank];
            bits += rate.of(p[rank]) - rate.of_loss(0.0);
        }
        let cost = bits + rate.of_loss(energy.max(0.0));
        if cost < best.0 {
            best = (cost, rank + 1);
        }
    }
    best.1
}
