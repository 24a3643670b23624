//! Scales scenes down that are so bright that squares of their colours leave f32.
//!
//! The fast modes square in f32. Where a colour is above 2⁴⁰ they are asked about the same scene at a power
//! of two of its brightness as well, and what overflowed is taken from that answer, scaled back in f64: it
//! is a square of about the brightest, which the darker scene holds to the last bit. Any other scene is
//! asked about once.

use super::{engine::Engine, utilities::Utilities};

/// An answer made of squares.
pub(super) trait Squared {
    /// Takes what is not finite from `other`, times `gain`.
    fn mend(&mut self, other: Self, gain: f64);
}

impl Squared for f64 {
    fn mend(&mut self, other: Self, gain: f64) {
        if !self.is_finite() {
            *self = other * gain;
        }
    }
}

impl Squared for Vec<f64> {
    fn mend(&mut self, other: Self, gain: f64) {
        self.iter_mut().zip(other).for_each(|(value, other)| value.mend(other, gain));
    }
}

impl Squared for Utilities {
    fn mend(&mut self, other: Self, gain: f64) {
        self.sse.mend(other.sse, gain);
        self.delta.mend(other.delta, gain);
    }
}

impl Engine {
    /// Asks a fast mode, and the darker scene, if there is one, about what overflows.
    pub(super) fn ask<T: Squared>(&self, mode: impl Fn(&Self) -> T) -> T {
        let mut answer = mode(self);
        if let Some(scaled_down) = &self.scaled_down {
            answer.mend(mode(&scaled_down.engine), scaled_down.gain);
        }
        answer
    }
}
