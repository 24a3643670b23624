//! Parses the command line: one struct per verb, whose meaning is in `command`.

mod camera;
mod codec;
mod convert;
mod cut;
mod device;
mod frames;
mod link;
mod number;
mod pictures;
mod scene;
mod socket;
mod sweep;
pub mod train;
mod view;

use std::path::PathBuf;

use clap::{Args, Parser, Subcommand, ValueEnum};
use render_host::camera::MAX_SIDE;

pub(crate) use self::pictures::RenderBackground;
pub use self::{
    camera::CameraArgs,
    codec::{CodecArgs, ProfileName},
    convert::Convert,
    cut::Cut,
    device::DeviceName,
    frames::FrameRange,
    link::{ControllerName, LinkArgs, TransportName},
    pictures::{Compare, Render},
    scene::{SceneArgs, Up},
    socket::{Play, Serve, ServerController},
    sweep::{SweepAction, SweepArgs, SweepMerge},
    view::{View, WindowArgs},
};
use self::{
    number::{background, name, not_negative, whole},
    train::Train,
};

/// What programs that call this one go by.
const EXIT_STATUS: &str = "Exit status: 0 fine, 1 refused, 2 done, but not all of it \
                           (damaged input used as far as it goes, an interrupted training, what a server did \
                           not grant), 64 not a command, 130 interrupted (0 of serve, view and play)";

/// Dynamic Gaussian splats that stay renderable when delivery is incomplete: encode, send over a
/// lossy link, decode what arrived, render, measure.
#[derive(Debug, Parser)]
#[command(name = "dgs", version, max_term_width = 100, after_help = EXIT_STATUS)]
pub struct Cli {
    /// What to do.
    #[command(subcommand)]
    pub verb: Verb,
    /// Print figures as JSON on standard output, and nothing else there.
    #[arg(long, global = true)]
    pub json: bool,
}

/// The verbs, in the order of the walk.
#[derive(Debug, Subcommand)]
pub enum Verb {
    /// Read a scene in any supported format and say what it is.
    Import(Import),
    /// Write a scene in another format, cropped, thinned, moved or merged on the way.
    ///
    /// Edits are done in one order, however they are typed: --frames, --merge, --crop, --filter, --decimate,
    /// --transform, --sh-degree; where another is wanted, convert twice. A scene is then turned so that up is
    /// where it usually is in the format written: -y in PLY, compressed PLY, .splat and SOG, y in SPZ, glTF
    /// and .4dgs.
    Convert(Box<Convert>),
    /// Fit a moving scene to photographs, or to the renders of another scene.
    Train(Box<Train>),
    /// Encode a scene to a .dgs stream.
    Encode(Encode),
    /// Say what a .dgs file holds: manifest, packets, damage.
    Inspect(Inspect),
    /// Leave packets out of a .dgs file (levels, bytes), cut it in time (frames), or order its packets.
    ///
    /// Nothing is decoded or coded again. A shorter clip is a whole stream; where packets are left out of it
    /// besides, the manifest still tells of all, and what reads the file says how many packets are missing.
    /// Parity stays where all packets of its repair set do, and goes with the first of them that is left out,
    /// since it repairs nothing then; what of it goes is said. Utilities beside the input go with the output,
    /// unless others are there.
    Cut(Cut),
    /// Decode a .dgs file to PLY or SPZ frames.
    Decode(Decode),
    /// Render a scene or a .dgs file to pictures, an animation or a video.
    Render(Render),
    /// Compare two scenes, streams or sets of pictures: PSNR, SSIM, FLIP, LPIPS, attributes.
    ///
    /// Scenes and streams are rendered from the same cameras, in the coordinates of B; of two sides that have
    /// different directions up, A is turned if it is a scene. Pictures are compared with pictures of the same
    /// names, or in the order of their names where none is the same; or with renders of their size: of the
    /// cameras that `dgs render` takes, or those that are typed, by name (the longest end of the path that is
    /// the same) where any is the same, and then all must be, else in order.
    Compare(Compare),
    /// Send a scene or a .dgs file over an emulated link under one scheduler.
    ///
    /// The utility is the share of what the stream could show; beside it stands what no schedule could pass
    /// over the same link (over the model alone; over --transport quic it is not computed). Beside all
    /// misses stand those of groups of positive utility: what would make pictures worse is left out on
    /// purpose.
    Stream(StreamArgs),
    /// Run a design of many simulations from a file: parallel, resumable, in shards; then summarise it.
    Sweep(SweepArgs),
    /// Serve streams or scenes to viewers over QUIC.
    Serve(Box<Serve>),
    /// Play a served stream: receive, decode and show frames on time.
    Play(Box<Play>),
    /// Show streams or scenes: in a browser by a page on this machine alone, or in a window.
    View(Box<View>),
    /// The whole pipeline with a report: four schedulers side by side over one link.
    Demo(Demo),
    /// Measure: the figures this project quotes.
    Bench(Bench),
    /// Print completions of commands for a shell.
    Completions(Completions),
    /// Write manual pages, one per verb.
    Man(Man),
}

/// `dgs completions`.
#[derive(Debug, Args)]
pub struct Completions {
    /// The shell.
    #[arg(value_enum)]
    pub shell: clap_complete::Shell,
}

/// `dgs man`.
#[derive(Debug, Args)]
pub struct Man {
    /// Folder to write into, which is there already.
    pub out: PathBuf,
}

/// What pictures are.
#[derive(Clone, Debug, Args)]
pub struct ViewArgs {
    /// Image width, 1 to 16384 pixels [default: 512; of cameras of a file or of the scene their own, or as
    /// their shape says by --height].
    #[arg(long, value_parser = whole(1..=MAX_SIDE, "pixels"))]
    pub width: Option<u32>,
    /// Image height, 1 to 16384 pixels [default: 512; of cameras of a file or of the scene their own, or as
    /// their shape says by --width].
    #[arg(long, value_parser = whole(1..=MAX_SIDE, "pixels"))]
    pub height: Option<u32>,
    /// Background, 0 to 1 per channel: grey level, r,g,b or #rrggbb.
    #[arg(long, default_value = "0", value_parser = background)]
    pub background: [f32; 3],
}

impl ViewArgs {
    /// The options whose values are not the defaults.
    pub fn given(&self) -> Vec<&'static str> {
        let options = [
            ("--width", self.width.is_some()),
            ("--height", self.height.is_some()),
            ("--background", self.background != [0.0; 3]),
        ];
        options.into_iter().filter(|(_, is_given)| *is_given).map(|(name, _)| name).collect()
    }

    /// Width and height, pixels, where nothing else says.
    pub fn size(&self) -> (u32, u32) {
        (self.width.unwrap_or(512), self.height.unwrap_or(512))
    }
}

/// A scheduler.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum PolicyName {
    /// All base packets first, then each level of refinement.
    Layered,
    /// Whole segments within a budget of bytes, as DASH chooses representations.
    Dash,
    /// Groups with all that they need, the earliest deadline first.
    Dependency,
    /// What each byte adds to the picture, by the time it arrives.
    DeadlineUtility,
    /// Scores by the paper's S(g) exactly; around it: the first frame's base goes first, groups with P below
    /// .05 are skipped, 16 are ranked for up to 100 ms, what was begun is finished.
    DeadlineUtilityPaper,
}

/// `dgs import`.
#[derive(Debug, Args)]
pub struct Import {
    /// File or folder, or synth:KIND:GAUSSIANS:FRAMES (numbers optional), KIND balls, figure, cloth or
    /// births, GAUSSIANS at least 1000.
    #[arg(value_parser = name())]
    pub input: String,
    /// How to read it.
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// `dgs encode`.
#[derive(Debug, Args)]
#[command(
    mut_arg("cameras", |arg| arg.help("Cameras that --target-psnr is measured from: a Blender/NeRF \
        transforms_*.json, or COLMAP's cameras and images [default: three around the scene, 28° above the \
        horizon]")),
    mut_arg("width", |arg| arg.help("Width of the pictures of --target-psnr, 1 to 16384 pixels [default: \
        256, or what a file of cameras says]")),
    mut_arg("height", |arg| arg.help("Height of the pictures of --target-psnr, 1 to 16384 pixels [default: \
        256, or what a file of cameras says]")),
    mut_arg("background", |arg| arg.help("Background of the pictures of --target-psnr, 0 to 1 per channel: \
        grey level, r,g,b or #rrggbb")),
)]
pub struct Encode {
    /// Scene, as for import.
    #[arg(value_parser = name())]
    pub input: String,
    /// Stream to write; - is standard output.
    #[arg(short, long)]
    pub out: PathBuf,
    /// How to read the scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// How to encode it.
    #[command(flatten)]
    pub codec: CodecArgs,
    /// Where --target-psnr is measured from [default: three cameras around the scene, 28° above the horizon,
    /// 256 × 256 pixels].
    #[command(flatten)]
    pub cameras: CameraArgs,
    /// What the pictures of --target-psnr are.
    #[command(flatten)]
    pub view: ViewArgs,
    /// Device that renders the pictures by which quantiser steps, --target-psnr and --search choose;
    /// utilities are measured on the processor.
    #[arg(long, value_enum, default_value_t = DeviceName::Cpu)]
    pub device: DeviceName,
    /// Also measure what each group of packets adds to a picture and write it beside the stream
    /// (NAME.utility.json): senders, `dgs cut` and the order of packets in the file go by it.
    #[arg(long)]
    pub utility: bool,
    /// Measure utilities against photographs of the scene instead of its own renders: the training split of a
    /// dataset as `dgs train` reads it, in the scene's coordinates and clip.
    #[arg(long, value_name = "DATASET", requires = "utility")]
    pub photographs: Option<PathBuf>,
    /// Measure what levels gain and do not send those that gain less than this per byte (mean
    /// distortion of the clip, MSE + 0.2 (1 - SSIM)); 0 drops what gains nothing (dgs1).
    #[arg(long, value_name = "LAMBDA", value_parser = not_negative, allow_negative_numbers = true)]
    pub truncate: Option<f64>,
    /// Print bytes and PSNR per window and level (validation cameras).
    #[arg(long)]
    pub table: bool,
    /// Also write everything that was chosen, as JSON: clusters, quantisers, motion, entropy tables, levels.
    #[arg(long, value_name = "FILE")]
    pub decisions_out: Option<PathBuf>,
    /// Choose nothing: write the scene as this file of decisions says. The same scene and decisions give the
    /// same bytes.
    #[arg(
        long,
        value_name = "FILE",
        conflicts_with_all = [
            "profile", "fineness", "pictures", "search", "cluster_size", "block_len", "window_frames", "rank",
            "packet_bytes", "repair_set", "repair", "truncate",
        ]
    )]
    pub decisions: Option<PathBuf>,
}

/// `dgs inspect`.
#[derive(Debug, Args)]
pub struct Inspect {
    /// A .dgs file; - is standard input.
    pub input: PathBuf,
    /// Also write the whole manifest as JSON: clusters, motion, quantisers, tables, groups, packets.
    #[arg(long, value_name = "FILE")]
    pub manifest: Option<PathBuf>,
    /// The file holds decisions instead, as `encode --decisions-out` writes them.
    #[arg(long)]
    pub decisions: bool,
}

/// `dgs decode`.
///
/// PLY and SPZ hold other values than a decoder gives: natural logs of scales (clamped to -20..10), logits
/// of opacities (clamped to ±12) and quaternions normalised once more, so that PLY differs from the decoded
/// values in the last bits, and SPZ by its own quantisation. Gaussians of which nothing has arrived, and
/// those that are fully transparent, are left out. For what the decoder gives, bit by bit, see --digest.
#[derive(Debug, Args)]
pub struct Decode {
    /// A .dgs file; - is standard input.
    pub input: PathBuf,
    /// A folder for a PLY sequence, or a file as convert writes it for one frame; axes are the stream's.
    #[arg(short, long, required_unless_present = "digest")]
    pub out: Option<PathBuf>,
    /// The frame for a single file [default: 0], or the only one of --digest [default: all].
    #[arg(long, value_parser = whole::<u32>(0..=u32::MAX, "frames"))]
    pub frame: Option<u32>,
    /// Highest level to use, 0 to 3.
    #[arg(long, default_value_t = 3, value_parser = whole::<u8>(0..=3, "levels"))]
    pub level: u8,
    /// Replace a folder of frames that is there already, or a .bin of something else where a .gltf goes.
    #[arg(long)]
    pub overwrite: bool,
    /// Print the digest of all decoded frames, or of that of --frame: 64-bit FNV-1a over the little-endian
    /// 32-bit floats of every Gaussian (position, scale, quaternion wxyz, opacity, sh0), then the higher
    /// bands, frame after frame.
    #[arg(long)]
    pub digest: bool,
}

/// `dgs stream`.
#[derive(Debug, Args)]
#[command(
    mut_arg("cameras", |arg| arg.help("A viewer at cameras of a file, a Blender/NeRF \
        transforms_*.json or COLMAP's cameras and images, one after the other: pictures of all frames are \
        compared with complete ones (PSNR), as for --eye and --turntable [default: no viewer, no pictures]")),
    mut_arg("width", |arg| arg.help("Width of what the viewer sees, 1 to 16384 pixels")),
    mut_arg("height", |arg| arg.help("Height of what the viewer sees, 1 to 16384 pixels")),
    mut_arg("background", |arg| arg.help("Background of what the viewer sees, 0 to 1 per channel: grey \
        level, r,g,b or #rrggbb")),
)]
pub struct StreamArgs {
    /// A .dgs file or a scene.
    #[arg(value_parser = name())]
    pub input: String,
    /// Scheduler.
    #[arg(long, value_enum, default_value_t = PolicyName::DeadlineUtility)]
    pub policy: PolicyName,
    /// An emulated link in the words of `dgs serve --impair`, in place of the options of the link but for
    /// --controller and --transport: a capacity trace, or a list of loss=5%, burst=PACKETS, rate=5mbit,
    /// delay=40ms (both ways), jitter=5ms, queue=250ms, trace=FILE, light=40mbit/15kB/100ms (the first
    /// 15 kB after a pause of 100 ms pass at 40 Mbit/s, as on cellular links), seed=1. What the receiver
    /// sends comes over 2 Mbit/s.
    #[arg(
        long, value_name = "LINK",
        conflicts_with_all = [
            "trace", "delay_trace", "trace_offset", "scale", "load", "delay_ms", "burst_loss", "queue_ms",
            "link_seed",
        ]
    )]
    pub impair: Option<String>,
    /// Save what arrived as a .dgs file. Without its manifest, complete, nothing is written.
    #[arg(short, long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Save what had arrived when each frame was displayed, as JSON: a state per frame, of each block of
    /// Gaussians the levels. `dgs train --delivery` learns from it, where its file names it as `recorded`.
    /// Where no frame was displayed nothing is written.
    #[arg(long, value_name = "FILE")]
    pub states: Option<PathBuf>,
    /// The link.
    #[command(flatten)]
    pub link: LinkArgs,
    /// A viewer, who tells the sender where it is; what it sees is compared with complete frames (PSNR).
    #[command(flatten)]
    pub cameras: CameraArgs,
    /// The viewer does not say where it is: for comparison.
    #[arg(long)]
    pub no_pose: bool,
    /// What the viewer's pictures are like.
    #[command(flatten)]
    pub view: ViewArgs,
    /// How to read a scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// How to encode a scene.
    #[command(flatten)]
    pub codec: CodecArgs,
}

/// `dgs demo`.
#[derive(Debug, Args)]
pub struct Demo {
    /// Scene, as for import [default: synth:figure:8000:60].
    #[arg(long)]
    pub scene: Option<String>,
    /// Folder for the report: report.html, report.json, and utility.json, which is measured anew only where
    /// it is of something else.
    #[arg(short, long, default_value = "dgs-demo")]
    pub out: PathBuf,
    /// Replace these files where any of them is there already.
    #[arg(long)]
    pub overwrite: bool,
    /// The link.
    #[command(flatten)]
    pub link: LinkArgs,
    /// How to read the scene.
    #[command(flatten)]
    pub source: SceneArgs,
    /// How to encode it.
    #[command(flatten)]
    pub codec: CodecArgs,
    /// Where to look from.
    #[command(flatten)]
    pub view: ViewArgs,
    /// What renders the frames of the report. Utilities are measured on the processor, whatever this says.
    #[arg(long, value_enum, default_value_t = DeviceName::Cpu)]
    pub device: DeviceName,
    /// Contexts per group when utilities are measured: 1 to 64.
    #[arg(long, default_value_t = 3, value_parser = whole::<usize>(1..=64, "contexts"))]
    pub contexts: usize,
}

/// `dgs bench`.
///
/// In the source tree cargo builds the laboratory first (profile dist), which takes minutes once; elsewhere
/// the dgs-lab beside this program runs.
#[derive(Debug, Args)]
pub struct Bench {
    /// Which figures, or `all`; see --list.
    #[arg(required_unless_present = "list")]
    pub name: Option<String>,
    /// Name the benches and what each measures.
    #[arg(long)]
    pub list: bool,
    /// Smaller sizes: under a minute where it can be.
    #[arg(long)]
    pub quick: bool,
    /// Folder with the real scenes and traces [default: ../shared/data, where it exists].
    #[arg(long)]
    pub data: Option<PathBuf>,
    /// Folder for tables (CSV) and drawings (SVG) of the benches that make them; none are written without.
    #[arg(long)]
    pub out: Option<PathBuf>,
    /// Weights of LPIPS (AlexNet, safetensors), to measure it too: in `transport`, `workloads` and `erasure`;
    /// the last also finds them in the data folder (lpips/alexnet.safetensors).
    #[arg(long, value_name = "FILE")]
    pub lpips: Option<PathBuf>,
    /// How many states per loss `erasure` measures with FLIP and LPIPS, which take longest: 1 to 128
    /// [default: 32].
    #[arg(long, value_name = "STATES", value_parser = whole::<u16>(1..=128, "states"))]
    pub perceptual_states: Option<u16>,
    /// Of `workloads` and `erasure`, which take hours, only streams, or scenes and their parity, whose names
    /// hold this, for example cloth, sheet or bouncingballs.full.
    #[arg(long, value_name = "NAME")]
    pub only: Option<String>,
}
