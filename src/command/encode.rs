//! Encodes a scene to a `.dgs` file, and says where every byte went: `dgs encode`.

use std::{path::Path, time::Instant};

use anyhow::{Context, Result, bail};
use render_host::Backend;
use serde_json::json;
use trainer_host::{
    Scene, Stream,
    encode::{Decisions, EncodeOptions, Encoded, PacketReport, Protection, Report, Target, TargetViews},
    evaluator::{self, Segment},
    train::dataset,
    utility::{ReferencePhotographs, References, Table, Truncated, UtilityOptions, gain_cameras},
    viewpoint::{Framing, Ring},
};

use crate::{
    args::{Encode, ProfileName},
    figures::{audit_lines, counted, number},
    files,
    output::VerbOutput,
    pipeline::{self, Loaded, Quiet, Surroundings},
};

/// Cameras that a target PSNR is measured from, where none are typed.
const TARGET_CAMERAS: usize = 3;
/// Width and height of the pictures that a target PSNR is measured on, pixels.
const TARGET_SIZE: (u32, u32) = (256, 256);

/// Runs the verb.
pub fn run(args: &Encode, quiet: Quiet) -> Result<VerbOutput> {
    check_outputs(args)?;
    let photographs = args.photographs.as_deref().map(photographs).transpose().context("--photographs")?;
    let mut loaded = pipeline::import(&args.input, &args.scene)?;
    let mut warnings: Vec<String> = loaded.damage.take().into_iter().collect();
    let damaged = !warnings.is_empty();
    let unused = args.codec.unused();
    if !unused.is_empty() {
        let notes = &mut loaded.scene.notes;
        notes.push(format!("not used, being for --profile dgs1: {}", unused.join(", ")));
    }
    let device = args.device.into();
    Backend::open(device).context("--device")?;
    let target_views = target_views(args, &loaded.scene)?;
    let (target_views, cameras) = target_views.unzip();
    let options =
        EncodeOptions { device, target_views, ..pipeline::encode_options(&args.codec, Protection::NONE) };
    let coded = Coded::of(args, &loaded.scene, &options, quiet)?;
    loaded.scene.notes.extend(cluster_size_note(args, &coded.encoded.report));
    loaded.scene.notes.extend(beyond_size_note(&coded.encoded.report));
    let stream = &coded.encoded.stream;
    if let Some(path) = &args.decisions_out {
        files::write(path, serde_json::to_string(&coded.encoded.decisions)?.as_bytes())?;
    }
    let bytes = stream.to_bytes()?;
    files::write(&args.out, &bytes)?;
    let VerbOutput { mut text, mut json, .. } = said(args, &loaded, &coded, cameras, bytes.len())?;
    if args.table {
        let segments = evaluator::segments(&loaded.scene, stream, 2)?;
        text += &segment_table(&segments);
        json["segments"] = json!(segments);
    }
    if args.utility {
        let path = pipeline::utility_path(&args.out);
        let table = utilities(photographs.as_ref(), &loaded.scene, stream, &path, quiet, &mut warnings)?;
        // What was written to a pipe is gone.
        if args.out.is_file() {
            files::write(&args.out, &pipeline::file_by_utility(stream, &table)?)?;
        }
        let audit = table.audit();
        text += &format!("utilities of {} groups → {}\n", table.groups.len(), path.display());
        text += &audit_lines(&audit);
        if audit.first().is_some_and(|base| 2 * base.negative_mean > base.groups) {
            warnings.push(
                "most base levels make pictures worse: the references may show another scene".to_owned(),
            );
        }
        json["utility"] = json!({
            "groups": table.groups.len(), "protocol": table.protocol, "levels": audit,
            "path": files::shown(&path),
            "negative_mean": audit.iter().map(|level| level.negative_mean).sum::<usize>(),
        });
    }
    json["warnings"] = json!(warnings);
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// Refuses before the work what could not be written, or what would be written over an input.
fn check_outputs(args: &Encode) -> Result<()> {
    let mut others: Vec<&Path> = vec![args.input.as_ref()];
    others.extend(args.decisions.as_deref());
    files::check_stream(&args.out, &others)?;
    others.push(&args.out);
    if args.utility {
        if files::is_standard_output(&args.out) {
            bail!("--utility: is written beside the stream, and nothing is beside standard output");
        }
        let utilities = pipeline::utility_path(&args.out);
        files::check(&utilities)?;
        let mut others = others.clone();
        others.extend(args.decisions_out.as_deref());
        files::check_apart(&utilities, &others)?;
    }
    if args.truncate.is_some() && args.codec.profile != ProfileName::Dgs1 {
        bail!("--truncate: profile paper sends every level; profile dgs1 is allowed");
    }
    if let Some(path) = &args.decisions_out {
        files::check_apart(path, &others)?;
        files::check_json(path)?;
    }
    Ok(())
}

/// A scene as a stream, and how it became one.
struct Coded {
    encoded: Encoded,
    truncated: Option<Truncated>,
    seconds: f64,
}

impl Coded {
    /// By the decisions of a file where one is named, else by `options`.
    fn of(args: &Encode, scene: &Scene, options: &EncodeOptions, quiet: Quiet) -> Result<Self> {
        let start = Instant::now();
        let mut encoded = match &args.decisions {
            Some(path) => {
                let decisions = read_decisions(path)?;
                check_decisions(&decisions, scene).with_context(|| path.display().to_string())?;
                pipeline::write(scene, &decisions, quiet)?
            }
            None => pipeline::encode(scene, options, quiet)?,
        };
        let mut truncated = None;
        if let Some(lambda) = args.truncate {
            let found = pipeline::truncate(scene, options, &encoded, lambda, quiet)?;
            encoded = found.0;
            truncated = Some(found.1);
        }
        Ok(Self { encoded, truncated, seconds: start.elapsed().as_secs_f64() })
    }
}

/// What the verb says of a stream of `file_bytes` bytes.
fn said(
    args: &Encode,
    loaded: &Loaded,
    Coded { encoded, truncated, seconds }: &Coded,
    cameras: Option<String>,
    file_bytes: usize,
) -> Result<VerbOutput> {
    let report = &encoded.report;
    let packets = encoded.packet_report()?;
    let ledger = &report.ledger;
    let mut text = format!(
        "{} → {} ({file_bytes} bytes at rest, {}, {seconds:.2} s)\n{}",
        loaded.name,
        args.out.display(),
        counted(loaded.scene.frames(), "frame"),
        report_table(report, &packets)
    );
    if let Some(t) = truncated {
        text += &format!(
            "  truncation at {}: {} of {} groups not sent, {:.0} bytes on the wire instead of {:.0}\n",
            number(t.lambda),
            t.dropped,
            t.groups,
            t.wire_after,
            t.wire_before
        );
    }
    if let Some(views) = report.reached.and_then(|reached| reached.views) {
        text += &format!(
            "  measured on {} from {}, pictures of {} × {}, of which the scene covers {:.1} %; each counts \
             by the share that is covered\n",
            counted(views.frames, "frame"),
            cameras.unwrap_or_default(),
            views.width,
            views.height,
            100.0 * views.covered
        );
    }
    for note in &loaded.scene.notes {
        text += &format!("note: {note}\n");
    }
    let mut json = json!({
        "name": loaded.name, "out": files::shown(&args.out), "file_bytes": file_bytes, "seconds": seconds,
        "ledger": ledger, "report": report_json(report), "packets": packets, "parts": ledger.parts(),
        "notes": loaded.scene.notes,
        "bits_per_gaussian": ledger.bits_per_gaussian(), "bytes_per_frame": ledger.bytes_per_frame(),
    });
    if let Some(truncated) = truncated {
        json["truncated"] = json!(truncated);
    }
    Ok(VerbOutput { text, json, ..VerbOutput::default() })
}

/// Where the target PSNR is measured, if there is one, and what that is for people.
fn target_views(args: &Encode, scene: &Scene) -> Result<Option<(TargetViews, String)>> {
    if args.codec.target_psnr.is_none() {
        let is_given = args.view.width.is_some() || args.view.height.is_some();
        if args.cameras.is_given() || is_given || args.view.background != [0.0; 3] {
            bail!("cameras and pictures are for --target-psnr, which is missing");
        }
        return Ok(None);
    }
    let mut around = Surroundings {
        own: &[],
        framing: &mut || Ok(Framing::of(scene)),
        ring: (Ring::Validation, TARGET_CAMERAS),
        size: TARGET_SIZE,
        up: scene.up,
    };
    let found = pipeline::viewpoints(&args.cameras, &args.view, &mut around)?;
    let cameras = found.views.into_iter().map(|view| view.camera).collect();
    Ok(Some((TargetViews { cameras, background: args.view.background }, found.description)))
}

/// Longest side of photographs as they are read, pixels: several times what utilities are measured at.
const LONGEST_READ: u32 = 800;

/// The training photographs of a dataset, over the background that utilities are measured over.
fn photographs(folder: &Path) -> Result<ReferencePhotographs> {
    let (dataset, _) = dataset::read_reduced(folder, LONGEST_READ)?;
    let background = UtilityOptions::paper().settings.background;
    Ok(pipeline::reference_photographs(&dataset.train, background)?)
}

/// Utilities of the groups of `stream`, against photographs if some were named.
fn utilities(
    photographs: Option<&ReferencePhotographs>,
    scene: &Scene,
    stream: &Stream,
    path: &Path,
    quiet: Quiet,
    warnings: &mut Vec<String>,
) -> Result<Table> {
    let options = UtilityOptions::paper();
    let mut measure = |references: &References<'_>| {
        let warn = &mut |warning| warnings.push(warning);
        pipeline::utilities(references, stream, &options, Some(path), quiet, warn)
    };
    if let Some(photographs) = photographs {
        return measure(&References::Photographs(photographs)).context("--photographs");
    }
    let cameras = Framing::of(scene).ring(Ring::Validation, 3, (160, 160))?;
    measure(&References::renders(scene, &cameras, &gain_cameras(scene)?))
}

/// Decisions from a file.
///
/// # Errors
/// A file that cannot be read, or does not hold decisions.
pub(super) fn read_decisions(path: &Path) -> Result<Decisions> {
    let file = std::fs::File::open(path).with_context(|| format!("{}: cannot read", path.display()))?;
    // Read as it is parsed: what is something else, and perhaps has no end, is refused at its beginning.
    serde_json::from_reader(std::io::BufReader::new(file))
        .with_context(|| format!("{}: not a file of decisions", path.display()))
}

/// Refuses decisions for another scene.
fn check_decisions(decisions: &Decisions, scene: &Scene) -> Result<()> {
    let Decisions::Dgs1(decisions) = decisions else { return Ok(()) };
    let (found, wanted) = (scene.epochs().len(), decisions.epochs.len());
    if found != wanted {
        bail!("the scene has {}; the decisions are for {wanted}", counted(found, "epoch"));
    }
    for (i, (epoch, decided)) in scene.epochs().iter().zip(&decisions.epochs).enumerate() {
        let found = epoch.count();
        // What is never drawn is in no cluster: where the file does not say how many there were, any number
        // of such may be there.
        let in_clusters: usize = decided.clusters.iter().map(|cluster| cluster.gaussians.len()).sum();
        let recorded = decisions.made_from.epoch_gaussians.get(i).copied();
        let wanted = recorded.unwrap_or(in_clusters);
        if found < wanted || recorded.is_some_and(|recorded| found != recorded) {
            let of = if scene.epochs().len() > 1 { format!(" in epoch {i}") } else { String::new() };
            bail!("the scene has {}{of}; the decisions are for {wanted}", counted(found, "Gaussian"));
        }
    }
    Ok(())
}

/// What is said of a bound on clusters that none comes near, although there are Gaussians for it.
fn cluster_size_note(args: &Encode, report: &Report) -> Option<String> {
    let (c, most) = (&report.clustering, args.codec.cluster_size);
    let is_given = args.decisions.is_none() && args.codec.given().contains(&"--cluster-size");
    (is_given && 2 * c.largest <= most && c.clusters > 1).then(|| {
        format!(
            "--cluster-size {most}: the largest cluster has {}; what is spread out is cut, down to {} \
             Gaussians, however many are allowed",
            counted(c.largest, "Gaussian"),
            c.options.min_gaussians
        )
    })
}

/// Share of a target size below which a stream is not close to it.
const CLOSE: f64 = 0.98;
/// Coarseness below which a search for a size goes only for want of bytes.
const FINE: f32 = 1.0 / 16.0;

/// What is said of a target size that is more than the scene takes at any coarseness that was tried.
fn beyond_size_note(report: &Report) -> Option<String> {
    let reached = report.reached?;
    let is_size = !matches!(reached.target, Target::PsnrDb(_));
    let is_less = reached.value < CLOSE * reached.target.value();
    (is_size && is_less && reached.coarseness < FINE).then(|| {
        format!(
            "{} is {}: coarseness {}, the closest that was tried, comes to {}",
            reached.target.name(),
            number(reached.target.value()),
            reached.coarseness,
            number(reached.value)
        )
    })
}

/// How Gaussians were clustered, for people.
fn clustering_line(report: &Report) -> String {
    let (c, w) = (&report.clustering, &report.clustering.options.weights);
    format!(
        "  {} clusters of {} to {} Gaussians (mean {:.1}, median {}), feature weights: position {}, \
         displacement \
         {}, speed {}, visibility {}\n",
        c.clusters,
        c.smallest,
        c.largest,
        c.mean,
        c.median,
        w.position,
        w.displacement,
        w.speed,
        w.visibility
    )
}

/// Rate and distortion per segment for people.
fn segment_table(segments: &[Segment]) -> String {
    let mut text =
        "  epoch window  frames          level  canonical     motion  cumulative   PSNR\n".to_owned();
    for s in segments {
        let window = s.window.map_or("-".to_owned(), |w| w.to_string());
        let frames = format!("{}..{}", s.first_frame, (s.first_frame + s.frames).saturating_sub(1));
        for (level, p) in s.levels.iter().enumerate() {
            text += &format!(
                "  {:>5} {window:>6}  {frames:<15} {level:>5} {:>10} {:>10}  {:>10}  {:>5.2}\n",
                s.epoch, p.canonical_bytes, p.motion_bytes, p.cumulative_bytes, p.psnr_db
            );
        }
    }
    text
}

/// What was chosen and what it came to besides the ledger, for programs.
fn report_json(report: &Report) -> serde_json::Value {
    json!({
        "quality": report.quality, "quantiser_classes": report.quantiser_classes,
        "clustering": report.clustering,
        "reached": report.reached, "searched": report.searched,
    })
}

/// The accounting of a stream for people.
fn report_table(report: &Report, packets: &PacketReport) -> String {
    let ledger = &report.ledger;
    let mut text = String::new();
    for (name, bytes) in [
        ("raw symbols", ledger.raw_symbols),
        ("empirical entropy", ledger.empirical_entropy),
        ("monolithic", ledger.monolithic),
        ("payload", ledger.payload),
        ("headers", ledger.headers),
        ("dependencies", ledger.dependencies),
        ("CRC", ledger.crc),
        ("parity", ledger.parity),
        ("manifest", ledger.manifest),
        ("wire", ledger.wire()),
    ] {
        text += &format!("  {name:18} {bytes:>12.0} bytes\n");
    }
    text += &format!(
        "  {} packets + {} parity, {} bits/Gaussian, {} bytes/frame, packetisation {:.2} %, robustness \
            premium {:.2} %\n",
        ledger.packets,
        ledger.parity_packets,
        number(ledger.bits_per_gaussian()),
        number(ledger.bytes_per_frame()),
        100.0 * ledger.packetisation_overhead(),
        100.0 * ledger.robustness_premium(),
    );
    text += &format!(
        "  mean payload {:.1} bytes, fill {:.1} %, chunk loss {:.2} bytes/packet, {:.2} packets per base \
         group, \
         {:.2} per refinement group, {:.2} groups per packet\n",
        packets.mean_payload_bytes,
        100.0 * packets.fill,
        packets.chunk_loss_bytes,
        packets.packets_per_base_group,
        packets.packets_per_refinement_group,
        packets.groups_per_packet,
    );
    text += &clustering_line(report);
    if let Some(reached) = report.reached {
        text += &format!(
            "  {} {}: {} at coarseness {:.4}, {} encodings\n",
            reached.target.name(),
            number(reached.target.value()),
            number(reached.value),
            reached.coarseness,
            reached.encodes
        );
    }
    if let Some(searched) = report.searched {
        text += &format!(
            "  search: {} encodings, {} {:+.2} % bytes, {:+.2} dB from validation cameras\n",
            searched.encodes,
            if searched.is_better { "kept," } else { "nothing better:" },
            100.0 * (searched.bits - 1.0),
            searched.psnr_db
        );
    }
    if ledger.saturated > 0 {
        text += &format!("  {} values did not fit their symbol and were clamped\n", ledger.saturated);
    }
    let classes = &report.quantiser_classes;
    for (k, class) in classes.iter().enumerate().filter(|_| classes.len() > 1) {
        let q = class.quality;
        text += &format!(
            "  quantiser class {k}: {:>7} Gaussians, steps: position {:.4} sizes, scale {:.4}, rotation \
             {:.4}, \
             opacity {:.4}, sh0 {:.4}, harmonics {:.4}\n",
            class.gaussians, q.position, q.scale, q.rotation, q.opacity, q.sh0, q.sh_rest
        );
    }
    let gaussians = ledger.gaussians.max(1) as f64;
    for part in ledger.parts() {
        let (bits, bytes) = (part.bits / gaussians, part.bits / 8.0);
        text += &format!("    {:38} {bits:>9.3} bits/Gaussian {bytes:>12.1} bytes\n", part.name);
    }
    text
}
