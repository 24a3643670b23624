//! What groups are estimate: estimates beside exact values, and states of colours without rendering.

use anyhow::Result;
use codec_core::Gaussian;
use render_host::{
    Camera, Gradients, Image, Renderer, Settings, Splats, Workspace,
    adjoint::loss::Mse,
    counterfactual::{
        Engine, Quadratic, States, Variants,
        quadratic::{Change, Repaints},
    },
};
use trainer_host::{
    cluster,
    viewpoint::{Framing, Ring},
};

use super::{
    super::cloud::{Kind, LATTICE, Numbers, beside, camera, cloud},
    ms, rank,
};
use crate::{
    figures::{Bench, Figure, median},
    setup::{Setup, synth},
};

/// A scene in groups.
struct Case {
    name: String,
    gaussians: Vec<Gaussian>,
    groups: Vec<u32>,
    count: usize,
    film: Camera,
}

fn cases(setup: &Setup) -> Result<Vec<Case>> {
    let (n, side) = if setup.quick { (3000, 120) } else { (84_000, 400) };
    let mut out = Vec::new();
    for (kind, name) in [(Kind::Volume, "volume"), (Kind::Shells, "shells")] {
        let scene = cloud(kind, n);
        out.push(Case {
            name: format!("{name}-{n}.{side}"),
            gaussians: scene.gaussians,
            groups: scene.groups,
            count: LATTICE.groups(),
            film: camera(side)?,
        });
    }
    let n = if setup.quick { 3000 } else { 20_000 };
    for kind in ["figure", "cloth", "balls"] {
        let scene = synth(kind, n, 2)?;
        let instant = scene.instant(0).unwrap_or_default();
        let film = Framing::of(&scene).ring(Ring::Measuring, 1, (side, side))?.remove(0);
        let mut groups = vec![0; instant.gaussians.len()];
        let epoch = scene.epochs().first();
        let clusters = epoch.map_or_else(Vec::new, |e| cluster::cluster(e, &cluster::Options::default()));
        for (group, cluster) in (0..).zip(&clusters) {
            for &member in cluster {
                if let Some(slot) = groups.get_mut(member as usize) {
                    *slot = group;
                }
            }
        }
        let count = clusters.len().max(1);
        out.push(Case {
            name: format!("{kind}-{n}.{side}"),
            gaussians: instant.gaussians,
            groups,
            count,
            film,
        });
    }
    Ok(out)
}

/// All utilities from one pass and, as an estimate, from the derivative, against the engine's lanes.
pub(super) fn utilities(setup: &Setup, bench: &mut Bench, runs: usize) -> Result<()> {
    let settings = Settings { early_stop: false, ..Settings::default() };
    for case in cases(setup)? {
        let splats = Splats::plain(&case.gaussians);
        let variants = Variants::new(splats, &case.groups, case.count)?;
        let picture = render_host::render(&splats, &case.film, &settings)?.image;
        let target = beside(&picture)?;
        let mut contexts = States::full(case.count);
        let mut r = Numbers(99);
        contexts.push(|_| r.unit() < 0.7);
        let mse = Mse::new(target.clone());
        let engine = Engine::new(&variants, &case.film, &target, &settings)?;
        let (mut workspace, mut out) = (Workspace::new(), Gradients::default());
        let [mut exact_ms, mut single_ms, mut backward_ms] = [const { Vec::new() }; 3];
        let (mut single_off, mut slope_off) = (0.0f64, 0.0);
        for (context, what) in ["full", "random"].into_iter().enumerate() {
            let state = contexts.one(context);
            let (mut exact, mut single) = (None, None);
            for _ in 0..runs {
                ms(&mut exact_ms, || {
                    exact = Some(engine.utilities(&state)?);
                    Ok(())
                })?;
                ms(&mut single_ms, || {
                    single = Some(engine.single_pass(&state)?);
                    Ok(())
                })?;
                if what == "full" {
                    ms(&mut backward_ms, || {
                        Ok(render_host::adjoint::render_and_gradients_into(
                            &mut workspace,
                            &splats,
                            &case.film,
                            &settings,
                            &mse,
                            &mut out,
                        )?)
                    })?;
                }
            }
            let (Some(exact), Some(single)) = (exact, single) else { continue };
            let exact = exact.delta;
            let off =
                compare(bench, &format!("groups.{}.{what}.single_pass", case.name), &exact, &single.delta);
            single_off = single_off.max(off);
            if what == "full" {
                let slope = workspace.presence(&case.groups, case.count)?;
                // The loss is a mean, utilities are sums.
                let values = picture.rgb().len() as f64;
                let estimate: Vec<f64> = slope.iter().map(|s| -s * values).collect();
                slope_off =
                    compare(bench, &format!("groups.{}.{what}.derivative", case.name), &exact, &estimate);
            }
        }
        let time = |key: &str, times: &[f64], off: f64| {
            Figure::new(format!("groups.{}.{key}", case.name), median(times), "ms")
                .error(off, "worst, of the largest")
                .peer("engine's lanes", median(&exact_ms), true)
                .runs(times.len())
        };
        bench.push(time("single_pass.time", &single_ms, single_off));
        bench.push(time("derivative.time", &backward_ms, slope_off));
    }
    Ok(())
}

/// How `got` ranks the groups; returns its largest error as a share of the largest utility.
fn compare(bench: &mut Bench, key: &str, exact: &[f64], got: &[f64]) -> f64 {
    let off = off(exact, got);
    let figure = Figure::new(format!("{key}.spearman"), rank::spearman(exact, got), "");
    bench.push(figure.error(off, "worst, of the largest"));
    bench.push(Figure::new(format!("{key}.kendall"), rank::kendall(exact, got), ""));
    let k = (exact.len() / 10).max(1);
    bench.push(Figure::new(format!("{key}.top_{k}"), rank::overlap(exact, got, k), "shared"));
    off
}

/// Largest error of `got`, as a share of the largest of `exact`.
fn off(exact: &[f64], got: &[f64]) -> f64 {
    let largest = exact.iter().fold(0.0f64, |m, d| m.max(d.abs()));
    exact.iter().zip(got).fold(0.0f64, |m, (a, b)| m.max((a - b).abs())) / largest
}

/// Three levels of colour per cluster: every state from the quadratic form, against rendering it.
pub(super) fn colour(setup: &Setup, bench: &mut Bench, runs: usize) -> Result<()> {
    let (n, sides): (usize, &[u32]) = if setup.quick { (3000, &[120]) } else { (84_000, &[400, 800]) };
    let mut scene = cloud(Kind::Shells, n);
    // Away from black, so that no level brings a colour below 0.
    scene.gaussians.iter_mut().for_each(|g| g.sh0 = g.sh0.map(|v| 0.4 * v + 0.5));
    let mut r = Numbers(5);
    let count = 3 * LATTICE.clusters;
    let mut changes = Vec::new();
    for (i, group) in scene.groups.iter().enumerate() {
        for level in 0..3 {
            let size = [0.4, 0.2, 0.1][level as usize];
            let sh0 = [0; 3].map(|_| r.between(-size, size));
            changes.push(Change {
                gaussian: i as u32,
                group: group / LATTICE.levels as u32 * 3 + level,
                sh0,
            });
        }
    }
    let repaints = Repaints::new(Splats::plain(&scene.gaussians), &changes, &[], count)?;
    let settings = Settings::default();
    for &side in sides {
        let film = camera(side)?;
        let picture = render_host::render(&Splats::plain(&scene.gaussians), &film, &settings)?.image;
        let target = beside(&picture)?;
        let mut states = States::new(count);
        for _ in 0..1000 {
            states.push(|_| r.unit() < 0.5);
        }
        let mut renderer = Renderer::new();
        let [mut build, mut alone, mut each, mut estimate] = [const { Vec::new() }; 4];
        let (mut form, mut sse, mut worst, mut worst_delta) = (None, Vec::new(), 0.0f64, 0.0f64);
        for run in 0..runs {
            ms(&mut build, || {
                form = Some(Quadratic::new(&repaints, &film, &target, &settings)?);
                Ok(())
            })?;
            let Some(form) = &form else { continue };
            ms(&mut each, || {
                sse = form.sse(&states)?;
                Ok(())
            })?;
            let few = states.one(run);
            let mut found = None;
            ms(&mut estimate, || {
                found = Some(form.utilities(&few)?);
                Ok(())
            })?;
            let (gaussians, _) = repaints.world(&states, run);
            let mut image = None;
            ms(&mut alone, || {
                image = Some(renderer.render(&Splats::plain(&gaussians), &film, &settings)?.image);
                Ok(())
            })?;
            let Some(image) = image else { continue };
            let square = |(a, b): (&f32, &f32)| (f64::from(*a) - f64::from(*b)).powi(2);
            let squares = |image: &Image| image.rgb().iter().zip(target.rgb()).map(square).sum::<f64>();
            let rendered = squares(&image);
            worst = worst.max((sse[run] / rendered - 1.0).abs());
            // One group toggled, rendered too.
            let Some(found) = found else { continue };
            let (group, mut toggled) = (run * 7 % count, States::new(count));
            toggled.push(|g| few.has(0, g) != (g == group));
            let (gaussians, _) = repaints.world(&toggled, 0);
            let rise =
                squares(&renderer.render(&Splats::plain(&gaussians), &film, &settings)?.image) - rendered;
            let delta = if few.has(0, group) { rise } else { -rise };
            let largest = found.delta.iter().fold(0.0f64, |m, d| m.max(d.abs()));
            worst_delta = worst_delta.max((found.of(0, group) - delta).abs() / largest);
        }
        let Some(form) = form else { continue };
        let name = format!("colour.{n}.{count}.{side}");
        let each = 1000.0 * median(&each) / states.len() as f64;
        bench.push(
            Figure::new(format!("{name}.state"), each, "us")
                .error(worst, "relative SSE against rendering")
                .peer("one render", 1000.0 * median(&alone), true)
                .runs(runs),
        );
        bench.push(
            Figure::new(format!("{name}.all_utilities"), 1000.0 * median(&estimate), "us")
                .error(worst_delta, "of the largest, a group toggled and rendered")
                .runs(runs),
        );
        bench.push(
            Figure::new(format!("{name}.build"), median(&build), "ms")
                .error(worst, "relative SSE against rendering")
                .runs(runs),
        );
        bench.push(Figure::new(format!("{name}.pairs"), form.pairs() as f64, ""));
        bench.push(Figure::new(format!("{name}.clamp_bound"), form.clamp(), "root SSE"));
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_utility_shows() {
        assert_eq!(off(&[1.0, -4.0], &[1.0, -4.0]), 0.0);
        assert_eq!(off(&[1.0, -4.0], &[1.0, -3.0]), 0.25);
    }
}
