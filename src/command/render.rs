//! Renders a scene or a stream to pictures or video: from cameras of a file, of the scene, or around it.

use std::{ops::Range, path::Path};

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::{Backend, Camera, Splats};
use serde_json::json;

use crate::{
    args::{Render, RenderBackground},
    figures::counted,
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

/// The frames that are shown, and how many the clip has.
struct Chosen {
    count: u32,
    range: Range<u32>,
}

/// Runs the verb.
pub fn run(args: &Render, quiet: Quiet) -> Result<VerbOutput> {
    let output = PictureOutput::of(&args.out, args.video_codec)?;
    files::check_apart(&args.out, &[Path::new(&args.input)])?;
    output.check(&args.out, args.overwrite)?;
    let is_transparent = args.view.background == RenderBackground::Transparent;
    if is_transparent {
        output.check_transparent(&args.out)?;
    }
    let backend = Backend::open(args.device.into()).context("--device")?;
    let mut warnings = Vec::new();
    let level = Level::from_bits(args.level);
    let mut frames = Frames::open(&args.input, &args.scene, level, &mut |w| warnings.push(w))?;
    let (pictures, cameras) = pictures(args, &mut frames, output.is_still())?;
    let mut notes: Vec<String> =
        frames.notes().iter().cloned().chain(unused(args, &frames, output)).collect();
    notes.extend(
        pictures.first().and_then(|first| output.rounded_up(first.camera.width(), first.camera.height())),
    );
    let settings = pipeline::settings(&args.view.opaque()).with_footprint(frames.footprint());

    let frames_per_second = args.rate.unwrap_or_else(|| frames.frames_per_second());
    notes.extend(output.rounded_rate(frames_per_second));
    let (quality, overwrite) = (args.quality, args.overwrite);
    let run = PictureRun { pictures: pictures.len(), frames_per_second, quality, overwrite };
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
        counters = Some(rendered.counters);
        if is_transparent {
            writer.add_transparent(&picture.name, &rendered.image, &rendered.transmittance)?;
        } else {
            writer.add(&picture.name, &rendered.image)?;
        }
    }
    // Of a video, the last pictures are still to be coded.
    progress.stage("finishing", 1.0);
    writer.finish()?;
    drop(progress);
    let count = pictures.len();
    let mut text = format!("wrote {} to {}; {cameras}\n", counted(count, "image"), args.out.display());
    for note in &notes {
        text += &format!("  note: {note}\n");
    }
    let json = json!({
        "out": files::shown(&args.out),
        "images": count,
        "cameras": cameras,
        "up": frames.up().to_string(),
        "notes": notes,
        "device": backend.name(),
        "last_counters": counters,
        "warnings": warnings,
    });
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// Notes on options that have no effect on this scene or output.
fn unused(args: &Render, frames: &Frames, output: PictureOutput) -> Vec<String> {
    let input = &args.input;
    let mut notes = Vec::new();
    if matches!(frames, Frames::Scene(_)) && args.level != Level::HIGHEST.get() {
        notes.push(format!("{input}: is a scene; not used, being for streams: --level"));
    }
    if args.rate.is_some() && !output.is_moving() {
        let out = args.out.display();
        notes.push(format!("{out}: is no animation or video; not used, being for those: --rate"));
    }
    if args.quality.is_some() && !output.is_lossy() {
        let out = args.out.display();
        notes.push(format!("{out}: is no JPEG or video; not used, being for those: --quality"));
    }
    notes
}

/// The images to make: one if `single`, else all frames from one camera, or one from each camera of a list.
fn pictures(args: &Render, frames: &mut Frames, single: bool) -> Result<(Vec<Picture>, String)> {
    let own = frames.cameras().to_vec();
    let up = frames.up();
    let found = pipeline::viewpoints(
        &args.cameras,
        &args.view.opaque(),
        &mut Surroundings { own: &own, framing: &mut || frames.framing(), ring: RENDER_RING, size: SIZE, up },
    )?;
    let count = frames.count();
    let range = args.frames.map_or(Ok(0..count), |range| range.within(count))?;
    let chosen = Chosen { count, range };
    let views = &found.views;
    let is_list = found.showing != Showing::Clip;
    let pictures = if single && is_list {
        bail!("there are {} cameras; choose one by --camera, or give --out a folder", views.len());
    } else if single {
        if let Some(range) = args.frames {
            bail!("--frames is {range}; a single image shows one frame: --frame");
        }
        vec![picture(args, &found, 0, &chosen)?]
    } else if is_list {
        let each = (0..views.len()).map(|i| picture(args, &found, i, &chosen));
        let is_chosen = |picture: &Picture| args.frame.is_some() || chosen.range.contains(&picture.frame);
        let some: Vec<_> = each.filter(|picture| picture.as_ref().map_or(true, is_chosen)).collect();
        some.into_iter().collect::<Result<_>>()?
    } else if let Some(frame) = args.frame {
        bail!("--frame is {frame}; every frame is shown there: a single image (.png) shows one");
    } else {
        let camera = &views[0].camera;
        let all =
            chosen.range.map(|frame| Picture { frame, camera: camera.clone(), name: format!("{frame:05}") });
        all.collect()
    };
    if pictures.is_empty() {
        bail!("--frames: no camera shows a frame that is chosen");
    }
    let description = if is_list { found.of_frames(args.frames) } else { found.of_first() };
    Ok((pictures, description))
}

/// The image of one camera: at the frame typed, else at its own; cameras that play along do so over the
/// frames that are chosen.
fn picture(args: &Render, found: &Viewpoints, index: usize, chosen: &Chosen) -> Result<Picture> {
    let view = &found.views[index];
    let of_camera = || found.showing.frame_of(view, index, chosen.count, &chosen.range);
    let frame = args.frame.map_or_else(of_camera, Ok)?;
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
