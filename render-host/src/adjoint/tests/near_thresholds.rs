//! Close to where the picture jumps or bends: what a threshold decides, the gradient follows.

use super::*;

fn pair(opacity: f32) -> Scene {
    let ball = Gaussian { scale: [0.5; 3], opacity, sh0: [1.0; 3], ..Gaussian::ABSENT };
    let behind = Gaussian { position: [0.0, 0.0, 1.0], opacity: 0.6, sh0: [0.2; 3], ..ball };
    Scene { gaussians: vec![ball, behind], rest: vec![], degree: ShDegree::ZERO }
}

fn one_pixel() -> Camera {
    Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 1, 1).unwrap()
}

fn logits(scene: &Scene, settings: &Settings) -> [f32; 2] {
    let loss = Linear(Image::filled(1, 1, [1.0, 0.5, 0.25]).unwrap());
    let got = render_and_gradients(&mut Workspace::new(), &scene.splats(), &one_pixel(), settings, &loss);
    let got = got.unwrap();
    [got.splats[0].opacity_logit, got.splats[1].opacity_logit]
}

/// Difference over a step that crosses nothing.
fn difference(scene: &Scene, index: usize, settings: &Settings) -> f64 {
    let loss = Linear(Image::filled(1, 1, [1.0, 0.5, 0.25]).unwrap());
    let logit = |o: f32| (f64::from(o) / (1.0 - f64::from(o))).ln();
    let at = |h: f32| {
        let mut scene = scene.clone();
        scene.gaussians[index].opacity *= 1.0 + h;
        let picture = reference::render(&scene.splats(), &one_pixel(), settings).unwrap();
        (logit(scene.gaussians[index].opacity), loss.exact(&picture.rgb))
    };
    let ((a, fa), (b, fb)) = (at(1e-5), at(-1e-5));
    (fa - fb) / (a - b)
}

#[test]
fn at_the_clamp() {
    let settings = Settings { low_pass: 0.0, ..smooth() };
    let below = pair(0.9899);
    let expected = difference(&below, 0, &settings);
    assert!((f64::from(logits(&below, &settings)[0]) / expected - 1.0).abs() < 1e-3, "{expected}");
    let above = pair(0.9901);
    assert_eq!(logits(&above, &settings)[0], 0.0);
    assert_eq!(difference(&above, 0, &settings), 0.0);
}

#[test]
fn at_the_cut_off() {
    let settings = Settings { alpha_cutoff: 0.1, low_pass: 0.0, ..smooth() };
    let above = pair(0.1002);
    let expected = difference(&above, 0, &settings);
    assert!((f64::from(logits(&above, &settings)[0]) / expected - 1.0).abs() < 1e-3, "{expected}");
    assert_eq!(logits(&pair(0.0998), &settings)[0], 0.0);
}

#[test]
fn at_the_stop() {
    let settings = Settings { early_stop: true, transmittance_stop: 0.2, low_pass: 0.0, ..smooth() };
    let open = pair(0.799);
    for index in 0..2 {
        let expected = difference(&open, index, &settings);
        let got = f64::from(logits(&open, &settings)[index]);
        assert!((got / expected - 1.0).abs() < 1e-3, "{index}: {got} {expected}");
    }
    let shut = pair(0.801);
    let expected = difference(&shut, 0, &settings);
    let [front, behind] = logits(&shut, &settings);
    assert!((f64::from(front) / expected - 1.0).abs() < 1e-3);
    assert_eq!(behind, 0.0);
}

/// The default tolerances bend the gradient by what they cut away: 5 % over a scene of coarse splats.
#[test]
fn default_tolerances_cost_little() {
    let scene = Scene::random(300, 1, [0.05, 0.2], 77);
    let (camera, loss) = (camera(64, 64), Mse::new(noise(64, 64, 3)));
    let of = |s: &Settings| {
        let g = render_and_gradients(&mut Workspace::new(), &scene.splats(), &camera, s, &loss).unwrap();
        g.splats.iter().flat_map(|s| s.position).map(f64::from).collect::<Vec<_>>()
    };
    let (a, b) = (of(&Settings::default()), of(&Settings::exact()));
    let wrong: f64 = a.iter().zip(&b).map(|(a, b)| (a - b) * (a - b)).sum();
    let all: f64 = b.iter().map(|b| b * b).sum();
    assert!((wrong / all).sqrt() < 0.05, "{}", (wrong / all).sqrt());
}
/// Every place where the picture jumps or bends.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
enum Edge {
    AlphaCutoff,
    AlphaMax,
    Stop,
    DepthOrder,
    ColourAtZero,
    Slope,
    NearPlane,
    DimmingFloor,
}

/// With the largest relative error allowed, [`super::WORST`] and [`super::L2`] elsewhere being for smooth
/// scenes: here the picture has few pixels, so single elements weigh more.
const EDGES: [(Edge, f64); 8] = [
    (Edge::AlphaCutoff, 1e-3),
    (Edge::AlphaMax, 1e-3),
    (Edge::Stop, 1e-3),
    (Edge::DepthOrder, 1e-3),
    (Edge::ColourAtZero, 1e-3),
    (Edge::Slope, 1e-3),
    (Edge::NearPlane, 1e-3),
    (Edge::DimmingFloor, 1e-3),
];

/// Shorter than the way to any edge.
const SHORT: f64 = 1.0 / 65536.0;

/// A scene whose first Gaussian is a share `d` past the edge (above, behind, outside) or before it.
fn at_edge(edge: Edge, d: f64) -> (Scene, Camera, Settings) {
    let mut scene = Scene::random(3, 1, [0.35, 0.7], 31);
    scene.gaussians[0].position = [0.07, -0.11, 0.0];
    scene.gaussians[1].position = [-0.2, 0.13, 0.9];
    scene.gaussians[2].position = [0.3, 0.2, 1.7];
    scene.gaussians.iter_mut().for_each(|g| g.opacity = 0.8);
    scene.gaussians[0].opacity = if edge == Edge::AlphaCutoff { 0.4 } else { 0.95 };
    let mut camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 5, 4).unwrap();
    let mut settings = smooth();
    let factor = 1.0 + d;
    // Alpha of the first Gaussian at the third pixel of the second row, as the reference sees it.
    let alpha = |settings: &Settings| {
        let alone = Scene { gaussians: scene.gaussians[..1].to_vec(), rest: vec![0.0; 9], ..scene.clone() };
        1.0 - reference::render(&alone.splats(), &camera, settings).unwrap().transmittance[5 + 2]
    };
    match edge {
        Edge::AlphaCutoff => settings.alpha_cutoff = (alpha(&settings) * factor) as f32,
        Edge::AlphaMax => settings.alpha_max = (alpha(&settings) / factor) as f32,
        Edge::Stop => {
            settings.early_stop = true;
            settings.transmittance_stop = ((1.0 - alpha(&settings)) * factor) as f32;
        }
        Edge::DepthOrder => {
            let behind = camera.to_camera(scene.gaussians[1].position)[2];
            scene.gaussians[0].position[2] += (behind * factor - 4.0) as f32;
        }
        Edge::ColourAtZero => {
            let rest: Vec<f32> = scene.rest[..9].to_vec();
            let offset: [f64; 3] =
                std::array::from_fn(|k| f64::from(scene.gaussians[0].position[k]) - camera.centre()[k]);
            let length = offset.iter().map(|v| v * v).sum::<f64>().sqrt();
            let basis = crate::harmonics::basis(1, offset.map(|v| v / length));
            let bands: f64 = (0..3).map(|k| basis[k] * f64::from(rest[3 * k + 1])).sum();
            scene.gaussians[0].sh0[1] = ((-d - 0.5 - bands) / crate::harmonics::C0) as f32;
        }
        Edge::Slope => {
            let limit = crate::stage::project::slope_limits(&camera)[0][1];
            scene.gaussians[0].position[0] = (limit * factor * 4.0) as f32;
            scene.gaussians[0].scale = [1.5, 1.2, 1.7];
        }
        Edge::NearPlane => {
            let near = camera.to_camera(scene.gaussians[0].position)[2] * factor;
            camera = camera.with_near(near).unwrap();
        }
        Edge::DimmingFloor => {
            settings.antialiased = true;
            // On the axis √(det0 / det) = s² / (s² + p), so it is the floor at this s, pixels.
            let ratio = crate::stage::project::MIN_COMPENSATION / factor;
            let pixels = (settings.low_pass * ratio / (1.0 - ratio)).sqrt();
            let scale = (pixels * 4.0 / camera.intrinsics().fx) as f32;
            let shape = Gaussian { position: [0.0; 3], scale: [scale; 3], ..scene.gaussians[0] };
            // Alone, since beside others so dim a splat would count for nothing.
            scene.gaussians = vec![shape];
            scene.rest.truncate(9);
        }
    }
    (scene, camera, settings)
}

fn checked(edge: Edge, d: f64, loss: &dyn Loss, step: f64) -> Check {
    let (scene, camera, settings) = at_edge(edge, d);
    let got = render_and_gradients(&mut Workspace::new(), &scene.splats(), &camera, &settings, loss).unwrap();
    check::compare(&scene.splats(), &camera, &settings, loss, &got, step).unwrap()
}

/// Away from and near every edge, on both sides, all classes agree with differences that do not cross it.
#[test]
fn on_both_sides_of_every_edge_gradients_are_differences() {
    let losses: [Box<dyn Loss>; 3] = [
        Box::new(Linear(noise(5, 4, 3))),
        Box::new(Mse::new(noise(5, 4, 5))),
        Box::new(Distortion::new(noise(5, 4, 6))),
    ];
    for (edge, tolerance) in EDGES {
        for d in [0.05, 1e-3, -1e-3, -0.05] {
            for loss in &losses {
                let check = checked(edge, d, &**loss, SHORT);
                for class in &check.classes {
                    assert!(class.rough == 0, "{edge:?} {d}: crosses it: {class:?}");
                    assert!(class.worst < tolerance, "{edge:?} {d}: {class:?}\n{check}");
                }
            }
        }
    }
}

/// The two sides differ, so the suite is about the edge that it names, and a step across it is noticed.
#[test]
fn every_edge_is_there() {
    let loss = Linear(noise(5, 4, 3));
    for (edge, tolerance) in EDGES {
        let of = |d: f64| {
            let (scene, camera, settings) = at_edge(edge, d);
            let splats = scene.splats();
            let got =
                render_and_gradients(&mut Workspace::new(), &splats, &camera, &settings, &loss).unwrap();
            let finite = |g: &SplatGradient| g.position.iter().chain(&g.log_scale).all(|v| v.is_finite());
            assert!(got.splats.iter().all(finite), "{edge:?} {d}");
            got.splats[0]
        };
        let all = |g: &SplatGradient| -> Vec<f32> {
            g.position.iter().chain(&g.log_scale).chain(&g.sh0).chain([&g.opacity_logit]).copied().collect()
        };
        let (above, below, on) = (all(&of(1e-3)), all(&of(-1e-3)), all(&of(0.0)));
        let largest = above.iter().chain(&below).fold(0.0f32, |m, v| m.max(v.abs()));
        let apart = |a: &[f32], b: &[f32]| a.iter().zip(b).fold(0.0f32, |m, (a, b)| m.max((a - b).abs()));
        assert!(apart(&above, &below) > 0.01 * largest, "{edge:?}: both sides are alike");
        let nearer = apart(&on, &above).min(apart(&on, &below));
        assert!(nearer < 0.01 * largest, "{edge:?}: at the edge it is neither side: {nearer} of {largest}");
        let crossing = checked(edge, 1e-3, &loss, 1.0 / 16.0);
        let noticed = crossing.classes.iter().any(|c| c.rough > 0 || c.worst > tolerance);
        assert!(noticed, "{edge:?}: a step across it goes unnoticed\n{crossing}");
    }
}
