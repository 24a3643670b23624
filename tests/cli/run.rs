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
