//! Reads throughput traces of two columns: time in seconds, rate in Mbit/s.

use super::{
    Limits, MAX_PERIOD, MAX_RATE, Step, Trace, TraceError,
    lines::{check_points, check_size, decimal, field, lines},
};
use crate::clock::{Nanos, Rate};

/// Which way the rate of a row holds. The two families of public traces differ; the difference is one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Holds {
    /// From its own time until the next row's; the last row for as long as the one before it.
    Forward,
    /// From the previous row's time until its own; the first row for as long as the second.
    Backward,
}

impl Trace {
    /// Loads `time_s rate_Mbps` lines, rebased to the first time; `holds` says which way a rate holds.
    ///
    /// # Errors
    /// See [`TraceError`].
    pub fn two_column(name: &str, bytes: &[u8], holds: Holds, limits: &Limits) -> Result<Self, TraceError> {
        load(name, bytes, holds, limits)
    }
}

fn load(name: &str, bytes: &[u8], holds: Holds, limits: &Limits) -> Result<Trace, TraceError> {
    check_size(bytes, limits)?;
    let mut rows: Vec<Step> = Vec::new();
    let mut first_s = None;
    for line in lines(bytes, limits) {
        let (number, text) = line?;
        let mut columns = text.split(u8::is_ascii_whitespace).filter(|column| !column.is_empty());
        let (time, rate) = (columns.next().unwrap_or_default(), columns.next().unwrap_or_default());
        if let Some(extra) = columns.next() {
            return Err(field(number, "third column", extra, "two columns"));
        }
        let Some(seconds) = decimal(time).filter(|seconds| *seconds < 1e12) else {
            return Err(field(number, "time in s", time, "a decimal number from 0 to 10^12"));
        };
        let since = seconds - *first_s.get_or_insert(seconds);
        if !(0.0..=MAX_PERIOD.as_s()).contains(&since) {
            return Err(field(
                number,
                "time in s",
                time,
                "no earlier than the first line, at most 7 days after it",
            ));
        }
        let at = Nanos((since * 1e9).round() as u64);
        let Some(mbps) = decimal(rate).filter(|mbps| *mbps * 1e6 <= MAX_RATE.0 as f64) else {
            return Err(field(number, "rate in Mbit/s", rate, "a decimal number from 0 to 10^6"));
        };
        if rows.last().is_some_and(|last| last.at >= at) {
            return Err(field(number, "time in s", time, "more than on the line before"));
        }
        rows.push(Step { at, rate: Rate((mbps * 1e6).round() as u64) });
        check_points(rows.len(), limits)?;
    }
    let Some(last) = rows.last().map(|row| row.at) else { return Err(TraceError::NoCapacity) };
    let lone = Nanos::from_s(1);
    match holds {
        Holds::Forward => {
            let tail = rows.windows(2).last().map_or(lone, |pair| pair[1].at - pair[0].at);
            Trace::steps(name, rows, last + tail)
        }
        Holds::Backward => {
            let head = rows.windows(2).next().map_or(lone, |pair| pair[1].at - pair[0].at);
            let mut start = Nanos::ZERO;
            for row in &mut rows {
                let end = row.at + head;
                row.at = start;
                start = end;
            }
            Trace::steps(name, rows, last + head)
        }
    }
}

#[cfg(test)]
mod tests {
    use super::super::Shape;
    use super::*;

    fn steps(holds: Holds) -> (Vec<(u64, u64)>, u64) {
        let trace = load("t", b"300.0 1\n300.5\t2.5\n302.5 3\n", holds, &Limits::default()).unwrap();
        let Shape::Steps(steps) = trace.shape() else { panic!("steps") };
        let rows = steps.iter().map(|s| (s.at.0 / 1_000_000, s.rate.0 / 1000)).collect();
        (rows, trace.period().0 / 1_000_000)
    }

    #[test]
    fn both_conventions_differ_by_one_step() {
        assert_eq!(steps(Holds::Forward), (vec![(0, 1000), (500, 2500), (2500, 3000)], 4500));
        assert_eq!(steps(Holds::Backward), (vec![(0, 1000), (500, 2500), (1000, 3000)], 3000));
    }

    #[test]
    fn errors_name_the_column() {
        for (text, start) in [
            ("0 nan\n", "line 1, rate in Mbit/s: found \"nan\""),
            ("0 1\n0 2\n", "line 2, time in s: found \"0\""),
            ("0 1\n1\n", "line 2, rate in Mbit/s: found \"\""),
            ("0 1 2\n", "line 1, third column: found \"2\""),
            ("x 1\n", "line 1, time in s: found \"x\""),
        ] {
            let error = load("t", text.as_bytes(), Holds::Forward, &Limits::default()).unwrap_err();
            assert!(error.to_string().starts_with(start), "{error}");
        }
    }
}
