//! Lays the fixture and the memory map where compiler and linker find them.
//!
//! The fixture is written by `dgs bench embedded` (see `tests/lab/src/fixture.rs`), to
//! `target/embedded/fixture` unless `DGS_FIXTURE` names another folder.

use std::{env, fs, path::PathBuf};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    println!("cargo::rerun-if-env-changed=DGS_FIXTURE");
    println!("cargo::rerun-if-changed=memory.x");
    let beside = PathBuf::from("../../target/embedded/fixture");
    let fixture = env::var_os("DGS_FIXTURE").map_or(beside, PathBuf::from);
    let folder = fixture.canonicalize().unwrap_or(fixture);
    println!("cargo::rustc-env=DGS_FIXTURE={}", folder.display());
    println!("cargo::rerun-if-changed={}", folder.display());
    if !folder.join("fixture.rs").is_file() {
        println!("cargo::error={}: no fixture here; `dgs bench embedded` writes it", folder.display());
    }
    if let Err(error) = fs::copy("memory.x", out.join("memory.x")) {
        println!("cargo::error=memory.x: {error}");
    }
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
}
