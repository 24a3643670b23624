//! Motion to symbols: a track per cluster and window, then coefficients per Gaussian.
//!
//! Closed loop: what a coarser term leaves over is measured after that term has been quantised
//! and reconstructed by the decoder's own functions, so errors do not add up. Each term is sent
//! only where leaving it out would exceed the tolerance: a cluster that does not move costs
//! nothing.

use codec_core::internals::{
    decode::motion::cosine,
    ids::Level,
    layout::Shape,
    math,
    quant::{Class, recorrelate},
    wire::manifest::{Motion, Quant},
};
use glam::Vec3;
use rayon::prelude::*;

use super::{
    super::{EncodeError, Options, packetise::CellSymbols},
    WindowPlan,
    canonical::{Canonical, to_symbol},
    price::Price,
    track::{self, Member, dot},
};
use crate::{
    factorise::temporal_basis,
    scene::{Epoch, Scene},
};

/// A cluster's motion in one window after its track has been quantised.
struct Tracked {
    motion: Motion,
    track: Vec<i16>,
    /// What is left per moving class: one trajectory per Gaussian and component, empty if nothing.
    left: [Vec<Vec<f64>>; Class::MOVING],
}

/// Prices of a moving class's coefficients.
fn price(quant: &Quant, class: Class) -> Price {
    Price::of_step(quant.motion[class.index()].step(Level::ALL[3]))
}

/// The window plans of `epoch`, and the number of clamped values. No plans if nothing moves.
pub(super) fn quantise(
    epoch: &Epoch,
    first_frame: usize,
    members: &[Vec<u32>],
    canonical: &Canonical,
    scene: &Scene,
    options: &Options,
) -> Result<(Vec<WindowPlan>, u64), EncodeError> {
    if epoch.attributes().is_constant() {
        return Ok((Vec::new(), 0));
    }
    let second = (scene.frames_per_second().round() as usize).clamp(1, 64);
    let most = options.window_frames.unwrap_or(second);
    let count = epoch.frames().div_ceil(most);
    let mut plans = Vec::new();
    let mut saturated = 0;
    let mut start = 0;
    for w in 0..count {
        let end = epoch.frames() * (w + 1) / count;
        let (plan, clamped) = window(epoch, first_frame, start..end, members, canonical, options)?;
        saturated += clamped;
        plans.push(plan);
        start = end;
    }
    Ok((plans, saturated))
}

fn window(
    epoch: &Epoch,
    first_frame: usize,
    frames: std::ops::Range<usize>,
    members: &[Vec<u32>],
    canonical: &Canonical,
    options: &Options,
) -> Result<(WindowPlan, u64), EncodeError> {
    let count = frames.len();
    let cosines: Vec<Vec<f64>> = cosine_vectors(count);
    let tracked: Vec<Tracked> = members
        .par_iter()
        .zip(&canonical.cells)
        .map(|(members, cell)| tracked(epoch, frames.clone(), members, cell, canonical, &cosines, options))
        .collect();
    let position = Class::Position.index();
    let rows = tracked.iter().flat_map(|t| &t.left[position]).map(Vec::as_slice);
    let most = options.rank.min(count);
    let (vectors, energy) = temporal_basis(rows, count, most);
    let mut basis: Vec<Vec<i16>> = vectors
        .iter()
        .zip(&energy)
        .take_while(|(_, e)| **e > 0.0)
        .map(|(v, _)| v.iter().map(|x| (x * 16_384.0).round() as i16).collect())
        .collect();
    let as_sent: Vec<Vec<f64>> =
        basis.iter().map(|v| v.iter().map(|&x| f64::from(x) / 16_384.0).collect()).collect();
    let cells: Vec<(CellSymbols, u64)> = tracked
        .into_par_iter()
        .zip(&canonical.cells)
        .map(|(tracked, cell)| coefficients(tracked, cell, count, &as_sent, &cosines))
        .collect();
    let saturated = cells.iter().map(|(_, s)| s).sum();
    let cells: Vec<CellSymbols> = cells.into_iter().map(|(c, _)| c).collect();
    let used = cells.iter().map(|c| usize::from(c.shape.motion.position)).max().unwrap_or(0);
    basis.truncate(used);
    let plan = WindowPlan { frames: count, first_frame: first_frame + frames.start, basis, cells };
    Ok((plan, saturated))
}

/// The cosine basis as vectors over time.
fn cosine_vectors(frames: usize) -> Vec<Vec<f64>> {
    let at: Vec<_> = (0..frames).map(|t| cosine(frames as u32, t as u32)).collect();
    (0..frames).map(|k| at.iter().map(|weights| f64::from(weights[k])).collect()).collect()
}

fn tracked(
    epoch: &Epoch,
    frames: std::ops::Range<usize>,
    members: &[u32],
    cell: &CellSymbols,
    canonical: &Canonical,
    cosines: &[Vec<f64>],
    options: &Options,
) -> Tracked {
    let (n, a) = (epoch.count(), epoch.attributes());
    let quant = &cell.shape.quant;
    let decoded: Vec<Vec<[f32; 3]>> = Class::ALL
        .into_iter()
        .take(Class::MOVING)
        .map(|class| (0..members.len()).map(|i| dequantised(cell, class, i, canonical)).collect())
        .collect();
    let base = quant.canonical[Class::Position.index()].step(Level::BASE);
    let record = cell.shape.cluster;
    let centre = Vec3::new(
        canonical.origin[0] + f32::from(record.centre_x) * base,
        canonical.origin[1] + f32::from(record.centre_y) * base,
        canonical.origin[2] + f32::from(record.centre_z) * base,
    );
    let rest = decoded[Class::Rotation.index()].iter();
    let member = Member {
        attributes: a,
        count: n,
        frames: frames.clone(),
        members,
        still: decoded[Class::Position.index()].clone(),
        rest: rest.map(|&m| math::normalised(math::quat_from_mrp(m))).collect(),
        centre,
    };
    let still = Shape::dgs1(record, *quant, Some(Motion::default()), frames.len() as u32, options.block_len);
    let prices = [price(quant, Class::Position), price(quant, Class::Rotation)];
    let most_bits = 7.0 * (options.packet_bytes as f64 - 80.0);
    let chosen = track::choose(&member, &still, &prices, cosines, most_bits);

    let mut left: [Vec<Vec<f64>>; Class::MOVING] = Default::default();
    for i in 0..members.len() {
        let rows = member.leftover(&chosen.poses, i);
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
        for (i, &g) in members.iter().enumerate() {
            let (g, still) = (g as usize, decoded[class.index()][i]);
            for (d, &still) in still.iter().enumerate().take(class.components()) {
                let value = |t: usize| match class {
                    Class::Scale => a.log_scales.frame(t, n)[g][d],
                    Class::Opacity => 1.0 / (1.0 + (-a.opacity_logits.frame(t, n)[g]).exp()),
                    _ => a.sh0.frame(t, n)[g][d],
                };
                left[class.index()].push(frames.clone().map(|t| f64::from(value(t) - still)).collect());
            }
        }
    }
    Tracked { motion: chosen.motion, track: chosen.symbols, left }
}

/// Values of Gaussian `i` of a cell as the decoder gets them at level 3 (Rodrigues parameters
/// for rotation).
fn dequantised(cell: &CellSymbols, class: Class, i: usize, canonical: &Canonical) -> [f32; 3] {
    let origin = canonical.origin;
    let shape = &cell.shape;
    let (block, within) = (i / shape.block_len, i % shape.block_len);
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

fn coefficients(
    tracked: Tracked,
    cell: &CellSymbols,
    frames: usize,
    learned: &[Vec<f64>],
    cosines: &[Vec<f64>],
) -> (CellSymbols, u64) {
    let Tracked { mut motion, track, left } = tracked;
    let mut saturated = 0;
    // Projections per class: row-major, one list of coefficients per Gaussian and component.
    let mut projected: [Vec<Vec<f64>>; Class::MOVING] = Default::default();
    for class in Class::ALL.into_iter().take(Class::MOVING) {
        let rows = &left[class.index()];
        if rows.is_empty() {
            continue;
        }
        let vectors = if class == Class::Position { learned } else { cosines };
        let projections: Vec<Vec<f64>> =
            rows.iter().map(|row| vectors.iter().map(|v| dot(row, v)).collect()).collect();
        let rank = cheapest_rank(rows, &projections, price(&cell.shape.quant, class));
        match class {
            Class::Position => motion.position = rank as u8,
            Class::Scale => motion.scale = rank as u8,
            Class::Rotation => motion.rotation = rank as u8,
            Class::Opacity => motion.opacity = rank as u8,
            _ => motion.sh0 = rank as u8,
        }
        projected[class.index()] = projections;
    }
    let quant = &cell.shape.quant;
    let shape = Shape::dgs1(cell.shape.cluster, *quant, Some(motion), frames as u32, cell.shape.block_len);
    let mut levels: [Vec<i16>; Level::COUNT] = Default::default();
    levels[0] = track;
    for level in Level::ALL.into_iter().skip(1) {
        let out = &mut levels[level.index()];
        for block in 0..shape.blocks() {
            let first = block * shape.block_len;
            for (class, k, dims) in shape.components(level) {
                let quantiser = quant.motion[class.index()];
                for d in 0..dims {
                    let mut previous = 0;
                    for i in first..first + shape.block_gaussians(block) {
                        let value = projected[class.index()][dims * i + d][k];
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
    (CellSymbols { shape, levels }, saturated)
}

/// How many of the basis' vectors are coded for all Gaussians of a cluster: where bits and what is
/// left out together cost least.
fn cheapest_rank(rows: &[Vec<f64>], projections: &[Vec<f64>], price: Price) -> usize {
    let mut energy: f64 = rows.iter().map(|r| dot(r, r)).sum();
    let (mut bits, mut best) = (0.0, (price.of_loss(energy), 0));
    for rank in 0..projections.first().map_or(0, Vec::len) {
        for p in projections {
            energy -= p[rank] * p[rank];
            bits += price.of(p[rank]) - price.of_loss(0.0);
        }
        let cost = bits + price.of_loss(energy.max(0.0));
        if cost < best.0 {
            best = (cost, rank + 1);
        }
    }
    best.1
}
