//! Scales scenes down that are so bright that squares of their colours leave f32.
//!
//! The fast modes square in f32. Where a colour is above 2⁴⁰ they are asked about the same scene at a power
//! of two of its brightness as well, and what overflowed is taken from that answer, scaled back in f64: it
//! is a square of about the brightest, which the darker scene holds to the last bit. Any other scene is
//! asked about once.

use super::{engine::Engine, utilities::Utilities};

/// A result of squared errors, which may overflow f32.
pub(super) trait SquaredError {
    /// Takes what is not finite from `other`, times `gain`.
    fn replace_non_finite(&mut self, other: Self, gain: f64);
}

impl SquaredError for f64 {
    fn replace_non_finite(&mut self, other: Self, gain: f64) {
        if !self.is_finite() {
            *self = other * gain;
        }
    }
}

impl SquaredError for Vec<f64> {
    fn replace_non_finite(&mut self, other: Self, gain: f64) {
        self.iter_mut().zip(other).for_each(|(value, other)| value.replace_non_finite(other, gain));
    }
}

impl SquaredError for Utilities {
    fn replace_non_finite(&mut self, other: Self, gain: f64) {
        self.sse.replace_non_finite(other.sse, gain);
        self.delta.replace_non_finite(other.delta, gain);
    }
}

impl Engine {
    /// Runs a fast mode; values that overflow are computed on the scene at a lower brightness.
    pub(super) fn with_overflow_rescue<T: SquaredError>(&self, mode: impl Fn(&Self) -> T) -> T {
        let mut answer = mode(self);
        if let Some(scaled_down) = &self.scaled_down {
            answer.replace_non_finite(mode(&scaled_down.engine), scaled_down.gain);
        }
        answer
    }
}
