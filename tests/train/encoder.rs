//! `dgs train` and the options of the encoder: sizes that are met or refused, and going on with others.

use std::fs;

use super::{SCENE, dgs, ok, refused, train};

/// A size that is larger or smaller than what the training has rounded for is met all the same.
#[test]
fn sizes_are_met_where_motion_alone_does_not_lead_there() {
    let folder = tempfile::tempdir().unwrap();
    for bytes in [3000u64, 400_000] {
        let typed = bytes.to_string();
        let args = ["-o", "out", "--overwrite", "--json", "--target-bytes", &typed];
        let report: serde_json::Value = serde_json::from_str(&ok(folder.path(), &args)).unwrap();
        assert!(report["bytes"].as_u64().is_some_and(|found| found <= bytes + bytes / 10), "{report}");
    }
    // It is met, too, where a training rounds nothing.
    fs::write(folder.path().join("options.json"), r#"{"finish": {"target_bytes": 3000, "round_from": 1.0}}"#)
        .unwrap();
    let args = ["-o", "out", "--overwrite", "--json", "--options", "options.json"];
    let report: serde_json::Value = serde_json::from_str(&ok(folder.path(), &args)).unwrap();
    assert!(report["bytes"].as_u64().is_some_and(|found| found <= 3300), "{report}");
}

/// A clip has the frame rate that its source states, or what was typed at first; values that are rounded for
/// so many frames stay those of so many.
#[test]
fn frames_and_their_rate_stay_what_they_were() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let heard = |args: &[&str]| {
        let output = dgs(at, args);
        String::from_utf8_lossy(&output.stdout).into_owned() + &String::from_utf8_lossy(&output.stderr)
    };
    heard(&["encode", SCENE, "-o", "fast.dgs", "--fps", "60", "--pictures", "0"]);
    heard(&["decode", "fast.dgs", "-o", "fast"]);
    let small = ["--side", "48", "--cameras", "3", "--pictures", "0"];
    let short = ["--steps", "30", "--gaussians", "300", "--nodes", "8"];
    let trained = |args: &[&str]| heard(&[&["train"], args, &small[..]].concat());
    trained(&[&["fast", "-o", "out", "--frames", "2"], &short[..]].concat());
    assert!(heard(&["inspect", "out/scene.dgs"]).contains("2 frames at 60 fps"));
    let error = trained(&["fast", "-o", "out", "--resume"]);
    assert!(error.contains("--frames is 3; 2, as before, is allowed"), "{error}");
    trained(&["fast", "-o", "out", "--resume", "--frames", "2", "--packet-bytes", "900"]);
    assert!(heard(&["inspect", "out/scene.dgs"]).contains("2 frames at 60 fps"));
    // What was typed at the start holds later too, whatever the source says.
    trained(&[&["fast", "-o", "typed", "--fps", "50"], &short[..]].concat());
    trained(&["fast", "-o", "typed", "--resume", "--packet-bytes", "900"]);
    assert!(heard(&["inspect", "typed/scene.dgs"]).contains("3 frames at 50 fps"));
}

/// A size that not even one Gaussian leaves room for is refused before anything is trained.
#[test]
fn sizes_that_no_stream_has_are_refused_before_training() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let error = refused(at, &["-o", "out", "--target-bytes", "20"]);
    assert!(error.contains("--target-bytes is 20; ") && error.contains("one Gaussian"), "{error}");
    assert!(!at.join("out").exists(), "nothing was begun");
    fs::write(at.join("options.json"), r#"{"finish": {"target_bytes": 20}}"#).unwrap();
    let error = refused(at, &["-o", "out", "--options", "options.json"]);
    assert!(error.contains("--target-bytes is 20; "), "{error}");
    // What is allowed by that may still be too little for what was trained: the checkpoint is there then.
    let least: u64 = error.split("is 20; ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!((21..2000).contains(&least), "{error}");
    let error = refused(at, &["-o", "out", "--target-bytes", &(least + 20).to_string()]);
    assert!(error.contains("the checkpoint is whole; --resume encodes it"), "{error}");
    assert!(at.join("out/checkpoint.dgst").is_file() && !at.join("out/scene.dgs").exists());
    ok(at, &["-o", "out", "--resume", "--target-bytes", "5000"]);
}

/// Going on with other options of the encoder is said once, and not where they are the same.
#[test]
fn other_options_of_the_encoder_are_said_where_a_training_goes_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let heard = |args: &[&str]| {
        let output = train(at, args);
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stderr).unwrap()
    };
    let note = "options of the encoder are not those that the training had";
    assert!(!heard(&["-o", "out"]).contains(note));
    let stream = || fs::read(at.join("out/scene.dgs")).unwrap();
    let first = stream();
    assert!(!heard(&["-o", "out", "--resume"]).contains(note));
    assert!(stream() == first);
    let other = heard(&["-o", "out", "--resume", "--packet-bytes", "400"]);
    assert_eq!(other.matches(note).count(), 1, "{other}");
    assert!(other.contains("--packet-bytes 400 (before: 1150)"), "{other}");
    assert!(stream() != first);
    // From now on these are what it had.
    assert!(!heard(&["-o", "out", "--resume", "--packet-bytes", "400"]).contains(note));
    // What it has rounded by stays, and is not said to change.
    let second = stream();
    let same = heard(&["-o", "out", "--resume", "--packet-bytes", "400", "--cluster-size", "64"]);
    assert!(same.contains("--cluster-size 64 (before: 512) changes nothing"), "{same}");
    assert!(!same.contains(note) && stream() == second, "{same}");
    let again = heard(&["-o", "out", "--resume", "--packet-bytes", "400"]);
    assert!(!again.contains("--cluster-size"), "{again}");
    // A training of before the file was written says as much as it can.
    fs::remove_file(at.join("out/encoder.json")).unwrap();
    let unknown = heard(&["-o", "out", "--resume"]);
    assert!(unknown.contains("scene.dgs: is another than before") && !unknown.contains(note), "{unknown}");
    assert!(stream() == first);
}
