//! Runs the verbs: one file each, from the command line to steps of the pipeline to a [`output::VerbOutput`].

mod bench;
mod compare;
mod convert;
mod cut;
mod decode;
mod demo;
mod encode;
mod import;
mod inspect;
mod interruption;
mod manual;
mod play;
mod relay;
mod render;
mod serve;
mod socket;
mod stream;
mod sweep;
mod train;
mod view;

use std::process::ExitCode;

use anyhow::anyhow;
pub use demo::page as demo_page;

use crate::{
    args::{Cli, Verb},
    files, output,
    pipeline::Quiet,
};

/// Runs what was typed and prints what it says.
pub fn run(cli: Cli) -> ExitCode {
    let quiet = Quiet(cli.json);
    let writes_data = writes_data(&cli.verb);
    if cli.json && writes_data {
        return output::finish_beside_data(Err(anyhow!(
            "--json: standard output is what --out writes to; name a file there"
        )));
    }
    // The others have something to finish first.
    if !matches!(cli.verb, Verb::Train(_) | Verb::Serve(_) | Verb::Play(_) | Verb::View(_)) {
        interruption::leave_when_interrupted();
    }
    let said = match cli.verb {
        Verb::Import(args) => import::run(&args),
        Verb::Convert(args) => convert::run(&args, quiet),
        Verb::Train(args) => train::run(&args, quiet),
        Verb::Encode(args) => encode::run(&args, quiet),
        Verb::Inspect(args) => inspect::run(&args),
        Verb::Cut(args) => cut::run(&args),
        Verb::Completions(args) => manual::completions(&args),
        Verb::Man(args) => manual::pages(&args),
        Verb::Decode(args) => decode::run(&args, quiet),
        Verb::Render(args) => render::run(&args, quiet),
        Verb::Compare(args) => compare::run(&args, quiet),
        Verb::Stream(args) => stream::run(&args, quiet),
        Verb::Sweep(args) => sweep::run(&args, quiet),
        Verb::Serve(args) => serve::run(&args, quiet),
        Verb::Play(args) => play::run(&args, quiet),
        Verb::View(args) => view::run(&args, quiet),
        Verb::Demo(args) => demo::run(&args, quiet),
        Verb::Bench(args) => match bench::run(&args, cli.json) {
            // It has printed for itself.
            Ok(code) => return code,
            Err(error) => Err(error),
        },
    };
    if writes_data { output::finish_beside_data(said) } else { output::finish(said, cli.json) }
}

/// Whether a picture or a stream is written to standard output.
fn writes_data(verb: &Verb) -> bool {
    let out = match verb {
        Verb::Encode(args) => Some(&args.out),
        Verb::Cut(args) => Some(&args.out),
        Verb::Render(args) => Some(&args.out),
        Verb::Stream(args) => args.out.as_ref(),
        _ => None,
    };
    out.is_some_and(|out| files::is_standard_output(out))
}
