//! Streams a scene by one scheduler over one link: `dgs stream`.

use anyhow::{Result, bail};
use codec_core::internals::ids::Level;
use emulator_host::SessionConfig;
use render_host::metric;
use serde_json::json;
use trainer_host::{Stream, evaluator};

use crate::{
    args::StreamArgs,
    delivery::ShownState,
    figures::{mean, number},
    files,
    output::VerbOutput,
    pipeline::{self, Delivered, Frames, Quiet, Sendable, Watching},
};

/// Runs the verb.
pub fn run(args: &StreamArgs, quiet: Quiet) -> Result<VerbOutput> {
    if let Some(out) = &args.out {
        files::check_stream(out, &[args.input.as_ref()])?;
    }
    if args.no_pose && !args.cameras.is_typed() {
        bail!("--no-pose is for a viewer; --eye, --turntable or --cameras gives one");
    }
    let mut warnings = Vec::new();
    let Sendable { stream, map, graph, damaged } =
        pipeline::sendable(&args.input, &args.scene, &args.codec, quiet, &mut |w| warnings.push(w))?;
    let link = pipeline::link(&args.link, &graph)?;
    warnings.extend(link.warnings.iter().cloned());
    let policy = pipeline::policy(args.policy);
    let watching = if args.cameras.is_typed() { Some(watching(args, &stream)?) } else { None };
    let viewer = watching.as_ref().filter(|_| !args.no_pose).and_then(Watching::path);
    let config = SessionConfig { viewer, ..link.config.clone() };
    let Delivered { report, shown, arrived } =
        pipeline::delivered(&stream, &map, &graph, &config, policy, args.link.transport)?;
    let startup = report.startup_ms.map_or("never".to_owned(), |ms| format!("{ms:.0} ms"));
    let mut text = format!(
        "{} over {}\n  startup {startup}, miss {:.1} % (base {:.1} %), utility {:.3}\n  \
         limited by {}\n  \
         goodput {} kbit/s, usable {} kbit/s, wasted {:.1} KiB, {} of {} frames shown, {} recovered by \
         repair\n",
        report.policy,
        link.description,
        100.0 * report.miss_rate,
        100.0 * report.base_miss_rate,
        report.utility,
        link.limit(&report),
        number(report.goodput_bps / 1000.0),
        number(report.usable_goodput_bps / 1000.0),
        report.waste.total_bytes() as f64 / 1024.0,
        shown.len(),
        graph.frames(),
        report.recovered
    );
    let limit = link.limit(&report);
    let mut json =
        json!({ "link": link.description, "limit": limit, "report": report, "warnings": warnings });
    if let Some(watching) = &watching {
        let psnr_db = seen(args, watching, &stream, &shown)?;
        let (mean, worst_tenth) = (mean(&psnr_db), evaluator::worst_tenth(&psnr_db));
        text += &format!(
            "  seen from there: PSNR against complete frames: mean {mean:.2} dB, worst tenth \
             {worst_tenth:.2} dB\n"
        );
        json["seen"] =
            json!({ "mean_psnr_db": mean, "worst_tenth_psnr_db": worst_tenth, "located": !args.no_pose });
    }
    if let Some(out) = &args.out {
        let count = arrived.iter().filter(|arrived| **arrived).count();
        files::write(out, &stream.with_packets(|id| arrived[id]).to_bytes()?)?;
        text += &format!("what arrived, {count} of {} packets → {}\n", arrived.len(), out.display());
        json["out"] = json!(files::shown(out));
        json["arrived_packets"] = json!(count);
    }
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// The viewer that is typed.
fn watching(args: &StreamArgs, stream: &Stream) -> Result<Watching> {
    let up = args.scene.up.map(Into::into).unwrap_or_default();
    let mut frames = Frames::of_stream(stream.receive()?, Level::ALL[Level::COUNT - 1], up);
    Watching::of(&args.cameras, &args.view, &mut frames)
}

/// What the viewer saw of each frame, PSNR against the complete one; a frame that was not shown is black.
fn seen(args: &StreamArgs, watching: &Watching, stream: &Stream, shown: &[ShownState]) -> Result<Vec<f64>> {
    let received = stream.receive()?;
    let (content, settings) = (received.content(), pipeline::settings(&args.view));
    let state_of = |frame: u32| shown.iter().find(|state| state.frame == frame);
    let frames = 0..content.manifest.head().frames;
    let states: Vec<(u32, Option<&[u8]>)> =
        frames.map(|frame| (frame, state_of(frame).map(|state| state.state.as_slice()))).collect();
    let complete: Vec<(u32, Option<&[u8]>)> =
        states.iter().map(|(frame, _)| (*frame, Some(content.blocks))).collect();
    let images = watching.pictures(&content, &states, &settings)?;
    let references = watching.pictures(&content, &complete, &settings)?;
    let scores = images
        .iter()
        .zip(&references)
        .map(|(image, reference)| Ok(metric::psnr(image, reference)?.min(evaluator::PSNR_CAP_DB)));
    scores.collect()
}
