//! The front door: what was typed, what it means, run, an exit code.

use std::process::ExitCode;

use clap::Parser;
use dgs::{args::Cli, command};

fn main() -> ExitCode {
    let cli = Cli::parse();
    let json = cli.json;
    match command::run(cli) {
        Ok(outcome) => {
            outcome.print(json);
            outcome.exit_code()
        }
        Err(error) => {
            // The whole chain as one sentence: file, place, what was found, what is allowed.
            eprintln!("dgs: {error:#}");
            ExitCode::from(1)
        }
    }
}
