//! Backends: the graphics device shows what the CPU shows, and what is missing is named.
#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use render_host::{
    Image, Settings, Splats,
    backend::{Backend, BackendError, DeviceChoice},
    counterfactual::{States, Variants},
    reference,
};

use support::{Numbers, Scene, camera};

/// Largest difference of a channel between backends, away from cut-offs.
const TOLERANCE: f64 = 1e-4;

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
    let mut r = Numbers(3);
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
