//! Decodes a `.dgs` file to frames that other programs read, or to the digest of what it holds.

use anyhow::{Result, bail};
use codec_core::{
    ErrorKind,
    internals::{digest::Digest, ids::Level},
};
use serde_json::json;
use trainer_host::{scene::Up, stream::decoded};

use super::convert::format::{FrameRun, SceneOutput};
use crate::{
    args::Decode,
    files,
    output::VerbOutput,
    pipeline::{self, Frames, Quiet},
    progress::Progress,
};

/// Runs the verb.
pub fn run(args: &Decode, quiet: Quiet) -> Result<VerbOutput> {
    let out =
        args.out.as_deref().map(|out| Ok::<_, anyhow::Error>((out, SceneOutput::of(out)?))).transpose()?;
    if let Some((out, output)) = out {
        if output == SceneOutput::FourDgs {
            bail!("{}: .4dgs is written by dgs convert", out.display());
        }
        output.check(out, args.overwrite)?;
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
    let mut frames = Frames::of_stream(received, Level::from_bits(args.level), Up::default());
    let mut json = json!({
        "file": files::shown(&args.input), "out": args.out.as_deref().map(files::shown), "packets": counters.media,
        "recovered": counters.recovered, "frames": frames.count(),
    });
    if args.digest {
        let digest = format!("{:016x}", digest(&mut frames)?);
        text += &format!("digest {digest}\n");
        json["digest"] = json!(digest);
    }
    if let Some((out, output)) = out {
        let mut absent = AbsentGaussians::default();
        let progress = Progress::new("decode", quiet.0);
        let run = FrameRun {
            overwrite: args.overwrite,
            only: output.only(args.frame)?,
            count: frames.count(),
            footprint: frames.footprint(),
        };
        text += &output.write(out, run, &progress, |frame| {
            let instant = frames.instant(frame)?;
            let (epoch, missing) = decoded::snapshot(&instant)?;
            absent.add(missing, instant.gaussians.len());
            Ok((epoch, 0))
        })?;
        text += "  axes are the stream's, which does not say which way is up: dgs convert turns them\n";
        warnings.extend(absent.warning());
    }
    let damaged = !warnings.is_empty();
    if let Some((_, output)) = out {
        warnings.extend(output.losses(degree, frames.footprint()));
    }
    json["warnings"] = json!(warnings);
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// The digest of all frames, as conformance is told by.
fn digest(frames: &mut Frames) -> Result<u64> {
    let mut digest = Digest::new();
    for frame in 0..frames.count() {
        let instant = frames.instant(frame)?;
        digest = digest.frame(&instant.gaussians, &instant.sh_rest);
    }
    Ok(digest.get())
}

/// Gaussians that have not arrived and are not written.
#[derive(Default)]
struct AbsentGaussians {
    /// Frames that lack some.
    frames: usize,
    /// The frame that lacks most: how many of how many.
    most: (usize, usize),
}

impl AbsentGaussians {
    fn add(&mut self, missing: usize, of: usize) {
        self.frames += usize::from(missing > 0);
        if missing > self.most.0 {
            self.most = (missing, of);
        }
    }

    fn warning(&self) -> Option<String> {
        let (missing, of) = self.most;
        (missing > 0).then(|| {
            format!(
                "Gaussians of which nothing has arrived are left out of {} frames, up to {missing} of {of}: \
                 rows of different frames need not be the same Gaussians",
                self.frames
            )
        })
    }
}
