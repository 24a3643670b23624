//! The tile renderer against the f64 reference and a naive f32 renderer, same scene, same settings, same
//! process. After criterion's own report it prints the ratios and the errors, which are the point.
//!
//! `cargo bench -p render-host`

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

#[path = "../tests/support/mod.rs"]
mod support;

use std::hint::black_box;

use criterion::Criterion;
use render_host::{
    Camera, Gradients, Image, Loss, Renderer, Settings, Splats, Workspace,
    adjoint::{
        check,
        loss::{Distortion, Mse},
        render_and_gradients_into,
    },
    reference,
};

use support::{Scene, camera};

/// What one writes first: all f32, the covariance by its matrix, `a·c - b²`, splat by splat over its
/// 3σ box, one thread. Degree 0.
mod naive {
    use super::{Camera, Settings, Splats};

    struct Disc {
        z: f32,
        mean: [f32; 2],
        conic: [f32; 3],
        radius: f32,
        opacity: f32,
        colour: [f32; 3],
    }

    pub fn render(splats: &Splats, camera: &Camera, settings: &Settings) -> Vec<f32> {
        let (width, height) = (camera.width() as usize, camera.height() as usize);
        let intrinsics = camera.intrinsics();
        let rotation = camera.rotation().map(|r| r.map(|v| v as f32));
        let mut discs: Vec<Disc> = Vec::new();
        for g in splats.gaussians() {
            let [x, y, z] = camera.to_camera(g.position).map(|v| v as f32);
            if z < camera.near() as f32 {
                continue;
            }
            let [w, i, j, k] = g.rotation;
            let local = [
                [1.0 - 2.0 * (j * j + k * k), 2.0 * (i * j - w * k), 2.0 * (i * k + w * j)],
                [2.0 * (i * j + w * k), 1.0 - 2.0 * (i * i + k * k), 2.0 * (j * k - w * i)],
                [2.0 * (i * k - w * j), 2.0 * (j * k + w * i), 1.0 - 2.0 * (i * i + j * j)],
            ];
            let (fx, fy) = (intrinsics.fx as f32 / z, intrinsics.fy as f32 / z);
            let jacobian = [[fx, 0.0, -fx * x / z], [0.0, fy, -fy * y / z]];
            let mut m = [[0.0f32; 3]; 2];
            for (row, j) in m.iter_mut().zip(jacobian) {
                for (k, out) in row.iter_mut().enumerate() {
                    for a in 0..3 {
                        for (b, local) in local.iter().enumerate() {
                            *out += j[a] * rotation[a][b] * local[k] * g.scale[k];
                        }
                    }
                }
            }
            let dot = |a: [f32; 3], b: [f32; 3]| a[0] * b[0] + a[1] * b[1] + a[2] * b[2];
            let low_pass = settings.low_pass as f32;
            let (a, b, c) = (dot(m[0], m[0]) + low_pass, dot(m[0], m[1]), dot(m[1], m[1]) + low_pass);
            let det = a * c - b * b;
            if det <= 0.0 {
                continue;
            }
            let mid = 0.5 * (a + c);
            let radius = 3.0 * (mid + (mid * mid - det).max(0.1).sqrt()).sqrt();
            discs.push(Disc {
                z,
                mean: [fx * x + intrinsics.cx as f32, fy * y + intrinsics.cy as f32],
                conic: [c / det, -b / det, a / det],
                radius,
                opacity: g.opacity,
                colour: g.sh0.map(|v| (0.5 + 0.282_094_8 * v).max(0.0)),
            });
        }
        discs.sort_by(|a, b| a.z.total_cmp(&b.z));
        let mut rgb = vec![0.0f32; 3 * width * height];
        let mut transmittance = vec![1.0f32; width * height];
        for d in &discs {
            let range = |mean: f32, side: usize| {
                let (low, high) = (mean - d.radius, mean + d.radius);
                low.max(0.0) as usize..(high.max(0.0).ceil() as usize).min(side)
            };
            for py in range(d.mean[1], height) {
                for px in range(d.mean[0], width) {
                    let (dx, dy) = (px as f32 + 0.5 - d.mean[0], py as f32 + 0.5 - d.mean[1]);
                    let [a, b, c] = d.conic;
                    let power = -0.5 * (a * dx * dx + c * dy * dy) - b * dx * dy;
                    let alpha = (d.opacity * power.exp()).min(settings.alpha_max);
                    let t = &mut transmittance[py * width + px];
                    if alpha < settings.alpha_cutoff || *t < settings.transmittance_stop {
                        continue;
                    }
                    let pixel = &mut rgb[3 * (py * width + px)..][..3];
                    for (sum, colour) in pixel.iter_mut().zip(d.colour) {
                        *sum += *t * alpha * colour;
                    }
                    *t *= 1.0 - alpha;
                }
            }
        }
        rgb
    }
}

/// A scene in [-1, 1]³ whose scales are 0.012 times a log-normal of σ = 0.4.
fn cloud(n: usize) -> Scene {
    let mut scene = Scene::random(n, 0, 0.01, 0.02, 42);
    let mut r = support::TestRng(7);
    let mut normal = || {
        let (a, b) = (r.unit().max(1e-9), r.unit());
        (-2.0 * a.ln()).sqrt() * (std::f32::consts::TAU * b).cos()
    };
    scene.gaussians.iter_mut().for_each(|g| g.scale = [0; 3].map(|_| 0.012 * (0.4 * normal()).exp()));
    scene
}

/// Median, as the machine may be shared.
#[expect(clippy::disallowed_methods, reason = "a bench measures time")]
fn medians(runs: usize, work: &mut [&mut dyn FnMut()]) -> Vec<f64> {
    let mut times = vec![Vec::new(); work.len()];
    for _ in 0..runs {
        for (work, times) in work.iter_mut().zip(&mut times) {
            let start = std::time::Instant::now();
            work();
            times.push(start.elapsed().as_secs_f64() * 1e3);
        }
    }
    times.iter_mut().for_each(|t| t.sort_by(f64::total_cmp));
    times.iter().map(|t| t[t.len() / 2]).collect()
}

/// Forward, and forward with gradients, interleaved.
fn gradients(lines: &mut Vec<String>) {
    for (n, side) in [(20_000, 400), (20_000, 800), (100_000, 400), (100_000, 800)] {
        let scene = cloud(n);
        let (splats, camera) = (scene.splats(), camera(side, side));
        let settings = Settings::default();
        let target = Image::filled(side, side, [0.4, 0.5, 0.6]).unwrap();
        let (mse, distortion) = (Mse::new(target.clone()), Distortion::new(target));
        let (mut renderer, mut out) = (Renderer::new(), Default::default());
        let (mut workspace, mut gradients) = (Workspace::new(), [Gradients::default(), Gradients::default()]);
        let [with_mse, with_distortion] = &mut gradients;
        let mut both = |loss: &dyn Loss, out: &mut Gradients| {
            render_and_gradients_into(&mut workspace, &splats, &camera, &settings, loss, out).unwrap();
        };
        both(&mse, with_mse);
        let mut forward = || renderer.render_into(&splats, &camera, &settings, &mut out).unwrap();
        let both = std::cell::RefCell::new(both);
        let mut a = || (both.borrow_mut())(&mse, with_mse);
        let mut b = || (both.borrow_mut())(&distortion, with_distortion);
        let times = medians(9, &mut [&mut forward, &mut a, &mut b]);
        lines.push(format!(
            "{n} splats, {side} x {side}, medians of 9: forward {:.1} ms; with gradients {:.1} ms (mse), \
             {:.1} ms (distortion)",
            times[0], times[1], times[2]
        ));
    }
    for degree in 0..=3 {
        let scene = Scene::random(8, degree, 0.1, 0.5, 1);
        let loss = Distortion::new(Image::filled(24, 18, [0.4, 0.5, 0.6]).unwrap());
        let errors = check(&scene.splats(), &camera(24, 18), &Settings::exact(), &loss).unwrap();
        lines.push(format!("gradients against differences of the f64 reference, degree {degree}\n{errors}"));
    }
}

#[expect(clippy::disallowed_methods, reason = "a bench measures time")]
fn best_of(runs: usize, mut work: impl FnMut()) -> f64 {
    let times = (0..runs).map(|_| {
        let start = std::time::Instant::now();
        work();
        start.elapsed().as_secs_f64() * 1e3
    });
    times.fold(f64::INFINITY, f64::min)
}

fn main() {
    let mut criterion = Criterion::default().sample_size(10).configure_from_args();
    let settings = Settings::default();
    let serial = Settings { parallel: false, ..Settings::default() };
    let mut lines = Vec::new();
    gradients(&mut lines);
    lines.drain(..).for_each(|line| println!("{line}"));
    for (n, side) in [(100_000, 400), (100_000, 800)] {
        let scene = Scene::random(n, 0, 0.003, 0.02, 42);
        let (splats, camera) = (scene.splats(), camera(side, side));
        let (mut renderer, mut out) = (Renderer::new(), Default::default());
        let mut fast = |settings: &Settings| {
            renderer.render_into(black_box(&splats), &camera, settings, &mut out).unwrap();
        };
        criterion.bench_function(&format!("fast/{n}/{side}"), |b| b.iter(|| fast(&settings)));
        let target = Image::filled(side, side, [0.4, 0.5, 0.6]).unwrap();
        let (mse, distortion) = (Mse::new(target.clone()), Distortion::new(target));
        let (mut workspace, mut gradients) = (Workspace::new(), Gradients::default());
        let mut both = |loss: &dyn Loss| {
            let splats = black_box(&splats);
            render_and_gradients_into(&mut workspace, splats, &camera, &settings, loss, &mut gradients)
                .unwrap();
        };
        criterion.bench_function(&format!("mse gradients/{n}/{side}"), |b| b.iter(|| both(&mse)));
        criterion
            .bench_function(&format!("distortion gradients/{n}/{side}"), |b| b.iter(|| both(&distortion)));

        let fast_ms = best_of(9, || fast(&settings));
        let serial_ms = best_of(5, || fast(&serial));
        let naive_ms = best_of(2, || drop(black_box(naive::render(&splats, &camera, &settings))));
        let mut slow = None;
        let slow_ms = best_of(1, || slow = reference::render(&splats, &camera, &settings).ok());
        let slow = slow.unwrap();
        let error = slow.difference(out.image.rgb()).unwrap();
        let naive_error = slow.difference(&naive::render(&splats, &camera, &settings)).unwrap();
        let counters = out.counters;
        lines.push(format!(
            "{n} splats, {side} x {side}: fast {fast_ms:.1} ms ({serial_ms:.1} on one thread); \
             naive f32 {naive_ms:.0} ms = {:.1}x ({:.1}x one thread); \
             f64 reference {slow_ms:.0} ms = {:.0}x\n  \
             fast against f64: {error:?}\n  naive against f64: {naive_error:?}\n  {counters:?}",
            naive_ms / fast_ms,
            naive_ms / serial_ms,
            slow_ms / fast_ms,
        ));
    }
    lines.iter().for_each(|line| println!("{line}"));
    criterion.final_summary();
}
