//! Tests that options do what they say or are named, and that what is left out is said.

use std::fs;

use serde_json::Value;

use super::{SMALL, json, names, ok, stopped};

/// A file of splat records, every other one of which is all but transparent.
fn faint(count: usize) -> Vec<u8> {
    let mut bytes = Vec::new();
    for i in 0..count {
        let position = [i as f32 * 0.1, (i % 7) as f32 * 0.1, (i % 5) as f32 * 0.1];
        position.into_iter().chain([0.05; 3]).for_each(|value: f32| bytes.extend(value.to_le_bytes()));
        bytes.extend([200, 100, 50, if i % 2 == 0 { 1 } else { 250 }, 255, 128, 128, 128]);
    }
    bytes
}

/// What is transparent at the quality of a stream that is all there is no damage.
#[test]
fn what_is_transparent_has_arrived() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("a.splat"), faint(200)).unwrap();
    ok(at, &["encode", "a.splat", "-o", "a.dgs", "--pictures", "0", "--coarseness", "20"]);
    let text = ok(at, &["decode", "a.dgs", "-o", "a.ply"]);
    assert!(text.contains("fully transparent at this quality are left out of 1 frame, up to"), "{text}");
    let text = ok(at, &["convert", "a.dgs", "b.ply"]);
    assert!(text.contains("fully transparent at this quality"), "{text}");
    ok(at, &["encode", "synth:figure:2000:2", "-o", "b.dgs", "--pictures", "0"]);
    let most = (fs::metadata(at.join("b.dgs")).unwrap().len() / 4).to_string();
    ok(at, &["cut", "b.dgs", "c.dgs", "--bytes", &most]);
    assert!(stopped(at, &["decode", "c.dgs", "-o", "c.ply"], 2).contains("nothing has arrived"));
    assert!(ok(at, &["convert", "c.dgs", "d.ply"]).contains("nothing has arrived"));
}

/// What a format does not hold is said, to people and to programs.
#[test]
fn what_is_clamped_is_in_text_and_json() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Records of 32 bytes, x first and scales from byte 12 on: one far away, and one that is too thin.
    let mut bytes = faint(200);
    bytes[3 * 32..3 * 32 + 4].copy_from_slice(&50_000f32.to_le_bytes());
    bytes[32 + 12..32 + 16].copy_from_slice(&1e-6f32.to_le_bytes());
    fs::write(at.join("a.splat"), bytes).unwrap();
    let convert = ["convert", "a.splat", "a.spz"];
    let (text, said) = (ok(at, &convert), json(at, &convert));
    for says in ["positions are rounded to 0.0078125 scene units", "scales of 1 Gaussian were clamped to"] {
        assert!(text.contains(&format!("  note: {says}")), "{text}");
        assert!(said["notes"].to_string().contains(says), "{said}");
    }
    ok(at, &["encode", "a.splat", "-o", "a.dgs", "--pictures", "0"]);
    let said = json(at, &["decode", "a.dgs", "-o", "b.spz"]);
    assert!(said["notes"].to_string().contains("positions are rounded to 0.0078125"), "{said}");
    let said = json(at, &["convert", "a.splat", "a.ply"]);
    assert!(!said["notes"].to_string().contains("clamped"), "{said}");
}

/// More bytes than a scene takes at any coarseness are a target that is not met closely, which is said.
#[test]
fn a_target_size_beyond_the_finest_steps_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let encode = ["encode", "synth:figure:1000:1", "-o", "a.dgs", "--pictures", "0", "--target-bytes"];
    let notes = |bytes: &str| json(folder.path(), &[&encode[..], &[bytes]].concat())["notes"].to_string();
    let said = notes("1000000");
    assert!(said.contains("target_bytes is 1000000: coarseness 0.0"), "{said}");
    assert!(!notes("5000").contains("closest that was tried"));
}

/// Parity of sets that stay whole stays, and what goes is said; bytes that are left are used.
#[test]
fn a_cut_keeps_parity_that_repairs_and_uses_its_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:figure:2000:12", "-o", "a.dgs", "--window-frames", "4", "--repair-set", "4"]);
    let parity = |name: &str| json(at, &["inspect", name])["parity_packets"].as_u64().unwrap();
    let all = parity("a.dgs");
    let said = json(at, &["cut", "a.dgs", "base.dgs", "--levels", "0"]);
    assert_eq!(parity("base.dgs"), all, "only base packets are protected, and all of them stay: {said}");
    let said = json(at, &["cut", "a.dgs", "part.dgs", "--frames", "0..3"]);
    let left = parity("part.dgs");
    assert!(0 < left && left < all, "{left} of {all}");
    assert_eq!(said["parity_left_out"]["packets"], all - left);
    assert!(ok(at, &["cut", "a.dgs", "part.dgs", "--frames", "0..3"]).contains("parity left out: "));
    let whole = fs::metadata(at.join("a.dgs")).unwrap().len();
    for share in [3, 5, 8] {
        let bytes = whole * share / 10;
        let said = json(at, &["cut", "a.dgs", "some.dgs", "--bytes", &bytes.to_string()]);
        let used = said["bytes"].as_u64().unwrap();
        assert_eq!(used, fs::metadata(at.join("some.dgs")).unwrap().len());
        assert!(used <= bytes && used + 400 > bytes, "{used} of {bytes}");
    }
}

#[test]
fn options_that_mean_nothing_are_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:3";
    ok(at, &["convert", scene, "a.ply"]);
    let render = ["render", "a.ply", "-o", "a.png", "--level", "0", "--rate", "3", "--clip", "walk"];
    let text = ok(at, &[&render[..], &SMALL[..]].concat());
    for says in ["being for streams: --level", "being for those: --rate", "read as PLY; not used: --clip"] {
        assert!(text.contains(says), "{text}");
    }
    let paper = ["encode", scene, "-o", "p.dgs", "--profile", "paper", "--block-len", "32"];
    let text = ok(at, &[&paper[..], &["--packet-bytes", "900"]].concat());
    assert!(text.contains("being for --profile dgs1: --block-len, --packet-bytes"), "{text}");
    // One frame's digest is another than all frames', and there must be such a frame.
    ok(at, &["encode", scene, "-o", "a.dgs", "--pictures", "0"]);
    let digest = |args: &[&str]| json(at, &[&["decode", "a.dgs", "--digest"], args].concat());
    let (all, one, other) = (digest(&[]), digest(&["--frame", "1"]), digest(&["--frame", "2"]));
    let is_same = |a: &Value, b: &Value| a["digest"] == b["digest"];
    assert!(!is_same(&all, &one) && !is_same(&one, &other), "{all} {one} {other}");
    let of = [&all, &one, &other].map(|said| said["digest_frame"].as_u64());
    assert!(all["digest_frame"].is_null() && of == [None, Some(1), Some(2)], "{of:?}");
    for past in ["99", "4294967295"] {
        let text = stopped(at, &["decode", "a.dgs", "--digest", "--frame", past], 1);
        assert!(text.contains(&format!("--frame is {past}; 0 to 2 are allowed")), "{text}");
    }
    // Nor has a scene of one frame another.
    let text = stopped(at, &["convert", "a.ply", "b.ply", "--frame", "1"], 1);
    assert!(text.contains("--frame is 1; 0 to 0 are allowed"), "{text}");
    ok(at, &["convert", "a.dgs", "b.ply", "--frame", "2"]);
}

/// Names that are no Unicode are refused with what is wrong and for which argument.
#[cfg(unix)]
#[test]
fn names_that_are_no_unicode_are_named() {
    use std::{ffi::OsStr, os::unix::ffi::OsStrExt as _};

    let name = OsStr::from_bytes(b"caf\xe9.ply");
    for verb in [&["import"][..], &["render", "-o", "a.png"], &["encode", "-o", "a.dgs"], &["serve"]] {
        let output =
            std::process::Command::new(env!("CARGO_BIN_EXE_dgs")).args(verb).arg(name).output().unwrap();
        let text = String::from_utf8(output.stderr).unwrap();
        assert!(text.contains("caf\u{fffd}.ply") && text.contains("a name in Unicode"), "{verb:?}: {text}");
        assert_eq!(output.status.code(), Some(64), "{verb:?}");
    }
}

/// What is behind the scene is left open, and what is in front of it has the colour that it had.
#[test]
fn transparent_pictures_are_laid_over_any_background() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:2";
    let render = |out: &str, background: &str| {
        ok(at, &[&["render", scene, "-o", out, "--background", background], &SMALL[..]].concat())
    };
    render("open.png", "transparent");
    render("open.webp", "transparent");
    render("open.apng", "transparent");
    render("open", "transparent");
    render("grey.png", "#808080");
    // The colour type of the header of PNG: with alpha.
    for name in ["open.png", "open.apng", "open/00000.png"] {
        assert_eq!(fs::read(at.join(name)).unwrap()[25], 6, "{name}");
    }
    for name in ["open.png", "open.webp"] {
        let said = json(at, &["compare", name, "grey.png", "--background", "#808080"]);
        let psnr = said["summary"][0]["mean"].as_f64().unwrap();
        assert!(psnr > 45.0, "{name}: {psnr} dB");
    }
    let said = json(at, &["compare", "open.png", "grey.png", "--background", "1"]);
    assert!(said["summary"][0]["mean"].as_f64().unwrap() < 20.0, "white shows through: {said}");
    for name in ["x.jpg", "x.gif", "x.mp4"] {
        let error = stopped(at, &["render", scene, "-o", name, "--background", "transparent"], 1);
        assert!(error.contains("--background transparent: ") && error.contains(name), "{error}");
    }
}

#[test]
fn frames_are_rendered_as_chosen() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:5";
    let render = |out: &str, args: &[&str]| -> Value {
        json(at, &[&["render", scene, "-o", out], args, &SMALL[..]].concat())
    };
    assert_eq!(render("p", &["--frames", "2..3"])["images"], 2);
    assert_eq!(names(&at.join("p")), ["00002.png", "00003.png", "sequence.json"]);
    let said = json(at, &["compare", "p", scene]);
    let psnr = said["summary"][0]["mean"].as_f64().unwrap();
    assert!(psnr > 50.0, "{psnr}");
    assert_eq!(render("round", &["--frames", "2..3", "--turntable", "6"])["images"], 6);
    render("two", &["--frame", "2", "--turntable", "6"]);
    let read = |name: &str| fs::read(at.join(name)).unwrap();
    assert_eq!(read("round/00000.png"), read("two/00000.png"));
    assert_ne!(read("round/00001.png"), read("two/00001.png"));
    let text = stopped(at, &["render", scene, "-o", "a.png", "--frames", "1..2"], 1);
    assert!(text.contains("a single image shows one frame"), "{text}");
    let text = stopped(at, &["render", scene, "-o", "q", "--frames", "3..9"], 1);
    assert!(text.contains("frames 0 to 4 are there"), "{text}");
}

/// A lower quality takes fewer bytes; where nothing is lossy, that it is not used is said.
#[test]
fn quality_is_of_what_is_lossy() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let render = |out: &str, more: &[&str]| {
        ok(at, &[&["render", "synth:figure:1000:3", "-o", out], &SMALL[..], more].concat())
    };
    let length = |name: &str| fs::metadata(at.join(name)).unwrap().len();
    for ending in ["jpg", "mp4"] {
        let names = ["20", "", "100"].map(|quality| format!("at{quality}.{ending}"));
        for (name, more) in names.iter().zip([&["--quality", "20"][..], &[], &["--quality", "100"]]) {
            render(name, more);
        }
        let [low, usual, high] = names.each_ref().map(|name| length(name));
        assert!(low < usual && usual < high, "{ending}: {low}, {usual}, {high} bytes");
    }
    let text = render("a.webp", &["--quality", "20"]);
    assert!(text.contains("a.webp: is no JPEG or video; not used, being for those: --quality"), "{text}");
    let text = render("a.gif", &["--rate", "30"]);
    assert!(text.contains("pictures stay for 3 or 4 of them"), "{text}");
    assert!(!render("a.gif", &["--rate", "25"]).contains("hundredths"));
    let text = stopped(at, &["render", "synth:figure:1000:3", "-o", "slow.gif", "--rate", "0.001"], 1);
    assert!(
        text.contains("slow.gif: found 0.001 frames per second; 0.001526 to 10000 are allowed"),
        "{text}"
    );
    assert!(!at.join("slow.gif").exists());
    stopped(at, &["render", "synth:figure:1000:3", "-o", "a.jpg", "--quality", "0"], 64);
}

/// The error for a number below 0 that is taken for an option suggests `--OPTION=VALUE`, never `--`.
#[test]
fn numbers_below_zero_are_never_taken_for_files() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for wrong in [["--frame", "-1"], ["--frames", "-1..2"], ["--width", "-5"], ["--background", "-.5"]] {
        let text = stopped(at, &[&["render", "synth:figure:1000:1", "-o", "a.png"], &wrong[..]].concat(), 64);
        assert!(text.contains("--OPTION=VALUE") && !text.contains("-- -"), "{text}");
    }
    ok(
        at,
        &["render", "synth:figure:1000:1", "-o", "a.png", "--eye", "-1,0,2", "--width", "8", "--height", "8"],
    );
}

#[test]
fn cameras_of_panoptic_are_looked_from() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let meta = r#"{"w": 16, "h": 12, "k": [[[[10,0,8],[0,10,6],[0,0,1]]],[[[10,0,8],[0,10,6],[0,0,1]]]],
        "w2c": [[[[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]],[[[1,0,0,0],[0,1,0,0],[0,0,1,5],[0,0,0,1]]]],
        "fn": [["0/000000.jpg"],["0/000001.jpg"]]}"#;
    fs::write(at.join("train_meta.json"), meta).unwrap();
    let said = json(at, &["render", "synth:figure:1000:4", "-o", "p", "--cameras", "train_meta.json"]);
    assert_eq!(said["images"], 2, "{said}");
    assert!(said["cameras"].as_str().unwrap().starts_with("2 cameras of "), "{said}");
    fs::write(at.join("test_meta.json"), meta.replace("16", "0")).unwrap();
    let text = stopped(at, &["render", "synth:figure:1000:4", "-o", "q", "--cameras", "test_meta.json"], 1);
    assert!(text.contains("test_meta.json") && text.contains("0/000000.jpg"), "{text}");
}

#[test]
fn the_order_of_edits_is_in_the_help() {
    let folder = tempfile::tempdir().unwrap();
    let text = ok(folder.path(), &["convert", "--help"]);
    let words = text.split_whitespace().collect::<Vec<_>>().join(" ");
    assert!(
        words.contains("--frames, --merge, --crop, --filter, --decimate, --transform, --sh-degree"),
        "{text}"
    );
}

/// A bound on clusters that none comes near is said, and one that holds is not.
#[test]
fn a_bound_on_clusters_that_is_of_no_use_is_said() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let notes = |size: &str| {
        let encode =
            ["encode", "synth:figure:3000:2", "-o", "a.dgs", "--pictures", "0", "--cluster-size", size];
        let said = json(at, &encode);
        (said["notes"].to_string(), said["report"]["clustering"]["largest"].as_u64())
    };
    let (said, largest) = notes("8192");
    assert!(largest < Some(3000), "{largest:?}");
    assert!(said.contains("--cluster-size 8192: the largest cluster has "), "{said}");
    assert!(said.contains("what is spread out is cut, down to 192 Gaussians"), "{said}");
    for size in ["100", "512"] {
        assert!(!notes(size).0.contains("--cluster-size"), "{size}");
    }
}

/// One rule for `render` and `compare`: files are replaced, folders that hold anything with --overwrite only.
#[test]
fn files_are_replaced_and_folders_only_with_overwrite() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:2";
    for verb in [&["render", scene][..], &["compare", scene, scene, "--frames", "0..1"]] {
        for _ in 0..2 {
            ok(at, &[verb, &["-o", "a.apng"], &SMALL[..]].concat());
        }
        let name = verb[0];
        let into_folder = [verb, &["-o", name], &SMALL[..]].concat();
        ok(at, &into_folder);
        let said = stopped(at, &into_folder, 1);
        assert!(said.contains("replace the frames in it with --overwrite"), "{said}");
        ok(at, &[&into_folder[..], &["--overwrite"]].concat());
        let help = ok(at, &[name, "--help"]);
        let words = help.split_whitespace().collect::<Vec<_>>().join(" ");
        assert!(words.contains("that is there already; a file is replaced without it"), "{words}");
    }
}
