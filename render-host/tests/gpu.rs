//! The wgpu backend on whatever adapter there is: judged by the f64 reference, by the CPU backend stage by
//! stage, and by itself for what must be the same bit for bit.
#![cfg(feature = "gpu")]
#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

#[path = "gpu/stages.rs"]
mod stages;
mod support;

use std::sync::{Mutex, MutexGuard, OnceLock};

use codec_core::Gaussian;
use proptest::prelude::*;
use render_host::{
    Camera, Rendered, Settings, Splats,
    counterfactual::States,
    gpu::{Device, DeviceOptions, Executor, GpuError, Presence, Renderer, Scene as OnDevice, wgpu},
    reference, render,
};

use support::{Scene, TestRng, camera};

/// The renderer that all tests share, with run-time checks in every shader; what was drawn before must not
/// matter. Without an adapter a test is skipped with a notice, and fails in CI.
fn renderer() -> Option<MutexGuard<'static, Renderer>> {
    static SHARED: OnceLock<Option<Mutex<Renderer>>> = OnceLock::new();
    let options = DeviceOptions { checked: true, ..DeviceOptions::from_env() };
    let shared = SHARED.get_or_init(|| match Device::open(&options) {
        Ok(device) => Some(Mutex::new(Renderer::new(&Executor::new(&device)).unwrap())),
        Err(error) => {
            assert!(std::env::var("CI").as_deref() != Ok("true"), "{error}");
            eprintln!("SKIPPED: {error}");
            None
        }
    });
    // A test that failed while it held the renderer left it usable.
    shared.as_ref().map(|r| r.lock().unwrap_or_else(std::sync::PoisonError::into_inner))
}

fn bits(r: &Rendered) -> Vec<u32> {
    r.image.rgb().iter().chain(&r.transmittance).map(|v| v.to_bits()).collect()
}

fn finite(r: &Rendered) -> bool {
    r.image.rgb().iter().all(|v| v.is_finite())
        && r.transmittance.iter().all(|t| (0.0..=1.0).contains(t))
        && r.counters.drawn + r.counters.skipped() == r.counters.gaussians
}

/// Compares a picture with the f64 reference: no pixel away from a threshold may be off by 1e-4.
fn compare(got: &Rendered, splats: &Splats, camera: &Camera, settings: &Settings) -> reference::Difference {
    compare_with(got, splats, camera, settings, 0)
}

/// As [`compare`], for long needles. Their alphas are good to 1e-4 only (the factor is f32), so that a few
/// more decisions are close to the cut-off than the reference marks: one pixel in a thousand may be off by
/// one.
fn compare_needles(got: &Rendered, splats: &Splats, camera: &Camera, settings: &Settings) {
    let excused = if settings.alpha_cutoff > 0.0 { 1 + got.transmittance.len() / 1000 } else { 0 };
    compare_with(got, splats, camera, settings, excused);
}

fn compare_with(
    got: &Rendered,
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    excused: usize,
) -> reference::Difference {
    let exact = reference::render(splats, camera, settings).unwrap();
    let d = exact.difference(got.image.rgb()).unwrap();
    let colour = 0.5 + 0.283 * 1.7 + 0.3 * 15.0;
    let (pixels, cutoff) = (got.transmittance.len(), f64::from(settings.alpha_cutoff));
    let off = |k: &usize| (exact.rgb[*k] - f64::from(got.image.rgb()[*k])).abs() > 1e-4;
    let far = (0..pixels).filter(|p| exact.close[*p] == 0 && (3 * p..3 * p + 3).any(|k| off(&k))).count();
    assert!(far <= excused, "{far} pixels are off: {d:?}");
    assert!(d.max_clear.max(d.max_close) <= 1e-4 + 2.0 * cutoff * colour, "{d:?}");
    assert!(d.close_pixels <= 8 + pixels / 100, "too many excused: {d:?}");
    assert!(d.psnr_db >= 90.0, "{d:?}");
    for (a, b) in exact.transmittance.iter().zip(&got.transmittance) {
        assert!((a - f64::from(*b)).abs() <= cutoff + 1e-4);
    }
    d
}

#[test]
#[should_panic(expected = "1 pixels are off")]
fn one_wrong_pixel_is_seen() {
    let (scene, camera, settings) = (Scene::random(40, 0, 0.02, 0.3, 5), camera(40, 30), Settings::default());
    let mut got = render(&scene.splats(), &camera, &settings).unwrap();
    compare(&got, &scene.splats(), &camera, &settings);
    let close = reference::render(&scene.splats(), &camera, &settings).unwrap().close;
    let clear = close.iter().position(|&c| c == 0).unwrap();
    got.image.rgb_mut()[3 * clear] += 2e-4;
    compare(&got, &scene.splats(), &camera, &settings);
}

fn settings() -> impl Strategy<Value = Settings> {
    let cutoff = prop_oneof![Just(1.0 / 255.0), Just(0.0), Just(1e-3)];
    let stop = prop_oneof![Just(1e-4), Just(0.0), Just(1e-6)];
    (cutoff, stop, any::<[bool; 4]>(), 0.0..1.0f32, 0u8..4).prop_map(
        |(alpha_cutoff, transmittance_stop, [antialiased, early_stop, cull, exact], grey, max_sh_degree)| {
            Settings {
                background: [grey, 0.5, 1.0 - grey],
                alpha_cutoff,
                transmittance_stop,
                antialiased,
                early_stop,
                cull_frustum: cull,
                exact_tiles: exact,
                max_sh_degree,
                ..Settings::default()
            }
        },
    )
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    #[test]
    fn random_scenes_match_the_reference(
        seed in any::<u64>(), n in 0usize..1500, degree in 0u8..4,
        width in 1u32..120, height in 1u32..90, largest in 0.02..0.5f32, settings in settings(),
    ) {
        let Some(mut renderer) = renderer() else { return Ok(()) };
        let scene = Scene::random(n, degree, 0.003, largest, seed);
        let camera = camera(width, height);
        let got = renderer.render_splats(&scene.splats(), &camera, &settings).unwrap();
        compare(&got, &scene.splats(), &camera, &settings);
    }

    /// Needles 10⁵ times as long as wide, at every angle.
    #[test]
    fn needles_match_the_reference(seed in any::<u64>()) {
        let Some(mut renderer) = renderer() else { return Ok(()) };
        let mut scene = Scene::random(200, 0, 1e-4, 1e-4, seed);
        scene.gaussians.iter_mut().for_each(|g| g.scale[0] = 10.0);
        let camera = camera(100, 100);
        for settings in [Settings::default(), Settings::exact()] {
            let got = renderer.render_splats(&scene.splats(), &camera, &settings).unwrap();
            compare_needles(&got, &scene.splats(), &camera, &settings);
        }
    }

    /// Every world of a batch is, bit for bit, what it holds drawn alone.
    #[test]
    fn a_world_of_a_batch_is_the_world_alone(
        seed in any::<u64>(), worlds in 1usize..=128, groups in 1usize..40, settings in settings(),
    ) {
        let Some(mut renderer) = renderer() else { return Ok(()) };
        let scene = Scene::random(400, 1, 0.01, 0.3, seed);
        let mut r = TestRng(seed ^ 1);
        let of: Vec<u32> = (0..400).map(|_| (r.unit() * groups as f32) as u32 % groups as u32).collect();
        let mut states = States::new(groups);
        (0..worlds).for_each(|w| states.push(|_| w == 0 || r.unit() < 0.6));
        let camera = camera(37, 33);
        let device = renderer.device().clone();
        let all = OnDevice::with_groups(&device, &scene.splats(), &of).unwrap();
        let presence = Presence::new(&device, &states).unwrap();
        let batch = renderer.render_worlds(&all, &presence, &camera, &settings).unwrap();
        prop_assert_eq!(batch.len(), worlds);
        // The first, the last, and some between.
        for world in [0, worlds / 3, worlds / 2, worlds - 1] {
            let present: Vec<usize> = (0..400).filter(|&i| states.has(world, of[i] as usize)).collect();
            let gaussians: Vec<Gaussian> = present.iter().map(|&i| scene.gaussians[i]).collect();
            let rest: Vec<f32> = present.iter().flat_map(|&i| scene.splats().rest(i).to_vec()).collect();
            let splats = Splats::new(&gaussians, &rest, scene.degree).unwrap();
            let alone = renderer.render_splats(&splats, &camera, &settings).unwrap();
            prop_assert_eq!(bits(&batch[world]), bits(&alone), "world {}", world);
        }
    }
}

#[test]
fn all_128_worlds_equal_serial_renders() {
    let Some(mut renderer) = renderer() else { return };
    let scene = Scene::random(600, 0, 0.02, 0.3, 5);
    let of: Vec<u32> = (0..600).map(|i| i % 24).collect();
    let mut r = TestRng(3);
    let mut states = States::new(24);
    (0..128).for_each(|_| states.push(|_| r.unit() < 0.7));
    let (camera, settings) = (camera(24, 20), Settings::default());
    let device = renderer.device().clone();
    let all = OnDevice::with_groups(&device, &scene.splats(), &of).unwrap();
    let presence = Presence::new(&device, &states).unwrap();
    let batch = renderer.render_worlds(&all, &presence, &camera, &settings).unwrap();
    for (world, got) in batch.iter().enumerate() {
        let present =
            scene.gaussians.iter().zip(&of).filter(|(_, group)| states.has(world, **group as usize));
        let gaussians: Vec<Gaussian> = present.map(|(g, _)| *g).collect();
        let alone = renderer.render_splats(&Splats::plain(&gaussians), &camera, &settings).unwrap();
        assert_eq!(bits(got), bits(&alone), "world {world}");
    }
    assert_ne!(bits(&batch[0]), bits(&batch[1]), "worlds that differ look different");
}

#[test]
fn a_dense_scene_meets_the_promise_and_repeats_itself() {
    let Some(mut renderer) = renderer() else { return };
    let scene = Scene::random(20_000, 0, 0.004, 0.02, 7);
    let (camera, settings) = (camera(300, 300), Settings::default());
    let device = renderer.device().clone();
    let on_device = OnDevice::new(&device, &scene.splats()).unwrap();
    let first = renderer.render(&on_device, &camera, &settings).unwrap();
    let d = compare(&first, &scene.splats(), &camera, &settings);
    assert!(d.max_clear <= 1e-5, "{d:?}");
    // Another picture in between leaves no trace.
    renderer.render_splats(&Splats::plain(&[]), &camera, &settings).unwrap();
    let again = renderer.render(&on_device, &camera, &settings).unwrap();
    assert_eq!((bits(&first), first.counters), (bits(&again), again.counters));
    // Counted as on the CPU, slivers apart.
    let cpu = render(&scene.splats(), &camera, &settings).unwrap().counters;
    let gpu = first.counters;
    assert_eq!((gpu.drawn, gpu.outside, gpu.sub_pixel), (cpu.drawn, cpu.outside, cpu.sub_pixel));
    assert!(gpu.intersections >= cpu.intersections, "{gpu:?} {cpu:?}");
    assert!(gpu.intersections - cpu.intersections <= cpu.intersections / 1000, "{gpu:?} {cpu:?}");
    assert!(gpu.pixels_stopped.abs_diff(cpu.pixels_stopped) <= 3, "{gpu:?} {cpu:?}");
}

#[test]
fn trusted_shaders_give_the_bits_of_checked_ones() {
    let Some(mut checked) = renderer() else { return };
    let mut trusted =
        Renderer::new(&Executor::new(&Device::open(&DeviceOptions::from_env()).unwrap())).unwrap();
    let scene = Scene::random(1500, 2, 0.01, 0.2, 19);
    let (camera, settings) = (camera(90, 70), Settings::default());
    let a = checked.render_splats(&scene.splats(), &camera, &settings).unwrap();
    let b = trusted.render_splats(&scene.splats(), &camera, &settings).unwrap();
    assert_eq!((bits(&a), a.counters), (bits(&b), b.counters));
}

#[test]
fn one_splat_too_few_is_seen() {
    let Some(mut renderer) = renderer() else { return };
    let mut scene = Scene::random(500, 0, 0.02, 0.1, 3);
    let (camera, settings) = (camera(80, 60), Settings::default());
    let exact = reference::render(&scene.splats(), &camera, &settings).unwrap();
    let depth = |g: &Gaussian| camera.to_camera(g.position)[2];
    let nearest =
        (0..500).min_by(|&a, &b| depth(&scene.gaussians[a]).total_cmp(&depth(&scene.gaussians[b]))).unwrap();
    scene.gaussians[nearest].opacity = 0.0;
    let got = renderer.render_splats(&scene.splats(), &camera, &settings).unwrap();
    assert!(exact.difference(got.image.rgb()).unwrap().max_clear > 1e-3);
}

#[test]
fn odd_sizes_and_empty_scenes() {
    let Some(mut renderer) = renderer() else { return };
    let settings = Settings::over([0.25, 0.5, 0.75]);
    let scene = Scene::random(200, 0, 0.01, 0.3, 11);
    for (w, h) in [(1, 1), (17, 16), (15, 33), (8192, 3), (3, 8192)] {
        let camera = camera(w, h);
        let empty = renderer.render_splats(&Splats::plain(&[]), &camera, &settings).unwrap();
        assert!(empty.image.rgb().chunks(3).all(|p| p == [0.25, 0.5, 0.75]), "{w} x {h}");
        assert_eq!(empty.counters.pixels, u64::from(w) * u64::from(h));
        let got = renderer.render_splats(&scene.splats(), &camera, &settings).unwrap();
        assert!(finite(&got));
        compare(&got, &scene.splats(), &camera, &settings);
    }
    let hidden = [Gaussian::ABSENT; 3];
    let got = renderer.render_splats(&Splats::plain(&hidden), &camera(20, 20), &settings).unwrap();
    assert_eq!((got.counters.absent, got.counters.drawn), (3, 0));
}

/// Splats that cover the whole image: more entries than there is room for at first, listed by whole
/// workgroups, over more tiles than one digit names.
#[test]
fn lists_that_do_not_fit_are_made_room_for() {
    let Some(shared) = renderer() else { return };
    let mut renderer = Renderer::new(&Executor::new(shared.device())).unwrap();
    let device = shared.device().clone();
    let mut scene = Scene::random(150, 0, 0.05, 0.1, 2);
    for g in &mut scene.gaussians {
        (g.scale, g.opacity) = ([30.0; 3], 0.02);
    }
    let (camera, settings) = (camera(500, 350), Settings::default());
    let on_device = OnDevice::new(&device, &scene.splats()).unwrap();
    renderer.draw(&on_device, &camera, &settings).unwrap();
    let needed = 150 * 32 * 22;
    let error = renderer.read().unwrap_err();
    assert_eq!(error, GpuError::Entries { found: needed, room: 1 << 16 }, "never silent");
    assert!(renderer.make_room().unwrap());
    renderer.draw(&on_device, &camera, &settings).unwrap();
    assert!(!renderer.make_room().unwrap());
    let got = renderer.read().unwrap();
    assert_eq!(got.counters.intersections, u64::from(needed));
    compare(&got, &scene.splats(), &camera, &settings);
    // One call that recovers by itself.
    let once =
        Renderer::new(&Executor::new(&device)).unwrap().render(&on_device, &camera, &settings).unwrap();
    assert_eq!((bits(&got), got.counters), (bits(&once), once.counters));
}

#[test]
fn what_does_not_fit_is_refused_by_name() {
    let Some(mut renderer) = renderer() else { return };
    let device = renderer.device().clone();
    let plain = [Gaussian { opacity: 0.5, ..Gaussian::ABSENT }];
    let splats = Splats::plain(&plain);
    let error = OnDevice::with_groups(&device, &splats, &[0, 1]).unwrap_err();
    assert_eq!(error, GpuError::Length { field: "groups", found: 2, needed: 1 });
    let scene = OnDevice::with_groups(&device, &splats, &[4]).unwrap();
    let states = Presence::new(&device, &States::full(4)).unwrap();
    let error = renderer.render_worlds(&scene, &states, &camera(8, 8), &Settings::default()).unwrap_err();
    assert_eq!(error, GpuError::Length { field: "groups of worlds", found: 4, needed: 5 });
    assert!(Presence::new(&device, &States::new(4)).is_err());
    let bad = Settings { alpha_max: 2.0, ..Settings::default() };
    assert!(matches!(renderer.render(&scene, &camera(8, 8), &bad), Err(GpuError::Settings(_))));
    let usage = wgpu::BufferUsages::STORAGE;
    let most = device.facts().max_binding_bytes;
    assert!(matches!(device.buffer("much", most + 1, usage), Err(GpuError::TooLarge { what: "much", .. })));
    let nobody = DeviceOptions { name: "no adapter has this name".into(), checked: true };
    assert!(matches!(Device::open(&nobody), Err(GpuError::NoAdapter { .. })));
    // None of this harmed the device.
    renderer.render(&scene, &camera(8, 8), &Settings::default()).unwrap();
}

/// Values that break arithmetic, by kind.
#[rustfmt::skip]
const POISON: [f32; 14] = [
    f32::NAN, f32::INFINITY, f32::NEG_INFINITY, f32::MAX, f32::MIN, f32::MIN_POSITIVE, 1e-45,
    -0.0, 0.0, 1e-12, 1e6, -1e6, 1e30, 0.5,
];

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn poison_gives_a_finite_picture(
        fields in proptest::collection::vec(proptest::collection::vec(0usize..70, 14), 1..30),
        seed in any::<u64>(), low_pass in prop_oneof![Just(0.3f64), Just(0.0)],
        cutoff in prop_oneof![Just(1.0f32 / 255.0), Just(0.0)], antialiased in any::<bool>(),
    ) {
        let Some(mut renderer) = renderer() else { return Ok(()) };
        let mut r = TestRng(seed);
        let value = |kind: &usize, r: &mut TestRng| {
            POISON.get(*kind).copied().unwrap_or_else(|| r.between(-1.5, 1.5))
        };
        let gaussians: Vec<Gaussian> = fields.iter().map(|f| {
            let v: Vec<f32> = f.iter().map(|kind| value(kind, &mut r)).collect();
            Gaussian {
                position: [v[0], v[1], v[2]], scale: [v[3].abs(), v[4].abs(), v[5].abs()],
                rotation: [v[6], v[7], v[8], v[9]], opacity: v[10].abs(), sh0: [v[11], v[12], v[13]],
            }
        }).collect();
        let settings = Settings { low_pass, alpha_cutoff: cutoff, antialiased, ..Settings::default() };
        let (splats, camera) = (Splats::plain(&gaussians), camera(50, 40));
        let got = renderer.render_splats(&splats, &camera, &settings).unwrap();
        prop_assert!(finite(&got), "{:?}", got.counters);
    }
}
