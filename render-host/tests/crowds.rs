//! Lists that are ended early are lists of which nothing is seen, in pictures, gradients and worlds.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use codec_core::Gaussian;
use render_host::{
    Image, Renderer, SequenceRenderer, Settings, Splats, Workspace,
    adjoint::{SplatGradient, loss::Mse},
    counterfactual::{Engine, States, Variants, brute},
    render_and_gradients,
};

use support::{Scene, camera};

/// Walls over everything, nearest last in index so that order is not that of indices.
fn walls(n: usize) -> Scene {
    let mut scene = Scene::random(n, 0, 3.0, 30.0, 21);
    for (i, g) in scene.gaussians.iter_mut().enumerate() {
        g.position = [0.3 * (i as f32).sin(), 0.3 * (i as f32).cos(), 0.0];
        g.opacity = 0.05 + 0.1 * (i % 7) as f32;
    }
    scene
}

#[test]
fn what_is_behind_walls_changes_nothing() {
    for n in [6000, 70_000] {
        check_behind(&walls(n).gaussians);
    }
}

fn check_behind(walls: &[Gaussian]) {
    let view = camera(100, 60);
    // Nearest first, so that the first ones are a scene by themselves.
    let mut gaussians = walls.to_vec();
    gaussians.sort_by(|a, b| view.to_camera(a.position)[2].total_cmp(&view.to_camera(b.position)[2]));
    let target = Image::filled(100, 60, [0.5; 3]).unwrap();
    let loss = Mse::new(target);
    for settings in [Settings::default(), Settings { alpha_cutoff: 0.0, ..Settings::default() }] {
        let (all, few) = (Splats::plain(&gaussians), Splats::plain(&gaussians[..1000]));
        let mut renderer = Renderer::new();
        let whole = renderer.render(&all, &view, &settings).unwrap();
        let part = renderer.render(&few, &view, &settings).unwrap();
        // 28 tiles: the lists of the few are whole, those of all are ended.
        assert_eq!(part.counters.intersections, 28 * 1000);
        assert!(whole.counters.intersections < 28 * 1000, "{:?}", whole.counters);
        assert!(whole.image == part.image && whole.transmittance == part.transmittance);

        // A sequence in which a frame without a crowd leaves its lists to one with it, and the other way.
        let mut sequence = SequenceRenderer::default();
        for (splats, expected) in [(&all, &whole), (&few, &part), (&all, &whole)] {
            let shown = sequence.render(splats, &view, &settings).unwrap();
            assert!(shown == expected);
        }

        let gradients =
            |splats| render_and_gradients(&mut Workspace::new(), splats, &view, &settings, &loss).unwrap();
        let (whole, part) = (gradients(&all), gradients(&few));
        assert_eq!(whole.splats[..1000], part.splats[..]);
        assert!(whole.splats[1000..].iter().all(|g| *g == SplatGradient::default()));
        assert!(part.splats[0] != SplatGradient::default());
    }
}

/// Enough for lists to be made piece by piece; only some of the tiles are ever finished.
#[test]
fn many_splats_over_a_part_of_the_image() {
    let mut gaussians = walls(70_000).gaussians;
    for (i, g) in gaussians.iter_mut().enumerate() {
        // Balls at one side of the image, a few anywhere.
        g.scale = [0.5; 3];
        g.position[0] += if i % 2000 == 0 { 0.0 } else { 1.2 };
        g.opacity = 0.03;
    }
    let (view, splats) = (camera(64, 48), Splats::plain(&gaussians));
    let mut renderer = Renderer::new();
    let ended = renderer.render(&splats, &view, &Settings::default()).unwrap();
    // Without a stop no list is ended.
    let unstopped = Settings { early_stop: false, ..Settings::default() };
    let whole = renderer.render(&splats, &view, &unstopped).unwrap();
    let (few, all) = (ended.counters.intersections, whole.counters.intersections);
    assert!(10 * few < 9 * all, "{few} of {all}");
    assert!(ended.counters.intersections > 70_000, "{:?}", ended.counters);
    let stopped = ended.counters.pixels_stopped;
    assert!(stopped > 300 && stopped < 64 * 48 - 300, "{:?}", ended.counters);
    for (a, b) in ended.image.rgb().iter().zip(whole.image.rgb()) {
        assert!((a - b).abs() < 2e-4, "{a} {b}");
    }
    let serial = Settings { parallel: false, ..Settings::default() };
    assert_eq!(renderer.render(&splats, &view, &serial).unwrap(), ended);
}

#[test]
fn worlds_see_behind_walls_that_they_lack() {
    let scene = walls(9000);
    let view = camera(60, 40);
    // Group 0 is a third of the walls, group 1 the rest but a few, group 2 what is left.
    let groups: Vec<u32> = (0..9000).map(|i| if i % 1000 == 0 { 2 } else { u32::from(i % 3 > 0) }).collect();
    let variants = Variants::new(scene.splats(), &groups, 3).unwrap();
    let mut states = States::new(3);
    (0..8).for_each(|world| states.push(|group| world >> group & 1 == 1));
    let settings = Settings::default();
    let target = Image::filled(60, 40, [0.4; 3]).unwrap();
    let engine = Engine::new(&variants, &view, &target, &settings).unwrap();
    let alone = brute::sse(&variants, &states, &view, &target, &settings).unwrap();
    assert_eq!(engine.strict(&states).unwrap(), alone);
    let unstopped = Settings { early_stop: false, ..settings };
    let alone = brute::sse(&variants, &states, &view, &target, &unstopped).unwrap();
    for (fast, alone) in engine.fast(&states).unwrap().iter().zip(&alone) {
        assert!((fast / alone - 1.0).abs() < 2e-6, "{fast} {alone}");
    }
    assert!(alone.windows(2).all(|w| w[0] != w[1]), "worlds differ");
}

#[test]
fn every_mode_can_square_bright_scenes() {
    let mut scene = Scene::random(300, 0, 0.05, 0.3, 22);
    scene.gaussians[..40].iter_mut().for_each(|g| g.sh0 = g.sh0.map(|c| 1e30 * c));
    let view = camera(40, 30);
    let groups: Vec<u32> = (0..300).map(|i| i / 20 % 4).collect();
    let variants = Variants::new(scene.splats(), &groups, 4).unwrap();
    let settings = Settings { early_stop: false, ..Settings::default() };
    let target = Image::filled(40, 30, [0.4; 3]).unwrap();
    let engine = Engine::new(&variants, &view, &target, &settings).unwrap();
    let order = [3, 0, 2, 1];
    let mut along = States::new(4);
    (0..=4).for_each(|count| along.push(|group| order[..count].contains(&(group as u32))));
    let exact = engine.strict(&along).unwrap();
    assert!(exact[0] < 1e6 && exact[4] > 1e55, "{exact:?}");
    let close = |a: f64, b: f64| a.is_finite() && (a - b).abs() <= 2e-6 * b.abs();
    let fast = engine.fast(&along).unwrap();
    assert!(fast.iter().zip(&exact).all(|(&a, &b)| close(a, b)), "{fast:?} {exact:?}");
    // Adding the first group to the empty world, and taking it away from the next.
    let delta = engine.utilities(&along.range(0..2)).unwrap();
    let rise = exact[0] - exact[1];
    assert!(close(delta.of(0, 3), rise) && close(delta.of(1, 3), rise), "{delta:?} {exact:?}");
}

#[test]
fn transmittance_never_decays_into_subnormal_numbers() {
    // Discs one behind the other, each of which halves what it covers, and nothing ends a pixel early.
    let mut scene = Scene::random(400, 0, 0.5, 0.6, 23);
    for (i, g) in scene.gaussians.iter_mut().enumerate() {
        (g.position, g.opacity) = ([0.0, 0.0, 0.4 - i as f32 * 1e-3], 0.5);
    }
    let view = camera(40, 30);
    let settings = Settings { early_stop: false, ..Settings::default() };
    let drawn = render_host::render(&scene.splats(), &view, &settings).unwrap();
    let least = drawn.transmittance.iter().fold(f32::INFINITY, |least, &t| least.min(t));
    // 0.5 to the power of 400 is far below what f32 holds.
    assert!((1e-33..1e-29).contains(&least), "{least:e}");
    assert!(drawn.transmittance.iter().all(|&t| t >= f32::MIN_POSITIVE));
    let exact = render_host::reference::render(&scene.splats(), &view, &settings).unwrap();
    let off = exact.difference(drawn.image.rgb()).unwrap().max_clear;
    assert!(off < 1e-5, "{off:e}");
    // The modes of the engine agree with it, where groups alternate and where one is whole.
    for share in [1, 200] {
        let groups: Vec<u32> = (0..400).map(|i| i / share % 2).collect();
        let variants = Variants::new(scene.splats(), &groups, 2).unwrap();
        let target = Image::filled(40, 30, [0.4; 3]).unwrap();
        let engine = Engine::new(&variants, &view, &target, &settings).unwrap();
        let full = States::full(2);
        let alone = brute::sse(&variants, &full, &view, &target, &settings).unwrap();
        assert_eq!(engine.strict(&full).unwrap(), alone);
        assert!((engine.fast(&full).unwrap()[0] / alone[0] - 1.0).abs() < 2e-6);
    }
}
