//! What is served and shown of inputs that are damaged or missing, and how that ends.

use std::{
    io::{BufRead, BufReader, Read, Write},
    path::Path,
    process::{Command, Stdio},
};

use super::{
    Running,
    run::{ok, refused},
};

/// How `dgs serve` of `inputs` with `bytes` on standard input ends when it is interrupted once it has said
/// `lines`: its exit status and its JSON.
fn served(folder: &Path, inputs: &[&str], bytes: &[u8], lines: &[&str]) -> (Option<i32>, serde_json::Value) {
    let mut server = Running(
        Command::new(env!("CARGO_BIN_EXE_dgs"))
            .current_dir(folder)
            .args(["--json", "serve", "--listen", "127.0.0.1:0", "--no-http"])
            .args(inputs)
            .stdin(Stdio::piped())
            .stdout(Stdio::piped())
            .stderr(Stdio::piped())
            .spawn()
            .unwrap(),
    );
    server.0.stdin.take().unwrap().write_all(bytes).unwrap();
    let mut said = BufReader::new(server.0.stderr.take().unwrap()).lines();
    let mut missing = lines.to_vec();
    while !missing.is_empty() {
        let Some(line) = said.next() else { panic!("{missing:?} was not said") };
        let line = line.unwrap();
        missing.retain(|words| !line.contains(words));
    }
    let id = server.0.id().to_string();
    assert!(Command::new("kill").args(["-INT", &id]).status().unwrap().success());
    let mut json = String::new();
    server.0.stdout.take().unwrap().read_to_string(&mut json).unwrap();
    (server.0.wait().unwrap().code(), serde_json::from_str(&json).unwrap())
}

/// As every verb that goes on with damaged input ends.
#[test]
fn a_server_of_damaged_input_ends_with_exit_status_2() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    ok(at, &["encode", "synth:cloth:1000:10", "--out", "a.dgs", "--pictures", "0"]);
    let whole = std::fs::read(at.join("a.dgs")).unwrap();
    std::fs::write(at.join("cut.dgs"), &whole[..whole.len() * 2 / 3]).unwrap();
    let (code, said) = served(at, &["a.dgs", "cut.dgs"], b"", &["serving dgs://"]);
    assert_eq!(code, Some(2), "{said}");
    assert!(said["warnings"].to_string().contains("cut.dgs: "), "{said}");

    let mut damaged = whole.clone();
    damaged[whole.len() * 3 / 4] ^= 1;
    let ended = ["serving dgs://", "standard input has ended"];
    let (code, said) = served(at, &["-"], &damaged, &ended);
    assert_eq!(code, Some(2), "{said}");
    let warnings = said["warnings"].to_string();
    assert!(warnings.contains("standard input: ") && warnings.contains("damaged"), "{said}");

    let (code, said) = served(at, &["a.dgs"], b"", &["serving dgs://"]);
    assert!(code == Some(0) && !said["warnings"].to_string().contains("damaged"), "{said}");
}

/// Nor is the first of these inputs a scene, which is found as it is read.
#[test]
fn an_input_that_is_not_there_is_refused_before_another_is_encoded() {
    let folder = tempfile::tempdir().unwrap();
    let at = folder.path();
    std::fs::write(at.join("first.ply"), b"no scene").unwrap();
    for (missing, says) in [
        ("none.ply", "none.ply: no such file or folder"),
        ("none.dgs", "none.dgs: cannot read"),
        ("synth:none", "synth:none: no such scene"),
        ("https://host/none.dgs", "a page shows files and scenes"),
    ] {
        let text = refused(at, &["view", "first.ply", missing, "--port", "0"]);
        assert!(text.contains(says), "{text}");
    }
}
