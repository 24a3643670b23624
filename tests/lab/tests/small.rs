//! What a program in C makes of a stream is what Rust makes of it.

#![allow(clippy::unwrap_used, clippy::panic, reason = "helpers of tests fail like tests")]

use std::{
    path::{Path, PathBuf},
    process::{Command, Output},
};

use dgs_lab::fixture::Fixture;

/// The static library, built beside this test because the test depends on its crate.
fn library() -> PathBuf {
    let beside = std::env::current_exe().unwrap();
    let library = beside.parent().unwrap().join("libcodec_capi.a");
    assert!(library.is_file(), "{} is built with the tests", library.display());
    library
}

/// The folder of the C ABI.
fn capi() -> PathBuf {
    Path::new(env!("CARGO_MANIFEST_DIR")).join("../../codec-core/capi")
}

/// The C file `source`, which is of the language's version `standard`, as a program in `folder`; `None` where
/// there is no C compiler and nobody demands one.
fn program(folder: &Path, standard: &str, source: &str) -> Option<PathBuf> {
    let capi = capi();
    let program = folder.join("program");
    let output = Command::new("cc")
        .args([standard, "-O1", "-Wall", "-Wextra", "-pedantic", "-Werror", "-I"])
        .arg(capi.join("include"))
        .arg(capi.join(source))
        .arg(library())
        .args(["-lpthread", "-lm", "-ldl", "-o"])
        .arg(&program)
        .output();
    match output {
        Ok(output) => {
            assert!(output.status.success(), "{}", String::from_utf8_lossy(&output.stderr));
            Some(program)
        }
        Err(error) => {
            assert!(std::env::var("CI").is_err(), "cc: {error}");
            println!("skipped: cc: {error}");
            None
        }
    }
}

fn decode(program: &Path, folder: &Path, frames: &[u32]) -> Output {
    let frames = frames.iter().map(u32::to_string);
    let files = ["manifest.dgsm", "packets.bin"].map(|name| folder.join(name));
    Command::new(program).args(files).args(frames).output().unwrap()
}

#[cfg(unix)]
#[test]
fn a_c_program_decodes_a_damaged_stream_to_the_same_bits() {
    let folder = tempfile::tempdir().unwrap();
    let fixture = Fixture::make().unwrap();
    fixture.write(folder.path()).unwrap();
    let Some(program) = program(folder.path(), "-std=c99", "tests/decode.c") else { return };
    let output = decode(&program, folder.path(), &fixture.frames);
    let text = String::from_utf8_lossy(&output.stdout);
    assert!(output.status.success(), "{text}");
    let counters = fixture.answer.counters;
    for line in [
        format!("digest {:016x}\n", fixture.answer.digest),
        format!("count.media {}\n", counters.media),
        format!("count.recovered {}\n", counters.recovered),
        format!("refused {}\n", counters.refused.iter().sum::<u32>()),
    ] {
        assert!(text.contains(&line), "{line} is not in\n{text}");
    }

    // Other frames, another digest: the comparison above can fail.
    let other = decode(&program, folder.path(), &fixture.frames[1..]);
    assert!(
        !String::from_utf8_lossy(&other.stdout).contains(&format!("digest {:016x}", fixture.answer.digest))
    );

    // Damage is named by call, field, found and allowed.
    let mut message = fixture.message().to_vec();
    let last = message.len() - 1;
    message[last] ^= 1;
    std::fs::write(folder.path().join("manifest.dgsm"), &message).unwrap();
    let output = decode(&program, folder.path(), &fixture.frames);
    let text = String::from_utf8_lossy(&output.stdout);
    assert_eq!(output.status.code(), Some(1), "{text}");
    assert!(text.contains("dgs_required") && text.contains("status"), "{text}");
}

#[cfg(unix)]
#[test]
fn the_example_in_c_shows_what_rust_shows_and_stands_in_its_readme() {
    let folder = tempfile::tempdir().unwrap();
    let Some(program) = program(folder.path(), "-std=c11", "examples/play.c") else { return };
    let source = std::fs::read_to_string(capi().join("examples/play.c")).unwrap();
    assert!(std::fs::read_to_string(capi().join("README.md")).unwrap().contains(&source));
    for name in ["one", "everything", "paper"] {
        let file = capi().join(format!("../tests/conformance/{name}.dgs"));
        let (mut player, _) = dgs_player::Player::open_file(&file).unwrap();
        let wanted = format!("{} Gaussians\n", player.frame(0).unwrap().gaussians.len());
        let output = Command::new(&program).arg(&file).output().unwrap();
        assert_eq!(String::from_utf8_lossy(&output.stdout), wanted, "{name}");
    }
    assert_eq!(Command::new(&program).output().unwrap().status.code(), Some(1), "without a file");
}
