//! Renders a scene or a stream to PNG: from cameras of a file, of the scene, or around it.

use anyhow::{Context, Result, bail};
use codec_core::internals::ids::Level;
use render_host::{
    Backend, Settings, Splats,
    camera::{Camera, View},
};
use serde_json::json;
use trainer_host::viewpoint::Ring;

use crate::{
    args::Render,
    files::{self, FrameFolder},
    output::VerbOutput,
    pipeline::{self, Frames},
};

/// Cameras on the ring around a scene without its own.
const RING: usize = 8;

/// An image to make.
struct Picture {
    frame: u32,
    camera: Camera,
    /// File name in a folder of images.
    name: String,
}

/// Runs the verb.
pub fn run(args: &Render) -> Result<VerbOutput> {
    let backend = Backend::open(args.device.into()).context("--device")?;
    let single = args.out.extension().is_some_and(|e| e == "png");
    if single {
        files::check(&args.out)?;
    } else {
        FrameFolder::create(&args.out, args.overwrite)?;
    }
    let mut warnings = Vec::new();
    let stream = if pipeline::is_stream(&args.input) {
        Some(pipeline::read_stream(args.input.as_ref(), &mut |w| warnings.push(w))?)
    } else {
        None
    };
    let mut frames = match &stream {
        Some(stream) => {
            Frames::of_stream(stream.receive()?, Level::from_bits(args.level), args.scene.up.into())
        }
        None => Frames::Scene(Box::new(pipeline::import(&args.input, &args.scene)?.scene)),
    };
    let pictures = pictures(args, &mut frames, single)?;
    let settings = Settings { antialiased: args.antialiased, ..pipeline::settings(&args.view) };

    let mut folder = if single { None } else { Some(FrameFolder::create(&args.out, args.overwrite)?) };
    let mut renderer = backend.frames()?;
    let mut counters = None;
    for picture in &pictures {
        let instant = frames.instant(picture.frame)?;
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        let rendered = renderer.render(&splats, &picture.camera, &settings)?;
        let png = rendered.image.to_png()?;
        match &mut folder {
            None => files::write(&args.out, &png)?,
            Some(folder) => folder.add(picture.name.clone(), &png)?,
        }
        counters = Some(rendered.counters);
    }
    if let Some(folder) = folder {
        folder.finish(args.overwrite)?;
    }
    let count = pictures.len();
    let text = format!("wrote {count} images to {}\n", args.out.display());
    let json = json!({
        "out": args.out,
        "images": count,
        "device": backend.name(),
        "last_counters": counters,
        "warnings": warnings,
    });
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
}

/// The images that were asked for: one if `single`, else all frames from one camera, or one from each camera
/// of a file.
fn pictures(args: &Render, frames: &mut Frames, single: bool) -> Result<Vec<Picture>> {
    let views = views(args, frames)?;
    let count = frames.count();
    let chosen = match &args.camera {
        Some(text) => Some(choose(&views, text)?),
        None if args.cameras.is_none() || views.len() == 1 => Some(&views[0]),
        None => None,
    };
    match chosen {
        Some(view) if single => Ok(vec![picture(args, view, 0, count)?]),
        Some(view) => {
            let all = (0..count).map(|frame| Picture {
                frame,
                camera: view.camera.clone(),
                name: format!("{frame:05}.png"),
            });
            Ok(all.collect())
        }
        None if single => {
            bail!("--cameras has {} cameras; choose one by --camera, or give --out a folder", views.len())
        }
        None => views.iter().enumerate().map(|(i, view)| picture(args, view, i, count)).collect(),
    }
}

/// The image of one camera: at the frame typed, else at its own time.
fn picture(args: &Render, view: &View, index: usize, count: u32) -> Result<Picture> {
    let frame = match (args.frame, view.time) {
        (Some(frame), _) => frame,
        (None, None) => 0,
        (None, Some(time)) if (0.0..=1.0).contains(&time) => (time * f64::from(count - 1)).round() as u32,
        (None, Some(time)) => bail!("{}: time is {time}; 0 to 1 is allowed, or --frame", view.name),
    };
    // Of the name in the file what any system takes for a file name; numbers keep equal names apart.
    let stem = view.name.rsplit(['/', '\\']).next().unwrap_or_default();
    let stem = stem.rsplit_once('.').map_or(stem, |(stem, _)| stem);
    let stem: String = stem
        .chars()
        .take(64)
        .map(|c| if c.is_ascii_alphanumeric() || "-_".contains(c) { c } else { '_' })
        .collect();
    let camera = view.camera.clone();
    Ok(Picture { frame, camera, name: format!("{index:05}_{stem}.png") })
}

/// The camera of this name or number.
fn choose<'v>(views: &'v [View], text: &str) -> Result<&'v View> {
    let named = views.iter().find(|view| view.name == text);
    let numbered = || text.parse::<usize>().ok().and_then(|index| views.get(index));
    named.or_else(numbered).with_context(|| {
        let last = views.len() - 1;
        format!("--camera is {text}; a name in the file of --cameras, or 0 to {last} are allowed")
    })
}

/// The cameras there are, at the size typed: those of a file, of the scene, or around it.
fn views(args: &Render, frames: &mut Frames) -> Result<Vec<View>> {
    let view = &args.view;
    let mut views = match &args.cameras {
        Some(path) => pipeline::read_cameras(path, view.width.zip(view.height))?,
        None => {
            let own = match &*frames {
                Frames::Scene(scene) => scene.cameras.clone(),
                Frames::Stream { .. } => Vec::new(),
            };
            let cameras = if own.is_empty() {
                frames.framing()?.ring(Ring::HeldOut, RING, view.size()).context("--width, --height")?
            } else {
                own
            };
            cameras.into_iter().map(|camera| View { name: String::new(), time: None, camera }).collect()
        }
    };
    for found in &mut views {
        let own = (found.camera.width(), found.camera.height());
        let wanted = match args.cameras {
            Some(_) => (view.width.unwrap_or(own.0), view.height.unwrap_or(own.1)),
            None => view.size(),
        };
        if wanted != own {
            found.camera = found.camera.resized(wanted.0, wanted.1).context("--width, --height")?;
        }
    }
    Ok(views)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn view(name: &str, time: Option<f64>) -> View {
        let camera = Camera::look_at([0.0, 0.0, -3.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 8, 8).unwrap();
        View { name: name.to_owned(), time, camera }
    }

    #[test]
    fn cameras_are_chosen_by_name_before_number() {
        let views = [view("1", None), view("b/c.png", None)];
        assert_eq!(choose(&views, "1").unwrap().name, "1");
        assert_eq!(choose(&views, "b/c.png").unwrap().name, "b/c.png");
        assert_eq!(choose(&views, "0").unwrap().name, "1");
        assert!(choose(&views, "2").unwrap_err().to_string().contains("0 to 1 are allowed"));
    }
}
