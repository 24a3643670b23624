//! The engine on the device against the engine on the CPU and brute force.

use super::{
    super::{
        Renderer, Scene, Stages,
        test_scene::{TestScene, executor, worst},
        tiles::through_f32,
    },
    *,
};
use crate::{
    Splats,
    counterfactual::{self, brute},
    render,
};

fn settings() -> Settings {
    Settings { early_stop: false, background: [0.3, 0.1, 0.6], ..Settings::default() }
}

fn engine(executor: &Executor, case: &TestScene) -> Engine {
    Engine::new(executor, &case.variants(), &case.camera, &case.against, &settings()).unwrap()
}

/// The CPU's engine, fed with the ellipses of the device.
fn twin(case: &TestScene) -> counterfactual::Engine {
    let mut twin =
        counterfactual::Engine::new(&case.variants(), &case.camera, &case.against, &settings()).unwrap();
    twin.map_splats(through_f32);
    twin
}

fn cases() -> [(TestScene, usize); 4] {
    [
        (TestScene::new(1500, 0, 27, [75, 53], 1), 37),
        (TestScene::new(800, 1, 5, [16, 16], 2), 1),
        (TestScene::new(0, 0, 3, [40, 20], 3), 4),
        // More groups than a word, and in one place: several passes over a block.
        (many_groups(), 20),
    ]
}

fn many_groups() -> TestScene {
    let mut case = TestScene::new(900, 0, 100, [33, 20], 4);
    case.ids = (0..900).map(|i| i * 7 % 100).collect();
    case
}

#[test]
fn errors_are_those_of_the_cpu() {
    let Some(executor) = executor() else { return };
    let mut most = 0.0f64;
    for (case, worlds) in cases() {
        let states = case.states(worlds, 9);
        let got = engine(executor, &case).fast(&states).unwrap();
        let expected = twin(&case).fast(&states).unwrap();
        let error = worst(&got, &expected, |i| expected[i]);
        most = most.max(error);
        let alone = brute::sse(&case.variants(), &states, &case.camera, &case.against, &settings()).unwrap();
        let all = worst(&got, &alone, |i| alone[i]);
        println!("{worlds} worlds: {error:.1e} against the twin, {all:.1e} against brute force");
        assert!(all < 1e-5);
    }
    assert!(most < 2e-6, "{most}");
}

#[test]
fn utilities_are_those_of_the_cpu() {
    let Some(executor) = executor() else { return };
    for (case, worlds) in cases() {
        let states = case.states(worlds.min(5), 10);
        let got = engine(executor, &case).utilities(&states).unwrap();
        let expected = twin(&case).utilities(&states).unwrap();
        let base = worst(&got.sse, &expected.sse, |i| expected.sse[i]);
        let largest = expected.delta.iter().fold(1e-30f64, |m, d| m.max(d.abs()));
        let delta = worst(&got.delta, &expected.delta, |_| largest);
        let smallest = expected.sse.iter().fold(f64::INFINITY, |m, &e| m.min(e));
        let of_error = worst(&got.delta, &expected.delta, |_| smallest);
        println!("utilities: {base:.1e}, {of_error:.1e} of the error, {delta:.1e} of the largest utility");
        assert!(base < 2e-6 && of_error < 2e-7 && delta < 1e-5);
    }
}

/// Lists made on the device, without a word to the host between camera and errors.
#[test]
fn errors_from_lists_of_the_device_are_those_of_the_cpu() {
    let Some(executor) = executor() else { return };
    let mut stages = Stages::new(executor.device()).unwrap();
    for (case, worlds) in cases() {
        let states = case.states(worlds, 9);
        let scene = Scene::with_groups(executor.device(), &case.splats(), &case.ids).unwrap();
        stages.prepare(executor.device(), &scene, &case.camera, &settings()).unwrap();
        let tiles = stages.tiles().unwrap();
        let engine = Engine::with_tiles(executor, tiles, case.groups, &case.against).unwrap();
        let batch = engine.worlds(&states).unwrap();
        let mut recording = Recording::new();
        stages.record(&scene, &mut recording).unwrap();
        engine.record_lists(&mut recording);
        engine.record_fast(&batch, &mut recording);
        executor.run(recording).unwrap();
        let got = engine.read_errors(&batch).unwrap();
        let alone = brute::sse(&case.variants(), &states, &case.camera, &case.against, &settings()).unwrap();
        let error = worst(&got, &alone, |i| alone[i]);
        println!("lists of the device, {worlds} worlds: {error:.1e} against brute force");
        assert!(error < 1e-5);
    }
}

#[test]
fn a_batch_equals_its_worlds_alone_and_every_run_equals_the_first() {
    let Some(executor) = executor() else { return };
    let case = TestScene::new(700, 0, 27, [70, 40], 11);
    let states = case.states(35, 12);
    let engine = engine(executor, &case);
    let bits = |values: Vec<f64>| values.into_iter().map(f64::to_bits).collect::<Vec<_>>();
    let all = bits(engine.fast(&states).unwrap());
    assert_eq!(all, bits(engine.fast(&states).unwrap()));
    for world in [0, 15, 16, 34] {
        assert_eq!(bits(engine.fast(&states.one(world)).unwrap()), [all[world]]);
    }
    let utilities = engine.utilities(&states).unwrap();
    let one = engine.utilities(&states.one(33)).unwrap();
    assert_eq!(utilities.sse[33].to_bits(), one.sse[0].to_bits());
    assert_eq!(utilities.delta[33 * 27..34 * 27], one.delta);
    assert!(engine.fast(&States::new(27)).unwrap().is_empty());
    assert!(engine.utilities(&States::new(27)).unwrap().delta.is_empty());
}

/// Sum of squares as the kernels add: a tree over the threads of a tile, then over tiles.
fn squares(picture: &Image, wanted: &Image) -> f32 {
    let [width, height] = [picture.width() as usize, picture.height() as usize];
    let [columns, rows] = [width, height].map(|side| side.div_ceil(16));
    let mut tiles = vec![0.0f32; columns * rows];
    for (tile, sum) in tiles.iter_mut().enumerate() {
        let mut threads = [0.0f32; 256];
        for (thread, error) in threads.iter_mut().enumerate() {
            let (block, within) = (thread / 32, thread % 32);
            let x = tile % columns * 16 + block % 2 * 8 + within % 8;
            let y = tile / columns * 16 + block / 2 * 4 + within / 8;
            if x < width && y < height {
                let first = 3 * (y * width + x);
                let d: [f32; 3] = std::array::from_fn(|c| picture.rgb()[first + c] - wanted.rgb()[first + c]);
                *error = d[2].mul_add(d[2], d[1].mul_add(d[1], d[0] * d[0]));
            }
        }
        for half in [128, 64, 32, 16, 8, 4, 2, 1] {
            (0..half).for_each(|i| threads[i] += threads[i + half]);
        }
        *sum = threads[0];
    }
    let mut pieces = [0.0f32; 16];
    for (piece, sum) in pieces.iter_mut().enumerate() {
        for run in (piece..tiles.len()).step_by(256) {
            let few = (run..tiles.len().min(run + 256)).step_by(16).fold(0.0, |few, t| few + tiles[t]);
            *sum += few;
        }
    }
    for half in [8, 4, 2, 1] {
        (0..half).for_each(|i| pieces[i] += pieces[i + half]);
    }
    pieces[0]
}

/// Strict errors are, on exact bits, those of the pictures that the renderer draws of each world alone.
#[test]
fn strict_errors_are_those_of_worlds_drawn_alone() {
    let Some(executor) = executor() else { return };
    let (mut renderer, mut stages) =
        (Renderer::new(executor).unwrap(), Stages::new(executor.device()).unwrap());
    // A background of zeros and ones is exact however it is added.
    let settings = Settings { background: [0.0, 1.0, 0.0], ..Settings::default() };
    for (mut case, worlds) in cases() {
        // Opaque enough to stop early.
        case.gaussians.iter_mut().for_each(|g| g.opacity = g.opacity.sqrt());
        let scene = Scene::with_groups(executor.device(), &case.splats(), &case.ids).unwrap();
        stages.prepare(executor.device(), &scene, &case.camera, &settings).unwrap();
        let tiles = stages.tiles().unwrap();
        let engine = Engine::with_tiles(executor, tiles, case.groups, &case.against).unwrap();
        let mut recording = Recording::new();
        stages.record(&scene, &mut recording).unwrap();
        engine.record_lists(&mut recording);
        executor.run(recording).unwrap();
        let states = case.states(worlds, 13);
        let got = engine.strict(&states).unwrap();
        for world in (0..worlds).step_by(5) {
            let (gaussians, rest) = brute::world(&case.variants(), &states, world);
            let alone = Splats::new(&gaussians, &rest, case.degree).unwrap();
            let picture = renderer.render_splats(&alone, &case.camera, &settings).unwrap().image;
            let expected = squares(&picture, &case.against);
            assert_eq!((got[world] as f32).to_bits(), expected.to_bits(), "world {world}");
        }
        if worlds > 1 && !case.gaussians.is_empty() {
            assert!(got[0] != got[1], "the comparison would see another world");
        }
    }
}

#[test]
fn what_is_refused_is_named() {
    let Some(executor) = executor() else { return };
    let case = TestScene::new(10, 0, 4, [20, 20], 1);
    let refused = engine(executor, &case).fast(&States::full(5)).unwrap_err().to_string();
    assert!(refused.contains("groups of the states: found 5 values, need 4"), "{refused}");
    let small = Image::filled(10, 20, [0.0; 3]).unwrap();
    let error = Engine::new(executor, &case.variants(), &case.camera, &small, &settings());
    assert!(error.unwrap_err().to_string().contains("20 x 20 and 10 x 20"));
}

/// The comparison would see a splat that is missing.
#[test]
fn a_missing_splat_is_seen() {
    let Some(executor) = executor() else { return };
    let case = TestScene::new(300, 0, 6, [50, 40], 5);
    let states = case.states(3, 1);
    let got = engine(executor, &case).fast(&states).unwrap();
    let drawn = |g: &&codec_core::Gaussian| {
        render(&Splats::plain(&[**g]), &case.camera, &settings()).unwrap().counters.drawn == 1
    };
    let seen = case.gaussians.iter().position(|g| drawn(&g)).unwrap();
    let mut fewer = TestScene::new(300, 0, 6, [50, 40], 5);
    fewer.gaussians[seen].opacity = 0.0;
    let expected = twin(&fewer).fast(&States::full(6)).unwrap();
    let full = twin(&case).fast(&States::full(6)).unwrap();
    assert!((expected[0] / full[0] - 1.0).abs() > 2e-6);
    assert!(got.iter().all(|e| e.is_finite()));
}
