//! `dgs train --resume` of a training that gave up.

use std::fs;

use trainer_host::train::Checkpoint;

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
    // Its length is that of its checkpoint until another is typed.
    let length = || {
        let checkpoint = Checkpoint::from_bytes(&fs::read(at.join("out/checkpoint.dgst")).unwrap()).unwrap();
        (checkpoint.steps(), checkpoint.length())
    };
    assert_eq!(length(), (0, Some(200)));
    let failed = |args: &[&str]| {
        let cameras = ["train", SCENE, "-o", "out", "--side", "64", "--cameras", "6"];
        let output = dgs(at, &[&cameras[..], args].concat());
        assert_eq!(output.status.code(), Some(1), "{args:?}");
        String::from_utf8(output.stderr).unwrap()
    };
    for typed in [&["--steps", "300"][..], &[]] {
        let error = failed(&[&["--resume"], typed].concat());
        assert!(error.contains("diverged at step") && !error.contains("fell back to step"), "{error}");
        assert_eq!(length(), (0, Some(300)));
    }
    assert!(!at.join("out/scene.dgs").exists());
    // Of one that a time was to end nothing says how much of it is over.
    let path = at.join("out/checkpoint.dgst");
    let timed = Checkpoint::from_bytes(&fs::read(&path).unwrap()).unwrap().of_length(None);
    fs::write(path, timed.to_bytes().unwrap()).unwrap();
    let error = failed(&["--resume"]);
    assert!(error.contains("type --steps or --minutes"), "{error}");
}
