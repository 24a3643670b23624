//! Writes the golden streams of codec-core:
//! `cargo test -p trainer-host --test golden -- --ignored`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

#[allow(dead_code, reason = "the tests of codec-core use the rest")]
#[path = "../../codec-core/tests/conformance/session.rs"]
mod session;

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use codec_core::internals::{gaussian::ShDegree, ids::Level, quant::Class};
use trainer_host::{
    Epoch, Scene,
    encode::{
        Decisions, EncodeError, EncodeOptions, Protection,
        decisions::{Dgs1Decisions, TableSetEntry},
        encode, write,
    },
    scene::{Attributes, Track},
};

/// What a made epoch does over time.
#[derive(Clone, Copy, Default)]
struct Motion {
    /// One half glides, the other turns.
    rigid: bool,
    /// Everything waves for itself.
    wave: bool,
    /// Sizes, colours and opacities breathe.
    breath: bool,
}

/// A value in −1..1 for an index.
fn noise(i: usize) -> f32 {
    let x = (i as u32).wrapping_mul(2_654_435_761) ^ 0x5bd1_e995;
    let x = (x ^ x >> 15).wrapping_mul(0x2c1b_3c6d);
    (x >> 8) as f32 / (1 << 23) as f32 - 1.0
}

fn epoch(n: usize, frames: usize, degree: u8, motion: Motion, seed: usize) -> Epoch {
    let degree = ShDegree::new(degree).unwrap();
    let at = |i: usize, k: usize| noise(seed + 31 * i + 7 * k);
    let phase = |i: usize, t: usize| ((i % 5) as f32 + t as f32 * 0.7).sin();
    let side = |i: usize| if i.is_multiple_of(2) { -2.0 } else { 2.0 };
    let place = |i: usize, t: usize| {
        let [mut x, mut y, mut z] = [at(i, 0), at(i, 1), at(i, 2)];
        if motion.rigid && i % 2 == 1 {
            let (sin, cos) = (t as f32 * 0.2).sin_cos();
            (x, z) = (x * cos - z * sin, x * sin + z * cos);
        } else if motion.rigid {
            y += t as f32 * 0.1;
        }
        if motion.wave {
            z += 0.2 * phase(i, t);
        }
        [x + side(i), y, z]
    };
    let turn = |i: usize, t: usize| {
        let half = if motion.rigid && i % 2 == 1 { t as f32 * -0.1 } else { 0.0 };
        let q = [1.0, 0.3 * at(i, 3), 0.3 * at(i, 4) + half.tan(), 0.3 * at(i, 5)];
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        q.map(|v| v / length)
    };
    let breath = |i: usize, t: usize| if motion.breath { 0.3 * phase(i, t) } else { 0.0 };
    // With harmonics, channels go together and Gaussians are balls of equal flatness.
    let colour = |seed: usize, i: usize, k: usize| {
        if degree.get() > 0 {
            noise(seed + 5 * i) + 0.1 * noise(seed + 31 * i + 7 * k)
        } else {
            at(i, 10 + k)
        }
    };
    let size =
        |i: usize, k: usize| if degree.get() > 0 { 0.5 * at(i, 6) - k as f32 } else { 0.5 * at(i, 6 + k) };
    fn track<T: Copy>(n: usize, frames: usize, value: impl Fn(usize, usize) -> T) -> Track<T> {
        Track::PerFrame(
            (0..frames).flat_map(|t| (0..n).map(move |i| (i, t))).map(|(i, t)| value(i, t)).collect(),
        )
    }
    let attributes = Attributes {
        positions: track(n, frames, place).collapse(n),
        rotations: track(n, frames, turn).collapse(n),
        log_scales: track(n, frames, |i, t| [0, 1, 2].map(|k| -3.0 + size(i, k) + breath(i, t))).collapse(n),
        opacity_logits: track(n, frames, |i, t| 2.0 * at(i, 9) + 1.0 + breath(i, t)).collapse(n),
        sh0: track(n, frames, |i, t| [0, 1, 2].map(|k| colour(seed, i, k) + breath(i, t))).collapse(n),
        sh_degree: degree,
        sh_rest: (0..n * degree.rest_len()).map(|i| 0.2 * colour(seed + 977, i / 3, i % 3)).collect(),
    };
    Epoch::new(frames, attributes).unwrap()
}

/// `epoch` with two in three of its Gaussians small and faint.
fn fading(epoch: &Epoch) -> Epoch {
    let mut attributes = epoch.attributes().clone();
    let (Track::Constant(logits), Track::Constant(sizes)) =
        (&mut attributes.opacity_logits, &mut attributes.log_scales)
    else {
        panic!("a still epoch");
    };
    for (i, (logit, size)) in logits.iter_mut().zip(sizes).enumerate().filter(|(i, _)| i % 3 != 0) {
        *logit -= 4.0 + (i % 2) as f32;
        size.iter_mut().for_each(|s| *s -= 1.0);
    }
    Epoch::new(1, attributes).unwrap()
}

fn scene(epochs: Vec<Epoch>) -> Scene {
    Scene::new(epochs, 10.0).unwrap()
}

/// Name, what it exercises, scene, options.
fn all() -> Vec<(&'static str, &'static str, Scene, EncodeOptions)> {
    let still = Motion::default();
    let rigid = Motion { rigid: true, ..still };
    let wave = Motion { wave: true, ..rigid };
    let breath = Motion { breath: true, ..wave };
    let small = |block_len, packet_bytes| {
        let mut options =
            EncodeOptions { block_len, packet_bytes, window_frames: Some(4), ..EncodeOptions::default() };
        options.cluster.max_gaussians = 64;
        options.cluster.min_gaussians = 32;
        options
    };
    let with = |text: &str, options: EncodeOptions| EncodeOptions {
        repair: Protection::parse(text).unwrap(),
        ..options
    };
    let mut paper = EncodeOptions { packet_bytes: 1150, ..EncodeOptions::paper() };
    paper.cluster.max_gaussians = 64;
    vec![
        ("one", "one Gaussian, one frame", scene(vec![epoch(1, 1, 0, still, 1)]), small(64, 1150)),
        (
            "still",
            "one frame, several blocks and packets",
            scene(vec![epoch(150, 1, 0, still, 2)]),
            small(16, 200),
        ),
        (
            "harmonics",
            "bands 1 to 3 in refinements only",
            scene(vec![epoch(70, 1, 3, still, 3)]),
            small(16, 400),
        ),
        (
            "quantiser-classes",
            "several quantisers, some with fewer refinements",
            scene(vec![fading(&epoch(900, 1, 0, still, 14))]),
            small(64, 1150),
        ),
        ("tracks", "clusters that glide and turn", scene(vec![epoch(120, 8, 0, rigid, 4)]), small(64, 400)),
        (
            "coefficients",
            "positions that wave, three windows of which the last is short",
            scene(vec![epoch(120, 10, 0, wave, 5)]),
            small(32, 400),
        ),
        (
            "everything",
            "all attributes move, two epochs, degree 1",
            scene(vec![epoch(90, 6, 1, breath, 6), epoch(60, 5, 1, breath, 7)]),
            small(16, 300),
        ),
        ("blocks-of-one", "a block per Gaussian", scene(vec![epoch(40, 3, 0, wave, 8)]), small(1, 200)),
        (
            "xor",
            "one parity packet per set of base levels",
            scene(vec![epoch(150, 6, 0, wave, 9)]),
            EncodeOptions { repair: Protection::xor(4), ..small(8, 200) },
        ),
        (
            "cauchy",
            "unequal protection: up to three losses per set, refinements too",
            scene(vec![epoch(150, 6, 0, wave, 10)]),
            with("base=8+3,tracks=4+2,1=12+2,3=20+1", small(8, 200)),
        ),
        (
            "cauchy-eight",
            "sets of up to 64 packets with eight parity packets",
            scene(vec![epoch(400, 1, 0, still, 11)]),
            with("base=64+8,1=64+8", small(4, 200)),
        ),
        ("paper", "profile paper", scene(vec![epoch(60, 5, 1, wave, 12)]), paper.clone()),
        (
            "paper-repaired",
            "profile paper with parity",
            scene(vec![epoch(60, 5, 0, rigid, 13)]),
            EncodeOptions { repair: Protection::parse("base=4+2").unwrap(), ..paper },
        ),
    ]
}

fn folder() -> std::path::PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../codec-core/tests/conformance")
}

#[test]
#[ignore = "writes committed files"]
fn write_golden() {
    let mut lines = Vec::new();
    for (name, exercises, scene, options) in all() {
        let stream = encode(&scene, &options, &trainer_host::encode::no_progress).unwrap().stream;
        let bytes = stream.to_bytes().unwrap();
        std::fs::write(folder().join(format!("{name}.dgs")), &bytes).unwrap();
        lines.push(session::Line::of(name, exercises, &bytes).text());
    }
    // The streams made by hand are written by codec-core's own test.
    let index = std::fs::read_to_string(folder().join("index.txt")).unwrap();
    lines.extend(index.lines().filter(|line| line.starts_with("made-")).map(str::to_owned));
    std::fs::write(folder().join("index.txt"), lines.join("\n") + "\n").unwrap();
}

/// Where the length and the digest of every encoding are written down.
fn encodings() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/golden/encodings.txt")
}

/// `NAME LENGTH DIGEST` of the bytes of a file; the digest is FNV-1a 64.
fn encoding(name: &str, bytes: &[u8]) -> String {
    let step = |digest: u64, byte: &u8| (digest ^ u64::from(*byte)).wrapping_mul(0x0100_0000_01b3);
    format!("{name} {} {:016x}", bytes.len(), bytes.iter().fold(0xcbf2_9ce4_8422_2325, step))
}

#[test]
#[ignore = "writes a committed file"]
fn write_encodings() {
    let bytes = |scene, options| {
        encode(scene, options, &trainer_host::encode::no_progress).unwrap().stream.to_bytes().unwrap()
    };
    let lines: Vec<String> =
        all().iter().map(|(name, _, scene, options)| encoding(name, &bytes(scene, options))).collect();
    std::fs::create_dir_all(encodings().parent().unwrap()).unwrap();
    std::fs::write(encodings(), lines.join("\n") + "\n").unwrap();
}

/// The encoder writes today what is written down, to the byte; its decisions, read back from JSON, replay to
/// the same bytes, and with another step to others. The golden streams themselves are older than some of
/// the encoder's choices; that they decode to what they did is tested in codec-core.
#[test]
fn encoding_and_replaying_decisions_give_the_bytes_written_down() {
    let pinned = std::fs::read_to_string(encodings()).unwrap();
    let pinned: BTreeSet<&str> = pinned.lines().collect();
    for (name, _, scene, options) in all() {
        let encoded = encode(&scene, &options, &trainer_host::encode::no_progress).unwrap();
        let bytes = encoded.stream.to_bytes().unwrap();
        let found = encoding(name, &bytes);
        assert!(pinned.contains(found.as_str()), "{found} is not in encodings.txt");
        let json = serde_json::to_string(&encoded.decisions).unwrap();
        let mut decisions: Decisions = serde_json::from_str(&json).unwrap();
        assert!(decisions == encoded.decisions, "{name}");
        let replayed =
            |decisions: &Decisions| write(&scene, decisions, &trainer_host::encode::no_progress).unwrap();
        let again = replayed(&decisions);
        assert!(again.stream.to_bytes().unwrap() == bytes, "{name} replayed");
        assert_eq!((again.order, again.report), (encoded.order, encoded.report), "{name}");
        let quantisers = match &mut decisions {
            Decisions::Dgs1(decisions) => &mut decisions.epochs[0].quantisers[0],
            Decisions::Paper(decisions) => &mut decisions.epochs[0].quantisers,
        };
        quantisers.canonical[Class::Scale.index()].step *= 1.25;
        assert!(replayed(&decisions).stream.to_bytes().unwrap() != bytes, "{name} with another step");
    }
}

/// Decisions that do not fit the scene are refused with the place and the field at fault.
#[test]
fn decisions_that_do_not_fit_are_named() {
    let (.., scene, options) = all().into_iter().find(|(name, ..)| *name == "coefficients").unwrap();
    let good = encode(&scene, &options, &trainer_host::encode::no_progress).unwrap().decisions;
    let Decisions::Dgs1(good) = good else { panic!("profile dgs1") };
    let refused = |change: fn(&mut Dgs1Decisions)| {
        let mut changed = good.clone();
        change(&mut changed);
        write(&scene, &Decisions::Dgs1(changed), &trainer_host::encode::no_progress).unwrap_err().to_string()
    };
    type Spoil = fn(&mut Dgs1Decisions);
    let cases: [(Spoil, &str); 8] = [
        (|d| d.epochs.clear(), "number of epochs is 0"),
        (|d| d.block_len = 0, "block_len is 0"),
        (|d| d.epochs[0].clusters[1].gaussians[0] = 999, "epoch 0, cluster 1: gaussians is 999"),
        (|d| d.epochs[0].clusters[0].quantisers = 7, "epoch 0, cluster 0: quantisers is 7"),
        (|d| d.epochs[0].windows[1].frames += 1, "epoch 0, window 1: length of a basis vector"),
        (|d| d.epochs[0].windows[0].motions[0].ranks[0] = 60, "epoch 0, window 0, cluster 0: ranks is 60"),
        (|d| d.epochs[0].clusters[0].table_indices[0].clear(), "cluster 0: table_indices is too few"),
        (|d| d.table_sets[0] = vec![TableSetEntry { table: 200, code_bits: 0 }], "table set 0: table is 200"),
    ];
    for (change, wanted) in cases {
        let message = refused(change);
        assert!(message.contains(wanted), "{message:?} lacks {wanted:?}");
    }
    // A step so fine that a block no longer fits a packet has an error of its own.
    let mut fine = good;
    for quantisers in &mut fine.epochs[0].quantisers {
        for class in [Class::Scale, Class::Opacity, Class::Sh0] {
            quantisers.canonical[class.index()].step *= 1e-4;
        }
    }
    let error = write(&scene, &Decisions::Dgs1(fine), &trainer_host::encode::no_progress).unwrap_err();
    assert!(matches!(error, EncodeError::BlockTooLarge { .. }), "{error}");
}

#[test]
fn harmonics_are_decorrelated_and_noise_is_not() {
    let decorrelated = |wanted: &str| {
        let (.., scene, options) = all().into_iter().find(|(name, ..)| *name == wanted).unwrap();
        let stream = encode(&scene, &options, &trainer_host::encode::no_progress).unwrap().stream;
        let received = stream.receive().unwrap();
        let quant = received.content().manifest.quant(0).unwrap();
        Class::ALL.map(|class| quant.canonical[class.index()].decorrelated())
    };
    assert_eq!(decorrelated("harmonics"), Class::ALL.map(Class::decorrelates));
    assert_eq!(decorrelated("paper"), [false; Class::COUNT]);
    assert!(!decorrelated("coefficients")[Class::Sh0.index()]);
}

#[test]
fn quantiser_classes_have_quantisers_of_their_own() {
    let (.., scene, options) = all().into_iter().find(|(name, ..)| *name == "quantiser-classes").unwrap();
    let stream = encode(&scene, &options, &trainer_host::encode::no_progress).unwrap().stream;
    let manifest = stream.manifest().unwrap();
    let quants: Vec<_> = (0..manifest.head().quants).map(|q| manifest.quant(q as u8).unwrap()).collect();
    assert!(quants.len() > 1);
    let last = |q: &codec_core::internals::wire::manifest::Quant| {
        q.canonical[Class::Scale.index()].ratio(Level::ALL[3])
    };
    assert!(quants.iter().any(|q| last(q) == 1) && quants.iter().any(|q| last(q) == 3));
}

/// Name of a stream and what it exercises.
fn title(line: &str) -> String {
    line.split(" | ").take(2).collect::<Vec<_>>().join(" | ")
}

/// The index names what this file would write, beside the streams made by hand; the bytes are the encoder's
/// to change.
#[test]
fn the_index_is_of_these_streams() {
    let index = std::fs::read_to_string(folder().join("index.txt")).unwrap();
    let listed: BTreeSet<String> = index.lines().filter(|l| !l.starts_with("made-")).map(title).collect();
    let made = all().into_iter().map(|(name, exercises, ..)| format!("{name} | {exercises}")).collect();
    assert_eq!(listed, made);
}
