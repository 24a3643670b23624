//! Sessions of processes that are stopped, or wait for each other: what was shown is on disk however they
//! end, and a stream is served while it is written.

use std::{
    io::{BufRead, BufReader, Write},
    path::Path,
    process::{Command, Stdio},
    sync::mpsc,
    time::Duration,
};

use dgs_player::Player;
use dgs_quic::socket::{ClientConfig, FrameSink, Locator, PlayReport, Trust, play};
use tokio::runtime::Runtime;

use super::{
    Running,
    run::{ok, refused},
};

/// `dgs` with `args` in `folder`, going on.
fn started(folder: &Path, args: &[&str]) -> Running {
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    Running(command.current_dir(folder).args(args).stdout(Stdio::piped()).spawn().unwrap())
}

/// Says when the manifest has come, which is when the session is there; shows nothing.
struct Present(mpsc::Sender<()>);

impl FrameSink for Present {
    fn show(&mut self, _player: &mut Player, _frame: u32) -> Result<(), String> {
        Ok(())
    }

    fn manifest(&mut self, _message: &[u8]) {
        // The first time is what is waited for.
        let _ = self.0.send(());
    }
}

/// What is seen of `url` to its end; `present` hears when that has begun.
fn seen(url: &str, present: mpsc::Sender<()>) -> PlayReport {
    let locator: Locator = url.parse().unwrap();
    let trust = Trust::Pin(locator.pin.unwrap());
    let (config, mut screen) = (ClientConfig::new(locator, trust), Present(present));
    let playing = async { play(&config, &mut screen, std::future::pending()).await };
    Runtime::new().unwrap().block_on(playing).whole().unwrap()
}

/// The lines of a log.
fn rows(path: &Path) -> Vec<serde_json::Value> {
    let text = std::fs::read_to_string(path).unwrap_or_default();
    text.lines().map(|line| serde_json::from_str(line).unwrap()).collect()
}

/// The lines of a log once there are `count`.
fn soon(path: &Path, count: usize) -> Vec<serde_json::Value> {
    for _ in 0..2400 {
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
    // The last two seconds; the time to play counts from before the handshake, which a busy machine takes
    // long for.
    ok(at, &["play", url.trim(), "--seek", "8", "--duration", "20"]);
    let viewers = soon(&at.join("viewers.jsonl"), 1);
    drop(server);
    assert!(viewers.iter().any(|viewer| viewer["stream"] == "a" && viewer["packets"].as_u64() > Some(0)));
    assert!(rows(&at.join("viewers.jsonl")).len() >= viewers.len());
    let error = refused(at, &[&["serve", "a.dgs", "--log", "."][..], &address].concat());
    assert!(error.contains("--log .: is a folder"), "{error}");
}

/// A stream is served while it is written: who is there from the start sees all of it, who comes late the
/// newest window.
#[test]
fn standard_input_is_served_while_it_is_written() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Three windows of a second: what a busy machine writes or reads late is still in time.
    let encode = ["encode", "synth:figure:1000:12", "--fps", "4", "--window-frames", "4", "--pictures", "2"];
    ok(at, &[&encode[..], &["--out", "a.dgs"]].concat());
    let bytes = std::fs::read(at.join("a.dgs")).unwrap();
    let mut server = Running(
        Command::new(env!("CARGO_BIN_EXE_dgs"))
            .current_dir(at)
            .args(["serve", "-", "--listen", "127.0.0.1:0", "--no-http"])
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut input = server.0.stdin.take().unwrap();
    let manifest = 8 + u32::from_le_bytes(bytes[4..8].try_into().unwrap()) as usize;
    input.write_all(&bytes[..manifest]).unwrap();
    let mut url = String::new();
    BufReader::new(server.0.stdout.take().unwrap()).read_line(&mut url).unwrap();
    let url = url.trim();
    assert!(url.contains("/live#"), "{url}");
    let early = std::thread::scope(|scope| {
        let (present, is_present) = mpsc::channel();
        let early = scope.spawn(move || seen(url, present));
        // What comes before the session is there would be over when it begins.
        is_present.recv().unwrap();
        for part in bytes[manifest..].chunks(1000) {
            input.write_all(part).unwrap();
            std::thread::sleep(Duration::from_millis(2));
        }
        drop(input);
        early.join().unwrap()
    });
    assert!(early.shown_count == 12 && early.base_miss_rate < 0.5, "{early:?}");
    let late: serde_json::Value = serde_json::from_str(&ok(at, &["play", url, "--json"])).unwrap();
    assert_eq!(late["report"]["shown_count"], 4, "{late}");
    drop(server);
    let nothing = refused(at, &["serve", "-", "--listen", "127.0.0.1:0"]);
    assert!(nothing.contains("standard input: the input is no .dgs stream"), "{nothing}");
}
