//! Leaves packets out of a stream, without decoding it: `dgs cut`.

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use codec_core::internals::{ids::Span, wire::manifest::Manifest};
use emulator_host::{PacketGraph, policy};
use serde_json::json;
use trainer_host::{
    Stream,
    stream::{PacketMap, SlicePlacement},
    utility::Table,
};

use crate::{
    args::Cut,
    files,
    output::VerbOutput,
    pipeline::{self, stored_utilities, utility_path},
};

/// Runs the verb.
pub fn run(args: &Cut) -> Result<VerbOutput> {
    files::check_stream(&args.out, &[&args.input])?;
    if args.levels.is_none() && args.frames.is_none() && args.bytes.is_none() {
        bail!("nothing to leave out: --levels, --frames or --bytes is needed");
    }
    let mut warnings = Vec::new();
    let stream = pipeline::read_stream(&args.input, &mut |w| warnings.push(w))?;
    let manifest = stream.manifest()?;
    let map = PacketMap::of(&stream)?;
    let frames = args.frames.map(|range| range.within(manifest.head().frames)).transpose()?;
    let mut stays: Vec<bool> = (0..stream.packets().len())
        .map(|id| {
            let wanted = |placement: &SlicePlacement| {
                let level = args.levels.is_none_or(|most| placement.group.level.get() <= most);
                level && frames.as_ref().is_none_or(|frames| shows(&manifest, placement, frames))
            };
            !stream.packets()[id].is_empty() && (map.is_parity(id) || map.placements(id).iter().any(wanted))
        })
        .collect();
    let beside = utility_path(&args.input);
    let damaged = !warnings.is_empty();
    let table = match stored_utilities(&beside, manifest.raw()) {
        Ok(table) => Some(table),
        Err(error) => {
            if beside.exists() {
                warnings.push(format!("{error:#}; they are not used"));
            }
            None
        }
    };
    let measured = table.as_ref().map(|_| std::fs::read(&beside)).transpose();
    let measured = measured.with_context(|| format!("{}: cannot read", beside.display()))?;
    let target = measured.as_ref().and_then(|bytes| beside_output(&args.out, bytes, &mut warnings));
    if let Some(target) = &target {
        files::check(target)?;
    }
    let mut ranking = None;
    if let Some(bytes) = args.bytes {
        let (order, by) = match &table {
            Some(table) => {
                let wanted = stream.with_packets(|id| stays[id]);
                (order_by_utility(&wanted, &map, table, frames.as_ref()), Ranking::Utility)
            }
            None => (order_by_level(&stream, &map), Ranking::Level),
        };
        if within(&stream, &order, &mut stays, bytes)? {
            ranking = Some(by);
        }
    }
    let there = stream.packets().iter().filter(|packet| !packet.is_empty()).count();
    if stays.iter().filter(|stays| **stays).count() < there {
        // Parity of a set that is not whole repairs what was left out on purpose, or nothing.
        (0..stays.len()).filter(|&id| map.is_parity(id)).for_each(|id| stays[id] = false);
    }
    let cut = stream.with_packets(|id| stays[id]);
    let left = stays.iter().filter(|stays| **stays).count();
    let bytes = match &table {
        Some(table) if left > 0 => pipeline::file_by_utility(&cut, table)?,
        _ => cut.to_bytes()?,
    };
    files::write(&args.out, &bytes)?;
    if let (Some(target), Some(bytes)) = (&target, &measured) {
        // They are of the groups that the manifest tells of, whatever packets are there.
        files::write(target, bytes)?;
    }
    let before = stream.to_bytes()?.len();
    let text = format!(
        "{} → {}: {left} of {there} packets, {} of {before} bytes{}\n",
        args.input.display(),
        args.out.display(),
        bytes.len(),
        ranking.map_or("", Ranking::sentence)
    );
    let json = json!({
        "input": files::shown(&args.input), "out": files::shown(&args.out), "packets": left, "packets_before": there,
        "bytes": bytes.len(), "bytes_before": before, "ranking": ranking.map(Ranking::name),
        "warnings": warnings,
    });
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// Where utilities are written beside `out`: nowhere beside a device, and never over others.
fn beside_output(out: &Path, bytes: &[u8], warnings: &mut Vec<String>) -> Option<PathBuf> {
    if std::fs::metadata(out).is_ok_and(|found| !found.is_file()) {
        return None;
    }
    let target = utility_path(out);
    match std::fs::read(&target) {
        Ok(there) if there == bytes => None,
        Ok(_) => {
            let name = target.display();
            warnings.push(format!("{name}: utilities of something else are there, and stay"));
            None
        }
        Err(_) => Some(target),
    }
}

/// Whether what a slice brings shows in any of `frames`.
fn shows(manifest: &Manifest<'_>, placement: &SlicePlacement, frames: &Range<u32>) -> bool {
    let (first, count) = match placement.group.span {
        Span::Canonical(id) => {
            manifest.epochs().nth(id.0.into()).map_or((0, 0), |epoch| (epoch.first_frame, epoch.frames))
        }
        Span::Motion(id) => manifest
            .windows()
            .nth(id.0.into())
            .map_or((0, 0), |window| (window.first_frame, u32::from(window.frames))),
    };
    first < frames.end && frames.start < first.saturating_add(count)
}

/// What decides which packets of too many stay.
#[derive(Clone, Copy, Debug)]
enum Ranking {
    Utility,
    Level,
}

impl Ranking {
    const fn name(self) -> &'static str {
        match self {
            Self::Utility => "utility",
            Self::Level => "level",
        }
    }

    const fn sentence(self) -> &'static str {
        match self {
            Self::Utility => ", by the utilities beside the input",
            Self::Level => ", lower levels first: no utilities beside the input (encode with --utility)",
        }
    }
}

/// Packets that are there by what each byte of them adds to `frames`, what each needs before it; those that
/// add nothing last.
fn order_by_utility(
    stream: &Stream,
    map: &PacketMap,
    table: &Table,
    frames: Option<&Range<u32>>,
) -> Vec<usize> {
    let graph = pipeline::ranked_graph(stream, map, table).and_then(|graph| shown_in(graph, frames));
    // Of a stream of which nothing shows, nothing is ranked.
    let mut order: Vec<usize> = graph.map_or_else(
        |_| Vec::new(),
        |graph| {
            policy::order_by_utility(&graph).iter().map(|packet| graph.wire_id(*packet).index()).collect()
        },
    );
    let mut is_ranked = vec![false; stream.packets().len()];
    order.iter().for_each(|&id| is_ranked[id] = true);
    order.extend(order_by_level(stream, map).into_iter().filter(|&id| !is_ranked[id]));
    order
}

/// The graph of which nothing but `frames` is shown.
fn shown_in(graph: PacketGraph, frames: Option<&Range<u32>>) -> Result<PacketGraph> {
    let Some(frames) = frames else { return Ok(graph) };
    let mut parts = graph.parts().clone();
    for group in &mut parts.groups {
        let (first, past) = (group.first_frame.max(frames.start), (group.last_frame + 1).min(frames.end));
        if first < past {
            (group.first_frame, group.last_frame) = (first, past - 1);
        } else {
            group.utility = 0.0;
        }
    }
    Ok(PacketGraph::new(parts)?)
}

/// Packets that are there by level, those of one level as they lie in the stream.
fn order_by_level(stream: &Stream, map: &PacketMap) -> Vec<usize> {
    let is_media = |&id: &usize| !stream.packets()[id].is_empty() && !map.is_parity(id);
    let mut order: Vec<usize> = (0..stream.packets().len()).filter(is_media).collect();
    let lowest = |id: usize| map.placements(id).iter().map(|placement| placement.group.level).min();
    order.sort_by_key(|&id| lowest(id).map_or(u8::MAX, |level| level.get()));
    order
}

/// Leaves packets out until the file has at most `bytes`: the last of `order` first. Parity goes with the
/// first that does. Whether any had to.
fn within(stream: &Stream, order: &[usize], stays: &mut [bool], bytes: u64) -> Result<bool> {
    let file =
        |stays: &[bool]| -> Result<u64> { Ok(stream.with_packets(|id| stays[id]).to_bytes()?.len() as u64) };
    if file(stays)? <= bytes {
        return Ok(false);
    }
    let order: Vec<usize> = order.iter().copied().filter(|&id| stays[id]).collect();
    // Files are never larger with fewer packets: halving finds how many fit.
    let first = |count: usize| {
        let mut some = vec![false; stays.len()];
        order[..count].iter().for_each(|&id| some[id] = true);
        some
    };
    let least = file(&first(0))?;
    if least > bytes {
        bail!("--bytes is {bytes}; at least {least} are needed, for the manifest alone");
    }
    let (mut fits, mut exceeds) = (0, order.len() + 1);
    while exceeds - fits > 1 {
        let middle = fits + (exceeds - fits) / 2;
        if file(&first(middle))? <= bytes { fits = middle } else { exceeds = middle }
    }
    let some = first(fits);
    stays.copy_from_slice(&some);
    Ok(true)
}
