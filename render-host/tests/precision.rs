//! Precisions: depth keys of few bits and f16 attributes change the picture by what the reference says, and
//! nothing else: skips, worlds and threads still do not show.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use render_host::{
    Settings,
    counterfactual::{Engine, States, Variants, brute},
    reference, render,
};

use support::{Scene, camera};

fn precisions() -> [(&'static str, Settings); 4] {
    let d = Settings::default();
    [
        ("16 bits", Settings { depth_bits: 16, ..d.clone() }),
        ("20 bits", Settings { depth_bits: 20, ..d.clone() }),
        ("f16", Settings { half_attributes: true, ..d.clone() }),
        ("f16, no low pass", Settings { half_attributes: true, low_pass: 0.0, depth_bits: 17, ..d }),
    ]
}

#[test]
fn the_error_is_visible_and_small() {
    let scene = Scene::random(3000, 2, 0.01, 0.1, 5);
    let view = camera(90, 70);
    let error = |settings: &Settings| {
        let got = render(&scene.splats(), &view, settings).unwrap();
        let exact = reference::render(&scene.splats(), &view, settings).unwrap();
        exact.difference(got.image.rgb()).unwrap().max_clear
    };
    let full = error(&Settings::default());
    for (name, settings) in precisions() {
        let found = error(&settings);
        assert!(found > 3.0 * full && found < 0.5, "{name}: {found:e} where full precision has {full:e}");
    }
    // More bits, less error; the last ones tell nothing apart.
    let of = |depth_bits| error(&Settings { depth_bits, ..Settings::default() });
    let (few, more, most) = (of(16), of(22), of(31));
    assert!(few > more && more >= most && most <= 1e-4, "{few} {more} {most}");
}

#[test]
fn skips_worlds_and_threads_do_not_show() {
    // Scales from far below a pixel to far beyond the image, where f16 has no bits left.
    let mut scene = Scene::random(400, 0, 1e-6, 1e5, 6);
    scene.gaussians.extend(Scene::random(800, 0, 0.01, 0.2, 7).gaussians);
    scene.gaussians.iter_mut().for_each(|g| g.opacity *= 0.5);
    let view = camera(90, 70);
    for (name, settings) in precisions() {
        let all = render(&scene.splats(), &view, &settings).unwrap();
        let plain = Settings { cull_frustum: false, exact_tiles: false, parallel: false, ..settings.clone() };
        let without = render(&scene.splats(), &view, &plain).unwrap();
        assert!(all.image == without.image && all.transmittance == without.transmittance, "{name}");

        let groups: Vec<u32> = (0..scene.gaussians.len() as u32).map(|i| i % 5).collect();
        let variants = Variants::new(scene.splats(), &groups, 5).unwrap();
        let mut states = States::full(5);
        (0..5).for_each(|missing| states.push(|group| group != missing));
        let engine = Engine::new(&variants, &view, &without.image, &settings).unwrap();
        let alone = brute::sse(&variants, &states, &view, &without.image, &settings).unwrap();
        assert_eq!(engine.strict(&states).unwrap(), alone, "{name}");
    }
}

#[test]
fn equal_keys_go_by_index() {
    // Two discs whose depths differ in the last bits only, the farther one first.
    let mut scene = Scene::random(2, 0, 0.3, 0.3, 8);
    for (g, (x, colour)) in scene.gaussians.iter_mut().zip([(-1.0e-4f32, 1.0f32), (1.0e-4, -1.0)]) {
        (g.position, g.opacity, g.sh0) = ([x, 0.0, 0.0], 0.9, [colour; 3]);
    }
    let view = camera(40, 40);
    let depth = |i: usize| view.to_camera(scene.gaussians[i].position)[2];
    assert!(depth(1) < depth(0), "{} {}", depth(0), depth(1));
    let at = |depth_bits| {
        let settings = Settings { depth_bits, ..Settings::default() };
        render(&scene.splats(), &view, &settings).unwrap().image.pixel(20, 20).unwrap()[0]
    };
    assert!(at(32) < 0.4 && at(16) > 0.6, "{} {}", at(32), at(16));
}
