//! Orders packets as an encoder writes them that follows a recording: window after window.

use std::{
    collections::BTreeMap,
    io::{self, ErrorKind, Write as _},
    ops::Range,
    thread,
    time::{Duration, Instant},
};

use anyhow::{Context, Result};
use codec_core::internals::{
    ids::PacketId,
    wire::{file, manifest::Manifest},
};
use trainer_host::{
    Stream,
    stream::{PacketMap, SlicePlacement},
};

use crate::delivery::coverage;

/// Packets of one window of time.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct Window {
    /// The first frame of which they show anything.
    first_frame: u32,
    /// Lower levels first.
    packets: Vec<PacketId>,
}

/// The packets of `stream` by the newest window that they bring something of; attributes of an epoch belong
/// to its first frame, and parity to the last of the packets that it repairs.
pub(super) fn windows(stream: &Stream, manifest: &Manifest<'_>, map: &PacketMap) -> Vec<Window> {
    let is_there = |id: usize| stream.packets().get(id).is_some_and(|packet| !packet.is_empty());
    // First frame and level of each packet of media.
    let mut keys: Vec<(u32, u8)> = (0..stream.packets().len())
        .map(|id| {
            let starts = map.placements(id).iter().map(|placement| covered(manifest, placement).start);
            let level = map.placements(id).iter().map(|placement| placement.group.level.get()).min();
            (starts.max().unwrap_or(0), level.unwrap_or(0))
        })
        .collect();
    for range in manifest.repairs() {
        for set in 0..range.sets() {
            let members = (0..range.members(set)).map(|position| range.member(set, position) as usize);
            let last = members.filter_map(|id| keys.get(id)).max().copied().unwrap_or_default();
            for row in 0..range.parity.into() {
                if let Some(key) = keys.get_mut(range.parity_id(set, row) as usize) {
                    *key = last;
                }
            }
        }
    }
    let mut windows: BTreeMap<u32, Vec<(u8, PacketId)>> = BTreeMap::new();
    for (id, (first_frame, level)) in keys.into_iter().enumerate().filter(|(id, _)| is_there(*id)) {
        // A stream has no more packets than there are ids.
        windows.entry(first_frame).or_default().extend(PacketId::new(id as u32).map(|id| (level, id)));
    }
    let window = |(first_frame, mut packets): (u32, Vec<(u8, PacketId)>)| {
        packets.sort_unstable();
        Window { first_frame, packets: packets.into_iter().map(|(_, id)| id).collect() }
    };
    windows.into_iter().map(window).collect()
}

/// The frames in which what a slice brings shows.
pub(super) fn covered(manifest: &Manifest<'_>, placement: &SlicePlacement) -> Range<u32> {
    let (first, frames) = coverage(manifest, placement.group.span);
    first..first.saturating_add(frames)
}

/// The file of `stream` with its packets in the order of `windows`.
///
/// # Errors
/// None in practice: the stream was read.
pub(super) fn to_bytes(stream: &Stream, windows: &[Window]) -> Result<Vec<u8>> {
    Ok(stream.to_bytes_in_order(windows.iter().flat_map(|window| window.packets.iter().copied()))?)
}

/// Parts of the file of [`to_bytes`], each with the time from the first on at which it is due, seconds: the
/// manifest and each window when its first frame is, the index at the end with the last.
fn parts(
    stream: &Stream,
    windows: &[Window],
    len: usize,
    frames_per_second: f64,
) -> Vec<(f64, Range<usize>)> {
    let mut at = file::MAGIC.len() + size_of::<u32>() + stream.message().len();
    let mut parts = vec![(0.0, 0..at)];
    for window in windows {
        let bytes = window.packets.iter().map(|&id| size_of::<u16>() + stream.packets()[id.index()].len());
        let end = at + bytes.sum::<usize>();
        parts.push((f64::from(window.first_frame) / frames_per_second, at..end));
        at = end;
    }
    let last = parts.last().map_or(0.0, |part| part.0);
    parts.push((last, at..len));
    parts
}

/// Writes the file of [`to_bytes`] to standard output, each window when its first frame is due; gives the
/// bytes written.
///
/// # Errors
/// What the system says of standard output; a reader that has gone is none, and ends it.
pub(super) fn write_live(stream: &Stream, windows: &[Window], frames_per_second: f64) -> Result<usize> {
    let bytes = to_bytes(stream, windows)?;
    let begin = Instant::now();
    let mut out = io::stdout().lock();
    let mut len = 0;
    for (due, part) in parts(stream, windows, bytes.len(), frames_per_second) {
        let due = begin + Duration::from_secs_f64(due);
        thread::sleep(due.saturating_duration_since(Instant::now()));
        let end = part.end;
        match out.write_all(&bytes[part]).and_then(|()| out.flush()) {
            Err(error) if error.kind() == ErrorKind::BrokenPipe => break,
            written => written.context("standard output: cannot write")?,
        }
        len = end;
    }
    Ok(len)
}

#[cfg(test)]
mod tests {
    use clap::Parser;
    use trainer_host::encode::Protection;

    use super::*;
    use crate::{
        args::{Cli, Verb},
        pipeline::{self, LiveReader, Quiet},
    };

    fn stream() -> Stream {
        let flags = ["dgs", "demo", "--window-frames", "10", "--pictures", "2"];
        let Ok(Cli { verb: Verb::Demo(args), .. }) = Cli::try_parse_from(flags) else { panic!("{flags:?}") };
        let scene = pipeline::import("synth:cloth:1000:40", &args.source).unwrap().scene;
        let options = pipeline::encode_options(&args.codec, Protection::STANDARD);
        pipeline::encode(&scene, &options, Quiet(true)).unwrap().stream
    }

    #[test]
    fn an_encoder_that_follows_a_recording_writes_so() {
        let stream = stream();
        let manifest = stream.manifest().unwrap();
        let windows = windows(&stream, &manifest, &PacketMap::of(&stream).unwrap());
        let firsts: Vec<u32> = windows.iter().map(|window| window.first_frame).collect();
        assert_eq!(firsts, [0, 10, 20, 30]);
        let bytes = to_bytes(&stream, &windows).unwrap();
        assert_eq!(Stream::from_bytes(&bytes).unwrap().0.packets(), stream.packets(), "nothing is left out");
        for (bytes, by_window) in [(bytes.clone(), true), (stream.to_bytes().unwrap(), false)] {
            let mut reader = LiveReader::new(&bytes[..]).unwrap();
            while reader.advance().unwrap() {}
            assert_eq!(reader.is_by_window(), by_window);
        }
        let parts = parts(&stream, &windows, bytes.len(), 20.0);
        let due: Vec<f64> = parts.iter().map(|part| part.0).collect();
        assert_eq!(due, [0.0, 0.0, 0.5, 1.0, 1.5, 1.5]);
        assert!(parts.windows(2).all(|pair| pair[0].1.end == pair[1].1.start));
        // Every part but the first and the last is whole packets.
        for (_, part) in &parts[1..parts.len() - 1] {
            let found = file::packets(&bytes[part.clone()], 0, codec_simd::crc32);
            assert!(found.take(1).all(|record| matches!(record, file::Record::Packet(2, _))));
        }
    }
}
