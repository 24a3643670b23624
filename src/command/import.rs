//! Imports a scene and says what it is: `dgs import`. What writes it is `dgs convert`.

use anyhow::Result;
use serde_json::json;
use trainer_host::viewpoint::Framing;

use crate::{args::Import, figures::counted, output::VerbOutput, pipeline};

/// Runs the verb.
pub fn run(args: &Import) -> Result<VerbOutput> {
    let loaded = pipeline::import(&args.input, &args.scene)?;
    let scene = &loaded.scene;
    let mut text = format!(
        "{}: {}, {} at {} fps, {} (at most, per epoch)\n",
        loaded.name,
        counted(scene.epochs().len(), "epoch"),
        counted(scene.frames(), "frame"),
        scene.frames_per_second(),
        counted(scene.max_count(), "Gaussian")
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
                "  epoch {i}: {}, {}, harmonic degree {}, moving: {still}\n",
                counted(epoch.count(), "Gaussian"),
                counted(epoch.frames(), "frame"),
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
    let (Framing { target, radius, .. }, footprint) = (&framing, scene.footprint.name());
    text += &format!("  centre {target:.3?}, radius {radius:.3}, up {}, footprint {footprint}\n", scene.up);
    for note in &scene.notes {
        text += &format!("  note: {note}\n");
    }
    let json = json!({
        "name": loaded.name, "frames": scene.frames(), "fps": scene.frames_per_second(),
        "epochs": epochs, "centre": framing.target, "radius": framing.radius, "notes": scene.notes,
        "cameras": scene.cameras.len(), "up": scene.up.to_string(),
        "footprint": footprint, "warnings": loaded.damage.as_slice(),
    });
    let damaged = loaded.damage.is_some();
    Ok(VerbOutput { text, json, warnings: loaded.damage.into_iter().collect(), damaged })
}
