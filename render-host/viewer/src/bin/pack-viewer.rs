//! Makes `dist/` from the sources: the player as WebAssembly and the script that loads it.
//!
//!     cargo run -p dgs-viewer --features pack --bin pack-viewer [FOLDER]
//!
//! It needs the target `wasm32-unknown-unknown` and no other tool. What it writes is committed, so that a
//! build of `dgs` needs neither.

use std::{
    env, fs,
    path::{Path, PathBuf},
    process::{Command, ExitCode},
};

use wasm_bindgen_cli_support::Bindgen;

#[path = "../../tests/support/mod.rs"]
mod sources;

const TARGET: &str = "wasm32-unknown-unknown";

fn main() -> ExitCode {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR"));
    let dist = env::args_os().nth(1).map_or_else(|| folder.join("dist"), PathBuf::from);
    match pack(folder, &dist) {
        Ok(bytes) => {
            println!("{}: {bytes} bytes of WebAssembly", dist.display());
            ExitCode::SUCCESS
        }
        Err(error) => {
            eprintln!("pack-viewer: {error}");
            ExitCode::FAILURE
        }
    }
}

/// Compiles, writes the script, notes what it was made from.
fn pack(folder: &Path, dist: &Path) -> Result<u64, String> {
    let root = sources::root(folder);
    let target = root.join("target").join("viewer");
    let digest = sources::digest(&root)?;
    compile(&root, &target)?;
    let wasm = target.join(TARGET).join("web").join("dgs_viewer.wasm");
    let failed = |error| format!("{}: {error:#}", wasm.display());
    let mut bindgen = Bindgen::new();
    bindgen.input_path(&wasm).out_name("dgs_viewer").typescript(true);
    bindgen.remove_name_section(true).remove_producers_section(true).omit_default_module_path(false);
    bindgen.web(true).map_err(failed)?.generate(dist).map_err(failed)?;
    fs::write(dist.join(sources::FILE), format!("{digest}\n")).map_err(|e| e.to_string())?;
    Ok(fs::metadata(dist.join("dgs_viewer_bg.wasm")).map_err(|e| e.to_string())?.len())
}

/// Compiles the crate for browsers, with no path of this machine in what comes out.
fn compile(root: &Path, target: &Path) -> Result<(), String> {
    let home = env::var_os("CARGO_HOME").map(PathBuf::from);
    let home = home.or_else(|| env::var_os("HOME").map(|home| PathBuf::from(home).join(".cargo")));
    let mut flags =
        vec!["-Ctarget-feature=+simd128".to_owned(), format!("--remap-path-prefix={}=.", root.display())];
    if let Some(home) = home {
        flags.push(format!("--remap-path-prefix={}=cargo", home.display()));
    }
    let status = Command::new(env::var_os("CARGO").unwrap_or_else(|| "cargo".into()))
        .current_dir(root)
        .env("CARGO_ENCODED_RUSTFLAGS", flags.join("\u{1f}"))
        .args(["rustc", "--package", "dgs-viewer", "--lib", "--crate-type", "cdylib"])
        .args(["--profile", "web", "--target", TARGET, "--locked"])
        .arg("--target-dir")
        .arg(target)
        .status()
        .map_err(|error| format!("cargo: {error}"))?;
    if status.success() { Ok(()) } else { Err(format!("cargo ended with {status}")) }
}
