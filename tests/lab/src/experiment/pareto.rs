//! Measures accuracy against time: every tolerance, precision and skip alone, a few together, and every
//! backend, each against the f64 reference at exact settings (nothing cut, nothing stopped).
//!
//! `--out DIR` writes `pareto.csv`, `pareto-states.csv` and a drawing per scene, size and error.

mod backend;
mod candidates;
mod states;
mod view;

use std::{fmt::Write as _, time::Instant};

use anyhow::Result;
use dgs::output::print;
use render_host::{
    Image, Settings, metric,
    reference::{self, Reference},
};

use self::{
    backend::Backend,
    candidates::{Candidate, KNOBS, candidates},
    view::{View, exact},
};
use crate::{
    draw::scatter::{Point, Scatter, front},
    figures::{Bench, Figure, median, number},
    setup::{Setup, load, synth},
};

/// Largest error of a channel that a default may add: half a step of an 8-bit display.
const BUDGET: f64 = 0.5 / 255.0;

/// Share of the time that a value must save to be recommended over the default: less is noise.
const PAYS: f64 = 0.05;

/// What a candidate costs and how far off it is.
struct Row {
    name: String,
    backend: &'static str,
    knob: usize,
    time_ms: f64,
    max: f64,
    mean: f64,
    psnr_db: f64,
    flip: f64,
    /// Largest error against each of [`reference_settings`].
    against: [f64; 3],
    /// On the front of time and largest error; of time and mean error.
    front: [bool; 2],
}

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let runs = if setup.quick { 3 } else { 9 };
    let sides: &[u32] = if setup.quick { &[128] } else { &[400, 800] };
    let (mut backends, device) = backend::all(setup.quick)?;
    let mut bench = Bench::new(
        "pareto",
        format!(
            "one held-out view per scene at {sides:?} squared, black background; ms per frame: medians of \
                {runs} interleaved runs after one that is dropped, \
             order rotated; a graphics device: scene uploaded before, picture read back within the time, 3 \
             runs on one that is a CPU; errors per channel, data range 1, against the f64 reference without \
             early stop and cut only at 1e-12; FLIP at 67 pixels per degree; own: against the reference that \
             lacks only what the knob takes away, pixels near a threshold left out; \
             states: 32 states of 32 groups, relative error of sums of squares against the same reference"
        ),
    );
    match device {
        Ok(name) => bench.machine.device = Some(name),
        Err(missing) => bench.skipped.push(missing),
    }
    let mut csv = String::from(
        "scene,side,backend,knob,candidate,ms,max_abs,mean_abs,psnr_db,flip,own_max,front_max,front_mean\n",
    );
    let mut states_csv = String::from("scene,side,candidate,ms_per_state,relative_sse_error,front\n");
    for &side in sides {
        for view in views(setup, side, &mut bench)? {
            let rows = measure(&view, runs, &mut backends)?;
            let key = format!("{}.{side}", view.name);
            let text = table(&key, &rows);
            if !setup.quiet.0 {
                print(&format!("{text}\n"))?;
            }
            for row in &rows {
                let Row { name, backend, knob, time_ms, max, mean, psnr_db, flip, against, front } = row;
                let own = against[reference_of(*knob)];
                let _ = writeln!(
                    csv,
                    "{},{side},{backend},{},{name},{time_ms:.4},{max:.4e},{mean:.4e},{psnr_db:.2},{flip:.4e},{own:.4e},{},{}",
                    view.name, KNOBS[*knob], front[0], front[1]
                );
            }
            draw(setup, &view.name, side, &rows)?;
            push(&mut bench, &key, &rows, runs);
            if side == sides[0] {
                states::run(setup, &view, side, runs, &mut bench, &mut states_csv)?;
            }
        }
    }
    setup.write("pareto.csv", &csv)?;
    setup.write("pareto-states.csv", &states_csv)?;
    Ok(bench)
}

fn views(setup: &Setup, side: u32, bench: &mut Bench) -> Result<Vec<View>> {
    let (n, m) = if setup.quick { (4000, 2000) } else { (100_000, 20_000) };
    let mut out =
        vec![View::random(n, side)?, View::of(format!("synth-cloth-{m}"), &synth("cloth", m, 2)?, side)?];
    if let Some(path) = setup.data("scenes/gltf-fox/Fox.glb", bench)? {
        out.push(View::of(format!("fox-{m}"), &load(&path, m)?, side)?);
    }
    if !setup.quick
        && let Some(path) = setup.data("scenes/splat-biker/biker.spz", bench)?
    {
        out.push(View::of("biker-152746".into(), &load(&path, 0)?, side)?);
    }
    bench.skipped.dedup();
    Ok(out)
}

/// Pictures of the f64 reference that tell the error of one knob from that of the others: exact; the defaults
/// without stop; the defaults.
fn reference_settings() -> [Settings; 3] {
    [exact(), Settings { early_stop: false, ..Settings::default() }, Settings::default()]
}

/// Which of [`reference_settings`] has everything that the knob takes away, and nothing else.
fn reference_of(knob: usize) -> usize {
    match KNOBS[knob] {
        "default" | "alpha cut-off" | "presets" => 0,
        "stop" => 1,
        _ => 2,
    }
}

fn measure(view: &View, runs: usize, backends: &mut [Box<dyn Backend>]) -> Result<Vec<Row>> {
    let splats = view.splats()?;
    let mut references = Vec::new();
    for settings in reference_settings() {
        references.push(reference::render(&splats, &view.camera, &settings)?);
    }
    let truth = &references[0];
    let (width, height) = (view.camera.width(), view.camera.height());
    let wanted = Image::new(width, height, truth.rgb.iter().map(|&v| v as f32).collect())?;
    for backend in backends.iter_mut() {
        backend.take(&splats)?;
    }
    let all = candidates(view.degree.get());
    let jobs: Vec<(usize, &Candidate)> = backends
        .iter()
        .enumerate()
        .flat_map(|(b, backend)| {
            let measured = move |c: &&Candidate| (b == 0 || c.everywhere) && backend.takes(&c.settings);
            all.iter().filter(measured).map(move |c| (b, c))
        })
        .collect();
    let mut times = vec![Vec::new(); jobs.len()];
    let mut rows = Vec::new();
    for run in 0..=runs {
        for k in 0..jobs.len() {
            // Another beginning each time, and every other time backwards.
            let at = if run % 2 == 0 { k } else { jobs.len() - 1 - k };
            let at = (at + 5 * run) % jobs.len();
            let (backend, candidate) = jobs[at];
            let backend = &mut backends[backend];
            if run > backend.most_runs() {
                continue;
            }
            let start = Instant::now();
            backend.render(&splats, &view.camera, &candidate.settings)?;
            if run > 0 {
                times[at].push(1000.0 * start.elapsed().as_secs_f64());
            }
        }
    }
    for ((b, candidate), times) in jobs.iter().zip(&times) {
        let backend = &mut backends[*b];
        backend.render(&splats, &view.camera, &candidate.settings)?;
        let image = backend.image();
        let worse = |a: f64, b: f64| if b.total_cmp(&a).is_gt() { b } else { a };
        let errors = || image.rgb().iter().zip(&truth.rgb).map(|(a, e)| (f64::from(*a) - e).abs());
        let max = errors().fold(0.0, worse);
        // With a cut, rounding may decide a pixel either way: those that it may are left out.
        let clear =
            |reference: &Reference| reference.difference(image.rgb()).map_or(f64::NAN, |d| d.max_clear);
        let against = [max, clear(&references[1]), clear(&references[2])];
        rows.push(Row {
            name: candidate.name.clone(),
            backend: backend.name(),
            knob: candidate.knob,
            time_ms: median(times),
            max,
            mean: errors().sum::<f64>() / truth.rgb.len() as f64,
            against,
            psnr_db: truth.difference(image.rgb()).map_or(f64::NAN, |d| d.psnr_db),
            flip: metric::flip(image, &wanted, metric::flip::PIXELS_PER_DEGREE)?.mean,
            front: [false; 2],
        });
    }
    for (which, error) in [|r: &Row| r.max, |r: &Row| r.mean].into_iter().enumerate() {
        let on = front(&rows.iter().map(|r| (r.time_ms, error(r))).collect::<Vec<_>>());
        rows.iter_mut().zip(on).for_each(|(row, on)| row.front[which] = on);
    }
    Ok(rows)
}

fn table(key: &str, rows: &[Row]) -> String {
    let mut out = format!(
        "{key}\n  {:24}{:8}{:>10}{:>11}{:>11}{:>8}{:>11}{:>11}  front (max, mean)\n",
        "candidate", "backend", "ms", "max abs", "mean abs", "PSNR", "FLIP", "own max"
    );
    for r in rows {
        let mark = |on: bool, text: &'static str| if on { text } else { "" };
        let _ = writeln!(
            out,
            "  {:24}{:8}{:>10}{:>11.2e}{:>11.2e}{:>8.1}{:>11.2e}{:>11.2e}  {} {}",
            r.name,
            r.backend,
            number(r.time_ms),
            r.max,
            r.mean,
            r.psnr_db,
            r.flip,
            r.against[reference_of(r.knob)],
            mark(r.front[0], "max"),
            mark(r.front[1], "mean")
        );
    }
    for (knob, name) in KNOBS.iter().enumerate() {
        if let Some((fastest, default)) = justified(rows, knob) {
            let keep = fastest.time_ms > (1.0 - PAYS) * default.time_ms;
            let advice = if keep { "keep the default" } else { fastest.name.as_str() };
            let _ = writeln!(
                out,
                "  {name}, its own error: within half an 8-bit step ({BUDGET:.1e}) the fastest is {} ({} ms, \
                    {:.1e}); the default: {} ms, {:.1e}; recommended: {advice}",
                fastest.name,
                number(fastest.time_ms),
                fastest.against[reference_of(knob)],
                number(default.time_ms),
                default.against[reference_of(knob)]
            );
        }
    }
    out
}

/// Of the values of `knob`, the default's included, the fastest whose own error is within the budget; and the
/// default.
fn justified(rows: &[Row], knob: usize) -> Option<(&Row, &Row)> {
    let default = rows.iter().find(|r| r.knob == candidates::DEFAULT)?;
    let of_knob = |r: &&Row| r.knob == knob && r.backend == default.backend;
    if knob == candidates::DEFAULT || !rows.iter().any(|r| of_knob(&r)) {
        return None;
    }
    let within =
        rows.iter().filter(of_knob).chain([default]).filter(|r| r.against[reference_of(knob)] <= BUDGET);
    let fastest = within.min_by(|a, b| a.time_ms.total_cmp(&b.time_ms))?;
    Some((fastest, default))
}

fn push(bench: &mut Bench, key: &str, rows: &[Row], runs: usize) {
    let default = rows.iter().find(|r| r.knob == candidates::DEFAULT).map_or(f64::NAN, |r| r.time_ms);
    for r in rows {
        let key = format!("{key}.{}.{}", r.backend, r.name.replace([' ', '/'], "-"));
        let figure =
            Figure::new(format!("{key}.ms"), r.time_ms, "ms").error(r.max, "max abs against exact f64");
        bench.push(figure.peer("default", default, true).runs(runs));
        bench.push(Figure::new(format!("{key}.mean_abs"), r.mean, ""));
        bench.push(Figure::new(format!("{key}.psnr"), r.psnr_db, "dB"));
        bench.push(Figure::new(format!("{key}.flip"), r.flip, ""));
        bench.push(Figure::new(format!("{key}.own_max"), r.against[reference_of(r.knob)], ""));
        bench.push(Figure::new(format!("{key}.on_front"), f64::from(u8::from(r.front[0])), ""));
    }
}

fn draw(setup: &Setup, scene: &str, side: u32, rows: &[Row]) -> Result<()> {
    for (label, short, error) in [
        ("largest absolute error of a channel", "max", (|r: &Row| r.max) as fn(&Row) -> f64),
        ("mean absolute error of a channel", "mean", |r| r.mean),
        ("mean FLIP", "flip", |r| r.flip),
    ] {
        let several = rows.iter().any(|r| r.backend != rows[0].backend);
        let name = |r: &Row| if several { format!("{}: {}", r.backend, r.name) } else { r.name.clone() };
        let point = |r: &Row| Point { name: name(r), group: r.knob, x: r.time_ms, y: error(r) };
        let plot = Scatter {
            title: &format!("{scene} at {side} × {side}: time against error"),
            subtitle: "Each knob alone from the defaults, and presets; against the f64 reference without cut \
                and stop. Smaller is better in both.",
            x_label: "time per frame, ms",
            y_label: label,
            groups: &KNOBS,
            points: rows.iter().map(point).collect(),
        };
        setup.write(&format!("pareto-{scene}-{side}-{short}.svg"), &plot.svg())?;
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(knob: usize, time_ms: f64, max: f64) -> Row {
        let (name, backend, against) = (format!("{knob}-{time_ms}"), "cpu", [max; 3]);
        Row {
            name,
            backend,
            knob,
            time_ms,
            max,
            mean: 0.0,
            psnr_db: 0.0,
            flip: 0.0,
            against,
            front: [false; 2],
        }
    }

    #[test]
    fn every_knob_has_its_reference() {
        let [exact, unstopped, default] = reference_settings();
        assert!(exact.alpha_cutoff < 1e-11 && !exact.early_stop && !unstopped.early_stop);
        assert_eq!(default, Settings::default());
        assert_eq!(
            KNOBS.map(|name| reference_of(KNOBS.iter().position(|k| *k == name).unwrap())),
            [0, 0, 1, 2, 2, 2, 2, 2, 0]
        );
    }

    #[test]
    fn the_fastest_within_the_budget_is_named() {
        let rows = [row(0, 5.0, 1e-4), row(1, 4.0, 1e-2), row(1, 4.5, 1e-3), row(2, 6.0, 0.0)];
        let fastest = |knob| justified(&rows, knob).map(|(f, _)| f.time_ms);
        assert_eq!((fastest(1), fastest(2), fastest(0), fastest(3)), (Some(4.5), Some(5.0), None, None));
    }

    #[test]
    fn the_random_scene_is_measured_against_another_picture_than_its_own() {
        let view = View::random(300, 48).unwrap();
        let rows = measure(&view, 1, &mut [backend::cpu()]).unwrap();
        let of = |name: &str| rows.iter().find(|r| r.name == name).unwrap();
        assert!(of("exact").max < 1e-5, "{}", of("exact").max);
        assert!(of("default").max > of("exact").max && of("default").max < 0.05);
        for tiles in ["tiles of 8", "tiles of 32"] {
            assert_eq!((of(tiles).max, of(tiles).mean), (of("default").max, of("default").mean));
        }
        assert!(of("cut 1/64").mean > 2.0 * of("default").mean);
        assert!(of("degree 0").max > 0.01, "{}", of("degree 0").max);
        assert!(rows.iter().any(|r| r.front[0]) && rows.iter().any(|r| r.front[1]));
    }
}
