//! Runs `dgs`: parses what was typed, runs its verb, exits with its status.

use std::process::ExitCode;

use dgs::{args::Cli, command, output};

fn main() -> ExitCode {
    match output::parse::<Cli>() {
        Ok(cli) => command::run(cli),
        Err(code) => code,
    }
}
