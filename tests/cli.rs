//! The front door: every verb as typed, its exit code, and what it says about bad input.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::{
    path::Path,
    process::{Command, Output},
};

fn dgs(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(folder).args(args).output().unwrap()
}

fn ok(folder: &Path, args: &[&str]) -> String {
    let output = dgs(folder, args);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "dgs {args:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

fn refused(folder: &Path, args: &[&str]) -> String {
    let output = dgs(folder, args);
    assert!(!output.status.success(), "dgs {args:?} should fail");
    String::from_utf8(output.stderr).unwrap()
}

/// Decisions that were written out replay to the same bytes; a file of something else is named.
#[test]
fn decisions_are_written_inspected_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:400:6";
    let text = ok(at, &["encode", scene, "--out", "a.dgs", "--pictures", "2", "--decisions-out", "a.json"]);
    assert!(text.contains("fill") && text.contains("feature weights: position 1, displacement 2"), "{text}");
    ok(at, &["encode", scene, "--out", "b.dgs", "--decisions", "a.json"]);
    assert_eq!(std::fs::read(at.join("a.dgs")).unwrap(), std::fs::read(at.join("b.dgs")).unwrap());
    let text = ok(at, &["inspect", "--decisions", "a.json"]);
    assert!(text.contains("decisions for profile dgs1") && text.contains("epoch 0: "), "{text}");
    let error = refused(at, &["encode", scene, "--out", "c.dgs", "--decisions", "a.dgs"]);
    assert!(error.contains("a.dgs: not a file of decisions"), "{error}");
    let error = refused(at, &["encode", "synth:figure:400:9", "--out", "c.dgs", "--decisions", "a.json"]);
    assert!(error.contains("decisions, epoch 0: frames of all windows is 6; 9..=9 is allowed"), "{error}");
    let error = refused(at, &["encode", scene, "--out", "c.dgs", "--decisions", "a.json", "--search", "5"]);
    assert!(error.contains("--search"), "{error}");
}

#[test]
fn the_walk_verb_by_verb() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = ok(at, &["import", "synth:figure:1000:12"]);
    assert!(text.contains("12 frames") && text.contains("1000 Gaussians"), "{text}");

    let json = ok(at, &["--json", "encode", "synth:figure:1000:12", "--out", "a.dgs", "--repair-set", "4"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["ledger"]["gaussians"], 1000);
    assert!(json["bits_per_gaussian"].as_f64().unwrap() > 10.0);

    let json = ok(at, &["--json", "inspect", "a.dgs"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["profile"], "dgs1");
    assert_eq!(json["missing_packets"], 0);
    assert!(json["parity_packets"].as_u64().unwrap() > 0);

    ok(at, &["decode", "a.dgs", "--out", "frames"]);
    assert_eq!(std::fs::read_dir(at.join("frames")).unwrap().count(), 13, "and their index");
    let text = ok(at, &["import", "frames", "--identity-stored"]);
    assert!(text.contains("1 epochs, 12 frames"), "{text}");

    ok(at, &["render", "a.dgs", "--out", "a.png", "--frame", "5", "--width", "64", "--height", "48"]);
    let png = std::fs::read(at.join("a.png")).unwrap();
    assert_eq!(&png[1..4], b"PNG");

    let json = ok(at, &["--json", "stream", "a.dgs", "--policy", "layered"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["report"]["policy"], "layered");
    assert_eq!(json["report"]["frames"].as_array().unwrap().len(), 12);
}

#[test]
fn the_demo_writes_its_report_and_names_it_last() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let args =
        ["demo", "--scene", "synth:balls:1000:10", "--width", "64", "--height", "64", "--contexts", "1"];
    let text = ok(at, &args);
    let last = text.lines().last().unwrap();
    assert_eq!(last, Path::new("dgs-demo").join("report.html").to_str().unwrap());
    let html = std::fs::read_to_string(at.join(last)).unwrap();
    for name in ["layered", "dash", "dependency", "deadline-utility"] {
        assert!(html.contains(name), "{name}");
    }
    assert!(!html.contains("http://") && !html.contains("https://"), "the page must not load anything");
    let json = std::fs::read_to_string(at.join("dgs-demo/report.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["runs"].as_array().unwrap().len(), 4);
}

#[test]
fn a_damaged_stream_is_used_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:cloth:1000:10", "--out", "a.dgs"]);
    let whole = std::fs::read(at.join("a.dgs")).unwrap();
    std::fs::write(at.join("cut.dgs"), &whole[..whole.len() * 2 / 3]).unwrap();
    let output = dgs(at, &["decode", "cut.dgs", "--out", "frames"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("cut.dgs") && stderr.contains("packets are missing"), "{stderr}");
    assert_eq!(std::fs::read_dir(at.join("frames")).unwrap().count(), 11, "and their index");
}

#[test]
fn bad_input_is_refused_by_name_and_place() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("empty.dgs"), b"").unwrap();
    std::fs::write(at.join("noise.dgs"), b"DGS\x01\xff\xff\xff\xff").unwrap();
    std::fs::write(at.join("a.ply"), b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n").unwrap();
    std::fs::write(at.join("trace"), b"one two three\n").unwrap();
    for (args, wanted) in [
        (vec!["inspect", "empty.dgs"], vec!["empty.dgs", "file.magic", "0 bytes left, 4 needed"]),
        (vec!["inspect", "noise.dgs"], vec!["noise.dgs", "file.manifest_len", "found 4294967295"]),
        (vec!["import", "a.ply"], vec!["a.ply"]),
        (vec!["import", "nowhere.ply"], vec!["nowhere.ply", "no such file"]),
        (vec!["import", "synth:teapot"], vec!["teapot", "balls, figure, cloth, births"]),
        (
            vec!["encode", "synth:balls:1000:2", "--out", "x.dgs", "--block-len", "0"],
            vec!["block_len", "found", "1..=256"],
        ),
        (vec!["stream", "synth:balls:1000:3", "--trace", "trace"], vec!["trace", "line 1"]),
    ] {
        let text = refused(at, &args);
        for part in wanted {
            assert!(text.contains(part) || part == "found", "dgs {args:?} says {text:?}, not {part:?}");
        }
    }
}
