//! Makes what is typed ready to be served: files, scenes that are encoded first, standard input as it comes.

use std::{
    io,
    path::Path,
    sync::{
        Arc,
        atomic::{AtomicUsize, Ordering},
    },
    thread,
};

use anyhow::{Context, Result, bail};
use dgs_quic::socket::{ServedStream, message::MAX_NAME_BYTES};

use crate::{
    args::Serve,
    figures::counted,
    output,
    pipeline::{self, LiveReader, Quiet},
};

/// Standard input, as an input.
const LIVE_INPUT: &str = "-";
/// What the stream from standard input is called.
const LIVE_NAME: &str = "live";

/// A file lies by level.
const NOT_BY_WINDOW: &str = "warning: packets of windows that were over came on standard input: viewers are \
                             shown a stream that grows from its newest window on; dgs cut FILE - --live \
                             writes a file so, and dgs serve FILE serves it whole";

/// What of the inputs is damaged, and used as far as it goes.
#[derive(Debug, Default)]
pub(super) struct Damage {
    /// Whether a file or a scene is.
    of_files: bool,
    /// Parts of standard input that are, of what has come so far.
    of_live: Arc<AtomicUsize>,
}

impl Damage {
    /// Whether anything was until now, and what is to be said of standard input: what of files is was said as
    /// they were read.
    pub(super) fn until_now(&self) -> (bool, Option<String>) {
        let parts = self.of_live.load(Ordering::Relaxed);
        let said = (parts > 0).then(|| {
            format!("standard input: {} damaged; what is readable was served", counted(parts, "part"))
        });
        (self.of_files || said.is_some(), said)
    }
}

/// Refuses inputs of which two would have one name.
pub(super) fn check_names(inputs: &[String]) -> Result<()> {
    if inputs.iter().filter(|input| *input == LIVE_INPUT).count() > 1 {
        bail!("{LIVE_INPUT} is given twice; standard input is one stream");
    }
    let called = |input: &String| if input == LIVE_INPUT { LIVE_NAME.to_owned() } else { name(input) };
    let names: Vec<String> = inputs.iter().map(called).collect();
    for (at, called) in names.iter().enumerate() {
        if let Some(before) = names[..at].iter().position(|name| name == called) {
            bail!(
                "two streams are called {called}, {} and {}: rename a file; dgs encode makes a file of a \
                 scene",
                inputs[before],
                inputs[at]
            );
        }
    }
    Ok(())
}

/// The streams that are named, ready to be sent, and what of them is damaged.
pub(super) fn offers(
    args: &Serve,
    quiet: Quiet,
    warnings: &mut Vec<String>,
) -> Result<(Vec<ServedStream>, Damage)> {
    // Before any is encoded, for minutes.
    for input in args.inputs.iter().filter(|input| *input != LIVE_INPUT) {
        pipeline::check_input(input, &args.scene)?;
    }
    let (mut offers, mut damage) = (Vec::new(), Damage::default());
    for input in &args.inputs {
        if input == LIVE_INPUT {
            offers.push(live(quiet, Arc::clone(&damage.of_live))?);
            continue;
        }
        let warn = &mut |warning| warnings.push(warning);
        let ready = pipeline::sendable(input, &args.scene, &args.codec, args.policy, quiet, warn)?;
        damage.of_files |= ready.damaged;
        offers.push(ServedStream::new(&name(input), &ready.stream, ready.graph)?);
    }
    Ok((offers, damage))
}

/// A stream that is read from standard input while it is served; `damaged` counts the parts of it that are.
fn live(quiet: Quiet, damaged: Arc<AtomicUsize>) -> Result<ServedStream> {
    let mut reader = LiveReader::new(io::stdin()).context("standard input")?;
    let (offer, feed) = ServedStream::live(LIVE_NAME, reader.stream(), reader.graph()?, reader.newest())?;
    // Reading blocks, for as long as the encoder wants; the end of the process ends it.
    let mut read = move || -> Result<(usize, bool)> {
        while reader.advance()? {
            damaged.store(reader.damaged(), Ordering::Relaxed);
            feed.renew(reader.stream(), reader.graph()?, reader.newest())?;
        }
        Ok((reader.damaged(), reader.is_by_window()))
    };
    let until_the_end = move || match read() {
        Ok((0, true)) if quiet.0 => {}
        Ok((damaged, by_window)) => {
            output::print_status(&format!("standard input has ended; {} damaged", counted(damaged, "part")));
            if !by_window {
                output::print_status(NOT_BY_WINDOW);
            }
        }
        Err(error) => output::print_status(&format!("standard input: {error:#}; what has come is served on")),
    };
    thread::Builder::new().name("dgs-live".to_owned()).spawn(until_the_end).context("cannot read beside")?;
    Ok(offer)
}

/// What a stream is called: its file's name without extension, other characters than a name has replaced.
pub(in crate::command) fn name(input: &str) -> String {
    let plain = input.strip_prefix("synth:").map_or(input, |kind| kind.split(':').next().unwrap_or(kind));
    let stem = Path::new(plain).file_stem().map_or_else(String::new, |stem| stem.to_string_lossy().into());
    let legal = |c: char| if c.is_ascii_alphanumeric() || "._-".contains(c) { c } else { '-' };
    let name: String = stem.chars().take(MAX_NAME_BYTES).map(legal).collect();
    if name.is_empty() { "stream".to_owned() } else { name }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn streams_are_called_by_their_files() {
        for (input, called) in [
            ("a/Fox.glb", "Fox"),
            ("b c.dgs", "b-c"),
            ("synth:figure:8000:60", "figure"),
            ("folder/", "folder"),
            ("/", "stream"),
        ] {
            assert_eq!(name(input), called);
        }
    }

    #[test]
    fn damage_is_of_files_or_of_what_has_come_by_the_end() {
        let damage = Damage::default();
        assert_eq!(damage.until_now(), (false, None));
        damage.of_live.store(2, Ordering::Relaxed);
        let (is_damaged, said) = damage.until_now();
        assert!(is_damaged && said.is_some_and(|said| said.starts_with("standard input: 2 parts damaged")));
        assert_eq!(Damage { of_files: true, ..Damage::default() }.until_now(), (true, None));
    }
}
