//! Same bits: for any number of threads, serial or parallel, alone or in a batch, with or without skips,
//! in a used or a fresh renderer.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use codec_core::Gaussian;
use proptest::prelude::*;
use render_host::{Rendered, Renderer, Settings, Splats, render, render_many, stage::TileSide};

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

type Switch = fn(&mut Settings);

/// Every skip that promises not to show, and how to switch it off; `cull_entries` also how to switch it on;
/// and tiles of every other side.
const SWITCHES: [(&str, Switch); 12] = [
    ("cull_frustum", |s| s.cull_frustum = false),
    ("cull_sub_pixel", |s| s.cull_sub_pixel = false),
    ("opacity_bounds", |s| s.opacity_bounds = false),
    ("exact_tiles", |s| s.exact_tiles = false),
    ("cull_entries", |s| s.cull_entries = true),
    ("skip_empty_tiles", |s| s.skip_empty_tiles = false),
    ("row_reach", |s| s.row_reach = false),
    ("sh_by_need", |s| s.sh_by_need = false),
    ("all", |s| *s = s.clone().without_skips()),
    ("tiles of 8", |s| s.tile = TileSide::Eight),
    ("tiles of 32", |s| s.tile = TileSide::ThirtyTwo),
    ("all, tiles of 8", |s| *s = Settings { tile: TileSide::Eight, ..s.clone().without_skips() }),
];

/// A scene of which much is beside, behind and very near the camera, with specks between pixel centres,
/// faint ones, and Gaussians that hold fewer bands than the scene does.
fn untidy(n: usize, degree: u8, smallest: f32, largest: f32, seed: u64) -> Scene {
    let mut scene = Scene::random(n, degree, smallest, largest, seed);
    let each = scene.degree.rest_len();
    for (i, g) in scene.gaussians.iter_mut().enumerate() {
        g.position = g.position.map(|p| 4.0 * p);
        if i % 3 == 0 {
            g.opacity *= 0.02;
        }
        let used = [0, 9, 24, 45][i % 4];
        scene.rest[i * each..(i + 1) * each].iter_mut().skip(used).for_each(|v| *v = 0.0);
    }
    scene
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(32))]

    #[test]
    fn skips_that_promise_nothing_change_nothing(
        seed in any::<u64>(), n in 0usize..1500, largest in 0.01..3.0f32, degree in 0u8..4,
        cutoff in prop_oneof![Just(1.0f32 / 255.0), Just(0.0)], antialiased in any::<bool>(),
        early_stop in any::<bool>(), background in prop_oneof![Just([-0.0f32; 3]), Just([0.2, 0.4, 0.6])],
    ) {
        let scene = untidy(n, degree, 0.001, largest, seed);
        let camera = camera(97, 66);
        let bands = scene.splats().used_bands();
        let splats = scene.splats().with_bands(&bands).unwrap();
        let cut = Settings { alpha_cutoff: cutoff, ..Settings::default() };
        let all = Settings { antialiased, early_stop, background, ..cut };
        let a = render(&splats, &camera, &all).unwrap();
        for (name, switch) in SWITCHES {
            let mut other = all.clone();
            switch(&mut other);
            prop_assert_ne!(&other, &all, "{}", name);
            let b = render(&splats, &camera, &other).unwrap();
            prop_assert_eq!(bits(&a), bits(&b), "{}", name);
            prop_assert_eq!(b.counters.skipped() + b.counters.drawn, n as u64);
        }
    }

    /// A Gaussian that is absent leaves no trace, whatever else its slot holds.
    #[test]
    fn absent_gaussians_leave_no_trace(
        seed in any::<u64>(), keep in proptest::collection::vec(any::<bool>(), 300),
    ) {
        let scene = Scene::random(300, 0, 0.02, 0.2, seed);
        let camera = camera(64, 64);
        let absent = Gaussian { opacity: 0.0, scale: [f32::NAN; 3], ..Gaussian::ABSENT };
        let chosen = || scene.gaussians.iter().zip(&keep);
        let blanked: Vec<_> = chosen().map(|(g, k)| if *k { *g } else { absent }).collect();
        let removed: Vec<_> = chosen().filter(|(_, k)| **k).map(|(g, _)| *g).collect();
        let settings = Settings::default();
        let a = render(&Splats::plain(&blanked), &camera, &settings).unwrap();
        let b = render(&Splats::plain(&removed), &camera, &settings).unwrap();
        prop_assert_eq!(bits(&a), bits(&b));
        prop_assert_eq!(a.counters.absent, 300 - removed.len() as u64);
    }
}

/// Each switch leaves out work, and its counter says so.
#[test]
fn every_skip_is_counted() {
    let mut scene = untidy(4000, 3, 0.0005, 0.2, 11);
    // A tail of splats far apart, so that some tiles stay empty.
    scene.gaussians.iter_mut().for_each(|g| g.position[2] = g.position[2].abs());
    let camera = camera(400, 300);
    let bands = scene.splats().used_bands();
    let splats = scene.splats().with_bands(&bands).unwrap();
    let on = Settings::default();
    let counts = |settings: &Settings| render(&splats, &camera, settings).unwrap().counters;
    let a = counts(&on);
    let b = counts(&Settings { cull_frustum: false, ..on.clone() });
    assert!(a.culled > 0 && a.culled <= a.outside && b.culled == 0 && b.drawn == a.drawn, "{a:?} {b:?}");
    let b = counts(&Settings { cull_sub_pixel: false, ..on.clone() });
    assert!(a.sub_pixel > 0 && b.sub_pixel == 0 && b.drawn > a.drawn, "{a:?} {b:?}");
    let b = counts(&Settings { opacity_bounds: false, ..on.clone() });
    assert!(b.boxed > a.boxed && b.intersections > a.intersections, "{a:?} {b:?}");
    let b = counts(&Settings { exact_tiles: false, ..on.clone() });
    assert!(a.intersections < a.boxed && b.intersections == b.boxed && a.boxed == b.boxed, "{a:?} {b:?}");
    assert!(b.entries_idle > a.entries_idle, "{a:?} {b:?}");
    let b = counts(&Settings { cull_entries: true, ..on.clone() });
    assert!(b.intersections < a.intersections && b.boxed == a.boxed, "{a:?} {b:?}");
    assert!(a.tiles_touched < a.tiles);
    let b = counts(&Settings { row_reach: false, ..on.clone() });
    assert!(a.rows_unreached > 0 && b.rows_unreached == 0 && a.rows == b.rows, "{a:?} {b:?}");
    let b = counts(&Settings { sh_by_need: false, ..on.clone() });
    assert!(a.sh_coefficients == 15 * a.drawn && a.sh_skipped > a.sh_coefficients / 3 && b.sh_skipped == 0);
    let dense = Scene::random(20_000, 0, 0.01, 0.1, 4);
    let a = render(&dense.splats(), &camera, &on).unwrap().counters;
    let b = render(&dense.splats(), &camera, &Settings { early_stop: false, ..on }).unwrap().counters;
    assert!(a.pixels_stopped > 0 && a.entries_unread > 0 && a.rows_finished > 0, "{a:?}");
    assert_eq!((b.pixels_stopped, b.entries_unread, b.rows_finished), (0, 0, 0));
}

/// What the comparison of bits in these tests is for: a tolerance, which does show.
#[test]
fn the_comparison_sees_an_early_stop() {
    let scene = Scene::random(20_000, 0, 0.01, 0.1, 4);
    let camera = camera(160, 120);
    let stop = render(&scene.splats(), &camera, &Settings::default()).unwrap();
    let on = Settings { early_stop: false, ..Settings::default() };
    assert_ne!(bits(&stop), bits(&render(&scene.splats(), &camera, &on).unwrap()));
}

/// Degrees that claim less than a Gaussian holds do change the picture: the caller's word is taken.
#[test]
fn bands_are_believed() {
    let scene = Scene::random(50, 2, 0.05, 0.3, 7);
    let (camera, none) = (camera(64, 64), vec![0; 50]);
    let lying = render(&scene.splats().with_bands(&none).unwrap(), &camera, &Settings::default()).unwrap();
    assert_ne!(bits(&lying), bits(&render(&scene.splats(), &camera, &Settings::default()).unwrap()));
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

/// Where lists are long, they end at another splat with every side of tiles.
#[test]
fn tile_sides_do_not_show_where_many_splats_overlap() {
    let mut scene = Scene::random(9000, 0, 0.3, 3.0, 5);
    for (i, g) in scene.gaussians.iter_mut().enumerate() {
        g.opacity = 0.01 + 0.2 * f32::from(u8::from(i % 90 == 0));
    }
    let (splats, camera) = (scene.splats(), camera(203, 517));
    let pictures = TileSide::ALL.map(|tile| {
        let settings = Settings { tile, ..Settings::default() };
        render(&splats, &camera, &settings).unwrap()
    });
    let usual = pictures[1].counters;
    assert!(usual.pixels_stopped > 0 && 2 * usual.intersections < usual.boxed, "{usual:?}");
    for other in [&pictures[0], &pictures[2]] {
        assert_eq!(bits(other), bits(&pictures[1]));
        assert_eq!(other.counters.pixels_stopped, usual.pixels_stopped);
        assert_ne!(other.counters.intersections, usual.intersections);
    }
}
