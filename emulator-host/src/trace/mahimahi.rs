//! Reads Mahimahi delivery-opportunity traces.

use super::{
    Limits, MAX_PERIOD, Trace, TraceError,
    lines::{check_points, check_text, field, integer, lines},
};
use crate::clock::Nanos;

impl Trace {
    /// Loads a mahimahi delivery-opportunity trace: one time in ms per line, not decreasing; the period is
    /// the last time.
    ///
    /// # Errors
    /// See [`TraceError`].
    pub fn mahimahi(name: &str, bytes: &[u8], limits: &Limits) -> Result<Self, TraceError> {
        load(name, bytes, limits)
    }
}

fn load(name: &str, bytes: &[u8], limits: &Limits) -> Result<Trace, TraceError> {
    check_text(bytes, limits)?;
    let mut at: Vec<Nanos> = Vec::new();
    for line in lines(bytes, limits) {
        let (number, text) = line?;
        let time = integer(text).map(Nanos::from_ms).filter(|time| *time <= MAX_PERIOD);
        let Some(time) = time else {
            return Err(field(number, "time in ms", text, "whole milliseconds up to 7 days"));
        };
        if at.last().is_some_and(|last| *last > time) {
            return Err(field(number, "time in ms", text, "no less than on the line before"));
        }
        at.push(time);
        check_points(at.len(), limits)?;
    }
    let Some(period) = at.last().copied() else { return Err(TraceError::NoCapacity) };
    Trace::opportunities(name, at, period)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::clock::Rate;

    #[test]
    fn a_line_is_an_opportunity_and_the_last_one_is_the_period() {
        let trace = load("t", b"0\n0\r\n\n500\n1000\n", &Limits::default()).unwrap();
        assert_eq!(trace.period(), Nanos::from_s(1));
        assert_eq!(trace.mean_rate(), Rate(48_000));
    }

    #[test]
    fn errors_name_line_field_found_and_allowed() {
        let error = load("t", b"0\n7\n-3\n", &Limits::default()).unwrap_err();
        assert_eq!(
            error.to_string(),
            "line 3, time in ms: found \"-3\", allowed whole milliseconds up to 7 days"
        );
        let error = load("t", b"5\n4\n", &Limits::default()).unwrap_err();
        assert!(error.to_string().starts_with("line 2, time in ms: found \"4\""));
        assert_eq!(load("t", b"\n", &Limits::default()).unwrap_err(), TraceError::NoCapacity);
        assert_eq!(load("t", b"0\n", &Limits::default()).unwrap_err(), TraceError::Period { found_ns: 0 });
        let few = Limits { points: 1, ..Limits::default() };
        assert!(matches!(load("t", b"1\n2\n", &few), Err(TraceError::TooLarge { .. })));
    }
}
