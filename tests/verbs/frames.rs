//! Tests what is said and written of the frames of a clip.

use super::{json, names, ok, stopped};

/// Of a stream one frame is decoded, and its number is that of the clip all the same.
#[test]
fn a_frame_is_named_by_its_place_in_the_clip() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:3";
    ok(at, &["encode", scene, "-o", "a.dgs", "--pictures", "0"]);
    for input in [scene, "a.dgs"] {
        assert!(ok(at, &["convert", input, "x.ply"]).contains(", frame 0 of 3"), "{input}");
        assert!(ok(at, &["convert", input, "x.spz", "--frame", "2"]).contains(", frame 2 of 3"), "{input}");
        assert_eq!(json(at, &["convert", input, "x.glb"])["frames"], 3, "{input}");
        let text = stopped(at, &["convert", input, "x.ply", "--frame", "3"], 1);
        assert!(text.contains("--frame is 3; 0 to 2 are allowed"), "{input}: {text}");
    }
}

/// Frames of a sequence need not have as many Gaussians: a file has those of its own.
#[test]
fn a_file_of_one_frame_says_which_and_how_many_gaussians_it_has() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::create_dir(at.join("clip")).unwrap();
    for (name, gaussians) in [("clip/0.ply", 1000), ("clip/1.ply", 1200)] {
        ok(at, &["convert", &format!("synth:figure:{gaussians}:1"), name]);
    }
    for (frame, gaussians) in [("0", 1000), ("1", 1200)] {
        for name in ["x.ply", "x.glb"] {
            let said = json(at, &["convert", "clip", name, "--frame", frame]);
            assert!(said["gaussians"] == gaussians && said["frames"] == 2, "{said}");
            assert_eq!(said["frame"].to_string(), frame, "{said}");
        }
    }
    let said = json(at, &["convert", "clip", "all"]);
    assert!(said["gaussians"] == 1200 && said["frame"].is_null(), "{said}");
}

#[test]
fn a_pattern_of_names_is_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for args in [
        ["render", "synth:figure:1000:3", "-o", "f_%03d.png"],
        ["compare", "synth:figure:1000:3", "synth:figure:1000:3", "-of_%d.gif"],
    ] {
        assert!(stopped(at, &args, 1).contains("name a folder, without an ending"), "{args:?}");
    }
    let text = stopped(at, &["convert", "synth:figure:1000:3", "seq_%04d.ply"], 1);
    assert!(text.contains("seq_%04d.ply: is one file; for one per frame name a folder"), "{text}");
    assert!(names(at).is_empty(), "{:?}", names(at));
}
