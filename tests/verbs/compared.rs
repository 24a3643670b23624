//! Tests what is compared with what: cameras, frames, names and axes of both sides.

use std::{fs, path::Path};

use super::{SMALL, json, ok, stopped};

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
