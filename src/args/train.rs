//! What `dgs train` takes.

use std::path::PathBuf;

use clap::{Args, ValueEnum};

use super::{
    codec::CodecArgs,
    device::DeviceName,
    number::{background, name, not_negative, real, whole},
    scene::SceneArgs,
};

/// Loss of PSNR by encoding where nothing is said, dB.
pub(crate) const ENCODING_LOSS: f64 = 0.1;
/// Times that quality is measured after the first step where nothing is said.
pub(crate) const EVALUATIONS: u32 = 10;
/// Pictures that fine-tuning compares with, where nothing is typed.
pub(crate) const REFERENCES: usize = 64;
/// What a new epoch must gain where nothing is said, dB.
pub(crate) const SPLIT: f64 = 0.5;

/// `dgs train`.
///
/// Writes into the folder of --out: scene.dgs (the encoded scene), checkpoint.dgst (to resume, and a scene
/// for `dgs encode` and `dgs render`), log.csv, preview.png, report.html and encoder.json (options of the
/// encoder, so that --resume says where it goes on with others). A clip in several epochs (--split) has
/// epochs.json and a folder epoch-N with the checkpoint and log of each.
#[derive(Clone, Debug, Args)]
pub struct Train {
    /// A dataset: a folder with transforms_train.json (Blender, D-NeRF), transforms.json (Nerfstudio),
    /// sparse/0 (COLMAP) or train_meta.json (Panoptic). Of COLMAP every eighth image, in the order of names,
    /// is for testing, of Nerfstudio without lists every eighth frame. Or any scene that import reads: its
    /// own renders are then the photographs, and a sequence without identity becomes one moving scene.
    #[arg(value_parser = name())]
    pub input: String,
    /// Folder to write into.
    #[arg(short, long, default_value = "dgs-train")]
    pub out: PathBuf,
    /// Steps, one photograph each: the same steps and seed give the same scene.
    /// [default: 15000, or what is left of the training that is resumed]
    #[arg(long, value_parser = whole::<u32>(1..=10_000_000, "steps"))]
    pub steps: Option<u32>,
    /// Train for so many minutes instead of steps: 0.01 to 100000. They are those of the whole training; one
    /// that is resumed half way takes half of them.
    #[arg(
        long, conflicts_with = "steps", value_parser = real(0.01..=100_000.0, "minutes"),
        allow_negative_numbers = true
    )]
    pub minutes: Option<f64>,
    /// Go on from the checkpoint in --out, bit for bit; options of the training are those it was made with,
    /// and others are refused. --delivery, which goes on from delivery.dgst, and options of the encoder and
    /// of a scene's renders (--cameras, --side) are typed as before; where the encoder has others, scene.dgs
    /// is written with them, and a note names them; those that the training has rounded its values by stay.
    /// --frames stays what it was once values are rounded (finish.round_from).
    /// A training that is complete can be fine-tuned: `dgs train DATASET -o DIR --resume --delivery mixed`.
    #[arg(long)]
    pub resume: bool,
    /// Replace the training in --out, and files called as those that it writes: they are removed.
    #[arg(long, conflicts_with = "resume")]
    pub overwrite: bool,
    /// Options of the training as JSON: any of those that report.html lists. What is typed besides wins.
    /// Cameras of a rig may differ in brightness and tint: that is learnt where places have several
    /// photographs, without outlines, and the scene is their mean; {"rates": {"exposure": 0}} takes all as
    /// alike. All bands of the harmonics train from the first step; {"schedule": {"harmonics_every": 0.1}}
    /// begins one band after another, a tenth of the training apart (at most 0.25).
    #[arg(long, value_name = "FILE")]
    pub options: Option<PathBuf>,
    /// Most Gaussians, of all epochs together [default: 26000].
    #[arg(long, value_parser = whole::<usize>(1..=5_000_000, "Gaussians"))]
    pub gaussians: Option<usize>,
    /// Control nodes that carry the motion [default: 512]; 0: nothing moves.
    #[arg(long, value_parser = whole::<usize>(0..=65_536, "nodes"))]
    pub nodes: Option<usize>,
    /// Degree of the spherical harmonics, 0 to 3 [default: 2].
    #[arg(long, value_parser = whole::<u8>(0..=3, "degrees"))]
    pub sh_degree: Option<u8>,
    /// Longest side of the photographs that are trained on, pixels. Where one is larger, all are reduced, by
    /// one whole number of at most 64, and cut by a few pixels where that does not divide them; photographs
    /// that are too large or too thin for that stay larger, and a note says so. --delivery compares with no
    /// larger ones [default: 800].
    #[arg(long, value_parser = whole::<u32>(16..=16_384, "pixels"))]
    pub max_side: Option<u32>,
    /// Background that figures are for, 0 to 1 per channel: grey level, r,g,b or #rrggbb [default: 1; of
    /// --delivery on a scene 0].
    #[arg(long, value_parser = background)]
    pub background: Option<[f32; 3]>,
    /// Time of the frame whose Gaussians are stored and moved to other times, 0 to 1 of the clip [default:
    /// 0.5].
    #[arg(long, value_parser = real(0.0..=1.0, "a share of the clip"), allow_negative_numbers = true)]
    pub canonical_time: Option<f64>,
    /// How strongly neighbouring nodes move as one rigid body [default: 0.01].
    #[arg(long, value_parser = not_negative, allow_negative_numbers = true)]
    pub rigidity: Option<f64>,
    /// How Gaussians are added [default: split].
    #[arg(long, value_enum)]
    pub density: Option<DensityName>,
    /// What renders and differentiates photographs, and states of --delivery; gpu is in builds with
    /// `--features gpu`. Losses, validation, encoding and figures run on the processor, whatever this says. A
    /// training or fine-tuning may be resumed on another device; bit for bit it goes on only on its own.
    #[arg(long, value_enum, default_value_t = DeviceName::Cpu)]
    pub device: DeviceName,
    /// Steps between checkpoints; of --delivery updates, at most 20.
    #[arg(long, default_value_t = 2000, value_parser = whole::<u32>(1..=10_000_000, "steps"))]
    pub checkpoint_every: u32,
    /// Times that quality is measured during training after its first step, where it is measured too: 0 to
    /// 1000; 0: never.
    #[arg(long, default_value_t = EVALUATIONS, value_parser = whole::<u32>(0..=1000, "times"))]
    pub evaluations: u32,
    /// Fine-tune for what delivery leaves: reconstruction, iid, burst-cvar, mixed, or a JSON file of options.
    /// A dataset is trained first; a scene is taken as it is and compared with its own renders. Pixels that
    /// masks of a dataset leave out (mask_path) stay as they were trained, and count in its figures. Also
    /// writes registration.json (what was fixed before), delivery.json (what came of it), delivery.csv
    /// (update by update) and delivery.dgst (to resume); report.html shows the objective, validation, and
    /// damaged states before and after. `recorded` in the file of options names states of a real delivery,
    /// which `dgs stream --states` writes: every other world of mixed is one of them. A dataset is trained
    /// first for that; its stream is then the one that `dgs encode` makes of DIR/checkpoint.dgst.
    #[arg(long, value_name = "CONFIG")]
    pub delivery: Option<String>,
    /// With --delivery: choose the rank of the shared temporal basis before, by validation, in place of
    /// --rank. Ranks 0 to 8 are tried with three seeds each, as 27 fine-tunings of half as many updates, on
    /// pictures for validation alone. Writes ranks.json.
    #[arg(long, requires = "delivery", conflicts_with = "rank")]
    pub choose_rank: bool,
    /// Largest loss of PSNR by encoding, dB.
    ///
    /// Measured on validation views, or on training views where there are none. Quantiser steps are chosen to
    /// keep to it; where the training has rounded values itself (its last fifth; `finish` in --options),
    /// those of motion alone. --target-bytes N ends between 98 % and all of N where something moves. Other
    /// typed sizes or steps leave rounding to the encoder, and --delivery has steps of its own.
    #[arg(
        long, value_name = "DB", default_value_t = ENCODING_LOSS, value_parser = real(0.001..=100.0, "dB"),
        conflicts_with = "fineness", allow_negative_numbers = true
    )]
    pub encoding_loss: f64,
    /// Weights of LPIPS (AlexNet, safetensors), to measure it too on test views of 31 pixels a side or more;
    /// FLIP is measured wherever there are test views.
    #[arg(long, value_name = "FILE")]
    pub lpips: Option<PathBuf>,
    /// Also measure what each group of packets adds to a picture, against the training photographs, and write
    /// it beside the stream (scene.utility.json); the test photographs are a check on it.
    #[arg(long)]
    pub utility: bool,
    /// With --delivery: pictures that fine-tuning compares with, at most. Candidates are compared on a fifth
    /// as many validation photographs, or, where a dataset has none, on one in five of these pictures, which
    /// no update is made on (validation.every in the file of --delivery).
    #[arg(long, default_value_t = REFERENCES, value_parser = whole::<usize>(5..=10_000, "pictures"))]
    pub references: usize,
    /// Frames of the encoded scene [default: as many as the training photographs have instants; of
    /// transforms.json, as many as all that it lists have].
    #[arg(long, value_parser = whole::<usize>(1..=100_000, "frames"))]
    pub frames: Option<usize>,
    /// Cameras around a scene that is rendered.
    #[arg(long, default_value_t = 24, value_parser = whole::<usize>(1..=1000, "cameras"))]
    pub cameras: usize,
    /// Side of the renders of a scene, pixels.
    #[arg(long, default_value_t = 400, value_parser = whole::<u32>(16..=16_384, "pixels"))]
    pub side: u32,
    /// Where the renders of a scene change at once, begin a new epoch, trained by itself, if that gains so
    /// many dB in a trial at as many Gaussians and steps in all; 0: never. Not tried with --frames.
    #[arg(
        long, value_name = "DB", default_value_t = SPLIT, value_parser = real(0.0..=100.0, "dB"),
        allow_negative_numbers = true
    )]
    pub split: f64,
    /// How to read a scene; --fps, --seed, --up and --footprint also apply to the trained one.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// How to encode the result.
    #[command(flatten)]
    pub codec: CodecArgs,
}

/// How Gaussians are added.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum DensityName {
    /// Split those with large view-space gradients, lengths added up pixel by pixel (AbsGS).
    Split,
    /// Split those with large view-space gradients, added up before the length is taken (3DGS).
    SplitBySum,
    /// Move transparent ones to opaque ones (MCMC).
    Relocate,
}
