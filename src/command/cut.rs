//! Leaves packets out of a stream, without decoding it: `dgs cut`.

mod budget;
mod parity;
mod windows;

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, bail};
use codec_core::internals::wire::manifest::Manifest;
use serde_json::json;
use trainer_host::stream::{PacketMap, SlicePlacement};

use crate::{
    args::Cut,
    figures::counted,
    files,
    output::VerbOutput,
    pipeline::{self, stored_utilities, utility_path},
};

/// Runs the verb.
pub fn run(args: &Cut) -> Result<VerbOutput> {
    files::check_stream(&args.out, &[&args.input])?;
    let is_ordered = args.by_window || args.live;
    if args.levels.is_none() && args.frames.is_none() && args.bytes.is_none() && !is_ordered {
        bail!(
            "nothing to leave out or to order: --levels, --frames, --bytes, --by-window or --live is needed"
        );
    }
    if args.live && !files::is_standard_output(&args.out) {
        bail!("{}: --live writes to standard output; - is allowed", args.out.display());
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
    parity::only_of_whole_sets(&manifest, &stream, &mut stays);
    let mut ranking = None;
    if let Some(bytes) = args.bytes {
        let (order, by) = match &table {
            Some(table) => {
                let wanted = stream.with_packets(|id| stays[id]);
                (budget::order_by_utility(&wanted, &map, table, frames.as_ref()), Ranking::Utility)
            }
            None => (budget::order_by_level(&stream, &map), Ranking::Level),
        };
        if budget::within(&stream, &map, &order, &mut stays, bytes)? {
            ranking = Some(by);
        }
    }
    let there = stream.packets().iter().filter(|packet| !packet.is_empty()).count();
    let without = parity::left_out(&stream, &map, &stays);
    let cut = stream.with_packets(|id| stays[id]);
    let left = stays.iter().filter(|stays| **stays).count();
    let windows = is_ordered.then(|| windows::windows(&cut, &manifest, &map));
    let len = match (&windows, &table) {
        (Some(windows), _) if args.live => windows::write_live(&cut, windows, manifest.frames_per_second())?,
        (Some(windows), _) => written(args, &windows::to_bytes(&cut, windows)?)?,
        (None, Some(table)) if left > 0 => written(args, &pipeline::file_by_utility(&cut, table)?)?,
        (None, _) => written(args, &cut.to_bytes()?)?,
    };
    if let (Some(target), Some(bytes)) = (&target, &measured) {
        // They are of the groups that the manifest tells of, whatever packets are there.
        files::write(target, bytes)?;
    }
    let before = stream.to_bytes()?.len();
    let mut text = format!(
        "{} → {}: {left} of {there} packets, {} of {before} bytes{}\n",
        args.input.display(),
        args.out.display(),
        len,
        ranking.map_or("", Ranking::sentence)
    );
    if without.packets > 0 {
        text +=
            &format!("  parity left out: {}, {} bytes\n", counted(without.packets, "packet"), without.bytes);
    }
    let json = json!({
        "input": files::shown(&args.input), "out": files::shown(&args.out),
        "packets": left, "packets_before": there,
        "bytes": len, "bytes_before": before, "ranking": ranking.map(Ranking::name),
        "parity_left_out": { "packets": without.packets, "bytes": without.bytes },
        "warnings": warnings,
    });
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// Where utilities are written beside `out`: nowhere beside a device, and never over others.
fn beside_output(out: &Path, bytes: &[u8], warnings: &mut Vec<String>) -> Option<PathBuf> {
    if files::is_standard_output(out) || std::fs::metadata(out).is_ok_and(|found| !found.is_file()) {
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

/// Writes the file of `args`; gives its length.
fn written(args: &Cut, bytes: &[u8]) -> Result<usize> {
    files::write(&args.out, bytes)?;
    Ok(bytes.len())
}

/// Whether what a slice brings shows in any of `frames`.
fn shows(manifest: &Manifest<'_>, placement: &SlicePlacement, frames: &Range<u32>) -> bool {
    let covered = windows::covered(manifest, placement);
    covered.start < frames.end && frames.start < covered.end
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
