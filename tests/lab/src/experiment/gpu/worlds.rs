//! Measures world batches: world-frames per second for W = 1, 2, 4 … 128.

use std::time::Instant;

use anyhow::Result;
use codec_core::Gaussian;
use render_host::{
    Camera, Settings, Splats,
    gpu::{Presence, Renderer, Scene},
};

use super::{
    super::{
        cloud::{Cloud, CloudShape, camera, cloud},
        partial::deliveries,
    },
    context::Context,
};
use crate::figures::{Bench, Figure, mean, student95};

const REPETITIONS: usize = 3;
/// Frames drawn before each repetition that are not counted.
const WARM_UPS: usize = 5;
/// Worlds that are drawn alone, one after the other.
const SERIAL: usize = 8;

struct Row {
    worlds: usize,
    presence: Presence,
    rates: Vec<f64>,
    bytes: u64,
}

/// Measures.
pub(super) fn run(context: &Context, bench: &mut Bench) -> Result<()> {
    let (n, side, most) = match (context.quick, context.is_cpu) {
        (true, _) => (1500, 48, 8),
        (false, true) => (10_000, 96, 128),
        (false, false) => (84_000, 400, 128),
    };
    let frames = if context.is_cpu { 1 } else { 32 };
    let (device, settings) = (context.executor.device(), Settings::default());
    let Cloud { gaussians, groups: of } = cloud(CloudShape::Volume, n);
    let splats = Splats::plain(&gaussians);
    let camera = camera(side)?;
    let all = Scene::with_groups(device, &splats, &of)?;
    let states = deliveries(most);
    let mut renderer = Renderer::new(&context.executor)?;
    let world = |w: usize| -> Vec<Gaussian> {
        let present = gaussians.iter().zip(&of).filter(|(_, group)| states.has(w, **group as usize));
        present.map(|(g, _)| *g).collect()
    };
    let alone: Vec<Scene> = (0..SERIAL.min(most))
        .map(|w| Scene::new(device, &Splats::plain(&world(w))))
        .collect::<Result<_, _>>()?;

    let mut rows = Vec::new();
    for worlds in (0..).map(|p| 1 << p).take_while(|&w| w <= most) {
        rows.push(Row {
            worlds,
            presence: Presence::new(device, &states.range(0..worlds))?,
            rates: Vec::new(),
            bytes: 0,
        });
    }
    let differing = differing_bits(&mut renderer, &all, &rows, &alone, &camera, &settings)?;
    let mut serial = Vec::new();
    for _ in 0..REPETITIONS {
        let mut one = |scene: &Scene| Ok(renderer.draw(scene, &camera, &settings)?);
        let mut turn = alone.iter().cycle();
        let mut next = |frames: usize| turn.by_ref().take(frames).try_for_each(&mut one);
        serial.push(rate(context, WARM_UPS, frames * SERIAL, 1, &mut next)?);
        for row in &mut rows {
            let mut next = |frames: usize| -> Result<()> {
                (0..frames)
                    .try_for_each(|_| Ok(renderer.draw_worlds(&all, &row.presence, &camera, &settings)?))
            };
            row.rates.push(rate(context, WARM_UPS, frames, row.worlds, &mut next)?);
            row.bytes = renderer.bytes() + all.bytes();
        }
    }
    let name = format!("worlds.{n}.{side}");
    let base = mean(&serial);
    bench.push(interval(Figure::new(format!("{name}.serial"), base, "world-frames/s"), &serial));
    for row in &rows {
        let key = format!("{name}.W{:03}", row.worlds);
        let figure = Figure::new(&key, mean(&row.rates), "world-frames/s").error(differing, "bits");
        bench.push(interval(figure.peer("serial", base, false), &row.rates));
        bench.push(Figure::new(format!("{key}.memory"), row.bytes as f64 / 1e6, "MB"));
    }
    Ok(())
}

/// World-frames per second of `frames` calls of `draw`, each of `worlds` worlds.
fn rate(
    context: &Context,
    warm_ups: usize,
    frames: usize,
    worlds: usize,
    draw: &mut dyn FnMut(usize) -> Result<()>,
) -> Result<f64> {
    draw(warm_ups)?;
    context.executor.device().wait()?;
    let start = Instant::now();
    draw(frames)?;
    context.executor.device().wait()?;
    Ok((frames * worlds) as f64 / start.elapsed().as_secs_f64())
}

fn interval(mut figure: Figure, values: &[f64]) -> Figure {
    figure.ci95 = student95(values);
    figure.runs(values.len())
}

/// Bits by which the first worlds of the largest batch differ from the worlds drawn alone.
fn differing_bits(
    renderer: &mut Renderer,
    all: &Scene,
    rows: &[Row],
    alone: &[Scene],
    camera: &Camera,
    settings: &Settings,
) -> Result<f64> {
    let Some(row) = rows.last() else { return Ok(0.0) };
    let batch = renderer.render_worlds(all, &row.presence, camera, settings)?;
    let mut bits = 0u64;
    for (scene, got) in alone.iter().zip(&batch) {
        let one = renderer.render(scene, camera, settings)?;
        let pairs = one.image.rgb().iter().chain(&one.transmittance);
        let pairs = pairs.zip(got.image.rgb().iter().chain(&got.transmittance));
        bits += pairs.map(|(a, b)| u64::from((a.to_bits() ^ b.to_bits()).count_ones())).sum::<u64>();
    }
    Ok(bits as f64)
}
