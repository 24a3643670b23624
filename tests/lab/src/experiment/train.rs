//! Times one iteration of training by stage, with the error beside each part.

mod measure;
mod step;
mod switches;
mod tiles;

use std::time::Instant;

use anyhow::{Context, Result};
use render_host::{
    Backend, BackendError, Camera, DeviceChoice, Differentiator, Gradients, Image, Loss, Renderer, Settings,
    Splats, Workspace,
    adjoint::{
        loss::{
            Distortion, Mse,
            photograph::{Photograph, PhotographLoss, Weights},
        },
        render_and_gradients_into,
    },
    gpu::GpuError,
    metric,
};

use self::measure::{WEIGHTS, WHITE, apart, ms};
use super::{demo::push_peak_memory, gradient::along_colours};
use crate::{
    figures::{Bench, Figure, median},
    setup::{Setup, synth},
};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (gaussians, sides, runs): (_, &[u32], _) =
        if setup.quick { (2000, &[160], 3) } else { (26_000, &[400, 800], 15) };
    let mut bench = Bench::new(
        "train",
        format!(
            "synth figure, {gaussians} Gaussians, frame 0 towards a photograph of frame 3, on white; ms of \
             processor time on one thread, medians of {runs} interleaved runs; loss 0.8 L1 + 0.2 (1 - SSIM); \
             peer: MSE + 0.20 (1 - SSIM) with a target \
             prepared beforehand; `device`: wall time of picture, loss, gradients and statistics, the \
             processor on all threads, a graphics device with the loss on the processor; {}; {}; {}",
            step::PROTOCOL,
            switches::PROTOCOL,
            tiles::PROTOCOL
        ),
    );
    let scene = synth("figure", gaussians, 4)?;
    let [now, later] = [0, 3].map(|frame| scene.instant(frame));
    let (now, later) = (now.context("no frame 0")?, later.context("no frame 3")?);
    let splats = Splats::new(&now.gaussians, &now.sh_rest, now.sh_degree)?;
    let seen = Splats::new(&later.gaussians, &later.sh_rest, later.sh_degree)?;
    let backends = backends()?;
    for &side in sides {
        let camera = Camera::look_at([2.6, 0.6, 3.4], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.69, side, side)?;
        let photograph = photograph(&seen, &camera)?;
        iteration(&mut bench, &splats, &photograph, &camera, runs)?;
        devices(&mut bench, &splats, &photograph, &camera, runs, &backends)?;
        step::stages(&mut bench, &scene, side, gaussians, runs)?;
    }
    push_peak_memory(&mut bench);
    let side = sides[0];
    let camera = Camera::look_at([2.6, 0.6, 3.4], [0.0, 0.0, 0.0], [0.0, 1.0, 0.0], 0.69, side, side)?;
    switches::tolerances(&mut bench, &splats, &photograph(&seen, &camera)?, &camera)?;
    tiles::variance(&mut bench, &scene, side, if setup.quick { 200 } else { 3000 })?;
    Ok(bench)
}

/// The processor, and a graphics device where there is one.
fn backends() -> Result<Vec<Backend>> {
    match Backend::open(DeviceChoice::Gpu) {
        Ok(gpu) => Ok(vec![Backend::Cpu, gpu]),
        Err(BackendError::Gpu(GpuError::NoAdapter { .. })) => Ok(vec![Backend::Cpu]),
        Err(error) => Err(error.into()),
    }
}

/// A row per device: the picture of a step with all that is asked of it.
fn devices(
    bench: &mut Bench,
    splats: &Splats,
    photograph: &Photograph,
    camera: &Camera,
    runs: usize,
    backends: &[Backend],
) -> Result<()> {
    let settings = Settings::over(WHITE);
    let mut of_cpu: Option<(f64, Gradients)> = None;
    for backend in backends {
        let mut differentiator = backend.differentiator()?;
        let (mut found, mut statistics, mut times) = (Gradients::default(), Vec::new(), Vec::new());
        // The first one compiles kernels and makes room.
        for run in 0..=runs {
            let start = Instant::now();
            let loss = PhotographLoss::new(photograph, WHITE, WEIGHTS);
            let counted = Some(&mut statistics);
            differentiator.differentiate(splats, camera, &settings, &loss, &mut found, counted)?;
            if run > 0 {
                times.push(1000.0 * start.elapsed().as_secs_f64());
            }
        }
        let squared = Mse::new(photograph.over(WHITE));
        differentiator.differentiate(splats, camera, &settings, &squared, &mut found, None)?;
        let key = format!("{}.device.{}", camera.width(), if of_cpu.is_none() { "cpu" } else { "gpu" });
        let figure = Figure::new(key, median(&times), "ms").runs(runs);
        bench.push(match &of_cpu {
            None => figure,
            Some((cpu_ms, expected)) => figure
                .error(apart(&found, expected), "relative L2 distance of position gradients from the cpu's")
                .peer("cpu", *cpu_ms, true),
        });
        of_cpu.get_or_insert((median(&times), found));
    }
    Ok(())
}

/// What a camera sees of `splats`, with transparency.
fn photograph(splats: &Splats, camera: &Camera) -> Result<Photograph> {
    let picture = render_host::render(splats, camera, &Settings::default())?;
    let colours = picture.image.to_rgb8();
    let pixels = colours.chunks_exact(3).zip(&picture.transmittance).flat_map(|(colour, &shows)| {
        let alpha = ((1.0 - shows) * 255.0).round() as u8;
        [colour[0].min(alpha), colour[1].min(alpha), colour[2].min(alpha), alpha]
    });
    Ok(Photograph::new(camera.width(), camera.height(), pixels.collect())?)
}

/// Figure 6: the stages of one iteration.
fn iteration(
    bench: &mut Bench,
    splats: &Splats,
    photograph: &Photograph,
    camera: &Camera,
    runs: usize,
) -> Result<()> {
    let side = camera.width();
    let settings = Settings { parallel: false, ..Settings::over(WHITE) };
    let target = photograph.over(WHITE);
    let prepared = Distortion::new(target.clone());
    let loss = || PhotographLoss::new(photograph, WHITE, WEIGHTS);
    let (mut renderer, mut picture) = (Renderer::new(), Default::default());
    let (mut workspace, mut out, mut statistics) = (Workspace::new(), Gradients::default(), Vec::new());
    let mut differentiator = Differentiator::default();
    renderer.render_into(splats, camera, &settings, &mut picture)?;
    let mut gradient = vec![0.0; picture.image.rgb().len()];
    let [mut forward, mut compare, mut peer, mut prepare, mut whole, mut with_peer, mut counted] =
        [const { Vec::new() }; 7];
    for _ in 0..runs {
        ms(&mut forward, || Ok(renderer.render_into(splats, camera, &settings, &mut picture)?))?;
        ms(&mut compare, || {
            loss().differentiate(&picture.image, false, &mut gradient)?;
            Ok(())
        })?;
        ms(&mut peer, || {
            prepared.differentiate(&picture.image, false, &mut gradient)?;
            Ok(())
        })?;
        ms(&mut prepare, || {
            Distortion::new(target.clone());
            Ok(())
        })?;
        ms(&mut whole, || {
            Ok(render_and_gradients_into(&mut workspace, splats, camera, &settings, &loss(), &mut out)?)
        })?;
        ms(&mut with_peer, || {
            Ok(render_and_gradients_into(&mut workspace, splats, camera, &settings, &prepared, &mut out)?)
        })?;
        ms(&mut counted, || {
            let counted = Some(&mut statistics);
            Ok(differentiator.differentiate(splats, camera, &settings, &loss(), &mut out, counted)?)
        })?;
    }
    let share = picture.counters.tiles_touched as f64 / picture.counters.tiles as f64;
    bench.push(Figure::new(format!("{side}.tiles_touched"), share, "share"));
    bench.push(Figure::new(format!("{side}.forward"), median(&forward), "ms").runs(runs));
    bench.push(
        Figure::new(format!("{side}.loss"), median(&compare), "ms")
            .error(wrong(photograph, &target, &picture.image)?, "relative, 1 - SSIM against the f64 metric")
            .peer("prepared target", median(&peer), true)
            .runs(runs),
    );
    bench.push(Figure::new(format!("{side}.peer.prepare"), median(&prepare), "ms").runs(runs));
    bench.push(
        Figure::new(format!("{side}.forward_backward"), median(&whole), "ms")
            .error(along_colours(splats, camera, &settings, &loss())?, "relative, derivative along colours")
            .peer("prepared target", median(&with_peer), true)
            .runs(runs),
    );
    bench.push(
        Figure::new(format!("{side}.forward_backward.statistics"), median(&counted), "ms")
            .peer("without", median(&whole), true)
            .runs(runs),
    );
    Ok(())
}

/// Relative error of `1 - SSIM`.
fn wrong(photograph: &Photograph, target: &Image, picture: &Image) -> Result<f64> {
    let structure = Weights { absolute: 0.0, squared: 0.0, structure: 1.0 };
    let mut gradient = vec![0.0; picture.rgb().len()];
    let found =
        PhotographLoss::new(photograph, WHITE, structure).differentiate(picture, false, &mut gradient)?;
    Ok((found / (1.0 - metric::ssim(picture, target)?) - 1.0).abs())
}
