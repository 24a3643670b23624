//! Parses what showing takes: in a browser, in a window, as one picture.

use std::path::PathBuf;

use clap::{ArgGroup, Args};
use dgs_viewer::Overlay;
use render_host::camera::MAX_SIDE;

use super::{
    CodecArgs, SceneArgs,
    number::{background, name, not_negative, whole},
};

/// `dgs view`.
#[derive(Debug, Args)]
#[command(group = ArgGroup::new("native").args(["window", "screenshot"]))]
pub struct View {
    /// .dgs files or scenes (which are encoded first), each called by its file name without extension; with
    /// --window one of them, or http(s)://….dgs by byte ranges, or the dgs:// URL of a server.
    #[arg(required = true, value_name = "STREAM|SCENE|URL", value_parser = name())]
    pub inputs: Vec<String>,
    /// TCP port of the page on this machine; 0 takes a free one.
    #[arg(long, default_value_t = 4641, conflicts_with = "native")]
    pub port: u16,
    /// Show it in a window of this machine, not in a browser; in builds with `--features window`.
    #[arg(long)]
    pub window: bool,
    /// Write the picture that the window would show to this PNG file; no display is needed, and no window
    /// opened.
    #[arg(long, value_name = "FILE.png")]
    pub screenshot: Option<PathBuf>,
    /// Frame of the picture of --screenshot, from 0.
    #[arg(long, value_name = "FRAME", default_value_t = 0, requires = "screenshot")]
    pub at: u32,
    /// How a window begins.
    #[command(flatten)]
    pub look: WindowArgs,
    /// How to read a scene.
    #[command(flatten)]
    pub scene: SceneArgs,
    /// How to encode a scene.
    #[command(flatten)]
    pub codec: CodecArgs,
}

/// How a window begins.
#[derive(Debug, Args)]
pub struct WindowArgs {
    /// Width of the window or the screenshot, 1 to 16384 pixels.
    #[arg(
        long, default_value_t = 1280, value_parser = whole::<u32>(1..=MAX_SIDE, "pixels"), requires = "native"
    )]
    pub width: u32,
    /// Height of the window or the screenshot, 1 to 16384 pixels.
    #[arg(
        long, default_value_t = 720, value_parser = whole::<u32>(1..=MAX_SIDE, "pixels"), requires = "native"
    )]
    pub height: u32,
    /// Background of the window or the screenshot, 0 to 1 per channel: grey level, r,g,b or #rrggbb.
    #[arg(long, default_value = "0", value_parser = background, requires = "native")]
    pub background: [f32; 3],
    /// With --window or --screenshot: highest level shown, 0 to 3.
    #[arg(long, default_value_t = 3, value_parser = whole::<usize>(0..=3, "levels"), requires = "native")]
    pub level: usize,
    /// With --window or --screenshot: paint blocks by the level that they are shown at, by how long ago they
    /// gained one, or by the utility of what is missing: levels (without a name), arrivals, missing or none.
    #[arg(
        long, value_name = "WHAT", num_args = 0..=1, require_equals = true, default_value = "none",
        default_missing_value = "levels", value_parser = overlay, requires = "native"
    )]
    pub overlay: Overlay,
    /// With --window: begin at this time, at least 0 seconds.
    #[arg(
        long, value_name = "SECONDS", default_value_t = 0.0, value_parser = not_negative,
        allow_negative_numbers = true, requires = "window"
    )]
    pub seek: f64,
    /// With --window: begin paused.
    #[arg(long, requires = "window")]
    pub paused: bool,
    /// With --window: play once and close.
    #[arg(long, requires = "window", conflicts_with = "paused")]
    pub once: bool,
    /// With --window: take the whole display.
    #[arg(long, requires = "window")]
    pub fullscreen: bool,
}

fn overlay(text: &str) -> Result<Overlay, String> {
    Overlay::named(text).ok_or_else(|| "none, levels, arrivals and missing are allowed".to_owned())
}
