//! A digest of all code that the WebAssembly is made from: what packs it and what tests it share this.

use std::{
    fs,
    path::{Path, PathBuf},
};

use codec_core::internals::digest::Digest;

/// Where the digest is noted beside what was made.
pub const FILE: &str = "sources.txt";

/// What it is made from: folders of Rust and WGSL, under the root of the repository.
const FOLDERS: [&str; 5] = [
    "codec-core/src",
    "codec-core/simd/src",
    "codec-core/player/src",
    "render-host/src",
    "render-host/viewer/src",
];
/// Folders of them that the player does not reach, files that no browser compiles, and tests.
const WITHOUT: [&str; 11] = [
    "render-host/src/adjoint",
    "render-host/src/counterfactual",
    "render-host/src/metric",
    "render-host/src/sequence",
    "render-host/src/gpu/adjoint",
    "render-host/src/camera/blender",
    "render-host/src/camera/colmap",
    "codec-core/simd/src/kernel/",
    "render-host/viewer/src/bin",
    "render-host/viewer/src/asset.rs",
    "/tests",
];

/// The root of the repository that holds the crate in `folder`.
pub fn root(folder: &Path) -> PathBuf {
    folder.ancestors().nth(2).unwrap_or(folder).to_owned()
}

/// The digest of every line of code, whatever its comments and its tests say.
pub fn digest(root: &Path) -> Result<String, String> {
    let mut files = Vec::new();
    for folder in FOLDERS {
        collect(root, &root.join(folder), &mut files)?;
    }
    files.sort();
    let mut digest = Digest::new();
    for (name, path) in &files {
        let text = fs::read_to_string(path).map_err(|error| format!("{name}: {error}"))?;
        digest = digest.bytes(name.as_bytes());
        for line in code(&text) {
            digest = digest.bytes(line.as_bytes()).bytes(b"\n");
        }
    }
    Ok(format!("{:016x} of {} files", digest.get(), files.len()))
}

/// Lines that are neither blank nor comment, up to the tests.
pub fn code(text: &str) -> impl Iterator<Item = &str> {
    let product = text.split("#[cfg(test)]\nmod tests").next().unwrap_or("");
    product.lines().map(str::trim).filter(|line| !line.is_empty() && !line.starts_with("//"))
}

fn collect(root: &Path, folder: &Path, files: &mut Vec<(String, PathBuf)>) -> Result<(), String> {
    let failed = |error| format!("{}: {error}", folder.display());
    for entry in fs::read_dir(folder).map_err(failed)? {
        let path = entry.map_err(failed)?.path();
        let name = path.strip_prefix(root).unwrap_or(&path).to_string_lossy().replace('\\', "/");
        if WITHOUT.iter().any(|without| name.contains(without)) {
            continue;
        }
        if path.is_dir() {
            collect(root, &path, files)?;
        } else if name.ends_with(".rs") || name.ends_with(".wgsl") {
            files.push((name, path));
        }
    }
    Ok(())
}
