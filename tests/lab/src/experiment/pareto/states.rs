//! Measures time per state against error of the sum of squares: strict and fast counterfactuals, and brute
//! force.

use std::{fmt::Write as _, time::Instant};

use anyhow::Result;
use dgs::output::print;
use render_host::{
    Image, Settings, Splats,
    counterfactual::{Engine, States, Variants, brute},
    reference,
};

use super::view::{View, exact};
use crate::{
    draw::scatter::{Point, Scatter, front},
    figures::{Bench, Figure, median, number},
    setup::Setup,
};

/// Groups, dealt by place in space, and states, each group present in two of three.
const GROUPS: usize = 32;
const STATES: usize = 32;
/// States that brute force renders and that the reference renders too.
const JUDGED: usize = 2;

/// Measures `view` and adds to `bench` and `csv`.
pub fn run(
    setup: &Setup,
    view: &View,
    side: u32,
    runs: usize,
    bench: &mut Bench,
    csv: &mut String,
) -> Result<()> {
    let splats = view.splats()?;
    let cell = |p: f32, most: f32| ((p * 2.0).rem_euclid(most)) as u32;
    let group = |p: [f32; 3]| cell(p[0], 4.0) + 4 * cell(p[1], 4.0) + 16 * cell(p[2], 2.0);
    let groups: Vec<u32> = view.gaussians.iter().map(|g| group(g.position) % GROUPS as u32).collect();
    let variants = Variants::new(splats, &groups, GROUPS)?;
    let camera = &view.camera;
    let full = brute::image(&variants, &States::full(GROUPS), 0, camera, &Settings::default())?;
    let paler = full.rgb().iter().map(|v| 0.97 * v + 0.01).collect();
    let target = Image::new(side, side, paler)?;
    let mut states = States::new(GROUPS);
    let mut few = States::new(GROUPS);
    for world in 0..STATES {
        let present = |group: usize| !(world * 7 + group * 5 + world * group).is_multiple_of(3);
        states.push(present);
        if world < JUDGED {
            few.push(present);
        }
    }
    let mut truth = Vec::new();
    for world in 0..JUDGED {
        let (gaussians, rest) = brute::world(&variants, &few, world);
        let picture = reference::render(&Splats::new(&gaussians, &rest, view.degree)?, camera, &exact())?;
        truth.push(
            picture.rgb.iter().zip(target.rgb()).map(|(a, &b)| (a - f64::from(b)).powi(2)).sum::<f64>(),
        );
    }

    let d = Settings::default();
    let cut = Settings { alpha_cutoff: 1.0 / 1024.0, ..d.clone() };
    let unstopped = Settings { early_stop: false, ..d.clone() };
    let strict: fn(&Engine, &States) -> _ = |e, s| e.strict(s);
    let fast: fn(&Engine, &States) -> _ = |e, s| e.fast(s);
    let by_engine = [
        ("strict", strict, &d),
        ("strict, no stop", strict, &unstopped),
        ("fast", fast, &d),
        ("fast, cut 1/1024", fast, &cut),
    ];
    let mut times = vec![Vec::new(); by_engine.len() + 1];
    let mut found = vec![Vec::new(); times.len()];
    for run in 0..=runs {
        for at in 0..times.len() {
            let start = Instant::now();
            let (values, count) = match by_engine.get(at) {
                Some((_, mode, settings)) => {
                    (mode(&Engine::new(&variants, camera, &target, settings)?, &states)?, STATES)
                }
                None => (brute::sse(&variants, &few, camera, &target, &d)?, JUDGED),
            };
            if run > 0 {
                times[at].push(1000.0 * start.elapsed().as_secs_f64() / count as f64);
            }
            found[at] = values;
        }
    }
    let names: Vec<&str> = by_engine.iter().map(|b| b.0).chain(["brute force"]).collect();
    let error = |values: &[f64]| {
        values
            .iter()
            .zip(&truth)
            .map(|(v, t)| (v / t - 1.0).abs())
            .fold(0.0, |a: f64, b| if b.total_cmp(&a).is_gt() { b } else { a })
    };
    let points: Vec<(f64, f64)> = times.iter().zip(&found).map(|(t, f)| (median(t), error(f))).collect();
    let on = front(&points);
    let mut text = format!("{}.{side}, states (with set-up)\n", view.name);
    for ((name, (ms, error)), on) in names.iter().zip(&points).zip(&on) {
        let mark = if *on { "front" } else { "" };
        let _ = writeln!(
            text,
            "  {name:24}{:>10} ms per state, relative error of SSE {error:.2e}  {mark}",
            number(*ms)
        );
        let _ = writeln!(csv, "{},{side},{},{ms:.4},{error:.4e},{on}", view.name, name.replace(',', ";"));
        let key = format!("{}.{side}.states.{}", view.name, name.replace([' ', ',', '/'], "-"));
        let figure = Figure::new(format!("{key}.ms"), *ms, "ms per state")
            .error(*error, "relative SSE against exact f64");
        bench.push(figure.peer("brute force", points[points.len() - 1].0, true).runs(runs));
    }
    if !setup.quiet.0 {
        print(&format!("{text}\n"))?;
    }
    let point = |(i, (&name, &(x, y)))| Point { name: String::from(name), group: i, x, y };
    let plot = Scatter {
        title: &format!("{} at {side} × {side}: time per state against error", view.name),
        subtitle: "Squared errors of 32 states of 32 groups against a picture; error against the f64 \
            reference without cut and stop.",
        x_label: "time per state, ms",
        y_label: "relative error of the sum of squares",
        groups: &names,
        points: names.iter().zip(&points).enumerate().map(point).collect(),
    };
    setup.write(&format!("pareto-{}-{side}-states.svg", view.name), &plot.svg())
}
