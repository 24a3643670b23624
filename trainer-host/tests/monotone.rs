//! More levels are never worse: pictures of one stream at levels 0 to 3, from held-out cameras, for the
//! whole scene and for one group at a time.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use codec_core::internals::{receiver::for_each_cell, wire::manifest::Profile};
use render_host::{Camera, Image, Renderer, Settings, Splats, metric};
use trainer_host::{
    Scene,
    encode::{EncodeOptions, encode},
    import::{
        Limits,
        synth::{self, SynthKind},
    },
    stream::{PacketMap, Player, Stream},
    viewpoint::{Framing, Ring},
};

const FRAME: u32 = 5;

/// Falls of PSNR among the steps that were taken.
#[derive(Debug, Default, PartialEq)]
struct Steps {
    taken: usize,
    fallen: usize,
    /// The deepest fall, dB.
    worst_db: f64,
}

impl Steps {
    fn take(&mut self, before_db: f64, after_db: f64) {
        self.taken += 1;
        self.fallen += usize::from(after_db < before_db);
        self.worst_db = self.worst_db.max(before_db - after_db);
    }
}

/// A stream, and what its pictures are compared with.
struct Subject {
    stream: Stream,
    /// Cameras and the source's pictures from them.
    views: Vec<(Camera, Image)>,
}

fn picture(instant: &trainer_host::Instant, camera: &Camera) -> Image {
    let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
    Renderer::new().render(&splats, camera, &Settings::default()).unwrap().image
}

impl Subject {
    fn new(scene: &Scene, profile: Profile) -> Self {
        let mut options = match profile {
            Profile::Dgs1 => EncodeOptions::default(),
            Profile::Paper => EncodeOptions::paper(),
        };
        options.cluster.max_gaussians = 200;
        let stream = encode(scene, &options, &trainer_host::encode::no_progress).unwrap().stream;
        let cameras = Framing::of(scene).ring(Ring::HeldOut, 2, (80, 60)).unwrap();
        let source = scene.instant(FRAME as usize).unwrap();
        let views = cameras.into_iter().map(|camera| (camera.clone(), picture(&source, &camera))).collect();
        Self { stream, views }
    }

    /// PSNR per view of each of `states`.
    fn scores(&self, states: &[Vec<u8>]) -> Vec<Vec<f64>> {
        let manifest = self.stream.manifest().unwrap();
        let received = self.stream.receive().unwrap();
        let mut player = Player::new(&manifest);
        let mut score = |state: &Vec<u8>| -> Vec<f64> {
            let instant = player.instant(&received.content().with_state(state), FRAME).unwrap();
            let psnr = |(camera, source): &(Camera, Image)| {
                metric::psnr(&picture(&instant, camera), source).unwrap()
            };
            self.views.iter().map(psnr).collect()
        };
        states.iter().map(&mut score).collect()
    }

    /// The state in which everything up to `level` has arrived.
    fn state(&self, initial: &[u8], level: u8) -> Vec<u8> {
        initial.iter().map(|mask| mask | ((2 << level) - 1)).collect()
    }

    /// Steps of the whole scene from each level to the next.
    fn whole(&self) -> Steps {
        let initial = PacketMap::of(&self.stream).unwrap().initial().to_vec();
        let states: Vec<Vec<u8>> = (0..4).map(|level| self.state(&initial, level)).collect();
        let mut steps = Steps::default();
        for pair in self.scores(&states).windows(2) {
            pair[0].iter().zip(&pair[1]).for_each(|(before, after)| steps.take(*before, *after));
        }
        steps
    }

    /// Steps of one group alone, the others staying at the level below.
    fn groups(&self) -> Steps {
        let manifest = self.stream.manifest().unwrap();
        let initial = PacketMap::of(&self.stream).unwrap().initial().to_vec();
        let (mut cells, mut end) = (Vec::new(), 0);
        for_each_cell(&manifest, |_, _, shape| {
            cells.push(end..end + shape.blocks());
            end += shape.blocks();
            Ok(())
        })
        .unwrap();
        let mut steps = Steps::default();
        for level in 0..3u8 {
            let below = self.state(&initial, level);
            let raised = |cell: &std::ops::Range<usize>| {
                let mut state = below.clone();
                state[cell.clone()].iter_mut().for_each(|mask| *mask |= 2 << level);
                state
            };
            let with_symbols = |cell: &&std::ops::Range<usize>| below[cell.start] >> (level + 1) & 1 == 0;
            let mut states = vec![below.clone()];
            states.extend(cells.iter().filter(with_symbols).map(raised));
            let scores = self.scores(&states);
            for score in &scores[1..] {
                scores[0].iter().zip(score).for_each(|(before, after)| steps.take(*before, *after));
            }
        }
        steps
    }
}

#[test]
fn no_level_makes_a_picture_worse() {
    for kind in SynthKind::ALL {
        let options =
            synth::SynthOptions { kind, gaussians: 1000, frames: 10, frames_per_second: 20.0, seed: 3 };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        for profile in [Profile::Dgs1, Profile::Paper] {
            let subject = Subject::new(&scene, profile);
            let (whole, groups) = (subject.whole(), subject.groups());
            println!("{} {profile:?}: scene {whole:?}, groups {groups:?}", kind.name());
            assert_eq!((whole.taken, whole.fallen), (6, 0), "{} {profile:?}: {whole:?}", kind.name());
            // A group alone may cost a little before its neighbours follow; more than a quarter do not.
            assert!(groups.taken > 20 && 4 * groups.fallen <= groups.taken, "{groups:?}");
        }
    }
}

/// The comparison sees a fall: levels taken away one by one are one at every step.
#[test]
fn levels_taken_away_are_falls() {
    let mut steps = Steps::default();
    steps.take(30.0, 31.0);
    assert_eq!(steps, Steps { taken: 1, fallen: 0, worst_db: 0.0 });
    steps.take(31.0, 29.0);
    assert_eq!(steps, Steps { taken: 2, fallen: 1, worst_db: 2.0 });
    let options = synth::SynthOptions { gaussians: 1000, frames: 10, ..synth::SynthOptions::default() };
    let scene = synth::make(&options, &Limits::default()).unwrap();
    let subject = Subject::new(&scene, Profile::Dgs1);
    let initial = PacketMap::of(&subject.stream).unwrap().initial().to_vec();
    let states: Vec<Vec<u8>> = (0..4).rev().map(|level| subject.state(&initial, level)).collect();
    let mut steps = Steps::default();
    for pair in subject.scores(&states).windows(2) {
        pair[0].iter().zip(&pair[1]).for_each(|(before, after)| steps.take(*before, *after));
    }
    assert_eq!((steps.taken, steps.fallen), (6, 6));
}
