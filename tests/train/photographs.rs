//! `dgs train` on photographs that are larger than what is trained on.

use std::{fs, path::Path, process::Command};

use render_host::Image;

use super::dgs;

/// Photographs of 24 MB each once they are decoded, 24 of them.
#[test]
fn large_photographs_are_not_all_in_memory_at_once() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let picture = Image::filled(3000, 2000, [0.4, 0.5, 0.1]).unwrap();
    fs::write(at.join("r.png"), picture.to_png().unwrap()).unwrap();
    let frame = |k: u32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 24.0).sin_cos();
        let (x, z) = (4.0 * sin, 4.0 * cos);
        format!(
            r#"{{"file_path": "r.png", "transform_matrix":
            [[{cos}, 0, {sin}, {x}], [0, 1, 0, 0], [{}, 0, {cos}, {z}], [0, 0, 0, 1]]}}"#,
            -sin
        )
    };
    let frames: Vec<String> = (0..24).map(frame).collect();
    let text = format!(r#"{{"camera_angle_x": 0.7, "frames": [{}]}}"#, frames.join(","));
    fs::write(at.join("transforms.json"), text).unwrap();
    // Most of it is for the program itself and its threads.
    let script = format!(
        "ulimit -v 400000; RAYON_NUM_THREADS=1 exec '{}' train . -o out --steps 2 --evaluations 0 \
         --gaussians 100 --max-side 150 --pictures 0",
        env!("CARGO_BIN_EXE_dgs")
    );
    let output = Command::new("sh").current_dir(at).args(["-c", &script]).output().unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(text.contains("at twice the size") && text.contains("300 x "), "{text}");
}

/// A folder in which nothing was trained is not there afterwards, whatever the reason.
#[test]
fn what_cannot_begin_leaves_no_folder() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::create_dir(at.join("d")).unwrap();
    fs::write(at.join("d/train_meta.json"), r#"{"w": 16, "h": 12, "k": [], "w2c": [], "fn": []}"#).unwrap();
    // More Gaussians over all frames than a checkpoint holds are only known once the folder is there.
    let many = ["train", "synth:balls:1000:12", "-o", "out", "--gaussians", "5000000", "--split", "0"];
    let many = [&many[..], &["--side", "16", "--cameras", "1"]].concat();
    for (args, named) in [
        (&["train", "d", "-o", "out"][..], "train_meta.json: fn is empty; at least 1 photograph"),
        (&many[..], "--gaussians is 5000000 over 12 frames"),
    ] {
        let output = dgs(at, args);
        let error = String::from_utf8_lossy(&output.stderr).into_owned();
        assert!(output.status.code() == Some(1) && error.contains(named), "{error}");
        assert!(!at.join("out").exists(), "{args:?}");
    }
}

/// Photographs in a ring around nothing.
fn write_ring(folder: &Path) {
    fs::create_dir(folder).unwrap();
    let picture = Image::filled(64, 64, [0.4, 0.5, 0.1]).unwrap();
    fs::write(folder.join("r.png"), picture.to_png().unwrap()).unwrap();
    let frame = |k: u32| {
        let (sin, cos) = (std::f64::consts::TAU * f64::from(k) / 5.0).sin_cos();
        format!(
            r#"{{"file_path": "r.png", "transform_matrix":
            [[{cos}, 0, {sin}, {}], [0, 1, 0, 0], [{}, 0, {cos}, {}], [0, 0, 0, 1]]}}"#,
            4.0 * sin,
            -sin,
            4.0 * cos
        )
    };
    let frames: Vec<String> = (0..5).map(frame).collect();
    let text = format!(r#"{{"camera_angle_x": 0.7, "frames": [{}]}}"#, frames.join(","));
    fs::write(folder.join("transforms_train.json"), text).unwrap();
}

/// What is up was typed once; what photographs have no use for is named.
#[test]
fn what_is_up_stays_and_what_is_not_used_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_ring(&at.join("set"));
    let train = |more: &[&str]| -> String {
        let args = ["train", "set", "-o", "out", "--steps", "20", "--nodes", "0", "--gaussians", "200"];
        let output = dgs(at, &[&args[..], &["--pictures", "0", "--evaluations", "0"], more].concat());
        let heard = String::from_utf8(output.stderr).unwrap();
        assert!(output.status.success(), "{heard}");
        heard
    };
    let up = || -> String {
        let output = dgs(at, &["inspect", "out/scene.dgs"]);
        let text = String::from_utf8(output.stdout).unwrap();
        text.lines().next().and_then(|line| line.rsplit(", ").next()).unwrap().to_owned()
    };
    let heard = train(&["--up", "x", "--max-gaussians", "9000", "--split", "2"]);
    assert!(heard.contains("not used, being for scenes: --max-gaussians, --split"), "{heard}");
    assert_eq!(up(), "x up");
    train(&["--resume"]);
    assert_eq!(up(), "x up");
    train(&["--resume", "--up", "y"]);
    assert_eq!(up(), "y up");
    let heard = train(&["--overwrite", "--profile", "paper", "--packet-bytes", "400"]);
    let is_named = heard.contains("not used, being for --profile dgs1: ") && heard.contains("--packet-bytes");
    assert!(is_named, "{heard}");
    assert_eq!(up(), "z up", "as usual in its format");
}

/// Memory, a tail of less than one world, and the device that trains and fine-tunes are said.
#[test]
fn what_a_training_takes_and_what_its_objective_is_of_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    write_ring(&at.join("set"));
    let config = r#"{"updates": 1, "worlds": 2, "validation": {"every": 4, "states": 1, "candidates": 1}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    let args = ["train", "set", "-o", "out", "--pictures", "0", "--references", "5", "--overwrite"];
    let more = ["--steps", "20", "--nodes", "0", "--gaussians", "200", "--delivery", "config.json"];
    let args = [&args[..], &more].concat();
    let output = dgs(at, &args);
    let (text, heard) = (String::from_utf8_lossy(&output.stdout), String::from_utf8_lossy(&output.stderr));
    assert!(output.status.success(), "{heard}");
    assert!(heard.contains("weights.cvar_fraction is 0.05, less than one of 2 worlds per update"), "{heard}");
    assert!(heard.contains("1/2 of them"), "{heard}");
    let tuned_on = || -> String {
        let record = fs::read(at.join("out/delivery.json")).unwrap();
        let record: serde_json::Value = serde_json::from_slice(&record).unwrap();
        record["device"].as_str().unwrap().to_owned()
    };
    assert_eq!(tuned_on(), "cpu");
    let tells = fs::read_to_string("/proc/self/status").is_ok_and(|status| status.contains("VmHWM:"));
    assert_eq!(text.contains("  peak memory "), tells, "{text}");

    let output = dgs(at, &[&args[..], &["--device", "gpu", "--json"]].concat());
    if !output.status.success() {
        let heard = String::from_utf8_lossy(&output.stderr);
        assert!(heard.contains("--device"), "{heard}");
        eprintln!("SKIPPED: {heard}");
        return;
    }
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_ne!(report["device"], "cpu");
    assert_eq!(report["device"], tuned_on());
    assert_eq!(report["peak_memory_bytes"].as_u64().is_some_and(|bytes| bytes > 1 << 20), tells, "{report}");
}

/// Lists of a dataset may give one photograph two purposes, which a person hears.
#[test]
fn photographs_for_validation_that_are_for_testing_are_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.png"), Image::filled(32, 32, [0.4, 0.5, 0.1]).unwrap().to_png().unwrap()).unwrap();
    for name in ["b.png", "c.png"] {
        fs::copy(at.join("a.png"), at.join(name)).unwrap();
    }
    let frame = |name: &str, z: u32| {
        format!(
            r#"{{"file_path": "{name}.png", "transform_matrix":
            [[1, 0, 0, 0], [0, 1, 0, 0], [0, 0, 1, {z}], [0, 0, 0, 1]]}}"#
        )
    };
    let frames = [frame("a", 4), frame("b", 5), frame("c", 6)].join(",");
    let heard = |validation: &str| {
        let text = format!(
            r#"{{"camera_angle_x": 0.7, "frames": [{frames}], "train_filenames": ["a.png"],
            "val_filenames": ["{validation}.png"], "test_filenames": ["c.png"]}}"#
        );
        fs::write(at.join("transforms.json"), text).unwrap();
        let args = ["train", ".", "-o", "out", "--overwrite", "--steps", "2", "--gaussians", "100"];
        let output = dgs(at, &[&args[..], &["--pictures", "0", "--evaluations", "0"]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stderr).unwrap()
    };
    assert!(heard("c").contains("1 of 1 photographs for validation are also for testing"), "{}", heard("c"));
    assert!(!heard("b").contains("also for testing"));
}
