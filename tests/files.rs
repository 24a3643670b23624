//! Files as a person meets them when something goes wrong: a full disk, a killed process, an output that
//! cannot be, an input that claims more than it holds; and the frames, cameras and digests that come out.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[path = "cli/run.rs"]
#[allow(dead_code, reason = "other tests use the rest")]
mod run;

use std::{
    fs,
    io::Write,
    path::Path,
    process::{Command, Output},
};

use run::{dgs, killed, names, ok, refused};

const DGS: &str = env!("CARGO_BIN_EXE_dgs");

/// `dgs` with `args` after the shell has taken `limits` upon itself.
#[cfg(unix)]
fn limited(folder: &Path, limits: &str, args: &str) -> Output {
    let script = format!("{limits}; exec {DGS} {args}");
    Command::new("sh").current_dir(folder).args(["-c", &script]).output().unwrap()
}

const SMALL: [&str; 4] = ["encode", "synth:balls:1000:2", "--pictures", "0"];

fn encode(folder: &Path, name: &str) -> Vec<u8> {
    ok(folder, &[&SMALL[..], &["--out", name]].concat());
    fs::read(folder.join(name)).unwrap()
}

#[cfg(unix)]
#[test]
fn a_disk_that_is_full_leaves_the_file_of_before() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let good = encode(at, "x.dgs");
    assert!(good.len() > 2048);
    let again = "encode synth:balls:2000:2 --pictures 0 --out x.dgs";
    // The system refuses what is beyond two blocks of 512 bytes, by an error or by ending the process.
    let error = limited(at, "trap '' XFSZ; ulimit -f 2", again);
    assert_eq!(error.status.code(), Some(1));
    assert!(String::from_utf8_lossy(&error.stderr).contains("x.dgs: cannot write"));
    assert_eq!(names(at), ["x.dgs"], "nothing is left beside it");
    let killed = limited(at, "ulimit -f 2", again);
    assert_eq!(killed.status.code(), None, "killed by a signal");
    assert_eq!(fs::read(at.join("x.dgs")).unwrap(), good);
    // Without the limit the same command does change it.
    assert!(limited(at, "true", again).status.success());
    assert_ne!(fs::read(at.join("x.dgs")).unwrap(), good);
}

#[test]
fn outputs_are_refused_before_the_work() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::create_dir(at.join("folder.dgs")).unwrap();
    fs::write(at.join("file"), b"x").unwrap();
    fs::create_dir(at.join("used")).unwrap();
    fs::write(at.join("used/notes.txt"), b"mine").unwrap();
    // The input does not exist: what is said of the output was said first.
    for (args, says) in [
        (vec!["encode", "none", "--out", "nowhere/x.dgs"], "nowhere: no such folder"),
        (vec!["encode", "none", "--out", "folder.dgs"], "is a folder; a file is needed"),
        (vec!["render", "none", "--out", "x.png/"], "names a folder; a file is needed"),
        (vec!["decode", "none", "--out", "nowhere/x.ply"], "nowhere: no such folder"),
        (vec!["decode", "none", "--out", "used"], "holds 1 files already"),
        (vec!["decode", "none", "--out", "used", "--overwrite"], "notes.txt"),
        (vec!["render", "none", "--out", "file"], "not a folder"),
        (vec!["convert", "none", "used"], "holds 1 files already"),
        (vec!["demo", "--scene", "none", "--out", "file/report"], "file/report"),
    ] {
        let text = refused(at, &args);
        assert!(text.contains(says), "dgs {args:?} says {text:?}");
    }
    assert_eq!(names(at), ["file", "folder.dgs", "used"]);
}

#[test]
fn a_folder_of_frames_is_whole_or_not_there() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:balls:4000:60", "--pictures", "0", "--out", "long.dgs"]);
    encode(at, "short.dgs");
    // Killed as soon as the first frame lies in the folder under its temporary name.
    let half = killed(at, &["decode", "long.dgs", "--out", "frames"], "frames", || {
        // Whether the folder can be made is tried first, and the trial vanishes again.
        let inside = |half: &String| fs::read_dir(at.join(half)).map_or(0, Iterator::count);
        names(at).into_iter().find(|name| name.starts_with(".frames.") && inside(name) > 1)
    });
    let text = refused(at, &["import", &half]);
    assert!(text.contains("complete: found false"), "{text}");

    ok(at, &["decode", "long.dgs", "--out", "frames"]);
    assert_eq!(names(&at.join("frames")).len(), 61, "sixty frames and their index");
    assert!(ok(at, &["import", "frames"]).contains("60 frames"));
    assert!(refused(at, &["decode", "short.dgs", "--out", "frames"]).contains("--overwrite"));
    assert!(ok(at, &["import", "frames"]).contains("60 frames"));
    ok(at, &["decode", "short.dgs", "--out", "frames", "--overwrite"]);
    assert_eq!(names(&at.join("frames")), ["frame_00000.ply", "frame_00001.ply", "sequence.json"]);
    // One frame less than the index says.
    fs::remove_file(at.join("frames/frame_00001.ply")).unwrap();
    assert!(refused(at, &["import", "frames"]).contains("frame_00001.ply"));
}

/// Names need not be Unicode: what is written is written, and said as far as it can be.
#[cfg(unix)]
#[test]
fn names_that_are_no_text_are_written_and_said() {
    use std::os::unix::ffi::OsStringExt as _;
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    encode(at, "a.dgs");
    let scene = "synth:balls:1000:2";
    let small = ["--width", "16", "--height", "16"];
    for (i, (args, ending)) in [
        (vec!["encode", scene, "--pictures", "0", "--out"], ".dgs"),
        (vec!["cut", "a.dgs", "--levels", "0"], ".dgs"),
        (vec!["stream", "a.dgs", "--load", "0.1", "--out"], ".dgs"),
        (vec!["convert", scene, "--frames", "0"], ".ply"),
        (vec!["decode", "a.dgs", "--out"], ".ply"),
        (vec!["render", "a.dgs", small[0], small[1], small[2], small[3], "--out"], ".png"),
        (vec!["compare", "a.dgs", scene, small[0], small[1], small[2], small[3], "--out"], ""),
        (vec!["man"], ""),
    ]
    .into_iter()
    .enumerate()
    {
        let name = [&[b'0' + i as u8, 0xff][..], ending.as_bytes()].concat();
        let path = at.join(std::ffi::OsString::from_vec(name));
        if args[0] == "man" {
            fs::create_dir(&path).unwrap();
        }
        let output = Command::new(DGS).current_dir(at).arg("--json").args(&args).arg(&path).output().unwrap();
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success() && path.exists(), "{args:?}: {error}");
        let said: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(said.to_string().contains('\u{fffd}'), "{said}");
        if ending == ".dgs" {
            let output = Command::new(DGS).arg("--json").arg("inspect").arg(&path).output().unwrap();
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        }
    }
}

/// What is under a temporary name is gone with whoever is interrupted; what was there before stays.
#[cfg(unix)]
#[test]
fn an_interruption_leaves_what_was_there_before_and_nothing_else() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:figure:2000:60", "--out", "a.dgs", "--pictures", "2"]);
    fs::write(at.join("a.gif"), b"before").unwrap();
    // At once, and while frames are being added.
    for (out, after_ms) in [("a.gif", 0), ("frames", 0), ("frames", 20), ("frames", 80), ("a.gif", 40)] {
        let mut running = Command::new(DGS)
            .current_dir(at)
            .args(["render", "a.dgs", "-o", out, "--width", "1000", "--height", "1000", "--json"])
            .stdout(std::process::Stdio::null())
            .spawn()
            .unwrap();
        let is_pending = || names(at).iter().any(|name| name.ends_with(".part"));
        while !is_pending() {
            assert!(running.try_wait().unwrap().is_none(), "{out} was finished before it was interrupted");
            std::thread::sleep(std::time::Duration::from_millis(1));
        }
        std::thread::sleep(std::time::Duration::from_millis(after_ms));
        let id = running.id().to_string();
        assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
        assert_eq!(running.wait().unwrap().code(), Some(130), "{out} after {after_ms} ms");
        assert_eq!(names(at), ["a.dgs", "a.gif"], "{out} after {after_ms} ms");
    }
    assert_eq!(fs::read(at.join("a.gif")).unwrap(), b"before");
}

#[test]
fn the_digest_is_that_of_the_conformance_streams() {
    let streams = Path::new(env!("CARGO_MANIFEST_DIR")).join("codec-core/tests/conformance");
    let index = fs::read_to_string(streams.join("index.txt")).unwrap();
    let mut checked = 0;
    for line in index.lines() {
        let cells: Vec<&str> = line.split(" | ").collect();
        let (Some(name), Some(digest)) = (cells.first(), cells.get(4)) else { continue };
        if digest.len() != 16 {
            continue;
        }
        let text = ok(&streams, &["decode", &format!("{name}.dgs"), "--digest"]);
        assert!(text.contains(&format!("digest {digest}\n")), "{name}: {text}");
        checked += 1;
    }
    assert!(checked >= 13, "{checked} streams");
    let text = ok(&streams, &["decode", "still.dgs", "--digest", "--level", "0"]);
    assert!(!text.contains("digest 1e3b5b062fad4e2f"), "fewer levels, another digest: {text}");
}

#[test]
fn gaussians_that_have_not_arrived_are_left_out() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let streams = Path::new(env!("CARGO_MANIFEST_DIR")).join("codec-core/tests/conformance");
    let whole = fs::read(streams.join("still.dgs")).unwrap();
    fs::write(at.join("cut.dgs"), &whole[..whole.len() / 3]).unwrap();
    let output = dgs(at, &["decode", "cut.dgs", "--out", "cut.ply"]);
    assert_eq!(output.status.code(), Some(2));
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    let missing: usize = said.split("up to ").nth(1).unwrap().split(' ').next().unwrap().parse().unwrap();
    assert!(said.contains("of 150: rows") && missing > 0 && missing < 150, "{said}");
    let text = ok(at, &["import", "cut.ply"]);
    assert!(text.contains(&format!("{} Gaussians", 150 - missing)), "{text}");
}

const TRANSFORMS: &str = r#"{"camera_angle_x": 0.7, "frames": [
    {"file_path": "./test/r_000", "time": 0.0, "transform_matrix": [[1,0,0,0],[0,1,0,0],[0,0,1,4],[0,0,0,1]]},
    {"file_path": "./test/r_001", "time": 1.0, "transform_matrix": [[1,0,0,0.5],[0,1,0,0],[0,0,1,5],[0,0,0,1]]}]}"#;

#[test]
fn cameras_of_files_choose_views_and_frames() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    encode(at, "a.dgs");
    fs::write(at.join("transforms_test.json"), TRANSFORMS).unwrap();
    let render = ["render", "a.dgs", "--cameras", "transforms_test.json"];
    let typed = |more: &[&'static str]| [&render[..], more].concat();
    let text = refused(at, &typed(&["--out", "views"]));
    assert!(text.contains("transforms_test.json") && text.contains("--width and --height"), "{text}");

    let sized = |more: &[&'static str]| typed(&[more, &["--width", "48", "--height", "32"]].concat());
    ok(at, &sized(&["--out", "views"]));
    assert_eq!(names(&at.join("views")), ["00000_r_000.png", "00001_r_001.png", "sequence.json"]);
    let one = ["--out", "one.png", "--camera", "./test/r_001"];
    ok(at, &sized(&one));
    let picture = |name: &str| fs::read(at.join(name)).unwrap();
    assert_eq!(picture("one.png"), picture("views/00001_r_001.png"), "its own time is the last frame");
    ok(at, &sized(&[&one[..], &["--frame", "0"]].concat()));
    assert_ne!(picture("one.png"), picture("views/00001_r_001.png"), "the frame typed goes first");
    let text = refused(at, &sized(&["--out", "one.png", "--camera", "7"]));
    assert!(text.contains("--camera is 7") && text.contains("0 to 1 are allowed"), "{text}");
    let text = refused(at, &sized(&["--out", "one.png"]));
    assert!(text.contains("2 cameras; choose one"), "{text}");

    // The same two cameras as COLMAP writes them: its axes are OpenCV's, half a turn about x from these.
    fs::create_dir(at.join("sparse")).unwrap();
    let focal = 24.0 / (0.35f64).tan();
    let write = |name: &str, text: String| fs::write(at.join("sparse").join(name), text).unwrap();
    write("cameras.txt", format!("1 PINHOLE 48 32 {focal} {focal} 24 16\n"));
    write("images.txt", "1 0 1 0 0 0 0 4 1 r_000.png\n\n2 0 1 0 0 -0.5 0 5 1 r_001.png\n\n".to_owned());
    ok(at, &["render", "a.dgs", "--cameras", "sparse", "--out", "colmap", "--frame", "1"]);
    assert_eq!(picture("colmap/00001_r_001.png"), picture("views/00001_r_001.png"));
    assert_ne!(picture("colmap/00000_r_000.png"), picture("views/00000_r_000.png"), "another frame");
    write("cameras.txt", "1 OPENCV_FISHEYE 48 32 1 1 1 1 0 0 0 0\n".to_owned());
    let text = refused(at, &["render", "a.dgs", "--cameras", "sparse/images.txt", "--out", "fish"]);
    assert!(text.contains("cameras.txt") && text.contains("OPENCV_FISHEYE"), "{text}");
}

#[test]
fn gaussians_in_another_order_give_the_same_picture() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["convert", "synth:figure:12000:1", "a.ply"]);
    let whole = fs::read(at.join("a.ply")).unwrap();
    let end = b"end_header\n";
    let start = whole.windows(end.len()).position(|w| w == end).unwrap() + end.len();
    let bytes = (whole.len() - start) / 12_000;
    let rows: Vec<&[u8]> = whole[start..].chunks_exact(bytes).collect();
    // 7,919 has no divisor in common with 12,000: every row comes once.
    let shuffled: Vec<&[u8]> = (0..rows.len()).map(|i| rows[i * 7919 % rows.len()]).collect();
    let with = |rows: &[&[u8]]| [&whole[..start], &rows.concat()].concat();
    fs::write(at.join("shuffled.ply"), with(&shuffled)).unwrap();
    fs::write(at.join("half.ply"), {
        let text = String::from_utf8(whole[..start].to_vec()).unwrap().replace("12000", "6000");
        [text.as_bytes(), &shuffled[..6000].concat()].concat()
    })
    .unwrap();
    let picture = |name: &str| {
        ok(at, &["render", name, "--out", "p.png", "--width", "128", "--height", "128"]);
        render_host::Image::decode(&fs::read(at.join("p.png")).unwrap(), [0.0; 3]).unwrap()
    };
    let psnr = |name: &str| render_host::metric::psnr(&picture(name), &picture("a.ply")).unwrap();
    assert!(psnr("shuffled.ply") > 60.0, "{} dB", psnr("shuffled.ply"));
    assert!(psnr("half.ply") < 40.0, "half of them give another picture");
}

/// A zip of one member: `head` and then zeros.
#[cfg(unix)]
fn zeros(name: &str, head: &[u8], zeros: usize) -> Vec<u8> {
    let mut zip = zip::ZipWriter::new(std::io::Cursor::new(Vec::new()));
    zip.start_file(name, zip::write::SimpleFileOptions::default()).unwrap();
    zip.write_all(head).unwrap();
    let piece = vec![0; 1 << 20];
    for _ in 0..zeros >> 20 {
        zip.write_all(&piece).unwrap();
    }
    zip.finish().unwrap().into_inner()
}

#[cfg(unix)]
#[test]
fn archives_that_unpack_to_more_than_is_accepted_take_little_memory() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let header = "{'descr': '<f4', 'fortran_order': False, 'shape': (22000000, 3), }\n";
    let header =
        [&b"\x93NUMPY\x01\x00"[..], &(header.len() as u16).to_le_bytes(), header.as_bytes()].concat();
    fs::write(at.join("bomb.npz"), zeros("means3d.npy", &header, 256 << 20)).unwrap();
    fs::write(at.join("bomb.sog"), zeros("meta.json", b"", 256 << 20)).unwrap();
    // Half of what either unpacks to, of which the program itself and its threads take most.
    let limit = "ulimit -v 131072; RAYON_NUM_THREADS=1; export RAYON_NUM_THREADS";
    for (name, says) in
        [("bomb.npz", "Gaussian count: found 22000000"), ("bomb.sog", "meta.json: found more")]
    {
        let output = limited(at, limit, &format!("import {name}"));
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{text}");
        assert!(text.contains(name) && text.contains(says), "{text}");
    }
    // The limit is one that counts: reading as many bytes does not fit.
    fs::write(at.join("large.splat"), vec![0; 256 << 20]).unwrap();
    assert_ne!(limited(at, limit, "import large.splat").status.code(), Some(0));
}

#[test]
fn no_input_is_written_over_and_streams_are_called_dgs() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let good = encode(at, "x.dgs");
    ok(at, &["convert", "x.dgs", "x.ply", "--frame", "0"]);
    let besides = "is read or written besides; name another file";
    for args in [
        &["cut", "x.dgs", "x.dgs", "--levels", "0"][..],
        &["cut", "x.dgs", "./x.dgs", "--levels", "0"],
        &["convert", "x.ply", "./x.ply"],
        &["convert", "x.dgs", "x.ply", "--merge", "x.ply"],
        &["stream", "x.dgs", "-o", "x.dgs"],
        &["encode", "synth:balls:1000:2", "-o", "d.dgs", "--decisions-out", "d.dgs"],
        &["encode", "x.ply", "-o", "d.dgs", "--decisions-out", "x.ply"],
        &["inspect", "x.dgs", "--manifest", "x.dgs"],
    ] {
        assert!(refused(at, args).contains(besides), "{args:?}");
    }
    let ending = "a stream is written here; the ending .dgs is allowed";
    for args in [
        &["encode", "x.ply", "-o", "x.ply"][..],
        &["stream", "x.dgs", "-o", "y.ply"],
        &["cut", "x.dgs", "y", "--levels", "0"],
    ] {
        assert!(refused(at, args).contains(ending), "{args:?}");
    }
    assert_eq!(fs::read(at.join("x.dgs")).unwrap(), good);
    assert_eq!(names(at), ["x.dgs", "x.ply"]);
}

/// A verb that goes on with damaged input ends with exit status 2.
#[test]
fn damage_decides_the_exit_status() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let whole = encode(at, "x.dgs");
    fs::write(at.join("part.dgs"), &whole[..whole.len() * 2 / 3]).unwrap();
    ok(at, &["convert", "x.dgs", "x.ply"]);
    let whole = fs::read(at.join("x.ply")).unwrap();
    fs::write(at.join("part.ply"), &whole[..whole.len() / 2]).unwrap();
    let small = ["--width", "32", "--height", "32"];
    let stream: [&[&str]; 5] = [
        &["convert", "part.dgs", "y.ply"],
        &["stream", "part.dgs"],
        &["cut", "part.dgs", "y.dgs", "--levels", "0"],
        &["decode", "part.dgs", "-o", "z.ply"],
        &["render", "part.dgs", "-o", "y.png"],
    ];
    let scene: [&[&str]; 7] = [
        &["import", "part.ply", "--keep-readable"],
        &["convert", "part.ply", "w.ply", "--keep-readable"],
        &["encode", "part.ply", "-o", "w.dgs", "--keep-readable", "--pictures", "0"],
        &["stream", "part.ply", "--keep-readable", "--pictures", "0"],
        &["render", "part.ply", "-o", "w.png", "--keep-readable"],
        &["demo", "--scene", "part.ply", "--out", "report", "--keep-readable", "--contexts", "1"],
        &[
            "train",
            "part.ply",
            "-o",
            "t",
            "--keep-readable",
            "--steps",
            "4",
            "--side",
            "32",
            "--cameras",
            "2",
        ],
    ];
    for args in stream.into_iter().chain(scene) {
        let args = if args[0] == "render" { [args, &small].concat() } else { args.to_vec() };
        let output = dgs(at, &args);
        let errors = String::from_utf8_lossy(&output.stderr).into_owned();
        assert_eq!(output.status.code(), Some(2), "{args:?}: {errors}");
        let says_it = !["decode", "demo"].contains(&args[0]);
        assert!(errors.contains("what is readable is kept") || !says_it, "{args:?}: {errors}");
    }
    assert!(refused(at, &["import", "part.ply"]).contains("part.ply"), "not asked for");
}

#[test]
fn what_would_be_ignored_is_refused() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    encode(at, "x.dgs");
    assert!(refused(at, &["decode", "x.dgs", "-o", "f", "--frame", "1"]).contains("every frame is written"));
    assert!(refused(at, &["convert", "x.dgs", "f", "--frame", "1"]).contains("every frame is written"));
    assert!(refused(at, &["view", "x.dgs", "--port", "0", "--seek", "3"]).contains("--window"));
    assert!(refused(at, &["import", "x.dgs"]).contains("is a stream, no scene"));
    fs::write(at.join("checkpoint.dgst"), "").unwrap();
    assert!(refused(at, &["import", "x.dgs"]).contains("checkpoint.dgst is the scene that was trained"));
    let pictures = ["encode", "synth:balls:1000:2", "-o", "y.dgs", "--background", "1"];
    assert!(refused(at, &pictures).contains("--target-psnr"));
    fs::write(at.join("trace.csv"), "0,2\n1,1\n").unwrap();
    assert!(ok(at, &["stream", "x.dgs", "--trace", "trace.csv"]).contains("limited by"));
    let noted =
        ["render", "x.dgs", "-o", "x.png", "--width", "32", "--height", "32", "--fps", "60", "--clip", "1"];
    assert!(ok(at, &noted).contains("x.dgs: is a stream; not used, being for scenes: --fps, --clip"));
}

#[test]
fn a_folder_that_holds_the_input_is_not_replaced() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["convert", "synth:balls:1000:2", "clip"]);
    let before = names(&at.join("clip"));
    ok(at, &["render", "clip", "-o", "pictures", "--width", "32"]);
    for args in [
        &["convert", "clip/frame_00000.ply", "clip", "--overwrite"][..],
        &["render", "clip/frame_00000.ply", "-o", "clip", "--overwrite"],
        &["compare", "pictures", "pictures", "-o", "pictures", "--overwrite"],
        &["compare", "pictures/00000.png", "pictures/00001.png", "-o", "pictures", "--overwrite"],
    ] {
        let error = refused(at, args);
        assert!(error.contains("is read or written besides"), "{args:?}: {error}");
    }
    assert_eq!(names(&at.join("clip")), before);
    // Asking whether a folder can be written makes none.
    refused(at, &["compare", "pictures", "nothing", "-o", "deep/maps"]);
    assert_eq!(names(at), ["clip", "pictures"]);
}

#[test]
fn a_folder_of_frames_comes_back_as_the_clip_that_it_was() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:balls:1000:4", "--fps", "25", "--pictures", "0", "-o", "clip.dgs"]);
    for verb in [&["convert", "clip.dgs", "converted"][..], &["decode", "clip.dgs", "-o", "decoded"]] {
        ok(at, verb);
        let text = ok(at, &["import", verb[verb.len() - 1]]);
        assert!(text.contains("4 frames at 25 fps") && !text.contains("an epoch of its own"), "{text}");
    }
    let text = ok(at, &["import", "decoded", "--fps", "50"]);
    assert!(text.contains("at 50 fps"), "{text}");
    // One frame of a stream is the same whether the others are decoded or not.
    ok(at, &["convert", "clip.dgs", "one.ply", "--frame", "2"]);
    ok(at, &["convert", "clip.dgs", "chosen.ply", "--frame", "2", "--filter", "opacity>=0"]);
    let text = ok(at, &["compare", "one.ply", "chosen.ply", "--width", "64"]);
    assert!(text.contains("psnr_db  mean 99"), "{text}");
    assert!(refused(at, &["convert", "clip.dgs", "no.ply", "--frame", "4"]).contains("0 to 3 are allowed"));
}

#[test]
fn one_frame_is_compared_with_that_of_a_clip() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    encode(at, "x.dgs");
    ok(at, &["convert", "x.dgs", "one.ply", "--frame", "1"]);
    let small = ["--width", "32", "--height", "32", "--up", "y"];
    let compared = |more: &[&'static str]| [&["compare", "one.ply", "x.dgs"][..], &small[..], more].concat();
    assert!(refused(at, &compared(&[])).contains("have 1 and 2 frames"));
    let text = ok(at, &compared(&["--frames", "1"]));
    assert!(text.contains("3 pictures"), "{text}");
    assert!(refused(at, &compared(&["--frames", "0..1"])).contains("have 1 and 2 frames"));
}

#[test]
fn a_manifest_without_packets_says_that_nothing_can_be_sent() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:balls:1000:2", "--out", "x.dgs"]);
    let whole = std::fs::read(at.join("x.dgs")).unwrap();
    let manifest = u32::from_le_bytes(whole[4..8].try_into().unwrap()) as usize;
    std::fs::write(at.join("bare.dgs"), &whole[..8 + manifest]).unwrap();
    let output = dgs(at, &["stream", "bare.dgs"]);
    let said = String::from_utf8_lossy(&output.stderr).into_owned();
    assert_eq!(output.status.code(), Some(1), "{said}");
    assert!(said.contains("bare.dgs: nothing of this stream can be sent"), "{said}");
}
