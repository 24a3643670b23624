//! A sequence against fresh renders of the same frames: the same bits and the same counts, whatever happened
//! between frames and whatever is kept.

#![expect(clippy::unwrap_used, reason = "a helper outside a test function may fail its test")]

mod support;

use std::ops::Range;

use codec_core::{Gaussian, ShDegree};
use proptest::prelude::*;
use render_host::{Camera, Rendered, ReuseOptions, SequenceRenderer, Settings, Splats, render};

use support::{Scene, TestRng, camera};

fn bits(r: &Rendered) -> Vec<u32> {
    r.image.rgb().iter().chain(&r.transmittance).map(|v| v.to_bits()).collect()
}

fn fresh(scene: &Scene, camera: &Camera, settings: &Settings) -> Rendered {
    let bands = scene.splats().used_bands();
    render(&scene.splats().with_bands(&bands).unwrap(), camera, settings).unwrap()
}

/// Eight sequences, one for every choice of what is kept.
fn sequences() -> Vec<SequenceRenderer> {
    let choices = (0..8).map(|i| ReuseOptions { projection: i & 1 > 0, order: i & 2 > 0, tiles: i & 4 > 0 });
    choices.map(SequenceRenderer::new).collect()
}

/// What happens between two frames.
#[derive(Clone, Copy, Debug)]
enum Edit {
    Nothing,
    Move,
    Vanish,
    Recolour,
    Bands,
    Broken,
    Swap,
    Camera,
    Settings,
    Size,
    Count,
}

const EDITS: [Edit; 11] = [
    Edit::Nothing,
    Edit::Move,
    Edit::Vanish,
    Edit::Recolour,
    Edit::Bands,
    Edit::Broken,
    Edit::Swap,
    Edit::Camera,
    Edit::Settings,
    Edit::Size,
    Edit::Count,
];

/// A scene and a view of it.
struct World {
    scene: Scene,
    camera: Camera,
    settings: Settings,
    r: TestRng,
}

impl World {
    fn new(n: usize, degree: u8, seed: u64, settings: Settings) -> Self {
        let scene = Scene::random(n, degree, 0.004, 0.1, seed);
        Self { scene, camera: camera(120, 90), settings, r: TestRng(seed ^ 0xeda1) }
    }

    /// A few neighbours, or many.
    fn some(&mut self) -> Range<usize> {
        let n = self.scene.gaussians.len();
        let start = (self.r.unit() * n as f32) as usize;
        let length = if self.r.unit() < 0.7 { n / 40 + 1 } else { n };
        start..(start + length).min(n)
    }

    fn apply(&mut self, edit: Edit) {
        let some = self.some();
        let (r, scene) = (&mut self.r, &mut self.scene);
        let each = scene.degree.rest_len();
        let gaussians = &mut scene.gaussians[some.clone()];
        match edit {
            Edit::Nothing => {}
            Edit::Move => gaussians.iter_mut().for_each(|g| {
                g.position = g.position.map(|p| p + r.between(-0.2, 0.2));
                g.rotation[0] += r.between(0.0, 0.5);
            }),
            // Some vanish and some come back.
            Edit::Vanish => gaussians.iter_mut().for_each(|g| {
                g.opacity = if r.unit() < 0.5 { 0.0 } else { r.between(0.02, 1.0) };
            }),
            Edit::Recolour => gaussians.iter_mut().for_each(|g| g.sh0[1] = r.between(-1.0, 1.0)),
            Edit::Bands => {
                let used = if r.unit() < 0.5 { 0 } else { each };
                for rest in scene.rest[some.start * each..some.end * each].chunks_mut(each.max(1)) {
                    rest[..used].fill_with(|| r.between(-0.3, 0.3));
                    rest[used..].fill(0.0);
                }
            }
            Edit::Broken => gaussians.iter_mut().for_each(|g| {
                g.scale[1] = [f32::NAN, -1.0, 1e-9, 0.05][(4.0 * r.unit()) as usize % 4];
            }),
            // Depth order turns while the set of values stays.
            Edit::Swap => gaussians.reverse(),
            Edit::Camera => {
                let eye = [r.between(1.0, 3.0), r.between(-3.0, -1.0), r.between(0.5, 2.0)].map(f64::from);
                let (width, height) = (self.camera.width(), self.camera.height());
                self.camera = Camera::look_at(eye, [0.0; 3], [0.0, 0.0, 1.0], 0.8, width, height).unwrap();
            }
            Edit::Settings => {
                let s = &mut self.settings;
                let switches: [&mut bool; 7] = [
                    &mut s.antialiased,
                    &mut s.early_stop,
                    &mut s.exact_tiles,
                    &mut s.skip_empty_tiles,
                    &mut s.cull_entries,
                    &mut s.sh_by_need,
                    &mut s.parallel,
                ];
                let which = (7.0 * r.unit()) as usize % 7;
                for (i, switch) in switches.into_iter().enumerate() {
                    *switch ^= i == which;
                }
                s.background[0] = r.unit();
            }
            Edit::Size => {
                let (width, height) = (r.between(1.0, 150.0) as u32, r.between(1.0, 110.0) as u32);
                self.camera = camera(width, height);
            }
            Edit::Count => {
                let n = (r.between(0.0, 1.5) * scene.gaussians.len() as f32) as usize;
                *scene = Scene::random(n.min(2000), scene.degree.get(), 0.004, 0.1, u64::from(n as u32));
            }
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(24))]

    /// The promise, for every choice of what is kept.
    #[test]
    fn a_sequence_is_its_frames(
        seed in any::<u64>(), n in 0usize..900, degree in 0u8..3, parallel in any::<bool>(),
        edits in proptest::collection::vec(proptest::sample::subsequence(&EDITS[..], 0..3), 1..9),
    ) {
        let settings = Settings { parallel, ..Settings::over([0.1, 0.5, 0.2]) };
        let mut world = World::new(n, degree, seed, settings);
        let mut sequences = sequences();
        let mut bounded = SequenceRenderer::default().keeping_at_most(n as u64);
        for edits in [Vec::new()].into_iter().chain(edits) {
            edits.iter().for_each(|&edit| world.apply(edit));
            let expected = fresh(&world.scene, &world.camera, &world.settings);
            let (splats, view) = (world.scene.splats(), &world.camera);
            for (i, sequence) in sequences.iter_mut().chain([&mut bounded]).enumerate() {
                let got = sequence.render(&splats, view, &world.settings).unwrap();
                prop_assert_eq!(bits(got), bits(&expected), "sequence {} after {:?}", i, edits);
                prop_assert_eq!(got, &expected, "sequence {} after {:?}", i, edits);
                let r = sequence.reused();
                prop_assert_eq!(r.projected + r.projections_reused, splats.len() as u64);
                prop_assert_eq!(r.tiles_blended + r.tiles_emptied + r.tiles_reused, expected.counters.tiles);
            }
        }
    }
}

#[test]
fn what_stays_is_reused() {
    let mut world = World::new(3000, 1, 3, Settings::default());
    let mut sequence = SequenceRenderer::default();
    let mut show = |world: &World| {
        let (splats, camera) = (world.scene.splats(), &world.camera);
        let got = sequence.render(&splats, camera, &world.settings).unwrap();
        assert_eq!(bits(got), bits(&fresh(&world.scene, camera, &world.settings)));
        sequence.reused()
    };
    let first = show(&world);
    assert_eq!((first.projected, first.tiles_reused, first.lists_made), (3000, 0, 48));
    let idle = show(&world);
    assert_eq!((idle.projected, idle.changed, idle.sorted, idle.tiles_reused), (0, 0, 0, 48));
    // One splat takes another colour: its tiles, no lists.
    let small = (0..3000).find(|&i| world.scene.gaussians[i].position.iter().all(|p| p.abs() < 0.2)).unwrap();
    world.scene.gaussians[small].sh0 = [1.0, -1.0, 1.0];
    let recoloured = show(&world);
    assert_eq!((recoloured.projected, recoloured.changed), (1, 1));
    assert_eq!((recoloured.lists_reused, recoloured.sorted), (48, 0));
    assert!(recoloured.tiles_blended > 0 && recoloured.tiles_reused > 24, "{recoloured:?}");
    // It moves: the lists of its tiles are mended, nothing is sorted.
    world.scene.gaussians[small].position[0] += 0.2;
    let moved = show(&world);
    assert!(moved.lists_mended > 0 && moved.lists_mended + moved.lists_reused == 48 && moved.sorted == 0);
    // Gone, and back.
    let before = std::mem::replace(&mut world.scene.gaussians[small], Gaussian::ABSENT);
    assert_eq!(show(&world).changed, 1);
    world.scene.gaussians[small] = before;
    assert_eq!(show(&world).changed, 1);
    // Everything moves: everything is made, but nothing is lost.
    world.scene.gaussians.iter_mut().for_each(|g| g.position[1] += 0.01);
    let all = show(&world);
    assert_eq!((all.projected, all.lists_made), (3000, 48));
    // Another camera starts from nothing, even if no Gaussian changed.
    world.apply(Edit::Camera);
    assert_eq!((show(&world).projected, show(&world).projected), (3000, 0));
}

/// Rows of very long lists are binned anew, however little changed.
#[test]
fn long_lists_are_made() {
    let mut world = World::new(2000, 0, 5, Settings::default());
    world.camera = camera(16, 16);
    let mut sequence = SequenceRenderer::default();
    for frame in 0..4 {
        if frame > 0 {
            world.scene.gaussians[40 * frame] = Gaussian::ABSENT;
        }
        let got = sequence.render(&world.scene.splats(), &world.camera, &world.settings);
        assert_eq!(got.unwrap(), &fresh(&world.scene, &world.camera, &world.settings));
        let reused = sequence.reused();
        assert_eq!((reused.lists_made, reused.lists_mended), (1, 0), "{reused:?}");
    }
}

/// Degrees that the caller gives are obeyed in each frame, even where no Gaussian changed.
#[test]
fn given_bands_are_looked_at() {
    let world = World::new(400, 2, 8, Settings::default());
    let mut sequence = SequenceRenderer::default();
    let mut before = Vec::new();
    for degree in [2, 0, 1, 1] {
        let bands = vec![degree; 400];
        let splats = world.scene.splats().with_bands(&bands).unwrap();
        let got = sequence.render(&splats, &world.camera, &world.settings).unwrap();
        assert_eq!(got, &render(&splats, &world.camera, &world.settings).unwrap());
        before.push(bits(got));
    }
    assert!(before[0] != before[1] && before[1] != before[2] && before[2] == before[3]);
}

#[test]
fn a_refused_frame_changes_nothing() {
    let world = World::new(300, 0, 2, Settings::default());
    let mut sequence = SequenceRenderer::default();
    let bad = Settings { alpha_max: 7.0, ..Settings::default() };
    sequence.render(&world.scene.splats(), &world.camera, &world.settings).unwrap();
    let before = sequence.picture().clone();
    let none = Splats::new(&[], &[], ShDegree::ZERO).unwrap();
    assert!(sequence.render(&none, &world.camera, &bad).is_err());
    assert_eq!(sequence.picture(), &before);
    let got = sequence.render(&world.scene.splats(), &world.camera, &world.settings);
    assert_eq!(got.unwrap(), &before);
    sequence.forget();
    sequence.render(&world.scene.splats(), &world.camera, &world.settings).unwrap();
    assert_eq!(sequence.reused().projected, 300);
    assert_eq!(sequence.picture(), &before);
}
