//! Decodes a `.dgs` file to frames that other programs read, or to the digest of what it holds.

use std::ops::RangeInclusive;

use anyhow::Result;
use codec_core::{
    ErrorKind,
    internals::{digest::Digest, ids::Level},
};
use serde_json::json;
use trainer_host::stream::decoded::{self, Snapshot};

use super::convert::format::{FrameRun, FrameToWrite, SceneOutput};
use crate::{
    args::Decode,
    files,
    output::VerbOutput,
    pipeline::{self, Frames, LeftOut, Quiet},
    progress::Progress,
};

/// Runs the verb.
pub fn run(args: &Decode, quiet: Quiet) -> Result<VerbOutput> {
    let out = args
        .out
        .as_deref()
        .map(|out| Ok::<_, anyhow::Error>((out, SceneOutput::of_decoded(out)?)))
        .transpose()?;
    if let Some((out, output)) = out {
        output.check(out, args.overwrite, &[&args.input])?;
        output.only(args.frame)?;
    }
    let mut warnings = Vec::new();
    let stream = pipeline::read_stream(&args.input, &mut |w| warnings.push(w))?;
    let received = stream.receive()?;
    let counters = *received.counters();
    let kinds = [
        ErrorKind::Checksum,
        ErrorKind::Illegal,
        ErrorKind::Contradiction,
        ErrorKind::Short,
        ErrorKind::Unknown,
        ErrorKind::Capacity,
    ];
    for kind in kinds {
        let refused = counters.refused[kind.index()];
        if refused > 0 {
            warnings.push(format!("{refused} packets were refused as {}", kind.name()));
        }
    }
    let mut text = format!(
        "{}: {} packets decoded, {} recovered by repair\n",
        args.input.display(),
        counters.media,
        counters.recovered
    );
    let degree = stream.manifest()?.sh_degree();
    let starts = decoded::epoch_starts(&stream.manifest()?);
    let mut frames = Frames::of_stream(received, Level::from_bits(args.level), None);
    let mut json = json!({
        "file": files::shown(&args.input), "out": args.out.as_deref().map(files::shown),
        "packets": counters.media,
        "recovered": counters.recovered, "frames": frames.count(),
    });
    let mut notes = Vec::new();
    if args.digest {
        let range = args.frame.map_or(0..=frames.count().saturating_sub(1), |frame| frame..=frame);
        let digest = format!("{:016x}", digest(&mut frames, range)?);
        let of = args.frame.map_or(String::new(), |frame| format!(" of frame {frame}"));
        text += &format!("digest{of} {digest}\n");
        json["digest"] = json!(digest);
        json["digest_frame"] = json!(args.frame);
    }
    if let Some((out, output)) = out {
        let mut left_out = LeftOut::default();
        let progress = Progress::new("decode", quiet.0);
        let run = FrameRun {
            overwrite: args.overwrite,
            only: output.only(args.frame)?,
            count: frames.count(),
            footprint: frames.footprint(),
            frames_per_second: frames.frames_per_second(),
        };
        let mut last: Option<Snapshot> = None;
        let written = output.write(out, run, &progress, |frame| {
            let instant = frames.instant(frame)?;
            let shown = decoded::snapshot(&instant)?;
            let count = instant.gaussians.len();
            left_out.add(count - shown.rows.len(), count);
            let is_first = starts.binary_search(&frame).is_ok();
            let has_rows_of_last = !is_first && last.as_ref().is_some_and(|last| last.is_followed_by(&shown));
            let epoch = shown.epoch.clone();
            last = Some(shown);
            Ok(FrameToWrite { epoch, t: 0, has_rows_of_last })
        });
        // What was damaged may be why nothing can be written.
        let written = written.map_err(|error| match warnings.join("; ") {
            damage if damage.is_empty() => error,
            damage => error.context(format!("{}: {damage}", args.input.display())),
        })?;
        text += &written.text;
        notes.extend(written.notes);
        text += &format!("  axes are the stream's, with {} up: dgs convert turns them\n", frames.up());
        let said = left_out.sentence(&frames);
        if frames.has_all_bases() { notes.extend(said) } else { warnings.extend(said) }
    }
    let damaged = !warnings.is_empty();
    if let Some((_, output)) = out {
        warnings.extend(output.losses(degree, frames.footprint()));
    }
    for note in &notes {
        text += &format!("  note: {note}\n");
    }
    json["notes"] = json!(notes);
    json["warnings"] = json!(warnings);
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// The digest of the frames in `range`. Over all frames it is the digest that the conformance streams list.
fn digest(frames: &mut Frames, range: RangeInclusive<u32>) -> Result<u64> {
    let mut digest = Digest::new();
    for frame in range {
        let instant = frames.instant(frame)?;
        digest = digest.frame(&instant.gaussians, &instant.sh_rest);
    }
    Ok(digest.get())
}
