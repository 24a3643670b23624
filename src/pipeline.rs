//! Runs the steps from scene to report that every verb and every experiment is made of.

mod cache;
mod camera_names;
mod cameras;
mod frames;
mod impair;
mod limit;
mod link;
mod live;
mod piped;
mod recording;
mod refused;
mod sendable;
mod watching;

use std::path::Path;

use anyhow::{Context, Result, anyhow, bail};
use codec_core::internals::wire::manifest::Profile;
use emulator_host::{PacketGraph, PolicyKind, Report, SessionConfig, policy};
use render_host::{Camera, Settings};
use trainer_host::{
    Scene, Stream,
    encode::{self, Decisions, Encoded, Protection, QuantiserSteps, Target},
    import::{self, gltf::Clip, synth},
    scene::Up,
    stream::PacketMap,
    train::Checkpoint,
    utility,
    viewpoint::{Framing, Ring},
};

pub(crate) use self::{
    cache::{reference_photographs, stored_utilities, utilities_of_clip},
    camera_names::{file_names, listed, shared_end, stem},
    cameras::RENDER_RING,
    frames::{LeftOut, note_of},
    impair::{LIGHT_LOADS, impairment, light_load},
    limit::{Lost, freezes},
    link::{impaired_link, rate_words, typed_link},
    piped::bytes as input_bytes,
    recording::{read_delays, read_recording},
};
pub use self::{
    cache::{utilities, utility_path},
    cameras::{Showing, Surroundings, Viewpoints, read_cameras, viewpoints},
    frames::Frames,
    impair::viewer_link,
    link::{Link, capacity_bins, link},
    live::LiveReader,
    recording::read_trace,
    sendable::{Sendable, sendable},
    watching::Watching,
};
use crate::{
    args::{CodecArgs, PolicyName, ProfileName, SceneArgs, TransportName, ViewArgs},
    delivery::{self, Places, ShownState, WireEndpoint},
    progress::Progress,
};

/// What ends the note on the way that is taken to be up.
pub(crate) const UP_HINT: &str = "; --up says otherwise";

/// Whether progress is left out: the output is for a program (`--json`).
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Quiet(pub bool);

/// A scene and what to call it.
#[derive(Debug)]
pub struct Loaded {
    /// File name or synth description.
    pub name: String,
    /// The scene.
    pub scene: Scene,
    /// Why only a part of the file was read, with its name, where that was allowed.
    pub damage: Option<String>,
}

/// Step 1: import. `input` is a file, a folder, or `synth:KIND[:GAUSSIANS[:FRAMES]]`.
///
/// # Errors
/// What the importer refuses, with the file's name.
pub fn import(input: &str, args: &SceneArgs) -> Result<Loaded> {
    let limits = import::Limits { max_gaussians: args.max_gaussians, ..import::Limits::default() };
    if let Some(text) = input.strip_prefix("synth:") {
        let options = synth_options(text, args)?;
        let name = format!("synth {}", options.kind.name());
        let mut scene = synth::make(&options, &limits).with_context(|| format!("cannot make {input}"))?;
        scene.up = args.up.map_or(Up::default(), Into::into);
        scene.footprint = args.footprint.map_or(scene.footprint, Into::into);
        let applies = ["--fps", "--seed", "--up", "--footprint", "--max-gaussians"];
        let unused: Vec<&str> = args.given().into_iter().filter(|name| !applies.contains(name)).collect();
        if !unused.is_empty() {
            scene.notes.push(format!("the scene is made, not read; not used: {}", unused.join(", ")));
        }
        return Ok(Loaded { name, scene, damage: None });
    }
    let clip = || match &args.clip {
        None => Clip::First,
        Some(text) => text.parse().map_or_else(|_| Clip::Name(text.clone()), Clip::Index),
    };
    let options = |keep_readable: bool| import::ImportOptions {
        limits: import::Limits { keep_readable, ..limits },
        identity: if args.identity_stored { import::Identity::Stored } else { import::Identity::PerFrame },
        frames_per_second: args.fps,
        gltf: import::gltf::GltfOptions {
            clip: clip(),
            frames_per_second: args.frames_per_second(),
            samples: args.samples,
            seed: args.seed(),
            ..import::gltf::GltfOptions::default()
        },
        deformation_frames: args.deformation_frames,
    };
    let path = Path::new(input);
    if piped::is_piped(path) && !is_stream(input) {
        bail!("{input}: is no file, folder or stream; scenes are read from files and folders");
    }
    if !piped::is_piped(path) && !path.exists() {
        return Err(no_such(input));
    }
    if is_stream(input) {
        let trained = path.with_file_name("checkpoint.dgst");
        if !piped::is_piped(path) && trained.is_file() {
            bail!("{input}: is a stream, no scene; {} is the scene that was trained", trained.display());
        }
        bail!(
            "{input}: is a stream, no scene: dgs inspect says what it holds, dgs convert makes a scene of it"
        );
    }
    let mut damage = None;
    let mut scene = match trained(path, args.fps)? {
        Some(scene) => scene,
        None => match import::import(path, &options(false)) {
            Err(error) if args.keep_readable => {
                let scene = import::import(path, &options(true))
                    .map_err(|error| anyhow::anyhow!("{error}; --keep-readable finds nothing to keep"))?;
                damage = Some(format!("{error:#}; what is readable is kept"));
                scene
            }
            read => read.map_err(|error| {
                refused::hinted(error, path, || import::import(path, &options(true)).is_ok())
            })?,
        },
    };
    scene.up = match (args.up, scene.default_up) {
        (Some(typed), _) => typed.into(),
        (None, usual) => {
            let up = usual.unwrap_or_default();
            scene.notes.push(format!("up is taken to be {up}{UP_HINT}"));
            up
        }
    };
    scene.footprint = args.footprint.map_or(scene.footprint, Into::into);
    scene.notes.extend(unused_in_format(path, args));
    let name = path.file_name().map_or_else(|| input.to_owned(), |n| n.to_string_lossy().into_owned());
    Ok(Loaded { name, scene, damage })
}

/// Refuses a scene or a stream that is not there: asked before the work on those typed before it.
///
/// # Errors
/// No such file, folder or built-in scene.
pub(crate) fn check_input(input: &str, args: &SceneArgs) -> Result<()> {
    if let Some(text) = input.strip_prefix("synth:") {
        return synth_options(text, args).map(drop);
    }
    let path = Path::new(input);
    match std::fs::metadata(path) {
        Err(_) if piped::is_piped(path) => Ok(()),
        Err(error) if is_stream(input) => Err(error).with_context(|| format!("{input}: cannot read")),
        Err(_) => Err(no_such(input)),
        Ok(_) => Ok(()),
    }
}

/// That there is no `input`.
fn no_such(input: &str) -> anyhow::Error {
    anyhow!("{input}: no such file or folder (built-in scenes are named synth:figure and the like)")
}

/// What a person should know who typed options of other formats than that of the scene at `path`.
fn unused_in_format(path: &Path, args: &SceneArgs) -> Option<String> {
    // Files are read again only where anything can be unused; every format has frames.
    if args.scene_only().iter().all(|&option| option == "--fps") {
        return None;
    }
    let format = import::Format::of(path)?;
    let unused = args.unused_in(format);
    (!unused.is_empty()).then(|| format!("the scene is read as {format}; not used: {}", unused.join(", ")))
}

/// The scene in a checkpoint of a training, if the file is one.
fn trained(path: &Path, frames_per_second: Option<f64>) -> Result<Option<Scene>> {
    if path.extension().is_none_or(|extension| extension != "dgst") {
        return Ok(None);
    }
    let failed = || path.display().to_string();
    let checkpoint =
        Checkpoint::from_bytes(&std::fs::read(path).with_context(failed)?).with_context(failed)?;
    let rate = frames_per_second.unwrap_or(checkpoint.frames_per_second);
    let mut scene = checkpoint.model().scene(checkpoint.frames, rate)?;
    scene.default_up = Some(checkpoint.up());
    Ok(Some(scene))
}

fn synth_options(text: &str, args: &SceneArgs) -> Result<synth::SynthOptions> {
    let mut parts = text.split(':');
    let kind = parts.next().unwrap_or_default();
    let names: Vec<&str> = synth::SynthKind::ALL.iter().map(|k| k.name()).collect();
    let kind = synth::SynthKind::from_name(kind)
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
    Ok(synth::SynthOptions {
        kind,
        gaussians,
        frames,
        frames_per_second: args.frames_per_second(),
        seed: args.seed(),
    })
}

/// The encoder's options as typed, with `repair` if nothing is said about parity.
pub fn encode_options(args: &CodecArgs, repair: Protection) -> encode::EncodeOptions {
    let base = match args.profile {
        ProfileName::Dgs1 => encode::EncodeOptions::default(),
        ProfileName::Paper => encode::EncodeOptions::paper(),
        ProfileName::PaperContext => encode::EncodeOptions::paper_context(),
    };
    let mut cluster = base.cluster;
    cluster.max_gaussians = args.cluster_size;
    cluster.min_gaussians = cluster.min_gaussians.min(args.cluster_size);
    encode::EncodeOptions {
        cluster,
        block_len: args.block_len,
        window_frames: args.window_frames,
        rank: args.rank.unwrap_or(base.rank),
        quality: QuantiserSteps::default().scaled(args.coarseness),
        target: args
            .target_bits_per_gaussian
            .map(Target::BitsPerGaussian)
            .or(args.target_bytes.map(Target::Bytes))
            .or(args.target_psnr.map(Target::PsnrDb)),
        pictures: args.pictures.unwrap_or(encode::EncodeOptions::default().pictures),
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
pub fn encode(scene: &Scene, options: &encode::EncodeOptions, quiet: Quiet) -> Result<Encoded> {
    let progress = Progress::new("encode", quiet.0);
    encode::encode(scene, options, &|stage, share| progress.heard(stage, share)).context("cannot encode")
}

/// The stream that `decisions` describe.
///
/// # Errors
/// Decisions that do not fit the scene.
pub fn write(scene: &Scene, decisions: &Decisions, quiet: Quiet) -> Result<Encoded> {
    let progress = Progress::new("encode", quiet.0);
    encode::write(scene, decisions, &|stage, share| progress.heard(stage, share)).context("cannot encode")
}

/// `whole` without the levels that gain less than `lambda` per byte from validation cameras.
///
/// # Errors
/// If measuring or encoding fails.
pub fn truncate(
    scene: &Scene,
    options: &encode::EncodeOptions,
    whole: &Encoded,
    lambda: f64,
    quiet: Quiet,
) -> Result<(Encoded, utility::Truncated)> {
    let cameras = utility::truncation_cameras(scene)?;
    let (references, how) =
        (utility::References::renders(scene, &cameras, &cameras), utility::UtilityOptions::complete());
    let table = utilities(&references, &whole.stream, &how, None, quiet, &mut |_| ())?;
    let progress = Progress::new("encode", quiet.0);
    let report = |stage, share| progress.heard(stage, share);
    utility::truncate(scene, whole, &table, lambda, options.table_choices, &report).context("cannot encode")
}

/// A stream from a `.dgs` file; damage is passed to `warn`.
///
/// # Errors
/// If the file or its manifest cannot be read.
pub fn read_stream(path: &Path, warn: &mut dyn FnMut(String)) -> Result<Stream> {
    stream_of(path, &piped::bytes(path)?, warn)
}

/// As [`read_stream`], of the `bytes` of file `path`.
///
/// # Errors
/// As [`read_stream`].
pub(crate) fn stream_of(path: &Path, bytes: &[u8], warn: &mut dyn FnMut(String)) -> Result<Stream> {
    let magic = codec_core::internals::wire::file::MAGIC;
    let is_stream = bytes.starts_with(&magic);
    let format = import::sniff(bytes, path);
    if !is_stream && format != import::Format::Unknown {
        bail!(
            "{}: is a scene ({format}), no stream: dgs import says what it holds, dgs encode makes a stream \
             of it",
            path.display()
        );
    }
    // Fewer bytes are refused by their number.
    if !is_stream && bytes.len() >= magic.len() {
        let [found, wanted] = [&bytes[..magic.len()], &magic].map(<[u8]>::escape_ascii);
        let instead = refused::instead(path).map(|instead| format!("; {instead}")).unwrap_or_default();
        bail!(
            "{}: no usable .dgs file (dgs encode makes one of a scene): it begins with \"{found}\"; \
             \"{wanted}\" is allowed{instead}",
            path.display()
        );
    }
    let (stream, damage) = Stream::from_bytes(bytes).with_context(|| {
        format!("{}: no usable .dgs file (dgs encode makes one of a scene)", path.display())
    })?;
    if !damage.is_none() {
        warn(format!("{}: {damage}; what is readable is kept", path.display()));
    }
    Ok(stream)
}

/// What a person should know who typed options of scenes, or of how to encode them, with the stream `input`.
pub(crate) fn unused_options(input: &str, args: &SceneArgs, codec: Option<&CodecArgs>) -> Option<String> {
    let mut options = args.scene_only();
    options.extend(codec.into_iter().flat_map(CodecArgs::given));
    let names = options.join(", ");
    (!options.is_empty()).then(|| format!("{input}: is a stream; not used, being for scenes: {names}"))
}

/// Whether `input` names a `.dgs` stream rather than a scene.
pub fn is_stream(input: &str) -> bool {
    let magic = codec_core::internals::wire::file::MAGIC;
    if Path::new(input).extension().is_some_and(|e| e == "dgs") {
        return true;
    }
    if piped::is_piped(Path::new(input)) {
        // What cannot be read is refused by whoever reads it as a stream.
        return piped::bytes(Path::new(input)).map_or(true, |bytes| bytes.starts_with(&magic));
    }
    let mut head = [0u8; 4];
    std::fs::File::open(input)
        .and_then(|mut f| std::io::Read::read_exact(&mut f, &mut head))
        .is_ok_and(|()| head == magic)
}

/// Render settings as typed.
pub fn settings(args: &ViewArgs) -> Settings {
    Settings { background: args.background, ..Settings::default() }
}

/// Render settings and a ring of `count` cameras as typed.
///
/// # Errors
/// An image size the camera refuses.
pub fn view(scene: &Scene, args: &ViewArgs, ring: Ring, count: usize) -> Result<(Vec<Camera>, Settings)> {
    let framing = Framing::of(scene);
    let cameras = framing.ring(ring, count, args.size()).map_err(cameras::around_the_scene)?;
    Ok((cameras, settings(args)))
}

/// The scheduler as the emulator names it.
pub const fn policy(name: PolicyName) -> PolicyKind {
    match name {
        PolicyName::Layered => PolicyKind::Layered,
        PolicyName::Dash => PolicyKind::Dash,
        PolicyName::Dependency => PolicyKind::Dependency,
        PolicyName::DeadlineUtility => PolicyKind::DeadlineUtility,
        PolicyName::DeadlineUtilityPaper => PolicyKind::DeadlineUtilityPaper,
    }
}

/// What a delivery came to.
#[derive(Debug)]
pub struct Delivered {
    /// Figures.
    pub report: Report,
    /// What was shown, frame by frame.
    pub shown: Vec<ShownState>,
    /// Whether each packet of the stream has arrived or was recovered; `None`: its manifest did not arrive
    /// complete, without which no packet can be read.
    pub arrived: Option<Vec<bool>>,
}

/// Steps 8 to 12: schedule, send, link, receive, repair, closure, with the real receiver.
///
/// # Errors
/// A configuration that the transport refuses.
pub fn deliver(
    stream: &Stream,
    map: &PacketMap,
    graph: &PacketGraph,
    config: &SessionConfig,
    policy: PolicyKind,
    transport: TransportName,
) -> Result<(Report, Vec<ShownState>)> {
    let Delivered { report, shown, .. } = delivered(stream, map, graph, config, policy, transport)?;
    Ok((report, shown))
}

/// As [`deliver`], with what has arrived.
///
/// # Errors
/// As [`deliver`].
pub fn delivered(
    stream: &Stream,
    map: &PacketMap,
    graph: &PacketGraph,
    config: &SessionConfig,
    policy: PolicyKind,
    transport: TransportName,
) -> Result<Delivered> {
    let config = SessionConfig { policy, ..config.clone() };
    let early_bytes = config.buffer_limit * codec_core::internals::limits::MAX_PACKET_BYTES;
    let mut endpoint = WireEndpoint::new(early_bytes, stream, map, graph)?;
    let mut scheduler = policy.build(graph);
    let report = match transport {
        TransportName::Model => emulator_host::run(graph, &config, &mut *scheduler, &mut endpoint)?,
        TransportName::Quic => {
            let run = dgs_quic::virtual_time::run(graph, &config, &mut *scheduler, &mut endpoint);
            run.context("--transport quic")?
        }
    };
    let arrived = endpoint.arrived();
    Ok(Delivered { report, shown: std::mem::take(&mut endpoint.shown), arrived })
}

/// The stream as a graph, with the utilities if there are any.
///
/// # Errors
/// A stream of which nothing is there that shows.
pub fn graph(stream: &Stream, map: &PacketMap, table: Option<&utility::Table>) -> Result<PacketGraph> {
    let manifest = stream.manifest()?;
    let places = Places::of(&stream.receive()?.content(), 0..manifest.head().frames)?;
    delivery::graph(stream, &manifest, map, table, &places).context("this stream cannot be sent")
}

/// The `.dgs` file of `stream` in the order in which it is best fetched: base levels first, then what adds
/// most to the picture per byte by `table`. A stream with packets that mean nothing without others, which are
/// not there, stays as it is numbered.
///
/// # Errors
/// None in practice: the stream was read or made.
pub(crate) fn file_by_utility(stream: &Stream, table: &utility::Table) -> Result<Vec<u8>> {
    let there = stream.packets().iter().filter(|packet| !packet.is_empty()).count();
    let graph = ranked_graph(stream, &PacketMap::of(stream)?, table).ok();
    let Some(graph) = graph.filter(|graph| graph.packets().len() == there) else {
        return Ok(stream.to_bytes()?);
    };
    let order = policy::file_order(&graph).into_iter().map(|packet| graph.wire_id(packet));
    Ok(stream.to_bytes_in_order(order)?)
}

/// The stream as a graph to rank packets by, wherever they lie.
///
/// # Errors
/// As [`graph`].
pub(crate) fn ranked_graph(stream: &Stream, map: &PacketMap, table: &utility::Table) -> Result<PacketGraph> {
    let manifest = stream.manifest()?;
    let graph = delivery::graph(stream, &manifest, map, Some(table), &Places::default());
    graph.context("the packets of this stream cannot be ranked")
}

/// Name of a profile.
pub const fn profile_name(profile: Profile) -> &'static str {
    match profile {
        Profile::Paper => "paper",
        Profile::Dgs1 => "dgs1",
    }
}
