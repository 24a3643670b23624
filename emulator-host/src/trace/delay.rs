//! Reads one-way delay over time: one number in milliseconds per interval (10 ms in the LeoCC recordings).

use std::sync::Arc;

use super::{
    Limits, TraceError, Warning,
    lines::{check_points, check_text, decimal, field, lines},
    steps,
    unit_checks::delay_unit_warning,
};
use crate::clock::Nanos;

/// Longest delay of a trace, ms.
pub(super) const MAX_MS: f64 = 60_000.0;

/// One-way delays that hold from one time to the next, repeating at the end. Not empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DelayTrace {
    delays: Arc<[(Nanos, Nanos)]>,
    period: Nanos,
}

impl DelayTrace {
    /// Loads one decimal number of ms per line, 0 to 60 000, each holding for `interval`.
    ///
    /// # Errors
    /// See [`TraceError`].
    pub fn load(bytes: &[u8], interval: Nanos, limits: &Limits) -> Result<Self, TraceError> {
        check_text(bytes, limits)?;
        if interval < Nanos::from_ms(1) {
            return Err(TraceError::Period { found_ns: interval.0 });
        }
        let mut delays = Vec::new();
        for line in lines(bytes, limits) {
            let (number, text) = line?;
            let Some(ms) = decimal(text).filter(|ms| *ms <= MAX_MS) else {
                return Err(field(number, "delay in ms", text, "a decimal number from 0 to 60000"));
            };
            delays.push((interval.times(delays.len() as u64), Nanos((ms * 1e6).round() as u64)));
            check_points(delays.len(), limits)?;
        }
        let period = interval.times(delays.len() as u64);
        if delays.is_empty() { Err(TraceError::NoCapacity) } else { Ok(Self::of(delays, period)) }
    }

    /// From (time, delay) in order of time, the first at zero, all before `period`.
    pub(super) fn of(delays: Vec<(Nanos, Nanos)>, period: Nanos) -> Self {
        Self { delays: delays.into(), period }
    }

    /// The delay that holds at `now`.
    pub fn at(&self, now: Nanos) -> Nanos {
        steps::at(&self.delays, self.period, now).unwrap_or(Nanos::ZERO)
    }

    /// The median over the points of the trace.
    pub fn median(&self) -> Nanos {
        let mut delays: Vec<Nanos> = self.delays.iter().map(|(_, delay)| *delay).collect();
        delays.sort_unstable();
        delays.get(delays.len() / 2).copied().unwrap_or(Nanos::ZERO)
    }

    /// The least over the points of the trace.
    pub(crate) fn least(&self) -> Nanos {
        self.delays.iter().map(|(_, delay)| *delay).min().unwrap_or(Nanos::ZERO)
    }

    /// What makes its unit doubtful, by the median.
    pub fn unit_warning(&self) -> Option<Warning> {
        delay_unit_warning(self.median())
    }

    /// The whole trace, entered at `offset`.
    #[must_use]
    pub fn starting_at(&self, offset: Nanos) -> Self {
        Self::of(steps::starting_at(&self.delays, self.period, offset), self.period)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn delays_hold_for_their_interval_and_repeat() {
        let trace = DelayTrace::load(b"12\n9.5\n", Nanos::from_ms(10), &Limits::default()).unwrap();
        let at = |ms| trace.at(Nanos::from_ms(ms)).0 / 1000;
        assert_eq!([at(0), at(9), at(10), at(20)], [12_000, 12_000, 9_500, 12_000]);
        assert_eq!(trace.least(), trace.at(Nanos::from_ms(10)));
        assert!(DelayTrace::load(b"1\n-1\n", Nanos::from_ms(10), &Limits::default()).is_err());
    }
}
