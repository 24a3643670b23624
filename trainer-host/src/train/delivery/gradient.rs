//! Holds the gradient of the objective: by parameters, and by quantiser steps.

use super::{parameters::COMPONENTS, steps::PerClass};

/// Slopes of the objective.
#[derive(Clone, Debug, PartialEq)]
pub(super) struct Gradient {
    /// Per Gaussian and proxy, by its parameters.
    pub parameters: Vec<[f64; COMPONENTS]>,
    /// Per row of quantisers, by the logarithm of each learned step.
    pub steps: Vec<PerClass>,
}

impl Gradient {
    /// Zeros for `count` Gaussians and proxies and `rows` rows of quantisers.
    pub(super) fn zeros(count: usize, rows: usize) -> Self {
        Self { parameters: vec![[0.0; COMPONENTS]; count], steps: vec![PerClass::default(); rows] }
    }

    /// Adds `other`, entry by entry.
    pub(super) fn add(&mut self, other: &Self) {
        let add = |sum: &mut f64, value: &f64| *sum += value;
        let parameters = self.parameters.as_flattened_mut().iter_mut();
        parameters.zip(other.parameters.as_flattened()).for_each(|(sum, value)| add(sum, value));
        let steps = self.steps.as_flattened_mut().iter_mut();
        steps.zip(other.steps.as_flattened()).for_each(|(sum, value)| add(sum, value));
    }

    /// Multiplies every entry by `factor`.
    pub(super) fn scale(&mut self, factor: f64) {
        self.parameters.as_flattened_mut().iter_mut().for_each(|value| *value *= factor);
        self.steps.as_flattened_mut().iter_mut().for_each(|value| *value *= factor);
    }
}
