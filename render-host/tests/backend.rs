//! Backends: the graphics device shows what the CPU shows, and what is missing is named.
#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use render_host::{
    Differentiator, Gradients, Image, Settings, Splats,
    adjoint::{
        DensityStatistics,
        loss::{
            Mse,
            photograph::{Photograph, PhotographLoss, Weights},
        },
    },
    backend::{Backend, BackendError, DeviceChoice},
    counterfactual::{States, Variants},
    reference,
};

use support::{Scene, TestRng, camera};

/// Largest difference of a channel between backends, away from cut-offs.
const TOLERANCE: f64 = 1e-4;
/// Largest relative L2 distance of a field of gradients or statistics between backends.
const GRADIENT_TOLERANCE: f64 = 1e-4;

/// The graphics device; `None`, with a notice, where there is none. A build server must have one.
fn gpu() -> Option<Backend> {
    match Backend::open(DeviceChoice::Gpu) {
        Ok(backend) => Some(backend),
        Err(error) => {
            let excused = !Backend::HAS_GPU || std::env::var("CI").as_deref() != Ok("true");
            assert!(excused, "{error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    }
}

/// Pixels that differ by more than the tolerance although no splat is near a cut-off there.
fn differing(a: &Image, b: &Image, splats: &Splats, settings: &Settings) -> usize {
    let close = reference::render(splats, &camera(a.width(), a.height()), settings).unwrap().close;
    let pixels = a.rgb().chunks(3).zip(b.rgb().chunks(3)).zip(&close);
    let far = |(a, b): (&[f32], &[f32])| a.iter().zip(b).any(|(a, b)| f64::from((a - b).abs()) > TOLERANCE);
    pixels.filter(|(pair, close)| **close == 0 && far(*pair)).count()
}

#[test]
fn both_backends_show_the_same_frames() {
    let Some(gpu) = gpu() else { return };
    let settings = Settings::over([0.2, 0.4, 0.6]);
    let (mut on_cpu, mut on_gpu) = (Backend::Cpu.frames().unwrap(), gpu.frames().unwrap());
    // Scenes of other sizes follow each other in the same buffers.
    for (n, seed, size) in [(600, 1, [70, 50]), (1500, 2, [70, 50]), (40, 3, [31, 64])] {
        let scene = Scene::random(n, 1, 0.01, 0.3, seed);
        let camera = camera(size[0], size[1]);
        let a = on_cpu.render(&scene.splats(), &camera, &settings).unwrap().image.clone();
        let b = on_gpu.render(&scene.splats(), &camera, &settings).unwrap().image.clone();
        assert_eq!(differing(&a, &b, &scene.splats(), &settings), 0);
        let mut wrong = b.clone();
        wrong.rgb_mut().iter_mut().for_each(|v| *v += 2e-4);
        assert!(differing(&a, &wrong, &scene.splats(), &settings) > 0, "the comparison sees a difference");
    }
}

#[test]
fn both_backends_show_the_same_worlds() {
    let scene = Scene::random(500, 0, 0.01, 0.3, 5);
    let of: Vec<u32> = (0..500).map(|i| i % 24).collect();
    let variants = Variants::new(scene.splats(), &of, 24).unwrap();
    let mut r = TestRng(3);
    let mut states = States::new(24);
    (0..9).for_each(|_| states.push(|_| r.unit() < 0.7));
    let (camera, settings) = (camera(40, 33), Settings::default());
    for backend in [Some(Backend::Cpu), gpu()].into_iter().flatten() {
        let pictures = backend.render_worlds(&variants, &states, &camera, &settings).unwrap();
        assert_eq!(pictures.len(), 9);
        for (world, picture) in pictures.iter().enumerate() {
            let included = scene.gaussians.iter().zip(&of).filter(|(_, g)| states.has(world, **g as usize));
            let gaussians: Vec<_> = included.map(|(g, _)| *g).collect();
            let splats = Splats::plain(&gaussians);
            let alone = backend.frames().unwrap().render(&splats, &camera, &settings).unwrap().image.clone();
            assert!(alone == *picture, "{}: world {world}", backend.name());
        }
        assert!(backend.render_worlds(&variants, &States::new(24), &camera, &settings).unwrap().is_empty());
        let error = backend.render_worlds(&variants, &States::full(5), &camera, &settings).unwrap_err();
        assert!(matches!(error, BackendError::Worlds(_)), "{error}");
    }
}

#[test]
fn what_is_chosen_is_what_is_opened() {
    assert_eq!(Backend::open(DeviceChoice::Cpu).unwrap().name(), "cpu");
    let auto = Backend::open(DeviceChoice::Auto).unwrap();
    if let Some(gpu) = gpu() {
        assert_ne!(gpu.name(), "cpu");
        // Software is taken only when it is asked for.
        let software = gpu.name().contains("llvmpipe");
        assert_eq!(auto.name() == "cpu", software);
    } else if !Backend::HAS_GPU {
        assert_eq!(Backend::open(DeviceChoice::Gpu).unwrap_err(), BackendError::NotBuilt);
        assert_eq!(auto.name(), "cpu");
    }
}

/// A photograph of noise, partly transparent.
fn photograph(width: u32, height: u32, seed: u64) -> Photograph {
    let mut r = TestRng(seed);
    let pixel = |_| {
        let alpha = if r.unit() < 0.3 { 0.0 } else { 255.0 * r.unit() };
        let [red, green, blue] = [0; 3].map(|_| (alpha * r.unit()) as u8);
        [red, green, blue, alpha as u8]
    };
    Photograph::new(width, height, (0..width * height).flat_map(pixel).collect()).unwrap()
}

/// Gradients and statistics field by field, by name.
fn fields(gradients: &Gradients, statistics: &[DensityStatistics]) -> Vec<(&'static str, Vec<f64>)> {
    let splats = &gradients.splats;
    let wide = |values: Vec<f32>| values.into_iter().map(f64::from).collect();
    let pose = gradients.pose.translation.into_iter().chain(gradients.pose.rotation);
    vec![
        ("position", wide(splats.iter().flat_map(|s| s.position).collect())),
        ("log scale", wide(splats.iter().flat_map(|s| s.log_scale).collect())),
        ("rotation", wide(splats.iter().flat_map(|s| s.rotation).collect())),
        ("opacity", wide(splats.iter().map(|s| s.opacity_logit).collect())),
        ("band 0", wide(splats.iter().flat_map(|s| s.sh0).collect())),
        ("higher bands", wide(gradients.sh_rest.clone())),
        ("centre", wide(splats.iter().flat_map(|s| s.image_mean).collect())),
        ("background", gradients.background.to_vec()),
        ("pose", pose.collect()),
        ("pull", wide(statistics.iter().map(|s| s.gradient).collect())),
        ("weight", wide(statistics.iter().map(|s| s.weight).collect())),
        ("pixels", statistics.iter().map(|s| f64::from(s.pixels)).collect()),
    ]
}

/// Relative L2 distance; infinite where something is not a number.
fn distance(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    let square = |sum: f64, v: f64| sum + v * v;
    let apart = a.iter().zip(b).map(|(a, b)| a - b).fold(0.0, square);
    let all = b.iter().copied().fold(0.0, square);
    let found = (apart / all.max(1e-300)).sqrt();
    if found.is_nan() { f64::INFINITY } else { found }
}

#[test]
fn both_backends_give_the_same_gradients_and_statistics() {
    let Some(gpu) = gpu() else { return };
    let (mut on_cpu, mut on_gpu) = (Differentiator::default(), gpu.differentiator().unwrap());
    let weights = Weights { absolute: 0.8, squared: 0.0, structure: 0.2 };
    // Scenes and pictures of other sizes follow each other in the same buffers.
    let cases = [
        (700, 1, [70, 50]),
        (2500, 0, [130, 90]),
        (40, 3, [31, 64]),
        (900, 2, [9, 40]),
        (5, 1, [1, 1]),
        (700, 1, [70, 50]),
    ];
    for (n, degree, [width, height]) in cases {
        for background in [[1.0; 3], [0.0; 3]] {
            let scene = Scene::random(n, degree, 0.01, 0.2, 7 + n as u64);
            let (splats, camera) = (scene.splats(), camera(width, height));
            let photograph = photograph(width, height, 3);
            let loss = PhotographLoss::new(&photograph, background, weights);
            let settings = Settings::over(background);
            let of = |by: &mut Differentiator| {
                let (mut gradients, mut statistics) = (Gradients::default(), Vec::new());
                let counted = Some(&mut statistics);
                by.differentiate(&splats, &camera, &settings, &loss, &mut gradients, counted).unwrap();
                (gradients, statistics)
            };
            let (a, statistics_a) = of(&mut on_cpu);
            let (b, statistics_b) = of(&mut on_gpu);
            let name = format!("{n} Gaussians, {width} x {height} over {}", background[0]);
            assert_eq!(differing(&a.rendered.image, &b.rendered.image, &splats, &settings), 0, "{name}");
            assert!((a.loss - b.loss).abs() < 1e-6 * a.loss, "{name}: {} {}", a.loss, b.loss);
            let (expected, found) = (fields(&a, &statistics_a), fields(&b, &statistics_b));
            for ((field, expected), (_, found)) in expected.iter().zip(&found) {
                let apart = distance(found, expected);
                println!("{name}: {field} {apart:.1e}");
                assert!(apart < GRADIENT_TOLERANCE, "{name}: {field} {apart}");
            }
            assert_eq!(a.rendered.counters.drawn, b.rendered.counters.drawn, "{name}");
            let through = |g: &Gradients| g.rendered.transmittance.iter().map(|&t| f64::from(t)).collect();
            let [t, u]: [Vec<f64>; 2] = [through(&a), through(&b)];
            assert!(distance(&u, &t) < GRADIENT_TOLERANCE, "{name}: transmittance");
            assert!(of(&mut on_gpu) == (b, statistics_b), "{name}: the same bits again");
        }
    }
}

/// The comparison sees a scene that is a little off, in every field.
#[test]
fn a_wrong_gradient_is_seen() {
    let (scene, camera) = (Scene::random(300, 1, 0.02, 0.2, 5), camera(60, 45));
    let loss = Mse::new(Image::filled(60, 45, [0.4, 0.6, 0.2]).unwrap());
    let of = |scene: &Scene| {
        let (mut gradients, mut statistics) = (Gradients::default(), Vec::new());
        let (splats, settings) = (scene.splats(), Settings::over([0.3; 3]));
        let counted = Some(&mut statistics);
        let mut cpu = Differentiator::default();
        cpu.differentiate(&splats, &camera, &settings, &loss, &mut gradients, counted).unwrap();
        fields(&gradients, &statistics)
    };
    let right = of(&scene);
    let mut off = scene;
    off.gaussians.iter_mut().for_each(|g| g.opacity *= 0.99);
    for ((field, expected), (_, found)) in right.iter().zip(&of(&off)) {
        let apart = distance(found, expected);
        assert!(apart > 3.0 * GRADIENT_TOLERANCE, "{field}: {apart}");
        let mut one = expected.clone();
        let largest = one.iter_mut().max_by(|a, b| a.abs().total_cmp(&b.abs())).unwrap();
        *largest *= 1.05;
        assert!(distance(&one, expected) > GRADIENT_TOLERANCE, "{field}: one number by a twentieth");
    }
}

#[test]
fn gradients_without_statistics_are_the_same_and_what_does_not_fit_is_named() {
    let scene = Scene::random(200, 1, 0.02, 0.2, 5);
    let (splats, camera, settings) = (scene.splats(), camera(40, 30), Settings::over([1.0; 3]));
    let loss = Mse::new(Image::filled(40, 30, [0.4, 0.6, 0.2]).unwrap());
    for backend in [Some(Backend::Cpu), gpu()].into_iter().flatten() {
        let mut by = backend.differentiator().unwrap();
        let (mut with, mut without, mut statistics) = Default::default();
        by.differentiate(&splats, &camera, &settings, &loss, &mut with, Some(&mut statistics)).unwrap();
        by.differentiate(&splats, &camera, &settings, &loss, &mut without, None).unwrap();
        assert!(with == without && statistics.len() == 200, "{}", backend.name());

        let small = Mse::new(Image::filled(40, 31, [0.0; 3]).unwrap());
        let refused = by.differentiate(&splats, &camera, &settings, &small, &mut with, None).unwrap_err();
        assert!(refused.to_string().contains("loss: "), "{}: {refused}", backend.name());
        let wrong = Settings { alpha_max: 2.0, ..settings.clone() };
        let refused = by.differentiate(&splats, &camera, &wrong, &loss, &mut with, None).unwrap_err();
        assert!(refused.to_string().contains("alpha_max is 2"), "{}: {refused}", backend.name());

        let nothing = Splats::plain(&[]);
        by.differentiate(&nothing, &camera, &settings, &loss, &mut with, Some(&mut statistics)).unwrap();
        assert!(with.splats.is_empty() && statistics.is_empty(), "{}", backend.name());
        assert_eq!(with.rendered.image.pixel(3, 4), Some([1.0; 3]), "{}", backend.name());
    }
}
