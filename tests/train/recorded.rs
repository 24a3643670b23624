//! `dgs train --delivery` on states that `dgs stream` recorded.

use std::{fs, path::Path};

use render_host::Image;

use super::{SCENE, dgs, ok, refused};

/// What `dgs` says, which succeeds.
fn made(at: &Path, args: &[&str]) -> String {
    let output = dgs(at, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

/// States that a lossy link left are what a scene is fine-tuned for; those of another stream are refused.
#[test]
fn states_that_a_stream_recorded_are_trained_on() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let made = |args: &[&str]| made(at, args);
    let stream = |input: &str, states: &str| {
        made(&["stream", input, "--impair", "loss=20%,rate=1mbit,delay=40ms", "--states", states])
    };
    made(&["encode", SCENE, "-o", "a.dgs", "--pictures", "0"]);
    made(&["encode", SCENE, "-o", "b.dgs", "--pictures", "0", "--block-len", "16"]);
    assert!(stream("a.dgs", "a.json").contains("displayed frames → a.json"));
    stream("b.dgs", "b.json");
    let written = fs::read_to_string(at.join("a.json")).unwrap();
    let recorded: serde_json::Value = serde_json::from_str(&written).unwrap();
    assert_eq!(recorded["stream"].as_str().map(str::len), Some(16), "{recorded}");
    assert!(recorded["states"][0]["frame"] == 0 && recorded["states"][0]["arrived"].is_string());

    let config = |states: &str| {
        let config = format!(
            r#"{{"updates": 2, "worlds": 4, "warm_up": 0.0, "recorded": {states:?},
            "validation": {{"every": 4, "states": 2, "candidates": 1}}}}"#
        );
        fs::write(at.join("config.json"), config).unwrap();
    };
    let args = ["-o", "out", "--overwrite", "--delivery", "config.json", "--references", "8"];
    let worlds = || -> serde_json::Value {
        ok(at, &args);
        serde_json::from_slice(&fs::read(at.join("out/delivery.json")).unwrap()).unwrap()
    };
    config("a.json");
    let with = worlds();
    fs::write(
        at.join("config.json"),
        fs::read_to_string(at.join("config.json")).unwrap().replace(r#""a.json""#, "null"),
    )
    .unwrap();
    let of = |record: serde_json::Value| record["registration"]["worlds"].as_str().unwrap().to_owned();
    assert_ne!(of(with), of(worlds()));

    let bad = |states: &str, named: &[&str]| {
        config(states);
        let error = refused(at, &args);
        assert!(error.contains(states) && named.iter().all(|name| error.contains(name)), "{states}: {error}");
    };
    bad("b.json", &["stream is", "dgs encode SCENE -o ck.dgs", "dgs stream ck.dgs --states"]);
    fs::write(at.join("high.json"), written.replacen("0f", "1f", 1)).unwrap();
    bad("high.json", &["--delivery: recorded", "00 to 0f is allowed"]);
    fs::write(at.join("empty.json"), "").unwrap();
    bad("empty.json", &["--delivery: recorded", "EOF"]);
    bad("nowhere.json", &["--delivery: recorded"]);

    // Where nothing is displayed there is nothing to learn from, and over the input nothing is written.
    fs::write(at.join("dead.txt"), "0 0\n3000 1\n").unwrap();
    let dead = ["stream", "a.dgs", "--trace", "dead.txt", "--states", "dead.json"];
    let output = dgs(at, &dead);
    assert_eq!(output.status.code(), Some(2), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(String::from_utf8_lossy(&output.stdout).contains("no frame was displayed: dead.json"));
    assert!(!at.join("dead.json").exists());
    let output = dgs(at, &["stream", "a.dgs", "--states", "a.dgs"]);
    assert_eq!(output.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&output.stderr).contains("--states: a.dgs"));
}

/// States are of a stream, which a dataset has once it is trained: the commands that are named lead there.
#[test]
fn recorded_states_of_a_dataset_come_after_its_training() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let set = at.join("set");
    fs::create_dir(&set).unwrap();
    let picture = Image::filled(64, 64, [0.4, 0.5, 0.1]).unwrap();
    fs::write(set.join("r.png"), picture.to_png().unwrap()).unwrap();
    let frame = |k: u32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 5.0).sin_cos();
        let (x, z) = (4.0 * sin, 4.0 * cos);
        format!(
            r#"{{"file_path": "r.png", "transform_matrix":
            [[{cos}, 0, {sin}, {x}], [0, 1, 0, 0], [{}, 0, {cos}, {z}], [0, 0, 0, 1]]}}"#,
            -sin
        )
    };
    let frames: Vec<String> = (0..5).map(frame).collect();
    let text = format!(r#"{{"camera_angle_x": 0.7, "frames": [{}]}}"#, frames.join(","));
    fs::write(set.join("transforms_train.json"), text).unwrap();
    let config = r#"{"updates": 1, "worlds": 2, "recorded": "st.json",
        "validation": {"every": 4, "states": 1, "candidates": 1}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    let other = r#"{"stream": "0", "states": [{"frame": 0, "arrived": "0f"}]}"#;
    fs::write(at.join("st.json"), other).unwrap();

    let small = ["train", "set", "-o", "out", "--pictures", "0", "--references", "5"];
    let first = ["--steps", "20", "--nodes", "0", "--gaussians", "200"];
    let delivery = ["--delivery", "config.json"];
    let output = dgs(at, &[&small[..], &first, &delivery].concat());
    let error = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{error}");
    for named in ["set is not trained yet", "dgs encode out/checkpoint.dgst -o ck.dgs", "--resume --delivery"]
    {
        assert!(error.contains(named), "{error}");
    }
    assert!(!at.join("out").exists(), "nothing was trained");

    let output = dgs(at, &[&small[..], &first].concat());
    let said = [output.stdout, output.stderr].concat();
    let said = String::from_utf8_lossy(&said);
    assert!(said.contains("on the wire") && said.contains("set: no photographs are for testing"), "{said}");
    made(at, &["encode", "out/checkpoint.dgst", "-o", "ck.dgs", "--pictures", "0"]);
    made(at, &["stream", "ck.dgs", "--states", "st.json"]);
    made(at, &[&small[..], &["--resume"], &delivery].concat());
    assert!(at.join("out/delivery.json").is_file());
}
