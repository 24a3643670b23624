//! Reads files of traces: capacity, delay and loss over time, of whatever kind their content says.

use std::path::Path;

use anyhow::{Context, Result, bail};
use emulator_host::{
    Nanos, Trace,
    trace::{self, DelayTrace, Replay},
};

/// How long each line of a delay trace holds (LeoCC's recordings of Starlink).
const DELAY_INTERVAL: Nanos = Nanos::from_ms(10);

/// Reads a trace of capacity alone, by content: UCC CSV, mahimahi (one column) or two columns.
///
/// # Errors
/// What the loader refuses, with the file's name; a trace that has delays or losses too.
pub fn read_trace(path: &Path) -> Result<Trace> {
    let replay = read_recording(path)?.replay;
    if replay.delay.is_some() {
        bail!("{}: has delays too; a trace of capacity alone is needed here", path.display());
    }
    Ok(replay.capacity)
}

/// What a trace file holds.
#[derive(Clone, Debug)]
pub(crate) struct Recording {
    /// Capacity, with delays and losses where they were recorded.
    pub(crate) replay: Replay,
    /// What whoever uses it should know.
    pub(crate) notes: Vec<String>,
}

/// Reads a trace, by content: UCC CSV, mahimahi (one column), two columns, or three or four with delay and
/// loss.
///
/// # Errors
/// What the loader refuses, with the file's name.
pub(crate) fn read_recording(path: &Path) -> Result<Recording> {
    let limits = trace::Limits::default();
    let bytes = trace::read(path, &limits).with_context(|| path.display().to_string())?;
    let name = path.file_name().map_or_else(String::new, |n| n.to_string_lossy().into_owned());
    let first = Replay::first_line(&bytes);
    // Names of columns may have blanks in them.
    let has_commas = first.contains(&b',');
    let separates = |byte: &u8| if has_commas { *byte == b',' } else { byte.is_ascii_whitespace() };
    let columns = first.split(separates).filter(|cell| !cell.trim_ascii().is_empty()).count();
    let mut notes = Vec::new();
    let replay = if matches!(columns, 3 | 4) && !first.starts_with(b"Timestamp") {
        Replay::load(&name, &bytes, &limits)
    } else if first.starts_with(b"Timestamp") || (columns > 4 && first.contains(&b',')) {
        Trace::ucc(&name, &bytes, trace::Direction::Down, &limits).map(Replay::from)
    } else if columns <= 1 {
        Trace::mahimahi(&name, &bytes, &limits).map(Replay::from)
    } else if name.contains("pitree") {
        // The two families differ in which end of its interval a row stands at.
        notes.push("its name has pitree in it, so each rate holds until the time of its row".to_owned());
        Trace::two_column(&name, &bytes, trace::HoldDirection::Backward, &limits).map(Replay::from)
    } else {
        Trace::two_column(&name, &bytes, trace::HoldDirection::Forward, &limits).map(Replay::from)
    };
    let replay = replay.with_context(|| format!("{}: not a usable trace", path.display()))?;
    notes.extend(replay.capacity.warnings().iter().map(ToString::to_string));
    Ok(Recording { replay, notes })
}

/// Reads one-way delays: a number of milliseconds per line, each for 10 ms.
///
/// # Errors
/// What the loader refuses, with the file's name.
pub(crate) fn read_delays(path: &Path) -> Result<DelayTrace> {
    let limits = trace::Limits::default();
    let bytes = trace::read(path, &limits).with_context(|| path.display().to_string())?;
    DelayTrace::load(&bytes, DELAY_INTERVAL, &limits)
        .with_context(|| format!("{}: not a usable trace of delays", path.display()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn names_of_columns_do_not_change_what_a_file_is() {
        let folder = tempfile::tempdir().unwrap();
        let path = folder.path().join("trace.csv");
        for (text, has_delays) in [
            ("time (s),throughput (Mbps)\n0,3\n1,4\n", false),
            ("time_s,rate (Mbit/s),delay (ms)\n0,3,20\n1,4,25\n", true),
            ("0 3\n1 4\n", false),
            ("0, 3, 20\n1, 4, 25\n", true),
        ] {
            std::fs::write(&path, text).unwrap();
            let replay = read_recording(&path).unwrap().replay;
            assert_eq!(replay.delay.is_some(), has_delays, "{text}");
            assert_eq!(replay.capacity.mean_rate().0, 3_500_000, "{text}");
        }
    }
}
