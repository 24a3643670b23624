//! The walk, step by step, as every verb and every experiment takes it.

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use codec_core::{
    closure::Arrived, gaussian::ShDegree, ids::Level, receiver::Content, wire::manifest::Profile,
};
use emulator_host::{
    ControllerKind, Nanos, PacketGraph, PolicyKind, Rate, Report, SessionConfig, Trace,
    link::{Capacity, LossModel, PathConfig, QueueLimit},
    trace,
};
use render_host::{Camera, Settings};
use trainer_host::{
    Attributes, Epoch, Scene, Stream, Track,
    encode::{self, Protection, Quality, Target},
    import::{self, gltf::Clip, synth},
    stream::{HostMemory, PacketMap, Player},
    utility,
    viewpoint::{Framing, Ring},
};

use crate::{
    args::{CodecArgs, ControllerName, LinkArgs, PolicyName, ProfileName, SceneArgs, Up, ViewArgs},
    delivery::{self, ShownState, WireEndpoint},
    progress::Progress,
};

/// Whether a person is watching.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quiet(pub bool);

/// A scene and what to call it.
#[derive(Debug)]
pub struct Loaded {
    /// File name or synth description.
    pub name: String,
    /// The scene.
    pub scene: Scene,
}

/// Step 1: import. `input` is a file, a folder, or `synth:KIND[:GAUSSIANS[:FRAMES]]`.
///
/// # Errors
/// What the importer refuses, with the file's name.
pub fn import(input: &str, args: &SceneArgs) -> Result<Loaded> {
    let limits = import::Limits {
        max_gaussians: args.max_gaussians,
        keep_readable: args.keep_readable,
        ..import::Limits::default()
    };
    if let Some(text) = input.strip_prefix("synth:") {
        let options = synth_options(text, args)?;
        let name = format!("synth {}", options.kind.name());
        let scene = synth::make(&options, &limits).with_context(|| format!("cannot make {input}"))?;
        return Ok(Loaded { name, scene });
    }
    let clip = match &args.clip {
        None => Clip::First,
        Some(text) => text.parse().map_or_else(|_| Clip::Name(text.clone()), Clip::Index),
    };
    let options = import::Options {
        limits,
        identity: if args.identity_stored { import::Identity::Stored } else { import::Identity::PerFrame },
        frames_per_second: args.fps,
        gltf: import::gltf::Options {
            clip,
            frames_per_second: args.fps,
            samples: args.samples,
            seed: args.seed,
            ..import::gltf::Options::default()
        },
    };
    let path = Path::new(input);
    if !path.exists() {
        bail!("{input}: no such file or folder (built-in scenes are named synth:figure and the like)");
    }
    let scene = import::import(path, &options)?;
    let name = path.file_name().map_or_else(|| input.to_owned(), |n| n.to_string_lossy().into_owned());
    Ok(Loaded { name, scene })
}

fn synth_options(text: &str, args: &SceneArgs) -> Result<synth::Options> {
    let mut parts = text.split(':');
    let kind = parts.next().unwrap_or_default();
    let names: Vec<&str> = synth::Kind::ALL.iter().map(|k| k.name()).collect();
    let kind = synth::Kind::from_name(kind)
        .with_context(|| format!("synth:{kind}: no such scene; there are {}", names.join(", ")))?;
    let mut number = |what: &str, default: usize| -> Result<usize> {
        match parts.next() {
            None => Ok(default),
            Some(text) => {
                text.parse().with_context(|| format!("synth:{what} is {text:?}; a number is needed"))
            }
        }
    };
    let gaussians = number("GAUSSIANS", 8000)?;
    let frames = number("FRAMES", 60)?;
    if let Some(extra) = parts.next() {
        bail!("synth: {extra:?} is one part too many; synth:KIND[:GAUSSIANS[:FRAMES]] is allowed");
    }
    Ok(synth::Options { kind, gaussians, frames, frames_per_second: args.fps, seed: args.seed })
}

/// The encoder's options as typed, with `repair` if nothing is said about parity.
pub fn encode_options(args: &CodecArgs, repair: Protection) -> encode::Options {
    let base = match args.profile {
        ProfileName::Dgs1 => encode::Options::default(),
        ProfileName::Paper => encode::Options::paper(),
    };
    let mut cluster = base.cluster;
    cluster.max_gaussians = args.cluster_size;
    cluster.min_gaussians = cluster.min_gaussians.min(args.cluster_size);
    encode::Options {
        cluster,
        block_len: args.block_len,
        window_frames: args.window_frames,
        rank: args.rank.unwrap_or(base.rank),
        quality: Quality::default().scaled(args.coarseness),
        target: args
            .target_bits_per_gaussian
            .map(Target::BitsPerGaussian)
            .or(args.target_bytes.map(Target::Bytes))
            .or(args.target_psnr.map(Target::PsnrDb)),
        search: args.search,
        packet_bytes: args.packet_bytes,
        repair: match args.repair_set {
            Some(0) => Protection::NONE,
            Some(set_len) => Protection::xor(set_len),
            None => args.repair.unwrap_or(repair),
        },
        ..base
    }
}

/// Steps 2 to 7: cluster, factorise, layer, quantise, entropy-code, packetise.
///
/// # Errors
/// Options out of range, or a scene beyond the format's bounds.
pub fn encode(scene: &Scene, options: &encode::Options, quiet: Quiet) -> Result<Stream> {
    let progress = Progress::new("encode", quiet.0);
    encode::encode(scene, options, &|stage, share| progress.stage(stage, share)).context("cannot encode")
}

/// `stream` without the levels that measuring cameras do not find worth `lambda` per byte.
///
/// # Errors
/// If measuring or encoding fails.
pub fn truncate(
    scene: &Scene,
    options: &encode::Options,
    stream: &Stream,
    lambda: f64,
    quiet: Quiet,
) -> Result<(Stream, utility::Truncated)> {
    let (map, received) = (PacketMap::of(stream)?, stream.receive()?);
    let how = utility::Options::complete(scene)?;
    let table = utilities(scene, &received.content(), &map, &how, None, quiet)?;
    let progress = Progress::new("encode", quiet.0);
    let told = |stage, share| progress.stage(stage, share);
    utility::truncate(scene, options, stream, &table, lambda, &told).context("cannot encode")
}

/// A stream from a `.dgs` file; what is damaged is told to `warn`.
///
/// # Errors
/// If the file or its manifest cannot be read.
pub fn read_stream(path: &Path, warn: &mut dyn FnMut(String)) -> Result<Stream> {
    let bytes = std::fs::read(path).with_context(|| format!("{}: cannot read", path.display()))?;
    let (stream, damage) =
        Stream::from_bytes(&bytes).with_context(|| format!("{}: not a usable .dgs file", path.display()))?;
    if !damage.is_none() {
        warn(format!("{}: {damage}; what is readable is kept", path.display()));
    }
    Ok(stream)
}

/// Whether `input` names a `.dgs` stream rather than a scene.
pub fn is_stream(input: &str) -> bool {
    let magic = codec_core::wire::file::MAGIC;
    if Path::new(input).extension().is_some_and(|e| e == "dgs") {
        return true;
    }
    let mut head = [0u8; 4];
    std::fs::File::open(input)
        .and_then(|mut f| std::io::Read::read_exact(&mut f, &mut head))
        .is_ok_and(|()| head == magic)
}

/// The scene that `content` decodes to, up to `level`: what a stream is worth as a source.
///
/// # Errors
/// If a frame does not decode.
pub fn decoded_scene(content: &Content<'_>, level: Level) -> Result<Scene> {
    let manifest = &content.manifest;
    let keep = (1u8 << (level.get() + 1)) - 1;
    let state: Vec<u8> = content.blocks.iter().map(|m| Arrived(m & keep).0).collect();
    let content = content.with_state(&state);
    let mut player = Player::new(manifest);
    let mut epochs = Vec::new();
    for record in manifest.epochs() {
        let (frames, n) = (record.frames as usize, record.gaussians as usize);
        let mut positions = Vec::with_capacity(n * frames);
        let mut rotations = Vec::with_capacity(n * frames);
        let mut log_scales = Vec::with_capacity(n * frames);
        let mut opacity_logits = Vec::with_capacity(n * frames);
        let mut sh0 = Vec::with_capacity(n * frames);
        let mut sh_rest = Vec::new();
        let mut sh_degree = ShDegree::ZERO;
        for frame in record.first_frame..record.first_frame + record.frames {
            let shown = player.show(&content, frame)?;
            for g in shown.gaussians {
                positions.push(g.position);
                rotations.push(g.rotation);
                log_scales.push(g.scale.map(f32::ln));
                opacity_logits.push((g.opacity / (1.0 - g.opacity).max(1e-9)).max(1e-9).ln());
                sh0.push(g.sh0);
            }
            sh_rest = shown.sh_rest.to_vec();
            sh_degree = shown.sh_degree;
        }
        epochs.push(Epoch::new(
            frames,
            Attributes {
                positions: Track::PerFrame(positions),
                rotations: Track::PerFrame(rotations),
                log_scales: Track::PerFrame(log_scales),
                opacity_logits: Track::PerFrame(opacity_logits),
                sh0: Track::PerFrame(sh0),
                sh_rest,
                sh_degree,
            },
        )?);
    }
    Ok(Scene::new(epochs, manifest.frames_per_second())?)
}

/// The up axis as a vector.
pub const fn up(axis: Up) -> [f64; 3] {
    match axis {
        Up::X => [1.0, 0.0, 0.0],
        Up::Y => [0.0, 1.0, 0.0],
        Up::Z => [0.0, 0.0, 1.0],
        Up::MinusY => [0.0, -1.0, 0.0],
        Up::MinusZ => [0.0, 0.0, -1.0],
    }
}

/// Render settings and a ring of `count` cameras as typed.
///
/// # Errors
/// An image size the camera refuses.
pub fn view(scene: &Scene, args: &ViewArgs, ring: Ring, count: usize) -> Result<(Vec<Camera>, Settings)> {
    let framing = Framing::of(scene, up(args.up));
    let cameras = framing.ring(ring, count, (args.width, args.height)).context("--width, --height")?;
    Ok((cameras, Settings { background: args.background, ..Settings::default() }))
}

/// Utilities of `stream` against `scene`, from `cache` if it holds them for this very stream.
///
/// # Errors
/// If measuring fails; an unusable cache is measured anew.
pub fn utilities(
    scene: &Scene,
    content: &Content<'_>,
    map: &PacketMap,
    options: &utility::Options,
    cache: Option<&Path>,
    quiet: Quiet,
) -> Result<utility::Table> {
    let crc = codec_core::wire::crc::crc32(content.manifest.raw());
    if let Some(found) = cache.and_then(|path| std::fs::read(path).ok())
        && let Ok(table) = serde_json::from_slice::<utility::Table>(&found)
        && table.manifest_crc == crc
        && table.groups.len() == map.groups().len()
    {
        return Ok(table);
    }
    let progress = Progress::new("measure utilities", quiet.0);
    let table = utility::measure(scene, content, map, options, &|share| progress.at(share))?;
    if let Some(path) = cache {
        let text = serde_json::to_string(&table)?;
        std::fs::write(path, text).with_context(|| format!("{}: cannot write", path.display()))?;
    }
    Ok(table)
}

/// Where the utilities of `stream` are cached.
pub fn utility_path(stream: &Path) -> PathBuf {
    stream.with_extension("utility.json")
}

/// The scheduler as the emulator names it.
pub const fn policy(name: PolicyName) -> PolicyKind {
    match name {
        PolicyName::Layered => PolicyKind::Layered,
        PolicyName::Dash => PolicyKind::Dash,
        PolicyName::Dependency => PolicyKind::Dependency,
        PolicyName::DeadlineUtility => PolicyKind::DeadlineUtility,
    }
}

/// Reads a capacity trace, by content: UCC CSV, mahimahi (one column) or two columns.
///
/// # Errors
/// What the loader refuses, with the file's name.
pub fn read_trace(path: &Path) -> Result<Trace> {
    let limits = trace::Limits::default();
    let bytes = trace::read(path, &limits)?;
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let first = bytes.split(|b| *b == b'\n').find(|l| !l.trim_ascii().is_empty()).unwrap_or(&[]);
    let columns = first.split(|b| b.is_ascii_whitespace()).filter(|c| !c.is_empty()).count();
    let trace = if first.starts_with(b"Timestamp") || first.contains(&b',') {
        Trace::ucc(&name, &bytes, trace::Direction::Down, &limits)
    } else if columns <= 1 {
        Trace::mahimahi(&name, &bytes, &limits)
    } else {
        // The two families differ in which end of its interval a row stands at.
        let holds = if name.contains("pitree") { trace::Holds::Backward } else { trace::Holds::Forward };
        Trace::two_column(&name, &bytes, holds, &limits)
    };
    trace.with_context(|| format!("{}: not a usable capacity trace", path.display()))
}

/// A link ready to use, and what to say about it.
#[derive(Clone, Debug)]
pub struct Link {
    /// The session without its scheduler.
    pub config: SessionConfig,
    /// Capacity over time.
    pub trace: Trace,
    /// Name, mean rate, delay, loss, for people.
    pub description: String,
    /// Warnings of the trace loader.
    pub warnings: Vec<String>,
}

/// The link as typed, for a stream of `graph`'s size.
///
/// # Errors
/// An unreadable trace, or numbers out of range.
pub fn link(args: &LinkArgs, graph: &PacketGraph) -> Result<Link> {
    let clip_s = f64::from(graph.frames()) * graph.frame_interval().as_s();
    let built_in = args.trace.is_none();
    let trace = match &args.trace {
        Some(path) => read_trace(path)?,
        None => Trace::bursty(args.link_seed, Nanos::from_s(60)),
    };
    let warnings = trace.warnings().iter().map(ToString::to_string).collect();
    let trace = match args.trace_offset {
        0.0 => trace,
        offset if offset.is_finite() && offset > 0.0 => trace.starting_at(Nanos((offset * 1e9) as u64))?,
        offset => bail!("--trace-offset is {offset}; a time of at least 0 s is allowed"),
    };
    let scale = match args.scale {
        Some(scale) if scale.is_finite() && scale > 0.0 => scale,
        Some(scale) => bail!("--scale is {scale}; a positive number is allowed"),
        None if !(args.load.is_finite() && args.load > 0.0) => {
            bail!("--load is {}; a positive number is allowed", args.load)
        }
        None if built_in => {
            let wanted = graph.total_bytes() as f64 * 8.0 / clip_s.max(0.1) / args.load;
            wanted / trace.mean_rate().0 as f64
        }
        None => 1.0,
    };
    let trace = scaled(&trace, scale)?;
    let mean = trace.mean_rate();
    let delay = args
        .delay_ms
        .map(Nanos::from_ms)
        .or_else(|| trace.base_rtt().map(|rtt| Nanos(rtt.0 / 2)))
        .unwrap_or(Nanos::from_ms(30));
    if !(0.0..=0.3).contains(&args.burst_loss) {
        bail!("--burst-loss is {}; 0 to 0.3 is allowed", args.burst_loss);
    }
    // Bursts of four packets on average, all lost: stationary share p = enter / (enter + leave).
    let leave_bad = 0.25;
    let loss = match args.burst_loss {
        0.0 => LossModel::None,
        p => LossModel::GilbertElliott {
            enter_bad: p * leave_bad / (1.0 - p),
            leave_bad,
            loss_good: 0.0,
            loss_bad: 1.0,
        },
    };
    let queue = (mean.0 as f64 / 8.0 * args.queue_ms as f64 / 1000.0) as u64;
    let forward = PathConfig {
        capacity: Capacity::Trace(trace.clone()),
        queue: QueueLimit { bytes: queue.max(24_000), ..QueueLimit::default() },
        loss,
        delay,
        ..PathConfig::default()
    };
    let reverse =
        PathConfig { capacity: Capacity::Constant(Rate::from_mbps(2)), delay, ..PathConfig::default() };
    let config = SessionConfig {
        seed: args.link_seed,
        controller: match args.controller {
            ControllerName::Newreno => ControllerKind::NewReno,
            ControllerName::BbrModel => ControllerKind::BbrModel,
        },
        forward,
        reverse,
        ..SessionConfig::default()
    };
    let description = format!(
        "{} × {scale:.3}, mean {:.2} Mbit/s, {:.0} ms one way, queue {} kB, bursts of loss {:.1} %",
        trace.name(),
        mean.0 as f64 / 1e6,
        delay.as_ms(),
        queue.max(24_000) / 1000,
        100.0 * args.burst_loss
    );
    Ok(Link { config, trace, description, warnings })
}

/// `trace` with `factor` times the capacity.
fn scaled(trace: &Trace, factor: f64) -> Result<Trace> {
    if factor == 1.0 {
        return Ok(trace.clone());
    }
    // Capacity as rates over 20 ms bins, so that opportunities scale too.
    let period = trace.period();
    let bins = (period.0 / 20_000_000).clamp(1, 2_000_000);
    let steps = capacity_bins(trace, Nanos(20_000_000), bins as usize)
        .into_iter()
        .enumerate()
        .map(|(i, bits_per_s)| trace::Step {
            at: Nanos(i as u64 * 20_000_000),
            rate: Rate((bits_per_s * factor) as u64),
        })
        .collect();
    Ok(Trace::steps(trace.name(), steps, Nanos(bins * 20_000_000))?)
}

/// Mean capacity of the first `bins` bins of `width`, bits/s, the trace repeating.
pub fn capacity_bins(trace: &Trace, width: Nanos, bins: usize) -> Vec<f64> {
    let mut out = vec![0.0; bins];
    let period = trace.period().0.max(1);
    match trace.shape() {
        trace::Shape::Opportunities(at) => {
            let span = width.0 * bins as u64;
            let mut start = 0u64;
            while start < span {
                for t in at.iter().map(|t| t.0 + start).take_while(|&t| t < span) {
                    out[(t / width.0) as usize] += 1500.0 * 8.0 / width.as_s();
                }
                start += period;
            }
        }
        trace::Shape::Steps(steps) => {
            for (i, out) in out.iter_mut().enumerate() {
                // Samples inside the bin are enough: steps are far longer than bins.
                let samples = 4;
                for s in 0..samples {
                    let t = (i as u64 * width.0 + width.0 * s / samples) % period;
                    let at = steps.partition_point(|step| step.at.0 <= t).max(1) - 1;
                    *out += steps[at].rate.0 as f64 / samples as f64;
                }
            }
        }
    }
    out
}

/// Steps 8 to 12: schedule, send, link, receive, repair, closure, with the real receiver.
///
/// # Errors
/// A configuration the emulator refuses.
pub fn deliver(
    stream: &Stream,
    map: &PacketMap,
    graph: &PacketGraph,
    config: &SessionConfig,
    policy: PolicyKind,
) -> Result<(Report, Vec<ShownState>)> {
    let manifest = stream.manifest()?;
    let config = SessionConfig { policy, ..config.clone() };
    let mut memory = HostMemory::new(&manifest, config.buffer_limit * codec_core::limits::MAX_PACKET_BYTES)?;
    let mut endpoint = WireEndpoint::new(memory.memory(), stream, &manifest, map, graph);
    let mut scheduler = policy.build(graph);
    let report = emulator_host::run(graph, &config, &mut *scheduler, &mut endpoint)?;
    let shown = std::mem::take(&mut endpoint.shown);
    Ok((report, shown))
}

/// The stream as a graph, with the utilities if there are any.
///
/// # Errors
/// A stream that lacks packets.
pub fn graph(stream: &Stream, map: &PacketMap, table: Option<&utility::Table>) -> Result<PacketGraph> {
    let manifest = stream.manifest()?;
    delivery::graph(stream, &manifest, map, table).context("this stream cannot be sent")
}

/// Name of a profile.
pub const fn profile_name(profile: Profile) -> &'static str {
    match profile {
        Profile::Paper => "paper",
        Profile::Dgs1 => "dgs1",
    }
}
