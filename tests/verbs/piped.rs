//! Tests streams and pictures that come and go through pipes, and what is said where they cannot.

use std::{
    fs,
    io::Write,
    path::Path,
    process::{Command, Output, Stdio},
};

use super::{SMALL, ok, stopped};

/// `dgs` with `args` and `input` at its standard input.
fn piped(at: &Path, args: &[&str], input: &[u8]) -> Output {
    let mut running = Command::new(env!("CARGO_BIN_EXE_dgs"))
        .current_dir(at)
        .args(args)
        .stdin(Stdio::piped())
        .stdout(Stdio::piped())
        .stderr(Stdio::piped())
        .spawn()
        .unwrap();
    let mut pipe = running.stdin.take().unwrap();
    let input = input.to_vec();
    // Whoever is refused does not read.
    let writing = std::thread::spawn(move || drop(pipe.write_all(&input)));
    let output = running.wait_with_output().unwrap();
    writing.join().unwrap();
    output
}

fn text(bytes: &[u8]) -> String {
    String::from_utf8_lossy(bytes).into_owned()
}

#[test]
fn streams_and_pictures_go_through_pipes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let encode = ["encode", "synth:figure:1000:2", "--pictures", "0", "-o"];
    ok(at, &[&encode[..], &["a.dgs"]].concat());
    let stream = fs::read(at.join("a.dgs")).unwrap();
    for name in ["-", "/dev/stdout"] {
        let output = piped(at, &[&encode[..], &[name]].concat(), b"");
        assert!(output.status.success(), "{}", text(&output.stderr));
        assert_eq!(output.stdout, stream, "{name}: the stream alone");
        assert!(text(&output.stderr).contains("bytes at rest"), "the report is elsewhere");
    }
    for name in ["-", "/dev/stdin"] {
        let inspected = piped(at, &["inspect", name], &stream);
        assert!(text(&inspected.stdout).contains("2 frames"), "{}", text(&inspected.stderr));
        let cut = piped(at, &["cut", name, "-", "--levels", "0"], &stream);
        assert!(cut.status.success() && cut.stdout.starts_with(b"DGS\x01"), "{}", text(&cut.stderr));
        let decoded = piped(at, &["decode", name, "--digest"], &cut.stdout);
        assert!(text(&decoded.stdout).contains("digest "), "{}", text(&decoded.stderr));
        let picture = piped(at, &[&["render", name, "-o", "-"], &SMALL[..]].concat(), &stream);
        assert!(picture.stdout.starts_with(b"\x89PNG"), "{}", text(&picture.stderr));
        let same = piped(at, &[&["compare", name, "a.dgs", "--frames", "0"], &SMALL[..]].concat(), &stream);
        assert!(text(&same.stdout).contains("psnr_db  mean 99"), "{}", text(&same.stderr));
    }
}

#[test]
fn what_does_not_go_through_pipes_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:2";
    for (args, says) in [
        (vec!["--json", "render", scene, "-o", "-"], "--json: standard output"),
        (vec!["encode", scene, "-o", "-", "--utility"], "nothing is beside standard output"),
        (vec!["convert", scene, "-"], "standard output is no folder"),
        (vec!["encode", scene, "-o", "a.dgs", "--decisions-out", "-"], "name a file"),
    ] {
        let error = stopped(at, &args, 1);
        assert!(error.contains(says), "{args:?}: {error}");
    }
    assert_eq!(fs::read_dir(at).unwrap().count(), 0);
    let refused = piped(at, &["import", "-"], b"ply\n");
    assert!(text(&refused.stderr).contains("-: is no file, folder or stream"), "{}", text(&refused.stderr));
}

#[test]
fn what_was_meant_is_named() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["convert", "synth:figure:1000:2", "a.ply", "--frame", "0"]);
    for verb in [vec!["inspect", "a.ply"], vec!["decode", "a.ply", "--digest"]] {
        let error = stopped(at, &verb, 1);
        assert!(
            error.contains("a.ply: is a scene (PLY), no stream") && error.contains("dgs encode"),
            "{error}"
        );
    }
    let decisions = ["--pictures", "0", "--decisions-out", "d.json"];
    ok(at, &[&["encode", "synth:figure:1000:2", "-o", "a.dgs"], &decisions[..]].concat());
    fs::create_dir(at.join("photographs")).unwrap();
    fs::write(at.join("photographs/transforms_train.json"), r#"{"camera_angle_x": 0.7, "frames": []}"#)
        .unwrap();
    let cut = fs::read(at.join("a.ply")).unwrap();
    fs::write(at.join("cut.ply"), &cut[..cut.len() - 100]).unwrap();
    fs::write(at.join("cut.glb"), b"glTF\x02\0\0\0").unwrap();
    for (args, says) in [
        (["import", "photographs"], "dgs train photographs makes a scene of them"),
        (["import", "photographs/transforms_train.json"], "dgs train photographs makes"),
        (["inspect", "photographs/transforms_train.json"], "it begins with \"{\\\"ca\"; \"DGS\\x01\" is"),
        (["import", "d.json"], "dgs inspect --decisions"),
        (["inspect", "d.json"], "dgs inspect --decisions"),
        (["import", "cut.ply"], "--keep-readable reads what is there"),
    ] {
        let error = stopped(at, &args, 1);
        assert!(error.contains(says) && !error.contains("glTF)"), "{args:?}: {error}");
    }
    assert!(!stopped(at, &["import", "cut.glb"], 1).contains("--keep-readable"));
    let error = stopped(at, &["encode", "synth:figure:3000:2", "-o", "b.dgs", "--decisions", "d.json"], 1);
    assert!(error.contains("the scene has 3000 Gaussians; the decisions are for 1000"), "{error}");
    let error = stopped(at, &["decode", "a.dgs", "-o", "x.xyz"], 1);
    assert!(error.contains(".xyz is no format") && !error.contains(".4dgs"), "{error}");
    ok(at, &["convert", "a.ply", "far.ply", "--transform", "translate=1e8,0,0"]);
    let error = stopped(at, &["convert", "far.ply", "x.spz"], 1);
    assert!(error.contains("x.spz: SPZ: position of Gaussian ") && error.contains("8388607"), "{error}");
    // What follows a stream is said, and a folder is not written over while it is read.
    let stream = fs::read(at.join("a.dgs")).unwrap();
    fs::write(at.join("two.dgs"), [&stream[..], &stream].concat()).unwrap();
    let output = super::dgs(at, &["inspect", "two.dgs"]);
    let after = format!("{} bytes after the end of the stream", stream.len());
    assert!(text(&output.stdout).contains(&after), "{}", text(&output.stdout));
    assert!(!ok(at, &["inspect", "a.dgs"]).contains("after the end"));
    ok(at, &["convert", "synth:figure:1000:2", "frames"]);
    let error = stopped(at, &["convert", "frames", "frames", "--overwrite"], 1);
    assert!(error.contains("frames: is read or written besides"), "{error}");
    // Levels of detail are folders of their own.
    fs::create_dir_all(at.join("lod/0_0")).unwrap();
    fs::write(at.join("lod/0_0/meta.json"), "{}").unwrap();
    fs::write(at.join("lod/lod-meta.json"), "{}").unwrap();
    for path in ["lod", "lod/lod-meta.json"] {
        let error = stopped(at, &["import", path], 1);
        assert!(error.contains("SOG's list of levels of detail") && error.contains("lod/0_0"), "{error}");
    }
}
