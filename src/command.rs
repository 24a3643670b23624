//! One file per verb: what was typed becomes steps of the walk, and an [`Outcome`].

mod bench;
mod decode;
mod demo;
mod encode;
mod import;
mod inspect;
mod render;
mod stream;

use std::process::ExitCode;

use anyhow::Result;

use crate::{
    args::{Cli, Verb},
    pipeline::Quiet,
};

pub use demo::page as demo_page;

/// What a verb has to say.
#[derive(Debug, Default)]
pub struct Outcome {
    /// For people, on standard output.
    pub text: String,
    /// For programs, instead of the text when `--json` is given.
    pub json: serde_json::Value,
    /// For people, on standard error: damage, doubtful input.
    pub warnings: Vec<String>,
    /// True if something was kept but not everything was right (exit code 2).
    pub damaged: bool,
}

impl Outcome {
    /// Prints text or JSON, and warnings.
    pub fn print(&self, json: bool) {
        for warning in &self.warnings {
            eprintln!("dgs: warning: {warning}");
        }
        if json {
            println!("{}", self.json);
        } else {
            print!("{}", self.text);
        }
    }

    /// 0 if all is well, 2 if damaged input was used as far as it goes.
    pub fn exit_code(&self) -> ExitCode {
        ExitCode::from(if self.damaged { 2 } else { 0 })
    }
}

/// Runs what was typed.
///
/// # Errors
/// Whatever stops the verb, as a chain that names file and place.
pub fn run(cli: Cli) -> Result<Outcome> {
    let quiet = Quiet(cli.json);
    match cli.verb {
        Verb::Import(args) => import::run(&args),
        Verb::Encode(args) => encode::run(&args, quiet),
        Verb::Inspect(args) => inspect::run(&args),
        Verb::Decode(args) => decode::run(&args),
        Verb::Render(args) => render::run(&args),
        Verb::Stream(args) => stream::run(&args, quiet),
        Verb::Demo(args) => demo::run(&args, quiet),
        Verb::Bench(args) => bench::run(&args, quiet),
    }
}
