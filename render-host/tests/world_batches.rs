//! Pictures of many worlds in one call against each world rendered alone, on exact bytes.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use proptest::prelude::*;
use render_host::{
    Image, Settings,
    counterfactual::{
        CounterfactualError, States, Variants, WorldBatch, brute, render_worlds, tuner::OutOfMemory,
    },
    render_many,
};

use support::{Scene, TestRng, camera};

fn groups(scene: &Scene, count: usize) -> Vec<u32> {
    let cell = |p: f32| ((p + 1.0) * 1.5) as usize;
    let group = |p: [f32; 3]| (cell(p[0]) + 3 * cell(p[1]) + 9 * cell(p[2])) % count;
    scene.gaussians.iter().map(|g| group(g.position) as u32).collect()
}

fn random(count: usize, worlds: usize, seed: u64) -> States {
    let mut r = TestRng(seed);
    let mut states = States::new(count);
    (0..worlds).for_each(|_| states.push(|_| r.unit() < 0.7));
    states
}

fn bytes(image: &Image) -> Vec<u8> {
    image.rgb().iter().flat_map(|v| v.to_le_bytes()).collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(10))]

    #[test]
    fn every_picture_is_that_of_the_world_alone(
        seed in any::<u64>(), n in 0usize..1200, degree in 0u8..2, count in 1usize..27,
        worlds in prop_oneof![1usize..=4, 1usize..=128],
        width in 1u32..60, height in 1u32..40, early_stop in any::<bool>(),
        parallel in any::<bool>(),
    ) {
        let scene = Scene::random(n, degree, 0.01, 0.15, seed);
        let groups = groups(&scene, count);
        let variants = Variants::new(scene.splats(), &groups, count).unwrap();
        // A stop that is often met.
        let settings = Settings {
            early_stop, parallel, transmittance_stop: 0.05, background: [0.2, 0.5, 0.1], ..Settings::default()
        };
        let (camera, states) = (camera(width, height), random(count, worlds, seed));
        let got = render_worlds(&variants, &states, &camera, &settings).unwrap();
        prop_assert_eq!(got.len(), worlds);
        for (world, got) in got.iter().enumerate() {
            let alone = brute::image(&variants, &states, world, &camera, &settings).unwrap();
            prop_assert_eq!(bytes(got), bytes(&alone), "world {}", world);
        }
    }
}

#[test]
fn a_batch_of_128_equals_separate_splats_in_one_call() {
    let scene = Scene::random(2500, 1, 0.01, 0.1, 3);
    let groups = groups(&scene, 27);
    let variants = Variants::new(scene.splats(), &groups, 27).unwrap();
    let (camera, states, settings) = (camera(90, 70), random(27, 128, 4), Settings::default());
    let got = render_worlds(&variants, &states, &camera, &settings).unwrap();
    let worlds: Vec<_> = (0..128).map(|w| brute::world(&variants, &states, w)).collect();
    let splats: Vec<_> =
        worlds.iter().map(|(g, r)| render_host::Splats::new(g, r, scene.degree).unwrap()).collect();
    let alone = render_many(&splats, &camera, &settings).unwrap();
    assert!(got.iter().zip(&alone).all(|(a, b)| bytes(a) == bytes(&b.image)));
    // A comparator off by one world must not pass.
    assert!(got.iter().zip(&alone[1..]).any(|(a, b)| bytes(a) != bytes(&b.image)));
    // More than a word of worlds, and in batches.
    let (states, batch) = (random(27, 130, 9), WorldBatch::new(&variants, &camera, &settings).unwrap());
    let whole = batch.images(&states).unwrap();
    let parts = [0..48, 48..96, 96..130].map(|part| batch.images(&states.range(part)).unwrap());
    assert_eq!(whole, parts.concat());
    assert!(batch.images(&States::new(27)).unwrap().is_empty());
    let error = batch.images(&States::full(5)).unwrap_err();
    assert_eq!(error, CounterfactualError::States { found: 5, needed: 27 });
}

#[test]
fn the_tuner_finds_a_batch_that_fits_and_recovers_from_running_out() {
    let scene = Scene::random(1500, 0, 0.01, 0.1, 7);
    let groups = groups(&scene, 27);
    let variants = Variants::new(scene.splats(), &groups, 27).unwrap();
    let batch = WorldBatch::new(&variants, &camera(80, 60), &Settings::default()).unwrap();
    let states = random(27, 128, 8);
    // With room for all, one probe says so; what it used is below what was predicted, and near it.
    let tuned = batch.largest(&states, 1 << 34);
    assert_eq!((tuned.worlds, tuned.probes.len()), (128, 1));
    let used = tuned.probes[0].used.unwrap();
    assert!(used <= tuned.probes[0].predicted && 2 * used > tuned.probes[0].predicted, "{tuned:?}");
    // A budget is kept, by what was used and not by what was predicted.
    assert!(batch.predict_bytes(usize::MAX) >= usize::MAX as u64, "it saturates");
    let budget = batch.predict_bytes(40);
    let tuned = batch.largest(&states, budget);
    assert!(tuned.worlds >= 40 && tuned.worlds < 128, "{tuned:?}");
    assert!(tuned.probes.iter().any(|p| p.worlds == tuned.worlds && p.used.unwrap() <= budget));
    // A system that gives less than it was asked for.
    let most = batch.predict_bytes(20) - batch.predict_bytes(0);
    let mut denied = 0;
    let tuned = batch.largest_with(&states, 1 << 34, &mut |bytes| {
        denied += usize::from(bytes > most);
        if bytes > most { Err(OutOfMemory) } else { Ok(()) }
    });
    assert!(tuned.probes[0].used == Err(OutOfMemory) && denied > 0);
    assert!((19..=20).contains(&tuned.worlds), "{tuned:?}");
    assert_eq!(batch.largest_with(&states, 1 << 34, &mut |_| Err(OutOfMemory)).worlds, 0);
    assert_eq!(batch.largest(&states, 10).worlds, 0);
}
