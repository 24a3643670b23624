//! The counterfactual engine against brute force and the f64 reference.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use proptest::prelude::*;
use render_host::{
    Camera, Image, Settings, Splats,
    counterfactual::{CounterfactualError, Engine, States, Variants, WorldBatch, brute},
    reference,
};

use support::{Scene, TestRng, camera};

/// A scene whose groups are cells of space, so that they overlap on the image plane and in depth.
struct Case {
    scene: Scene,
    groups: Vec<u32>,
    count: usize,
    camera: Camera,
    against: Image,
}

impl Case {
    fn new(n: usize, degree: u8, count: usize, size: (u32, u32), seed: u64) -> Self {
        let scene = Scene::random(n, degree, 0.01, 0.12, seed);
        let cell = |p: f32| ((p + 1.0) * 1.5) as usize;
        let group = |p: [f32; 3]| (cell(p[0]) + 3 * cell(p[1]) + 9 * cell(p[2])) % count;
        let groups = scene.gaussians.iter().map(|g| group(g.position) as u32).collect();
        let mut r = TestRng(seed ^ 0x55);
        let rgb = (0..3 * size.0 * size.1).map(|_| r.unit()).collect();
        let against = Image::new(size.0, size.1, rgb).unwrap();
        Self { scene, groups, count, camera: camera(size.0, size.1), against }
    }

    fn variants(&self) -> (Splats<'_>, &[u32], usize) {
        (self.scene.splats(), &self.groups, self.count)
    }

    fn engine(&self, settings: &Settings) -> Engine {
        Engine::new(&variants(self), &self.camera, &self.against, settings).unwrap()
    }

    fn brute(&self, states: &States, settings: &Settings) -> Vec<f64> {
        brute::sse(&variants(self), states, &self.camera, &self.against, settings).unwrap()
    }

    fn truth(&self, states: &States, settings: &Settings) -> Vec<f64> {
        let world = |w| {
            let (gaussians, rest) = brute::world(&variants(self), states, w);
            let splats = Splats::new(&gaussians, &rest, self.scene.degree).unwrap();
            let got = reference::render(&splats, &self.camera, settings).unwrap();
            let square = |(a, &b): (&f64, &f32)| (a - f64::from(b)).powi(2);
            got.rgb.iter().zip(self.against.rgb()).map(square).sum()
        };
        (0..states.len()).map(world).collect()
    }
}

fn variants(case: &Case) -> Variants<'_> {
    let (splats, groups, count) = case.variants();
    Variants::new(splats, groups, count).unwrap()
}

fn random(count: usize, worlds: usize, seed: u64) -> States {
    let mut r = TestRng(seed);
    let mut states = States::new(count);
    (0..worlds).for_each(|_| states.push(|_| r.unit() < 0.7));
    states
}

fn no_stop() -> Settings {
    Settings { early_stop: false, background: [0.3, 0.1, 0.6], ..Settings::default() }
}

fn bits(values: &[f64]) -> Vec<u64> {
    values.iter().map(|v| v.to_bits()).collect()
}

/// Largest difference relative to `scale`; NaN counts as infinite.
fn worst(got: &[f64], expected: &[f64], scale: impl Fn(usize) -> f64) -> f64 {
    assert_eq!(got.len(), expected.len());
    let each = got.iter().zip(expected).enumerate().map(|(i, (a, b))| (a - b).abs() / scale(i));
    each.fold(0.0, |m, e| {
        if e <= m {
            m
        } else if e.is_nan() {
            f64::INFINITY
        } else {
            e
        }
    })
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(12))]

    /// Errors of strict mode and pictures of a batch are those of the world alone, on exact bytes.
    #[test]
    fn strict_is_brute_force_bit_for_bit(
        seed in any::<u64>(), n in 0usize..1500, degree in 0u8..2, count in 1usize..27,
        worlds in 1usize..=128, width in 1u32..70, height in 1u32..50, early_stop in any::<bool>(),
    ) {
        let case = Case::new(n, degree, count, (width, height), seed);
        let settings = Settings { early_stop, background: [0.2, 0.5, 0.1], ..Settings::default() };
        let states = random(count, worlds, seed);
        let engine = case.engine(&settings);
        prop_assert_eq!(bits(&engine.strict(&states).unwrap()), bits(&case.brute(&states, &settings)));
        let world = seed as usize % worlds;
        let alone = brute::image(&variants(&case), &states, world, &case.camera, &settings).unwrap();
        let bytes = |image: &Image| image.rgb().iter().flat_map(|v| v.to_le_bytes()).collect::<Vec<_>>();
        let batch = WorldBatch::new(&variants(&case), &case.camera, &settings).unwrap();
        prop_assert_eq!(bytes(&batch.images(&states).unwrap()[world]), bytes(&alone));
    }

    /// Every fast mode against brute force without early stop.
    #[test]
    fn fast_modes_agree_with_brute_force(
        seed in any::<u64>(), n in 0usize..1200, count in 1usize..27, width in 1u32..70, height in 1u32..50,
    ) {
        let case = Case::new(n, 0, count, (width, height), seed);
        let (settings, states) = (no_stop(), random(count, 5, seed));
        let engine = case.engine(&settings);
        let alone = case.brute(&states, &settings);
        let got = engine.fast(&states).unwrap();
        prop_assert!(worst(&got, &alone, |i| alone[i]) < 2e-6);

        // Leave one out and add one in.
        let utilities = engine.utilities(&states).unwrap();
        prop_assert!(worst(&utilities.sse, &alone, |i| alone[i]) < 2e-6);
        let mut toggled = States::new(count);
        for world in 0..states.len() {
            (0..count).for_each(|g| toggled.push(|h| states.has(world, h) != (g == h)));
        }
        let expected: Vec<f64> = case.brute(&toggled, &settings).iter().enumerate().map(|(i, sse)| {
            let rise = sse - alone[i / count];
            if states.has(i / count, i % count) { rise } else { -rise }
        }).collect();
        prop_assert!(worst(&utilities.delta, &expected, |i| alone[i / count]) < 2e-6);

    }
}

#[test]
fn fast_is_within_two_in_a_million_of_f64() {
    for seed in 0..3 {
        let case = Case::new(4000, 1, 27, (96, 80), seed);
        let states = random(27, 6, seed);
        let truth = case.truth(&states, &no_stop());
        let got = case.engine(&no_stop()).fast(&states).unwrap();
        let error = worst(&got, &truth, |i| truth[i]);
        assert!(error < 2e-6, "{error}");
        // A comparator off by one world must not pass.
        let mut shifted = truth.clone();
        shifted.rotate_left(1);
        assert!(worst(&got, &shifted, |i| truth[i]) > 1e-4);
    }
}

#[test]
fn a_wrong_comparator_fails() {
    let case = Case::new(2000, 0, 20, (64, 64), 3);
    let (settings, states) = (no_stop(), random(20, 40, 4));
    let engine = case.engine(&settings);
    let strict = engine.strict(&states).unwrap();
    // One group of one world changed, the wrong background, the wrong reference: each shows.
    let mut other = States::new(20);
    (0..40).for_each(|w| other.push(|g| states.has(w, g) != (w == 17 && g == 5)));
    let wrong = case.brute(&other, &settings);
    let differ: Vec<usize> = (0..40).filter(|&w| strict[w].to_bits() != wrong[w].to_bits()).collect();
    assert_eq!(differ, [17]);
    assert!(worst(&engine.fast(&states).unwrap(), &wrong, |i| strict[i]) > 1e-5);
    let black = case.brute(&states, &Settings { background: [0.0; 3], ..settings.clone() });
    assert!(strict.iter().zip(&black).all(|(a, b)| a != b));
    // With the sign of the utility turned, leave-one-out fails.
    let utilities = engine.utilities(&states).unwrap();
    let turned: Vec<f64> = utilities.delta.iter().map(|d| -d).collect();
    assert!(worst(&utilities.delta, &turned, |_| strict[0]) > 1e-3);
    // Early stop changes strict mode, as it should.
    let stopped = Settings { transmittance_stop: 0.2, early_stop: true, ..settings };
    assert_ne!(bits(&case.engine(&stopped).strict(&states).unwrap()), bits(&strict));
}

#[test]
fn threads_do_not_show() {
    let case = Case::new(3000, 0, 27, (150, 110), 5);
    let states = random(27, 140, 6);
    let all = |settings: &Settings| {
        let engine = case.engine(settings);
        let mut out = engine.strict(&states).unwrap();
        out.extend(engine.fast(&states).unwrap());
        let utilities = engine.utilities(&states).unwrap();
        out.extend(utilities.sse.iter().chain(&utilities.delta));
        bits(&out)
    };
    let expected = all(&Settings { parallel: false, ..Settings::default() });
    for threads in [1, 2, 5] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        assert!(pool.install(|| all(&Settings::default())) == expected, "{threads} threads");
    }
}

#[test]
fn a_batch_equals_its_worlds_alone() {
    let case = Case::new(2000, 0, 27, (80, 60), 11);
    let states = random(27, 130, 12);
    let engine = case.engine(&Settings::default());
    let (strict, fast) = (engine.strict(&states).unwrap(), engine.fast(&states).unwrap());
    for world in [0, 64, 127, 128, 129] {
        let one = states.one(world);
        assert_eq!(engine.strict(&one).unwrap()[0].to_bits(), strict[world].to_bits());
        assert_eq!(engine.fast(&one).unwrap()[0].to_bits(), fast[world].to_bits());
    }
    assert!(engine.fast(&States::new(27)).unwrap().is_empty());
    assert!(engine.strict(&States::new(27)).unwrap().is_empty());
    assert!(engine.utilities(&States::new(27)).unwrap().delta.is_empty());
}

#[test]
fn more_groups_than_a_word_and_nobody_home() {
    // 200 groups in a single tile, most of them touching every block.
    let mut case = Case::new(600, 0, 200, (16, 16), 9);
    case.groups = (0..600).map(|i| i % 200).collect();
    let (settings, states) = (no_stop(), random(200, 9, 2));
    let engine = case.engine(&settings);
    let alone = case.brute(&states, &settings);
    assert_eq!(bits(&engine.strict(&states).unwrap()), bits(&alone));
    assert!(worst(&engine.fast(&states).unwrap(), &alone, |i| alone[i]) < 2e-6);
    assert!(worst(&engine.utilities(&states).unwrap().sse, &alone, |i| alone[i]) < 2e-6);
}

#[test]
fn what_is_refused_is_named() {
    let case = Case::new(10, 0, 4, (20, 20), 1);
    let engine = case.engine(&Settings::default());
    let refused = |e: CounterfactualError, words: &str| assert!(e.to_string().contains(words), "{e}");
    refused(engine.fast(&States::full(5)).unwrap_err(), "5 groups for variants of 4");
    let small = Image::filled(10, 20, [0.0; 3]).unwrap();
    let error = Engine::new(&variants(&case), &case.camera, &small, &Settings::default()).unwrap_err();
    refused(error, "20 x 20 and 10 x 20");
}
