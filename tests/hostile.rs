//! Small files that claim much, given to the command line under limits of memory and of processor time.
//!
//! `codec-core/tests/hostile/README.md` lists the files and what their refusal says.

#![cfg(unix)]
#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

/// Address space of a run, KiB: 2 GiB.
const MEMORY_KIB: u64 = 2 << 20;
/// Processor time of a run, seconds.
const TIME_S: u64 = 30;

fn folder() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("codec-core/tests/hostile")
}

/// Runs `dgs` with `arguments` in at most `memory_kib` of address space.
fn dgs(memory_kib: u64, arguments: &[&Path]) -> Output {
    let limited = format!(r#"ulimit -v {memory_kib} && ulimit -t {TIME_S} && exec "$0" "$@""#);
    let mut shell = Command::new("sh");
    shell.args(["-c", &limited, env!("CARGO_BIN_EXE_dgs")]).args(arguments).output().unwrap()
}

/// File, and parts of its refusal, of each line of the table.
fn attacks() -> Vec<(PathBuf, Vec<String>)> {
    let text = std::fs::read_to_string(folder().join("README.md")).unwrap();
    let attack = |line: &str| {
        let cells: Vec<&str> = line.trim_matches('|').split('|').map(str::trim).collect();
        let [file, _, says] = cells[..] else { panic!("three cells: {line}") };
        let says = says.split('`').skip(1).step_by(2).map(str::to_owned).collect();
        (folder().join(file.trim_matches('`')), says)
    };
    text.lines().filter(|line| line.starts_with("| `")).map(attack).collect()
}

#[test]
fn every_verb_ends_within_limits() {
    let out = tempfile::tempdir().unwrap();
    let path = |text: &'static str| Path::new(text);
    for (file, says) in attacks() {
        let name = file.file_name().unwrap().to_str().unwrap();
        let [ply, png] = ["ply", "png"].map(|kind| out.path().join(name).with_extension(kind));
        for arguments in [
            &[path("inspect"), &file][..],
            &[path("decode"), &file, path("--frame"), path("0"), path("--out"), &ply],
            &[
                path("render"),
                &file,
                path("--width"),
                path("32"),
                path("--height"),
                path("32"),
                path("--out"),
                &png,
            ],
        ] {
            let output = dgs(MEMORY_KIB, arguments);
            let text = String::from_utf8_lossy(&output.stderr);
            // None is a signal: out of memory or of time.
            let code = output.status.code();
            assert!(matches!(code, Some(0..=2)), "{arguments:?}: {:?} {text}", output.status);
            let is_packet = says.iter().any(|part| part.starts_with("packet."));
            if !says.is_empty() && !is_packet {
                assert_eq!(code, Some(1), "{arguments:?}: {text}");
                for part in &says {
                    assert!(text.contains(part.as_str()), "{arguments:?}: {text:?} does not say {part:?}");
                }
            }
            if is_packet && arguments[0] == path("decode") {
                assert!(text.contains("1 packets were refused as capacity"), "{name}: {text}");
            }
        }
    }
}

/// A limit that cannot be exceeded proves nothing.
#[test]
fn the_limit_of_memory_holds() {
    let good = folder().join("ok.dgs");
    let arguments = [Path::new("inspect"), &good];
    assert_eq!(
        dgs(MEMORY_KIB, &arguments).status.code(),
        Some(0),
        "packets that it never held are no damage"
    );
    assert!(!dgs(4 << 10, &arguments).status.success(), "4 MiB do not hold the program itself");
}

/// One frame decoded alone is that frame of all.
#[test]
fn a_frame_alone_is_that_frame_of_all() {
    let out = tempfile::tempdir().unwrap();
    let stream = Path::new(env!("CARGO_MANIFEST_DIR")).join("codec-core/tests/conformance/coefficients.dgs");
    let (all, one) = (out.path().join("all"), out.path().join("one.ply"));
    let path = |text: &'static str| Path::new(text);
    let run = |arguments: &[&Path]| {
        let output = dgs(MEMORY_KIB, arguments);
        assert!(output.status.success(), "{arguments:?}: {}", String::from_utf8_lossy(&output.stderr));
    };
    run(&[path("decode"), &stream, path("--out"), &all]);
    run(&[path("decode"), &stream, path("--frame"), path("2"), path("--out"), &one]);
    let mut frames: Vec<PathBuf> =
        std::fs::read_dir(&all).unwrap().map(|entry| entry.unwrap().path()).collect();
    frames.retain(|frame| frame.extension().is_some_and(|kind| kind == "ply"));
    frames.sort();
    assert_eq!(std::fs::read(&one).unwrap(), std::fs::read(&frames[2]).unwrap());
    assert_ne!(std::fs::read(&frames[1]).unwrap(), std::fs::read(&frames[2]).unwrap());
}
