//! Tests the verbs for splats at hand: render, compare, convert, cut, inspect.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[path = "cli/run.rs"]
#[allow(dead_code, reason = "other tests use the rest")]
mod run;

#[path = "verbs/clipped.rs"]
mod clipped;
#[path = "verbs/compared.rs"]
mod compared;
#[path = "verbs/frames.rs"]
mod frames;
#[path = "verbs/gltf.rs"]
mod gltf;
#[path = "verbs/options.rs"]
mod options;
#[path = "verbs/piped.rs"]
mod piped;
#[path = "verbs/refused.rs"]
mod refused;

use std::{fs, path::Path, process::Command};

use run::{dgs, names, ok, stopped};
use serde_json::Value;

fn json(folder: &Path, args: &[&str]) -> Value {
    serde_json::from_str(&ok(folder, &[&["--json"], args].concat())).unwrap()
}

const SMALL: [&str; 4] = ["--width", "48", "--height", "40"];

#[test]
fn endings_decide_what_pictures_become() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:6";
    let starts: [(&str, &[u8]); 5] = [
        ("a.png", b"\x89PNG"),
        ("a.jpg", b"\xff\xd8\xff"),
        ("a.webp", b"RIFF"),
        ("a.apng", b"\x89PNG"),
        ("a.gif", b"GIF89a"),
    ];
    for (name, start) in starts {
        ok(at, &[&["render", scene, "-o", name], &SMALL[..]].concat());
        assert!(fs::read(at.join(name)).unwrap().starts_with(start), "{name}");
    }
    let frames = |name: &str| {
        let file = fs::read(at.join(name)).unwrap();
        file.windows(4).filter(|window| *window == b"fcTL").count()
    };
    assert_eq!(frames("a.apng"), 6, "the whole clip");
    ok(
        at,
        &[&["render", scene, "-o", "round.apng", "--turntable", "9", "--rate", "12"], &SMALL[..]].concat(),
    );
    assert_eq!(frames("round.apng"), 9, "a full circle");
    // Refused before the scene is looked for, and nothing is left behind.
    let before = names(at);
    for (name, says) in [("x.bmp", ".bmp is no format of pictures"), ("nowhere/x.gif", "no such folder")] {
        assert!(stopped(at, &["render", "none", "-o", name], 1).contains(says), "{name}");
    }
    assert_eq!(names(at), before);
}

/// AV1 needs no tool; H.264 is an installed ffmpeg's, and without one there is a sentence.
#[test]
fn videos_are_made_without_any_tool() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render = |path: Option<&str>, name: &str, codec: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
        command.current_dir(at).args(["render", "synth:figure:1000:4", "-o", name, "--width", "95"]);
        command.args(["--height", "66"]).args(codec);
        if let Some(path) = path {
            command.env("PATH", path);
        }
        command.output().unwrap()
    };
    let (nowhere, h264) = (Some("/nonexistent"), ["--video-codec", "h264"]);
    for (name, codec, says) in [
        ("a.mp4", h264, "no ffmpeg is installed"),
        ("a.webm", h264, ".webm does not hold H.264"),
        ("a.gif", ["--video-codec", "av1"], "a.gif is no video"),
    ] {
        let output = render(nowhere, name, &codec);
        let text = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && text.contains(says), "{text}");
    }
    assert!(names(at).is_empty());
    let holds = |name: &str, mark: &[u8]| {
        let file = fs::read(at.join(name)).unwrap();
        assert!(file.windows(mark.len()).any(|window| window == mark), "{name}");
    };
    for (name, mark) in [("a.mp4", &b"av01"[..]), ("a.webm", b"V_AV1")] {
        let output = render(nowhere, name, &[]);
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        let text = String::from_utf8_lossy(&output.stdout);
        assert!(text.contains("95 × 66 pixels were rounded up to 96 × 66"), "{text}");
        assert!(text.contains("the first of 8 cameras around the scene"), "{text}");
        holds(name, mark);
    }
    assert_eq!(names(at), ["a.mp4", "a.webm"], "no temporary name is left");
    if Command::new("ffmpeg").arg("-version").output().is_err() {
        assert!(std::env::var_os("CI").is_none_or(|ci| ci != "true"), "ffmpeg is missing");
        eprintln!("skipped: no ffmpeg is installed, H.264 is not tested");
        return;
    }
    let output = render(None, "b.mp4", &h264);
    let text = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success() || text.contains("none of the encoders"), "{text}");
    if output.status.success() {
        holds("b.mp4", b"avc1");
    }
}

#[test]
fn cameras_and_up_are_the_users() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["convert", "synth:figure:1000:1", "a.ply"]);
    let text = ok(at, &["import", "a.ply"]);
    assert!(text.contains("up minus-y") && text.contains("--up says otherwise"), "{text}");
    // Upright by the guess as it was before it was a file.
    let psnr = |args: &[&str]| {
        let found = json(at, &[&["compare"], args, &SMALL[..]].concat());
        found["summary"][0]["mean"].as_f64().unwrap()
    };
    ok(at, &[&["render", "synth:figure:1000:1", "-o", "plain"], &SMALL[..]].concat());
    ok(at, &[&["render", "a.ply", "-o", "file"], &SMALL[..]].concat());
    ok(at, &[&["render", "a.ply", "-o", "wrong", "--up", "y"], &SMALL[..]].concat());
    let (file, wrong) = (psnr(&["file", "plain"]), psnr(&["wrong", "plain"]));
    assert!(file > 35.0 && wrong < file - 5.0, "{file} {wrong}");
    let eye = ["--eye", "0,0,-4", "--target", "0,0,0", "--fov", "60"];
    let text = ok(at, &[&["render", "a.ply", "-o", "eye.png"], &eye[..], &SMALL[..]].concat());
    assert!(text.contains("1 camera at [0.0, 0.0, -4.0]"), "{text}");
    let text = stopped(at, &["render", "a.ply", "-o", "b.png", "--fov", "60"], 1);
    assert!(text.contains("--eye or --turntable"), "{text}");
    stopped(at, &["render", "a.ply", "-o", "b.png", "--eye", "1,2"], 64);
    stopped(at, &["render", "a.ply", "-o", "b.png", "--eye", "1,2,3", "--turntable", "4"], 64);
}

#[test]
fn a_target_psnr_says_what_it_measures() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let encode = ["encode", "synth:figure:1000:4", "-o", "a.dgs", "--target-psnr", "42"];
    let text = ok(at, &encode);
    assert!(text.contains("measured on 4 frames from 3 cameras around the scene, up y"), "{text}");
    assert!(text.contains("pictures of 256 × 256") && text.contains("covers"), "{text}");
    assert!(text.contains("each counts by the share that is covered"), "{text}");
    let near = ["--eye", "0,1,-2", "--width", "64", "--height", "64"];
    let said = json(at, &[&encode[..], &near].concat());
    let views = &said["report"]["reached"]["views"];
    assert_eq!((views["cameras"].as_u64(), views["width"].as_u64()), (Some(1), Some(64)), "{said}");
    assert!(views["covered"].as_f64().unwrap() > 0.05);
    let text = stopped(at, &["encode", "synth:figure:1000:4", "-o", "a.dgs", "--eye", "1,2,3"], 1);
    assert!(text.contains("--target-psnr, which is missing"), "{text}");
}

#[test]
fn comparisons_name_mean_and_worst_and_what_differs() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:figure:1000:4", "-o", "a.dgs"]);
    ok(at, &["convert", "synth:figure:1000:4", "frames"]);
    let same = json(at, &[&["compare", "frames", "frames", "--identity-stored"], &SMALL[..]].concat());
    let summary = |said: &Value, metric: &str| -> f64 {
        let all = said["summary"].as_array().unwrap();
        all.iter().find(|s| s["metric"] == metric).unwrap()["mean"].as_f64().unwrap()
    };
    assert_eq!((summary(&same, "psnr_db"), summary(&same, "ssim"), summary(&same, "flip")), (99.0, 1.0, 0.0));
    assert_eq!(same["pictures"].as_array().unwrap().len(), 12, "three cameras, four frames");
    assert!(same["gaussians"]["attributes"].as_array().unwrap().iter().all(|a| a["largest"] == 0.0));

    let args = ["compare", "a.dgs", "synth:figure:1000:4", "--frames", "1..2", "-o", "maps"];
    let said = json(at, &[&args[..], &SMALL[..]].concat());
    let psnr = summary(&said, "psnr_db");
    assert!((25.0..80.0).contains(&psnr), "{psnr}");
    assert_eq!(said["pictures"].as_array().unwrap().len(), 6);
    assert_eq!(names(&at.join("maps")).len(), 7, "a map for each picture, and their index");
    let worse =
        json(at, &[&["compare", "a.dgs", "synth:figure:1000:4", "--level", "0"], &SMALL[..]].concat());
    assert!(summary(&worse, "psnr_db") < psnr - 3.0, "one level is worse than four");
    let text = ok(at, &[&["compare", "a.dgs", "synth:figure:1000:4"], &SMALL[..]].concat());
    assert!(text.contains("psnr_db  mean") && text.contains("Gaussians are not compared"), "{text}");

    // Renders against pictures, by name and by order.
    ok(at, &[&["render", "a.dgs", "-o", "shots", "--turntable", "4"], &SMALL[..]].concat());
    let said = json(at, &["compare", "shots", "a.dgs", "--turntable", "4"]);
    assert_eq!(said["pictures"].as_array().unwrap().len(), 4);
    assert!(summary(&said, "psnr_db") > 50.0, "8 bits a channel: {}", summary(&said, "psnr_db"));
    assert!(said["cameras"].as_str().unwrap().contains("matched by name"), "{}", said["cameras"]);
    let text = stopped(at, &["compare", "shots", "a.dgs", "--turntable", "5"], 1);
    assert!(text.contains("4 pictures, and cameras and frames for 5"), "{text}");
    let text = stopped(at, &["compare", "synth:figure:1000:3", "a.dgs"], 1);
    assert!(text.contains("have 3 and 4 frames"), "{text}");
}

#[test]
fn every_format_comes_back_as_the_same_picture() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:4000:1";
    for (name, least) in [
        ("a.ply", 50.0),
        ("a.glb", 50.0),
        ("a.gltf", 50.0),
        ("a.splat", 38.0),
        ("a.compressed.ply", 38.0),
        ("a.spz", 35.0),
        ("a.sog", 33.0),
    ] {
        let text = ok(at, &["convert", scene, name]);
        assert!(text.contains("4000 Gaussians"), "{text}");
        // Axes are each format's own; the picture is upright in all.
        ok(at, &[&["render", name, "-o", "p", "--overwrite"], &SMALL[..]].concat());
        ok(at, &[&["render", scene, "-o", "q", "--overwrite"], &SMALL[..]].concat());
        let said = json(at, &["compare", "p", "q"]);
        let psnr = said["summary"][0]["mean"].as_f64().unwrap();
        assert!(psnr > least, "{name}: {psnr} dB");
    }
    // SPZ has y up, so that a capture is turned on the way there, and back again.
    assert!(ok(at, &["convert", "a.ply", "b.spz"]).contains("turned: minus-y was up, y is"));
    ok(at, &["convert", "a.spz", "back.ply"]);
    let said = json(at, &[&["compare", "back.ply", "a.ply"], &SMALL[..]].concat());
    let attribute = |name: &str| {
        let all = said["gaussians"]["attributes"].as_array().unwrap();
        all.iter().find(|a| a["name"] == name).unwrap()["largest"].as_f64().unwrap()
    };
    assert!(attribute("position") < 0.001 && attribute("rotation") < 0.5, "{said}");
    let text = ok(at, &["convert", "a.spz", "same.ply", "--keep-axes"]);
    assert!(text.contains("axes are kept, with y up"), "{text}");
    for (name, says) in [("x.obj", ".obj is no format that scenes"), ("x.dgs", "dgs encode")] {
        assert!(stopped(at, &["convert", "none", name], 1).contains(says), "{name}");
    }
}

/// How Gaussians are drawn goes with them, as far as formats can say.
#[test]
fn a_footprint_goes_with_its_scene() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:4000:1";
    let picture = |from: &[&str], name: &str| {
        ok(at, &[&["render"], from, &["-o", name, "--overwrite"], &SMALL[..]].concat());
    };
    let psnr = |a: &str, b: &str| json(at, &["compare", a, b])["summary"][0]["mean"].as_f64().unwrap();
    picture(&[scene], "dilated");
    for (footprint, file) in [("compensated", "a.spz"), ("compensated", "a.sog"), ("pixel", "a.dgs")] {
        picture(&[scene, "--footprint", footprint], footprint);
        let verb = if file == "a.dgs" { "encode" } else { "convert" };
        let out: &[&str] = if file == "a.dgs" { &["-o", file, "--coarseness", "0.1"] } else { &[file] };
        ok(at, &[&[verb, scene, "--footprint", footprint], out].concat());
        picture(&[file], "read");
        let (same, other) = (psnr("read", footprint), psnr("read", "dilated"));
        assert!(same > 33.0 && other < same - 3.0, "{file}: {same} and {other} dB");
    }
    assert_eq!(json(at, &["inspect", "a.dgs"])["manifest"]["footprint"], "pixel");
    assert_eq!(json(at, &["import", "a.spz"])["footprint"], "compensated");
    let said = json(at, &["convert", "a.dgs", "b.ply"]);
    assert!(said["warnings"][0].as_str().unwrap().contains("footprint pixel"), "{said}");
    let said = json(at, &["decode", "a.dgs", "-o", "d.ply"]);
    assert!(said["warnings"][0].as_str().unwrap().contains("footprint pixel"), "{said}");
    let refused = stopped(at, &["convert", "a.spz", "c.ply", "--merge", "b.ply"], 1);
    assert!(refused.contains("footprints compensated and dilated"), "{refused}");
}

#[test]
fn scenes_are_edited_on_the_way() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:6";
    let said = json(at, &["convert", scene, "part", "--frames", "2..4", "--decimate", "0.25"]);
    assert_eq!((said["gaussians"].as_u64(), said["frames"].as_u64()), (Some(250), Some(3)));
    assert_eq!(names(&at.join("part")).len(), 4);
    let said = json(at, &["convert", scene, "two.ply", "--merge", scene, "--transform", "translate=5,0,0"]);
    assert_eq!(said["gaussians"], 2000);
    let text = ok(at, &["import", "two.ply"]);
    assert!(text.contains("centre [") && text.contains("2000 Gaussians"), "{text}");
    let text = stopped(at, &["convert", scene, "none.ply", "--filter", "opacity>2"], 1);
    assert!(text.contains("filter: no Gaussian is left"), "{text}");
    for wrong in [["--filter", "size>2"], ["--crop", "1,2"], ["--transform", "turn=1"], ["--decimate", "0"]] {
        stopped(at, &[&["convert", scene, "none.ply"], &wrong[..]].concat(), 64);
    }
    assert!(!at.join("none.ply").exists());
    // A stream is a scene too.
    ok(at, &["encode", scene, "-o", "a.dgs"]);
    let said = json(at, &["convert", "a.dgs", "decoded", "--sh-degree", "0"]);
    assert_eq!(said["frames"], 6);
}

#[test]
fn a_stream_with_utilities_is_cut_to_the_better_picture() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let coded = ["--window-frames", "4", "--utility"];
    ok(at, &[&["encode", "synth:figure:2000:12", "-o", "a.dgs"], &coded[..]].concat());
    fs::copy(at.join("a.dgs"), at.join("bare.dgs")).unwrap();
    let most = (fs::metadata(at.join("a.dgs")).unwrap().len() / 3).to_string();
    for (input, out, ranking) in
        [("a.dgs", "by-utility.dgs", "utility"), ("bare.dgs", "by-level.dgs", "level")]
    {
        let said = json(at, &["cut", input, out, "--bytes", &most]);
        assert_eq!(said["ranking"], ranking);
        let bytes = said["bytes"].as_u64().unwrap();
        assert!(bytes <= most.parse().unwrap() && bytes + 2000 > most.parse().unwrap(), "{said}");
    }
    // Where fewer frames are asked for, their packets take the bytes of the others.
    let part = ["cut", "a.dgs", "part.dgs", "--frames", "8..11", "--bytes", &most];
    assert!(json(at, &part)["bytes"].as_u64() <= most.parse().ok());
    let psnr = |name: &str| {
        let said = json(at, &["compare", "a.dgs", name, "--width", "96", "--height", "96"]);
        said["summary"][0]["mean"].as_f64().unwrap()
    };
    let (utility, level) = (psnr("by-utility.dgs"), psnr("by-level.dgs"));
    println!("a third of the bytes: by utility {utility:.2} dB, by level {level:.2} dB");
    assert!(utility > level, "{utility} against {level}");
    assert!(at.join("by-utility.utility.json").exists() && !at.join("by-level.utility.json").exists());
}

#[test]
fn a_stream_is_cut_and_saved_as_it_arrived() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:figure:2000:12", "-o", "a.dgs", "--window-frames", "4", "--repair-set", "4"]);
    let size = |name: &str| fs::metadata(at.join(name)).unwrap().len();
    let text = ok(at, &["inspect", "a.dgs"]);
    assert!(text.contains("0.400 s, 2000 Gaussians over all epochs") && text.contains("bounds ["), "{text}");

    ok(at, &["cut", "a.dgs", "base.dgs", "--levels", "0"]);
    assert!(size("base.dgs") < size("a.dgs"));
    // Base levels decode to what the whole stream has at level 0.
    let digest = |args: &[&str]| {
        let output = dgs(at, &[&["--json", "decode", "--digest"], args].concat());
        let said: Value = serde_json::from_slice(&output.stdout).unwrap();
        said["digest"].as_str().unwrap().to_owned()
    };
    assert_eq!(digest(&["base.dgs", "--level", "0"]), digest(&["a.dgs", "--level", "0"]));

    ok(at, &["cut", "a.dgs", "few.dgs", "--frames", "0..3"]);
    let frame = |name: &str, frame: &str| {
        let args = ["render", name, "-o", "p.png", "--frame", frame, "--eye", "0,1,-4", "--target", "0,0,0"];
        let output = dgs(at, &[&args[..], &SMALL[..]].concat());
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        fs::read(at.join("p.png")).unwrap()
    };
    assert!(size("few.dgs") < size("a.dgs"));
    assert_eq!(frame("few.dgs", "2"), frame("a.dgs", "2"), "what frames need stays");
    let text = stopped(at, &["render", "few.dgs", "-o", "p.png", "--frame", "11"], 1);
    assert!(text.contains("0 to 3"), "{text}");

    let most = size("a.dgs") / 2;
    ok(at, &["cut", "a.dgs", "half.dgs", "--bytes", &most.to_string()]);
    assert!(size("half.dgs") <= most && size("half.dgs") > most * 8 / 10, "{}", size("half.dgs"));
    // What was left out is said, and is no damage.
    let text =
        ok(at, &["render", "half.dgs", "-o", "p.png", "--frame", "0", "--width", "32", "--height", "32"]);
    assert!(text.contains("packets are not in half.dgs"), "{text}");
    // What is left is sent, and a receiver shows as much as a reader of the file.
    let easy = ["--policy", "layered", "--load", "0.1", "--burst-loss", "0"];
    ok(at, &[&["stream", "half.dgs", "--out", "sent.dgs"], &easy[..]].concat());
    assert_eq!(digest(&["sent.dgs"]), digest(&["half.dgs"]));
    let text = stopped(at, &["cut", "a.dgs", "x.dgs", "--bytes", "10"], 1);
    assert!(text.contains("for the manifest alone"), "{text}");
    assert!(stopped(at, &["cut", "a.dgs", "x.dgs"], 1).contains("nothing to leave out"));
    assert_ne!(frame("half.dgs", "2"), frame("a.dgs", "2"), "levels are missing");

    // Window after window the same packets lie in the file; live they come while the clip lasts.
    ok(at, &["cut", "a.dgs", "ordered.dgs", "--by-window"]);
    let read = |name: &str| fs::read(at.join(name)).unwrap();
    assert!(size("ordered.dgs") == size("a.dgs") && read("ordered.dgs") != read("a.dgs"));
    assert_eq!(digest(&["ordered.dgs"]), digest(&["a.dgs"]));
    let begin = std::time::Instant::now();
    let output = dgs(at, &["cut", "a.dgs", "-", "--live"]);
    assert!(output.status.success() && output.stdout == read("ordered.dgs"));
    // Windows of 4 frames of 12 at 30 frames per second.
    assert!(begin.elapsed().as_secs_f64() > 8.0 / 30.0);
    assert!(stopped(at, &["cut", "a.dgs", "x.dgs", "--live"], 1).contains("- is allowed"));

    let lossy = ["--burst-loss", "0.2", "--policy", "layered", "--load", "2"];
    let said = json(at, &[&["stream", "a.dgs", "--out", "arrived.dgs"], &lossy[..]].concat());
    let arrived = said["arrived_packets"].as_u64().unwrap();
    let output = dgs(at, &["--json", "inspect", "arrived.dgs"]);
    let inspected: Value = serde_json::from_slice(&output.stdout).unwrap();
    let whole = json(at, &["inspect", "a.dgs"]);
    let total = whole["manifest"]["packets"].as_u64().unwrap();
    assert_eq!(arrived + inspected["missing_packets"].as_u64().unwrap(), total);
    assert!(arrived < total, "something was lost");
}

#[test]
fn a_viewer_who_is_close_sees_more_where_the_sender_knows_it() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:figure:6000:30", "-o", "a.dgs", "--utility", "--pictures", "2"]);
    let tight = ["--load", "2.5", "--width", "64", "--height", "64"];
    let close = ["--eye", "0.2,0.8,1.0", "--target", "0,0.8,0"];
    let seen =
        |options: &[&str]| json(at, &[&["stream", "a.dgs"], &tight[..], options].concat())["seen"].clone();
    let (heard, silent) = (seen(&close), seen(&[&close[..], &["--no-pose"]].concat()));
    assert!(heard["located"] == true && silent["located"] == false);
    let mean = |seen: &Value| seen["mean_psnr_db"].as_f64().unwrap();
    assert!(mean(&heard) > mean(&silent), "{heard} {silent}");
    assert!(seen(&["--turntable", "90"])["worst_tenth_psnr_db"].as_f64().unwrap() > 10.0);
    // Without a viewer nothing is looked at, and what would look is named.
    assert!(seen(&[]).is_null());
    let (hint, figure) =
        ("--turntable or --cameras (a viewer) adds their PSNR", "PSNR against complete frames");
    let text = ok(at, &["stream", "a.dgs"]);
    assert!(text.contains(hint) && !text.contains(figure), "{text}");
    let text = ok(at, &[&["stream", "a.dgs"], &tight[..], &close].concat());
    assert!(text.contains(figure) && !text.contains(hint), "{text}");
    let text = stopped(at, &["stream", "a.dgs", "--no-pose"], 1);
    assert!(text.contains("--no-pose") && text.contains("--eye"), "{text}");
}

#[test]
fn shells_and_manuals_know_every_verb() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for shell in ["bash", "zsh", "fish"] {
        let text = ok(at, &["completions", shell]);
        assert!(text.contains("convert") && text.contains("turntable"), "{shell}");
    }
    ok(at, &["man", "."]);
    let pages = names(at);
    for verb in ["dgs.1", "dgs-compare.1", "dgs-convert.1", "dgs-render.1"] {
        assert!(pages.iter().any(|page| page == verb), "{pages:?}");
    }
    assert!(fs::read_to_string(at.join("dgs-render.1")).unwrap().contains("turntable"));
    // Whatever a page refers to is there.
    for page in pages.iter().filter(|name| name.ends_with(".1")) {
        let text = fs::read_to_string(at.join(page)).unwrap().replace('\\', "");
        for name in text.split_whitespace().filter(|word| word.starts_with("dgs-") && word.ends_with("(1)")) {
            let file = name.replace("(1)", ".1");
            assert!(pages.contains(&file), "{page} refers to {name}");
        }
    }
    assert!(pages.iter().any(|page| page == "dgs-sweep-merge.1"), "{pages:?}");
    stopped(at, &["man", "nowhere"], 1);
}

/// What others trained or compressed is a scene like any other.
#[test]
fn files_of_other_trainers_and_compressors_convert() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let of_others = |name: &str| {
        Path::new(env!("CARGO_MANIFEST_DIR")).join("trainer-host/tests").join(name).display().to_string()
    };
    let field = of_others("deformation/planes.npz");
    let said = json(at, &["convert", &field, "clip", "--deformation-frames", "4"]);
    assert_eq!((&said["frames"], &said["gaussians"]), (&Value::from(4), &Value::from(6)));
    let frames: Vec<Vec<u8>> =
        (0..4).map(|frame| fs::read(at.join(format!("clip/frame_{frame:05}.ply"))).unwrap()).collect();
    assert!(frames.windows(2).all(|pair| pair[0] != pair[1]), "it moves");
    let said = json(at, &["convert", &of_others("compressed/packed-splats.glb"), "splats.ply"]);
    assert_eq!(said["gaussians"], 90);
    let said =
        json(at, &["convert", &of_others("compressed/draco-sequential.glb"), "mesh.ply", "--samples", "70"]);
    assert_eq!(said["gaussians"], 70);
    fs::write(at.join("deformation.pth"), b"\x80\x02}q\x00.").unwrap();
    let error = stopped(at, &["convert", ".", "x.ply"], 1);
    assert!(error.contains("deformation.pth") && error.contains("numpy.savez"), "{error}");
}
