//! `dgs bench`: every figure this project quotes, each beside its error.

use anyhow::{Result, bail};
use serde_json::json;

use super::Outcome;
use crate::{
    args::Bench,
    experiment::{self, Setup},
    pipeline::Quiet,
};

/// Runs the verb.
pub fn run(args: &Bench, quiet: Quiet) -> Result<Outcome> {
    if args.list {
        let text = experiment::ALL.iter().map(|e| format!("{:12} {}\n", e.name, e.about)).collect();
        let json = json!(experiment::ALL.iter().map(|e| (e.name, e.about)).collect::<Vec<_>>());
        return Ok(Outcome { text, json, ..Outcome::default() });
    }
    let name = args.name.as_deref().unwrap_or("all");
    let chosen: Vec<_> = experiment::ALL.iter().filter(|e| name == "all" || e.name == name).collect();
    if chosen.is_empty() {
        let names: Vec<&str> = experiment::ALL.iter().map(|e| e.name).collect();
        bail!("there is no bench {name:?}; there are {} and all", names.join(", "));
    }
    let mut setup = Setup::new(args.data.clone(), args.quick, quiet);
    setup.out.clone_from(&args.out);
    let mut results = Vec::new();
    for experiment in chosen {
        let bench = (experiment.run)(&setup)?;
        if !quiet.0 {
            println!("{}", bench.table());
        }
        results.push(bench);
    }
    Ok(Outcome { json: serde_json::to_value(&results)?, ..Outcome::default() })
}
