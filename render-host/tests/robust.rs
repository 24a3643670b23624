//! Whatever arrives, there is a finite picture, in bounded time, without a panic.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use codec_core::Gaussian;
use proptest::prelude::*;
use render_host::{Camera, Rendered, Settings, Splats, reference, render};

use support::{Scene, camera};

fn finite(r: &Rendered) -> bool {
    r.image.rgb().iter().all(|v| v.is_finite())
        && r.transmittance.iter().all(|t| (0.0..=1.0).contains(t))
        && r.counters.drawn + r.counters.skipped() == r.counters.gaussians
}

#[test]
fn nothing_to_draw_is_the_background() {
    let settings = Settings::over([0.25, 0.5, 0.75]);
    for (w, h) in [(1, 1), (17, 16), (8192, 3), (3, 8192)] {
        let out = render(&Splats::plain(&[]), &camera(w, h), &settings).unwrap();
        assert!(out.image.rgb().chunks(3).all(|p| p == [0.25, 0.5, 0.75]));
        assert!(out.transmittance.iter().all(|&t| t == 1.0));
        assert_eq!(out.counters.pixels, u64::from(w) * u64::from(h));
    }
}

#[test]
fn very_wide_and_very_small_images_match_the_reference() {
    let scene = Scene::random(300, 0, 0.01, 0.3, 11);
    for (w, h) in [(1, 1), (8192, 20), (20, 8192), (16, 16), (15, 17)] {
        let out = render(&scene.splats(), &camera(w, h), &Settings::exact()).unwrap();
        let slow = reference::render(&scene.splats(), &camera(w, h), &Settings::exact()).unwrap();
        let d = slow.difference(out.image.rgb()).unwrap();
        assert!(finite(&out) && d.max_clear < 1e-4, "{w} x {h}: {d:?}");
    }
}

/// Values that break arithmetic, by kind.
const POISON: [f32; 16] = [
    f32::NAN,
    f32::INFINITY,
    f32::NEG_INFINITY,
    f32::MAX,
    f32::MIN,
    f32::MIN_POSITIVE,
    1e-45,
    -0.0,
    0.0,
    1e-12,
    1e6,
    -1e6,
    1e30,
    1.0,
    -1.0,
    0.5,
];

fn poisoned() -> impl Strategy<Value = f32> {
    prop_oneof![4 => -2.0..2.0f32, 1 => (0..POISON.len()).prop_map(|i| POISON[i])]
}

prop_compose! {
    fn gaussian()(v in proptest::collection::vec(poisoned(), 14)) -> Gaussian {
        Gaussian {
            position: [v[0], v[1], v[2]], scale: [v[3].abs(), v[4].abs(), v[5]],
            rotation: [v[6], v[7], v[8], v[9]], opacity: v[10], sh0: [v[11], v[12], v[13]],
        }
    }
}

proptest! {
    #[test]
    fn poison_gives_a_finite_picture(
        gaussians in proptest::collection::vec(gaussian(), 0..40),
        low_pass in prop_oneof![Just(0.3f64), Just(0.0)],
        cutoff in prop_oneof![Just(1.0f32 / 255.0), Just(0.0)],
        antialiased in any::<bool>(), early_stop in any::<bool>(), alpha_max in 0.5..=1.0f32,
    ) {
        let cut = Settings { alpha_cutoff: cutoff, alpha_max, ..Settings::default() };
        let settings = Settings { low_pass, antialiased, early_stop, ..cut };
        let out = render(&Splats::plain(&gaussians), &camera(50, 40), &settings).unwrap();
        prop_assert!(finite(&out), "{:?}", out.counters);
    }

    /// Skipped Gaussians among good ones change nothing: the good ones still match the reference.
    #[test]
    fn poison_stays_with_the_poisoned(
        seed in any::<u64>(), bad in proptest::collection::vec((0usize..200, 0usize..14, 0usize..3), 0..50),
    ) {
        let mut scene = Scene::random(200, 0, 0.02, 0.2, seed);
        for (index, field, poison) in bad {
            let g = &mut scene.gaussians[index];
            let value = POISON[poison];
            match field {
                0..3 => g.position[field] = value,
                3..6 => g.scale[field - 3] = value,
                6..10 => g.rotation[field - 6] = value,
                10 => g.opacity = value,
                _ => g.sh0[field - 11] = value,
            }
        }
        let good: Vec<Gaussian> = scene.gaussians.iter().copied().filter(|g| {
            values(g).iter().all(|v| v.is_finite())
        }).collect();
        let settings = Settings::default();
        let a = render(&scene.splats(), &camera(64, 48), &settings).unwrap();
        let b = render(&Splats::plain(&good), &camera(64, 48), &settings).unwrap();
        prop_assert_eq!(a.image, b.image);
    }
}

fn values(g: &Gaussian) -> [f32; 14] {
    let mut v = [0.0; 14];
    v[..3].copy_from_slice(&g.position);
    v[3..6].copy_from_slice(&g.scale);
    v[6..10].copy_from_slice(&g.rotation);
    v[10] = g.opacity;
    v[11..].copy_from_slice(&g.sh0);
    v
}

#[test]
fn scales_and_coordinates_of_every_size() {
    for exponent in -12..=6 {
        let scale = 10f32.powi(exponent);
        let mut scene = Scene::random(200, 0, scale, scale, 4);
        let out = render(&scene.splats(), &camera(80, 60), &Settings::default()).unwrap();
        assert!(finite(&out), "scale {scale}");
        // A few specks are outside the frame or between pixels; none is lost to arithmetic.
        assert!(
            out.counters.drawn >= 190 && out.counters.degenerate == 0,
            "scale {scale}: {:?}",
            out.counters
        );
        // The same picture a million units away, as far as f32 coordinates can say.
        let offset = 1e6f32;
        scene.gaussians.iter_mut().for_each(|g| g.position = g.position.map(|p| offset + p));
        let o = f64::from(offset);
        let far = Camera::look_at([o + 3.0, o, o], [o; 3], [0.0, 0.0, 1.0], 0.9, 80, 60).unwrap();
        let out = render(&scene.splats(), &far, &Settings::default()).unwrap();
        let slow = reference::render(&scene.splats(), &far, &Settings::default()).unwrap();
        let d = slow.difference(out.image.rgb()).unwrap();
        assert!(finite(&out) && d.max_clear <= 1e-4, "scale {scale} far away: {d:?}");
    }
}

#[test]
fn many_splats_over_the_whole_image_end_in_bounded_time() {
    // 3000 splats over 4096 tiles: early stop ends each tile after a few.
    let scene = Scene::random(3000, 0, 1e5, 1e6, 9);
    let out = render(&scene.splats(), &camera(1024, 1024), &Settings::default()).unwrap();
    assert!(finite(&out));
    assert_eq!(out.counters.pixels_stopped, 1024 * 1024);
    assert!(out.counters.intersections < 3000 * 4096 / 20, "{:?}", out.counters);
}
