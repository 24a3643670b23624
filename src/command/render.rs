//! `dgs render`: a scene or a stream to PNG.

use anyhow::{Context, Result, bail};
use codec_core::ids::Level;
use render_host::{Changes, Sequence, Settings, Splats};
use serde_json::json;
use trainer_host::viewpoint::Ring;

use crate::{args::Render, output::VerbOutput, pipeline};

/// Cameras on the ring around a scene without its own.
const RING: usize = 8;

/// Runs the verb.
pub fn run(args: &Render) -> Result<VerbOutput> {
    let mut warnings = Vec::new();
    let scene = if pipeline::is_stream(&args.input) {
        let stream = pipeline::read_stream(args.input.as_ref(), &mut |w| warnings.push(w))?;
        let received = stream.receive()?;
        pipeline::decoded_scene(&received.content(), Level::from_bits(args.level))?
    } else {
        pipeline::import(&args.input, &args.scene)?.scene
    };
    let (ring, settings) = pipeline::view(&scene, &args.view, Ring::HeldOut, RING)?;
    let settings = Settings { antialiased: args.antialiased, ..settings };
    let cameras = if scene.cameras.is_empty() { ring } else { scene.cameras.clone() };
    let Some(camera) = cameras.get(args.camera) else {
        bail!("--camera is {}; 0 to {} are allowed", args.camera, cameras.len() - 1);
    };
    let camera = camera.resized(args.view.width, args.view.height)?;
    let single = args.out.extension().is_some_and(|e| e == "png");
    let frames = if single { args.frame..args.frame + 1 } else { 0..scene.frames() as u32 };
    if !single {
        std::fs::create_dir_all(&args.out)
            .with_context(|| format!("{}: cannot create", args.out.display()))?;
    }
    let mut sequence = Sequence::default();
    let mut counters = None;
    let count = frames.len();
    for frame in frames {
        let instant = scene
            .instant(frame as usize)
            .with_context(|| format!("--frame is {frame}; 0 to {} are allowed", scene.frames() - 1))?;
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        let rendered = sequence.render(&splats, Changes::Unknown, &camera, &settings)?;
        let path = if single { args.out.clone() } else { args.out.join(format!("{frame:05}.png")) };
        rendered.image.write_png(&path).with_context(|| format!("{}: cannot write", path.display()))?;
        counters = Some(rendered.counters);
    }
    let text = format!("wrote {count} images to {}\n", args.out.display());
    let json = json!({ "out": args.out, "images": count, "last_counters": counters, "warnings": warnings });
    let damaged = !warnings.is_empty();
    Ok(VerbOutput { text, json, warnings, damaged })
}
