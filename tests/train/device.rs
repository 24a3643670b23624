//! `dgs train --device gpu`: trains and fine-tunes on a graphics device, or says what is missing.

use std::fs;

use render_host::Backend;

use super::{SCENE, dgs, ok, train};

#[test]
fn a_device_is_named_and_one_that_is_missing_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let config = r#"{"updates": 2, "worlds": 2, "validation": {"every": 4, "states": 2, "candidates": 1}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    let tuned = ["-o", "scene", "--delivery", "config.json", "--references", "8", "--json"];
    let output = train(at, &[&tuned[..], &["--device", "gpu"]].concat());
    let error = String::from_utf8_lossy(&output.stderr);
    if !Backend::HAS_GPU {
        assert_eq!(output.status.code(), Some(1), "{error}");
        assert!(error.contains("--device") && error.contains("--features gpu"), "{error}");
        assert!(!at.join("scene").exists());
        return;
    }
    if error.contains("no graphics adapter") {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{error}");
        eprintln!("SKIPPED: {error}");
        return;
    }
    // A scene is fine-tuned there, and the fine-tuning goes on elsewhere.
    assert!(output.status.success(), "{error}");
    let record = || -> serde_json::Value {
        serde_json::from_slice(&fs::read(at.join("scene/delivery.json")).unwrap()).unwrap()
    };
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    let on_gpu = record();
    assert_ne!(report["device"], "cpu");
    assert_eq!(on_gpu["device"], report["device"]);
    assert_eq!(on_gpu["objective"].as_array().map(Vec::len), Some(2));
    ok(at, &[&tuned[..], &["--resume"]].concat());
    assert_eq!(record()["device"], "cpu");
    assert_eq!(record()["objective"], on_gpu["objective"]);
    let report: serde_json::Value =
        serde_json::from_str(&ok(at, &["-o", "out", "--device", "gpu", "--json"])).unwrap();
    assert_ne!(report["device"], "cpu");
    // A training goes on on another device.
    fs::remove_file(at.join("out/scene.dgs")).unwrap();
    let resumed =
        ["train", SCENE, "-o", "out", "--resume", "--side", "64", "--cameras", "6", "--pictures", "0"];
    let output = dgs(at, &resumed);
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert!(at.join("out/scene.dgs").exists());
}
