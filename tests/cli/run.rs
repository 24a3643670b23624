//! Runs `dgs` as a person does and checks how it ends.

use std::{
    fs,
    path::Path,
    process::{Command, Output},
};

/// `dgs` with `args` in `folder`.
pub fn dgs(folder: &Path, args: &[&str]) -> Output {
    Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(folder).args(args).output().unwrap()
}

/// Standard output of `args`, which end well.
pub fn ok(folder: &Path, args: &[&str]) -> String {
    let output = dgs(folder, args);
    let stderr = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "dgs {args:?}: {stderr}");
    String::from_utf8(output.stdout).unwrap()
}

/// What `args` say on standard error when they are refused.
pub fn refused(folder: &Path, args: &[&str]) -> String {
    stopped(folder, args, 1)
}

/// What `args` say on standard error when they end with exit status `code`.
pub fn stopped(folder: &Path, args: &[&str], code: i32) -> String {
    let output = dgs(folder, args);
    let text = String::from_utf8(output.stderr).unwrap();
    assert_eq!(output.status.code(), Some(code), "dgs {args:?}: {text}");
    text
}

/// Names of what is in `folder`, in order.
pub fn names(folder: &Path) -> Vec<String> {
    let entries = fs::read_dir(folder).unwrap();
    let mut names: Vec<String> = entries.map(|e| e.unwrap().file_name().into_string().unwrap()).collect();
    names.sort();
    names
}

/// What `begun` finds of `dgs` with `args` in `folder`, which is killed then, before it has made the folder
/// `out`. On a busy machine this process may wait until `out` is there; then all of it is done again.
pub fn killed(folder: &Path, args: &[&str], out: &str, begun: impl Fn() -> Option<String>) -> String {
    for _ in 0..5 {
        let mut child =
            Command::new(env!("CARGO_BIN_EXE_dgs")).current_dir(folder).args(args).spawn().unwrap();
        let found = loop {
            let found = begun();
            if found.is_some() || child.try_wait().unwrap().is_some() {
                break found;
            }
        };
        child.kill().unwrap();
        child.wait().unwrap();
        if !folder.join(out).exists() {
            return found.unwrap();
        }
        fs::remove_dir_all(folder.join(out)).unwrap();
    }
    panic!("dgs {args:?} was never seen at work");
}
