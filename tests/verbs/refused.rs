//! Tests what is refused before anything is read or written, and what an interruption leaves.

use super::{names, ok, stopped};

#[test]
fn an_ending_alone_is_no_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:2";
    ok(at, &["encode", scene, "-o", "a.dgs", "--pictures", "0"]);
    for args in [
        vec!["convert", scene, ".ply"],
        vec!["decode", "a.dgs", "-o", ".SPZ"],
        vec!["render", scene, "-o", ".png"],
        vec!["render", "a.dgs", "-o", ".mp4"],
        vec!["compare", "a.dgs", scene, "-o", ".gif"],
    ] {
        let error = stopped(at, &args, 1);
        assert!(error.contains(": is an ending without a name"), "{args:?}: {error}");
    }
    assert_eq!(names(at), ["a.dgs"]);
}

#[cfg(target_os = "linux")]
#[test]
fn a_device_without_end_is_refused_at_its_start() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for (args, says) in [
        (vec!["import", "/dev/zero"], "/dev/zero: is no file, folder or stream"),
        (vec!["encode", "/dev/zero", "-o", "a.dgs"], "/dev/zero: is no file, folder or stream"),
        (vec!["convert", "/dev/zero", "a.ply"], "/dev/zero: is no file, folder or stream"),
        (vec!["render", "/dev/zero", "-o", "a.png"], "/dev/zero: is no file, folder or stream"),
        (vec!["inspect", "/dev/zero"], "/dev/zero: no usable .dgs file"),
        (vec!["inspect", "--decisions", "/dev/zero"], "/dev/zero: not a file of decisions"),
    ] {
        let error = stopped(at, &args, 1);
        assert!(error.contains(says), "{args:?}: {error}");
    }
    assert!(names(at).is_empty());
}

/// What makes H.264 here writes, as ffmpeg does, once there is no more to read; it needs no ffmpeg.
#[cfg(unix)]
#[test]
fn an_interruption_ends_what_makes_the_video_too() {
    use std::{os::unix::fs::PermissionsExt, process::Command, thread, time::Duration};

    let folder = tempfile::tempdir().unwrap();
    let (at, tools) = (folder.path().join("out"), folder.path().join("tools"));
    for folder in [&at, &tools] {
        std::fs::create_dir(folder).unwrap();
    }
    let (ffmpeg, started) = (tools.join("ffmpeg"), folder.path().join("started"));
    let script = "#!/bin/sh\n\
        case \"$*\" in *-encoders*) echo libx264; exit 0;; esac\n\
        for out; do :; done\n\
        echo > \"$STARTED\"\n\
        cat > /dev/null\n\
        echo video > \"$out\"\n";
    std::fs::write(&ffmpeg, script).unwrap();
    std::fs::set_permissions(&ffmpeg, std::fs::Permissions::from_mode(0o755)).unwrap();
    let path = std::env::var("PATH").unwrap_or_default();
    let mut running = Command::new(env!("CARGO_BIN_EXE_dgs"))
        .current_dir(&at)
        .args(["render", "synth:figure:1000:600", "-o", "x.mp4", "--video-codec", "h264", "--json"])
        .env("PATH", format!("{}:{path}", tools.display()))
        .env("STARTED", &started)
        .stdout(std::process::Stdio::null())
        .spawn()
        .unwrap();
    while !started.exists() {
        assert!(running.try_wait().unwrap().is_none(), "it ended before it began");
        thread::sleep(Duration::from_millis(5));
    }
    let id = running.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    assert_eq!(running.wait().unwrap().code(), Some(130));
    // Whoever had gone on would write now.
    thread::sleep(Duration::from_millis(300));
    assert!(names(&at).is_empty(), "{:?}", names(&at));
}
