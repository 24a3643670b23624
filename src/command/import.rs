//! Imports a scene, says what it is, and converts it: `dgs import`.

use std::{borrow::Borrow, path::Path};

use anyhow::{Context, Result};
use serde_json::json;
use trainer_host::{Epoch, export, viewpoint::Framing};

use crate::{args::Import, files, output::VerbOutput, pipeline};

/// Runs the verb.
pub fn run(args: &Import) -> Result<VerbOutput> {
    if let Some(out) = &args.out {
        check(out, args.overwrite)?;
    }
    let loaded = pipeline::import(&args.input, &args.scene)?;
    let scene = &loaded.scene;
    let mut text = format!(
        "{}: {} epochs, {} frames at {} fps, {} Gaussians (at most, per epoch)\n",
        loaded.name,
        scene.epochs().len(),
        scene.frames(),
        scene.frames_per_second(),
        scene.max_count()
    );
    let mut epochs = Vec::new();
    for (i, epoch) in scene.epochs().iter().enumerate() {
        let a = epoch.attributes();
        let moving: Vec<&str> = [
            ("positions", a.positions.is_constant()),
            ("rotations", a.rotations.is_constant()),
            ("scales", a.log_scales.is_constant()),
            ("opacity", a.opacity_logits.is_constant()),
            ("colour", a.sh0.is_constant()),
        ]
        .into_iter()
        .filter_map(|(name, constant)| (!constant).then_some(name))
        .collect();
        let still = if moving.is_empty() { "nothing".to_owned() } else { moving.join(", ") };
        if i < 4 {
            text += &format!(
                "  epoch {i}: {} Gaussians, {} frames, harmonic degree {}, moving: {still}\n",
                epoch.count(),
                epoch.frames(),
                a.sh_degree.get()
            );
        }
        epochs.push(json!({
            "gaussians": epoch.count(), "frames": epoch.frames(),
            "sh_degree": a.sh_degree.get(), "moving": moving,
        }));
    }
    if scene.epochs().len() > 4 {
        text += &format!("  … {} more epochs\n", scene.epochs().len() - 4);
    }
    let framing = Framing::of(scene);
    text += &format!("  centre {:.3?}, radius {:.3}\n", framing.target, framing.radius);
    for note in &scene.notes {
        text += &format!("  note: {note}\n");
    }
    if let Some(out) = &args.out {
        text += &write(out, args.overwrite, 0, scene.frames() as u32, |frame| {
            let found = scene.locate(frame as usize);
            let (epoch, t) = found.with_context(|| format!("there is no frame {frame}"))?;
            Ok((&scene.epochs()[epoch], t))
        })?;
    }
    let json = json!({
        "name": loaded.name, "frames": scene.frames(), "fps": scene.frames_per_second(),
        "epochs": epochs, "centre": framing.target, "radius": framing.radius, "notes": scene.notes,
        "cameras": scene.cameras.len(),
    });
    Ok(VerbOutput { text, json, ..VerbOutput::default() })
}

/// Refuses an output of frames that could not be written: a file if its name ends in .ply or .spz, else a
/// folder.
pub(super) fn check(out: &Path, overwrite: bool) -> Result<()> {
    match Format::of(out) {
        Some(_) => files::check(out),
        None => files::FrameFolder::create(out, overwrite).map(drop),
    }
}

/// Writes frames as `out` says: a folder gets all of them as PLY, a file frame `only`. `frame` gives one as
/// an epoch and the frame in it.
pub(super) fn write<E: Borrow<Epoch>>(
    out: &Path,
    overwrite: bool,
    only: u32,
    count: u32,
    mut frame: impl FnMut(u32) -> Result<(E, usize)>,
) -> Result<String> {
    if let Some(format) = Format::of(out) {
        let (epoch, t) = frame(only)?;
        files::write(out, &format.encode(epoch.borrow(), t)?)?;
        return Ok(format!("wrote {}\n", out.display()));
    }
    let mut folder = files::FrameFolder::create(out, overwrite)?;
    for number in 0..count {
        let (epoch, t) = frame(number)?;
        folder.add(format!("frame_{number:05}.ply"), &Format::Ply.encode(epoch.borrow(), t)?)?;
    }
    Ok(format!("wrote {} PLY files to {}\n", folder.finish(overwrite)?, out.display()))
}

/// What one frame is written as.
#[derive(Clone, Copy)]
enum Format {
    Ply,
    Spz,
}

impl Format {
    /// By the ending of a name; `None` is a folder's.
    fn of(out: &Path) -> Option<Self> {
        match out.extension().and_then(|e| e.to_str()) {
            Some("ply") => Some(Self::Ply),
            Some("spz") => Some(Self::Spz),
            _ => None,
        }
    }

    fn encode(self, epoch: &Epoch, t: usize) -> Result<Vec<u8>> {
        match self {
            Self::Ply => Ok(export::ply::encode(epoch, t)),
            Self::Spz => Ok(export::spz::encode(epoch, t, &export::spz::SpzOptions::default())?),
        }
    }
}
