//! Describes capacity over time: measured traces and a synthetic one.
//!
//! Loaders take bytes, never panic on any of them, and hold no more than [`Limits`] allow. What looks wrong
//! but is legal comes back as a [`Warning`] on the trace; what is illegal comes back as a [`TraceError`] with
//! line, field, what was found and what is allowed.
//!
//! Rates of 0.2 s or 1 s averages hide the short stalls that delivery-opportunity traces show: do not compare
//! tail latency across families.

mod bursty;
mod delay;
mod lines;
mod mahimahi;
mod replay;
mod steps;
mod two_column;
mod ucc;
mod unit_checks;

use std::{collections::BTreeMap, sync::Arc};

use crate::clock::{Bytes, Nanos, Rate};

pub use delay::DelayTrace;
pub use lines::read;
pub use replay::{LossTrace, Replay};
pub use two_column::HoldDirection;
pub use ucc::Direction;

/// Bytes that one delivery opportunity moves (mahimahi's MTU).
pub(crate) const OPPORTUNITY_BYTES: u32 = 1500;
/// A byte in bits × 10⁻⁹, which a rate in bits/s moves in a time in ns.
const MOVED_PER_BYTE: u128 = 8_000_000_000;
/// Highest rate that a trace may state, bits/s.
pub const MAX_RATE: Rate = Rate(1_000_000_000_000);
/// Longest trace.
pub const MAX_PERIOD: Nanos = Nanos::from_s(7 * 24 * 3600);

/// Bounds on what a loader reads and keeps.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Limits {
    /// Bytes of a file.
    pub file_bytes: u64,
    /// Bytes of a line.
    pub line_bytes: usize,
    /// Points (opportunities, steps, seconds) kept.
    pub points: usize,
}

impl Default for Limits {
    /// 64 MiB, 4 KiB, 4 million points.
    fn default() -> Self {
        Self { file_bytes: 64 << 20, line_bytes: 4096, points: 4_000_000 }
    }
}

/// Something about a trace that whoever uses it should know.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Warning {
    /// Near-zero seconds next to a ping, an artefact of the logger, were treated as missing and interpolated.
    PingDipsRepaired {
        /// Seconds repaired.
        seconds: u32,
    },
    /// Many rows say that the phone was idle: the rate is what the application asked for and no capacity.
    ApplicationLimited {
        /// Share of rows with State = I, 0..=1.
        idle: f64,
    },
    /// The rate stays at zero for long: an outage, a coverage hole, or an application that paused.
    LongZeroRun {
        /// Longest run.
        seconds: u32,
    },
    /// Rows are so far apart that their times may be milliseconds.
    LikelyMilliseconds {
        /// Typical time from one row to the next, read as seconds.
        seconds: u32,
    },
    /// The rate is so high that it may be in kbit/s.
    LikelyKilobits {
        /// Typical rate, read as Mbit/s.
        mbps: u32,
    },
    /// The one-way delay is so short that it may be in seconds.
    LikelySeconds {
        /// Typical delay, read as milliseconds.
        ms: f64,
    },
    /// A long hole in the log was filled by holding the last rate.
    LongGap {
        /// Longest hole.
        seconds: u32,
    },
}

impl std::fmt::Display for Warning {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        match self {
            Self::PingDipsRepaired { seconds } => write!(
                f,
                "{seconds} near-zero seconds beside a ping are an artefact of the logger and were \
                 interpolated"
            ),
            Self::ApplicationLimited { idle } => write!(
                f,
                "{:.0} % of the rows say the phone was idle: this is what an application asked for, not \
                 capacity",
                100.0 * idle
            ),
            Self::LongZeroRun { seconds } => write!(f, "the rate stays at zero for {seconds} s"),
            Self::LikelyMilliseconds { seconds } => write!(
                f,
                "rows are {seconds} s apart: the first column is read as seconds and looks like milliseconds"
            ),
            Self::LikelyKilobits { mbps } => write!(
                f,
                "the rate is {mbps} Mbit/s: the second column is read as Mbit/s and looks like kbit/s"
            ),
            Self::LikelySeconds { ms } => {
                write!(f, "the delay is {ms:.3} ms: it is read as milliseconds and looks like seconds")
            }
            Self::LongGap { seconds } => write!(f, "a hole of {seconds} s was filled with the last rate"),
        }
    }
}

/// Why a trace was refused.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
pub enum TraceError {
    /// One field is illegal.
    #[error("line {line}, {field}: found {found:?}, allowed {allowed}")]
    Field {
        /// Line, from 1.
        line: u32,
        /// Field.
        field: &'static str,
        /// What is there, cut to 40 characters.
        found: String,
        /// What may be there.
        allowed: &'static str,
    },
    /// More than the limits allow.
    #[error("{what}: found {found}, allowed up to {allowed}")]
    TooLarge {
        /// What there is too much of.
        what: &'static str,
        /// How much there is, at least.
        found: u64,
        /// How much may be.
        allowed: u64,
    },
    /// JSON, as Pantheon logs it.
    #[error(
        "this is JSON, and no trace: allowed are mahimahi (a time in ms per line; Pantheon's traces are of \
         this kind), two columns (s, Mbit/s), three or four (s, Mbit/s, one-way delay in ms, loss in %) and \
         UCC CSV"
    )]
    Json,
    /// A file packed by gzip.
    #[error("gzip: unpack it first")]
    Gzip,
    /// Nothing is ever delivered.
    #[error("the trace has no capacity")]
    NoCapacity,
    /// The period is not positive, too long, or does not contain all points.
    #[error("period {found_ns} ns: allowed are 1 ms to 7 days, not before the last point")]
    Period {
        /// The period found.
        found_ns: u64,
    },
    /// The file cannot be read.
    #[error("cannot read the file: {reason}")]
    Unreadable {
        /// The system's words.
        reason: String,
    },
}

/// From `at` on, capacity is `rate`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Step {
    /// Time since the start of the trace.
    pub at: Nanos,
    /// Capacity.
    pub rate: Rate,
}

/// The two ways to write capacity down.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Instants at which 1500 bytes may move, not decreasing.
    Opportunities(Arc<[Nanos]>),
    /// Rates; the first step is at zero, times increase.
    Steps(Arc<[Step]>),
}

/// A capacity trace that repeats with its period. It has some capacity, its points are ordered and inside the
/// period.
///
/// # Examples
/// ```
/// use emulator_host::{
///     Rate, Trace,
///     trace::{HoldDirection, Limits},
/// };
///
/// // Time in seconds, rate in Mbit/s.
/// let trace = Trace::two_column("phone", b"0 2\n1 4\n", HoldDirection::Forward, &Limits::default())?;
/// assert_eq!(trace.mean_rate(), Rate::from_mbps(3));
/// # Ok::<(), emulator_host::trace::TraceError>(())
/// ```
#[derive(Clone, Debug)]
pub struct Trace {
    name: String,
    shape: Shape,
    period: Nanos,
    warnings: Vec<Warning>,
    base_rtt: Option<Nanos>,
}

impl Trace {
    /// A trace from delivery opportunities; see [`Shape::Opportunities`].
    ///
    /// # Errors
    /// [`TraceError::Period`] or [`TraceError::NoCapacity`].
    pub fn opportunities(name: &str, mut at: Vec<Nanos>, period: Nanos) -> Result<Self, TraceError> {
        at.sort_unstable();
        check_period(period, at.last().copied())?;
        if at.is_empty() {
            return Err(TraceError::NoCapacity);
        }
        Ok(Self::raw(name, Shape::Opportunities(at.into()), period))
    }

    /// A trace from steps in time order, rebased so that the first is at zero; equal times keep the last.
    ///
    /// # Errors
    /// [`TraceError::Period`] or [`TraceError::NoCapacity`].
    pub fn steps(name: &str, mut steps: Vec<Step>, period: Nanos) -> Result<Self, TraceError> {
        steps.sort_by_key(|step| step.at);
        steps.reverse();
        steps.dedup_by_key(|step| step.at);
        steps.reverse();
        let first = steps.first().map_or(Nanos::ZERO, |step| step.at);
        for step in &mut steps {
            step.at = step.at - first;
            step.rate = step.rate.min(MAX_RATE);
        }
        check_period(period, steps.last().map(|step| step.at + Nanos(1)))?;
        if steps.iter().all(|step| step.rate.0 == 0) {
            return Err(TraceError::NoCapacity);
        }
        Ok(Self::raw(name, Shape::Steps(steps.into()), period))
    }

    fn raw(name: &str, shape: Shape, period: Nanos) -> Self {
        Self { name: name.to_owned(), shape, period, warnings: Vec::new(), base_rtt: None }
    }

    /// Name, as the caller gave it.
    pub fn name(&self) -> &str {
        &self.name
    }

    /// The points.
    pub fn shape(&self) -> &Shape {
        &self.shape
    }

    /// After this long the trace starts again.
    pub fn period(&self) -> Nanos {
        self.period
    }

    /// What whoever uses it should know.
    pub fn warnings(&self) -> &[Warning] {
        &self.warnings
    }

    /// Round trip of an unloaded path, where the log holds pings (their median).
    pub fn base_rtt(&self) -> Option<Nanos> {
        self.base_rtt
    }

    /// Mean capacity over a period.
    pub fn mean_rate(&self) -> Rate {
        Rate(u64::try_from(self.moved_within(self.period) / u128::from(self.period.0)).unwrap_or(u64::MAX))
    }

    /// Whole bytes that may move from the start until `time`, the trace repeating. Rounded down once, however
    /// many steps there are; saturates.
    pub fn bytes_until(&self, time: Nanos) -> Bytes {
        let (rounds, rest) = (time.0 / self.period.0, Nanos(time.0 % self.period.0));
        let whole = self.moved_within(self.period).saturating_mul(u128::from(rounds));
        let moved = whole.saturating_add(self.moved_within(rest)) / MOVED_PER_BYTE;
        Bytes(u64::try_from(moved).unwrap_or(u64::MAX))
    }

    /// What may move until `end`, which is not past the period, in bits × 10⁻⁹.
    fn moved_within(&self, end: Nanos) -> u128 {
        match &self.shape {
            Shape::Opportunities(at) => {
                let count = at.partition_point(|at| *at <= end) as u128;
                count * u128::from(OPPORTUNITY_BYTES) * MOVED_PER_BYTE
            }
            Shape::Steps(steps) => {
                let ends = steps.iter().skip(1).map(|step| step.at).chain([self.period]);
                let used = steps.iter().zip(ends).take_while(|(step, _)| step.at < end);
                used.map(|(s, until)| u128::from(s.rate.0) * u128::from((until.min(end) - s.at).0)).sum()
            }
        }
    }

    /// The same trace with `numerator ÷ denominator` times the capacity: rates are multiplied, opportunities
    /// become rates over 20 ms.
    ///
    /// # Errors
    /// [`TraceError::NoCapacity`] if nothing is left.
    pub fn scaled(&self, numerator: u64, denominator: u64) -> Result<Self, TraceError> {
        const BIN: Nanos = Nanos::from_ms(20);
        let steps: Vec<Step> = match &self.shape {
            Shape::Steps(steps) => steps.to_vec(),
            Shape::Opportunities(times) => self.binned(times, BIN),
        };
        let steps =
            steps.into_iter().map(|step| Step { rate: step.rate.scaled(numerator, denominator), ..step });
        let mut scaled = Self::steps(&self.name, steps.collect(), self.period)?;
        scaled.warnings.clone_from(&self.warnings);
        scaled.base_rtt = self.base_rtt;
        Ok(scaled)
    }

    /// The rates of opportunities over bins of `width`; of a run of bins without any there is one step.
    fn binned(&self, times: &[Nanos], width: Nanos) -> Vec<Step> {
        // A bin has what comes after its start up to its end; what is at zero is at the end of the period.
        let mut bins: BTreeMap<u64, u64> = BTreeMap::new();
        for time in times {
            let time = if time.0 == 0 { self.period } else { *time };
            *bins.entry((time.0 - 1) / width.0).or_default() += u64::from(OPPORTUNITY_BYTES);
        }
        let mut steps = vec![Step { at: Nanos::ZERO, rate: Rate(0) }];
        for (bin, bytes) in bins {
            let at = width.times(bin);
            let end = (at + width).min(self.period);
            // Of two steps at one time the later one holds.
            steps.push(Step { at, rate: Rate::over(Bytes(bytes), end - at) });
            if end < self.period {
                steps.push(Step { at: end, rate: Rate(0) });
            }
        }
        steps
    }

    /// The part of `length` from `offset` on, going round at the end, as a trace with period `length`.
    ///
    /// # Errors
    /// [`TraceError::Period`] if `length` is out of range, [`TraceError::NoCapacity`] if the part has none,
    /// or [`TraceError::TooLarge`] if going round multiplies the points beyond 16 million.
    pub fn window(&self, offset: Nanos, length: Nanos) -> Result<Self, TraceError> {
        check_period(length, None)?;
        let rounds = length.0 / self.period.0 + 2;
        let points = match &self.shape {
            Shape::Opportunities(at) => at.len(),
            Shape::Steps(steps) => steps.len(),
        };
        let found = rounds.saturating_mul(points as u64);
        if found > 16_000_000 {
            return Err(TraceError::TooLarge { what: "points of the window", found, allowed: 16_000_000 });
        }
        let offset = Nanos(offset.0 % self.period.0);
        let end = offset + length;
        let starts = (0..rounds).map(|round| self.period.times(round));
        let mut cut = match &self.shape {
            Shape::Opportunities(at) => {
                let all = starts.flat_map(|start| at.iter().map(move |at| start + *at));
                let inside = all.filter(|at| *at >= offset && *at < end).map(|at| at - offset).collect();
                Self::opportunities(&self.name, inside, length)?
            }
            Shape::Steps(steps) => {
                let all = starts.flat_map(|start| {
                    steps.iter().map(move |step| Step { at: start + step.at, rate: step.rate })
                });
                let mut inside: Vec<Step> = Vec::new();
                for step in all.take_while(|step| step.at < end) {
                    let at = if step.at <= offset { Nanos::ZERO } else { step.at - offset };
                    if at == Nanos::ZERO {
                        inside.clear();
                    }
                    inside.push(Step { at, rate: step.rate });
                }
                Self::steps(&self.name, inside, length)?
            }
        };
        cut.warnings.clone_from(&self.warnings);
        cut.base_rtt = self.base_rtt;
        Ok(cut)
    }

    /// The whole trace, entered at `offset`.
    ///
    /// # Errors
    /// As [`Self::window`].
    pub fn starting_at(&self, offset: Nanos) -> Result<Self, TraceError> {
        self.window(offset, self.period)
    }
}

fn check_period(period: Nanos, last: Option<Nanos>) -> Result<(), TraceError> {
    let legal = period >= Nanos::from_ms(1) && period <= MAX_PERIOD && last.is_none_or(|last| last <= period);
    if legal { Ok(()) } else { Err(TraceError::Period { found_ns: period.0 }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn two_steps() -> Trace {
        let steps = vec![
            Step { at: Nanos::ZERO, rate: Rate::from_mbps(2) },
            Step { at: Nanos::from_s(1), rate: Rate::from_mbps(4) },
        ];
        Trace::steps("t", steps, Nanos::from_s(2)).unwrap()
    }

    #[test]
    fn windows_go_round_the_end() {
        let window = two_steps().window(Nanos::from_ms(1500), Nanos::from_s(2)).unwrap();
        let Shape::Steps(steps) = window.shape() else { panic!("steps stay steps") };
        let seen: Vec<(u64, u64)> =
            steps.iter().map(|s| (s.at.0 / 1_000_000, s.rate.0 / 1_000_000)).collect();
        assert_eq!(seen, [(0, 4), (500, 2), (1500, 4)]);
        assert_eq!(window.mean_rate(), Rate::from_mbps(3));

        let at = [0, 10, 20].map(Nanos::from_ms).to_vec();
        let trace = Trace::opportunities("o", at, Nanos::from_ms(20)).unwrap();
        let window = trace.window(Nanos::from_ms(10), Nanos::from_ms(20)).unwrap();
        assert_eq!(window.shape(), &Shape::Opportunities([0, 10, 10].map(Nanos::from_ms).to_vec().into()));
    }

    #[test]
    fn bytes_until_the_end_of_time_saturate() {
        let fast = vec![Step { at: Nanos::ZERO, rate: Rate::from_mbps(1_000_000) }];
        let fast = Trace::steps("t", fast, Nanos::from_s(1)).unwrap();
        assert_eq!(fast.bytes_until(Nanos::MAX), Bytes(u64::MAX));
        assert_eq!(fast.bytes_until(Nanos::from_s(3)), Bytes(375_000_000_000));
    }

    /// 20,000 steps of 1 ms, in each of which less than two bytes move.
    #[test]
    fn fine_steps_move_what_one_coarse_step_does() {
        let rate = Rate(15_900);
        let fine = (0..20_000).map(|at| Step { at: Nanos::from_ms(at), rate }).collect();
        let fine = Trace::steps("t", fine, Nanos::from_s(20)).unwrap();
        let coarse = Trace::steps("t", vec![Step { at: Nanos::ZERO, rate }], Nanos::from_s(20)).unwrap();
        for time in [Nanos(0), Nanos(1_234_567), Nanos::from_s(7), Nanos::from_s(20), Nanos::from_s(1_000)] {
            assert_eq!(fine.bytes_until(time), rate.bytes_in(time), "{time}");
            assert_eq!(coarse.bytes_until(time), rate.bytes_in(time), "{time}");
        }
        assert_eq!((fine.mean_rate(), coarse.mean_rate()), (rate, rate));
    }

    #[test]
    fn a_trace_without_capacity_or_with_a_bad_period_is_refused() {
        let silent = vec![Step { at: Nanos::ZERO, rate: Rate(0) }];
        assert_eq!(Trace::steps("t", silent, Nanos::from_s(1)).unwrap_err(), TraceError::NoCapacity);
        assert_eq!(
            two_steps().window(Nanos::ZERO, Nanos(5)).unwrap_err(),
            TraceError::Period { found_ns: 5 }
        );
    }
}
