//! Tests `dgs train` as typed: what it writes, how it stops and goes on, what it refuses.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

#[path = "train/device.rs"]
mod device;
#[path = "train/encoder.rs"]
mod encoder;
#[cfg(unix)]
#[path = "train/photographs.rs"]
mod photographs;
#[path = "train/rank.rs"]
mod rank;
#[path = "train/recorded.rs"]
mod recorded;
#[path = "train/resumed.rs"]
mod resumed;
#[path = "train/utility.rs"]
mod utility;

use std::{
    fs,
    path::Path,
    process::{Command, Output, Stdio},
    thread,
    time::Duration,
};

const SCENE: &str = "synth:balls:1000:3";
/// Small enough to train in a few seconds.
const SMALL: [&str; 16] = [
    "--side",
    "64",
    "--cameras",
    "6",
    "--steps",
    "200",
    "--nodes",
    "16",
    "--gaussians",
    "500",
    "--pictures",
    "0",
    "--checkpoint-every",
    "20",
    "--background",
    "0",
];

fn command(folder: &Path, args: &[&str]) -> Command {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    command.current_dir(folder).args(["train", SCENE]).args(SMALL).args(args);
    command
}

fn train(folder: &Path, args: &[&str]) -> Output {
    command(folder, args).output().unwrap()
}

fn ok(folder: &Path, args: &[&str]) -> String {
    let output = train(folder, args);
    assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
    String::from_utf8(output.stdout).unwrap()
}

fn refused(folder: &Path, args: &[&str]) -> String {
    let output = train(folder, args);
    assert_eq!(output.status.code(), Some(1), "{args:?}");
    String::from_utf8(output.stderr).unwrap()
}

/// How what `start` gives ended, which trains into `out` and is interrupted once `file` is there. On a busy
/// machine this process may wait until no training is left to interrupt: then the other has ended with 0, or
/// with 130 at work on what follows, and all of it is done again.
#[cfg(unix)]
fn interrupted(out: &Path, file: &str, start: impl Fn() -> Command) -> Output {
    let mut left = 5;
    loop {
        let mut child = start().stdout(Stdio::null()).stderr(Stdio::piped()).spawn().unwrap();
        while !out.join(file).exists() && child.try_wait().unwrap().is_none() {
            thread::sleep(Duration::from_millis(5));
        }
        if child.try_wait().unwrap().is_none() {
            let _ = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
        }
        let ended = child.wait_with_output().unwrap();
        left -= 1;
        let is_too_late = matches!(ended.status.code(), Some(0 | 130));
        if !is_too_late || left == 0 {
            return ended;
        }
        fs::remove_dir_all(out).unwrap();
    }
}

#[test]
fn a_training_writes_a_stream_a_checkpoint_a_log_and_a_report() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = ok(at, &["-o", "out", "--utility"]);
    assert!(text.contains("200 steps") && text.contains("test views, as decoded from scene.dgs"), "{text}");
    assert!(text.contains(", FLIP ") && text.contains("LPIPS: no weights given"), "{text}");
    assert!(text.contains("utilities, training photographs\n  level 0: "), "{text}");
    assert!(text.contains("utilities, test photographs\n"), "{text}");
    // Its end pruned and rounded, and says so.
    assert_eq!(text.matches("  pruned: ").count(), 2, "{text}");
    assert!(text.contains("  rounded: canonical values ") && text.contains("  harmonics: "), "{text}");
    let log = fs::read_to_string(at.join("out/log.csv")).unwrap();
    assert!(log.starts_with("step,seconds,loss") && log.contains("\n200,"), "{log}");
    let page = fs::read_to_string(at.join("out/report.html")).unwrap();
    assert!(page.contains("<svg") && page.contains("data:image/png;base64,"));
    // Photographs, pictures before and after, errors: four rows of one picture per test view.
    let preview = render_host::Image::read(&at.join("out/preview.png"), [0.0; 3]).unwrap();
    let columns = (preview.width() + 4) / 68;
    assert_eq!((preview.width(), preview.height()), (68 * columns - 4, 4 * 68 - 4), "{columns} views");
    let row = |number: u32| -> Vec<[f32; 3]> {
        (0..64)
            .flat_map(|y| (0..64).map(move |x| (x, y)))
            .map(|(x, y)| preview.pixel(x, 68 * number + y).unwrap())
            .collect()
    };
    let apart = |a: &[[f32; 3]], b: &[[f32; 3]]| -> f32 {
        a.iter().zip(b).flat_map(|(a, b)| a.iter().zip(b)).map(|(a, b)| (a - b).powi(2)).sum()
    };
    let (photograph, before, after) = (row(0), row(1), row(2));
    assert!(apart(&before, &photograph) > 2.0 * apart(&after, &photograph), "training brings it nearer");
    assert!(page.contains("before the first step and after the last"));
    assert!(fs::read(at.join("out/preview.png")).unwrap().starts_with(b"\x89PNG"));

    // The stream and the checkpoint are scenes for the other verbs.
    let dgs = |args: &[&str]| {
        let output = Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(at).args(args).output().unwrap();
        assert!(output.status.success(), "{args:?}: {}", String::from_utf8_lossy(&output.stderr));
        String::from_utf8(output.stdout).unwrap()
    };
    assert!(dgs(&["import", "out/checkpoint.dgst"]).contains("3 frames"));
    dgs(&["render", "out/scene.dgs", "-o", "a.png", "--width", "64", "--height", "64"]);
    // The sender finds the utilities beside the stream, and says so where there are none.
    let warned = |stream: &str| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
        let output = command.current_dir(at).args(["stream", stream]).output().unwrap();
        String::from_utf8(output.stderr).unwrap().contains("no utilities beside it")
    };
    fs::copy(at.join("out/scene.dgs"), at.join("alone.dgs")).unwrap();
    assert!(!warned("out/scene.dgs") && warned("alone.dgs"));

    // A folder in use is refused, kept, and replaced only where asked.
    let before = fs::read(at.join("out/scene.dgs")).unwrap();
    let error = refused(at, &["-o", "out"]);
    assert!(error.contains("out: holds a training; --resume"), "{error}");
    let error = refused(at, &["-o", "new.dgs"]);
    assert!(error.contains("new.dgs: several files are written") && !at.join("new.dgs").exists(), "{error}");
    assert_eq!(fs::read(at.join("out/scene.dgs")).unwrap(), before);
    ok(at, &["-o", "out", "--overwrite", "--utility"]);
    assert!(fs::read(at.join("out/scene.dgs")).unwrap() == before, "the same bytes");

    // A damaged checkpoint is refused by name.
    let mut bytes = fs::read(at.join("out/checkpoint.dgst")).unwrap();
    let middle = bytes.len() / 2;
    bytes[middle] ^= 1;
    fs::write(at.join("out/checkpoint.dgst"), bytes).unwrap();
    let error = refused(at, &["-o", "out", "--resume"]);
    assert!(error.contains("checkpoint.dgst") && error.contains("checksum"), "{error}");
}

/// Interrupted at any step and resumed, a training gives the bytes of one that was not interrupted.
#[cfg(unix)]
#[test]
fn an_interrupted_training_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["-o", "whole"]);
    let stopped = interrupted(&at.join("parts"), "checkpoint.dgst", || command(at, &["-o", "parts"]));
    let heard = String::from_utf8_lossy(&stopped.stderr);
    assert_eq!(stopped.status.code(), Some(2), "done, but not all of it: {heard}");
    assert!(heard.contains("interrupted: the checkpoint is whole; its stream and report follow"), "{heard}");
    // Without --steps: as many as the checkpoint was part of.
    let output = Command::new(env!("CARGO_BIN_EXE_dgs"))
        .current_dir(at)
        .args([
            "train",
            SCENE,
            "-o",
            "parts",
            "--resume",
            "--side",
            "64",
            "--cameras",
            "6",
            "--pictures",
            "0",
        ])
        .output()
        .unwrap();
    assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
    assert_eq!(fs::read(at.join("parts/scene.dgs")).unwrap(), fs::read(at.join("whole/scene.dgs")).unwrap());

    // What cannot be had of a training that is there is refused, and leaves it as it is.
    let longer =
        ["train", SCENE, "-o", "whole", "--resume", "--side", "64", "--cameras", "6", "--steps", "300"];
    let output = Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(at).args(longer).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.code() == Some(1) && error.contains("complete, after 200 steps"), "{error}");
    let error = refused(at, &["-o", "whole", "--resume", "--seed", "9", "--rigidity", "0.5"]);
    assert!(error.contains("--rigidity, --seed: not as in the checkpoint"), "{error}");
    assert!(at.join("whole/scene.dgs").exists());
    // What is replaced does not pass for what replaces it.
    fs::create_dir(at.join("whole/epoch-0")).unwrap();
    fs::write(at.join("whole/epoch-0/checkpoint.dgst"), "of another").unwrap();
    fs::write(at.join("whole/delivery.json"), "{}").unwrap();
    let error = refused(at, &["-o", "whole", "--overwrite", "--options", "nowhere.json"]);
    assert!(error.contains("nowhere.json") && at.join("whole/scene.dgs").exists(), "{error}");
    let own = ["train", "whole/checkpoint.dgst", "-o", "whole", "--overwrite", "--delivery", "iid"];
    let output = Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(at).args(own).output().unwrap();
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("checkpoint.dgst: is read or written besides"), "{error}");
    assert!(at.join("whole/scene.dgs").exists());
    ok(at, &["-o", "whole", "--overwrite"]);
    assert!(!at.join("whole/epoch-0").exists() && !at.join("whole/delivery.json").exists());
}

/// One ring becomes three balls: trained as two epochs that is seen better than as one.
#[cfg(unix)]
#[test]
fn a_clip_that_becomes_another_is_trained_in_parts_and_goes_on_from_any() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let births = |args: &[&str]| {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
        let named = SMALL.map(|arg| if arg == "500" { "1500" } else { arg });
        command.current_dir(at).args(["train", "synth:births:1000:12", "--json"]).args(named).args(args);
        command
    };
    let json = |mut command: Command| -> serde_json::Value {
        let output = command.output().unwrap();
        assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
        serde_json::from_slice(&output.stdout).unwrap()
    };
    let decoded_db = |report: &serde_json::Value| report["figures"][1]["found"]["psnr_db"].as_f64().unwrap();
    let parts = json(births(&["-o", "parts", "--overwrite"]));
    let frames = &parts["epochs"]["frames"];
    assert_eq!(*frames, serde_json::json!([{"start": 0, "end": 6}, {"start": 6, "end": 12}]));
    assert_eq!(parts["steps"], 200, "steps are shared out");
    assert_eq!(parts["options"]["max_gaussians"], 1500, "of the whole, not of its first part");
    for epoch in 0..2 {
        let log = fs::read_to_string(at.join(format!("parts/epoch-{epoch}/log.csv"))).unwrap();
        let gaussians =
            log.lines().skip(1).map(|line| line.split(',').nth(3).unwrap().parse::<usize>().unwrap());
        assert!(gaussians.max() <= Some(750), "so are Gaussians: {log}");
    }
    let whole = json(births(&["-o", "whole", "--split", "0"]));
    assert!(whole["epochs"].is_null());
    assert!(decoded_db(&parts) > decoded_db(&whole) + 1.0, "{} {}", decoded_db(&parts), decoded_db(&whole));
    let log = fs::read_to_string(at.join("parts/log.csv")).unwrap();
    assert!(log.contains("\n100,") && log.contains("\n200,"), "{log}");

    // Left in the first part or the second, it goes on to the same bytes.
    let stopped = interrupted(&at.join("left"), "epoch-0/checkpoint.dgst", || births(&["-o", "left"]));
    let heard = String::from_utf8_lossy(&stopped.stderr);
    assert_eq!(stopped.status.code(), Some(2), "done, but not all of it: {heard}");
    let again = ["-o", "left", "--resume"];
    // What is typed of the training is what it was begun with, and steps are more than were taken.
    let left = |args: &[&str]| {
        let cameras = ["--side", "64", "--cameras", "6", "--pictures", "0", "--json"];
        let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
        command.current_dir(at).args(["train", "synth:births:1000:12"]).args(again).args(cameras).args(args);
        command
    };
    for (args, named) in [
        (["--steps", "2"], "--steps is 2, 1 of them for left/epoch-"),
        (["--gaussians", "1400"], "epochs.json: --gaussians: not as in the checkpoint"),
    ] {
        let error = String::from_utf8(left(&args).output().unwrap().stderr).unwrap();
        assert!(error.contains(named), "{error}");
    }
    // Of what is not typed, parts that are begun later have what was typed at first.
    json(left(&[]));
    let stream = |folder: &str| fs::read(at.join(folder).join("scene.dgs")).unwrap();
    assert_eq!(stream("left"), stream("parts"));
    let error = String::from_utf8(left(&["--steps", "300"]).output().unwrap().stderr).unwrap();
    assert!(error.contains("complete, after 200 steps"), "{error}");
    let plan = fs::read_to_string(at.join("left/epochs.json")).unwrap();
    fs::write(at.join("left/epochs.json"), plan.replace("12", "13")).unwrap();
    let refused = births(&again).output().unwrap();
    let error = String::from_utf8_lossy(&refused.stderr);
    assert!(error.contains("epochs.json: of 13 frames; the scene has 12"), "{error}");
}

#[test]
fn fine_tuning_for_delivery_fixes_its_rules_before_it_starts() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let config = r#"{"updates": 4, "worlds": 4, "validation": {"every": 4, "states": 4, "candidates": 1}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    let text = ok(at, &["-o", "out", "--delivery", "config.json", "--references", "8"]);
    assert!(text.contains("4 of 4 updates for delivery, mixed"), "{text}");
    assert!(text.contains("background [0.0, 0.0, 0.0]"), "{text}");
    let registration = fs::read_to_string(at.join("out/registration.json")).unwrap();
    assert!(registration.contains("config_hash") && registration.contains("selection_rule"));
    let record: serde_json::Value =
        serde_json::from_slice(&fs::read(at.join("out/delivery.json")).unwrap()).unwrap();
    assert_eq!(record["terms"].as_array().map(Vec::len), Some(4), "a set of terms per update");
    // The log has a line per update, and what validation saw of the given scene and of the candidate.
    let log = fs::read_to_string(at.join("out/delivery.csv")).unwrap();
    let lines: Vec<&str> = log.lines().collect();
    assert!(lines.len() == 6 && lines[0].starts_with("update,seconds,objective,expected"), "{log}");
    assert!(!lines[1].ends_with(",,") && lines[2].ends_with(",,,") && !lines[5].ends_with(",,"), "{log}");
    // The page has curves, pictures, and the hash that was registered.
    let page = fs::read_to_string(at.join("out/report.html")).unwrap();
    let hash = record["registration"]["config_hash"].as_str().unwrap();
    for part in
        ["<svg", "data:image/png;base64,", hash, "10 % lost in bursts of six", "E[D], mean over worlds"]
    {
        assert!(page.contains(part), "{part}");
    }
    assert!(text.contains("out/report.html"), "{text}");
    assert!(!at.join("out/encoder.json").exists(), "nothing was trained that others could encode");
    let white = ["train", SCENE, "-o", "white", "--side", "64", "--cameras", "6", "--pictures", "0"];
    let output = Command::new(env!("CARGO_BIN_EXE_dgs"))
        .current_dir(at)
        .args(white)
        .args(["--delivery", "config.json", "--references", "8", "--background", "1"])
        .args(["--frames", "2", "--split", "1", "--evaluations", "3", "--encoding-loss", "0.2"])
        .output()
        .unwrap();
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success() && text.contains("background [1.0, 1.0, 1.0]"), "{text}");
    assert!(text.contains("one: --frames, --split, --evaluations, --encoding-loss\n"), "{text}");
    let error = refused(at, &["-o", "other", "--delivery", "config.json", "--utility"]);
    assert!(error.contains("--utility") && error.contains("measures neither"), "{error}");
    let error = refused(at, &["-o", "other", "--delivery", "no-such-variant"]);
    assert!(error.contains("no-such-variant") && error.contains("burst-cvar"), "{error}");
}

/// Interrupted, a fine-tuning stops at its next step and writes what exists.
#[cfg(unix)]
#[test]
fn an_interrupted_fine_tuning_writes_what_exists() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // More updates than anybody waits for: only the interruption ends them.
    let config = r#"{"updates": 3000, "worlds": 2, "warm_up": 0.0,
        "validation": {"every": 4, "states": 2, "candidates": 1}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    let args = ["-o", "out", "--delivery", "config.json", "--references", "8", "--json"];
    let mut child = command(at, &args).stdout(Stdio::piped()).spawn().unwrap();
    // It is written before the first update.
    while !at.join("out/registration.json").exists() && child.try_wait().unwrap().is_none() {
        thread::sleep(Duration::from_millis(5));
    }
    let another = train(at, &["-o", "out", "--overwrite"]);
    let _ = Command::new("kill").args(["-INT", &child.id().to_string()]).status().unwrap();
    let output = child.wait_with_output().unwrap();
    // Two trainings do not write into one folder.
    let error = String::from_utf8_lossy(&another.stderr);
    let is_refused = another.status.code() == Some(1);
    assert!(is_refused && error.contains("out: another dgs train is at work in it"), "{error}");
    assert_eq!(output.status.code(), Some(2), "done, but not all of it");
    let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
    assert_eq!(report["interrupted"], true);
    assert!(report["updates"].as_u64().is_some_and(|updates| updates > 0), "{report}");
    assert!(fs::read_to_string(at.join("out/delivery.json")).unwrap().contains("candidates"));
    assert!(at.join("out/scene.dgs").exists());
}

#[test]
fn options_and_inputs_are_refused_by_name() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    fs::write(at.join("options.json"), r#"{"rigidty": 1}"#).unwrap();
    let error = refused(at, &["-o", "out", "--options", "options.json"]);
    assert!(error.contains("options.json") && error.contains("rigidty"), "{error}");
    fs::write(at.join("options.json"), "[]").unwrap();
    let error = refused(at, &["-o", "out", "--options", "options.json"]);
    assert!(error.contains(r#"an object, {"max_gaussians": …}, is needed"#), "{error}");
    // Names are offered where what was typed is no file, not where its file is wrong.
    for (config, named, offers_names) in [
        (r#"{"worlds": 100000000000}"#, "worlds is 100000000000; 1 to 10000 is allowed", false),
        (r#"{"wrlds": 1}"#, "config.json: unknown field `wrlds`", false),
        ("", "EOF", false),
        ("nowhere.json", "nowhere.json: ", true),
    ] {
        fs::write(at.join("config.json"), config).unwrap();
        let typed = if offers_names { config } else { "config.json" };
        let error = refused(at, &["-o", "out", "--delivery", typed]);
        assert!(error.contains("--delivery") && error.contains(typed) && error.contains(named), "{error}");
        assert_eq!(error.contains("burst-cvar"), offers_names, "{error}");
    }
    let error = refused(at, &["-o", "out", "--resume"]);
    assert!(error.contains("checkpoint.dgst: no such checkpoint"), "{error}");
    let output = train(at, &["-o", "out", "--canonical-time=nan"]);
    assert_eq!(output.status.code(), Some(64));
    fs::write(at.join("weights"), b"none").unwrap();
    let error = refused(at, &["-o", "out", "--lpips", "weights"]);
    assert!(error.contains("--lpips: weights") && error.contains("safetensors"), "{error}");
    assert!(!at.join("out/scene.dgs").exists());
    fs::create_dir(at.join("empty")).unwrap();
    let output =
        Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(at).args(["train", "empty"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
}

/// Photographs that are not there stop an encoding before it writes anything.
#[test]
fn utilities_need_photographs_that_are_there() {
    let folder = tempfile::tempdir().unwrap();
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    command.current_dir(folder.path()).args(["encode", SCENE, "-o", "a.dgs", "--utility"]);
    let output = command.args(["--photographs", "nowhere"]).output().unwrap();
    assert_eq!(output.status.code(), Some(1));
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(error.contains("--photographs: nowhere: no dataset"), "{error}");
    assert!(!folder.path().join("a.dgs").exists());
}

fn dgs(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(folder).args(args).output().unwrap()
}

/// Interrupted and resumed, a fine-tuning gives the bytes of one that was not interrupted.
#[cfg(unix)]
#[test]
fn an_interrupted_fine_tuning_goes_on_to_the_same_bytes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let config = r#"{"updates": 60, "worlds": 2, "validation": {"every": 4, "states": 2, "candidates": 2}}"#;
    fs::write(at.join("config.json"), config).unwrap();
    fs::write(at.join("other.json"), config.replace("60", "61")).unwrap();
    let args = |out: &'static str, more: &'static str| {
        ["-o", out, "--delivery", "config.json", "--references", "8", more].map(str::to_owned)
    };
    let run = |out, more| {
        let args = args(out, more);
        ok(at, &args.iter().map(String::as_str).filter(|arg| !arg.is_empty()).collect::<Vec<_>>())
    };
    run("whole", "");
    let tuned = || command(at, &["-o", "parts", "--delivery", "config.json", "--references", "8"]);
    let stopped = interrupted(&at.join("parts"), "delivery.dgst", tuned);
    let heard = String::from_utf8_lossy(&stopped.stderr);
    assert_eq!(stopped.status.code(), Some(2), "done, but not all of it: {heard}");
    let registered = fs::read(at.join("parts/registration.json")).unwrap();
    let error = refused(at, &["-o", "parts", "--delivery", "other.json", "--references", "8", "--resume"]);
    assert!(error.contains("delivery.dgst") && error.contains("the configuration"), "{error}");
    assert!(fs::read(at.join("parts/registration.json")).unwrap() == registered, "what was fixed stays");
    run("parts", "--resume");
    let written = |out: &str, file: &str| fs::read(at.join(out).join(file)).unwrap();
    assert!(written("whole", "scene.dgs") == written("parts", "scene.dgs"));
    let record = |out: &str| {
        String::from_utf8(written(out, "delivery.json")).unwrap().replace(&format!("{out}/registration"), "")
    };
    assert_eq!(record("whole"), record("parts"));
    let bytes = fs::read(at.join("parts/delivery.dgst")).unwrap();
    fs::write(at.join("parts/delivery.dgst"), &bytes[..bytes.len() - 1]).unwrap();
    let error = refused(at, &["-o", "parts", "--delivery", "config.json", "--references", "8", "--resume"]);
    assert!(error.contains("delivery.dgst") && error.contains("checksum"), "{error}");
}

/// A log that is damaged keeps nothing from going on, and a scene that was trained is not overwritten by a
/// fine-tuning of what it was trained from.
#[test]
fn a_damaged_log_is_put_aside_and_a_trained_scene_is_not_fine_tuned_from_its_source() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["-o", "out"]);
    let stream = fs::read(at.join("out/scene.dgs")).unwrap();
    fs::write(at.join("out/log.csv"), "of,another\n1,2\n").unwrap();
    let output = train(at, &["-o", "out", "--resume"]);
    let error = String::from_utf8(output.stderr).unwrap();
    assert!(output.status.success() && error.contains("log.csv: line 1 is not"), "{error}");
    assert!(fs::read(at.join("out/scene.dgs")).unwrap() == stream);
    assert_eq!(fs::read_to_string(at.join("out/log.csv.damaged")).unwrap(), "of,another\n1,2\n");
    let error = refused(at, &["-o", "out", "--resume", "--delivery", "iid"]);
    assert!(error.contains("--delivery: fine-tunes synth:balls:1000:3 as it is"), "{error}");
    assert!(fs::read(at.join("out/scene.dgs")).unwrap() == stream);
}
