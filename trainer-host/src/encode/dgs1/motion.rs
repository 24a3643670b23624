//! Motion to symbols: a track per cluster and window, then coefficients per Gaussian.
//!
//! Closed loop: what a coarser term leaves over is measured after that term has been quantised
//! and reconstructed by the decoder's own functions, so errors do not add up. Each term is sent
//! only where leaving it out would exceed the tolerance: a cluster that does not move costs
//! nothing.

use codec_core::{
    decode::motion::{cosine, pose, track_steps},
    ids::Level,
    layout::Shape,
    math,
    quant::Class,
    wire::manifest::{Motion, TRACK_PARAMETERS},
};
use glam::Vec3;
use rayon::prelude::*;

use super::{
    super::{EncodeError, Options, packetise::CellSymbols, steps},
    WindowPlan,
    canonical::{Canonical, to_symbol},
};
use crate::{
    factorise::{fit_pose, mean_turn, temporal_basis},
    scene::{Epoch, Scene},
};

/// A cluster's motion in one window after its track has been quantised.
struct Tracked {
    motion: Motion,
    track: Vec<i16>,
    /// What is left per moving class: one trajectory per Gaussian and component, empty if nothing.
    left: [Vec<Vec<f64>>; Class::MOVING],
    saturated: u64,
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
    let a = epoch.attributes();
    let constant = a.positions.is_constant()
        && a.rotations.is_constant()
        && a.log_scales.is_constant()
        && a.opacity_logits.is_constant()
        && a.sh0.is_constant();
    if constant {
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
    let tolerance = steps::motion_tolerance(&options.quality, canonical.step);
    let tracked: Vec<Tracked> = members
        .par_iter()
        .zip(&canonical.cells)
        .map(|(members, cell)| track(epoch, frames.clone(), members, cell, canonical, &tolerance, options))
        .collect();
    let count = frames.len();
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
    let cosines: Vec<Vec<f64>> = cosine_vectors(count);
    let cells: Vec<(CellSymbols, u64)> = tracked
        .into_par_iter()
        .zip(&canonical.cells)
        .map(|(tracked, cell)| coefficients(tracked, cell, canonical, count, &as_sent, &cosines, &tolerance))
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

fn track(
    epoch: &Epoch,
    frames: std::ops::Range<usize>,
    members: &[u32],
    cell: &CellSymbols,
    canonical: &Canonical,
    tolerance: &[f64; Class::MOVING],
    options: &Options,
) -> Tracked {
    let (n, a) = (epoch.count(), epoch.attributes());
    let quant = &canonical.quant;
    let decoded: Vec<Vec<[f32; 3]>> = Class::ALL
        .into_iter()
        .take(Class::MOVING)
        .map(|class| (0..members.len()).map(|i| dequantised(cell, class, i, canonical)).collect())
        .collect();
    let at = |class: Class, i: usize| decoded[class.index()][i];
    let still = &decoded[Class::Position.index()];
    let position = quant.canonical[Class::Position.index()];
    let base = position.step(Level::BASE);
    let record = cell.shape.cluster;
    let centre = Vec3::new(
        canonical.origin[0] + f32::from(record.centre_x) * base,
        canonical.origin[1] + f32::from(record.centre_y) * base,
        canonical.origin[2] + f32::from(record.centre_z) * base,
    );
    let pick3 =
        |values: &[[f32; 3]]| -> Vec<[f32; 3]> { members.iter().map(|&i| values[i as usize]).collect() };
    let pick4 =
        |values: &[[f32; 4]]| -> Vec<[f32; 4]> { members.iter().map(|&i| values[i as usize]).collect() };
    let start_turns = pick4(a.rotations.frame(0, n));
    let p0: Vec<[f64; 3]> = still.iter().map(|p| p.map(f64::from)).collect();

    // Fit, then decide whether the cluster moves at all.
    let mut turn = [1.0, 0.0, 0.0, 0.0];
    let (mut moved2, mut turned2) = (0.0, 0.0);
    let mut parameters: Vec<Vec<f64>> = vec![Vec::new(); TRACK_PARAMETERS];
    for t in frames.clone() {
        let target: Vec<[f64; 3]> = pick3(a.positions.frame(t, n)).iter().map(|p| p.map(f64::from)).collect();
        turn = mean_turn(&start_turns, &pick4(a.rotations.frame(t, n)), turn);
        let fit = fit_pose(&p0, &target, centre.to_array().map(f64::from), turn);
        for (p, x) in p0.iter().zip(&target) {
            moved2 += (0..3).map(|d| (x[d] - p[d]).powi(2)).sum::<f64>();
        }
        turned2 += turn[1] * turn[1] + turn[2] * turn[2] + turn[3] * turn[3];
        for (i, parameter) in parameters.iter_mut().enumerate() {
            parameter.push(match i {
                0..=8 => fit.linear[(i / 3, i % 3)] - if i % 4 == 0 { 1.0 } else { 0.0 },
                9..=11 => fit.translation[i - 9],
                12 => fit.rotation[0] - 1.0,
                _ => fit.rotation[i - 12],
            });
        }
    }
    let samples = (members.len() * frames.len() * 3).max(1) as f64;
    let moves = (moved2 / samples).sqrt() > 0.5 * tolerance[0];
    let turns = (turned2 / frames.len() as f64).sqrt() > 0.5 * tolerance[2];
    let mut motion = Motion { track: u8::from(moves || turns), ..Motion::default() };
    let mut track = Vec::new();
    let count = frames.len() as u32;
    if motion.track == 1 {
        loop {
            let shape = Shape::dgs1(record, *quant, Some(motion), count, options.block_len);
            track = quantise_track(&shape, &parameters);
            let fits = track.len() == TRACK_PARAMETERS * frames.len();
            if (fits && size_bits(&track) < 7.0 * (options.packet_bytes as f64 - 60.0))
                || motion.track_shift == 24
            {
                track.resize(TRACK_PARAMETERS * frames.len(), 0);
                break;
            }
            motion.track_shift += 1;
        }
    }
    // What the decoder makes of it, and what is left.
    let shape = Shape::dgs1(record, *quant, Some(motion), count, options.block_len);
    let mut left: [Vec<Vec<f64>>; Class::MOVING] = Default::default();
    let empty = |dims: usize| vec![Vec::new(); members.len() * dims];
    left[Class::Position.index()] = empty(3);
    left[Class::Rotation.index()] = empty(3);
    for (class, constant) in [
        (Class::Scale, a.log_scales.is_constant()),
        (Class::Opacity, a.opacity_logits.is_constant()),
        (Class::Sh0, a.sh0.is_constant()),
    ] {
        if !constant {
            left[class.index()] = empty(class.components());
        }
    }
    for (local, t) in frames.clone().enumerate() {
        let pose = if motion.track == 1 {
            pose(&shape, &track, &cosine(count, local as u32))
        } else {
            codec_core::decode::motion::Pose::IDENTITY
        };
        for (i, &g) in members.iter().enumerate() {
            let g = g as usize;
            let offset = Vec3::from_array(still[i]) - centre;
            let x = pose.linear * offset + centre + pose.translation;
            let truth = a.positions.frame(t, n)[g];
            for d in 0..3 {
                left[Class::Position.index()][3 * i + d].push(f64::from(truth[d]) - f64::from(x[d]));
            }
            let rest = math::normalised(math::quat_from_mrp(at(Class::Rotation, i)));
            let [w, x, y, z] = math::quat_mul(pose.rotation, rest);
            let turn = math::quat_mul(a.rotations.frame(t, n)[g], [w, -x, -y, -z]);
            // Half-angle tangent components; a turn near 180° is clamped and stays coarse.
            let w = if turn[0].abs() < 0.05 { 0.05f32.copysign(turn[0]) } else { turn[0] };
            for d in 0..3 {
                left[Class::Rotation.index()][3 * i + d].push(f64::from(turn[d + 1] / w));
            }
            if !left[Class::Scale.index()].is_empty() {
                let (truth, still) = (a.log_scales.frame(t, n)[g], at(Class::Scale, i));
                for d in 0..3 {
                    left[Class::Scale.index()][3 * i + d].push(f64::from(truth[d] - still[d]));
                }
            }
            if !left[Class::Opacity.index()].is_empty() {
                let truth = 1.0 / (1.0 + (-a.opacity_logits.frame(t, n)[g]).exp());
                left[Class::Opacity.index()][i].push(f64::from(truth - at(Class::Opacity, i)[0]));
            }
            if !left[Class::Sh0.index()].is_empty() {
                let (truth, still) = (a.sh0.frame(t, n)[g], at(Class::Sh0, i));
                for d in 0..3 {
                    left[Class::Sh0.index()][3 * i + d].push(f64::from(truth[d] - still[d]));
                }
            }
        }
    }
    for (rows, &tolerance) in left.iter_mut().zip(tolerance) {
        if root_mean_square(rows) <= tolerance {
            rows.clear();
        }
    }
    Tracked { motion, track, left, saturated: 0 }
}

/// Cosine coefficients of the parameters as symbols; fewer than all if one does not fit i16.
fn quantise_track(shape: &Shape, parameters: &[Vec<f64>]) -> Vec<i16> {
    let (translation, linear) = track_steps(shape);
    let vectors = cosine_vectors(shape.frames as usize);
    let mut symbols = Vec::with_capacity(parameters.len() * vectors.len());
    for (p, parameter) in parameters.iter().enumerate() {
        let step = f64::from(if (9..12).contains(&p) { translation } else { linear });
        for vector in &vectors {
            let coefficient = dot(parameter, vector) / step;
            if coefficient.abs() > 32_767.0 {
                return symbols;
            }
            symbols.push(coefficient.round() as i16);
        }
    }
    symbols
}

/// A generous estimate of what a track takes, bits.
fn size_bits(symbols: &[i16]) -> f64 {
    symbols.iter().filter(|&&s| s != 0).map(|&s| 3.0 + 1.6 * f64::from(s.unsigned_abs()).log2()).sum()
}

fn dot(a: &[f64], b: &[f64]) -> f64 {
    a.iter().zip(b).map(|(x, y)| x * y).sum()
}

fn root_mean_square(rows: &[Vec<f64>]) -> f64 {
    let count: usize = rows.iter().map(Vec::len).sum();
    let sum: f64 = rows.iter().map(|r| dot(r, r)).sum();
    (sum / count.max(1) as f64).sqrt()
}

/// Values of Gaussian `i` of a cell as the decoder gets them at level 3 (Rodrigues parameters
/// for rotation).
fn dequantised(cell: &CellSymbols, class: Class, i: usize, canonical: &Canonical) -> [f32; 3] {
    let (quant, origin) = (&canonical.quant, canonical.origin);
    let shape = &cell.shape;
    let (block, within) = (i / shape.block_len, i % shape.block_len);
    let n = shape.block_gaussians(block);
    let quantiser = quant.canonical[class.index()];
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
    out
}

fn coefficients(
    tracked: Tracked,
    cell: &CellSymbols,
    canonical: &Canonical,
    frames: usize,
    learned: &[Vec<f64>],
    cosines: &[Vec<f64>],
    tolerance: &[f64; Class::MOVING],
) -> (CellSymbols, u64) {
    let Tracked { mut motion, track, left, mut saturated } = tracked;
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
        let samples = (rows.len() * frames).max(1) as f64;
        let mut energy: f64 = rows.iter().map(|r| dot(r, r)).sum();
        let limit = tolerance[class.index()].powi(2) * samples;
        let mut rank = 0;
        while rank < vectors.len() && energy > limit {
            energy -= projections.iter().map(|p| p[rank] * p[rank]).sum::<f64>();
            rank += 1;
        }
        match class {
            Class::Position => motion.position = rank as u8,
            Class::Scale => motion.scale = rank as u8,
            Class::Rotation => motion.rotation = rank as u8,
            Class::Opacity => motion.opacity = rank as u8,
            _ => motion.sh0 = rank as u8,
        }
        projected[class.index()] = projections;
    }
    let quant = &canonical.quant;
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
