//! Tests the command line: every verb as typed, its exit status, what it says about bad input.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

#[cfg(unix)]
#[path = "cli/inputs.rs"]
mod inputs;
#[cfg(unix)]
#[path = "cli/logged.rs"]
mod logged;
#[path = "cli/never_drawn.rs"]
mod never_drawn;
#[path = "cli/run.rs"]
#[allow(dead_code, reason = "other tests use the rest")]
mod run;
#[path = "cli/streamed.rs"]
mod streamed;

use std::{path::Path, process::Command};

use run::{dgs, ok, refused, stopped};

/// Decisions that were written out replay to the same bytes; a file of something else is named.
#[test]
fn decisions_are_written_inspected_and_replayed() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let scene = "synth:figure:1000:6";
    let text = ok(at, &["encode", scene, "--out", "a.dgs", "--pictures", "2", "--decisions-out", "a.json"]);
    assert!(text.contains("fill") && text.contains("feature weights: position 1, displacement 2"), "{text}");
    ok(at, &["encode", scene, "--out", "b.dgs", "--decisions", "a.json"]);
    assert_eq!(std::fs::read(at.join("a.dgs")).unwrap(), std::fs::read(at.join("b.dgs")).unwrap());
    let text = ok(at, &["inspect", "--decisions", "a.json"]);
    assert!(text.contains("decisions for profile dgs1") && text.contains("epoch 0: "), "{text}");
    let error = refused(at, &["encode", scene, "--out", "c.dgs", "--decisions", "a.dgs"]);
    assert!(error.contains("a.dgs: not a file of decisions"), "{error}");
    let error = refused(at, &["encode", "synth:figure:1000:9", "--out", "c.dgs", "--decisions", "a.json"]);
    assert!(error.contains("decisions, epoch 0: frames of all windows is 6; 9..=9 is allowed"), "{error}");
    let error =
        stopped(at, &["encode", scene, "--out", "c.dgs", "--decisions", "a.json", "--search", "5"], 64);
    assert!(error.contains("--search"), "{error}");
    // What one file would write over another is refused before the work.
    for decisions in ["--decisions", "--decisions-out"] {
        let error =
            refused(at, &["encode", scene, "-o", "u.dgs", "--utility", decisions, "./u.utility.json"]);
        assert!(error.contains("u.utility.json: is read or written besides"), "{error}");
    }
}

#[test]
fn the_walk_verb_by_verb() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let text = ok(at, &["import", "synth:figure:1000:12"]);
    assert!(text.contains("12 frames") && text.contains("1000 Gaussians"), "{text}");

    let json = ok(at, &["--json", "encode", "synth:figure:1000:12", "--out", "a.dgs", "--repair-set", "4"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["ledger"]["gaussians"], 1000);
    assert!(json["bits_per_gaussian"].as_f64().unwrap() > 10.0);

    let json = ok(at, &["--json", "inspect", "a.dgs"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["profile"], "dgs1");
    assert_eq!(json["missing_packets"], 0);
    assert!(json["parity_packets"].as_u64().unwrap() > 0);

    ok(at, &["decode", "a.dgs", "--out", "frames"]);
    assert_eq!(std::fs::read_dir(at.join("frames")).unwrap().count(), 13, "and their index");
    let text = ok(at, &["import", "frames", "--identity-stored"]);
    assert!(text.contains("1 epoch, 12 frames"), "{text}");

    ok(at, &["render", "a.dgs", "--out", "a.png", "--frame", "5", "--width", "64", "--height", "48"]);
    let png = std::fs::read(at.join("a.png")).unwrap();
    assert_eq!(&png[1..4], b"PNG");

    let json = ok(at, &["--json", "stream", "a.dgs", "--policy", "layered"]);
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    assert_eq!(json["report"]["policy"], "layered");
    assert_eq!(json["report"]["frames"].as_array().unwrap().len(), 12);
}

#[test]
fn the_demo_writes_its_report_and_names_it_last() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let args =
        ["demo", "--scene", "synth:balls:1000:10", "--width", "64", "--height", "64", "--contexts", "1"];
    let text = ok(at, &args);
    let last = text.lines().last().unwrap();
    assert_eq!(last, Path::new("dgs-demo").join("report.html").to_str().unwrap());
    let columns: Vec<&str> = text.lines().nth(1).unwrap().split_whitespace().collect();
    assert_eq!(columns[..6], ["scheduler", "PSNR", "worst", "10%", "D", "SSIM"], "{text}");
    assert_eq!(columns[6..10], ["flicker", "frozen", "startup", "miss"], "{text}");
    let html = std::fs::read_to_string(at.join(last)).unwrap();
    for name in ["layered", "dash", "dependency", "deadline-utility"] {
        assert!(html.contains(name), "{name}");
    }
    assert!(!html.contains("http://") && !html.contains("https://"), "the page must not load anything");
    let error = refused(at, &args);
    assert!(error.contains("report.html: is there already") && error.contains("--overwrite"), "{error}");
    // Utilities that an earlier run has measured are in nobody's way; a folder that nothing came into is.
    std::fs::create_dir(at.join("again")).unwrap();
    std::fs::copy(at.join("dgs-demo/utility.json"), at.join("again/utility.json")).unwrap();
    for (out, more) in [("again", ["--trace", "nofile"]), ("none/new", ["--trace", "nofile"])] {
        let error = refused(at, &[&args[..], &["--out", out], &more].concat());
        assert!(error.contains("nofile: "), "{error}");
    }
    assert!(refused(at, &["demo", "--scene", "nofile.ply", "--out", "new"]).contains("nofile.ply: no such"));
    assert_eq!(run::names(at), ["again", "dgs-demo"]);
    let json = std::fs::read_to_string(at.join("dgs-demo/report.json")).unwrap();
    let json: serde_json::Value = serde_json::from_str(&json).unwrap();
    let runs = json["runs"].as_array().unwrap();
    assert_eq!(runs.len(), 4);
    for run in runs {
        // The mean of MSE is at least that of the mean PSNR.
        let number = |key: &str| run[key].as_f64().unwrap();
        let least = 10f64.powf(-0.1 * number("mean_psnr_db")) + 0.20 * (1.0 - number("mean_ssim")) - 1e-9;
        assert!(number("d") >= least && number("d") < 1.0, "{run}");
    }
}

#[test]
fn a_damaged_stream_is_used_as_far_as_it_goes() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:cloth:1000:10", "--out", "a.dgs"]);
    let whole = std::fs::read(at.join("a.dgs")).unwrap();
    std::fs::write(at.join("cut.dgs"), &whole[..whole.len() * 2 / 3]).unwrap();
    let output = dgs(at, &["decode", "cut.dgs", "--out", "frames"]);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(2), "{stderr}");
    assert!(stderr.contains("cut.dgs") && stderr.contains("packets are missing"), "{stderr}");
    assert_eq!(std::fs::read_dir(at.join("frames")).unwrap().count(), 11, "and their index");
}

#[test]
fn bad_input_is_refused_by_name_and_place() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("empty.dgs"), b"").unwrap();
    std::fs::write(at.join("noise.dgs"), b"DGS\x01\xff\xff\xff\xff").unwrap();
    std::fs::write(at.join("a.ply"), b"ply\nformat binary_little_endian 1.0\nelement vertex 9\n").unwrap();
    std::fs::write(at.join("trace"), b"one two three\n").unwrap();
    for (args, wanted) in [
        (vec!["inspect", "empty.dgs"], vec!["empty.dgs", "file.magic", "0 bytes left, 4 needed"]),
        (vec!["inspect", "noise.dgs"], vec!["noise.dgs", "file.manifest_len", "found 4294967295"]),
        (vec!["import", "a.ply"], vec!["a.ply"]),
        (vec!["import", "nowhere.ply"], vec!["nowhere.ply", "no such file"]),
        (vec!["import", "synth:teapot"], vec!["teapot", "balls, figure, cloth, births"]),
        (vec!["import", "synth:balls:999"], vec!["999", "1000 to 1000000"]),
        (vec!["stream", "synth:balls:1000:3", "--trace", "trace"], vec!["trace", "line 1"]),
    ] {
        let text = refused(at, &args);
        for part in wanted {
            assert!(text.contains(part), "dgs {args:?} says {text:?}, not {part:?}");
        }
    }
}

/// Rate, delay and loss of one recording, and delays of another.
/// What is not a command ends with 64; what is asked for about commands with 0.
#[test]
fn wrong_usage_and_refused_input_exit_differently() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    for args in [&[][..], &["frobnicate"], &["encode"], &["encode", "a", "--out"], &["inspect", "a", "b"]] {
        let text = stopped(at, args, 64);
        assert!(text.contains("error: ") || text.contains("Usage: dgs"), "{args:?}: {text}");
    }
    for args in [&["--help"][..], &["help"], &["--version"], &["encode", "--help"], &["bench", "--help"]] {
        assert!(ok(at, args).contains("dgs"), "{args:?}");
    }
}

/// Every number out of range is refused before anything is read or written, by its option's name, with the
/// range in its own unit.
#[test]
fn options_out_of_range_are_refused_by_name_with_their_range() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    let encode = ["encode", "synth:balls:1000:2", "--out", "x.dgs"];
    let stream = ["stream", "synth:balls:1000:2"];
    let render = ["render", "synth:balls:1000:2", "--out", "x.png"];
    let demo = ["demo", "--out", "x"];
    let factor = "a factor on the default steps from 0.001 to 1000 is allowed";
    let above = "a finite number above 0 is allowed";
    let least = "a finite number of at least 0 is allowed";
    for (verb, option, values, range) in [
        (&encode[..], "--coarseness", &["nan", "inf", "-inf", "0", "-1", "1e30"][..], factor),
        (&encode, "--fps", &["nan", "inf", "0", "-30"], "frames per second from 0.001 to 10000 is allowed"),
        (&encode, "--truncate", &["nan", "inf", "-1"], least),
        (&encode, "--target-psnr", &["nan", "inf", "0", "-40", "100"], "dB from 0.001 to 99"),
        (&encode, "--target-bits-per-gaussian", &["nan", "inf", "0"], above),
        (&encode, "--packet-bytes", &["199", "1227", "nan"], "bytes from 200 to 1226 is allowed"),
        (&encode, "--block-len", &["0", "257"], "Gaussians from 1 to 256 is allowed"),
        (&encode, "--cluster-size", &["0", "32769"], "Gaussians from 1 to 32768 is allowed"),
        (&encode, "--window-frames", &["0", "65"], "frames from 1 to 64 is allowed"),
        (&encode, "--rank", &["65"], "vectors from 0 to 64 is allowed"),
        (&encode, "--pictures", &["1025"], "pictures from 0 to 1024 is allowed"),
        (&encode, "--samples", &["0"], "Gaussians from 1 to 5000000 is allowed"),
        (&encode, "--target-bytes", &["0", "nan"], "bytes from 1 to 18446744073709551615 is allowed"),
        (&encode, "--repair-set", &["1", "65"], "2 to 64 packets per set"),
        (&stream, "--burst-loss", &["nan", "0.31", "-0.1"], "a share from 0 to 0.3 is allowed"),
        (&stream, "--load", &["nan", "inf", "0"], above),
        (&stream, "--scale", &["nan", "inf", "0"], above),
        (&stream, "--trace-offset", &["nan", "inf", "-1"], least),
        (&stream, "--delay-ms", &["60001"], "milliseconds from 0 to 60000 is allowed"),
        (&render, "--width", &["0", "16385"], "pixels from 1 to 16384 is allowed"),
        (&render, "--background", &["nan", "2", "0,0"], "allowed"),
        (&render, "--level", &["4", "nan"], "levels from 0 to 3 is allowed"),
        (&render, "--frame", &["nan", "-1", "1e9"], "frames from 0 to 4294967295 is allowed"),
        (&demo, "--contexts", &["0", "65"], "contexts from 1 to 64 is allowed"),
    ] {
        for value in values {
            let typed = format!("{option}={value}");
            let args: Vec<&str> = verb.iter().copied().chain([typed.as_str()]).collect();
            let text = stopped(at, &args, 64);
            assert!(text.contains(option) && text.contains(range), "{typed}: {text}");
        }
    }
    assert_eq!(std::fs::read_dir(at).unwrap().count(), 0, "nothing is written");
}

/// A reader that has seen enough is no error.
#[test]
fn a_closed_pipe_ends_quietly() {
    let folder = tempfile::tempdir().unwrap();
    for args in
        [&["--help"][..], &["import", "synth:balls:1000:2"], &["--json", "import", "synth:balls:1000:2"]]
    {
        let (reader, writer) = std::io::pipe().unwrap();
        drop(reader);
        let output = Command::new(env!("CARGO_BIN_EXE_dgs"))
            .current_dir(folder.path())
            .args(args)
            .stdout(writer)
            .output()
            .unwrap();
        assert_eq!(output.status.code(), Some(0), "{args:?}");
        assert_eq!(String::from_utf8_lossy(&output.stderr), "", "{args:?}");
    }
}

/// A full disk behind standard output is an error, and one behind standard error no panic.
#[cfg(target_os = "linux")]
#[test]
fn a_full_output_device_is_an_error_and_no_panic() {
    let folder = tempfile::tempdir().unwrap();
    let full = || std::fs::File::options().write(true).open("/dev/full").unwrap();
    for args in
        [&["--help"][..], &["import", "synth:balls:1000:2"], &["--json", "import", "synth:balls:1000:2"]]
    {
        let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
        command.current_dir(folder.path()).args(args).stdout(full());
        let output = command.output().unwrap();
        let text = String::from_utf8_lossy(&output.stderr);
        assert_eq!(output.status.code(), Some(1), "{args:?}: {text}");
        assert!(text.starts_with("dgs: ") && text.lines().count() == 1, "{args:?}: {text}");
        let status = command.stdout(full()).stderr(full()).status().unwrap();
        assert_eq!(status.code(), Some(1), "{args:?}");
    }
    let mut command = Command::new(env!("CARGO_BIN_EXE_dgs"));
    assert_eq!(command.arg("frobnicate").stderr(full()).status().unwrap().code(), Some(64));
}

/// Away from the source tree `dgs bench` runs the laboratory beside it, with what was typed and its status.
#[cfg(unix)]
#[test]
fn bench_runs_the_laboratory_beside_it() {
    use std::os::unix::fs::PermissionsExt as _;

    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Written by another process: what is open for writing does not start, and what this process writes is
    // open for a moment in each child that another test starts meanwhile.
    let copy = |from: &Path, to: &Path| {
        let copied = Command::new("cp").args([from, to]).status().unwrap();
        assert!(copied.success());
    };
    let installed = at.join("dgs");
    copy(Path::new(env!("CARGO_BIN_EXE_dgs")), &installed);
    let bench = |args: &[&str]| Command::new(&installed).current_dir(at).args(args).output().unwrap();

    let output = bench(&["bench", "rate"]);
    let text = String::from_utf8_lossy(&output.stderr);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("dgs-lab") && text.contains("cargo run"), "{text}");

    let script = at.join("script");
    std::fs::write(&script, "#!/bin/sh\necho \"$@\"\nexit 7\n").unwrap();
    std::fs::set_permissions(&script, std::fs::Permissions::from_mode(0o755)).unwrap();
    copy(&script, &at.join("dgs-lab"));
    let output = bench(&["--json", "bench", "rate", "--quick", "--data", "d", "--out", "o"]);
    assert_eq!(output.status.code(), Some(7));
    assert_eq!(String::from_utf8_lossy(&output.stdout), "--quick --json --data d --out o -- rate\n");
    let output = bench(&["bench", "erasure", "--only", "sheet", "--perceptual-states", "8", "--lpips", "w"]);
    let typed = "--lpips w --perceptual-states 8 --only=sheet -- erasure\n";
    assert_eq!(String::from_utf8_lossy(&output.stdout), typed);
    assert_eq!(String::from_utf8_lossy(&bench(&["bench", "--list"]).stdout), "--list\n");
}

/// What a server at `place` answers, head and body.
#[cfg(unix)]
fn get(place: &str, path: &str) -> Vec<u8> {
    use std::io::{Read, Write};

    let mut stream = std::net::TcpStream::connect(place).unwrap();
    let request = format!("GET {path} HTTP/1.1\r\nHost: {place}\r\nConnection: close\r\n\r\n");
    stream.write_all(request.as_bytes()).unwrap();
    let mut answer = Vec::new();
    stream.read_to_end(&mut answer).unwrap();
    answer
}

/// A program that does not outlive a test that fails: it would hold the output of all tests open.
struct Running(std::process::Child);

impl Drop for Running {
    fn drop(&mut self) {
        let _ = self.0.kill();
        let _ = self.0.wait();
    }
}

/// A server and its viewer as typed: the URL is all that goes between them, and Ctrl-C ends the server with
/// its counts.
#[cfg(unix)]
#[test]
fn what_is_served_is_played() {
    use std::io::{BufRead, BufReader, Read};

    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    // Slow, so that a busy machine has two seconds until the last frame, which must be complete.
    let encode = ["encode", "synth:figure:1000:12", "--fps", "5", "--out", "a b.dgs", "--pictures", "2"];
    ok(at, &encode);
    let mut server = Running(
        Command::new(env!("CARGO_BIN_EXE_dgs"))
            .current_dir(at)
            .args(["serve", "a b.dgs", "--listen", "127.0.0.1:0", "--impair", "delay=5ms"])
            .stdout(std::process::Stdio::piped())
            .stderr(std::process::Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut said = BufReader::new(server.0.stdout.take().unwrap());
    let mut url = String::new();
    said.read_line(&mut url).unwrap();
    let url = url.trim();
    assert!(url.starts_with("dgs://127.0.0.1:") && url.contains("/a-b#"), "{url}");
    let mut page = String::new();
    said.read_line(&mut page).unwrap();
    let place = page.trim().strip_prefix("http://").and_then(|page| page.strip_suffix('/')).unwrap();
    assert!(url.contains(place), "{page}");
    assert!(get(place, "/streams/a-b.dgs").ends_with(&std::fs::read(at.join("a b.dgs")).unwrap()));
    let (_, pin) = url.split_once('#').unwrap();
    assert!(get(place, "/certificate.sha256").ends_with(pin.as_bytes()));
    assert!(get(place, "/").starts_with(b"HTTP/1.1 200"));
    let small = ["--width", "32", "--height", "32"];
    let text = ok(at, &[&["play", url, "-o", "frames", "--reference", "a b.dgs"][..], &small].concat());
    assert!(text.contains("12 frames shown of a clip of 12") && text.contains("PSNR"), "{text}");
    assert!(at.join("frames/00011.png").is_file());
    // Pictures are those that `dgs render` makes of the file, and say of which camera.
    let compare = ["compare", "frames", "a b.dgs", "--frames", "11", "--json"];
    let json: serde_json::Value = serde_json::from_str(&ok(at, &compare)).unwrap();
    assert!(json["summary"][0]["mean"].as_f64().unwrap() > 50.0, "{json}");
    let index = std::fs::read_to_string(at.join("frames/sequence.json")).unwrap();
    assert!(index.contains("the first of 8 cameras around the scene"), "{index}");
    // Nothing is played that could not be compared.
    ok(at, &["encode", "synth:figure:1000:3", "--out", "short.dgs", "--pictures", "0"]);
    let error = refused(at, &["play", url, "-o", "other", "--reference", "short.dgs"]);
    assert!(error.contains("--reference has 3 frames; the stream that is served has 12"), "{error}");
    let json: serde_json::Value = serde_json::from_str(&ok(at, &["play", url, "--json"])).unwrap();
    assert_eq!(json["report"]["shown_count"], 12);
    let web = url.replace("dgs://", "https://");
    let json: serde_json::Value = serde_json::from_str(&ok(at, &["play", &web, "--json"])).unwrap();
    assert_eq!(json["report"]["shown_count"], 12);
    let wish = ["--policy", "dash", "--impair", "delay=300ms,loss=1%"];
    let text = ok(at, &[&["play", url, "--json"][..], &wish].concat());
    let json: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert!(json["report"]["startup_ms"].as_f64().unwrap() >= 300.0, "{json}");
    let all = serde_json::json!({ "link": true, "scheduler": true });
    assert_eq!((&json["report"]["granted"], &json["warnings"]), (&all, &serde_json::json!([])));
    let error = refused(at, &["play", url, "--impair", "jitter=5ms"]);
    assert!(error.contains("--impair: \"jitter=5ms\" is not allowed"), "{error}");
    assert!(refused(at, &["play", url, "--impair", "delay=2000ms"]).contains("delay is 0ms to 1000ms"));
    let (bare, _) = url.split_once('#').unwrap();
    assert!(refused(at, &["play", bare]).contains("by what is the server known"));
    let wrong = format!("{bare}#{}", "0".repeat(64));
    assert!(refused(at, &["play", &wrong]).contains("the server's certificate is "));
    let unknown = url.replace("a-b", "other");
    assert!(refused(at, &["play", &unknown]).contains("no stream called other; there are a-b"));
    let id = i32::try_from(server.0.id()).unwrap().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    assert!(server.0.wait().unwrap().success());
    assert!(rest.contains("5 viewers; 1 handshakes failed") && rest.contains("unknown stream 1"), "{rest}");
    assert!(rest.contains("page: 3 requests on 3 connections"), "{rest}");
    // What each address is for stands beside it where people read, and addresses alone where programs do.
    let mut beside = String::new();
    server.0.stderr.take().unwrap().read_to_string(&mut beside).unwrap();
    let lines: Vec<&str> = beside.lines().rev().take(2).collect();
    let page = "dgs: for a browser, the page that plays it:";
    assert_eq!(lines, [page, "dgs: for dgs play, and for dgs view --window:"], "{beside}");
    let error = refused(at, &["serve", "a b.dgs", "a b.dgs", "--listen", "127.0.0.1:0"]);
    assert!(error.contains("two streams are called a-b"), "{error}");
    let error = refused(at, &["serve", "a b.dgs", "--impair", "loss=2"]);
    assert!(error.contains("--impair: \"loss=2\" is not allowed"), "{error}");
}

/// The page and the files that `dgs view` shows, as a browser asks for them.
#[cfg(unix)]
#[test]
fn what_is_viewed_is_a_page_and_its_files() {
    use std::io::{BufRead, BufReader, Read};

    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:figure:1000:12", "--out", "a b.dgs", "--pictures", "2"]);
    std::fs::write(at.join("no.dgs"), b"no stream").unwrap();
    assert!(refused(at, &["view", "no.dgs", "--port", "0"]).contains("no.dgs: no .dgs file"));
    assert!(refused(at, &["view", "none.dgs", "--port", "0"]).contains("none.dgs: cannot read"));
    let mut server = Running(
        Command::new(env!("CARGO_BIN_EXE_dgs"))
            .current_dir(at)
            .args(["view", "a b.dgs", "--port", "0"])
            .stdout(std::process::Stdio::piped())
            .spawn()
            .unwrap(),
    );
    let mut said = BufReader::new(server.0.stdout.take().unwrap());
    let mut url = String::new();
    said.read_line(&mut url).unwrap();
    let port = url.trim().strip_prefix("http://localhost:").and_then(|rest| rest.strip_suffix('/')).unwrap();
    let place = format!("127.0.0.1:{port}");
    let page = get(&place, "/");
    assert!(page.windows(11).any(|part| part == b"<dgs-player"), "{}", String::from_utf8_lossy(&page));
    assert!(get(&place, "/dgs_viewer_bg.wasm").windows(4).any(|part| part == b"\0asm"));
    assert!(get(&place, "/streams/a-b.dgs").ends_with(&std::fs::read(at.join("a b.dgs")).unwrap()));
    let id = i32::try_from(server.0.id()).unwrap().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let mut rest = String::new();
    said.read_to_string(&mut rest).unwrap();
    assert!(server.0.wait().unwrap().success());
    assert_eq!(rest, "3 connections, 3 requests\n");
}
