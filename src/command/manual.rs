//! Writes what shells and `man` read: `dgs completions` and `dgs man`.

use anyhow::{Context, Result};
use clap::{Command, CommandFactory as _};
use serde_json::json;

use crate::{
    args::{Cli, Completions, Man},
    files,
    output::VerbOutput,
};

/// Prints completions for a shell.
pub fn completions(args: &Completions) -> Result<VerbOutput> {
    let mut bytes = Vec::new();
    clap_complete::generate(args.shell, &mut Cli::command(), "dgs", &mut bytes);
    let text = String::from_utf8(bytes).context("completions")?;
    let json = json!({ "shell": args.shell.to_string(), "completions": text });
    Ok(VerbOutput { text, json, ..VerbOutput::default() })
}

/// Writes a page for the program and one for every verb, and for what verbs have of their own.
pub fn pages(args: &Man) -> Result<VerbOutput> {
    let mut root = Cli::command().disable_help_subcommand(true);
    root.build();
    let mut pages = Vec::new();
    add_pages("dgs", &root, &mut pages);
    let mut written = Vec::new();
    for (name, command) in pages {
        let mut page = Vec::new();
        let command = command.clone().version(env!("CARGO_PKG_VERSION"));
        clap_mangen::Man::new(command)
            .title(&name)
            .render(&mut page)
            .with_context(|| format!("page {name}"))?;
        let path = args.out.join(format!("{name}.1"));
        files::write(&path, &page)?;
        written.push(files::shown(&path));
    }
    let text = format!("wrote {} pages to {}\n", written.len(), args.out.display());
    Ok(VerbOutput { text, json: json!({ "pages": written }), ..VerbOutput::default() })
}

/// Adds `command`, whose page is called `name`, and all that are below it.
fn add_pages<'c>(name: &str, command: &'c Command, pages: &mut Vec<(String, &'c Command)>) {
    pages.push((name.to_owned(), command));
    for below in command.get_subcommands().filter(|below| !below.is_hide_set()) {
        add_pages(&format!("{name}-{}", below.get_name()), below, pages);
    }
}
