//! Measures gradients: their error against the f64 reference, their speed, what they tell about groups.

mod groups;
mod peer;
mod rank;

use std::time::Instant;

use anyhow::{Result, ensure};
use codec_core::{Gaussian, ShDegree};
use render_host::{
    Camera, Gradients, Image, Loss, Renderer, Settings, Splats, Workspace,
    adjoint::{
        check,
        loss::{Distortion, Linear, Mse},
        render_and_gradients_into,
    },
    reference, render_and_gradients,
};
use trainer_host::viewpoint::{Framing, Ring};

use self::peer::{Peer, Timed};
use super::{
    clock::milliseconds_of,
    cloud::{CloudShape, TestRng, beside, camera, cloud},
};
use crate::{
    figures::{Bench, Figure, median},
    setup::{Setup, load},
};

/// How often ours and the peer take turns.
const TURNS: usize = 3;
/// A peer's picture that is further from the reference is of something else: ours and theirs cut differently.
const MIN_PEER_DB: f64 = 50.0;

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let runs = if setup.quick { 3 } else { 9 };
    let mut bench = Bench::new(
        "gradient",
        format!(
            "check: 8 Gaussians, 24x18, nothing cut, every parameter against central differences of the \
             f64 reference (worst: relative, at least 1 % of the class's largest; error: relative L2); \
             frames: ms forward, and forward with all gradients, default settings, medians of {runs} \
             interleaved runs, beside one f64 reference forward; opensplat: the same Gaussians, camera and \
             target in OpenSplat's processor path, a program of its own, in three turns with ours, its \
             picture against the same reference; their error: derivative along a random \
             change of all colours against the f64 reference; groups: first order of utilities from a \
             gradient, against leave-one-out by the engine's lanes"
        ),
    );
    checks(&mut bench, runs)?;
    losses(setup, &mut bench, runs)?;
    frames(setup, &mut bench, runs)?;
    groups::utilities(setup, &mut bench, runs)?;
    Ok(bench)
}

/// Figure 5: every class of parameters on scenes of every degree.
fn checks(bench: &mut Bench, runs: usize) -> Result<()> {
    let mut r = TestRng(3);
    let camera = Camera::look_at([1.9, -2.1, 1.45], [0.1, 0.0, -0.05], [0.0, 0.0, 1.0], 0.95, 24, 18)?;
    let target = Image::new(24, 18, (0..3 * 24 * 18).map(|_| r.unit()).collect())?;
    let settings = Settings { background: [0.3, 0.6, 0.1], ..Settings::exact() };
    let losses: [(&str, Box<dyn Loss>); 3] = [
        ("linear", Box::new(Linear(target.clone()))),
        ("mse", Box::new(Mse::new(target.clone()))),
        ("mse+ssim", Box::new(Distortion::weighted(target, 1.0))),
    ];
    for (name, loss) in &losses {
        let mut worst: Vec<check::ClassError> = Vec::new();
        let mut times = Vec::new();
        for degree in 0..=3 {
            let degree = ShDegree::new(degree).unwrap_or(ShDegree::ZERO);
            let gaussians: Vec<Gaussian> = (0..8)
                .map(|_| Gaussian {
                    position: [0; 3].map(|_| r.between(-1.0, 1.0)),
                    scale: [0; 3].map(|_| r.between(-2.3, -0.7).exp()),
                    rotation: [0; 4].map(|_| r.between(-1.5, 1.5)),
                    opacity: r.between(0.1, 0.95),
                    sh0: [0; 3].map(|_| r.between(0.5, 1.5)),
                })
                .collect();
            let rest: Vec<f32> = (0..8 * degree.rest_len()).map(|_| r.between(-0.15, 0.15)).collect();
            let splats = Splats::new(&gaussians, &rest, degree)?;
            let (mut workspace, mut out) = (Workspace::new(), Gradients::default());
            for _ in 0..runs {
                milliseconds_of(&mut times, || {
                    Ok(render_and_gradients_into(
                        &mut workspace,
                        &splats,
                        &camera,
                        &settings,
                        &**loss,
                        &mut out,
                    )?)
                })?;
            }
            let found = check::compare(&splats, &camera, &settings, &**loss, &out, 1.0 / 4096.0)?;
            for class in found.classes {
                match worst.iter_mut().find(|w| w.class == class.class) {
                    Some(w) => {
                        w.worst = w.worst.max(class.worst);
                        w.l2 = w.l2.max(class.l2);
                        w.rough += class.rough;
                        w.compared += class.compared;
                    }
                    None => worst.push(class),
                }
            }
        }
        let relative = worst.iter().map(|class| class.l2).fold(0.0, f64::max);
        for class in worst {
            let key = format!("check.{name}.{}", class.class.replace(' ', "_"));
            bench.push(Figure::new(key, class.worst, "worst").error(class.l2, "relative L2"));
            if class.rough > 0 {
                bench.push(Figure::new(
                    format!("check.{name}.{}.not_smooth", class.class.replace(' ', "_")),
                    class.rough as f64,
                    "left out",
                ));
            }
        }
        bench.push(
            Figure::new(format!("check.{name}.time"), median(&times), "ms")
                .error(relative, "relative L2 of the worst class")
                .runs(times.len()),
        );
    }
    Ok(())
}

/// The losses alone, on a rendered picture and the same in other colours.
fn losses(setup: &Setup, bench: &mut Bench, runs: usize) -> Result<()> {
    let sides: &[u32] = if setup.quick { &[160] } else { &[400, 800] };
    for &side in sides {
        let scene = cloud(CloudShape::Shells, 20_000);
        let image =
            render_host::render(&Splats::plain(&scene.gaussians), &camera(side)?, &Settings::default())?
                .image;
        let target = beside(&image)?;
        let exact = render_host::metric::distortion(&image, &target)?;
        let exact_mse = render_host::metric::mse(&image, &target)?;
        let (mse, both) = (Mse::new(target.clone()), Distortion::new(target));
        let mut gradient = vec![0.0; image.rgb().len()];
        let (mut of_mse, mut of_both, mut mean, mut value) = (Vec::new(), Vec::new(), 0.0, 0.0);
        for _ in 0..2 * runs + 1 {
            milliseconds_of(&mut of_mse, || {
                mean = mse.differentiate(&image, true, &mut gradient)?;
                Ok(())
            })?;
            milliseconds_of(&mut of_both, || {
                value = both.differentiate(&image, true, &mut gradient)?;
                Ok(())
            })?;
        }
        let of_metric = "relative, value against the f64 metric";
        bench.push(
            Figure::new(format!("loss.{side}.mse"), median(&of_mse), "ms")
                .error((mean / exact_mse - 1.0).abs(), of_metric)
                .runs(of_mse.len()),
        );
        bench.push(
            Figure::new(format!("loss.{side}.mse+ssim"), median(&of_both), "ms")
                .error((value / exact - 1.0).abs(), of_metric)
                .runs(of_both.len()),
        );
    }
    Ok(())
}

/// Figure 1, with gradients.
fn frames(setup: &Setup, bench: &mut Bench, runs: usize) -> Result<()> {
    let peer = Peer::installed()?;
    if peer.is_none() {
        bench.skipped.push(format!("OpenSplat: {} names no program of it", peer::PROGRAM));
    }
    let peer = peer.as_ref();
    let (counts, sides): (&[usize], &[u32]) =
        if setup.quick { (&[4000], &[160]) } else { (&[20_000, 100_000], &[400, 800]) };
    for &n in counts {
        let scene = cloud(CloudShape::Volume, n);
        for &side in sides {
            let name = format!("random-{n}.{side}");
            frame(bench, &name, &Splats::plain(&scene.gaussians), &camera(side)?, (runs, peer))?;
        }
    }
    let biker = if setup.quick { None } else { setup.data("scenes/splat-biker/biker.spz", bench)? };
    if let Some(path) = biker {
        let scene = load(&path, 0)?;
        let instant = scene.instant(0).unwrap_or_default();
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)?;
        for &side in sides {
            let camera = &Framing::of(&scene).ring(Ring::HeldOut, 3, (side, side))?[0];
            let name = format!("biker-{}.{side}", splats.len());
            frame(bench, &name, &splats, camera, (runs, peer))?;
        }
    }
    Ok(())
}

fn frame(
    bench: &mut Bench,
    name: &str,
    splats: &Splats,
    camera: &Camera,
    (runs, peer): (usize, Option<&Peer>),
) -> Result<()> {
    let settings = Settings::default();
    let (mut renderer, mut picture) = (Renderer::new(), Default::default());
    renderer.render_into(splats, camera, &settings, &mut picture)?;
    let start = Instant::now();
    let exact = reference::render(splats, camera, &settings)?;
    let slow = 1000.0 * start.elapsed().as_secs_f64();
    let error = exact.difference(picture.image.rgb()).unwrap_or_default();
    let target = beside(&picture.image)?;
    let (mse, both) = (Mse::new(target.clone()), Distortion::new(target.clone()));
    let (mut workspace, mut out) = (Workspace::new(), Gradients::default());
    let [mut forward, mut with_mse, mut with_both] = [const { Vec::new() }; 3];
    let mut theirs = Timed::default();
    for run in 0..runs {
        if let Some(peer) = peer
            && run % runs.div_ceil(TURNS) == 0
        {
            let timed = peer.time(splats, camera, &target, runs.div_ceil(TURNS))?;
            theirs.forward.extend(timed.forward);
            theirs.with_mse.extend(timed.with_mse);
            theirs.rgb = timed.rgb;
        }
        milliseconds_of(&mut forward, || {
            Ok(renderer.render_into(splats, camera, &settings, &mut picture)?)
        })?;
        milliseconds_of(&mut with_mse, || {
            Ok(render_and_gradients_into(&mut workspace, splats, camera, &settings, &mse, &mut out)?)
        })?;
        milliseconds_of(&mut with_both, || {
            Ok(render_and_gradients_into(&mut workspace, splats, camera, &settings, &both, &mut out)?)
        })?;
    }
    bench.push(
        Figure::new(format!("{name}.forward"), median(&forward), "ms")
            .error(error.max_clear, "max abs away from thresholds")
            .peer("f64 reference forward", slow, true)
            .runs(runs),
    );
    if let Some(difference) = exact.difference(&theirs.rgb).filter(|_| peer.is_some()) {
        let psnr_db = difference.psnr_db;
        beside_peer(bench, &format!("{name}.opensplat"), [&forward, &with_mse], (&theirs, psnr_db))?;
    }
    let losses: [(&str, &dyn Loss, &[f64]); 2] = [("mse", &mse, &with_mse), ("mse+ssim", &both, &with_both)];
    for (which, loss, times) in losses {
        bench.push(
            Figure::new(format!("{name}.forward_backward.{which}"), median(times), "ms")
                .error(along_colours(splats, camera, &settings, loss)?, "relative, derivative along colours")
                .peer("f64 reference forward", slow, true)
                .runs(runs),
        );
    }
    Ok(())
}

/// Adds our times, of pictures and with gradients, beside the peer's, and how far its picture is from the
/// reference, dB.
///
/// # Errors
/// Another picture: its time would be of other work.
fn beside_peer(
    bench: &mut Bench,
    name: &str,
    ours: [&[f64]; 2],
    (theirs, psnr_db): (&Timed, f64),
) -> Result<()> {
    ensure!(psnr_db >= MIN_PEER_DB, "{name}: its picture is {psnr_db:.1} dB from the reference");
    let parts = [("forward", ours[0], &theirs.forward), ("forward_backward", ours[1], &theirs.with_mse)];
    for (part, ours, theirs) in parts {
        let figure = Figure::new(format!("{name}.{part}"), median(ours), "ms");
        let figure = figure.error(psnr_db, "dB, its picture against the reference");
        bench.push(figure.peer("OpenSplat", median(theirs), true).runs(ours.len()));
    }
    Ok(())
}

/// Relative error of the derivative along a random change of all colours. The picture is linear in
/// colours that stay above 0, so thresholds do not disturb the difference.
pub(super) fn along_colours(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    loss: &dyn Loss,
) -> Result<f64> {
    let got = render_and_gradients(&mut Workspace::new(), splats, camera, settings, loss)?;
    let step = 1.0 / 2048.0;
    let mut r = TestRng(17);
    let n = splats.len();
    let mut change: Vec<[f32; 3]> = (0..n).map(|_| [0; 3].map(|_| r.between(-1.0, 1.0))).collect();
    // Only what raises the loss is added up, so that the sum does not cancel.
    for (change, g) in change.iter_mut().zip(&got.splats) {
        (0..3).for_each(|c| change[c] = change[c].abs() * g.sh0[c].signum());
        // Colours at or near the clamp are left alone.
        if g.sh0.contains(&0.0) {
            *change = [0.0; 3];
        }
    }
    let rest: Vec<f32> = (0..n).flat_map(|i| splats.rest(i)).copied().collect();
    let at = |h: f32| -> Result<(f64, Vec<[f64; 3]>)> {
        let mut gaussians = splats.gaussians().to_vec();
        for (gaussian, change) in gaussians.iter_mut().zip(&change) {
            (0..3).for_each(|c| gaussian.sh0[c] += h * change[c]);
        }
        let moved = gaussians.iter().map(|g| g.sh0.map(f64::from)).collect();
        let splats = Splats::new(&gaussians, &rest, splats.sh_degree())?;
        Ok((loss.exact(&reference::render(&splats, camera, settings)?.rgb), moved))
    };
    let ((above, a), (below, b)) = (at(step)?, at(-step)?);
    let expected = above - below;
    let mut found = 0.0;
    for ((a, b), g) in a.iter().zip(&b).zip(&got.splats) {
        found += (0..3).map(|c| (a[c] - b[c]) * f64::from(g.sh0[c])).sum::<f64>();
    }
    Ok((found / expected - 1.0).abs())
}

#[cfg(all(test, unix))]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// A program that prints times and draws nothing is no peer, nor is one that fails.
    #[test]
    fn a_peer_that_draws_something_else_is_refused() {
        let folder = tempfile::tempdir().unwrap();
        let against = |script: &str| {
            let program = folder.path().join("peer");
            std::fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
            std::fs::set_permissions(&program, std::fs::Permissions::from_mode(0o700)).unwrap();
            let peer = Peer::of(program).unwrap();
            let scene = cloud(CloudShape::Volume, 200);
            let mut bench = Bench::new("gradient", "test");
            let splats = Splats::plain(&scene.gaussians);
            let compared = frame(&mut bench, "x", &splats, &camera(16).unwrap(), (1, Some(&peer)));
            compared.unwrap_err().to_string()
        };
        let black = "head -c 3072 /dev/zero > \"$3\"; echo 1.0 2.0";
        assert!(against(black).contains("x.opensplat: its picture is"), "{}", against(black));
        assert!(against("head -c 12 /dev/zero > \"$3\"; echo 1.0 2.0").contains("has 12 bytes"));
        assert!(against("head -c 3072 /dev/zero > \"$3\"").contains("ran 0 times for 1"));
        assert!(against("echo no such thing >&2; exit 1").contains("no such thing"));
    }
}
