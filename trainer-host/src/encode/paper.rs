//! Encode in profile `paper`: the baseline, as the paper describes it.
//!
//! Equation 1 with one f32 affine per cluster and frame in the manifest, a shared basis of rank
//! R, i16 residuals δ2 and δ3 per frame, attributes as a static base plus three per-frame
//! refinement planes, byte-wise rANS with a table pair per group or the context coder, chunks of at
//! most 1200 bytes, one dependency word per refinement.

mod chunks;

use codec_core::internals::{
    ids::Level,
    layout::paper as layout,
    limits,
    quant::Class,
    wire::manifest::{self, ChunkCoder, Cluster, Head, Quant, Repair},
};
use rayon::prelude::*;

use super::{
    Analysis, EncodeError, Encoded, Ledger, Options, Progress, Report,
    decisions::{Decisions, MadeFrom, PaperDecisions, PaperEpochDecisions, Quantisers},
    factorise::{fit_pose, mean_turn, temporal_basis},
    ledger::{Section, manifest_parts},
    packet_id, parity, rate,
    steps::{self, Grid},
};
use crate::{
    scene::{Epoch, Scene},
    stream::Stream,
};
use chunks::{Group, groups};

/// One epoch, quantised.
struct EpochPlan {
    first_frame: usize,
    frames: usize,
    origin: [f32; 3],
    quant: Quant,
    /// Frame-major, `frames × rank`.
    basis: Vec<f32>,
    rank: usize,
    members: Vec<Vec<u32>>,
    cells: Vec<Cell>,
}

/// One cluster: transforms (frames × 12) and the symbols of its four groups.
struct Cell {
    transforms: Vec<f32>,
    levels: [Vec<i16>; Level::COUNT],
    saturated: u64,
}

/// Decides clusters, quantisers and rank of every epoch: all that the paper leaves open.
///
/// # Errors
/// Steps that the format does not hold.
pub(super) fn decide(
    analysis: &Analysis<'_>,
    options: &Options,
    progress: Progress<'_>,
) -> Result<PaperDecisions, EncodeError> {
    progress("decide", 0.0);
    let mut epochs = Vec::new();
    for (epoch, clusters) in analysis.scene.epochs().iter().zip(analysis.classes.clusters()) {
        let grid = Grid::of(epoch, 1.0);
        let quant = steps::paper(&options.quality, grid.step(&options.quality))?;
        epochs.push(PaperEpochDecisions {
            origin: grid.origin,
            quantisers: Quantisers::of(&quant),
            rank: options.rank,
            clusters: clusters.clone(),
        });
    }
    let made_from =
        MadeFrom { quality: options.quality, quantiser_classes: Vec::new(), clustering: options.cluster };
    Ok(PaperDecisions { made_from, repair: options.repair, context_coder: options.context_coder, epochs })
}

/// Writes `scene` as `decisions`, which have been checked against it, say.
///
/// # Errors
/// What the format refuses.
pub(super) fn write(
    scene: &Scene,
    decisions: &PaperDecisions,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let mut plans = Vec::new();
    let mut first_frame = 0;
    for (e, (epoch, decided)) in scene.epochs().iter().zip(&decisions.epochs).enumerate() {
        progress("factorise", e as f64 / scene.epochs().len() as f64);
        plans.push(plan(epoch, first_frame, decided)?);
        first_frame += epoch.frames();
    }
    let frames = first_frame;
    if frames > usize::from(u16::MAX) {
        return Err(EncodeError::Bound { what: "frames in profile paper", found: frames, most: 65_535 });
    }
    let clusters: usize = plans.iter().map(|p| p.cells.len()).sum();
    if clusters > usize::from(u16::MAX) {
        return Err(EncodeError::Bound { what: "clusters in profile paper", found: clusters, most: 65_535 });
    }
    progress("entropy-code", 0.0);
    let mut quants: Vec<Quant> = Vec::new();
    for plan in &plans {
        if !quants.contains(&plan.quant) {
            quants.push(plan.quant);
        }
    }
    let cells: Vec<(&EpochPlan, &Cell)> =
        plans.iter().flat_map(|p| p.cells.iter().map(move |c| (p, c))).collect();
    let groups: Result<Vec<[Group; Level::COUNT]>, EncodeError> = cells
        .par_iter()
        .enumerate()
        .map(|(c, (plan, cell))| groups(c, plan, cell, &quants, decisions))
        .collect();
    let groups = groups?;

    progress("packetise", 0.0);
    let mut ledger = Ledger {
        gaussians: scene.epochs().iter().map(|e| e.count() as u64).sum(),
        frames: scene.frames() as u64,
        saturated: cells.iter().map(|(_, c)| c.saturated).sum(),
        ..Ledger::default()
    };
    let mut packets = Vec::new();
    let mut repairs = Vec::new();
    let mut start = 0;
    for plan in &plans {
        let groups = &groups[start..start + plan.cells.len()];
        start += plan.cells.len();
        for level in Level::ALL {
            let first_packet = packets.len();
            for group in groups.iter().map(|g| &g[level.index()]) {
                ledger.symbols += group.symbols as u64;
                ledger.empirical_entropy += group.entropy_bytes;
                ledger.monolithic += group.monolithic as f64;
                for chunk in &group.chunks {
                    let id = packet_id(packets.len())?;
                    let mut bytes = vec![0u8; limits::MAX_PACKET_BYTES];
                    let len = chunk.packet(id).write(&mut bytes)?;
                    bytes.truncate(len);
                    let words = 4 * chunk.packet(id).dependencies.len();
                    ledger.payload += chunk.payload.len() as f64;
                    ledger.headers += codec_core::internals::wire::packet::CHUNK_HEADER_BYTES as f64;
                    ledger.dependencies += words as f64;
                    ledger.crc += 4.0;
                    packets.push(bytes);
                }
            }
            let strength = decisions.repair.of(false, level);
            repairs.extend(strength.and_then(|s| s.range(first_packet, &packets[first_packet..])));
        }
    }
    ledger.raw_symbols = 2.0 * ledger.symbols as f64;
    ledger.packets = packets.len() as u64;
    parity::append(&mut repairs, &mut packets, &mut ledger)?;
    let coder = if decisions.context_coder { ChunkCoder::Context } else { ChunkCoder::Tables };
    let (raw, sections) = body(scene, &plans, &groups, &quants, &repairs, packets.len(), coder);
    let stream = Stream::new(raw, packets)?;
    ledger.manifest = stream.message().len() as f64;
    ledger.manifest_parts = manifest_parts(stream.manifest()?.raw(), &sections, stream.message().len())?;
    let order = plans.iter().map(|p| p.members.concat()).collect();
    let decisions = Decisions::Paper(decisions.clone());
    let report = Report::of(ledger, &decisions);
    Ok(Encoded { stream, report, order, decisions })
}

fn plan(epoch: &Epoch, first_frame: usize, decided: &PaperEpochDecisions) -> Result<EpochPlan, EncodeError> {
    let (members, origin) = (decided.clusters.clone(), decided.origin);
    let quant = decided.quantisers.quant()?;
    let (n, frames, a) = (epoch.count(), epoch.frames(), epoch.attributes());
    let position = quant.canonical[Class::Position.index()];
    let step = position.step(Level::ALL[3]);
    let index = |i: usize, d: usize| {
        position.index(a.positions.frame(0, n)[i][d] - origin[d]).clamp(-32_768, 32_767) as i16
    };
    let still = |i: usize| [0, 1, 2].map(|d| origin[d] + f32::from(index(i, d)) * step);

    // Affine per cluster and frame, absolute coordinates as in equation 1, and what it leaves.
    let fits: Vec<(Vec<f32>, Vec<Vec<f64>>)> = members
        .par_iter()
        .map(|members| {
            let p0: Vec<[f32; 3]> = members.iter().map(|&i| still(i as usize)).collect();
            let before: Vec<[f32; 4]> =
                members.iter().map(|&i| a.rotations.frame(0, n)[i as usize]).collect();
            let wide: Vec<[f64; 3]> = p0.iter().map(|p| p.map(f64::from)).collect();
            let count = wide.len().max(1) as f64;
            let centre = [0, 1, 2].map(|d| wide.iter().map(|p| p[d]).sum::<f64>() / count);
            let mut transforms = Vec::with_capacity(frames * 12);
            let mut left: Vec<Vec<f64>> = vec![Vec::new(); members.len() * 3];
            let mut turn = [1.0, 0.0, 0.0, 0.0];
            for t in 0..frames {
                let truth = a.positions.frame(t, n);
                let target: Vec<[f64; 3]> =
                    members.iter().map(|&i| truth[i as usize].map(f64::from)).collect();
                let after: Vec<[f32; 4]> =
                    members.iter().map(|&i| a.rotations.frame(t, n)[i as usize]).collect();
                turn = mean_turn(&before, &after, turn);
                let fit = fit_pose(&wide, &target, centre, turn);
                let c = nalgebra::Vector3::from(centre);
                let shift = c + fit.translation - fit.linear * c;
                let start = transforms.len();
                for row in 0..3 {
                    (0..3).for_each(|column| transforms.push(fit.linear[(row, column)] as f32));
                    transforms.push(shift[row] as f32);
                }
                let at = &transforms[start..];
                for (i, (p, x)) in p0.iter().zip(&target).enumerate() {
                    for d in 0..3 {
                        let row = &at[4 * d..4 * d + 4];
                        let moved = row[0] * p[0] + row[1] * p[1] + row[2] * p[2] + row[3];
                        left[3 * i + d].push(x[d] - f64::from(moved));
                    }
                }
            }
            (transforms, left)
        })
        .collect();
    let rank = decided.rank.min(frames);
    let rows = fits.iter().flat_map(|(_, left)| left).map(Vec::as_slice);
    let (vectors, _) = temporal_basis(rows, frames, rank);
    let rank = vectors.len();
    let basis: Vec<f32> = (0..frames).flat_map(|t| vectors.iter().map(move |v| v[t] as f32)).collect();
    let cells = fits
        .into_par_iter()
        .zip(&members)
        .map(|((transforms, left), members)| {
            symbols(epoch, members, &quant, &index, transforms, &left, &basis, rank)
        })
        .collect();
    Ok(EpochPlan { first_frame, frames, origin, quant, basis, rank, members, cells })
}

/// Symbols of one cluster in the order of [`layout`].
#[allow(clippy::too_many_arguments)]
fn symbols(
    epoch: &Epoch,
    members: &[u32],
    quant: &Quant,
    index: &(dyn Fn(usize, usize) -> i16 + Sync),
    transforms: Vec<f32>,
    left: &[Vec<f64>],
    basis: &[f32],
    rank: usize,
) -> Cell {
    let (count, frames, a) = (epoch.count(), epoch.frames(), epoch.attributes());
    let n = members.len();
    let mut saturated = 0u64;
    let mut quantise = |value: f64, step: f32| -> i16 {
        let q = (value / f64::from(step)).round();
        if q.abs() > 32_767.0 {
            saturated += 1;
        }
        q.clamp(-32_768.0, 32_767.0) as i16
    };
    let rest = a.sh_degree.rest_len();
    let sizes = layout::symbols(n, frames, rank, rest);
    let mut levels: [Vec<i16>; Level::COUNT] = sizes.map(|len| vec![0; len]);
    let attribute = |t: usize, i: usize, c: usize| -> f64 {
        let g = members[i] as usize;
        f64::from(match c {
            0..=2 => a.log_scales.frame(t, count)[g][c],
            3..=6 => a.rotations.frame(t, count)[g][c - 3],
            7 => 1.0 / (1.0 + (-a.opacity_logits.frame(t, count)[g]).exp()),
            _ => a.sh0.frame(t, count)[g][c - 8],
        })
    };
    let class = |c: usize| match c {
        0..=2 => Class::Scale,
        3..=6 => Class::Rotation,
        7 => Class::Opacity,
        _ => Class::Sh0,
    };
    for (i, &g) in members.iter().enumerate() {
        for d in 0..3 {
            levels[0][d * n + i] = index(g as usize, d);
        }
    }
    let motion = quant.motion[Class::Position.index()];
    let steps = [1, 2, 3].map(|l| motion.step(Level::ALL[l]));
    for (row, left) in left.iter().enumerate() {
        let (i, d) = (row / 3, row % 3);
        let mut after = left.clone();
        for r in 0..rank {
            let q: f64 = (0..frames).map(|t| left[t] * f64::from(basis[t * rank + r])).sum();
            let symbol = quantise(q, steps[0]);
            levels[1][(3 * r + d) * n + i] = symbol;
            let sent = f64::from(f32::from(symbol) * steps[0]);
            (0..frames).for_each(|t| after[t] -= sent * f64::from(basis[t * rank + r]));
        }
        for (t, value) in after.iter().enumerate() {
            let at = (t * (3 + layout::ATTRIBUTES) + d) * n + i;
            let coarse = quantise(*value, steps[1]);
            levels[2][at] = coarse;
            levels[3][at] = quantise(value - f64::from(f32::from(coarse) * steps[1]), steps[2]);
        }
    }
    let refinement1 = layout::refinement1(n, rank);
    for c in 0..layout::ATTRIBUTES {
        let quantiser = quant.canonical[class(c).index()];
        let steps = Level::ALL.map(|l| quantiser.step(l));
        for i in 0..n {
            let base = quantise(attribute(0, i, c), steps[0]);
            levels[0][(3 + c) * n + i] = base;
            let base = f64::from(f32::from(base) * steps[0]);
            // Quaternion signs may flip between frames; refinements follow the base's.
            let start = attribute(0, i, 3) * attribute(0, i, 3);
            for t in 0..frames {
                let mut value = attribute(t, i, c);
                if (3..=6).contains(&c) && start >= 0.0 {
                    let dot: f64 = (3..=6).map(|k| attribute(0, i, k) * attribute(t, i, k)).sum();
                    value *= if dot < 0.0 { -1.0 } else { 1.0 };
                }
                let mut rest = value - base;
                for level in 1..=3 {
                    let symbol = quantise(rest, steps[level]);
                    rest -= f64::from(f32::from(symbol) * steps[level]);
                    let at = match level {
                        1 => refinement1 + (t * layout::ATTRIBUTES + c) * n + i,
                        _ => (t * (3 + layout::ATTRIBUTES) + 3 + c) * n + i,
                    };
                    levels[level][at] = symbol;
                }
            }
        }
    }
    let step = quant.canonical[Class::Sh1.index()].step(Level::ALL[3]);
    let offset = layout::rest(n, frames, rank);
    for (i, &g) in members.iter().enumerate() {
        for j in 0..rest {
            let value = a.sh_rest[g as usize * rest + j];
            levels[1][offset + j * n + i] = quantise(f64::from(value), step);
        }
    }
    Cell { transforms, levels, saturated }
}

/// The quantisation profile of an epoch; the manifest's check refuses more than 256 of them.
fn quant_index(quants: &[Quant], plan: &EpochPlan) -> u8 {
    quants.iter().position(|q| *q == plan.quant).unwrap_or(0).min(255) as u8
}

fn body(
    scene: &Scene,
    plans: &[EpochPlan],
    groups: &[[Group; Level::COUNT]],
    quants: &[Quant],
    repairs: &[Repair],
    packets: usize,
    coder: ChunkCoder,
) -> (Vec<u8>, Vec<Section>) {
    let (rate_frames, rate_seconds) = rate(scene);
    let degree = scene.epochs().iter().map(|e| e.attributes().sh_degree.get()).max().unwrap_or(0);
    let head = Head {
        profile: coder.profile_number(),
        sh_degree: degree,
        block_len: 64,
        frames: scene.frames() as u32,
        rate_frames,
        rate_seconds,
        packets: packets as u32,
        epochs: plans.len() as u16,
        windows: 0,
        clusters: plans.iter().map(|p| p.cells.len() as u32).sum(),
        quants: quants.len() as u16,
        tables: 0,
        repairs: repairs.len() as u16,
        proxies: 0,
        basis_values: plans.iter().map(|p| p.basis.len() as u32).sum(),
        transform_values: plans.iter().flat_map(|p| &p.cells).map(|c| c.transforms.len() as u32).sum(),
    };
    let (mut out, mut sections) = (Vec::new(), Vec::new());
    sections.push(("head, epochs", out.len()));
    out.extend(head.to_bytes());
    let (mut first_cluster, mut basis_first, mut transform_first) = (0, 0, 0);
    for plan in plans {
        let record = manifest::Epoch {
            first_frame: plan.first_frame as u32,
            frames: plan.frames as u32,
            gaussians: plan.members.iter().map(|m| m.len() as u32).sum(),
            first_cluster,
            clusters: plan.cells.len() as u32,
            first_window: 0,
            windows: 0,
            origin_x: plan.origin[0],
            origin_y: plan.origin[1],
            origin_z: plan.origin[2],
            basis_first,
            transform_first,
            rank: plan.rank as u8,
        };
        out.extend(record.to_bytes());
        first_cluster += record.clusters;
        basis_first += plan.basis.len() as u32;
        transform_first += plan.cells.iter().map(|c| c.transforms.len() as u32).sum::<u32>();
    }
    sections.push(("clusters", out.len()));
    for (plan, epoch) in plans.iter().zip(scene.epochs()) {
        let quant = quant_index(quants, plan);
        for members in &plan.members {
            let record = Cluster {
                gaussians: members.len() as u16,
                quant,
                kind: Cluster::kind_of(epoch.attributes().sh_degree.get(), Level::ALL[3]),
                radius: 1,
                ..Cluster::default()
            };
            out.extend(record.to_bytes());
        }
    }
    sections.push(("quantisers", out.len()));
    quants.iter().for_each(|q| q.write(|bytes| out.extend_from_slice(bytes)));
    sections.push(("repair ranges", out.len()));
    repairs.iter().for_each(|r| out.extend(r.to_bytes()));
    sections.push(("basis", out.len()));
    plans.iter().flat_map(|p| &p.basis).for_each(|v| out.extend(v.to_le_bytes()));
    sections.push(("transforms", out.len()));
    for cell in plans.iter().flat_map(|p| &p.cells) {
        cell.transforms.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    sections.push(("tables", out.len()));
    for table in groups.iter().flatten().flat_map(|g| &g.tables).flatten() {
        out.extend(table.to_bytes());
    }
    (out, sections)
}
