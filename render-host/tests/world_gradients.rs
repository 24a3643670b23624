//! Gradients summed over worlds against every world differentiated alone.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use render_host::{
    Camera, Image, Settings,
    adjoint::SplatGradient,
    counterfactual::{Engine, States, Variants, WorldGradients, brute},
};

use support::{Scene, TestRng, camera};

struct Case {
    scene: Scene,
    groups: Vec<u32>,
    count: usize,
    camera: Camera,
    against: Image,
    weights: Vec<f64>,
    states: States,
}

impl Case {
    fn new(n: usize, degree: u8, count: usize, worlds: usize, size: (u32, u32), seed: u64) -> Self {
        let scene = Scene::random(n, degree, 0.01, 0.12, seed);
        let cell = |p: f32| ((p + 1.0) * 1.5) as usize;
        let group = |p: [f32; 3]| (cell(p[0]) + 3 * cell(p[1]) + 9 * cell(p[2])) % count;
        let groups = scene.gaussians.iter().map(|g| group(g.position) as u32).collect();
        let mut r = TestRng(seed ^ 0x55);
        let rgb = (0..3 * size.0 * size.1).map(|_| r.unit()).collect();
        let against = Image::new(size.0, size.1, rgb).unwrap();
        let mut states = States::new(count);
        (0..worlds).for_each(|_| states.push(|_| r.unit() < 0.7));
        let weights = (0..worlds).map(|_| f64::from(r.between(0.1, 2.0))).collect();
        Self { scene, groups, count, camera: camera(size.0, size.1), against, weights, states }
    }

    fn variants(&self) -> Variants<'_> {
        Variants::new(self.scene.splats(), &self.groups, self.count).unwrap()
    }

    fn fast(&self, settings: &Settings) -> WorldGradients {
        let variants = self.variants();
        let engine = Engine::new(&variants, &self.camera, &self.against, settings).unwrap();
        engine.gradients(&variants, &self.states, &self.weights).unwrap()
    }

    fn brute(&self, settings: &Settings) -> WorldGradients {
        let (variants, states, weights) = (self.variants(), &self.states, &self.weights);
        brute::gradients(&variants, states, weights, &self.camera, &self.against, settings).unwrap()
    }
}

fn no_stop() -> Settings {
    Settings { early_stop: false, background: [0.3, 0.1, 0.6], ..Settings::default() }
}

/// A class of parameters and all its numbers.
fn classes(g: &WorldGradients) -> Vec<(&'static str, Vec<f64>)> {
    let of = |get: &dyn Fn(&SplatGradient) -> Vec<f32>| -> Vec<f64> {
        g.splats.iter().flat_map(|s| get(s).into_iter().map(f64::from)).collect()
    };
    vec![
        ("position", of(&|s| s.position.to_vec())),
        ("log scale", of(&|s| s.log_scale.to_vec())),
        ("rotation", of(&|s| s.rotation.to_vec())),
        ("opacity", of(&|s| vec![s.opacity_logit])),
        ("sh0", of(&|s| s.sh0.to_vec())),
        ("image mean", of(&|s| s.image_mean.to_vec())),
        ("sh rest", g.sh_rest.iter().map(|&v| f64::from(v)).collect()),
        ("background", g.background.to_vec()),
        ("pose", g.pose.translation.iter().chain(&g.pose.rotation).copied().collect()),
        ("losses", g.losses.clone()),
    ]
}

/// Length of the difference over the length of the expected, and the largest difference over the largest.
fn errors(got: &[f64], expected: &[f64]) -> [f64; 2] {
    assert_eq!(got.len(), expected.len());
    let length = |v: &[f64]| v.iter().map(|v| v * v).sum::<f64>().sqrt();
    let largest = |v: &[f64]| v.iter().fold(0.0f64, |m, v| m.max(v.abs()));
    let difference: Vec<f64> = got.iter().zip(expected).map(|(a, b)| a - b).collect();
    assert!(difference.iter().all(|d| d.is_finite()));
    let over = |a: f64, b: f64| if a == 0.0 { 0.0 } else { a / b };
    [over(length(&difference), length(expected)), over(largest(&difference), largest(expected))]
}

#[test]
fn sums_over_worlds_are_those_of_the_worlds_alone() {
    for (n, degree, count, worlds, size, seed) in [
        (900, 1, 27, 20, (60, 44), 1),
        (700, 0, 4, 128, (33, 50), 2),
        (500, 2, 1, 3, (17, 16), 3),
        (300, 0, 200, 7, (16, 16), 4),
    ] {
        let case = Case::new(n, degree, count, worlds, size, seed);
        let (got, expected) = (case.fast(&no_stop()), case.brute(&no_stop()));
        assert!((got.loss / expected.loss - 1.0).abs() < 1e-6);
        for ((name, got), (_, expected)) in classes(&got).iter().zip(&classes(&expected)) {
            let [l2, worst] = errors(got, expected);
            println!("seed {seed}, {name}: relative length {l2:.1e}, worst of largest {worst:.1e}");
            assert!(l2 < 1e-5 && worst < 1e-5, "seed {seed}, {name}: {l2} {worst}");
        }
    }
}

#[test]
fn a_wrong_sum_fails() {
    let mut case = Case::new(900, 1, 27, 20, (60, 44), 1);
    let got = case.fast(&no_stop());
    let differs = |expected: &WorldGradients| {
        let pairs = classes(&got).into_iter().zip(classes(expected));
        pairs.map(|((_, a), (_, b))| errors(&a, &b)[0]).fold(0.0, f64::max)
    };
    // One weight changed, one group of one world changed, another background, early stop.
    case.weights[3] *= 1.01;
    assert!(differs(&case.brute(&no_stop())) > 1e-4);
    case.weights[3] /= 1.01;
    let states = std::mem::replace(&mut case.states, States::new(27));
    (0..20).for_each(|w| case.states.push(|g| states.has(w, g) != (w == 17 && g == 5)));
    assert!(differs(&case.brute(&no_stop())) > 1e-4);
    case.states = states;
    assert!(differs(&case.brute(&Settings { background: [0.0; 3], ..no_stop() })) > 1e-3);
    let stopped = Settings { early_stop: true, transmittance_stop: 0.1, ..no_stop() };
    assert!(differs(&case.brute(&stopped)) > 1e-4);
}

#[test]
fn threads_do_not_show_and_chunks_add_up() {
    let case = Case::new(2500, 0, 27, 150, (120, 90), 5);
    let bits = |g: &WorldGradients| -> Vec<u64> {
        classes(g).iter().flat_map(|(_, values)| values.iter().map(|v| v.to_bits())).collect()
    };
    let expected = case.fast(&Settings { parallel: false, ..no_stop() });
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(bits(&pool.install(|| case.fast(&no_stop()))) == bits(&expected), "{threads} threads");
    }
    // 150 worlds are two words of classes.
    let brute = case.brute(&no_stop());
    for ((name, got), (_, expected)) in classes(&expected).iter().zip(&classes(&brute)) {
        assert!(errors(got, expected)[0] < 1e-5, "{name}");
    }
}

#[test]
fn nothing_is_differentiated_to_nothing_and_what_is_refused_is_named() {
    let mut case = Case::new(40, 0, 4, 2, (20, 20), 1);
    let variants = case.variants();
    let engine = Engine::new(&variants, &case.camera, &case.against, &no_stop()).unwrap();
    let none = engine.gradients(&variants, &States::new(4), &[]).unwrap();
    assert!(none.loss == 0.0 && none.splats.iter().all(|g| *g == SplatGradient::default()));
    let error = engine.gradients(&variants, &case.states, &[1.0]).unwrap_err().to_string();
    assert!(error.contains("2 finite numbers"), "{error}");
    assert!(engine.gradients(&variants, &case.states, &[1.0, f64::NAN]).is_err());
    let few = Variants::new(render_host::Splats::plain(&[]), &[], 4).unwrap();
    let error = engine.gradients(&few, &case.states, &[1.0, 1.0]).unwrap_err().to_string();
    assert!(error.contains("variants of 0 Gaussians for an engine of 40"), "{error}");
    case.states = States::empty(4);
    case.weights = vec![1.0];
    let empty = case.fast(&no_stop());
    assert!(empty.loss > 0.0 && empty.splats.iter().all(|g| g.position == [0.0; 3]));
}
