//! Encodes in profile `paper`: the baseline, as the paper describes it.
//!
//! Equation 1 with one f32 affine per cluster and frame in the manifest, a shared basis of rank
//! R, i16 residuals δ2 and δ3 per frame, attributes as a static base plus three per-frame
//! refinement planes, byte-wise rANS with a table pair per group or the context coder, chunks of at
//! most 1200 bytes, one dependency word per refinement.

mod chunks;
mod plan;

use codec_core::internals::{
    ids::Level,
    limits,
    wire::manifest::{self, ChunkCoder, Cluster, Head, Quant, Repair},
};
use rayon::prelude::*;

use self::{
    chunks::{Group, groups},
    plan::{Cell, EpochPlan, plan, quant_index},
};
use super::{
    Analysis, EncodeError, EncodeOptions, Encoded, Ledger, Progress, Report,
    decisions::{DecisionInputs, Decisions, PaperDecisions, PaperEpochDecisions, Quantisers},
    ledger::{Section, manifest_parts},
    packetise::packet_id,
    parity,
    progress::report,
    steps::{self, Grid},
};
use crate::{
    scene::{Epoch, Scene},
    stream::Stream,
};

/// Decides clusters, quantisers and rank of every epoch: all that the paper leaves open.
///
/// # Errors
/// Steps that the format does not hold.
pub(super) fn decide(
    analysis: &Analysis<'_>,
    options: &EncodeOptions,
    progress: Progress<'_>,
) -> Result<PaperDecisions, EncodeError> {
    let mut epochs: Vec<PaperEpochDecisions> = Vec::new();
    for (epoch, clusters) in analysis.scene.epochs().iter().zip(analysis.classes.clusters()) {
        report(progress, "decide", epochs.len() as f64 / analysis.scene.epochs().len() as f64)?;
        let grid = Grid::of(epoch, 1.0);
        let quant = steps::paper(&options.quality, grid.step(&options.quality))?;
        epochs.push(PaperEpochDecisions {
            origin: grid.origin,
            quantisers: Quantisers::of(&quant),
            rank: options.rank,
            clusters: clusters.clone(),
        });
    }
    let made_from = DecisionInputs {
        quality: options.quality,
        quantiser_classes: Vec::new(),
        clustering: options.cluster,
        epoch_gaussians: analysis.scene.epochs().iter().map(Epoch::count).collect(),
    };
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
        report(progress, "factorise", 0.4 * e as f64 / scene.epochs().len() as f64)?;
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
    report(progress, "entropy-code", 0.4)?;
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

    report(progress, "packetise", 0.8)?;
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

fn body(
    scene: &Scene,
    plans: &[EpochPlan],
    groups: &[[Group; Level::COUNT]],
    quants: &[Quant],
    repairs: &[Repair],
    packets: usize,
    coder: ChunkCoder,
) -> (Vec<u8>, Vec<Section>) {
    let (rate_frames, rate_seconds) = scene.frame_rate();
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
        drawing: scene.footprint as u8 | (scene.up as u8) << 4,
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
