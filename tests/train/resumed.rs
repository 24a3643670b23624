//! `dgs train --resume` of a training that gave up.

use std::fs;

use super::{SCENE, dgs, refused};

/// A training that diverges again and again is not complete where it is gone on with: it gives up again.
#[test]
fn a_training_that_gave_up_is_not_completed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let rates = r#"{"rates": {"position": 100, "log_scale": 100, "opacity": 100}}"#;
    fs::write(at.join("hot.json"), rates).unwrap();
    let error = refused(at, &["-o", "out", "--options", "hot.json"]);
    for named in ["out/checkpoint.dgst: holds what was reached", "--overwrite", "it fell back 3 times"] {
        assert!(error.contains(named), "{error}");
    }
    let resumed = |args: &[&str]| {
        let again = ["train", SCENE, "-o", "out", "--resume", "--side", "64", "--cameras", "6"];
        let output = dgs(at, &[&again[..], args].concat());
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    let error = resumed(&[]);
    assert!(error.contains("type --steps or --minutes"), "{error}");
    let error = resumed(&["--steps", "200"]);
    assert!(error.contains("diverged at step") && !error.contains("fell back to step"), "{error}");
    assert!(!at.join("out/scene.dgs").exists());
}
