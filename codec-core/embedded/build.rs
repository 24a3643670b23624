//! Lays the kit and the memory map where compiler and linker find them.
//!
//! The kit is written by `dgs bench embedded` (see `src/kit.rs` of the root package), to
//! `target/embedded/kit` unless `DGS_KIT` names another folder.

use std::{env, fs, path::PathBuf};

fn main() {
    let out = PathBuf::from(env::var_os("OUT_DIR").unwrap_or_default());
    println!("cargo::rerun-if-env-changed=DGS_KIT");
    println!("cargo::rerun-if-changed=memory.x");
    let beside = PathBuf::from("../../target/embedded/kit");
    let kit = env::var_os("DGS_KIT").map_or(beside, PathBuf::from);
    let folder = kit.canonicalize().unwrap_or(kit);
    println!("cargo::rustc-env=DGS_KIT={}", folder.display());
    println!("cargo::rerun-if-changed={}", folder.display());
    if !folder.join("kit.rs").is_file() {
        println!("cargo::error={}: no kit here; `dgs bench embedded` writes it", folder.display());
    }
    if let Err(error) = fs::copy("memory.x", out.join("memory.x")) {
        println!("cargo::error=memory.x: {error}");
    }
    println!("cargo::rustc-link-search={}", out.display());
    println!("cargo::rustc-link-arg-bins=-Tlink.x");
    println!("cargo::rustc-link-arg-bins=--nmagic");
}
