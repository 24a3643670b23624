//! Runs the whole pipeline under four schedulers and writes one page: `dgs demo`.

mod pictures;

use anyhow::{Context, Result, bail};
use emulator_host::PolicyKind;
use rayon::prelude::*;
use render_host::Backend;
use serde_json::json;
use trainer_host::{
    Scene, Stream,
    encode::{Ledger, Protection},
    evaluator::{self, PSNR_CAP_DB},
    stream::PacketMap,
    utility,
    viewpoint::{Framing, Ring},
};

use self::pictures::{Measured, Rendering};

use crate::{
    args::{Demo, TransportName},
    figures::{Machine, frozen, mean, startup},
    files::{self, MadeFolder},
    output::VerbOutput,
    pipeline::{self, Loaded, Quiet},
    progress::Progress,
    report::{Page, SchedulerRun, Shown, html},
};

/// The built-in scene.
const DEFAULT_SCENE: &str = "synth:figure:8000:60";
/// The paper's order of schedulers.
const POLICIES: [PolicyKind; 4] =
    [PolicyKind::Layered, PolicyKind::Dash, PolicyKind::Dependency, PolicyKind::DeadlineUtility];
/// Where utilities are kept, in the folder of the report.
const UTILITIES: &str = "utility.json";

/// Runs the verb.
pub fn run(args: &Demo, quiet: Quiet) -> Result<VerbOutput> {
    let written = ["report.html", "report.json"].map(|name| args.out.join(name));
    if let Some(file) = written.iter().find(|file| !args.overwrite && file.exists()) {
        bail!("{}: is there already; name another folder, or --overwrite", file.display());
    }
    MadeFolder::check(&args.out)?;
    let utilities = args.out.join(UTILITIES);
    // Where there is no folder yet, there is nothing in it that could not be written over.
    if args.out.is_dir() {
        written.iter().chain([&utilities]).try_for_each(|file| files::check(file))?;
    }
    let [report, figures] = written;
    let page = page(args, quiet)?;
    files::write(&report, html::page(&page).as_bytes())?;
    let json = serde_json::to_value(&page)?;
    files::write(&figures, serde_json::to_string_pretty(&json)?.as_bytes())?;
    let started = |run: &SchedulerRun| startup(run.delivery.startup_ms, run.delivery.startup_reached);
    let wide = page.runs.iter().map(|run| started(run).len()).max().map_or(8, |longest| longest.max(8));
    let mut text = format!("{}\n", page.title);
    text += &format!(
        "  {:17} {:>8} {:>9} {:>7} {:>6} {:>7} {:>6} {:>wide$} {:>6} {:>7} {:>10}\n",
        "scheduler",
        "PSNR",
        "worst 10%",
        "D",
        "SSIM",
        "flicker",
        "frozen",
        "startup",
        "miss",
        "utility",
        "wasted"
    );
    for run in &page.runs {
        text += &format!(
            "  {:17} {:>5.2} dB {:>6.2} dB {:>7.5} {:>6.4} {:>7.5} {:>6} {:>wide$} {:>5.1}% {:>7.3} {:>6.1} \
             KiB\n",
            run.name,
            run.mean_psnr_db,
            run.tail_psnr_db,
            run.distortion,
            run.mean_ssim,
            run.flicker,
            run.frozen_frames,
            started(run),
            100.0 * run.delivery.miss_rate,
            run.delivery.utility,
            run.delivery.waste.total_bytes() as f64 / 1024.0
        );
    }
    text += "  D: mean of MSE + 0.20 (1 - SSIM); flicker: share of the range; frozen: frames\n";
    for run in &page.runs {
        text += &format!(
            "  {:17} {}{}, limited by {}\n",
            run.name,
            frozen(run.freezes, run.frozen_frames),
            run.utility_bound
                .map_or(String::new(), |bound| format!(", utility at most {bound:.3} by any schedule")),
            run.limit
        );
    }
    text += &format!("{}\n{}\n", figures.display(), report.display());
    let json = json!({ "report": files::shown(&report), "figures": files::shown(&figures), "page": json });
    Ok(VerbOutput { text, json, damaged: page.damaged, ..VerbOutput::default() })
}

/// Runs the pipeline and gathers the page.
///
/// # Errors
/// Whatever stops a step.
pub fn page(args: &Demo, quiet: Quiet) -> Result<Page> {
    let backend = Backend::open(args.device.into()).context("--device")?;
    let input = args.scene.as_deref().unwrap_or(DEFAULT_SCENE);
    let Loaded { name, scene, damage } = pipeline::import(input, &args.source)?;
    // Encoding and measuring may take minutes: what they would be in vain for is refused before.
    let typed_link = pipeline::typed_link(&args.link)?;
    let encoded =
        pipeline::encode(&scene, &pipeline::encode_options(&args.codec, Protection::STANDARD), quiet)?;
    let (stream, ledger) = (encoded.stream, encoded.report.ledger);
    let map = PacketMap::of(&stream)?;
    let received = stream.receive()?;
    let content = received.content();

    let framing = Framing::of(&scene);
    let validation = framing.ring(Ring::Validation, 3, (128, 128))?;
    let gain_cameras = utility::gain_cameras(&scene)?;
    let sources = utility::References::renders(&scene, &validation, &gain_cameras);
    let options =
        utility::UtilityOptions { contexts: args.contexts.max(1), ..utility::UtilityOptions::paper() };
    let cache = args.out.join(UTILITIES);
    let _folder = MadeFolder::make(&args.out)?;
    let mut notes = scene.notes.clone();
    let damaged = damage.is_some();
    notes.extend(damage);
    let table =
        pipeline::utilities(&sources, &stream, &options, Some(&cache), quiet, &mut |w| notes.push(w))?;

    let graph = pipeline::graph(&stream, &map, Some(&table))?;
    let link = typed_link.before(&graph)?;
    let deliveries: Result<Vec<_>> = POLICIES
        .par_iter()
        .map(|&policy| pipeline::deliver(&stream, &map, &graph, &link.config, policy, args.link.transport))
        .collect();

    let deliveries = deliveries?;
    let is_model = args.link.transport == TransportName::Model;
    let bounds: Vec<Option<f64>> = deliveries
        .par_iter()
        .map(|(report, _)| if is_model { link.best_possible(report, &graph) } else { None })
        .collect();

    let progress = Progress::new("render", quiet.0);
    let (cameras, settings) = pipeline::view(&scene, &args.view, Ring::HeldOut, 3)?;
    let rendering = Rendering { scene: &scene, content: &content, camera: &cameras[0], settings, backend };
    let frames = scene.frames();
    let shown: Vec<_> =
        deliveries.iter().map(|(report, states)| (report.policy.as_str(), &states[..])).collect();
    let report = |done: usize| progress.at(done as f64 / frames as f64);
    let Measured { complete_psnr_db, runs: seen, strips } = rendering.measure(&shown, &report)?;

    let mut runs = Vec::new();
    for (i, ((report, _), seen)) in deliveries.into_iter().zip(seen).enumerate() {
        let times: std::collections::BTreeMap<u32, f64> =
            report.frames.iter().map(|row| (row.frame, row.time_ns.as_s())).collect();
        let scores = &seen.scores;
        let row = |(frame, score): (u32, &evaluator::Score)| Shown {
            time_s: times.get(&frame).copied(),
            frame,
            psnr_db: score.psnr_db,
            ssim: score.ssim,
        };
        let rows: Vec<Shown> = (0..).zip(scores).map(row).collect();
        let freezes = pipeline::freezes(&report, &graph);
        let psnr: Vec<f64> = scores.iter().map(|s| s.psnr_db).collect();
        let ssim: Vec<f64> = scores.iter().map(|s| s.ssim).collect();
        runs.push(SchedulerRun {
            name: report.policy.clone(),
            mean_psnr_db: mean(&psnr),
            tail_psnr_db: evaluator::worst_tenth(&psnr),
            distortion: seen.distortion(),
            mean_ssim: mean(&ssim),
            flicker: seen.flicker(),
            frames: rows,
            limit: link.limit(&report, &graph),
            utility_bound: bounds[i],
            freezes: freezes.count(),
            frozen_frames: freezes.frames(),
            delivery: report,
        });
    }
    let end_s = runs.iter().map(|r| r.delivery.duration_ns.as_s()).fold(0.0, f64::max);
    let width = emulator_host::Nanos::from_ms(100);
    let trace = link.trace().context("a link that follows a trace")?;
    let capacity = pipeline::capacity_bins(trace, width, (end_s * 10.0).ceil().max(1.0) as usize);
    notes.extend(link.warnings.iter().cloned());
    let mut protocol = protocol(args, &name, &scene, &stream, &ledger, &link, &table)?;
    protocol.push(("pictures".to_owned(), format!("rendered by {}", rendering.backend.name())));
    Ok(Page {
        title: format!("{name} over {}", trace.name()),
        machine: Machine::this(),
        protocol,
        ledger,
        complete_psnr_db,
        capacity_mbps: capacity.iter().enumerate().map(|(i, bps)| (i as f64 * 0.1, bps / 1e6)).collect(),
        runs,
        strips,
        notes,
        damaged,
    })
}

/// How the page was measured: (what, value) pairs in reading order.
fn protocol(
    args: &Demo,
    name: &str,
    scene: &Scene,
    stream: &Stream,
    ledger: &Ledger,
    link: &pipeline::Link,
    table: &utility::Table,
) -> Result<Vec<(String, String)>> {
    let profile = stream.manifest()?.profile_name();
    let (fps, count, frames) = (scene.frames_per_second(), scene.max_count(), scene.frames());
    let ((width, height), background) = (args.view.size(), args.view.background);
    let pairs = [
        ("scene", format!("{name}, {count} Gaussians, {frames} frames at {fps} fps")),
        (
            "stream",
            format!(
                "profile {profile}, {} packets of at most {} bytes, {} parity",
                ledger.packets, args.codec.packet_bytes, ledger.parity_packets
            ),
        ),
        ("link", link.description.clone()),
        ("controller", format!("{:?}", args.link.controller).to_lowercase()),
        (
            "quality",
            format!(
                "camera held out from every choice, {width}×{height}, background {background:?}, all frames, \
                 PSNR capped at {PSNR_CAP_DB} dB, against the uncompressed source's own render"
            ),
        ),
        ("utilities", table.protocol.clone()),
        (
            "playout",
            "starts when 95 % of the base groups of frame 0 are usable (at most 5 s), then never waits; \
             a frame not shown counts as background"
                .to_owned(),
        ),
        ("seeds", format!("scene {}, link {}", args.source.seed(), args.link.link_seed)),
    ];
    Ok(pairs.map(|(what, value)| (what.to_owned(), value)).into())
}
