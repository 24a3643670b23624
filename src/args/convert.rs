//! Parses what `dgs convert` takes.

use std::path::PathBuf;

use clap::Args;
use trainer_host::edit::{Bounds, Condition, Similarity};

use super::{
    FrameRange, SceneArgs,
    number::{name, real, whole},
};

/// `dgs convert`.
#[derive(Debug, Args)]
pub struct Convert {
    /// Scene, as for import, or a .dgs file.
    #[arg(value_parser = name())]
    pub input: String,
    /// NAME.ply, .compressed.ply, .spz, .splat, .sog, .glb or .gltf (KHR_gaussian_splatting; .gltf with its
    /// buffer beside it as NAME.bin) for one frame, .4dgs or a folder for a PLY sequence of all.
    pub out: PathBuf,
    /// Keep these frames: FIRST..LAST with LAST included, FIRST.., or one.
    #[arg(long, value_name = "FIRST..LAST")]
    pub frames: Option<FrameRange>,
    /// Add the Gaussians of another scene, of as many frames or of one; may be given again. --up, --clip,
    /// --footprint and --identity-stored are of the input alone.
    #[arg(long, value_name = "SCENE", value_parser = name())]
    pub merge: Vec<String>,
    /// Keep what is inside of this box at any frame; - leaves a side open.
    #[arg(long, value_name = "x,y,z,X,Y,Z", allow_hyphen_values = true)]
    pub crop: Option<Bounds>,
    /// Keep what meets this at any frame: opacity>0.05, scale<1 and the like, of x, y, z, opacity, scale (the
    /// longest), red, green, blue; may be given again.
    #[arg(long, value_name = "CONDITION")]
    pub filter: Vec<Condition>,
    /// Leave about this share of the Gaussians, above 0, at most 1: neighbours become one where that changes
    /// pictures least, and only where they move alike.
    #[arg(
        long, value_name = "SHARE", value_parser = real(1e-9..=1.0, "a share"), allow_negative_numbers = true
    )]
    pub decimate: Option<f64>,
    /// Turn, scale and move: steps such as rotate=x:90;scale=2;translate=0,1,0, done in order.
    #[arg(long, value_name = "STEPS")]
    pub transform: Option<Similarity>,
    /// Keep harmonics up to this degree, 0 to 3.
    #[arg(long, value_parser = whole::<u8>(0..=3, "degrees"))]
    pub sh_degree: Option<u8>,
    /// Leave axes as they are.
    #[arg(long)]
    pub keep_axes: bool,
    /// The frame for a single file [default: 0].
    #[arg(long, value_parser = whole::<u32>(0..=u32::MAX, "frames"))]
    pub frame: Option<u32>,
    /// Replace a folder of frames that is there already, or a .bin of something else where a .gltf goes; a
    /// file is replaced without it.
    #[arg(long)]
    pub overwrite: bool,
    /// How to read the scene.
    #[command(flatten)]
    pub scene: SceneArgs,
}
