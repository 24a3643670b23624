//! Promises of the window: its pictures are the renderer's, it obeys keys and pointers, it takes files and
//! servers, and where there is no display it says so.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[path = "window/display.rs"]
mod display;
#[path = "cli/run.rs"]
#[allow(dead_code, reason = "other tests use the rest")]
mod run;

use std::{
    fs,
    io::{BufRead, BufReader},
    path::Path,
    process::{Child, Command, Stdio},
    thread::sleep,
    time::{Duration, Instant},
};

use dgs_viewer::{Overlay, Session, Up};
use display::Display;
use render_host::{Backend, Image, Settings, metric::psnr, render};
use run::{ok, refused};

const PROGRAM: &str = env!("CARGO_BIN_EXE_dgs");
const SIZE: [u32; 2] = [256, 192];
/// What the window is given, as typed and in 8 bits.
const BACKGROUND: (&str, [f32; 3]) = ("0.2,0.4,0.6", [0.2, 0.4, 0.6]);
/// Least agreement with the renderer of this machine, dB.
const MIN_DB: f64 = 50.0;
/// Longest wait for a picture: software draws it, on a busy machine.
const PATIENCE: Duration = Duration::from_secs(120);

/// A process that ends with its test.
struct Ending(Child);

impl Drop for Ending {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A stream of 30 frames in `folder`, of many small packets.
fn stream(folder: &Path) -> Session {
    let encode =
        ["encode", "synth:figure:1000:30", "--out", "a.dgs", "--pictures", "2", "--coarseness", "0.05"];
    ok(folder, &encode);
    let (mut session, damage) = Session::open(&fs::read(folder.join("a.dgs")).unwrap()).unwrap();
    assert!(damage.is_none());
    session.look_at_all(f64::from(SIZE[0]) / f64::from(SIZE[1]), Up::named("y").unwrap()).unwrap();
    session
}

/// What the renderer of this machine draws of `session`.
fn expected(session: &mut Session, [width, height]: [u32; 2]) -> Image {
    let camera = session.orbit().camera(width, height).unwrap();
    let shown = session.show().unwrap();
    let image = render(&shown.splats, &camera, &Settings::over(BACKGROUND.1)).unwrap().image;
    let rgb = image.to_rgb8().iter().map(|&v| f32::from(v) / 255.0).collect();
    Image::new(width, height, rgb).unwrap()
}

/// Whether this program has windows; if not, that it says so.
fn has_windows(folder: &Path) -> bool {
    if cfg!(feature = "window") {
        return true;
    }
    for flags in [["a.dgs", "--window"].as_slice(), &["a.dgs", "--screenshot", "a.png"]] {
        let error = refused(folder, &[["view"].as_slice(), flags].concat());
        assert!(error.contains("--features window"), "{error}");
    }
    false
}

#[test]
fn a_picture_without_a_display_is_the_renderers() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let mut session = stream(at);
    if !has_windows(at) {
        return;
    }
    let out = ["view", "a.dgs", "--screenshot", "a.png", "--width", "256", "--height", "192"];
    let more = ["--background", BACKGROUND.0, "--at", "7"];
    let output = run::dgs(at, &[out.as_slice(), &more].concat());
    let errors = String::from_utf8_lossy(&output.stderr);
    if errors.contains("no graphics adapter") {
        assert_ne!(std::env::var("CI").as_deref(), Ok("true"), "{errors}");
        eprintln!("SKIPPED: {errors}");
        return;
    }
    assert!(output.status.success() && Backend::HAS_GPU, "{errors}");
    let shown = Image::read(&at.join("a.png"), [0.0; 3]).unwrap();
    session.playback_mut().step(7);
    let db = psnr(&shown, &expected(&mut session, SIZE)).unwrap();
    assert!(db >= MIN_DB, "{db} dB");
    // The comparison can fail: another frame.
    session.playback_mut().step(1);
    assert!(psnr(&shown, &expected(&mut session, SIZE)).unwrap() < MIN_DB);
    // The base alone, painted by level.
    let more = ["--background", BACKGROUND.0, "--at", "8", "--level", "0", "--overlay"];
    ok(at, &[out.as_slice(), &more].concat());
    session.set_cap(0);
    session.set_overlay(Overlay::Levels);
    let shown = Image::read(&at.join("a.png"), [0.0; 3]).unwrap();
    let db = psnr(&shown, &expected(&mut session, SIZE)).unwrap();
    assert!(db >= MIN_DB, "base alone: {db} dB");
    let error = refused(at, &[out.as_slice(), &["--at", "30"]].concat());
    assert!(error.contains("--at is 30; a.dgs has frames 0 to 29"), "{error}");
    let error = refused(at, &["view", "a.dgs", "--screenshot", "a.jpg"]);
    assert!(error.contains("a.jpg: .png is allowed") && !at.join("a.jpg").exists(), "{error}");
    let error = refused(at, &["view", "a.dgs", "a.dgs", "--screenshot", "a.png"]);
    assert!(error.contains("2 inputs; a window shows one"), "{error}");
}

#[test]
fn where_there_is_no_display_a_sentence_says_so() {
    let folder = tempfile::tempdir().unwrap();
    stream(folder.path());
    if !has_windows(folder.path()) {
        return;
    }
    let mut command = Command::new(PROGRAM);
    command.current_dir(folder.path()).args(["view", "a.dgs", "--window"]);
    let output = command.env_remove("DISPLAY").env_remove("WAYLAND_DISPLAY").output().unwrap();
    let error = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{error}");
    assert!(error.contains("no window can be opened here") && !error.contains("panicked"), "{error}");
}

/// A window on a display, and the session that it should show.
struct Shown {
    display: Display,
    session: Session,
    size: [u32; 2],
}

impl Shown {
    /// Waits until the display shows the session.
    fn settle(&mut self, what: &str) {
        let expected = expected(&mut self.session, self.size);
        let end = Instant::now() + PATIENCE;
        loop {
            let db = psnr(&self.display.picture(self.size[0], self.size[1]), &expected).unwrap();
            if db >= MIN_DB {
                return;
            }
            assert!(Instant::now() < end, "{what}: {db} dB");
            sleep(Duration::from_millis(50));
        }
    }

    /// Waits until the title of `window` begins with `start`: titles follow pictures, up to four a second.
    fn wait_for_title(&self, window: &str, start: &str) {
        let end = Instant::now() + PATIENCE;
        loop {
            let title = self.display.act(&["getwindowname", window]);
            if title.starts_with(start) {
                return;
            }
            assert!(Instant::now() < end, "{title}");
            sleep(Duration::from_millis(50));
        }
    }

    /// Presses `key`; `change` is what it should do.
    fn press(&mut self, key: &str, change: impl FnOnce(&mut Session)) {
        let before = self.display.picture(self.size[0], self.size[1]);
        change(&mut self.session);
        // What is to be shown is not what was shown: the comparison can fail.
        assert!(psnr(&before, &expected(&mut self.session, self.size)).unwrap() < MIN_DB, "{key}");
        // Let go at once: on a busy machine a key that is down for a while repeats, or flies.
        self.display.act(&["key", "--delay", "0", key]);
        self.settle(key);
    }
}

#[test]
fn a_window_shows_what_the_renderer_draws_and_obeys() {
    let folder = tempfile::tempdir().unwrap();
    let session = stream(folder.path());
    if !has_windows(folder.path()) {
        return;
    }
    let Some(display) = Display::open() else { return };
    let mut command = Command::new(PROGRAM);
    command.current_dir(folder.path()).args(["view", "a.dgs", "--window", "--paused", "--width", "256"]);
    command.args(["--height", "192", "--background", BACKGROUND.0]).env("DISPLAY", &display.name);
    let _window = Ending(command.env_remove("WAYLAND_DISPLAY").spawn().unwrap());
    let mut shown = Shown { display, session, size: SIZE };
    shown.settle("the first frame");
    let window = shown.display.act(&["search", "--name", "paused"]);
    // Nobody manages windows here.
    shown.display.act(&["windowfocus", &window, "mousemove", "100", "80"]);
    shown.press("period", |session| session.playback_mut().step(1));
    shown.press("comma", |session| session.playback_mut().step(-1));
    shown.press("w", |session| session.orbit_mut().fly(0.0, 0.0, 0.08));
    shown.press("shift+Left", |session| session.orbit_mut().pan(24.0, 0.0, 192.0));
    shown.press("o", |session| session.set_overlay(Overlay::Levels));
    shown.press("1", |session| session.set_cap(0));
    shown.display.act(&["mousedown", "1", "mousemove", "130", "90", "mouseup", "1"]);
    shown.session.orbit_mut().turn(30.0, 10.0, 192.0);
    shown.settle("a drag");
    shown.wait_for_title(&window, "a · 0.02 of 1.00 s · level 0.0 of 3");
    shown.display.act(&["windowsize", &window, "320", "240"]);
    shown.size = [320, 240];
    shown.settle("another size");
    // Hidden and shown again.
    shown.display.act(&["windowunmap", &window]);
    shown.display.act(&["windowmap", &window]);
    shown.settle("shown again");
}

/// The first line that a server says.
fn begun(folder: &Path, args: &[&str]) -> (Ending, String) {
    let mut command = Command::new(PROGRAM);
    let mut server = command.current_dir(folder).args(args).stdout(Stdio::piped()).spawn().unwrap();
    let mut line = String::new();
    BufReader::new(server.stdout.take().unwrap()).read_line(&mut line).unwrap();
    (Ending(server), line.trim().to_owned())
}

#[test]
fn files_ranges_and_sessions_are_played_to_their_end() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    stream(at);
    if !has_windows(at) {
        return;
    }
    let Some(display) = Display::open() else { return };
    let (_pages, page) = begun(at, &["view", "a.dgs", "--port", "0"]);
    let (_sessions, session) = begun(at, &["serve", "a.dgs", "--listen", "127.0.0.1:0", "--no-http"]);
    let ranges = format!("{page}streams/a.dgs");
    let play = |input: &str| {
        let mut command = Command::new(PROGRAM);
        command
            .current_dir(at)
            .args(["view", input, "--window", "--once", "--width", "128", "--height", "96"]);
        command.args(["--json"]).env("DISPLAY", &display.name).env_remove("WAYLAND_DISPLAY");
        command.output().unwrap()
    };
    for input in ["a.dgs", "synth:figure:1000:10", &ranges, &session] {
        let output = play(input);
        let errors = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.success(), "{input}: {errors}");
        let report: serde_json::Value = serde_json::from_slice(&output.stdout).unwrap();
        assert!(report["frames"].as_u64().unwrap() > 0, "{input}: {report}");
        assert_eq!(report["warnings"].as_array().unwrap().len(), 0, "{input}: {report}");
    }
    for (input, says) in [
        (format!("{page}streams/none.dgs"), "none.dgs: http status: 404"),
        (session.split('#').next().unwrap().to_owned(), "its #PIN is missing"),
    ] {
        let output = play(&input);
        let error = String::from_utf8_lossy(&output.stderr);
        assert!(output.status.code() == Some(1) && error.contains(says), "{input}: {error}");
    }
}
