//! Streams a scene by one scheduler over one link: `dgs stream`.

use std::path::Path;

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use emulator_host::SessionConfig;
use render_host::metric;
use serde_json::{Value, json};
use trainer_host::{Stream, evaluator, train::delivery::Recording};

use crate::{
    args::{StreamArgs, TransportName},
    delivery::ShownState,
    figures::{counted, frozen, mean, number, startup},
    files,
    output::VerbOutput,
    pipeline::{self, Delivered, Frames, Lost, Quiet, Sendable, Watching},
};

/// Runs the verb.
pub fn run(args: &StreamArgs, quiet: Quiet) -> Result<VerbOutput> {
    if let Some(out) = &args.out {
        files::check_stream(out, &[args.input.as_ref()])?;
    }
    if let Some(states) = &args.states {
        let others: Vec<&Path> = std::iter::once(Path::new(&args.input)).chain(args.out.as_deref()).collect();
        files::check_apart(states, &others).context("--states")?;
        files::check_json(states).context("--states")?;
    }
    if args.no_pose && !args.cameras.is_given() {
        bail!("--no-pose is for a viewer; --eye, --turntable or --cameras gives one");
    }
    // Encoding may take minutes: what it would be in vain for is refused before.
    let impaired =
        args.impair.as_deref().map(|text| pipeline::impaired_link(text, &args.link)).transpose()?;
    let typed_link = pipeline::typed_link(&args.link)?;
    let is_watched = args.cameras.is_given();
    let of_file = if is_watched { Watching::of_file(&args.cameras, &args.view)? } else { None };
    let mut warnings = Vec::new();
    let warn = &mut |warning| warnings.push(warning);
    let Sendable { stream, map, graph, damaged } =
        pipeline::sendable(&args.input, &args.scene, &args.codec, args.policy, quiet, warn)?;
    if graph.packets().is_empty() {
        bail!("{}: nothing of this stream can be sent", args.input);
    }
    let link = match impaired {
        Some(link) => link,
        None => typed_link.before(&graph)?,
    };
    warnings.extend(link.warnings.iter().cloned());
    let policy = pipeline::policy(args.policy);
    let watching = match of_file {
        None if is_watched => Some(watching(args, &stream)?),
        of_file => of_file,
    };
    let unused = args.view.given();
    if watching.is_none() && !unused.is_empty() {
        let names = unused.join(", ");
        warnings.push(format!("not used without a viewer (--eye, --turntable or --cameras): {names}"));
    }
    let viewer = watching.as_ref().filter(|_| !args.no_pose).and_then(Watching::path);
    let config = SessionConfig { viewer, ..link.config.clone() };
    let Delivered { report, shown, arrived } =
        pipeline::delivered(&stream, &map, &graph, &config, policy, args.link.transport)?;
    let (lost, limit) = (Lost::of(&report), link.limit(&report, &graph));
    let mean_rate = link.mean_until(report.duration_ns);
    let is_model = args.link.transport == TransportName::Model;
    let best = if is_model { link.best_possible(&report, &graph) } else { None };
    let freezes = pipeline::freezes(&report, &graph);
    let mut text = format!(
        "{} over {}\n  startup {}, miss {:.1} % (of positive utility {:.1} %, base {:.1} %), \
         utility {:.3}{}\n  \
         limited by {limit}\n  \
         goodput {} kbit/s, usable {} kbit/s, wasted {:.1} KiB, {} of {} frames shown, {}, {} \
         recovered by repair\n  lost {lost}{}{}\n",
        report.policy,
        link.description,
        startup(report.startup_ms, report.startup_reached),
        100.0 * report.miss_rate,
        100.0 * report.positive_miss_rate,
        100.0 * report.base_miss_rate,
        report.utility,
        best.map_or(String::new(), |best| format!(" (at most {best:.3} by any schedule)")),
        number(report.goodput_bps / 1000.0),
        number(report.usable_goodput_bps / 1000.0),
        report.waste.total_bytes() as f64 / 1024.0,
        shown.len(),
        graph.frames(),
        frozen(freezes.count(), freezes.frames()),
        report.recovered,
        report.one_way_delay.map_or(String::new(), |[median, tail]| {
            format!("; one way {:.0} ms, 95 % within {:.0} ms", median.as_ms(), tail.as_ms())
        }),
        mean_rate.map_or(String::new(), |rate| {
            let at_most = if link.config.forward.light.is_some() { " at most" } else { "" };
            format!("; the link could carry {}{at_most} on average", pipeline::rate_words(rate))
        }),
    );
    let mut json = json!({
        "link": link.description,
        "link_capacity_mean_bps": mean_rate.map(|rate| rate.0),
        "limit": limit,
        "utility_bound": best,
        "positive_miss_rate": report.positive_miss_rate,
        "lost_datagrams": { "queue": lost.queue, "way": lost.way },
        "one_way_delay_ms": report.one_way_delay.map(|[median, tail]| {
            json!({ "median": median.as_ms(), "p95": tail.as_ms() })
        }),
        "freezes": { "count": freezes.count(), "frames": freezes.frames() },
        "report": report,
        "warnings": warnings,
    });
    if let Some(watching) = &watching {
        let psnr_db = seen(args, watching, &stream, &shown)?;
        let (mean, worst_tenth) = (mean(&psnr_db), evaluator::worst_tenth(&psnr_db));
        text += &format!(
            "  seen from there: PSNR against complete frames: mean {mean:.2} dB, worst tenth \
             {worst_tenth:.2} dB\n"
        );
        json["seen"] =
            json!({ "mean_psnr_db": mean, "worst_tenth_psnr_db": worst_tenth, "located": !args.no_pose });
    } else {
        text += "  pictures were not compared; --eye, --turntable or --cameras (a viewer) adds their PSNR\n";
    }
    if let Some(out) = &args.out {
        text += &saved(out, &stream, arrived.as_deref(), &mut json)?;
    }
    let mut is_partial = damaged || (args.out.is_some() && arrived.is_none());
    if let Some(path) = &args.states {
        is_partial |= shown.is_empty();
        text += &recorded(path, &stream, shown, &mut json)?;
    }
    Ok(VerbOutput { text, json, warnings, damaged: is_partial })
}

/// Writes what arrived as `out`, if it can be read; says so.
fn saved(out: &Path, stream: &Stream, arrived: Option<&[bool]>, json: &mut Value) -> Result<String> {
    let Some(arrived) = arrived else {
        json["out"] = Value::Null;
        json["arrived_packets"] = json!(0);
        return Ok(format!("the manifest did not arrive complete: {} is not written\n", out.display()));
    };
    let count = arrived.iter().filter(|arrived| **arrived).count();
    files::write(out, &stream.with_packets(|id| arrived[id]).to_bytes()?)?;
    json["out"] = json!(files::shown(out));
    json["arrived_packets"] = json!(count);
    Ok(format!("what arrived, {count} of {} packets → {}\n", arrived.len(), out.display()))
}

/// Writes the states that frames of `stream` were displayed in to `path`, if any was; says so.
fn recorded(path: &Path, stream: &Stream, shown: Vec<ShownState>, json: &mut Value) -> Result<String> {
    json["recorded_states"] = json!(shown.len());
    if shown.is_empty() {
        json["states"] = Value::Null;
        return Ok(format!("no frame was displayed: {} is not written\n", path.display()));
    }
    let recording = Recording::of(stream, shown.into_iter().map(|shown| (shown.frame, shown.state)))?;
    files::write(path, recording.to_json().as_bytes())?;
    json["states"] = json!(files::shown(path));
    Ok(format!("states of {} → {}\n", counted(recording.count(), "displayed frame"), path.display()))
}

/// The viewer that is typed.
fn watching(args: &StreamArgs, stream: &Stream) -> Result<Watching> {
    let up = args.scene.up.map(Into::into);
    let mut frames = Frames::of_stream(stream.receive()?, Level::ALL[Level::COUNT - 1], up);
    Watching::of(&args.cameras, &args.view, &mut frames)
}

/// What the viewer saw of each frame, PSNR against the complete one; a frame that was not shown is black.
fn seen(args: &StreamArgs, watching: &Watching, stream: &Stream, shown: &[ShownState]) -> Result<Vec<f64>> {
    let received = stream.receive()?;
    let (content, settings) = (received.content(), pipeline::settings(&args.view));
    let frames = 0..content.manifest.head().frames;
    let mut states: Vec<(u32, Option<&[u8]>)> = frames.map(|frame| (frame, None)).collect();
    for state in shown {
        if let Some((_, known)) = states.get_mut(state.frame as usize) {
            known.get_or_insert(state.state.as_slice());
        }
    }
    let mut scores = Vec::with_capacity(states.len());
    // Pictures of a whole clip would take gigabytes: there are only as many as keep all threads busy.
    for states in states.chunks(2 * rayon::current_num_threads()) {
        let complete: Vec<(u32, Option<&[u8]>)> =
            states.iter().map(|(frame, _)| (*frame, Some(content.blocks))).collect();
        let images = watching.pictures(&content, states, &settings)?;
        let references = watching.pictures(&content, &complete, &settings)?;
        for (image, reference) in images.iter().zip(&references) {
            scores.push(metric::psnr(image, reference)?.min(evaluator::PSNR_CAP_DB));
        }
    }
    Ok(scores)
}
