//! Reads one-way delay over time: one number in milliseconds per interval (10 ms in the LeoCC recordings).

use std::sync::Arc;

use super::{
    Limits, TraceError,
    lines::{check_points, check_text, decimal, field, lines},
};
use crate::clock::Nanos;

/// One-way delays, one per interval, repeating at the end. Not empty.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct DelayTrace {
    delays: Arc<[Nanos]>,
    interval: Nanos,
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
            let Some(ms) = decimal(text).filter(|ms| *ms <= 60_000.0) else {
                return Err(field(number, "delay in ms", text, "a decimal number from 0 to 60000"));
            };
            delays.push(Nanos((ms * 1e6).round() as u64));
            check_points(delays.len(), limits)?;
        }
        if delays.is_empty() {
            return Err(TraceError::NoCapacity);
        }
        Ok(Self { delays: delays.into(), interval })
    }

    /// The delay that holds at `now`.
    pub fn at(&self, now: Nanos) -> Nanos {
        let slot = now.0 / self.interval.0 % self.delays.len() as u64;
        self.delays[slot as usize]
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
        assert!(DelayTrace::load(b"1\n-1\n", Nanos::from_ms(10), &Limits::default()).is_err());
    }
}
