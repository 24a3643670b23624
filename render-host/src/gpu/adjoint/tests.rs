//! Gradients on the device against those of the CPU.

use super::{
    super::{
        Stages,
        test_scene::{TestScene, executor},
    },
    *,
};
use crate::{
    Workspace,
    adjoint::{
        loss::{Dissimilarity, Distortion, Loss, Mse},
        render_and_gradients,
    },
    counterfactual::brute,
    splats::Splats,
};

fn engine(executor: &Executor, case: &TestScene, mix: Mix, settings: &Settings) -> Engine {
    let objective = Objective { target: &case.against, mix };
    Engine::new(executor, &case.variants(), &case.camera, &objective, settings).unwrap()
}

/// The loss of the CPU.
fn loss(case: &TestScene, mix: Mix) -> Box<dyn Loss> {
    let target = case.against.clone();
    match mix {
        Mix::MSE => Box::new(Mse::new(target)),
        Mix::STRUCTURE => Box::new(Dissimilarity::new(target)),
        Mix { mse, structure } => {
            assert_eq!(mse, 1.0);
            Box::new(Distortion::weighted(target, structure))
        }
    }
}

/// Fields of a Gaussian's gradient, by name.
const FIELDS: [&str; 6] = ["position", "log_scale", "rotation", "opacity_logit", "sh0", "image mean"];

fn fields(g: &SplatGradient) -> [Vec<f32>; 6] {
    [
        g.position.to_vec(),
        g.log_scale.to_vec(),
        g.rotation.to_vec(),
        vec![g.opacity_logit],
        g.sh0.to_vec(),
        g.image_mean.to_vec(),
    ]
}

/// Relative L2 distance, and the worst element by the largest.
fn distance(got: &[f32], expected: &[f64]) -> [f64; 2] {
    assert_eq!(got.len(), expected.len());
    let square = |v: f64| v * v;
    let all: f64 = expected.iter().map(|&e| square(e)).sum();
    let off: f64 = got.iter().zip(expected).map(|(&g, &e)| square(f64::from(g) - e)).sum();
    let largest = expected.iter().fold(1e-300f64, |m, e| m.max(e.abs()));
    let worst = got.iter().zip(expected).map(|(&g, &e)| (f64::from(g) - e).abs());
    [
        (off / all.max(1e-300)).sqrt(),
        worst.fold(0.0f64, |m, e| if e.is_nan() { f64::INFINITY } else { m.max(e) }) / largest,
    ]
}

/// What the CPU finds, world by world: losses; fields and harmonics summed.
struct Twin {
    loss: Vec<f64>,
    fields: [Vec<f64>; 6],
    rest: Vec<f64>,
    background: [f64; 3],
    pose: [f64; 6],
}

fn six(pose: &Pose) -> [f64; 6] {
    let Pose { translation: [a, b, c], rotation: [d, e, f] } = *pose;
    [a, b, c, d, e, f]
}

fn twin(case: &TestScene, states: &States, mix: Mix, settings: &Settings) -> Twin {
    let (n, each) = (case.gaussians.len(), case.degree.rest_len());
    let mut out = Twin {
        loss: Vec::new(),
        fields: [3, 3, 4, 1, 3, 2].map(|width| vec![0.0; n * width]),
        rest: vec![0.0; n * each],
        background: [0.0; 3],
        pose: [0.0; 6],
    };
    for world in 0..states.len() {
        let (gaussians, rest) = brute::world(&case.variants(), states, world);
        let splats = Splats::new(&gaussians, &rest, case.degree).unwrap();
        let loss = loss(case, mix);
        let found =
            render_and_gradients(&mut Workspace::new(), &splats, &case.camera, settings, &*loss).unwrap();
        out.loss.push(found.loss);
        (0..3).for_each(|c| out.background[c] += found.background[c]);
        out.pose.iter_mut().zip(six(&found.pose)).for_each(|(sum, v)| *sum += v);
        let present = (0..n).filter(|&i| states.has(world, case.ids[i] as usize));
        for (k, i) in present.enumerate() {
            for (sums, values) in out.fields.iter_mut().zip(fields(&found.splats[k])) {
                let width = values.len();
                let sums = &mut sums[i * width..][..width];
                sums.iter_mut().zip(values).for_each(|(s, v)| *s += f64::from(v));
            }
            let sums = out.rest[i * each..][..each].iter_mut();
            sums.zip(&found.sh_rest[k * each..]).for_each(|(s, &v)| *s += f64::from(v));
        }
    }
    out
}

fn compare(name: &str, case: &TestScene, worlds: usize, settings: &Settings) {
    compare_mix(name, case, worlds, Mix::MSE, settings);
}

fn compare_mix(name: &str, case: &TestScene, worlds: usize, mix: Mix, settings: &Settings) {
    let Some(executor) = executor() else { return };
    let states = if worlds == 0 { States::full(case.groups) } else { case.states(worlds, 3) };
    let got = engine(executor, case, mix, settings).gradients(&states).unwrap();
    check_gradients(name, case, &states, mix, settings, &got);
}

fn check_gradients(
    name: &str,
    case: &TestScene,
    states: &States,
    mix: Mix,
    settings: &Settings,
    got: &Gradients,
) {
    let expected = twin(case, states, mix, settings);
    assert_eq!(got.loss.len(), expected.loss.len());
    for (a, b) in got.loss.iter().zip(&expected.loss) {
        assert!((a / b - 1.0).abs() < 1e-5, "{name}: loss {a} {b}");
    }
    let mut found = Vec::new();
    for (k, field) in FIELDS.iter().enumerate() {
        let values: Vec<f32> = got.splats.iter().flat_map(|g| fields(g)[k].clone()).collect();
        found.push((*field, distance(&values, &expected.fields[k])));
    }
    found.push(("sh_rest", distance(&got.sh_rest, &expected.rest)));
    found.push(("background", distance(&got.background.map(|v| v as f32), &expected.background)));
    found.push(("pose", distance(&six(&got.pose).map(|v| v as f32), &expected.pose)));
    for (field, [l2, worst]) in &found {
        println!("{name}: {field} {l2:.1e} relative L2, worst {worst:.1e} of the largest");
    }
    for (field, [l2, worst]) in found {
        assert!(l2 < 1e-5 && worst < 1e-4, "{name}: {field} {l2} {worst}");
    }
}

fn settings() -> Settings {
    Settings { background: [0.3, 0.1, 0.6], ..Settings::default() }
}

#[test]
fn gradients_of_one_world_are_those_of_the_cpu() {
    compare("plain", &TestScene::new(900, 0, 27, [75, 53], 1), 0, &settings());
}

/// Lists of many segments, most of which nobody sees.
#[test]
fn gradients_of_opaque_crowds_are_those_of_the_cpu() {
    let mut case = TestScene::new(5000, 0, 27, [25, 20], 7);
    case.gaussians.iter_mut().for_each(|g| g.opacity = g.opacity.sqrt());
    compare("opaque crowd", &case, 2, &settings());
    compare("crowd without stop", &case, 0, &Settings { early_stop: false, ..settings() });
}

/// The comparison would see a Gaussian that is a little off, in every field.
#[test]
fn a_wrong_gradient_is_seen() {
    let Some(executor) = executor() else { return };
    let mut case = TestScene::new(60, 1, 5, [40, 30], 8);
    let got = engine(executor, &case, Mix::MSE, &settings()).gradients(&States::full(5)).unwrap();
    case.gaussians.iter_mut().for_each(|g| g.opacity *= 0.99);
    let expected = twin(&case, &States::full(5), Mix::MSE, &settings());
    for (k, field) in FIELDS.iter().enumerate() {
        let values: Vec<f32> = got.splats.iter().flat_map(|g| fields(g)[k].clone()).collect();
        let [l2, worst] = distance(&values, &expected.fields[k]);
        assert!(l2 > 1e-4 && worst > 1e-3, "{field}: {l2} {worst}");
    }
}

#[test]
fn gradients_of_harmonics_are_those_of_the_cpu() {
    compare("degree 3", &TestScene::new(500, 3, 5, [50, 40], 2), 0, &settings());
    let antialiased = Settings { antialiased: true, max_sh_degree: 1, ..settings() };
    compare("antialiased, degree 1 of 2", &TestScene::new(400, 2, 5, [40, 50], 3), 0, &antialiased);
}

/// Lists made on the device, without a word to the host between camera and gradients.
#[test]
fn gradients_from_lists_of_the_device_are_those_of_the_cpu() {
    [Mix::MSE, Mix::DISTORTION].into_iter().for_each(from_lists_of_the_device);
}

fn from_lists_of_the_device(mix: Mix) {
    let Some(executor) = executor() else { return };
    let (case, settings) = (TestScene::new(700, 1, 27, [61, 47], 6), settings());
    let states = case.states(3, 2);
    let mut stages = Stages::new(executor.device()).unwrap();
    let scene = Scene::with_groups(executor.device(), &case.splats(), &case.ids).unwrap();
    stages.prepare(executor.device(), &scene, &case.camera, &settings).unwrap();
    let tiles = stages.tiles().unwrap();
    let objective = Objective { target: &case.against, mix };
    let engine = Engine::with_tiles(executor, scene, tiles, case.groups, &objective, &settings);
    let engine = engine.unwrap();
    let worlds = engine.worlds(&states).unwrap();
    let mut recording = Recording::new();
    stages.record(engine.scene(), &mut recording).unwrap();
    engine.record(&worlds, &mut recording).unwrap();
    let bound = executor.bind(recording).unwrap();
    let once = || {
        executor.submit(&bound, None);
        engine.read(&worlds).unwrap()
    };
    let got = once();
    check_gradients("lists of the device", &case, &states, mix, &settings, &got);
    assert_eq!(once(), got, "every run equals the first");
}

#[test]
fn gradients_add_up_over_worlds() {
    compare("9 worlds", &TestScene::new(600, 1, 27, [45, 33], 4), 9, &settings());
}

#[test]
fn gradients_of_similarity_are_those_of_the_cpu() {
    let case = |size, seed| TestScene::new(700, 1, 27, size, seed);
    compare_mix("distortion", &case([75, 53], 1), 0, Mix::DISTORTION, &settings());
    compare_mix("1 - ssim", &case([61, 47], 2), 0, Mix::STRUCTURE, &settings());
    compare_mix("9 worlds of equal weight", &case([45, 33], 3), 9, Mix::weighted(1.0), &settings());
    compare_mix("a picture below the window", &case([9, 40], 4), 2, Mix::DISTORTION, &settings());
    let mut opaque = TestScene::new(5000, 0, 27, [25, 20], 7);
    opaque.gaussians.iter_mut().for_each(|g| g.opacity = g.opacity.sqrt());
    compare_mix("opaque crowd", &opaque, 5, Mix::DISTORTION, &settings());
    let endless = Settings { early_stop: false, ..settings() };
    compare_mix("crowd without stop", &opaque, 0, Mix::DISTORTION, &endless);
}

/// How many worlds are retained at a time is a matter of memory alone.
#[test]
fn worlds_in_chunks_give_the_same_bits() {
    let Some(executor) = executor() else { return };
    let case = TestScene::new(600, 0, 27, [45, 33], 4);
    let states = case.states(11, 5);
    let mut engine = engine(executor, &case, Mix::DISTORTION, &settings());
    let together = engine.gradients(&states).unwrap();
    engine.chunk_bytes = 1;
    assert!(engine.gradients(&states).unwrap() == together);
}

/// Given pixel gradients of squared error, the way back alone is what the way in one does.
#[test]
fn both_ways_of_squared_error_agree() {
    let Some(executor) = executor() else { return };
    let case = TestScene::new(600, 1, 27, [45, 33], 4);
    let states = case.states(6, 5);
    let mut engine = engine(executor, &case, Mix::MSE, &settings());
    let at_once = engine.gradients(&states).unwrap();
    engine.structure = Some(Structure::new(executor.device(), &case.against, Mix::MSE).unwrap());
    let with_pictures = engine.gradients(&states).unwrap();
    for (a, b) in with_pictures.loss.iter().zip(&at_once.loss) {
        assert!((a / b - 1.0).abs() < 1e-6, "{a} {b}");
    }
    assert!(with_pictures.splats == at_once.splats, "same pixel gradients, same sums");
}
