//! Same bits: for any number of threads, serial or parallel, alone or in a batch, with or without skips,
//! in a used or a fresh renderer.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use codec_core::Gaussian;
use proptest::prelude::*;
use render_host::{Rendered, Renderer, Settings, Splats, render, render_many};
use support::{Scene, camera};

fn bits(r: &Rendered) -> Vec<u32> {
    r.image.rgb().iter().chain(&r.transmittance).map(|v| v.to_bits()).collect()
}

#[test]
fn threads_do_not_show() {
    let scene = Scene::random(20_000, 2, 0.004, 0.06, 1);
    let camera = camera(333, 257);
    let serial = Settings { parallel: false, ..Settings::default() };
    let expected = render(&scene.splats(), &camera, &serial).unwrap();
    assert!(expected.counters.pixels_stopped > 0, "{:?}", expected.counters);
    for threads in [1, 2, 3, 7] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let got = pool.install(|| render(&scene.splats(), &camera, &Settings::default()).unwrap());
        assert_eq!(bits(&got), bits(&expected), "{threads} threads");
        assert_eq!(got.counters, expected.counters);
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn skips_that_promise_nothing_change_nothing(
        seed in any::<u64>(), n in 0usize..1500, largest in 0.01..3.0f32,
        cutoff in prop_oneof![Just(1.0f32 / 255.0), Just(0.0)], antialiased in any::<bool>(),
    ) {
        // Positions up to 4 put many splats beside, behind and very near the camera.
        let mut scene = Scene::random(n, 0, 0.001, largest, seed);
        scene.gaussians.iter_mut().for_each(|g| g.position = g.position.map(|p| 4.0 * p));
        let camera = camera(97, 66);
        let all = Settings { alpha_cutoff: cutoff, antialiased, ..Settings::default() };
        let none = Settings { cull_frustum: false, exact_tiles: false, ..all.clone() };
        let (a, b) = (render(&scene.splats(), &camera, &all).unwrap(), render(&scene.splats(), &camera, &none).unwrap());
        prop_assert_eq!(bits(&a), bits(&b));
        prop_assert!(a.counters.intersections <= b.counters.intersections);
        prop_assert_eq!(a.counters.skipped() + a.counters.drawn, n as u64);
    }

    /// A Gaussian that is absent leaves no trace, whatever else its slot holds.
    #[test]
    fn absent_gaussians_leave_no_trace(seed in any::<u64>(), keep in proptest::collection::vec(any::<bool>(), 300)) {
        let scene = Scene::random(300, 0, 0.02, 0.2, seed);
        let camera = camera(64, 64);
        let absent = Gaussian { opacity: 0.0, scale: [f32::NAN; 3], ..Gaussian::ABSENT };
        let blanked: Vec<_> = scene.gaussians.iter().zip(&keep).map(|(g, k)| if *k { *g } else { absent }).collect();
        let removed: Vec<_> = scene.gaussians.iter().zip(&keep).filter(|(_, k)| **k).map(|(g, _)| *g).collect();
        let settings = Settings::default();
        let a = render(&Splats::plain(&blanked), &camera, &settings).unwrap();
        let b = render(&Splats::plain(&removed), &camera, &settings).unwrap();
        prop_assert_eq!(bits(&a), bits(&b));
        prop_assert_eq!(a.counters.absent, 300 - removed.len() as u64);
    }
}

#[test]
fn a_batch_equals_its_worlds_alone() {
    let scene = Scene::random(3000, 1, 0.01, 0.1, 5);
    let camera = camera(120, 90);
    let worlds: Vec<Vec<Gaussian>> = (0..9)
        .map(|w| {
            let state = |(i, g): (usize, &Gaussian)| if i % 9 == w { Gaussian::ABSENT } else { *g };
            scene.gaussians.iter().enumerate().map(state).collect()
        })
        .collect();
    let splats: Vec<Splats> =
        worlds.iter().map(|g| Splats::new(g, &scene.rest, scene.degree).unwrap()).collect();
    for parallel in [true, false] {
        let settings = Settings { parallel, ..Settings::default() };
        for count in [0, 1, 9] {
            let many = render_many(&splats[..count], &camera, &settings).unwrap();
            assert_eq!(many.len(), count);
            for (world, got) in splats.iter().zip(&many) {
                assert_eq!(got, &render(world, &camera, &settings).unwrap());
            }
        }
    }
    assert_ne!(
        render(&splats[0], &camera, &Settings::default()).unwrap(),
        render(&splats[1], &camera, &Settings::default()).unwrap(),
        "the worlds differ, or this test says nothing"
    );
}

#[test]
fn a_used_renderer_gives_what_a_fresh_one_gives() {
    let (large, small) = (Scene::random(5000, 0, 0.01, 0.2, 1), Scene::random(40, 3, 0.05, 0.3, 2));
    let settings = Settings::over([0.2, 0.4, 0.6]);
    let mut renderer = Renderer::new();
    let mut out = Rendered::default();
    for (scene, width, height) in [(&large, 200, 100), (&small, 33, 77), (&large, 64, 64), (&small, 200, 100)]
    {
        let camera = camera(width, height);
        renderer.render_into(&scene.splats(), &camera, &settings, &mut out).unwrap();
        assert_eq!(out, render(&scene.splats(), &camera, &settings).unwrap());
    }
}
