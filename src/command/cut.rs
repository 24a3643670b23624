//! Leaves packets out of a stream, or takes a part in time of it, without decoding it: `dgs cut`.

mod budget;
mod parity;
mod windows;

use std::{
    ops::Range,
    path::{Path, PathBuf},
};

use anyhow::{Context, Result, anyhow, bail};
use serde_json::json;
use trainer_host::{
    Stream,
    encode::clip::{Clip, ClipError},
    stream::{PacketMap, SlicePlacement},
};

use self::parity::Amount;
use crate::{
    args::{Cut, FrameRange},
    figures::counted,
    files,
    output::VerbOutput,
    pipeline::{self, stored_utilities, utilities_of_clip, utility_path},
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
    let whole = pipeline::read_stream(&args.input, &mut |w| warnings.push(w))?;
    let map_of_whole = PacketMap::of(&whole)?;
    let clip = args.frames.map(|range| clip(&whole, range)).transpose()?;
    if clip.is_some() {
        let repaired = map_of_whole.repaired(|id| !whole.packets()[id].is_empty());
        let lost = (0..repaired.len()).filter(|&id| repaired[id] && whole.packets()[id].is_empty()).count();
        if lost > 0 {
            warnings.push(format!(
                "{}: {} that parity repairs are not in the file, and not in the clip",
                args.input.display(),
                counted(lost, "packet")
            ));
        }
    }
    let stream = clip.as_ref().map_or(&whole, |clip| &clip.stream);
    let manifest = stream.manifest()?;
    let map = PacketMap::of(stream)?;
    let mut stays: Vec<bool> = (0..stream.packets().len())
        .map(|id| {
            let wanted = |placement: &SlicePlacement| {
                args.levels.is_none_or(|most| placement.group.level.get() <= most)
            };
            !stream.packets()[id].is_empty() && (map.is_parity(id) || map.placements(id).iter().any(wanted))
        })
        .collect();
    let beside = utility_path(&args.input);
    let damaged = !warnings.is_empty();
    let stored = match &clip {
        Some(clip) => utilities_of_clip(&beside, &whole, clip),
        None => stored_utilities(&beside, stream).and_then(|table| {
            Ok((table, std::fs::read(&beside).with_context(|| format!("{}: cannot read", beside.display()))?))
        }),
    };
    let (table, measured) = match stored {
        Ok((table, bytes)) => (Some(table), Some(bytes)),
        Err(error) => {
            if beside.exists() {
                warnings.push(format!("{error:#}; they are not used"));
            }
            (None, None)
        }
    };
    let target = measured.as_ref().and_then(|bytes| beside_output(&args.out, bytes, &mut warnings));
    if let Some(target) = &target {
        files::check(target)?;
    }
    parity::only_of_whole_sets(&manifest, stream, &mut stays);
    let mut ranking = None;
    if let Some(bytes) = args.bytes {
        let (order, by) = match &table {
            Some(table) => {
                let wanted = stream.with_packets(|id| stays[id]);
                (budget::order_by_utility(&wanted, &map, table), Ranking::Utility)
            }
            None => (budget::order_by_level(stream, &map), Ranking::Level),
        };
        if budget::within(stream, &map, &order, &mut stays, bytes)? {
            ranking = Some(by);
        }
    }
    let there = whole.packets().iter().filter(|packet| !packet.is_empty()).count();
    let (before, after) =
        (Amount::of(&whole, &map_of_whole, |_| true), Amount::of(stream, &map, |id| stays[id]));
    let without = Amount {
        packets: before.packets.saturating_sub(after.packets),
        bytes: before.bytes.saturating_sub(after.bytes),
    };
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
    let before = whole.to_bytes()?.len();
    let mut text = format!(
        "{} → {}: {left} of {there} packets, {} of {before} bytes{}\n",
        args.input.display(),
        args.out.display(),
        len,
        ranking.map_or("", Ranking::sentence)
    );
    let frames = manifest.head().frames;
    if let Some((clip, requested)) = clip.as_ref().zip(args.frames) {
        let Range { start, end } = clip.frames;
        let seconds = f64::from(frames) / manifest.frames_per_second();
        text += &format!(
            "  frames {start} to {} are {} of their own from 0 on, {seconds:.3} s\n",
            end - 1,
            counted(frames as usize, "frame")
        );
        if requested.within(whole.manifest()?.head().frames)? != clip.frames {
            text += &format!(
                "  note: --frames is {requested}; motion is coded in windows, which stay whole (encode \
                 --window-frames makes them shorter)\n"
            );
        }
    }
    if without.packets > 0 {
        text +=
            &format!("  parity left out: {}, {} bytes\n", counted(without.packets, "packet"), without.bytes);
    }
    let json = json!({
        "input": files::shown(&args.input), "out": files::shown(&args.out),
        "packets": left, "packets_before": there,
        "bytes": len, "bytes_before": before, "ranking": ranking.map(Ranking::name),
        "first_frame": clip.as_ref().map_or(0, |clip| clip.frames.start), "frames": frames,
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
        // Those of the stream that is replaced go with it.
        Ok(_) if is_of_the_stream_at(out, &target) => Some(target),
        Ok(_) => {
            let name = target.display();
            warnings.push(format!("{name}: utilities of something else are there, and stay"));
            None
        }
        Err(_) => Some(target),
    }
}

/// Whether the utilities in the file `utilities` are those of the stream that is in file `out` now.
fn is_of_the_stream_at(out: &Path, utilities: &Path) -> bool {
    pipeline::read_stream(out, &mut |_| ()).is_ok_and(|stream| stored_utilities(utilities, &stream).is_ok())
}

/// Writes the file of `args`; gives its length.
fn written(args: &Cut, bytes: &[u8]) -> Result<usize> {
    files::write(&args.out, bytes)?;
    Ok(bytes.len())
}

/// The part of `whole` that shows `range`.
fn clip(whole: &Stream, range: FrameRange) -> Result<Clip> {
    let frames = range.within(whole.manifest()?.head().frames)?;
    Clip::of(whole, frames).map_err(|error| {
        let instead = "dgs convert --frames and dgs encode make a shorter one";
        match error {
            ClipError::Paper | ClipError::Shared { .. } => anyhow!("--frames is {range}: {error}; {instead}"),
            error => anyhow::Error::new(error).context(format!("--frames is {range}")),
        }
    })
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
