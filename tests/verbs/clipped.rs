//! Tests that a stream is cut to a shorter one.

use std::fs;

use super::{
    json,
    run::{ok, stopped},
};

#[test]
fn a_cut_in_time_is_a_clip_of_its_own() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let coded = ["--window-frames", "4", "--repair-set", "4", "--utility"];
    ok(at, &[&["encode", "synth:figure:1000:12", "-o", "a.dgs"], &coded[..]].concat());
    let said = json(at, &["cut", "a.dgs", "b.dgs", "--frames", "5..9"]);
    assert_eq!((said["first_frame"].as_u64(), said["frames"].as_u64()), (Some(4), Some(8)));
    let text = ok(at, &["cut", "a.dgs", "b.dgs", "--frames", "5..9"]);
    assert!(text.contains("frames 4 to 11 are 8 frames of their own from 0 on, 0.267 s"), "{text}");
    assert!(text.contains("note: --frames is 5..9; motion is coded in windows"), "{text}");
    assert!(!ok(at, &["cut", "a.dgs", "c.dgs", "--frames", "4..11"]).contains("note:"), "nothing is rounded");
    assert_eq!(fs::read(at.join("b.dgs")).unwrap(), fs::read(at.join("c.dgs")).unwrap());
    let digest = |name: &str, frame: u32| {
        json(at, &["decode", name, "--digest", "--frame", &frame.to_string()])["digest"].clone()
    };
    for frame in 0..8 {
        assert_eq!(digest("b.dgs", frame), digest("a.dgs", frame + 4), "frame {frame}");
    }
    // Every verb that reads the clip sees its shorter length.
    assert!(ok(at, &["inspect", "b.dgs"]).contains("0.267 s, 1000 Gaussians"));
    assert!(stopped(at, &["render", "b.dgs", "-o", "p.png", "--frame", "8"], 1).contains("0 to 7"));
    let said = json(at, &["stream", "b.dgs", "--load", "0.1", "--burst-loss", "0"]);
    assert_eq!(said["report"]["frames"].as_array().unwrap().len(), 8);
    // What was measured goes with it.
    let most = (fs::metadata(at.join("b.dgs")).unwrap().len() / 2).to_string();
    assert_eq!(json(at, &["cut", "b.dgs", "d.dgs", "--bytes", &most])["ranking"], "utility");
    assert!(stopped(at, &["cut", "a.dgs", "x.dgs", "--frames", "8..12"], 1).contains("frames 0 to 11"));
}

#[test]
fn what_cannot_be_cut_in_time_is_refused_with_what_can() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:balls:1000:4", "-o", "p.dgs", "--profile", "paper"]);
    let text = stopped(at, &["cut", "p.dgs", "x.dgs", "--frames", "0..1"], 1);
    assert!(text.contains("profile paper") && text.contains("dgs convert --frames"), "{text}");
    assert!(!at.join("x.dgs").exists());
}
