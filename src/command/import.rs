//! `dgs import`: read, say what it is, convert.

use std::path::Path;

use anyhow::{Context, Result};
use serde_json::json;
use trainer_host::{Scene, export, viewpoint::Framing};

use crate::{args::Import, output::VerbOutput, pipeline};

/// Runs the verb.
pub fn run(args: &Import) -> Result<VerbOutput> {
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
    let framing = Framing::of(scene, [0.0, 1.0, 0.0]);
    text += &format!("  centre {:.3?}, radius {:.3}\n", framing.target, framing.radius);
    for note in &scene.notes {
        text += &format!("  note: {note}\n");
    }
    if let Some(out) = &args.out {
        text += &write(scene, out, 0)?;
    }
    let json = json!({
        "name": loaded.name, "frames": scene.frames(), "fps": scene.frames_per_second(),
        "epochs": epochs, "centre": framing.target, "radius": framing.radius, "notes": scene.notes,
        "cameras": scene.cameras.len(),
    });
    Ok(VerbOutput { text, json, ..VerbOutput::default() })
}

/// Writes `scene` as `out` says: a folder is a PLY sequence, a file one frame.
pub(super) fn write(scene: &Scene, out: &Path, frame: usize) -> Result<String> {
    let failed = || format!("{}: cannot write", out.display());
    match out.extension().and_then(|e| e.to_str()) {
        Some(kind @ ("ply" | "spz")) => {
            let (epoch, t) = scene
                .locate(frame)
                .with_context(|| format!("there is no frame {frame}; {} exist", scene.frames()))?;
            let epoch = &scene.epochs()[epoch];
            if kind == "ply" {
                export::ply::write(out, epoch, t).with_context(failed)?;
            } else {
                let options = export::spz::Options::default();
                export::spz::write(out, epoch, t, &options).with_context(failed)?;
            }
            Ok(format!("wrote {}\n", out.display()))
        }
        _ => {
            std::fs::create_dir_all(out).with_context(failed)?;
            let files = export::ply::write_sequence(out, "frame", scene).with_context(failed)?;
            Ok(format!("wrote {} PLY files to {}\n", files.len(), out.display()))
        }
    }
}
