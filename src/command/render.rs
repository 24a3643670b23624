//! Renders a scene or a stream to pictures or video: from cameras of a file, of the scene, or around it.

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::{Backend, Camera, Splats};
use serde_json::json;

use crate::{
    args::Render,
    files,
    output::VerbOutput,
    pictures::{PictureOutput, PictureRun, PictureWriter},
    pipeline::{self, Frames, Quiet, RENDER_RING, Showing, Surroundings, Viewpoints},
    progress::Progress,
};

/// Width and height of pictures where nothing else says, pixels.
const SIZE: (u32, u32) = (512, 512);

/// An image to make.
struct Picture {
    frame: u32,
    camera: Camera,
    /// File name in a folder of images, without its ending.
    name: String,
}

/// Runs the verb.
pub fn run(args: &Render, quiet: Quiet) -> Result<VerbOutput> {
    let output = PictureOutput::of(&args.out, args.video_codec)?;
    output.check(&args.out, args.overwrite)?;
    let backend = Backend::open(args.device.into()).context("--device")?;
    let mut warnings = Vec::new();
    let level = Level::from_bits(args.level);
    let mut frames = Frames::open(&args.input, &args.scene, level, &mut |w| warnings.push(w))?;
    let (pictures, cameras) = pictures(args, &mut frames, output.is_still())?;
    let settings = pipeline::settings(&args.view).with_footprint(frames.footprint());

    let frames_per_second = args.rate.unwrap_or_else(|| frames.frames_per_second());
    let run = PictureRun { pictures: pictures.len(), frames_per_second, overwrite: args.overwrite };
    let mut writer = PictureWriter::begin(&args.out, output, run)?;
    writer.name_cameras(&cameras);
    let mut renderer = backend.frames()?;
    let mut counters = None;
    let progress = Progress::new("render", quiet.0);
    for (done, picture) in pictures.iter().enumerate() {
        progress.step("rendering", done, pictures.len());
        let instant = frames.instant(picture.frame)?;
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        let rendered = renderer.render(&splats, &picture.camera, &settings)?;
        writer.add(&picture.name, &rendered.image)?;
        counters = Some(rendered.counters);
    }
    // Of a video, the last pictures are still to be coded.
    progress.stage("finishing", 1.0);
    writer.finish()?;
    drop(progress);
    let count = pictures.len();
    let mut text = format!("wrote {count} images to {}; {cameras}\n", args.out.display());
    for note in frames.notes() {
        text += &format!("  note: {note}\n");
    }
    let json = json!({
        "out": files::shown(&args.out),
        "images": count,
        "cameras": cameras,
        "up": frames.up().to_string(),
        "notes": frames.notes(),
        "device": backend.name(),
        "last_counters": counters,
        "warnings": warnings,
    });
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// The images that were asked for: one if `single`, else all frames from one camera, or one from each camera
/// of a list.
fn pictures(args: &Render, frames: &mut Frames, single: bool) -> Result<(Vec<Picture>, String)> {
    let own = frames.cameras().to_vec();
    let up = frames.up();
    let found = pipeline::viewpoints(
        &args.cameras,
        &args.view,
        &mut Surroundings { own: &own, framing: &mut || frames.framing(), ring: RENDER_RING, size: SIZE, up },
    )?;
    let count = frames.count();
    let views = &found.views;
    let is_list = found.showing != Showing::Clip;
    let pictures = if single && is_list {
        bail!("there are {} cameras; choose one by --camera, or give --out a folder", views.len());
    } else if single {
        vec![picture(args, &found, 0, count)?]
    } else if is_list {
        let each = (0..views.len()).map(|i| picture(args, &found, i, count));
        each.collect::<Result<_>>()?
    } else if let Some(frame) = args.frame {
        bail!("--frame is {frame}; every frame is shown there: a single image (.png) shows one");
    } else {
        let camera = &views[0].camera;
        let all =
            (0..count).map(|frame| Picture { frame, camera: camera.clone(), name: format!("{frame:05}") });
        all.collect()
    };
    Ok((pictures, if is_list { found.description } else { found.of_first() }))
}

/// The image of one camera: at the frame typed, else at its own.
fn picture(args: &Render, found: &Viewpoints, index: usize, count: u32) -> Result<Picture> {
    let view = &found.views[index];
    let frame = match args.frame {
        Some(frame) => frame,
        None => found.showing.frame_of(view, index, count)?,
    };
    let stem = view.name.rsplit(['/', '\\']).next().unwrap_or_default();
    let stem = stem.rsplit_once('.').map_or(stem, |(stem, _)| stem);
    let stem: String = stem
        .chars()
        .take(64)
        .map(|c| if c.is_ascii_alphanumeric() || "-_".contains(c) { c } else { '_' })
        .collect();
    let camera = view.camera.clone();
    let name = if stem.is_empty() { format!("{index:05}") } else { format!("{index:05}_{stem}") };
    Ok(Picture { frame, camera, name })
}
