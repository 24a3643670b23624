//! What a session has shown is on disk however its processes end.

use std::{
    io::{BufRead, BufReader},
    path::Path,
    process::{Command, Stdio},
    time::Duration,
};

use super::{
    Running,
    run::{ok, refused},
};

/// `dgs` with `args` in `folder`, going on.
fn started(folder: &Path, args: &[&str]) -> Running {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    Running(command.current_dir(folder).args(args).stdout(Stdio::piped()).spawn().unwrap())
}

/// The lines of a log.
fn rows(path: &Path) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The lines of a log once there are `count`.
fn soon(path: &Path, count: usize) -> Vec<serde_json::Value> {
    for _ in 0..400 {
        if rows(path).len() >= count {
            break;
        }
        std::thread::sleep(Duration::from_millis(50));
    }
    rows(path)
}

#[test]
fn a_killed_viewer_and_a_killed_server_lose_nothing_that_was_finished() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:figure:1000:300", "--out", "a.dgs", "--pictures", "0"]);
    let address = ["--listen", "127.0.0.1:0", "--no-http"];
    let mut server = started(at, &[&["serve", "a.dgs", "--log", "viewers.jsonl"][..], &address].concat());
    let mut url = String::new();
    BufReader::new(server.0.stdout.take().unwrap()).read_line(&mut url).unwrap();
    let viewer = started(at, &["play", url.trim(), "--log", "frames.jsonl"]);
    assert!(soon(&at.join("frames.jsonl"), 10).len() >= 10);
    drop(viewer);
    let frames = rows(&at.join("frames.jsonl"));
    let numbers: Vec<u64> = frames.iter().map(|row| row["frame"].as_u64().unwrap()).collect();
    assert!(numbers.windows(2).all(|pair| pair[0] < pair[1]), "{numbers:?}");
    assert!(frames.iter().all(|row| row["levels"].is_number() && row["base_miss"].is_number()));
    ok(at, &["play", url.trim(), "--duration", "0.5"]);
    let viewers = soon(&at.join("viewers.jsonl"), 1);
    drop(server);
    assert!(viewers.iter().any(|viewer| viewer["stream"] == "a" && viewer["packets"].as_u64() > Some(0)));
    assert!(rows(&at.join("viewers.jsonl")).len() >= viewers.len());
    let error = refused(at, &[&["serve", "a.dgs", "--log", "."][..], &address].concat());
    assert!(error.contains("--log .: is a folder"), "{error}");
}
