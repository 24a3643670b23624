//! Tests what is compared with what: cameras, frames, names and axes of both sides.

use std::{fs, path::Path};

use super::{SMALL, json, names, ok, stopped};

/// Mean PSNR of a comparison, dB, and what it says of its cameras.
fn compared(at: &Path, args: &[&str]) -> (f64, String) {
    let said = json(at, &[&["compare"], args].concat());
    let psnr = said["summary"][0]["mean"].as_f64().unwrap();
    (psnr, format!("{} {}", said["cameras"].as_str().unwrap(), said["notes"]))
}

/// Pictures that `render` wrote are compared with what the same cameras see, without a word on cameras.
#[test]
fn renders_are_compared_with_what_their_cameras_see() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:4";
    let text = ok(at, &[&["render", scene, "-o", "p"], &SMALL[..]].concat());
    assert!(text.contains("the first of 8 cameras around the scene"), "{text}");
    ok(at, &[&["render", scene, "-o", "p.png"], &SMALL[..]].concat());
    for (pictures, how) in [("p", "matched by name"), ("p.png", "matched by order")] {
        let (psnr, cameras) = compared(at, &[scene, pictures]);
        assert!(psnr > 50.0 && cameras.contains(how), "{pictures}: {psnr} dB, {cameras}");
        assert!(cameras.contains("the first of 8 cameras around the scene"), "{cameras}");
    }
    let (psnr, cameras) = compared(at, &["p", scene, "--frames", "1..2"]);
    assert!(psnr > 50.0 && !cameras.contains("was rendered from"), "{psnr} dB, {cameras}");
    // A part of the frames is named as they are.
    fs::remove_file(at.join("p/00000.png")).unwrap();
    assert!(compared(at, &["p", scene]).0 > 50.0);
    // Several pictures make no file of one.
    let text = stopped(at, &["compare", scene, scene, "-o", "maps.png"], 1);
    assert!(text.contains("maps.png: several pictures are written: name a folder"), "{text}");
    // They move one after another, those of each camera together.
    for (name, start) in [("maps.apng", &b"\x89PNG"[..]), ("maps.gif", b"GIF89a")] {
        let clip = ["compare", scene, scene, "-o", name, "--frames", "1..2"];
        let said = json(at, &[&clip[..], &SMALL[..]].concat());
        let pictures = said["pictures"].as_array().unwrap();
        assert!(pictures.is_sorted_by_key(|picture| picture["camera"].as_u64()), "{said}");
        let file = fs::read(at.join(name)).unwrap();
        let frames = file.windows(4).filter(|window| *window == b"fcTL").count();
        assert!(file.starts_with(start) && (name == "maps.gif" || frames == pictures.len()), "{said}");
    }
    // Other cameras than those of the pictures are named.
    ok(at, &[&["render", scene, "-o", "round", "--turntable", "4"], &SMALL[..]].concat());
    let (_, cameras) = compared(at, &["round", scene]);
    assert!(cameras.contains("round was rendered from turntable of 4 cameras"), "{cameras}");
    // Cameras that play along do so over the frames that are chosen, and pictures of others are named.
    let part = ["--turntable", "4", "--frames", "1..2"];
    let (psnr, cameras) = compared(at, &[&["round", scene], &part[..]].concat());
    assert!(psnr < 50.0 && cameras.contains("round was rendered from"), "{psnr} dB, {cameras}");
    ok(at, &[&["render", scene, "-o", "part"], &part[..], &SMALL[..]].concat());
    let (psnr, cameras) = compared(at, &[&["part", scene], &part[..]].concat());
    assert!(psnr > 50.0 && !cameras.contains("was rendered from"), "{psnr} dB, {cameras}");
    let said = json(at, &[&["compare", "part", scene], &part[..]].concat());
    assert_eq!(said["pictures"].as_array().unwrap().len(), 4, "{said}");
}

#[test]
fn folders_of_pictures_are_compared_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:3";
    ok(at, &[&["render", scene, "-o", "p"], &SMALL[..]].concat());
    fs::create_dir(at.join("q")).unwrap();
    for frame in 0..3 {
        fs::copy(at.join(format!("p/{frame:05}.png")), at.join(format!("q/{frame:05}.png"))).unwrap();
    }
    assert_eq!(compared(at, &["p", "q"]).0, 99.0);
    let said = json(at, &["compare", "p", "q", "--frames", "1", "--level", "0", "--turntable", "9"]);
    assert_eq!(said["pictures"][0]["frame"], 1);
    let notes = said["notes"].to_string();
    assert!(notes.contains("not used: --turntable") && notes.contains("not used: --level"), "{notes}");
    fs::rename(at.join("q/00000.png"), at.join("q/00003.png")).unwrap();
    let text = stopped(at, &["compare", "p", "q"], 1);
    assert!(text.contains("B has no picture named 00000.png"), "{text}");
}

#[test]
fn scenes_with_other_axes_are_compared_upright() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["convert", "synth:figure:1000:1", "a.ply"]);
    ok(at, &["convert", "a.ply", "a.spz"]);
    let (psnr, said) = compared(at, &[&["a.spz", "a.ply"], &SMALL[..]].concat());
    assert!(
        psnr > 30.0 && said.contains("a.spz is turned: y is up in it, minus-y in a.ply"),
        "{psnr} {said}"
    );
    ok(at, &["encode", "a.spz", "-o", "s.dgs", "--pictures", "0"]);
    let (psnr, said) = compared(at, &[&["a.ply", "s.dgs"], &SMALL[..]].concat());
    assert!(psnr > 30.0 && said.contains("a.ply is turned"), "{psnr} {said}");
    let (other_way, said) = compared(at, &[&["s.dgs", "a.ply"], &SMALL[..]].concat());
    assert!((other_way - psnr).abs() < 0.1 && said.contains("a.ply is turned"), "{other_way} {psnr} {said}");
    ok(at, &["encode", "a.ply", "-o", "t.dgs", "--pictures", "0"]);
    let (_, said) = compared(at, &[&["s.dgs", "t.dgs"], &SMALL[..]].concat());
    assert!(said.contains("a stream is not turned"), "{said}");
    let (psnr, said) = compared(at, &[&["a.spz", "a.ply", "--up", "y"], &SMALL[..]].concat());
    assert!(psnr < 30.0 && !said.contains("turned"), "{psnr} {said}");
}

/// A view of nothing is as good as any other: it is named, and not counted as perfect.
#[test]
fn views_that_show_nothing_do_not_count() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let cameras = r#"{"camera_angle_x": 0.8, "w": 32, "h": 32, "frames": [
        {"file_path": "seen", "transform_matrix": [[1,0,0,0],[0,1,0,1],[0,0,1,4],[0,0,0,1]]},
        {"file_path": "away", "transform_matrix": [[1,0,0,0],[0,1,0,1],[0,0,1,-40],[0,0,0,1]]}]}"#;
    fs::write(at.join("cameras.json"), cameras).unwrap();
    let (a, b) = ("synth:figure:1000:1", "synth:figure:1100:1");
    let said = json(at, &["compare", a, b, "--cameras", "cameras.json"]);
    let (seen, away) = (&said["pictures"][0], &said["pictures"][1]);
    assert!(seen["nothing_seen"] == false && away["nothing_seen"] == true, "{said}");
    assert_eq!(said["summary"][0]["mean"], seen["psnr_db"], "{said}");
    assert!(said["notes"].to_string().contains("nothing of A or B is seen in 1 picture"), "{said}");
    let text = stopped(at, &["compare", a, b, "--eye", "0,0,90", "--target", "0,0,180"], 1);
    assert!(text.contains("nothing of A or B is seen in any of 1 picture"), "{text}");
}

/// COLMAP's cameras of a rig of two, each with a picture called 0001, and of other sizes.
fn rig(at: &Path) {
    fs::write(at.join("cameras.txt"), "1 PINHOLE 40 30 40 40 20 15\n2 PINHOLE 24 32 40 40 12 16\n").unwrap();
    let images = "1 1 0 0 0 0 1 4 1 left/0001.png\n\n2 1 0 0 0 0.5 1 4 2 right/0001.png\n\n";
    fs::write(at.join("images.txt"), images).unwrap();
}

/// Each picture goes with one camera: the one whose name it shares most of.
#[test]
fn pictures_of_a_rig_go_with_their_own_cameras() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:1";
    rig(at);
    fs::create_dir(at.join("left")).unwrap();
    let cameras = ["--cameras", "cameras.txt"];
    ok(at, &[&["render", scene, "-o", "left/0001.png", "--camera", "left/0001"], &cameras[..]].concat());
    let text = stopped(at, &[&["compare", "left", scene], &cameras[..]].concat(), 1);
    assert!(
        text.contains("1 picture, and cameras and frames for 2")
            && text.contains("no picture is that of right/0001.png"),
        "{text}"
    );
    // Two renders of the same stem have two names.
    let said = json(at, &[&["compare", scene, scene, "-o", "maps"], &cameras[..]].concat());
    assert_eq!(names(&at.join("maps")), ["left_0001.png", "right_0001.png", "sequence.json"]);
    assert_eq!(said["pictures"][1]["name"], "right_0001");
}

/// Cameras of several sizes are compared with pictures of those, and typed sizes are not used.
#[test]
fn renders_have_the_size_of_their_pictures() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:1";
    rig(at);
    let images = fs::read_to_string(at.join("images.txt")).unwrap();
    fs::write(at.join("images.txt"), images.replace("right/0001", "right/0002")).unwrap();
    let cameras = ["--cameras", "cameras.txt"];
    fs::create_dir(at.join("p")).unwrap();
    for name in ["0001", "0002"] {
        let out = format!("p/{name}.png");
        ok(at, &[&["render", scene, "-o", &out, "--camera", name], &cameras[..]].concat());
    }
    let (psnr, said) = compared(at, &[&["p", scene, "--width", "100"], &cameras[..]].concat());
    assert!(psnr > 50.0 && said.contains("matched by name"), "{psnr} dB, {said}");
    assert!(said.contains("renders are of the size of their pictures; not used: --width"), "{said}");
    // One wrong name does not make another order of all.
    fs::rename(at.join("p/0001.png"), at.join("p/0003.png")).unwrap();
    let text = stopped(at, &[&["compare", "p", scene], &cameras[..]].concat(), 1);
    assert!(text.contains("nothing is called 0003.png; no picture is that of left/0001.png"), "{text}");
    // Without any name that says, order does.
    fs::rename(at.join("p/0002.png"), at.join("p/0004.png")).unwrap();
    let (_, said) = compared(at, &[&["p", scene], &cameras[..]].concat());
    assert!(said.contains("matched by order"), "{said}");
}

/// What is said of one of two scenes says of which.
#[test]
fn notes_name_the_scene_that_they_are_of() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["convert", "synth:figure:1000:1", "a.ply"]);
    ok(at, &["convert", "synth:figure:1000:1", "b.spz"]);
    let said = json(at, &[&["compare", "a.ply", "b.spz"], &SMALL[..]].concat())["notes"].to_string();
    for says in ["a.ply: up is taken to be minus-y", "b.spz: up is taken to be y"] {
        assert!(said.contains(says), "{said}");
    }
    // What is typed of the input is not so of what is merged with it.
    let merge = ["convert", "a.ply", "c.ply", "--merge", "b.spz", "--up", "z"];
    let said = json(at, &merge)["notes"].to_string();
    assert!(said.contains("b.spz: up is taken to be y") && !said.contains("a.ply: up"), "{said}");
    assert!(!said.contains("--up says otherwise"), "not of what is merged: {said}");
}
