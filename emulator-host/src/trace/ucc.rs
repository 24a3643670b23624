//! Reads UCC 5G production logs (Raca et al., MMSys 2020): about one row per second of a phone that
//! downloads.
//!
//! The log is not capacity as it stands, and the loader says what it did about it:
//! - About every 14 s the logger itself stops the download to ping. Near-zero seconds within 2 s of a row
//!   with a PINGAVG are treated as missing. Near zero is less than 100 kbit/s or 5 % of the median non-zero
//!   second, whichever is more. Other zeros stay: they are handovers and coverage holes.
//! - Seconds without a row are missing too; of two rows in one second the last counts. Missing seconds are
//!   interpolated over holes of up to 5 s and hold the rate before them in longer ones.
//! - If more than a fifth of the rows say State = I, the rate is what an application asked for:
//!   [`Warning::ApplicationLimited`]. Less than 100 kbit/s for 20 s or more gives [`Warning::LongZeroRun`].

use super::{
    Limits, MAX_RATE, Step, Trace, TraceError, Warning,
    lines::{check_points, check_text, decimal, field, lines},
};
use crate::clock::{Nanos, Rate};

/// Seconds around a ping in which a near-zero rate is an artefact.
const PING_REACH_S: u64 = 2;
/// Longest hole that is interpolated.
const BRIDGE_S: usize = 5;
const NEAR_ZERO_KBPS: f64 = 100.0;
const IDLE_SHARE: f64 = 0.2;
const LONG_ZERO_S: u32 = 20;

/// Which bitrate column.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Direction {
    /// DL_bitrate.
    Down,
    /// UL_bitrate.
    Up,
}

struct Row {
    second: u64,
    kbps: Option<f64>,
    ping_ms: Option<f64>,
}

impl Trace {
    /// Loads a UCC 5G log (CSV with a header) and repairs the dips that its own pings cause; see [`Warning`].
    ///
    /// # Errors
    /// See [`TraceError`].
    pub fn ucc(name: &str, bytes: &[u8], direction: Direction, limits: &Limits) -> Result<Self, TraceError> {
        load(name, bytes, direction, limits)
    }
}

fn load(name: &str, bytes: &[u8], direction: Direction, limits: &Limits) -> Result<Trace, TraceError> {
    check_text(bytes, limits)?;
    let (rows, idle) = rows(bytes, direction, limits)?;
    let Some(first) = rows.first().map(|row| row.second) else { return Err(TraceError::NoCapacity) };
    let span = rows.last().map_or(0, |row| row.second - first) as usize + 1;
    check_points(span, limits)?;

    let mut seconds: Vec<Option<f64>> = vec![None; span];
    let mut near_ping = vec![false; span];
    for row in &rows {
        let at = (row.second - first) as usize;
        seconds[at] = row.kbps.or(seconds[at]);
        if row.ping_ms.is_some() {
            let reach = PING_REACH_S as usize;
            near_ping[at.saturating_sub(reach)..(at + reach + 1).min(span)].fill(true);
        }
    }
    let mut warnings = Vec::new();
    let near_zero =
        (median(seconds.iter().flatten().copied().filter(|kbps| *kbps > 0.0)) * 0.05).max(NEAR_ZERO_KBPS);
    let mut repaired = 0;
    for (second, near) in seconds.iter_mut().zip(&near_ping) {
        if *near && second.is_some_and(|kbps| kbps < near_zero) {
            *second = None;
            repaired += 1;
        }
    }
    if repaired > 0 {
        warnings.push(Warning::PingDipsRepaired { seconds: repaired });
    }
    let (filled, longest_gap) = fill(&seconds);
    if longest_gap as usize > BRIDGE_S {
        warnings.push(Warning::LongGap { seconds: longest_gap });
    }
    let share = idle as f64 / rows.len() as f64;
    if share > IDLE_SHARE {
        warnings.push(Warning::ApplicationLimited { idle: share });
    }
    let zeros = longest_run(&filled, |kbps| kbps < NEAR_ZERO_KBPS);
    if zeros >= LONG_ZERO_S {
        warnings.push(Warning::LongZeroRun { seconds: zeros });
    }
    let steps = filled
        .iter()
        .zip(0u64..)
        .map(|(kbps, at)| Step { at: Nanos::from_s(at), rate: Rate((kbps * 1000.0).round() as u64) });
    let mut trace = Trace::steps(name, steps.collect(), Nanos::from_s(span as u64))?;
    trace.warnings = warnings;
    let pings: Vec<f64> = rows.iter().filter_map(|row| row.ping_ms).collect();
    if !pings.is_empty() {
        trace.base_rtt = Some(Nanos((median(pings.into_iter()) * 1e6).round() as u64));
    }
    Ok(trace)
}

/// All rows in time order, and how many of them are idle.
fn rows(bytes: &[u8], direction: Direction, limits: &Limits) -> Result<(Vec<Row>, usize), TraceError> {
    let mut text = lines(bytes, limits);
    let (number, header) = text.next().unwrap_or(Err(TraceError::NoCapacity))?;
    let column = |name: &'static str| {
        let position =
            header.split(|byte| *byte == b',').position(|title| title.trim_ascii() == name.as_bytes());
        position.ok_or_else(|| field(number, name, header, "a header with this column"))
    };
    let bitrate = match direction {
        Direction::Down => "DL_bitrate",
        Direction::Up => "UL_bitrate",
    };
    let (time_at, rate_at, state_at) = (column("Timestamp")?, column(bitrate)?, column("State")?);
    let ping_at = column("PINGAVG")?;
    let mut rows: Vec<Row> = Vec::new();
    let mut idle = 0;
    for line in text {
        let (number, line) = line?;
        let cell = |at: usize| line.split(|byte| *byte == b',').nth(at).unwrap_or_default().trim_ascii();
        let Some(second) = timestamp(cell(time_at)) else {
            return Err(field(number, "Timestamp", cell(time_at), "YYYY.MM.DD_HH.MM.SS"));
        };
        if rows.last().is_some_and(|last| last.second > second) {
            return Err(field(number, "Timestamp", cell(time_at), "no earlier than on the line before"));
        }
        let kbps = optional(cell(rate_at), MAX_RATE.0 as f64 / 1000.0)
            .ok_or_else(|| field(number, bitrate, cell(rate_at), "kbit/s from 0 to 10^9, or -"))?;
        let ping_ms = optional(cell(ping_at), 60_000.0)
            .ok_or_else(|| field(number, "PINGAVG", cell(ping_at), "ms from 0 to 60000, or -"))?;
        idle += usize::from(cell(state_at) == b"I");
        rows.push(Row { second, kbps, ping_ms });
        check_points(rows.len(), limits)?;
    }
    Ok((rows, idle))
}

/// `Some(None)` for `-`, `None` for anything illegal.
fn optional(cell: &[u8], most: f64) -> Option<Option<f64>> {
    if cell == b"-" {
        return Some(None);
    }
    decimal(cell).filter(|value| *value <= most).map(Some)
}

/// Seconds since 1970 of `YYYY.MM.DD_HH.MM.SS`, by the civil calendar without time zones.
fn timestamp(cell: &[u8]) -> Option<u64> {
    let mut parts = cell.split(|byte| *byte == b'.' || *byte == b'_');
    let mut part = |low: u64, high: u64| {
        super::lines::integer(parts.next()?).filter(|value| (low..=high).contains(value))
    };
    let (year, month, day) = (part(1970, 9999)?, part(1, 12)?, part(1, 31)?);
    let (hour, minute, second) = (part(0, 23)?, part(0, 59)?, part(0, 60)?);
    if parts.next().is_some() {
        return None;
    }
    let shifted = if month <= 2 { year - 1 } else { year };
    let day_of_year = (153 * ((month + 9) % 12) + 2) / 5 + day - 1;
    let days = 365 * shifted + shifted / 4 - shifted / 100 + shifted / 400 + day_of_year;
    // 719 468 days lie between 0000-03-01 and 1970-01-01.
    Some((days.checked_sub(719_468)?) * 86_400 + hour * 3600 + minute * 60 + second)
}

/// Missing seconds filled, and the longest hole.
fn fill(seconds: &[Option<f64>]) -> (Vec<f64>, u32) {
    let mut filled: Vec<f64> = Vec::with_capacity(seconds.len());
    let mut longest = 0;
    let mut at = 0;
    while at < seconds.len() {
        if let Some(kbps) = seconds[at] {
            filled.push(kbps);
            at += 1;
            continue;
        }
        let hole = seconds[at..].iter().take_while(|second| second.is_none()).count();
        longest = longest.max(hole as u32);
        let after = seconds.get(at + hole).copied().flatten();
        let before = filled.last().copied();
        let (start, end) = match (before, after) {
            (Some(before), Some(after)) if hole <= BRIDGE_S => (before, after),
            (Some(before), _) => (before, before),
            (None, after) => (after.unwrap_or(0.0), after.unwrap_or(0.0)),
        };
        let slope = (end - start) / (hole + 1) as f64;
        filled.extend((1..=hole).map(|step| start + slope * step as f64));
        at += hole;
    }
    (filled, longest)
}

fn longest_run(values: &[f64], is_in: impl Fn(f64) -> bool) -> u32 {
    let (mut longest, mut run) = (0, 0);
    for value in values {
        run = if is_in(*value) { run + 1 } else { 0 };
        longest = longest.max(run);
    }
    longest
}

/// Upper median; 0 of nothing.
fn median(values: impl Iterator<Item = f64>) -> f64 {
    let mut sorted: Vec<f64> = values.collect();
    sorted.sort_by(f64::total_cmp);
    sorted.get(sorted.len() / 2).copied().unwrap_or(0.0)
}

#[cfg(test)]
mod tests {
    use super::super::Shape;
    use super::*;

    const HEADER: &str = "Timestamp,DL_bitrate,UL_bitrate,State,PINGAVG\n";

    fn trace(rows: &[(&str, &str, &str, &str)]) -> Result<Trace, TraceError> {
        let mut text = HEADER.to_owned();
        for (time, rate, state, ping) in rows {
            text += &format!("2020.02.14_09.38.{time},{rate},1,{state},{ping}\n");
        }
        load("t", text.as_bytes(), Direction::Down, &Limits::default())
    }

    fn rates(trace: &Trace) -> Vec<u64> {
        let Shape::Steps(steps) = trace.shape() else { panic!("steps") };
        steps.iter().map(|step| step.rate.0 / 1000).collect()
    }

    #[test]
    fn a_dip_beside_a_ping_is_bridged_and_another_zero_stays() {
        let trace = trace(&[
            ("00", "8000", "D", "-"),
            ("01", "0", "D", "-"),
            ("02", "0", "D", "80.0"),
            ("03", "5000", "D", "-"),
            ("04", "9000", "D", "-"),
            ("05", "0", "D", "-"),
            ("06", "7000", "D", "-"),
            ("06", "6000", "D", "-"),
            ("08", "8000", "D", "-"),
        ])
        .unwrap();
        assert_eq!(rates(&trace), [8000, 7000, 6000, 5000, 9000, 0, 6000, 7000, 8000]);
        assert_eq!(trace.warnings(), [Warning::PingDipsRepaired { seconds: 2 }]);
        assert_eq!(trace.base_rtt(), Some(Nanos::from_ms(80)));
        assert_eq!(trace.period(), Nanos::from_s(9));
    }

    #[test]
    fn an_idle_log_is_loaded_with_a_warning() {
        let trace =
            trace(&[("00", "10", "D", "-"), ("01", "900", "I", "-"), ("02", "10", "I", "-")]).unwrap();
        assert!(matches!(trace.warnings(), [Warning::ApplicationLimited { idle }] if *idle > 0.6));
    }

    #[test]
    fn illegal_cells_are_named() {
        let error = trace(&[("00", "x", "D", "-")]).unwrap_err();
        assert_eq!(error.to_string(), "line 2, DL_bitrate: found \"x\", allowed kbit/s from 0 to 10^9, or -");
        assert!(trace(&[("61", "1", "D", "-")]).unwrap_err().to_string().contains("Timestamp"));
        assert!(trace(&[("05", "1", "D", "-"), ("04", "1", "D", "-")]).is_err());
        let error = load("t", b"a,b\n", Direction::Down, &Limits::default()).unwrap_err();
        assert!(error.to_string().contains("Timestamp"));
    }

    #[test]
    fn civil_time_counts_leap_days() {
        assert_eq!(timestamp(b"1970.01.01_00.00.00"), Some(0));
        assert_eq!(timestamp(b"2020.02.29_23.59.59").map(|s| s + 1), timestamp(b"2020.03.01_00.00.00"));
        assert_eq!(timestamp(b"2020.02.14_09.38.22"), Some(1_581_673_102));
        assert_eq!(timestamp(b"2020.02.14"), None);
    }
}
