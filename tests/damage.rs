//! Damaged files as a person meets them: each is refused with a sentence that names field, place,
//! what was found and what is allowed, or gives what it still holds and says what is missing.
//!
//! `damage/README.md` lists the files and is the input of these tests. They are made by
//! `cargo test --test damage -- --ignored`, from formulas and from the corpus of `fuzz`.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::{
    collections::BTreeSet,
    path::{Path, PathBuf},
};

use codec_core::{
    Gaussian,
    internals::wire::{crc::crc32, manifest},
};
use emulator_host::{
    Nanos, Trace,
    trace::{self, DelayTrace, Direction, HoldDirection, Replay},
};
use trainer_host::{
    Scene, Stream,
    encode::{EncodeOptions, Protection, encode},
    export::{ply as ply_writer, spz as spz_writer},
    import::{self, Limits, import},
    stream::Player,
};

fn root() -> &'static Path {
    Path::new(env!("CARGO_MANIFEST_DIR"))
}

fn folder() -> PathBuf {
    root().join("tests/damage")
}

/// A line of the table: file, what is wrong, how much is readable, what is said.
struct Case {
    file: String,
    readable: Option<usize>,
    says: Vec<String>,
}

fn cases() -> Vec<Case> {
    let text = std::fs::read_to_string(folder().join("README.md")).unwrap();
    let rows = text.lines().filter(|l| l.starts_with("| `"));
    let case = |line: &str| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [file, _, readable, says] = cells[..] else { panic!("four cells: {line}") };
        Case {
            file: file.trim_matches('`').to_owned(),
            readable: readable.parse().ok(),
            says: says.split('`').skip(1).step_by(2).map(str::to_owned).collect(),
        }
    };
    rows.map(case).collect()
}

fn assert_says(case: &Case, text: &str) {
    assert!(!case.says.is_empty(), "{}", case.file);
    for part in &case.says {
        assert!(text.contains(part), "{}: {text:?} does not say {part:?}", case.file);
    }
}

fn assert_drawable(gaussians: &[Gaussian]) {
    for g in gaussians {
        assert!(g.position.iter().chain(&g.scale).chain(&g.sh0).all(|v| v.is_finite()), "{g:?}");
        assert!((g.rotation.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4, "{g:?}");
        assert!((0.0..=1.0).contains(&g.opacity), "{g:?}");
    }
}

#[test]
fn the_table_and_the_folder_agree() {
    let listed: BTreeSet<String> = cases().into_iter().map(|c| c.file).collect();
    let there: BTreeSet<String> = std::fs::read_dir(folder())
        .unwrap()
        .map(|e| e.unwrap().file_name().into_string().unwrap())
        .filter(|n| n != "README.md" && n != "whole.dgs")
        .collect();
    assert_eq!(listed, there);
    assert!(listed.len() > 30);
}

#[test]
fn damaged_streams() {
    let (whole, damage) = Stream::from_bytes(&std::fs::read(folder().join("whole.dgs")).unwrap()).unwrap();
    assert!(damage.is_none(), "{damage}");
    for case in cases().iter().filter(|c| c.file.ends_with(".dgs")) {
        let bytes = std::fs::read(folder().join(&case.file)).unwrap();
        match (Stream::from_bytes(&bytes), case.readable) {
            (Err(error), None) => assert_says(case, &error.to_string()),
            (Ok((stream, damage)), Some(readable)) => {
                assert_says(case, &damage.to_string());
                let left = stream.packets().iter().filter(|p| !p.is_empty()).count();
                assert_eq!(left, readable, "{}", case.file);
                for (id, packet) in stream.packets().iter().enumerate().filter(|(_, p)| !p.is_empty()) {
                    assert_eq!(packet, &whole.packets()[id], "{}: packet {id}", case.file);
                }
                let received = stream.receive().unwrap();
                let manifest = stream.manifest().unwrap();
                for frame in 0..manifest.head().frames {
                    let instant = Player::new(&manifest).instant(&received.content(), frame).unwrap();
                    assert_drawable(&instant.gaussians);
                }
            }
            (Ok(_), None) => panic!("{} is not refused", case.file),
            (Err(error), Some(_)) => panic!("{} is refused: {error}", case.file),
        }
    }
}

#[test]
fn damaged_scenes() {
    let scenes =
        ["ply", "splat", "ksplat", "splatv", "4dgs", "spz", "sog", "glb", "npz", "safetensors", "asset"];
    for case in cases().iter().filter(|c| scenes.iter().any(|e| c.file.ends_with(&format!(".{e}")))) {
        let path = folder().join(&case.file);
        let error = import(&path, &import::ImportOptions::default()).expect_err(&case.file);
        let text = error.to_string();
        assert_says(case, &text);
        for part in [case.file.as_str(), "found", "allowed"] {
            assert!(text.contains(part), "{text:?} does not say {part:?}");
        }
        let limits = Limits { keep_readable: true, ..Limits::default() };
        let readable = import(&path, &import::ImportOptions { limits, ..import::ImportOptions::default() });
        match (readable, case.readable) {
            (Ok(scene), Some(readable)) => {
                assert_eq!(scene.max_count(), readable, "{}", case.file);
                assert!(!scene.notes.is_empty(), "{} says what is missing", case.file);
                assert_drawable(&scene.instant(0).unwrap().gaussians);
            }
            (Ok(scene), None) => panic!("{} gives {} Gaussians", case.file, scene.max_count()),
            (Err(error), Some(_)) => panic!("{}: {error}", case.file),
            (Err(_), None) => {}
        }
    }
}

#[test]
fn damaged_traces() {
    let limits = trace::Limits::default();
    let loaded = |file: &str, bytes: &[u8]| {
        let extension = file.rsplit('.').next().unwrap();
        Some(match extension {
            "mahimahi" => Trace::mahimahi(file, bytes, &limits).err(),
            "columns" => Trace::two_column(file, bytes, HoldDirection::Forward, &limits).err(),
            "csv" => Trace::ucc(file, bytes, Direction::Down, &limits).err(),
            "replay" => Replay::load(file, bytes, &limits).err(),
            "delay" => DelayTrace::load(bytes, Nanos::from_ms(10), &limits).err(),
            _ => return None,
        })
    };
    let mut checked = 0;
    for case in cases() {
        let bytes = trace::read(&folder().join(&case.file), &limits).unwrap();
        let Some(error) = loaded(&case.file, &bytes) else { continue };
        assert_says(&case, &error.unwrap_or_else(|| panic!("{} loads", case.file)).to_string());
        checked += 1;
    }
    assert!(checked >= 11);
}

/// A check that cannot fail proves nothing.
#[test]
#[should_panic(expected = "does not say")]
fn another_message_is_noticed() {
    let case = Case { file: "x".into(), readable: None, says: vec!["file.magic at byte 0".into()] };
    assert_says(&case, "something is wrong");
}

fn records(n: usize) -> Vec<u8> {
    let mut out = Vec::new();
    for i in 0..n {
        for v in [i as f32 * 0.1, 0.5, -0.5, 0.05, 0.06, 0.07] {
            out.extend(v.to_le_bytes());
        }
        out.extend([255, 128, i as u8 * 3, 204, 255, 128, 128, 128]);
    }
    out
}

/// Forty Gaussians in small packets, with parity.
fn good_stream() -> Stream {
    let snapshot = import::splat::parse(&records(40), &Limits::default()).unwrap();
    let scene = Scene::new(vec![snapshot.epoch], 30.0).unwrap();
    let options = EncodeOptions {
        packet_bytes: 200,
        block_len: 8,
        repair: Protection::xor(4),
        ..EncodeOptions::default()
    };
    encode(&scene, &options, &trainer_host::encode::no_progress).unwrap().stream
}

/// A file around `message` with the packets of `stream`.
fn file_with(message: &[u8], stream: &Stream) -> Vec<u8> {
    let whole = stream.to_bytes().unwrap();
    let packets = &whole[8 + stream.message().len()..];
    [b"DGS\x01", &(message.len() as u32).to_le_bytes()[..], message, packets].concat()
}

#[test]
#[ignore = "writes the committed files"]
fn write_damaged_files() {
    let write = |name: &str, bytes: &[u8]| std::fs::write(folder().join(name), bytes).unwrap();
    let put = |bytes: &[u8], at: usize, with: &[u8]| {
        let mut out = bytes.to_vec();
        out[at..at + with.len()].copy_from_slice(with);
        out
    };
    let cut = |bytes: &[u8], end: usize| bytes[..bytes.len() - end].to_vec();
    let replaced = |bytes: &[u8], from: &str, to: &str| {
        assert_eq!(from.len(), to.len());
        let at = bytes.windows(from.len()).position(|w| w == from.as_bytes()).unwrap();
        put(bytes, at, to.as_bytes())
    };

    let stream = good_stream();
    let good = stream.to_bytes().unwrap();
    let message = stream.message();
    let first = 8 + message.len();
    let index = stream.packets().len() * 4 + 18;
    write("whole.dgs", &good);
    write("cut.dgs", &cut(&good, index + 200));
    write("cut-in-manifest.dgs", &good[..60]);
    write("flipped.dgs", &put(&good, first + 40, &[good[first + 40] ^ 4]));
    write("length.dgs", &put(&good, first, &[0xff, 0xff]));
    write("index.dgs", &put(&good, good.len() - 12, &[0x55; 4]));
    write("empty.dgs", &[]);
    write("text.dgs", b"this is no stream\n");
    write("manifest-length.dgs", &put(&good, 4, &u32::MAX.to_le_bytes()));
    write("contradiction.dgs", &put(&good, 4, &(message.len() as u32 + 2).to_le_bytes()));
    write("manifest-flipped.dgs", &put(&good, 8 + 30, &[good[8 + 30] ^ 1]));
    write("version.dgs", &put(&good, 8 + 4, &[manifest::VERSION + 1]));
    let raw = stream.manifest().unwrap().raw().to_vec();
    let sealed = |raw: &[u8]| {
        let mut message = vec![0u8; codec_core::internals::pack::packed_bound(raw.len()) + 32];
        let len = manifest::seal(raw, &mut message).unwrap();
        message.truncate(len);
        message
    };
    // The epoch's record follows the 44 bytes of the head; its Gaussians are at byte 8 of it.
    write("gaussians.dgs", &file_with(&sealed(&put(&raw, 44 + 8, &41u32.to_le_bytes())), &stream));
    write("profile.dgs", &file_with(&sealed(&put(&raw, 0, &[9])), &stream));
    write("body-cut.dgs", &file_with(&sealed(&raw[..raw.len() - 3]), &stream));
    let mut lying = message.to_vec();
    lying[8..12].copy_from_slice(&(raw.len() as u32 * 2).to_le_bytes());
    let end = lying.len() - 4;
    let crc = crc32(&lying[..end]).to_le_bytes();
    lying[end..].copy_from_slice(&crc);
    write("raw-length.dgs", &file_with(&lying, &stream));

    let epoch = import::splat::parse(&records(4), &Limits::default()).unwrap().epoch;
    let good = ply_writer::encode(&epoch, 0);
    write("cut.ply", &cut(&good, 30));
    write("count.ply", &replaced(&good, "element vertex 4\n", "element vertex 9\n"));
    write("not-a-number.ply", &put(&good, good.len() - 4, &f32::NAN.to_le_bytes()));
    write("property.ply", &replaced(&good, "float opacity", "float opasity"));
    write("header.ply", &good[..60]);
    write("empty.ply", &[]);

    let corpus = |name: &str| std::fs::read(root().join("fuzz/corpus").join(name)).unwrap();
    let good = corpus("compressed_ply/few");
    write("cut.compressed.ply", &cut(&good, 20));
    write("chunks.compressed.ply", &replaced(&good, "element chunk 1\n", "element chunk 0\n"));

    let good = records(3);
    write("cut.splat", &cut(&good, 5));
    write("negative.splat", &put(&good, 44, &(-1f32).to_le_bytes()));
    write("infinite.splat", &put(&good, 64, &f32::INFINITY.to_le_bytes()));
    write("empty.splat", &[]);

    let options =
        spz_writer::SpzOptions { version: spz_writer::Version::V3, fraction_bits: 12, antialiased: false };
    let good = spz_writer::encode(&epoch, 0, &options).unwrap();
    write("cut.spz", &cut(&good, 12));
    write("checksum.spz", &put(&good, good.len() - 8, &[0; 4]));
    let options = spz_writer::SpzOptions { version: spz_writer::Version::V4, ..options };
    let good = spz_writer::encode(&epoch, 0, &options).unwrap();
    write("version.spz", &put(&good, 4, &[77]));
    write("count.spz", &put(&good, 8, &u32::MAX.to_le_bytes()));

    let good = corpus("sog/archive");
    write("cut.sog", &cut(&good, 40));
    let at = good.windows(4).position(|w| w == b"VP8L").unwrap();
    write("plane.sog", &put(&good, at + 9, &[0xff; 6]));
    let good = corpus("points_npz/four");
    write("cut.npz", &cut(&good, 100));

    let good = corpus("gltf/strip.glb");
    write("cut.glb", &cut(&good, 30));
    write("length.glb", &put(&good, 8, &u32::MAX.to_le_bytes()));
    write("index.glb", &replaced(&good, "\"mesh\":0", "\"mesh\":7"));
    write("ring.glb", &replaced(&good, "\"children\":[2]", "\"children\":[1]"));
    write("count.glb", &replaced(&good, "\"count\":6", "\"count\":9"));

    let good = corpus("gltf_splats/few.glb");
    write("splats.glb", &replaced(&good, "\"count\":24", "\"count\":99"));
    // The first stream starts the binary chunk.
    let good = corpus("gltf_splats/packed-splats.glb");
    let first = good.windows(4).position(|w| w == b"BIN\0").unwrap() + 4;
    write("stream.glb", &put(&good, first, &[0xa9]));
    let good = corpus("ksplat/floats");
    write("cut.ksplat", &cut(&good, 20));
    write("section.ksplat", &put(&good, 4, &u32::MAX.to_le_bytes()));
    let good = corpus("splatv/three");
    write("cut.splatv", &cut(&good, 20));
    let good = corpus("fourdgs/reached-reference");
    write("cut.4dgs", &cut(&good, 300));
    let good = corpus("dynamic_npz/two");
    write("shape.npz", &replaced(&good, "'shape': (2, 1)", "'shape': (7, 1)"));

    let good = corpus("deformation/all");
    write("shape.safetensors", &replaced(&good, "\"shape\":[2,3]", "\"shape\":[3,2]"));

    write("version.asset", b"%YAML 1.1\nMonoBehaviour:\n  m_FormatVersion: 20230101\n  m_SplatCount: 4\n");

    write("backwards.mahimahi", b"5\n9\n4\n");
    write("word.mahimahi", b"5\nseven\n");
    write("empty.mahimahi", b"\n\n");
    write("instant.mahimahi", b"0\n0\n");
    write("one.columns", b"0.0 1.5\n0.5\n");
    write("negative.columns", b"0.0 1.5\n0.5 -2\n");
    write("silent.columns", b"0.0 0\n1.0 0\n");
    write("header.csv", b"Time,Rate\n1,2\n");
    write("cell.csv", b"Timestamp,DL_bitrate,UL_bitrate,State,PINGAVG\n2020.02.14_09.38.22,fast,1,D,-\n");
    write("negative.delay", b"12\n-1\n");
}
