//! Parses what makes pictures and compares them: `dgs render` and `dgs compare`.

use std::path::PathBuf;

use clap::Args;
use render_host::camera::MAX_SIDE;

use super::{
    CameraArgs, DeviceName, FrameRange, SceneArgs, ViewArgs,
    number::{background, name, real, whole},
};
use crate::pictures::VideoCodec;

/// `dgs render`.
#[derive(Debug, Args)]
pub struct Render {
    /// A .dgs file, of which - is one at standard input, or a scene.
    #[arg(value_parser = name())]
    pub input: String,
    /// NAME.png, .jpg or .webp for one image; .apng or .gif for an animation; .mp4 or .webm for a video; -
    /// for one PNG to standard output; or a folder of PNG. Several images are all frames from one camera, or
    /// one per camera of --cameras or --turntable.
    #[arg(short, long)]
    pub out: PathBuf,
    /// How a video is coded [default: av1].
    #[arg(long, value_enum, value_name = "CODEC")]
    pub video_codec: Option<VideoCodec>,
    /// Quality of a JPEG [default: 92] or a video [default: 76 of AV1, 67 of H.264], 1 to 100; all else is
    /// lossless but for the colours of GIF.
    #[arg(long, value_parser = whole::<u8>(1..=100, "percent"))]
    pub quality: Option<u8>,
    /// Frames per second of an animation or video, 0.001 to 10000 [default: the scene's].
    #[arg(
        long, value_name = "FPS", value_parser = real(0.001..=10_000.0, "frames per second"),
        allow_negative_numbers = true
    )]
    pub rate: Option<f64>,
    /// The frame of a single image [default: 0, or the time of a camera that has one].
    #[arg(long, value_parser = whole::<u32>(0..=u32::MAX, "frames"))]
    pub frame: Option<u32>,
    /// Frames to show where there are several images, FIRST..LAST with LAST included, FIRST.., or one
    /// [default: all].
    #[arg(long, value_name = "FIRST..LAST", conflicts_with = "frame")]
    pub frames: Option<FrameRange>,
    /// Highest level to use of a stream, 0 to 3.
    #[arg(long, default_value_t = 3, value_parser = whole::<u8>(0..=3, "levels"))]
    pub level: u8,
    /// Where to look from.
    #[command(flatten)]
    pub cameras: CameraArgs,
    /// Replace a folder of images that is there already; a file is replaced without it.
    #[arg(long)]
    pub overwrite: bool,
    /// What renders the images; gpu is in builds with `--features gpu`.
    #[arg(long, value_enum, default_value_t = DeviceName::Cpu)]
    pub device: DeviceName,
    /// What pictures are.
    #[command(flatten)]
    pub view: RenderViewArgs,
    /// How to read a scene.
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// What rendered pictures are.
#[derive(Clone, Debug, Args)]
pub struct RenderViewArgs {
    /// Image width, 1 to 16384 pixels [default: 512; of cameras of a file or of the scene their own, or as
    /// their shape says by --height].
    #[arg(long, value_parser = whole(1..=MAX_SIDE, "pixels"))]
    pub width: Option<u32>,
    /// Image height, 1 to 16384 pixels [default: 512; of cameras of a file or of the scene their own, or as
    /// their shape says by --width].
    #[arg(long, value_parser = whole(1..=MAX_SIDE, "pixels"))]
    pub height: Option<u32>,
    /// Background, 0 to 1 per channel: grey level, r,g,b or #rrggbb; or transparent, in .png, .webp, .apng
    /// and folders.
    #[arg(long, default_value = "0", value_parser = background_or_transparent)]
    pub background: RenderBackground,
}

impl RenderViewArgs {
    /// The same for what is opaque: transparent is black.
    pub fn opaque(&self) -> ViewArgs {
        let background = match self.background {
            RenderBackground::Opaque(colour) => colour,
            RenderBackground::Transparent => [0.0; 3],
        };
        ViewArgs { width: self.width, height: self.height, background }
    }
}

/// What is behind rendered pictures.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum RenderBackground {
    /// A colour, each channel 0 to 1.
    Opaque([f32; 3]),
    /// Nothing: pictures are transparent there.
    Transparent,
}

/// `dgs compare`.
#[derive(Debug, Args)]
pub struct Compare {
    /// What is looked at: a scene, a .dgs file (- is one at standard input), a picture, or a folder of
    /// pictures.
    #[arg(value_parser = name())]
    pub a: String,
    /// What it is compared with: the reference.
    #[arg(value_parser = name())]
    pub b: String,
    /// Write each picture of A, of B and their FLIP error map, from left to right: PNG in a folder, called as
    /// in the table, or one after another in .mp4, .webm, .apng or .gif, camera by camera. In the map dark
    /// is equal, bright is as different as can be.
    #[arg(short, long, value_name = "FILE|FOLDER")]
    pub out: Option<PathBuf>,
    /// Replace a folder of images that is there already; a file is replaced without it.
    #[arg(long)]
    pub overwrite: bool,
    /// Frames to compare, FIRST..LAST with LAST included, or one of them [default: all].
    #[arg(long, value_name = "FIRST..LAST")]
    pub frames: Option<FrameRange>,
    /// Highest level to use of a stream, 0 to 3.
    #[arg(long, default_value_t = 3, value_parser = whole::<u8>(0..=3, "levels"))]
    pub level: u8,
    /// Weights of LPIPS (AlexNet, safetensors), to measure it too.
    #[arg(long, value_name = "FILE")]
    pub lpips: Option<PathBuf>,
    /// What renders pictures; gpu is in builds with `--features gpu`.
    #[arg(long, value_enum, default_value_t = DeviceName::Cpu)]
    pub device: DeviceName,
    /// Where to look from.
    #[command(flatten)]
    pub cameras: CameraArgs,
    /// What pictures are.
    #[command(flatten)]
    pub view: ViewArgs,
    /// How to read scenes.
    #[command(flatten)]
    pub scene: SceneArgs,
}

/// Parses a background of what may be transparent: as [`background`], or `transparent`, which gives none.
fn background_or_transparent(text: &str) -> Result<RenderBackground, String> {
    match text.trim() {
        "transparent" => Ok(RenderBackground::Transparent),
        _ => background(text).map(RenderBackground::Opaque).map_err(|e| format!("{e}, or transparent")),
    }
}
