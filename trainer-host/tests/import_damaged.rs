//! Damaged files as a person meets them: each error names the file, what is wrong and what would be
//! right. The files are a few hundred bytes each, written by `import::damage::write_damaged_files`.

use std::path::{Path, PathBuf};

use ErrorKind::{Empty, Malformed, TooLarge, Truncated, Unsupported};
use trainer_host::import::{ErrorKind, ImportOptions, Limits, import};

/// File, kind of error, and a part of its text.
const DAMAGED: [(&str, ErrorKind, &str); 33] = [
    ("cut.ply", Truncated, "element vertex"),
    ("too_many.ply", Truncated, "element vertex"),
    ("no_opacity.ply", Malformed, "no opacity"),
    ("not_a_number.ply", Malformed, "of Gaussian 3, frame 0: found NaN"),
    ("no_end.ply", Malformed, "header line"),
    ("none.ply", Empty, "Gaussian count"),
    ("word.ply", Malformed, "in row 1"),
    ("cut.compressed.ply", Truncated, "element"),
    ("few_chunks.compressed.ply", Truncated, "element"),
    ("other_sh.compressed.ply", Malformed, "element sh: found 7; allowed: 8"),
    ("cut.splat", Truncated, "last record at byte 64"),
    ("negative.splat", Malformed, "scale at byte 44"),
    ("empty.splat", Empty, "file"),
    ("cut.spz", Malformed, "gzip"),
    ("checksum.spz", Malformed, "gzip trailer"),
    ("degree.spz", Malformed, "harmonic degree at byte 12: found 9"),
    ("count.spz", Truncated, "positions: found"),
    ("bomb.spz", Truncated, "planes: found at most"),
    ("table.spz", Malformed, "positions at byte 40: found 90; allowed: 81"),
    ("offset.spz", Truncated, "stream table"),
    ("flipped.spz", Malformed, "zstd"),
    ("cut.sog", Malformed, "zip"),
    ("plane.sog", Malformed, "webp"),
    ("cut.npz", Malformed, "zip"),
    ("cut.glb", Truncated, "GLB at byte 8"),
    ("index.glb", Malformed, "JSON"),
    ("ring.glb", Malformed, "its own ancestor"),
    ("count.glb", Truncated, "accessor 4"),
    ("other_version.asset", Unsupported, "m_FormatVersion"),
    ("no_planes.asset", ErrorKind::Io, "no_planes_chk.bytes"),
    ("noise.bin", Malformed, "content"),
    ("../data", Malformed, "no meta.json and no numbered"),
    ("missing.ply", ErrorKind::Io, "missing.ply"),
];

fn data() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/data")
}

#[test]
fn every_damaged_file_is_refused_with_a_reason() {
    for (name, kind, text) in DAMAGED {
        let error = import(&data().join(name), &ImportOptions::default()).expect_err(name);
        println!("{error}");
        assert_eq!(error.kind, kind, "{error}");
        assert!(error.to_string().contains(text), "{error}");
        assert!(error.path.is_some(), "{error}");
    }
}

#[test]
fn every_file_is_in_the_table() {
    for entry in std::fs::read_dir(data()).unwrap() {
        let name = entry.unwrap().file_name().into_string().unwrap();
        assert!(DAMAGED.iter().any(|d| d.0 == name), "{name} is not tested");
    }
}

#[test]
fn readable_parts_are_returned_when_the_limits_say_so() {
    let limits = Limits { keep_readable: true, ..Limits::default() };
    let options = ImportOptions { limits, ..ImportOptions::default() };
    for (name, count) in [("cut.ply", 3), ("too_many.ply", 4), ("not_a_number.ply", 3), ("cut.splat", 2)] {
        let scene = import(&data().join(name), &options).unwrap_or_else(|e| panic!("{e}"));
        assert_eq!(scene.max_count(), count, "{name}");
        assert!(!scene.notes.is_empty(), "{name} says what is missing");
    }
}

#[test]
fn limits_hold() {
    let limits = Limits { max_gaussians: 2, ..Limits::default() };
    let error =
        import(&data().join("cut.ply"), &ImportOptions { limits, ..ImportOptions::default() }).unwrap_err();
    assert_eq!(error.kind, TooLarge);
}
