//! Leaves packets out of a stream, without decoding it: `dgs cut`.

use std::ops::Range;

use anyhow::{Result, bail};
use codec_core::internals::{ids::Span, wire::manifest::Manifest};
use serde_json::json;
use trainer_host::{
    Stream,
    stream::{PacketMap, SlicePlacement},
};

use crate::{args::Cut, files, output::VerbOutput, pipeline};

/// Runs the verb.
pub fn run(args: &Cut) -> Result<VerbOutput> {
    files::check(&args.out)?;
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
    if let Some(bytes) = args.bytes {
        within(&stream, &map, &mut stays, bytes)?;
    }
    let there = stream.packets().iter().filter(|packet| !packet.is_empty()).count();
    if stays.iter().filter(|stays| **stays).count() < there {
        // Parity of a set that is not whole repairs what was left out on purpose, or nothing.
        (0..stays.len()).filter(|&id| map.is_parity(id)).for_each(|id| stays[id] = false);
    }
    let cut = stream.with_packets(|id| stays[id]);
    let bytes = cut.to_bytes()?;
    files::write(&args.out, &bytes)?;
    let left = stays.iter().filter(|stays| **stays).count();
    let before = stream.to_bytes()?.len();
    let text = format!(
        "{} → {}: {left} of {there} packets, {} of {before} bytes\n",
        args.input.display(),
        args.out.display(),
        bytes.len()
    );
    let json = json!({
        "input": args.input, "out": args.out, "packets": left, "packets_before": there,
        "bytes": bytes.len(), "bytes_before": before, "warnings": warnings,
    });
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
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

/// Leaves packets out until the file has at most `bytes`: the highest levels first, among those of a level
/// the last.
fn within(stream: &Stream, map: &PacketMap, stays: &mut [bool], bytes: u64) -> Result<()> {
    let file =
        |stays: &[bool]| -> Result<u64> { Ok(stream.with_packets(|id| stays[id]).to_bytes()?.len() as u64) };
    if file(stays)? <= bytes {
        return Ok(());
    }
    (0..stays.len()).filter(|&id| map.is_parity(id)).for_each(|id| stays[id] = false);
    let mut order: Vec<(u8, usize)> = (0..stays.len())
        .filter(|&id| stays[id])
        .map(|id| {
            let lowest = map.placements(id).iter().map(|placement| placement.group.level.get()).min();
            (lowest.unwrap_or(u8::MAX), id)
        })
        .collect();
    order.sort_unstable();
    // Files are never larger with fewer packets: halving finds how many fit.
    let first = |count: usize| {
        let mut some = vec![false; stays.len()];
        order[..count].iter().for_each(|&(_, id)| some[id] = true);
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
    Ok(())
}
