//! Describes a stream to people: its manifest, packets by kind, damage: `dgs inspect`.

mod manifest;

use anyhow::Result;
use codec_core::internals::{
    ids::{Level, Span},
    wire::{
        file::{self, Record},
        manifest::Manifest,
    },
};
use codec_simd::crc32;
use serde::Serialize;
use serde_json::{Value, json};
use trainer_host::{
    Stream,
    encode::{
        Decisions,
        decisions::{EpochDecisions, TrackForm},
    },
    stream::PacketMap,
    viewpoint::Framing,
};

use super::encode::read_decisions;
use crate::{
    args::Inspect,
    figures::{counted, number},
    files,
    output::VerbOutput,
    pipeline::{self, Frames},
};

/// Runs the verb.
pub fn run(args: &Inspect) -> Result<VerbOutput> {
    if args.decisions {
        return decisions(args);
    }
    if let Some(out) = &args.manifest {
        files::check_apart(out, &[&args.input])?;
        files::check_json(out)?;
    }
    let mut warnings = Vec::new();
    let bytes = pipeline::input_bytes(&args.input)?;
    let stream = pipeline::stream_of(&args.input, &bytes, &mut |w| warnings.push(w))?;
    let after = after_the_end(&bytes);
    let manifest = stream.manifest()?;
    let map = PacketMap::of(&stream)?;
    let mut by_kind = [[(0u64, 0u64); Level::COUNT]; 2];
    let (mut parity, mut missing) = (0u64, 0u64);
    for (id, packet) in stream.packets().iter().enumerate() {
        if packet.is_empty() {
            missing += 1;
        } else if map.is_parity(id) {
            parity += 1;
        } else if let Some(mark) = map.placements(id).first() {
            let kind = usize::from(matches!(mark.group.span, Span::Motion(_)));
            let slot = &mut by_kind[kind][mark.group.level.index()];
            *slot = (slot.0 + 1, slot.1 + packet.len() as u64);
        }
    }
    let head = manifest.head();
    let mut text = format!(
        "{}: profile {}, {}, {}, {}, {} at {} fps, harmonic degree {}, \
         footprint {}, {} up\n\
         manifest {} bytes on the wire, {} unpacked, {}, {}\n",
        args.input.display(),
        manifest.profile_name(),
        counted(head.epochs.into(), "epoch"),
        counted(head.windows.into(), "window"),
        counted(head.clusters as usize, "cluster"),
        counted(head.frames as usize, "frame"),
        manifest.frames_per_second(),
        head.sh_degree,
        manifest.footprint().name(),
        manifest.up(),
        stream.message().len(),
        manifest.raw().len(),
        counted(head.tables.into(), "entropy table"),
        counted(head.repairs.into(), "repair range")
    );
    let mut packets = Vec::new();
    for (kind, name) in ["canonical", "motion"].into_iter().enumerate() {
        for (level, &(count, bytes)) in by_kind[kind].iter().enumerate().filter(|(_, s)| s.0 > 0) {
            text += &format!("  {name:9} level {level}: {count:>6} packets, {bytes:>10} bytes\n");
            packets.push(json!({ "kind": name, "level": level, "packets": count, "bytes": bytes }));
        }
    }
    text += &format!("  parity: {parity} packets; missing: {missing}\n");
    let facts = StreamFacts::of(&stream, &manifest)?;
    text += &facts.lines();
    if after > 0 {
        text += &format!("  note: {after} bytes after the end of the stream are not part of it\n");
    }
    let json = json!({
        "stream": facts,
        "file": files::shown(&args.input), "profile": manifest.profile_name(),
        "manifest_bytes": stream.message().len(), "packets": packets, "parity_packets": parity,
        "missing_packets": missing, "bytes_after_end": after, "damage": warnings,
        "manifest": manifest_json(&manifest),
    });
    if let Some(path) = &args.manifest {
        let document = manifest::document(&stream, &map)?;
        files::write(path, format!("{document:#}\n").as_bytes())?;
    }
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// Bytes of a `.dgs` file after its index; none where it is cut off before.
fn after_the_end(bytes: &[u8]) -> usize {
    let Ok((_, mut at)) = file::manifest(bytes) else { return 0 };
    for record in file::packets(bytes, at, crc32) {
        match record {
            Record::Packet(first, packet) => at = first + packet.bytes().len(),
            Record::Illegal(first, length, _) | Record::Damaged(first, length) => at = first + length,
            Record::End => {
                // Its mark and name, so many offsets, their checksum and the index's length.
                let count = bytes.get(at + 6..at + 10).and_then(|count| count.try_into().ok());
                let offsets = count.map_or(0, u32::from_le_bytes) as usize;
                let end = at.saturating_add(18).saturating_add(offsets.saturating_mul(4));
                let is_index = bytes.get(..end).is_some_and(|file| file::index(file, crc32).is_ok());
                return if is_index { bytes.len() - end } else { 0 };
            }
        }
    }
    0
}

/// What a stream comes to as a whole.
#[derive(Serialize)]
struct StreamFacts {
    duration_s: f64,
    /// Over all epochs.
    gaussians: u64,
    wire_bytes: usize,
    bits_per_gaussian: f64,
    /// Least and greatest position of what has arrived, over sampled frames.
    bounds: Option<[[f32; 3]; 2]>,
}

impl StreamFacts {
    fn of(stream: &Stream, manifest: &Manifest<'_>) -> Result<Self> {
        let head = manifest.head();
        let gaussians: u64 = manifest.epochs().map(|epoch| u64::from(epoch.gaussians)).sum();
        let wire_bytes = stream.wire_bytes();
        let mut frames = Frames::of_stream(stream.receive()?, Level::HIGHEST, None);
        let mut bounds: Option<[[f32; 3]; 2]> = None;
        for frame in Framing::sampled(frames.count() as usize) {
            let instant = frames.instant(frame as u32)?;
            for gaussian in instant.gaussians.iter().filter(|gaussian| !gaussian.is_absent()) {
                let [low, high] = bounds.get_or_insert([gaussian.position; 2]);
                for axis in 0..3 {
                    low[axis] = low[axis].min(gaussian.position[axis]);
                    high[axis] = high[axis].max(gaussian.position[axis]);
                }
            }
        }
        Ok(Self {
            duration_s: f64::from(head.frames) / manifest.frames_per_second(),
            gaussians,
            wire_bytes,
            bits_per_gaussian: 8.0 * wire_bytes as f64 / gaussians.max(1) as f64,
            bounds,
        })
    }

    fn lines(&self) -> String {
        let bounds = match self.bounds {
            Some([low, high]) => format!("{low:.3?} to {high:.3?}"),
            None => "nothing has arrived".to_owned(),
        };
        format!(
            "  {:.3} s, {} Gaussians over all epochs, {} bytes on the wire, {} bits per Gaussian\n  bounds \
             {bounds}\n",
            self.duration_s,
            self.gaussians,
            self.wire_bytes,
            number(self.bits_per_gaussian)
        )
    }
}

/// What a file of decisions says, in short; as JSON, all of it.
fn decisions(args: &Inspect) -> Result<VerbOutput> {
    let decisions = read_decisions(&args.input)?;
    let mut text = format!("{}: decisions for profile ", args.input.display());
    match &decisions {
        Decisions::Paper(paper) => {
            text += "paper\n";
            for (e, epoch) in paper.epochs.iter().enumerate() {
                text += &format!(
                    "  epoch {e}: {} clusters, rank {}, position step {}\n",
                    epoch.clusters.len(),
                    epoch.rank,
                    epoch.quantisers.canonical[0].step
                );
            }
        }
        Decisions::Dgs1(dgs1) => {
            text += &format!(
                "dgs1\n  blocks of {} Gaussians, packets of at most {} bytes, proxies: {}, {} entropy \
                 tables\n",
                dgs1.block_len,
                dgs1.packet_bytes,
                dgs1.proxies,
                dgs1.tables.len()
            );
            for (e, epoch) in dgs1.epochs.iter().enumerate() {
                text += &epoch_summary(e, epoch);
            }
        }
    }
    Ok(VerbOutput { text, json: serde_json::to_value(&decisions)?, ..VerbOutput::default() })
}

fn epoch_summary(e: usize, epoch: &EpochDecisions) -> String {
    let motions = || epoch.windows.iter().flat_map(|window| &window.motions);
    let tracks = |form: TrackForm| motions().filter(|motion| motion.track == form).count();
    let mut text = format!(
        "  epoch {e}: {} clusters, {} windows, rotations {:?}, tracks: {} static, {} rigid, {} affine\n",
        epoch.clusters.len(),
        epoch.windows.len(),
        epoch.canonical_rotation,
        tracks(TrackForm::Static),
        tracks(TrackForm::Rigid),
        tracks(TrackForm::Affine)
    );
    for (q, quantisers) in epoch.quantisers.iter().enumerate() {
        let steps: Vec<String> = quantisers.canonical.iter().map(|q| number(q.step.into())).collect();
        let clusters = epoch.clusters.iter().filter(|c| c.quantisers == q).count();
        text += &format!("    quantisers {q} of {clusters} clusters, steps {}\n", steps.join(", "));
    }
    text
}

/// The manifest as JSON: for people, never on the wire.
fn manifest_json(manifest: &Manifest<'_>) -> Value {
    let head = manifest.head();
    let epochs: Vec<Value> = manifest
        .epochs()
        .map(|e| {
            json!({
                "first_frame": e.first_frame, "frames": e.frames, "gaussians": e.gaussians,
                "clusters": e.clusters, "windows": e.windows,
                "origin": [e.origin_x, e.origin_y, e.origin_z], "rank": e.rank,
            })
        })
        .collect();
    let windows: Vec<Value> = manifest
        .windows()
        .map(
            |w| json!({ "epoch": w.epoch, "first_frame": w.first_frame, "frames": w.frames, "rank": w.rank }),
        )
        .collect();
    json!({
        "frames": head.frames, "fps": manifest.frames_per_second(), "sh_degree": head.sh_degree,
        "footprint": manifest.footprint().name(), "up": manifest.up().name(),
        "block_len": manifest.block_len().get(),
        "packets": head.packets, "clusters": head.clusters,
        "epochs": epochs, "windows": windows, "tables": head.tables,
        "repair": manifest.repairs().map(|r| json!({
            "first_packet": r.first_packet, "packets": r.packets, "set_len": r.set_len, "sets": r.sets(),
            "parity": r.parity, "longest": r.longest,
        })).collect::<Vec<Value>>(),
    })
}
