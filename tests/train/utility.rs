//! `dgs train --utility` of a clip of which photographs do not show all.

use super::ok;

/// The training is over by then, and what came of it is not lost.
#[test]
fn windows_that_no_photograph_shows_cost_no_training() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = ok(at, &["-o", "out", "--utility", "--frames", "24", "--window-frames", "4"]);
    let missing = "utilities, training photographs: not measured: no photograph shows frames ";
    assert!(text.contains(missing), "{text}");
    assert!(at.join("out/report.html").exists() && at.join("out/scene.dgs").exists());
    assert!(!at.join("out/scene.utility.json").exists());
}
