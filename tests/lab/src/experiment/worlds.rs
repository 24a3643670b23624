//! Times world batches: pictures of W states of one scene, frame and camera in one call, in the shape of the
//! paper's world-batch table.

use std::{hint::black_box, time::Instant};

use anyhow::Result;
use render_host::{
    Renderer, Settings, Splats,
    counterfactual::{Engine, WorldBatch, brute, render_worlds},
    reference,
};

use super::{
    cloud::{CloudShape, LATTICE},
    counterfactual::distance,
    partial::{Partial, deliveries},
};
use crate::{
    figures::{Bench, Figure, mean, median, student95},
    setup::Setup,
};

/// Independent repetitions; a throughput is the mean of theirs.
const REPETITIONS: usize = 3;
/// Calls before a repetition that are not timed.
const WARM_UPS: usize = 5;

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let (n, side, most, calls) = if setup.quick { (6000, 160, 16, 1) } else { (84_000, 400, 128, 3) };
    let mut bench = Bench::new(
        "worlds",
        format!(
            "pictures of W states of one scene and camera, {n} Gaussians in {} groups, scene A (uniform \
                volume in cells), {side}x{side}, default \
             settings; one call per batch, set-up included; median of {calls} calls (more of fewer than 16 \
             worlds) after {WARM_UPS} warm-ups, mean of {REPETITIONS} repetitions, 95 % CI \
             by Student t; serial, between the calls of each batch, renders a state alone with all threads, \
             decoded states given; training is forward+backward of the weighted MSE of W \
             worlds in fast mode (no early stop)",
            LATTICE.groups()
        ),
    );
    let settings = Settings::default();
    let scene = Partial::new(CloudShape::Volume, n, side, &settings)?;
    let (variants, camera) = (scene.variants()?, &scene.camera);
    let states = deliveries(most);

    let alone: Vec<_> = (0..most.min(8)).map(|w| brute::world(&variants, &states, w)).collect();
    let mut renderer = Renderer::new();
    let picture = renderer.render(&scene.splats(), camera, &settings)?.image;
    let exact = reference::render(&scene.splats(), camera, &settings)?.difference(picture.rgb());
    let clear = exact.map_or(f64::NAN, |d| d.max_clear);
    // Gradients of one, two and four worlds, against the adjoint of each alone; more worlds are as the last.
    let no_stop = Settings { early_stop: false, ..settings.clone() };
    let engine = Engine::new(&variants, camera, &scene.against, &settings)?;
    let off = |worlds: usize| -> Result<f64> {
        let (some, weights) = (states.range(0..worlds), vec![1.0 / worlds as f64; worlds]);
        let alone = brute::gradients(&variants, &some, &weights, camera, &scene.against, &no_stop)?;
        Ok(distance(&engine.gradients(&variants, &some, &weights)?, &alone))
    };
    let mut training_error = 0.0;

    let batch = WorldBatch::new(&variants, camera, &settings)?;
    let mut turn = 0;
    let mut one = || -> Result<()> {
        let (gaussians, _) = &alone[turn % alone.len()];
        turn += 1;
        black_box(renderer.render(&Splats::plain(gaussians), camera, &settings)?);
        Ok(())
    };
    // Pictures per second, one at a time, between the calls of each batch.
    let mut serial = Vec::new();
    let mut worlds = 1;
    while worlds <= most {
        let some = states.range(0..worlds);
        let weights = vec![1.0 / worlds as f64; worlds];
        let calls = calls * (16 / worlds).max(1);
        let mut all = || {
            black_box(render_worlds(&variants, &some, camera, &settings)?);
            Ok(())
        };
        let [draw, beside] = repeat(calls, [&mut all, &mut one])?;
        let mut step = || {
            let engine = Engine::new(&variants, camera, &scene.against, &settings)?;
            black_box(engine.gradients(&variants, &some, &weights)?);
            Ok(())
        };
        let [train] = repeat(calls, [&mut step])?;
        let images = render_worlds(&variants, &some, camera, &settings)?;
        let mut differ = 0;
        for world in (0..worlds).step_by(worlds.div_ceil(4)) {
            let alone = brute::image(&variants, &states, world, camera, &settings)?;
            let same = images[world].rgb().iter().zip(alone.rgb()).all(|(a, b)| a.to_bits() == b.to_bits());
            differ += usize::from(!same);
        }
        let rates = |times: &[f64]| times.iter().map(|t| worlds as f64 / t).collect::<Vec<f64>>();
        let figure = throughput(format!("W{worlds}.frames"), &rates(&draw)).runs(REPETITIONS);
        let figure = figure.error(differ as f64, "pictures differ from single renders in a bit");
        let alone: Vec<f64> = beside.iter().map(|t| 1.0 / t).collect();
        bench.push(figure.peer("serial", mean(&alone), false));
        let speedups: Vec<f64> =
            draw.iter().zip(&beside).map(|(batch, one)| worlds as f64 * one / batch).collect();
        let mut figure = Figure::new(format!("W{worlds}.speedup"), mean(&speedups), "times serial");
        figure.ci95 = student95(&speedups);
        bench.push(figure.runs(REPETITIONS).error(differ as f64, "pictures differ"));
        serial.extend(alone);
        if worlds <= 4 {
            training_error = off(worlds)?;
        }
        let figure = throughput(format!("W{worlds}.training"), &rates(&train)).runs(REPETITIONS);
        let of = "relative length of the worst class, the first worlds (four at most) against each alone";
        bench.push(figure.error(training_error, of));
        let tuned = batch.largest(&some, u64::MAX);
        let used = tuned.probes.last().and_then(|probe| probe.used.ok()).unwrap_or_default();
        let mib = |bytes: u64| bytes as f64 / f64::from(1 << 20);
        let memory = Figure::new(format!("W{worlds}.memory"), mib(used), "MiB");
        bench.push(
            memory.error(mib(batch.predict_bytes(worlds)) - mib(used), "MiB predicted above what was used"),
        );
        worlds *= 2;
    }
    let figure = throughput("serial".into(), &serial).runs(serial.len());
    bench.push(figure.error(clear, "max abs against f64, away from thresholds"));
    let budget = batch.predict_bytes(most / 2);
    let tuned = batch.largest(&states, budget);
    bench.push(Figure::new(
        "tuner.worlds",
        tuned.worlds as f64,
        "worlds within the memory predicted for half",
    ));
    bench.push(Figure::new("tuner.probes", tuned.probes.len() as f64, "probes"));
    Ok(bench)
}

/// Something to time.
type Work<'a> = &'a mut dyn FnMut() -> Result<()>;

/// Median seconds of `calls` calls of each work in turn after the warm-ups, for every repetition.
fn repeat<const N: usize>(calls: usize, mut works: [Work<'_>; N]) -> Result<[Vec<f64>; N]> {
    let mut out = [const { Vec::new() }; N];
    for _ in 0..REPETITIONS {
        let mut times = [const { Vec::new() }; N];
        for _ in 0..WARM_UPS + calls {
            for (work, times) in works.iter_mut().zip(&mut times) {
                let start = Instant::now();
                work()?;
                times.push(start.elapsed().as_secs_f64());
            }
        }
        for (out, times) in out.iter_mut().zip(&times) {
            out.push(median(&times[WARM_UPS..]));
        }
    }
    Ok(out)
}

fn throughput(key: String, rates: &[f64]) -> Figure {
    let mut figure = Figure::new(key, mean(rates), "world-frames/s");
    figure.ci95 = student95(rates);
    figure
}
