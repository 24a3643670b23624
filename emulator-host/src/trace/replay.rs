//! Reads recordings of rate, delay and loss together: a line per step of time.
//!
//! `time_s rate_Mbps delay_ms [loss_percent]`, separated by white space or commas, as one makes them of
//! CellReplay's recordings (rate of the saturated link, base delay) or of UCC's logs (with ping and its
//! loss). All lines have as many columns as the first. A step holds until the next; the last for as long as
//! the one before it.

use std::sync::Arc;

use super::{
    DelayTrace, Limits, MAX_PERIOD, MAX_RATE, Step, Trace, TraceError,
    delay::MAX_MS,
    lines::{check_points, check_text, decimal, field, first_line, rows},
    steps,
    unit_checks::unit_warnings,
};
use crate::{
    clock::{Nanos, Rate},
    rng::Probability,
};

/// How long a lone line holds.
const LONE: Nanos = Nanos::from_s(1);

/// Loss over time: each datagram is lost with the chance that holds when it passes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct LossTrace {
    chances: Arc<[(Nanos, Probability)]>,
    period: Nanos,
}

impl LossTrace {
    /// The chance that holds at `now`.
    pub fn at(&self, now: Nanos) -> Probability {
        steps::at(&self.chances, self.period, now).unwrap_or_default()
    }

    /// The whole trace, entered at `offset`.
    #[must_use]
    pub(super) fn starting_at(&self, offset: Nanos) -> Self {
        let chances = steps::starting_at(&self.chances, self.period, offset);
        Self { chances: chances.into(), period: self.period }
    }
}

/// What a path did over time.
///
/// # Examples
/// ```
/// use emulator_host::{
///     Nanos, Rate,
///     trace::{Limits, Replay},
/// };
///
/// let replay = Replay::load("phone", b"0 2 31.5 0\n1 4 28 2.5\n", &Limits::default())?;
/// assert_eq!(replay.capacity.mean_rate(), Rate::from_mbps(3));
/// let delay = replay.delay.map(|delay| delay.at(Nanos::from_ms(1500)));
/// assert_eq!(delay, Some(Nanos::from_ms(28)));
/// # Ok::<(), emulator_host::trace::TraceError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Replay {
    /// Rate.
    pub capacity: Trace,
    /// One-way delay, if it was recorded.
    pub delay: Option<DelayTrace>,
    /// Loss, if it was recorded.
    pub loss: Option<LossTrace>,
}

impl From<Trace> for Replay {
    /// Nothing but capacity was recorded.
    fn from(capacity: Trace) -> Self {
        Self { capacity, delay: None, loss: None }
    }
}

impl Replay {
    /// The first line of a trace that is neither empty nor a comment, trimmed: it says of what kind the file
    /// is.
    pub fn first_line(bytes: &[u8]) -> &[u8] {
        first_line(bytes)
    }

    /// Loads lines of three or four columns.
    ///
    /// # Errors
    /// See [`TraceError`].
    pub fn load(name: &str, bytes: &[u8], limits: &Limits) -> Result<Self, TraceError> {
        check_text(bytes, limits)?;
        let mut recorded = Recorded::default();
        for line in rows(bytes, limits) {
            let (number, text) = line?;
            recorded.enter(number, text)?;
            check_points(recorded.rates.len(), limits)?;
        }
        recorded.finish(name)
    }

    /// The whole recording, entered at `offset`.
    ///
    /// # Errors
    /// As [`Trace::window`].
    pub fn starting_at(&self, offset: Nanos) -> Result<Self, TraceError> {
        Ok(Self {
            capacity: self.capacity.starting_at(offset)?,
            delay: self.delay.as_ref().map(|delay| delay.starting_at(offset)),
            loss: self.loss.as_ref().map(|loss| loss.starting_at(offset)),
        })
    }
}

/// The lines so far.
#[derive(Default)]
struct Recorded {
    first_s: Option<f64>,
    columns: usize,
    rates: Vec<Step>,
    delays: Vec<(Nanos, Nanos)>,
    chances: Vec<(Nanos, Probability)>,
}

impl Recorded {
    fn enter(&mut self, number: u32, text: &[u8]) -> Result<(), TraceError> {
        let is_separator = |byte: &u8| byte.is_ascii_whitespace() || *byte == b',';
        let columns: Vec<&[u8]> = text.split(is_separator).filter(|column| !column.is_empty()).collect();
        if self.rates.is_empty() {
            self.columns = columns.len();
        }
        let &[time, rate, delay, ref loss @ ..] = columns.as_slice() else {
            return Err(field(number, "line", text, "time in s, rate in Mbit/s, delay in ms, loss in %"));
        };
        if columns.len() != self.columns || loss.len() > 1 {
            return Err(field(number, "line", text, "three or four columns, as many as on the first line"));
        }
        let Some(seconds) = decimal(time).filter(|seconds| *seconds < 1e12) else {
            return Err(field(number, "time in s", time, "a decimal number from 0 to 10^12"));
        };
        let since = seconds - *self.first_s.get_or_insert(seconds);
        let at = Nanos((since.clamp(0.0, 1e9) * 1e9).round() as u64);
        let rises = self.rates.last().is_none_or(|last| last.at < at);
        if !rises || !(0.0..=MAX_PERIOD.as_s()).contains(&since) {
            let allowed = "more than on the line before, at most 7 days after the first";
            return Err(field(number, "time in s", time, allowed));
        }
        let Some(mbps) = decimal(rate).filter(|mbps| *mbps * 1e6 <= MAX_RATE.0 as f64) else {
            return Err(field(number, "rate in Mbit/s", rate, "a decimal number from 0 to 10^6"));
        };
        let Some(ms) = decimal(delay).filter(|ms| *ms <= MAX_MS) else {
            return Err(field(number, "delay in ms", delay, "a decimal number from 0 to 60000"));
        };
        self.rates.push(Step { at, rate: Rate((mbps * 1e6).round() as u64) });
        self.delays.push((at, Nanos((ms * 1e6).round() as u64)));
        if let [loss] = loss {
            let chance = decimal(loss).and_then(|percent| Probability::new(percent / 100.0));
            let allowed = "a decimal number from 0 to 100";
            self.chances.push((at, chance.ok_or_else(|| field(number, "loss in %", loss, allowed))?));
        }
        Ok(())
    }

    fn finish(self, name: &str) -> Result<Replay, TraceError> {
        let Some(last) = self.rates.last().map(|row| row.at) else { return Err(TraceError::NoCapacity) };
        let tail = self.rates.windows(2).last().map_or(LONE, |pair| pair[1].at - pair[0].at);
        let period = last + tail;
        let delay = DelayTrace::of(self.delays, period);
        let mut warnings = unit_warnings(&self.rates);
        warnings.extend(delay.unit_warning());
        let capacity = Trace { warnings, ..Trace::steps(name, self.rates, period)? };
        let loss = (!self.chances.is_empty()).then(|| LossTrace { chances: self.chances.into(), period });
        Ok(Replay { capacity, delay: Some(delay), loss })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn load(text: &str) -> Result<Replay, TraceError> {
        Replay::load("t", text.as_bytes(), &Limits::default())
    }

    #[test]
    fn rate_delay_and_loss_change_together_and_repeat() {
        let replay = load("10 1 20 0\n10.5, 3, 40.5, 100\n11.5 2 10 0\n").unwrap();
        assert_eq!(replay.capacity.period(), Nanos::from_ms(2500));
        let (delay, loss) = (replay.delay.clone().unwrap(), replay.loss.clone().unwrap());
        let at = |ms| {
            (delay.at(Nanos::from_ms(ms)).0 / 1000, loss.at(Nanos::from_ms(ms)) != Probability::default())
        };
        let seen = [at(0), at(499), at(500), at(1499), at(1500), at(2500), at(3000)];
        let low = (20_000, false);
        assert_eq!(seen, [low, low, (40_500, true), (40_500, true), (10_000, false), low, (40_500, true)]);
        let moved = replay.starting_at(Nanos::from_ms(700)).unwrap();
        assert_eq!(moved.delay.unwrap().at(Nanos::ZERO), Nanos(40_500_000));
        assert!(load("0 1 20\n").unwrap().loss.is_none());
    }

    #[test]
    fn units_are_doubted_as_those_of_two_columns_are() {
        let warnings = |text: &str| {
            let trace = load(text).unwrap().capacity;
            trace.warnings().iter().map(ToString::to_string).collect::<Vec<_>>().join("; ")
        };
        assert_eq!(warnings("time,rate,delay\n0,3,25\n1,4,0.5\n2,3,31\n"), "");
        assert_eq!(warnings("0 3 0\n1 4 0\n"), "");
        assert!(warnings("0 3 20\n1000 4 20\n2000 3 20\n").contains("looks like milliseconds"));
        assert!(warnings("0 3000 20 0\n1 4000 20 0\n").contains("looks like kbit/s"));
        let seconds = warnings("0 3 0.025\n1 4 0.031\n");
        assert!(seconds.contains("the delay is 0.031 ms") && seconds.contains("seconds"), "{seconds}");
    }

    #[test]
    fn errors_name_line_and_column() {
        for (text, start) in [
            ("0 1\n", "line 1, line: found \"0 1\", allowed time in s, rate"),
            ("0 1 2 3 4\n", "line 1, line"),
            ("0 1 2 3\n1 1 2\n", "line 2, line: found \"1 1 2\", allowed three or four columns"),
            ("0 1 2\n0 1 2\n", "line 2, time in s: found \"0\""),
            ("0 x 2\n", "line 1, rate in Mbit/s: found \"x\""),
            ("0 1 -2\n", "line 1, delay in ms: found \"-2\""),
            ("0 1 2 101\n", "line 1, loss in %: found \"101\", allowed a decimal number from 0 to 100"),
            ("{}", "this is JSON"),
            ("", "the trace has no capacity"),
            ("0 0 2\n", "the trace has no capacity"),
        ] {
            let error = load(text).unwrap_err().to_string();
            assert!(error.starts_with(start), "{text}: {error}");
        }
    }
}
