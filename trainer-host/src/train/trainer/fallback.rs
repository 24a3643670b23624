//! Notices that a training has diverged, and falls back to a state before.

use super::Trainer;
use crate::train::{
    error::TrainError,
    state::{MAX_ROLLBACKS, State},
};

/// Steps between two checks that every number is finite.
const CHECK_EVERY: u32 = 100;
/// Checks between two states to fall back to.
const KEEP_EVERY: u32 = 5;

impl Trainer<'_> {
    /// Notes what the next step is taken at, and from time to time remembers the state to fall back to.
    pub(super) fn keep(&mut self, progress: f64) {
        self.state.progress = progress;
        if self.is_to_keep() {
            self.fallback = self.state.clone();
        }
    }

    /// Whether the state is one to fall back to.
    pub(super) fn is_to_keep(&self) -> bool {
        let step = self.state.step;
        step > self.fallback.step && step.is_multiple_of(CHECK_EVERY * KEEP_EVERY)
    }

    /// From time to time checks that every number is finite.
    pub(super) fn find_divergence(&self) -> Option<String> {
        if self.state.model.gaussians() == 0 {
            return Some("no Gaussian is left".to_owned());
        }
        let is_due = self.state.step.is_multiple_of(CHECK_EVERY);
        (is_due && !self.state.model.is_sound()).then(|| "a parameter is not a number".to_owned())
    }

    /// Falls back to the state before, with half the rates from then on; gives up where that was done often.
    pub(super) fn rollback(&mut self, step: u32, what: &str) -> Result<(), TrainError> {
        let rollbacks = self.state.rollbacks + 1;
        self.state = State { rollbacks: rollbacks.min(MAX_ROLLBACKS), ..self.fallback.clone() };
        self.finisher.take_up(&self.state.finishing, self.state.model.gaussians())?;
        if rollbacks > MAX_ROLLBACKS {
            return Err(TrainError::Diverged { step, what: what.to_owned(), rollbacks: MAX_ROLLBACKS });
        }
        Ok(())
    }
}
