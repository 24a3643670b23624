//! Takes the walk step by step, as every verb and every experiment does.

mod link;

use std::path::{Path, PathBuf};

use anyhow::{Context, Result, bail};
use codec_core::{
    closure::Arrived, gaussian::ShDegree, ids::Level, receiver::Content, wire::manifest::Profile,
};
use emulator_host::{PacketGraph, PolicyKind, Report, SessionConfig};
use render_host::{Camera, Settings};
use trainer_host::{
    Attributes, Epoch, Scene, Stream, Track,
    encode::{self, Protection, Quality, Target},
    import::{self, gltf::Clip, synth},
    stream::{HostMemory, PacketMap, Player},
    utility,
    viewpoint::{Framing, Ring},
};

pub use self::link::{Link, capacity_bins, link, read_trace};
use crate::{
    args::{CodecArgs, PolicyName, ProfileName, SceneArgs, Up, ViewArgs},
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
        pictures: args.pictures,
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

/// `stream` without the levels that gain less than `lambda` per byte from measuring cameras.
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
    let report = |stage, share| progress.stage(stage, share);
    utility::truncate(scene, options, stream, &table, lambda, &report).context("cannot encode")
}

/// A stream from a `.dgs` file; damage is passed to `warn`.
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

/// The scene that `content` decodes to, up to `level`: a stream as a source.
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
