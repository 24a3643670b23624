//! Measures wall time and peak memory of the demo with its defaults.

use std::time::Instant;

use anyhow::Result;
use clap::Parser;
use dgs::{
    args::{Cli, Verb},
    command,
    report::html,
};

use crate::{
    figures::{Bench, Figure, Machine},
    setup::Setup,
};

/// Runs the bench.
pub fn run(setup: &Setup) -> Result<Bench> {
    let mut bench = Bench::new(
        "demo",
        "dgs demo with its defaults: synth figure, 8,000 Gaussians, 60 frames, 512x512, four schedulers; no \
            cached utilities",
    );
    let folder = std::env::temp_dir().join(format!("dgs-bench-demo-{}", std::process::id()));
    let out = folder.to_string_lossy().into_owned();
    let typed = ["dgs", "demo", "--out", &out];
    let Verb::Demo(args) = Cli::try_parse_from(typed)?.verb else { anyhow::bail!("demo is not a verb") };
    let start = Instant::now();
    let page = command::demo_page(&args, setup.quiet)?;
    let html = html::page(&page);
    let seconds = start.elapsed().as_secs_f64();
    std::fs::remove_dir_all(&folder)?;
    bench.push(Figure::new("wall_s", seconds, "s"));
    bench.push(Figure::new("report_bytes", html.len() as f64, "bytes"));
    push_peak_memory(&mut bench);
    Ok(bench)
}

/// Adds the largest resident set of this process so far.
pub(super) fn push_peak_memory(bench: &mut Bench) {
    match Machine::peak_memory_bytes("self") {
        Some(bytes) => bench.push(Figure::new("peak_memory_mib", bytes as f64 / 1_048_576.0, "MiB")),
        None => bench.skipped.push("peak memory: this system does not tell (/proc/self/status)".into()),
    }
}
