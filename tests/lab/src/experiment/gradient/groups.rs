//! Estimates what groups add to a picture from one gradient, beside the exact values.

use anyhow::Result;
use codec_core::Gaussian;
use render_host::{
    Camera, Gradients, Settings, Splats, Workspace,
    adjoint::loss::Mse,
    counterfactual::{Engine, States, Variants},
};
use trainer_host::{
    cluster,
    viewpoint::{Framing, Ring},
};

use super::{
    super::{
        clock::milliseconds_of,
        cloud::{CloudShape, LATTICE, beside, camera, cloud},
    },
    rank,
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
    camera: Camera,
}

fn cases(setup: &Setup) -> Result<Vec<Case>> {
    let (n, side) = if setup.quick { (3000, 120) } else { (84_000, 400) };
    let mut out = Vec::new();
    for (kind, name) in [(CloudShape::Volume, "volume"), (CloudShape::Shells, "shells")] {
        let scene = cloud(kind, n);
        out.push(Case {
            name: format!("{name}-{n}.{side}"),
            gaussians: scene.gaussians,
            groups: scene.groups,
            count: LATTICE.groups(),
            camera: camera(side)?,
        });
    }
    let n = if setup.quick { 3000 } else { 20_000 };
    for kind in ["figure", "cloth", "balls"] {
        let scene = synth(kind, n, 2)?;
        let instant = scene.instant(0).unwrap_or_default();
        let camera = Framing::of(&scene).ring(Ring::Validation, 1, (side, side))?.remove(0);
        let mut groups = vec![0; instant.gaussians.len()];
        let epoch = scene.epochs().first();
        let clusters =
            epoch.map_or_else(Vec::new, |e| cluster::cluster(e, &cluster::ClusterOptions::default()));
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
            camera,
        });
    }
    Ok(out)
}

/// Utilities as the derivative estimates them, against the engine's lanes.
pub(super) fn utilities(setup: &Setup, bench: &mut Bench, runs: usize) -> Result<()> {
    let settings = Settings { early_stop: false, ..Settings::default() };
    for case in cases(setup)? {
        let splats = Splats::plain(&case.gaussians);
        let variants = Variants::new(splats, &case.groups, case.count)?;
        let picture = render_host::render(&splats, &case.camera, &settings)?.image;
        let target = beside(&picture)?;
        let full = States::full(case.count);
        let mse = Mse::new(target.clone());
        let engine = Engine::new(&variants, &case.camera, &target, &settings)?;
        let (mut workspace, mut out) = (Workspace::new(), Gradients::default());
        let [mut exact_ms, mut backward_ms] = [const { Vec::new() }; 2];
        let mut exact = Vec::new();
        for _ in 0..runs {
            milliseconds_of(&mut exact_ms, || {
                exact = engine.utilities(&full)?.delta;
                Ok(())
            })?;
            milliseconds_of(&mut backward_ms, || {
                Ok(render_host::adjoint::render_and_gradients_into(
                    &mut workspace,
                    &splats,
                    &case.camera,
                    &settings,
                    &mse,
                    &mut out,
                )?)
            })?;
        }
        let slope = workspace.presence(&case.groups, case.count)?;
        // The loss is a mean, utilities are sums.
        let values = picture.rgb().len() as f64;
        let estimate: Vec<f64> = slope.iter().map(|s| -s * values).collect();
        let off = compare(bench, &format!("groups.{}.full.derivative", case.name), &exact, &estimate);
        bench.push(
            Figure::new(format!("groups.{}.derivative.time", case.name), median(&backward_ms), "ms")
                .error(off, "worst, of the largest")
                .peer("engine's lanes", median(&exact_ms), true)
                .runs(backward_ms.len()),
        );
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_wrong_utility_shows() {
        assert_eq!(off(&[1.0, -4.0], &[1.0, -4.0]), 0.0);
        assert_eq!(off(&[1.0, -4.0], &[1.0, -3.0]), 0.25);
    }
}
