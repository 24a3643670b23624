//! Measures CPU render time per frame beside its error against the f64 reference.

use std::time::Instant;

use anyhow::Result;
use render_host::{Camera, Renderer, Settings, Splats, reference};
use trainer_host::{
    Scene,
    viewpoint::{Framing, Ring},
};

use super::cloud::{CloudShape, camera, cloud};
use crate::{
    figures::{Bench, Figure, median},
    setup::{Setup, load, synth},
};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (sizes, runs): (&[u32], usize) = if setup.quick { (&[200], 3) } else { (&[400, 800], 9) };
    let mut bench = Bench::new(
        "render",
        format!(
            "one frame of each size (the last part of a key, pixels square), held-out ring camera (random \
                scenes: 3.2 away, focal length 0.9 \
             of the width), black background, default settings; medians of {runs} interleaved runs; error \
             against the f64 reference at the \
             same settings (max: pixels away from any threshold; all: every pixel)"
        ),
    );
    let n = if setup.quick { (3000, 8000) } else { (20_000, 150_000) };
    let fox = setup.data("scenes/gltf-fox/Fox.glb", &mut bench)?;
    let biker = if setup.quick { None } else { setup.data("scenes/splat-biker/biker.spz", &mut bench)? };
    let mut scenes: Vec<(String, Scene)> = vec![
        (format!("synth-cloth-{}", n.0), synth("cloth", n.0, 2)?),
        (format!("synth-balls-{}", n.1), synth("balls", n.1, 2)?),
    ];
    if let Some(path) = fox {
        scenes.push((format!("fox-{}", n.0), load(&path, n.0)?));
    }
    if let Some(path) = biker {
        scenes.push(("biker-152746".into(), load(&path, 0)?));
    }
    for (name, scene) in &scenes {
        let instant = scene.instant(scene.frames() / 2).unwrap_or_default();
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        let sizes = if name.starts_with("biker") { sizes } else { &sizes[sizes.len() - 1..] };
        for &size in sizes {
            let camera = &Framing::of(scene).ring(Ring::HeldOut, 3, (size, size))?[0];
            frame(&mut bench, &format!("{name}.{size}"), &splats, camera, runs)?;
        }
    }
    bench.skipped.push(
        "a public peer: none is linked; OpenSplat, in C++ on libtorch, draws Gaussians on a CPU".into(),
    );
    let counts: &[usize] = if setup.quick { &[4000] } else { &[20_000, 100_000] };
    for &n in counts {
        let scene = cloud(CloudShape::Volume, n);
        for &size in sizes {
            let name = format!("random-{n}.{size}");
            frame(&mut bench, &name, &Splats::plain(&scene.gaussians), &camera(size)?, runs)?;
        }
    }
    Ok(bench)
}

fn frame(bench: &mut Bench, name: &str, splats: &Splats, camera: &Camera, runs: usize) -> Result<()> {
    let settings = Settings::default();
    let exact = reference::render(splats, camera, &settings)?;
    let mut renderer = Renderer::new();
    let image = renderer.render(splats, camera, &settings)?.image;
    let (mut fast, mut slow) = (Vec::new(), Vec::new());
    for run in 0..runs {
        let start = Instant::now();
        renderer.render(splats, camera, &settings)?;
        fast.push(1000.0 * start.elapsed().as_secs_f64());
        // The reference is slow and steady: three runs between the others are enough.
        if run % 3 == 0 {
            let start = Instant::now();
            reference::render(splats, camera, &settings)?;
            slow.push(1000.0 * start.elapsed().as_secs_f64());
        }
    }
    let errors = image.rgb().iter().zip(&exact.rgb).map(|(a, b)| (f64::from(*a) - b).abs());
    let (sum, max) = errors.fold((0.0, 0.0f64), |(s, m), e| (s + e, m.max(e)));
    let mean = sum / exact.rgb.len() as f64;
    let figure = Figure::new(format!("{name}.frame"), median(&fast), "ms").error(max, "max abs, all pixels");
    bench.push(figure.peer("f64 reference", median(&slow), true).runs(fast.len()));
    bench.push(Figure::new(format!("{name}.mean_abs_error"), mean, ""));
    if let Some(difference) = exact.difference(image.rgb()) {
        bench.push(Figure::new(format!("{name}.max_error_clear"), difference.max_clear, ""));
        let close = difference.close_pixels as f64;
        bench.push(Figure::new(format!("{name}.pixels_near_a_threshold"), close, ""));
        bench.push(Figure::new(format!("{name}.psnr_vs_f64"), difference.psnr_db, "dB"));
    }
    Ok(())
}
