//! Ends a program: parses what was typed, prints what a verb says, turns both into an exit status.
//!
//! Exit status: 0 fine, 1 refused, 2 done, but not all of it (damaged input used as far as it goes, training
//! that was interrupted, conditions that a server did not grant, shards that are missing), 64 not a command
//! (`EX_USAGE` of sysexits.h), 130 interrupted. A reader that closes the pipe early is no error; a full disk
//! is.

use std::{
    io::{self, ErrorKind, Write as _},
    process::ExitCode,
};

use anyhow::{Context as _, Result};
use clap::{
    Parser,
    error::{ContextKind, ContextValue, ErrorKind as ErrorKindOfClap},
};

/// Nothing was done: the input or an option was refused, or writing failed.
const REFUSED: u8 = 1;
/// Something was done, but not all of it.
const DAMAGED: u8 = 2;
/// What was typed is not a command of this program.
const USAGE: u8 = 64;

/// What a verb has to say.
#[derive(Debug, Default)]
pub struct VerbOutput {
    /// For people, on standard output.
    pub text: String,
    /// For programs, instead of the text when `--json` is given.
    pub json: serde_json::Value,
    /// For people, on standard error: damage, doubtful input.
    pub warnings: Vec<String>,
    /// True if something was kept but not everything was right.
    pub damaged: bool,
}

impl VerbOutput {
    /// Prints its warnings.
    fn print_status(&self) {
        for warning in &self.warnings {
            print_status(&format!("warning: {warning}"));
        }
    }
}

/// What was typed, or the exit status after help, version or a refusal has been printed.
///
/// # Errors
/// 0 after `--help` and `--version` (1 if they cannot be printed), 64 if it is not a command.
pub fn parse<T: Parser>() -> Result<T, ExitCode> {
    T::try_parse().map_err(|mut error| {
        if error.use_stderr() {
            say_how_numbers_are_typed(&mut error);
            // Where standard error is closed, the exit status still says it.
            let _ = error.print();
            return ExitCode::from(USAGE);
        }
        written(error.print()).map_or_else(|error| refuse(&error), |()| ExitCode::SUCCESS)
    })
}

/// Of a number below 0 that was taken for an option: how it is typed as the value of one.
fn say_how_numbers_are_typed(error: &mut clap::Error) {
    let Some(ContextValue::String(typed)) = error.get(ContextKind::InvalidArg) else { return };
    let number = typed
        .strip_prefix('-')
        .is_some_and(|rest| rest.starts_with(|c: char| c == '.' || c.is_ascii_digit()));
    if error.kind() != ErrorKindOfClap::UnknownArgument || !number {
        return;
    }
    let tip = "a value that begins with - is typed behind =, as in --OPTION=VALUE".to_owned();
    error.insert(ContextKind::Suggested, ContextValue::StyledStrs(vec![tip.into()]));
}

/// An error and its causes in one line. Some errors say their cause themselves: it is not said again.
fn sentence(error: &anyhow::Error) -> String {
    let mut text = error.to_string();
    for cause in error.chain().skip(1).map(ToString::to_string) {
        if !text.ends_with(&cause) {
            text += &format!(": {cause}");
        }
    }
    text
}

/// Prints what a verb says and gives its exit status.
pub fn finish(said: Result<VerbOutput>, json: bool) -> ExitCode {
    let print = |said: VerbOutput| {
        said.print_status();
        let text = if json { format!("{}\n", said.json) } else { said.text };
        print(&text)?;
        Ok(ExitCode::from(if said.damaged { DAMAGED } else { 0 }))
    };
    said.and_then(print).unwrap_or_else(|error| refuse(&error))
}

/// As [`finish`], where a picture or a stream is on standard output: what a verb says goes to standard error.
pub(crate) fn finish_beside_data(said: Result<VerbOutput>) -> ExitCode {
    let print = |said: VerbOutput| {
        said.print_status();
        // Where standard error is closed too, nothing is left to say it on.
        let _ = io::stderr().write_all(said.text.as_bytes());
        Ok(ExitCode::from(if said.damaged { DAMAGED } else { 0 }))
    };
    said.and_then(print).unwrap_or_else(|error| refuse(&error))
}

/// Writes `text` to standard output. A closed pipe is no error: its reader has seen enough.
///
/// # Errors
/// Any other failure to write, a full disk for example.
pub fn print(text: &str) -> Result<()> {
    print_bytes(text.as_bytes())
}

/// As [`print`], of bytes.
///
/// # Errors
/// As [`print`].
pub(crate) fn print_bytes(bytes: &[u8]) -> Result<()> {
    let mut out = io::stdout().lock();
    written(out.write_all(bytes).and_then(|()| out.flush()))
}

/// What writing to standard output came to, a closed pipe being no error.
fn written(result: io::Result<()>) -> Result<()> {
    match result {
        Err(error) if error.kind() != ErrorKind::BrokenPipe => {
            Err(error).context("standard output: cannot write")
        }
        _ => Ok(()),
    }
}

/// The whole chain as one sentence: file, place, what was found, what is allowed.
fn refuse(error: &anyhow::Error) -> ExitCode {
    print_status(&sentence(error));
    ExitCode::from(REFUSED)
}

/// One line on standard error; nothing where that is closed.
pub(crate) fn print_status(line: &str) {
    let _ = writeln!(io::stderr(), "dgs: {line}");
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, thiserror::Error)]
    #[error("camera 3: {source}")]
    struct SaysItsCause {
        source: io::Error,
    }

    #[test]
    fn causes_are_said_once() {
        let error = SaysItsCause { source: io::Error::other("no lens") };
        let error = anyhow::Error::new(error).context("cameras.json").context("--cameras");
        assert_eq!(sentence(&error), "--cameras: cameras.json: camera 3: no lens");
    }
}
