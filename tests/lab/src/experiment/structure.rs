//! Counts the structure of the source: lines, public items, cycles, crates, lengths of examples.

use std::{
    collections::BTreeSet,
    path::Path,
    process::{Command, Stdio},
};

use anyhow::{Context, Result, ensure};

use crate::{
    figures::{Bench, Figure},
    setup::Setup,
    source::{CodeKind, Tree, cycles, lines, outside_tests, public_items, walks},
};

/// Runs the bench.
pub fn run(_: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "structure",
        "lines of Rust that are neither blank nor comment, inline tests counted as tests; public items: \
         what a user of a crate can name, methods and module `internals` left out; cycles: files of a \
         crate that need each other, by `use`, by path and in macros, names followed to the file that \
         declares the thing; walks: files that tests/lab/WALKS.md enters; crates: what `cargo build \
         --package dgs` compiles, build scripts' included",
    );
    let root = Path::new(env!("CARGO_MANIFEST_DIR")).join("../..");
    if !root.join("Cargo.toml").is_file() {
        bench.skipped.push("the source tree is absent".into());
        return Ok(bench);
    }
    let tree = Tree::of(&root);
    let counted = lines(&tree);
    for (floor, name) in
        [(CodeKind::Product, "product"), (CodeKind::Laboratory, "laboratory"), (CodeKind::Tests, "tests")]
    {
        let count = counted.get(&floor).copied().unwrap_or(0);
        bench.push(Figure::new(format!("lines.{name}"), count as f64, "lines"));
    }
    for (name, folder) in tree.libraries() {
        let cycles = cycles(&tree, &folder);
        let files: usize = cycles.iter().map(Vec::len).sum();
        bench.push(Figure::new(format!("public_items.{name}"), public_items(&tree, &folder) as f64, "items"));
        bench.push(Figure::new(format!("circles.{name}"), cycles.len() as f64, "circles"));
        bench.push(Figure::new(format!("circles.{name}.files"), files as f64, "files"));
    }
    for walk in walks(&tree) {
        let (key, entries) = (format!("walk.{}", walk.name), walk.entries());
        bench.push(Figure::new(format!("{key}.files"), entries.len() as f64, "files"));
        bench.push(Figure::new(format!("{key}.entries"), walk.files.len() as f64, "entries"));
        let most = entries.values().copied().max().unwrap_or(0);
        bench.push(Figure::new(format!("{key}.most_entries_of_a_file"), most as f64, "entries"));
    }
    for (path, text) in tree.rust().filter(|(path, _)| path.contains("examples/")) {
        let code = outside_tests(text).lines().map(str::trim);
        let count = code.filter(|line| !line.is_empty() && !line.starts_with("//")).count();
        bench.push(Figure::new(format!("example.{}", path.trim_end_matches(".rs")), count as f64, "lines"));
    }
    match crates(&root) {
        Ok(count) => bench.push(Figure::new("crates.default_build", count as f64, "crates")),
        Err(error) => bench.skipped.push(format!("crates of the default build: {error:#}")),
    }
    Ok(bench)
}

/// Crates that `cargo build --package dgs` compiles.
fn crates(root: &Path) -> Result<usize> {
    let output = Command::new("cargo")
        .args([
            "tree",
            "--locked",
            "--offline",
            "--package",
            "dgs",
            "--edges",
            "normal,build",
            "--prefix",
            "none",
        ])
        .args(["--format", "{p}"])
        .current_dir(root)
        .stdin(Stdio::null())
        .output()
        .context("cargo does not start")?;
    let said = String::from_utf8_lossy(&output.stderr);
    ensure!(output.status.success(), "cargo tree: {}", said.lines().next().unwrap_or("failed"));
    let text = String::from_utf8_lossy(&output.stdout);
    Ok(text.lines().map(|line| line.trim_end_matches(" (*)")).collect::<BTreeSet<_>>().len())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_floor_and_crate_is_counted() {
        let setup = Setup::new(None, true, dgs::pipeline::Quiet(true));
        let bench = run(&setup).unwrap();
        for key in [
            "lines.product",
            "lines.laboratory",
            "lines.tests",
            "public_items.codec-core",
            "walk.packet_to_pixel.entries",
            "walk.scene_to_packets.entries",
        ] {
            let figure = bench.figures.iter().find(|figure| figure.key == key);
            assert!(figure.is_some_and(|figure| figure.value > 20.0), "{key}: {figure:?}");
        }
    }
}
