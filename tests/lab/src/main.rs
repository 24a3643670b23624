//! Runs benches by name and prints their figures as a table or as JSON.

use std::{path::PathBuf, process::ExitCode};

use anyhow::{Result, bail};
use clap::Parser;
use dgs::{
    output::{self, VerbOutput},
    pipeline::Quiet,
};
use dgs_lab::{
    experiment::{self, Experiment},
    setup::Setup,
};
use serde_json::json;

/// Measure: the figures this project quotes, each beside its error.
#[derive(Debug, Parser)]
#[command(name = "dgs bench", version, max_term_width = 100)]
struct Typed {
    /// Which figures, or `all`; see --list.
    #[arg(required_unless_present = "list")]
    name: Option<String>,
    /// Name the benches and what each measures.
    #[arg(long)]
    list: bool,
    /// Smaller sizes: under a minute where it can be.
    #[arg(long)]
    quick: bool,
    /// Folder with the real scenes and traces [default: ../shared/data, where it exists].
    #[arg(long)]
    data: Option<PathBuf>,
    /// Folder for tables (CSV) and drawings (SVG) of the benches that make them; none are written without.
    #[arg(long)]
    out: Option<PathBuf>,
    /// Weights of LPIPS (AlexNet, safetensors), to measure it too: in `transport`, `workloads` and `erasure`;
    /// the last also finds them in the data folder (lpips/alexnet.safetensors).
    #[arg(long, value_name = "FILE")]
    lpips: Option<PathBuf>,
    /// How many states per loss `erasure` measures with FLIP and LPIPS, which take longest: 1 to 128.
    #[arg(
        long, value_name = "STATES", default_value_t = Setup::PERCEPTUAL_STATES,
        value_parser = clap::value_parser!(u16).range(1..=128)
    )]
    perceptual_states: u16,
    /// Of `workloads` and `erasure`, which take hours, only streams, or scenes and their parity, whose names
    /// hold this, for example cloth, sheet or bouncingballs.full.
    #[arg(long, value_name = "NAME")]
    only: Option<String>,
    /// Print figures as JSON on standard output, and nothing else there.
    #[arg(long)]
    json: bool,
}

/// Benches of several streams or scenes, of which one can be chosen.
const PARTED: [&str; 2] = ["workloads", "erasure"];

fn main() -> ExitCode {
    match output::parse::<Typed>() {
        Ok(typed) => output::finish(run(&typed), typed.json),
        Err(code) => code,
    }
}

fn run(typed: &Typed) -> Result<VerbOutput> {
    if typed.list {
        return Ok(list());
    }
    let mut setup = Setup::new(typed.data.clone(), typed.quick, Quiet(typed.json));
    setup.out.clone_from(&typed.out);
    setup.lpips.clone_from(&typed.lpips);
    setup.perceptual_states = usize::from(typed.perceptual_states);
    setup.only.clone_from(&typed.only);
    if let Some(name) =
        typed.name.as_ref().filter(|name| typed.only.is_some() && !PARTED.contains(&&name[..]))
    {
        bail!("--only is for {}; {name} is run as a whole", PARTED.join(" and "));
    }
    let mut benches = Vec::new();
    for experiment in chosen(typed.name.as_deref().unwrap_or("all"))? {
        let bench = (experiment.run)(&setup)?;
        if !typed.json {
            // At once: the next one may take minutes.
            output::print(&format!("{}\n", bench.table()))?;
        }
        benches.push(bench);
    }
    Ok(VerbOutput { json: serde_json::to_value(&benches)?, ..VerbOutput::default() })
}

/// The names of all benches and what each measures.
fn list() -> VerbOutput {
    let text = experiment::ALL.iter().map(|e| format!("{:12} {}\n", e.name, e.about)).collect();
    let json = json!(experiment::ALL.iter().map(|e| (e.name, e.about)).collect::<Vec<_>>());
    VerbOutput { text, json, ..VerbOutput::default() }
}

/// The benches that `name` means.
fn chosen(name: &str) -> Result<Vec<&'static Experiment>> {
    let chosen: Vec<_> = experiment::ALL.iter().filter(|e| name == "all" || e.name == name).collect();
    if chosen.is_empty() {
        let names: Vec<&str> = experiment::ALL.iter().map(|e| e.name).collect();
        bail!("there is no bench {name:?}; there are {} and all", names.join(", "));
    }
    Ok(chosen)
}
