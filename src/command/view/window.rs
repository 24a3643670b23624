//! Shows one stream in a window, or as the picture that the window would show.

use std::path::Path;

use anyhow::{Context, Result, bail};
use dgs_viewer::Session;
use dgs_window::{Feed, WindowOptions, picture, run};
use emulator_host::PolicyKind;
use serde_json::json;
use trainer_host::scene::Up;

use super::{
    loader::{StreamLoader, is_address},
    opened::opened,
};
use crate::{
    args::View,
    command::serve::name,
    files,
    output::{self, VerbOutput},
    pipeline::Quiet,
};

/// Shows it until the window is closed.
pub(super) fn window(args: &View, quiet: Quiet) -> Result<VerbOutput> {
    let input = only(args)?;
    let mut warnings = Vec::new();
    let mut damaged = false;
    let (feed, up, arriving) = if is_address(input) {
        let (arriving, feed) = StreamLoader::begin(input, args.look.seek)?;
        (feed, args.scene.up.map(Up::from), Some(arriving))
    } else {
        let mut say = |warning: String| output::print_status(&format!("warning: {warning}"));
        let opened = opened(input, args, quiet, &mut say)?;
        damaged = opened.damaged;
        (Feed::file(opened.bytes), opened.up, None)
    };
    if !quiet.0 {
        output::print_status("? in the window lists its keys; closing it ends");
    }
    let mut say = |sentence: &str| {
        output::print_status(sentence);
        warnings.push(sentence.to_owned());
    };
    let shown = run(options(args, input, up)?, feed, &mut say);
    if let Some(arriving) = arriving {
        arriving.end();
    }
    let report = shown.with_context(|| format!("{input} --window"))?;
    let rate = report.frames as f64 / report.seconds.max(1e-3);
    let text = format!("{} frames in {:.1} s on {}\n", report.frames, report.seconds, report.adapter);
    let json = json!({
        "frames": report.frames, "seconds": report.seconds, "frames_per_second": rate,
        "adapter": report.adapter, "devices_lost": report.devices_lost, "warnings": warnings,
    });
    Ok(VerbOutput { text, json, warnings: Vec::new(), damaged })
}

/// Writes the picture of frame `--at`.
pub(super) fn screenshot(args: &View, out: &Path, quiet: Quiet) -> Result<VerbOutput> {
    let input = only(args)?;
    if is_address(input) {
        bail!("{input}: --screenshot takes a file or a scene");
    }
    if out.extension().is_none_or(|ending| !ending.eq_ignore_ascii_case("png")) {
        bail!("--screenshot: {}: .png is allowed", out.display());
    }
    files::check(out)?;
    let mut warnings = Vec::new();
    let opened = opened(input, args, quiet, &mut |warning| warnings.push(warning))?;
    let (mut session, _) = Session::open(&opened.bytes)?;
    let frames = session.player().info().frames;
    if args.at >= frames {
        bail!("--at is {}; {input} has frames 0 to {}", args.at, frames.saturating_sub(1));
    }
    let image = picture(&mut session, args.at, &options(args, input, opened.up)?)?;
    files::write(out, &image.to_png()?)?;
    let text = format!("{}: {} × {} pixels\n", out.display(), image.width(), image.height());
    let json = json!({
        "out": files::shown(out), "frame": args.at,
        "width": image.width(), "height": image.height(), "warnings": warnings,
    });
    let damaged = opened.damaged;
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// The one input that a window has.
fn only(args: &View) -> Result<&str> {
    match args.inputs.as_slice() {
        [input] => Ok(input),
        inputs => bail!("--window, --screenshot: {} inputs; a window shows one", inputs.len()),
    }
}

fn options(args: &View, input: &str, up: Option<Up>) -> Result<WindowOptions> {
    let look = &args.look;
    Ok(WindowOptions {
        name: name(input),
        size: [look.width, look.height],
        background: look.background,
        up: up.and_then(|up| dgs_viewer::Up::named(up.name())),
        cap: look.level,
        overlay: look.overlay,
        time_s: look.seek,
        playing: !look.paused,
        fullscreen: look.fullscreen,
        closes: look.once,
        schedulers: PolicyKind::ALL.map(PolicyKind::name).to_vec(),
    })
}
