//! The distortion of states that differ in one cluster, against rendering and comparing each alone.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use proptest::prelude::*;
use render_host::{
    Camera, Image, Settings,
    counterfactual::{Distortions, Engine, Variants, Versions, brute},
};

use support::{Scene, TestRng, camera};

/// A scene in which clusters, regions of space, show one of up to four versions.
struct Levels {
    scene: Scene,
    groups: Vec<u32>,
    versions: Versions,
    camera: Camera,
    reference: Image,
}

impl Levels {
    fn new(n: usize, clusters: usize, size: (u32, u32), seed: u64) -> Self {
        let mut r = TestRng(seed ^ 0x77);
        let counts: Vec<u32> = (0..clusters).map(|c| 1 + (c as u32 * 7 + seed as u32 % 5) % 4).collect();
        let versions = Versions::new(&counts).unwrap();
        let mut scene = Scene::random(n, 0, 0.02, 0.15, seed);
        let third = |p: f32| ((p + 1.0) * 1.5) as usize;
        let mut groups = Vec::new();
        let mut all = Vec::new();
        for gaussian in &scene.gaussians {
            let [x, y, z] = gaussian.position.map(third);
            let cluster = (x + 3 * y + 9 * z) % clusters;
            // Version 0 of a cluster with several is empty, and the last repeats the one before it.
            let count = versions.count(cluster);
            for version in usize::from(count > 1)..count {
                let mut other = *gaussian;
                if version + 1 < count || count == 1 {
                    other.position[0] += 0.02 * version as f32 * r.unit();
                }
                all.push(other);
                groups.push(versions.group(cluster, version) as u32);
            }
        }
        scene.gaussians = all;
        let rgb = (0..3 * size.0 * size.1).map(|_| r.unit()).collect();
        let reference = Image::new(size.0, size.1, rgb).unwrap();
        Self { scene, groups, versions, camera: camera(size.0, size.1), reference }
    }

    fn variants(&self) -> Variants<'_> {
        Variants::new(self.scene.splats(), &self.groups, self.versions.groups()).unwrap()
    }

    fn contexts(&self, count: usize, seed: u64) -> Vec<Vec<u32>> {
        let mut r = TestRng(seed);
        let version = |c: usize, r: &mut TestRng| (r.unit() * self.versions.count(c) as f32) as u32;
        (0..count).map(|_| (0..self.versions.clusters()).map(|c| version(c, &mut r)).collect()).collect()
    }

    fn fast(&self, contexts: &[Vec<u32>], reference: &Image, settings: &Settings) -> Distortions {
        let engine = Engine::new(&self.variants(), &self.camera, reference, settings).unwrap();
        engine.distortions(&self.versions, contexts).unwrap()
    }

    fn alone(&self, contexts: &[Vec<u32>], settings: &Settings) -> Distortions {
        let (variants, camera) = (self.variants(), &self.camera);
        brute::distortions(&variants, &self.versions, contexts, camera, &self.reference, settings).unwrap()
    }

    /// Every distortion, in order.
    fn list(&self, of: &Distortions, contexts: usize) -> Vec<f64> {
        let mut out = Vec::new();
        for context in 0..contexts {
            out.push(of.of_context(context));
            for cluster in 0..self.versions.clusters() {
                out.extend((0..self.versions.count(cluster)).map(|v| of.of(context, cluster, v)));
            }
        }
        out
    }
}

fn worst(a: &[f64], b: &[f64]) -> f64 {
    assert_eq!(a.len(), b.len());
    a.iter().zip(b).map(|(a, b)| (a - b).abs()).fold(0.0, f64::max)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(16))]

    #[test]
    fn every_distortion_is_that_of_the_state_alone(
        seed in any::<u64>(), n in 0usize..500, clusters in 1usize..14, contexts in 0usize..4,
        width in 1u32..80, height in 1u32..60, early_stop in any::<bool>(),
    ) {
        let levels = Levels::new(n, clusters, (width, height), seed);
        let settings = Settings { early_stop, background: [0.2, 0.5, 0.1], ..Settings::default() };
        let contexts = levels.contexts(contexts, seed);
        let fast = levels.list(&levels.fast(&contexts, &levels.reference, &settings), contexts.len());
        let alone = levels.list(&levels.alone(&contexts, &settings), contexts.len());
        prop_assert!(worst(&fast, &alone) < 1e-12, "{}", worst(&fast, &alone));
    }
}

#[test]
fn a_pixel_of_the_reference_that_differs_shows_in_every_distortion() {
    let levels = Levels::new(400, 9, (50, 37), 5);
    let (settings, contexts) = (Settings::default(), levels.contexts(3, 6));
    let alone = levels.list(&levels.alone(&contexts, &settings), 3);
    let mut other = levels.reference.clone();
    other.rgb_mut()[3 * (18 * 50 + 25)] += 1e-3;
    let fast = levels.list(&levels.fast(&contexts, &other, &settings), 3);
    let least = fast.iter().zip(&alone).map(|(a, b)| (a - b).abs()).fold(f64::INFINITY, f64::min);
    assert!(least > 1e-9, "{least}");
    // One version in place of another shows too, in more than the tolerance of the test above.
    let shifted = worst(&alone[1..], &alone[..alone.len() - 1]);
    assert!(shifted > 1e-6, "{shifted}");
}

#[test]
fn batches_of_contexts_and_threads_do_not_show() {
    // 200 x 200 pixels hold so many blocks that contexts come in several batches.
    let levels = Levels::new(900, 20, (200, 200), 8);
    let contexts = levels.contexts(12, 9);
    let settings = Settings::default();
    let together = levels.list(&levels.fast(&contexts, &levels.reference, &settings), 12);
    let mut one_by_one = Vec::new();
    for context in &contexts {
        let alone = levels.fast(std::slice::from_ref(context), &levels.reference, &settings);
        one_by_one.extend(levels.list(&alone, 1));
    }
    let bits = |values: &[f64]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
    assert_eq!(bits(&together), bits(&one_by_one));
    let serial = Settings { parallel: false, ..settings.clone() };
    let serial = levels.list(&levels.fast(&contexts, &levels.reference, &serial), 12);
    assert_eq!(bits(&together), bits(&serial));
    let pool = rayon::ThreadPoolBuilder::new().num_threads(7).build().unwrap();
    let seven = pool.install(|| levels.list(&levels.fast(&contexts, &levels.reference, &settings), 12));
    assert_eq!(bits(&together), bits(&seven));
}

#[test]
fn what_does_not_fit_is_refused() {
    let levels = Levels::new(40, 3, (20, 20), 1);
    let engine =
        Engine::new(&levels.variants(), &levels.camera, &levels.reference, &Settings::default()).unwrap();
    let other = Versions::new(&[1, 1]).unwrap();
    let error = engine.distortions(&other, &[]).unwrap_err().to_string();
    assert!(error.contains("states of 2 groups"), "{error}");
    let error = engine.distortions(&levels.versions, &[vec![0, 0]]).unwrap_err().to_string();
    assert!(error.contains("context of 2 clusters"), "{error}");
}
