//! The streams under attack, and memory to receive them in.

use std::sync::OnceLock;

use codec_core::{Caps, ErrorKind};
use dgs_player::Player;
use trainer_host::{
    encode::{EncodeOptions, Protection, Strength, encode},
    import::{
        Limits,
        synth::{self, SynthKind},
    },
    scene::{Attributes, Epoch, Scene, Track},
    stream::Stream,
};

/// A scene with two epochs, several windows, tracks and coefficients.
fn scene() -> Option<Scene> {
    let options = synth::SynthOptions {
        kind: SynthKind::Births,
        gaussians: 1000,
        frames: 8,
        frames_per_second: 8.0,
        seed: 3,
    };
    synth::make(&options, &Limits::default()).ok()
}

/// `dgs1` with several packets in everything, and parity of several rows.
fn dgs1(packet_bytes: usize) -> EncodeOptions {
    EncodeOptions {
        block_len: 16,
        window_frames: Some(3),
        repair: Protection { refinements: [None, Some(Strength::share(9, 2)), None], ..Protection::STANDARD },
        packet_bytes,
        ..EncodeOptions::default()
    }
}

/// The streams under attack, one per profile (`dgs1`, `paper`): two epochs, several windows,
/// tracks, coefficients, parity. Encoded once.
pub fn fixture(paper: bool) -> &'static Stream {
    static STREAMS: OnceLock<Vec<Stream>> = OnceLock::new();
    let streams = STREAMS.get_or_init(|| {
        let all = [dgs1(400), EncodeOptions { repair: Protection::xor(4), ..EncodeOptions::paper() }];
        let encoded = |scene: Scene| {
            all.clone()
                .map(|options| encode(&scene, &options, &trainer_host::encode::no_progress).map(|e| e.stream))
        };
        scene().into_iter().flat_map(encoded).flatten().collect()
    });
    assert_eq!(streams.len(), 2, "both profiles encode");
    &streams[usize::from(paper)]
}

/// A few Gaussians cut into small and into large packets, received whole. Encoded once.
pub fn cuts() -> &'static [(Stream, Player)] {
    static CUTS: OnceLock<Vec<(Stream, Player)>> = OnceLock::new();
    CUTS.get_or_init(|| {
        let encoded = |scene: Scene| {
            [200, 1150].map(|bytes| {
                encode(&scene, &dgs1(bytes), &trainer_host::encode::no_progress).map(|e| e.stream)
            })
        };
        let streams = few().into_iter().flat_map(encoded).flatten();
        let received = |stream: Stream| {
            let player = stream.receive().ok()?;
            Some((stream, player))
        };
        streams.filter_map(received).collect()
    })
}

/// As [`fixture`], of few Gaussians: cheap to decode, and an edit changes much of it. Encoded once.
pub fn small(paper: bool) -> &'static Stream {
    static STREAMS: OnceLock<Vec<Stream>> = OnceLock::new();
    let streams = STREAMS.get_or_init(|| {
        let all = [dgs1(200), EncodeOptions { repair: Protection::xor(4), ..EncodeOptions::paper() }];
        let encoded = |scene: Scene| {
            all.clone()
                .map(|options| encode(&scene, &options, &trainer_host::encode::no_progress).map(|e| e.stream))
        };
        few().into_iter().flat_map(encoded).flatten().collect()
    });
    assert_eq!(streams.len(), 2, "both profiles encode");
    &streams[usize::from(paper)]
}

/// Every sixteenth Gaussian of a scene with two epochs.
fn few() -> Option<Scene> {
    let options = synth::SynthOptions {
        kind: SynthKind::Births,
        gaussians: 1000,
        frames: 6,
        frames_per_second: 6.0,
        seed: 5,
    };
    let scene = synth::make(&options, &Limits::default()).ok()?;
    let epochs = scene.epochs().iter().map(|epoch| {
        let (n, frames, all) = (epoch.count(), epoch.frames(), epoch.attributes());
        Epoch::new(
            frames,
            Attributes {
                positions: thin(&all.positions, n, frames),
                rotations: thin(&all.rotations, n, frames),
                log_scales: thin(&all.log_scales, n, frames),
                opacity_logits: thin(&all.opacity_logits, n, frames),
                sh0: thin(&all.sh0, n, frames),
                sh_rest: all
                    .sh_rest
                    .chunks(all.sh_degree.rest_len().max(1))
                    .step_by(16)
                    .flatten()
                    .copied()
                    .collect(),
                sh_degree: all.sh_degree,
            },
        )
    });
    Scene::new(epochs.collect::<Result<_, _>>().ok()?, scene.frames_per_second()).ok()
}

fn thin<T: Copy + PartialEq>(track: &Track<T>, n: usize, frames: usize) -> Track<T> {
    let frame = |t| track.frame(t, n).iter().step_by(16).copied();
    Track::PerFrame((0..frames).flat_map(frame).collect())
}

/// Largest stream that a body decodes; what is larger costs time and teaches nothing more.
pub const CAPS: Caps =
    Caps { symbols: 1 << 20, blocks: 1 << 20, parity_bytes: 16 << 20, early_bytes: 0, ..Caps::HOST };

/// A player of the stream of `message`, whose manifest parses; `None` if a cap refuses it, and nothing
/// else may.
pub fn player(message: &[u8]) -> Option<Player> {
    match Player::new(message, &CAPS) {
        Ok(player) => Some(player),
        Err(error) => {
            assert_eq!(error.kind, ErrorKind::Capacity, "{error}");
            None
        }
    }
}
