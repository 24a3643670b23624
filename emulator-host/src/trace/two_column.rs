//! Reads throughput traces of two columns: time in seconds, rate in Mbit/s.

use super::{
    Limits, MAX_PERIOD, MAX_RATE, Step, Trace, TraceError,
    lines::{check_points, check_text, decimal, field, rows as lines_of},
    unit_checks::unit_warnings,
};
use crate::clock::{Nanos, Rate};

/// Whether a row's rate holds after its time or before it: the public sets of traces use both conventions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum HoldDirection {
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
    pub fn two_column(
        name: &str,
        bytes: &[u8],
        holds: HoldDirection,
        limits: &Limits,
    ) -> Result<Self, TraceError> {
        load(name, bytes, holds, limits)
    }
}

fn load(name: &str, bytes: &[u8], holds: HoldDirection, limits: &Limits) -> Result<Trace, TraceError> {
    check_text(bytes, limits)?;
    let mut rows: Vec<Step> = Vec::new();
    let mut first_s = None;
    for line in lines_of(bytes, limits) {
        let (number, text) = line?;
        let mut columns = text
            .split(|byte| byte.is_ascii_whitespace() || *byte == b',')
            .filter(|column| !column.is_empty());
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
    let warnings = unit_warnings(&rows);
    let lone = Nanos::from_s(1);
    let trace = match holds {
        HoldDirection::Forward => {
            let tail = rows.windows(2).last().map_or(lone, |pair| pair[1].at - pair[0].at);
            Trace::steps(name, rows, last + tail)
        }
        HoldDirection::Backward => {
            let head = rows.windows(2).next().map_or(lone, |pair| pair[1].at - pair[0].at);
            let mut start = Nanos::ZERO;
            for row in &mut rows {
                let end = row.at + head;
                row.at = start;
                start = end;
            }
            Trace::steps(name, rows, last + head)
        }
    };
    trace.map(|trace| Trace { warnings, ..trace })
}

#[cfg(test)]
mod tests {
    use super::super::Shape;
    use super::*;

    fn steps(holds: HoldDirection) -> (Vec<(u64, u64)>, u64) {
        let trace = load("t", b"300.0 1\n300.5\t2.5\n302.5 3\n", holds, &Limits::default()).unwrap();
        let Shape::Steps(steps) = trace.shape() else { panic!("steps") };
        let rows = steps.iter().map(|s| (s.at.0 / 1_000_000, s.rate.0 / 1000)).collect();
        (rows, trace.period().0 / 1_000_000)
    }

    #[test]
    fn both_conventions_differ_by_one_step() {
        assert_eq!(steps(HoldDirection::Forward), (vec![(0, 1000), (500, 2500), (2500, 3000)], 4500));
        assert_eq!(steps(HoldDirection::Backward), (vec![(0, 1000), (500, 2500), (1000, 3000)], 3000));
    }

    #[test]
    fn milliseconds_and_kilobits_are_noticed_and_named() {
        let warnings = |text: &str| {
            let trace = load("t", text.as_bytes(), HoldDirection::Forward, &Limits::default()).unwrap();
            trace.warnings().iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
        };
        assert_eq!(warnings("0 3.1\n1 2.7\n2 3.0\n3 2\n"), "");
        assert!(warnings("0 3.1\n1000 2.7\n2000 3.0\n").contains("looks like milliseconds"));
        assert!(warnings("0 3100\n1 2700\n2 3000\n").contains("looks like kbit/s"));
        let rows = |count: usize, step: usize, rate: &str| -> String {
            (0..count).map(|row| format!("{} {rate}\n", row * step)).collect()
        };
        assert!(warnings(&rows(12, 20, "3.1")).contains("rows are 20 s apart"));
        assert!(warnings(&rows(12, 1, "300")).contains("the rate is 300 Mbit/s"));
        for fine in [rows(12, 5, "3.1"), rows(3, 20, "3.1"), rows(12, 1, "300.5"), rows(3, 1, "300")] {
            assert_eq!(warnings(&fine), "");
        }
        // 10 ms and 5 ms; the latter in a log of some seconds, since real traces have rows 5 s apart.
        assert!(warnings(&rows(21, 10, "3.1")).contains("rows are 10 s apart"));
        assert!(warnings(&rows(800, 5, "3.1")).contains("rows are 5 s apart"));
        for measured in [rows(300, 5, "1.1"), rows(800, 2, "1.1"), rows(9_000, 1, "1.1")] {
            assert_eq!(warnings(&measured), "");
        }
        // Around 312 kbit/s, with one digit behind the point or three; and a 5G link in Mbit/s.
        let varied = |rate: &dyn Fn(usize) -> String| -> String {
            (0..21).map(|row| format!("{row} {}\n", rate(row))).collect()
        };
        for logged in [
            varied(&|row| format!("312.{}", row % 10)),
            varied(&|row| format!("312.{row:03}")),
            varied(&|_| "312.5".to_owned()),
            varied(&|row| format!("{}.5", 10 + 40 * row)),
        ] {
            let said = warnings(&logged);
            assert!(said.contains("Mbit/s and looks like kbit/s"), "{logged}: {said}");
        }
        let wireless = varied(&|row| format!("{}.{row:03}271", [3, 312, 255, 401, 328][row % 5]));
        assert_eq!(warnings(&wireless), "");
        let both = warnings("0 3100\n1000 2700\n2000 3000\n");
        assert!(
            both.starts_with("rows are 1000 s apart") && both.contains("the rate is 3000 Mbit/s"),
            "{both}"
        );
    }

    #[test]
    fn marks_comments_and_names_of_columns_are_passed_over() {
        let whole = load("t", b"0,1\n1,2\n", HoldDirection::Forward, &Limits::default()).unwrap();
        for text in [
            "\u{feff}0,1\n1,2\n",
            "# a phone\n0,1\n# indoors\n1,2\n",
            "time_s,mbps\n0,1\n1,2\n",
            "\u{feff}# a phone\n\"time\", \"rate\"\n0,1\n1,2\n",
        ] {
            let found = load("t", text.as_bytes(), HoldDirection::Forward, &Limits::default()).unwrap();
            assert_eq!(found.shape(), whole.shape(), "{text}");
        }
        let twice = load("t", b"a,b\nc,d\n0,1\n", HoldDirection::Forward, &Limits::default()).unwrap_err();
        assert!(twice.to_string().starts_with("line 2, time in s: found \"c\""), "{twice}");
        let packed = load("t", &[0x1f, 0x8b, 8, 0], HoldDirection::Forward, &Limits::default()).unwrap_err();
        assert_eq!(packed.to_string(), "gzip: unpack it first");
    }

    #[test]
    fn json_is_refused_by_every_loader_in_a_sentence() {
        let json = b" {\"flows\": [1, 2]}\n";
        let limits = Limits::default();
        let direction = super::super::Direction::Down;
        for loaded in [
            Trace::mahimahi("t", json, &limits),
            Trace::two_column("t", json, HoldDirection::Forward, &limits),
            Trace::ucc("t", json, direction, &limits),
        ] {
            assert_eq!(loaded.unwrap_err(), TraceError::Json);
        }
        let said = TraceError::Json.to_string();
        for kind in
            ["Pantheon", "two columns (s, Mbit/s)", "three or four (s, Mbit/s, one-way delay", "UCC CSV"]
        {
            assert!(said.contains(kind), "{kind}: {said}");
        }
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
            let error = load("t", text.as_bytes(), HoldDirection::Forward, &Limits::default()).unwrap_err();
            assert!(error.to_string().starts_with(start), "{error}");
        }
    }
}
