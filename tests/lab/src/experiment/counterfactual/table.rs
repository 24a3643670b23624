//! Measures the utility table of a scheduler: every group of 32 clusters of 4 levels, in 32 contexts, at 4
//! frames. That is 16,512 different pictures per table when each is rendered.

use anyhow::Result;
use render_host::{
    Settings,
    counterfactual::{Engine, States, brute},
};

use crate::{
    experiment::{
        clock::seconds_of,
        cloud::{CloudShape, Lattice},
        partial::{Partial, STATES_ALONE, deliveries_of, spread},
    },
    figures::{Bench, Figure, median},
};

const LATTICE: Lattice = Lattice { clusters: 32, levels: 4 };
const CONTEXTS: usize = 32;
const FRAMES: usize = 4;

/// Fills the table of scene A, turning, and compares it with toggled groups rendered alone.
pub(super) fn run(bench: &mut Bench, n: usize, side: u32, runs: usize) -> Result<()> {
    let settings = Settings::default();
    let frames = (0..FRAMES)
        .map(|frame| Partial::turned(CloudShape::Volume, n, side, 0.05 * frame as f32, &settings))
        .collect::<Result<Vec<_>>>()?;
    let contexts = deliveries_of(LATTICE, CONTEXTS);
    let few = spread(&contexts, STATES_ALONE);
    let (mut table, mut alone) = (Vec::new(), Vec::new());
    for run in 0..runs {
        seconds_of(&mut table, || {
            for frame in &frames {
                let engine = Engine::new(&frame.variants()?, &frame.camera, &frame.against, &settings)?;
                std::hint::black_box(engine.utilities(&contexts)?);
            }
            Ok::<_, anyhow::Error>(())
        })?;
        let frame = &frames[run % FRAMES];
        seconds_of(&mut alone, || {
            brute::sse(&frame.variants()?, &few, &frame.camera, &frame.against, &settings)
                .map_err(anyhow::Error::from)
        })?;
    }
    let states = (FRAMES * CONTEXTS * (LATTICE.groups() + 1)) as f64;
    let brute = few.len() as f64 / median(&alone);
    let error = error(&frames[FRAMES - 1], &contexts)?;
    let figure = |key: String, value: f64, unit: &str| {
        Figure::new(key, value, unit)
            .error(error, "of the largest utility, worst of 8 rendered alone")
            .runs(runs)
    };
    let rate = figure(format!("table{side}"), states / median(&table), "states/s");
    bench.push(rate.peer("brute force", brute, false));
    bench.push(figure(format!("table{side}.time"), median(&table), "s for the table"));
    Ok(())
}

/// Worst of eight utilities of the last context, each from two pictures rendered alone without early stop.
fn error(frame: &Partial, contexts: &States) -> Result<f64> {
    let no_stop = Settings { early_stop: false, ..Settings::default() };
    let (variants, last) = (frame.variants()?, contexts.one(contexts.len() - 1));
    let mut tries = last.one(0);
    let group = |k: usize| 17 * k + 3;
    (0..8).for_each(|k| tries.push(|g| last.has(0, g) != (g == group(k))));
    let alone = brute::sse(&variants, &tries, &frame.camera, &frame.against, &no_stop)?;
    let engine = Engine::new(&variants, &frame.camera, &frame.against, &Settings::default())?;
    let found = engine.utilities(&last)?;
    let largest = found.delta.iter().fold(0.0f64, |most, d| most.max(d.abs()));
    let off = |k: usize| {
        let rise = alone[k + 1] - alone[0];
        let delta = if last.has(0, group(k)) { rise } else { -rise };
        (delta - found.of(0, group(k))).abs() / largest
    };
    Ok((0..8).map(off).fold(0.0, f64::max))
}
