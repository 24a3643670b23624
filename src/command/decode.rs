//! `dgs decode`: a `.dgs` file back to frames.

use anyhow::Result;
use codec_core::{ErrorKind, ids::Level};
use serde_json::json;

use super::import::write;
use crate::{args::Decode, output::VerbOutput, pipeline};

/// Runs the verb.
pub fn run(args: &Decode) -> Result<VerbOutput> {
    let mut warnings = Vec::new();
    let stream = pipeline::read_stream(&args.input, &mut |w| warnings.push(w))?;
    let received = stream.receive()?;
    let scene = pipeline::decoded_scene(&received.content(), Level::from_bits(args.level))?;
    let counters = received.counters();
    for kind in [ErrorKind::Checksum, ErrorKind::Illegal, ErrorKind::Contradiction, ErrorKind::Short] {
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
    text += &write(&scene, &args.out, args.frame as usize)?;
    let json = json!({
        "file": args.input, "out": args.out, "packets": counters.media,
        "recovered": counters.recovered, "frames": scene.frames(), "warnings": warnings,
    });
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
}
