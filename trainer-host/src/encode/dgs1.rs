//! Encoding in profile `dgs1`.

pub(super) mod canonical;
mod cut;
mod gauge;
mod motion;
mod need;
mod order;
pub(super) mod price;
mod proxy;
mod track;

use codec_core::internals::{
    gaussian::ShDegree,
    ids::{EpochId, Level, Span, WindowId},
    quant::Class,
    rans::lanes::{HEAD_BYTES, LEAST_PLANE_BYTES},
    wire::{
        manifest::{self, Head, Profile, Proxy, Quant, Repair, stream},
        packet::PARITY_OVERHEAD_BYTES,
    },
};
use rayon::prelude::*;

use super::{
    EncodeError, Encoded, Ledger, Options, Progress, Report, Share,
    ledger::{Section, manifest_parts},
    packet_id,
    packetise::{CellSymbols, Lot, Proto, each_run, packetise},
    parity, rate,
    statistics::{Model, Streams},
    strata::{Layer, Strata},
};
use crate::{
    cluster,
    scene::{Epoch, Scene},
    stream::Stream,
};

/// One epoch, quantised.
struct EpochPlan {
    record: manifest::Epoch,
    /// One per cluster.
    quants: Vec<Quant>,
    clusters: Vec<manifest::Cluster>,
    canonical: Vec<CellSymbols>,
    windows: Vec<WindowPlan>,
    proxies: Vec<Proxy>,
    order: Vec<u32>,
    saturated: u64,
}

/// One window, quantised.
struct WindowPlan {
    frames: usize,
    first_frame: usize,
    basis: Vec<Vec<i16>>,
    cells: Vec<CellSymbols>,
}

/// Encodes `scene`; see [`super::encode`].
pub(super) fn encode(
    scene: &Scene,
    options: &Options,
    strata: &Strata,
    progress: Progress<'_>,
) -> Result<Encoded, EncodeError> {
    let mut plans = plans(scene, options, strata, progress)?;
    cut::cut(&mut plans, &options.tops);
    progress("entropy-code", 0.0);
    let streams = streams(&plans);
    let model = streams.model(options.menu)?;
    progress("packetise", 0.0);
    let lots = lots(&plans);
    let strength = |lot: &Lot<'_>| options.repair.of(matches!(lot.span, Span::Motion(_)), lot.level);
    let limit = |lot: &Lot<'_>| match strength(lot) {
        Some(_) => options.packet_bytes - PARITY_OVERHEAD_BYTES,
        None => options.packet_bytes,
    };
    let protos: Result<Vec<Vec<Proto>>, EncodeError> =
        lots.par_iter().map(|lot| packetise(lot, &model, limit(lot))).collect();
    let protos = protos?;

    let mut packets = Vec::new();
    let mut repairs = Vec::new();
    let mut ledger = ledger(scene, &plans, &streams, &model);
    for (lot, protos) in lots.iter().zip(&protos) {
        let first_packet = packets.len();
        for proto in protos {
            let bytes = proto.write(packet_id(packets.len())?)?;
            ledger.payload += proto.body_len() as f64;
            ledger.lane_heads += HEAD_BYTES as f64;
            ledger.headers += (bytes.len() - proto.body_len() - 4) as f64;
            ledger.crc += 4.0;
            packets.push(bytes);
        }
        repairs.extend(strength(lot).and_then(|s| s.range(first_packet, &packets[first_packet..])));
    }
    ledger.packets = packets.len() as u64;
    parity::append(&mut repairs, &mut packets, &mut ledger)?;
    let (raw, sections) = body(scene, &plans, &model, &repairs, packets.len(), options);
    let stream = Stream::new(raw, packets)?;
    ledger.manifest = stream.message().len() as f64;
    ledger.manifest_parts = manifest_parts(stream.manifest()?.raw(), &sections, stream.message().len())?;
    let order = plans.into_iter().map(|p| p.order).collect();
    let report = Report {
        ledger,
        quality: options.quality,
        quantiser_classes: strata.shares(&options.quality),
        reached: None,
        searched: None,
    };
    Ok(Encoded { stream, report, order })
}

/// The epochs of `scene`, quantised.
fn plans(
    scene: &Scene,
    options: &Options,
    strata: &Strata,
    progress: Progress<'_>,
) -> Result<Vec<EpochPlan>, EncodeError> {
    let mut plans = Vec::new();
    let mut first_frame = 0;
    for (e, epoch) in scene.epochs().iter().enumerate() {
        progress("cluster", e as f64 / scene.epochs().len() as f64);
        let layer = &strata.layer(e, &options.quality);
        let mut sets = layer.sets.to_vec();
        if !options.keep_invisible {
            sets = need::drawn(epoch, sets);
        }
        let epoch = &gauge::reduced(epoch, &sets, form(epoch, &sets, layer, scene, options)?);
        let members = members(epoch, sets, layer, options)?;
        progress("factorise", e as f64 / scene.epochs().len() as f64);
        let canonical = canonical::quantise(epoch, &members, layer, options)?;
        let windows = motion::quantise(epoch, first_frame, &members, &canonical, scene, options)?;
        let proxies = if options.proxies { proxy::proxies(epoch, &members, &canonical) } else { Vec::new() };
        plans.push(plan(epoch.frames(), first_frame, members, canonical, windows, proxies));
        first_frame += epoch.frames();
    }
    Ok(plans)
}

/// Clusters that a trial takes, about.
const TRIAL: usize = 16;

/// The form of rotations and scales that takes the fewest bits in a trial on some clusters.
fn form(
    epoch: &Epoch,
    sets: &[Vec<u32>],
    layer: &Layer<'_>,
    scene: &Scene,
    options: &Options,
) -> Result<gauge::Form, EncodeError> {
    let some: Vec<Vec<u32>> = sets.iter().step_by((sets.len() / TRIAL).max(1)).cloned().collect();
    let mut best = (f64::INFINITY, gauge::Form::AsIs);
    for &form in gauge::Form::candidates(epoch) {
        let epoch = gauge::reduced(epoch, &some, form);
        let members = members(&epoch, some.clone(), layer, options)?;
        let canonical = canonical::quantise(&epoch, &members, layer, options)?;
        let (windows, _) = motion::quantise(&epoch, 0, &members, &canonical, scene, options)?;
        let mut streams = Streams::default();
        for cell in canonical.cells.iter().chain(windows.iter().flat_map(|w| &w.cells)) {
            runs(cell, |level, stream, symbols| {
                // Tracks do not depend on the form.
                if !cell.shape.is_whole(level) {
                    streams.add(stream, symbols);
                }
            });
        }
        let bits = streams.entropy_bits();
        if bits < best.0 {
            best = (bits, form);
        }
    }
    Ok(best.1)
}

/// The Gaussians of each cluster in the order in which they are sent.
fn members(
    epoch: &Epoch,
    sets: Vec<Vec<u32>>,
    layer: &Layer<'_>,
    options: &Options,
) -> Result<Vec<Vec<u32>>, EncodeError> {
    let positions = epoch.attributes().positions.frame(0, epoch.count());
    let sets: Vec<Vec<u32>> =
        sets.into_par_iter().map(|set| cluster::block_order(&set, positions, options.block_len)).collect();
    let (quants, origin) = canonical::plain(epoch, &sets, layer, options)?;
    Ok(order::arrange(epoch, sets, |set| &quants[layer.of(set)], origin, options.block_len))
}

fn plan(
    frames: usize,
    first_frame: usize,
    members: Vec<Vec<u32>>,
    canonical: canonical::Canonical,
    (windows, saturated): (Vec<WindowPlan>, u64),
    proxies: Vec<Proxy>,
) -> EpochPlan {
    let [origin_x, origin_y, origin_z] = canonical.origin;
    let order: Vec<u32> = members.concat();
    EpochPlan {
        record: manifest::Epoch {
            first_frame: first_frame as u32,
            frames: frames as u32,
            gaussians: order.len() as u32,
            clusters: members.len() as u32,
            windows: windows.len() as u32,
            origin_x,
            origin_y,
            origin_z,
            ..manifest::Epoch::default()
        },
        quants: canonical.cells.iter().map(|c| c.shape.quant).collect(),
        clusters: canonical.cells.iter().map(|c| c.shape.cluster).collect(),
        canonical: canonical.cells,
        windows,
        proxies,
        order,
        saturated: saturated + canonical.saturated,
    }
}

/// All cells with their spans, canonical cells of an epoch before its windows.
fn spans(plans: &[EpochPlan]) -> impl Iterator<Item = (Span, &[CellSymbols])> {
    let mut window = 0u16;
    plans.iter().enumerate().flat_map(move |(e, plan)| {
        let canonical = (Span::Canonical(EpochId(e as u16)), plan.canonical.as_slice());
        let first = window;
        window += plan.windows.len() as u16;
        let motion = plan
            .windows
            .iter()
            .enumerate()
            .map(move |(w, window)| (Span::Motion(WindowId(first + w as u16)), window.cells.as_slice()));
        std::iter::once(canonical).chain(motion)
    })
}

/// What is packed together, in nominal sending order: per epoch the base of everything, then
/// level by level.
fn lots(plans: &[EpochPlan]) -> Vec<Lot<'_>> {
    let mut lots = Vec::new();
    let mut spans = spans(plans).peekable();
    while let Some(first) = spans.next() {
        let mut epoch = vec![first];
        while let Some(next) = spans.next_if(|(span, _)| matches!(span, Span::Motion(_))) {
            epoch.push(next);
        }
        for level in Level::ALL {
            lots.extend(epoch.iter().map(|&(span, cells)| Lot { span, level, cells }));
        }
    }
    lots
}

/// Calls `run` with level, stream and symbols of each run of a cell.
fn runs<'c>(cell: &'c CellSymbols, mut run: impl FnMut(Level, usize, &'c [i16])) {
    for level in Level::ALL {
        if cell.shape.level_len(level) > 0 {
            each_run(cell, level, 0..cell.shape.blocks(), |stream, symbols| run(level, stream, symbols));
        }
    }
}

fn streams(plans: &[EpochPlan]) -> Streams<'_> {
    let mut streams = Streams::default();
    for (_, cells) in spans(plans) {
        cells.iter().for_each(|cell| runs(cell, |_, stream, symbols| streams.add(stream, symbols)));
    }
    streams
}

fn ledger(scene: &Scene, plans: &[EpochPlan], streams: &Streams<'_>, model: &Model) -> Ledger {
    let names = ["position", "scale", "rotation", "opacity", "sh0", "sh1", "sh2", "sh3"];
    let moving = ["position motion", "scale motion", "rotation motion", "opacity motion", "sh0 motion"];
    let gaussians = scene.epochs().iter().map(|e| e.count() as u64).sum();
    let mut ledger = Ledger {
        gaussians,
        invisible: gaussians - plans.iter().map(|p| p.order.len() as u64).sum::<u64>(),
        frames: scene.frames() as u64,
        saturated: plans.iter().map(|p| p.saturated).sum(),
        ..Ledger::default()
    };
    let name = |stream: usize| -> &'static str {
        match stream::attribute(stream) {
            (None, _) => "track",
            (Some(class), true) => moving[class.index() % Class::MOVING],
            (Some(class), false) => names[class.index()],
        }
    };
    for (_, cells) in spans(plans) {
        for cell in cells {
            runs(cell, |level, stream, symbols| {
                let (choice, bits) = model.choose(stream, symbols);
                let (_, _, code_bits) = model.code(stream, choice);
                let bits = bits - f64::from(code_bits);
                ledger.selectors += f64::from(code_bits) / 8.0;
                ledger.symbols += symbols.len() as u64;
                let (attribute, level) = (name(stream), level.get());
                let found = ledger.shares.iter_mut().find(|s| s.attribute == attribute && s.level == level);
                match found {
                    Some(share) => share.bits += bits,
                    None => ledger.shares.push(Share { attribute, level, bits }),
                }
            });
        }
    }
    ledger.raw_symbols = 2.0 * ledger.symbols as f64;
    ledger.empirical_entropy = streams.entropy_bits() / 8.0;
    let bits: f64 = ledger.shares.iter().map(|s| s.bits).sum();
    ledger.monolithic = (bits / 8.0 + ledger.selectors).ceil() + (HEAD_BYTES + LEAST_PLANE_BYTES) as f64;
    ledger
}

/// The unpacked manifest body, and where its sections begin.
fn body(
    scene: &Scene,
    plans: &[EpochPlan],
    model: &Model,
    repairs: &[Repair],
    packets: usize,
    options: &Options,
) -> (Vec<u8>, Vec<Section>) {
    let windows: usize = plans.iter().map(|p| p.windows.len()).sum();
    let clusters: usize = plans.iter().map(|p| p.clusters.len()).sum();
    let degree = scene.epochs().iter().map(|e| e.attributes().sh_degree).max().unwrap_or(ShDegree::ZERO);
    let (rate_frames, rate_seconds) = rate(scene);
    let distinct = distinct(plans.iter().flat_map(|p| &p.quants));
    let mut out = Vec::new();
    let basis_values = plans
        .iter()
        .flat_map(|p| &p.windows)
        .map(|w| w.basis.iter().map(Vec::len).sum::<usize>())
        .sum::<usize>();
    let head = Head {
        profile: Profile::Dgs1 as u8,
        sh_degree: degree.get(),
        block_len: options.block_len as u16,
        frames: scene.frames() as u32,
        rate_frames,
        rate_seconds,
        packets: packets as u32,
        epochs: plans.len() as u16,
        windows: windows as u16,
        clusters: clusters as u32,
        quants: distinct.len() as u16,
        tables: model.tables.len() as u16,
        repairs: repairs.len() as u16,
        proxies: options.proxies.into(),
        basis_values: basis_values as u32,
        transform_values: 0,
    };
    let mut sections = Vec::new();
    sections.push(("head, epochs, windows", out.len()));
    out.extend(head.to_bytes());
    let (mut first_cluster, mut first_window) = (0, 0);
    for plan in plans {
        out.extend(manifest::Epoch { first_cluster, first_window, ..plan.record }.to_bytes());
        first_cluster += plan.record.clusters;
        first_window += plan.record.windows;
    }
    let (mut first_cell, mut basis_first) = (0u32, 0u32);
    for (e, plan) in plans.iter().enumerate() {
        for window in &plan.windows {
            let record = manifest::Window {
                epoch: e as u16,
                frames: window.frames as u16,
                first_frame: window.first_frame as u32,
                first_cell,
                basis_first,
                rank: window.basis.len() as u8,
            };
            out.extend(record.to_bytes());
            first_cell += plan.record.clusters;
            basis_first += (window.basis.len() * window.frames) as u32;
        }
    }
    sections.push(("clusters", out.len()));
    for plan in plans {
        for (cluster, quant) in plan.clusters.iter().zip(&plan.quants) {
            let quant = distinct.iter().position(|q| q == quant).unwrap_or(0) as u8;
            out.extend(manifest::Cluster { quant, ..*cluster }.to_bytes());
        }
    }
    sections.push(("motions", out.len()));
    for window in plans.iter().flat_map(|p| &p.windows) {
        window.cells.iter().for_each(|cell| out.extend(cell.shape.motion.to_bytes()));
    }
    sections.push(("quantisers", out.len()));
    distinct.iter().for_each(|q| q.write(|bytes| out.extend_from_slice(bytes)));
    sections.push(("menus", out.len()));
    model.menus.iter().for_each(|menu| out.extend(menu.to_bytes()));
    sections.push(("repair ranges", out.len()));
    repairs.iter().for_each(|r| out.extend(r.to_bytes()));
    sections.push(("basis", out.len()));
    for vector in plans.iter().flat_map(|p| &p.windows).flat_map(|w| &w.basis) {
        vector.iter().for_each(|v| out.extend(v.to_le_bytes()));
    }
    sections.push(("proxies", out.len()));
    for plane in 0..Proxy::BYTES {
        out.extend(plans.iter().flat_map(|p| &p.proxies).map(|p| p.to_bytes()[plane]));
    }
    sections.push(("tables", out.len()));
    model.tables.iter().for_each(|t| t.write(|bytes| out.extend_from_slice(bytes)));
    (out, sections)
}

/// Distinct quantisation profiles, in order of appearance. Steps lie on a coarse ladder, so even
/// long sequences have few; over 256 the manifest's own check refuses the stream.
fn distinct<'q>(quants: impl Iterator<Item = &'q Quant>) -> Vec<Quant> {
    let mut distinct: Vec<Quant> = Vec::new();
    for quant in quants {
        if !distinct.contains(quant) {
            distinct.push(*quant);
        }
    }
    distinct
}
