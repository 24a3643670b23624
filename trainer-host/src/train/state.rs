//! Holds all that a training knows between two steps.

use std::borrow::Cow;

use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};
use serde::{Deserialize, Serialize};

use super::{
    average::Average, density::ViewGradients, exposure::Exposures, finish::Finishing, model::Model,
    motion::Neighbourhoods,
};

/// Rollbacks after which a training gives up.
pub(super) const MAX_ROLLBACKS: u32 = 3;
/// Rise of the mean loss that counts as divergence; the loss of pictures without anything in common is about
/// 1.
const MAX_RISE: f64 = 0.3;
/// Most steps of a training.
const MAX_STEPS: u32 = 1 << 30;

/// All that a training knows between two steps.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct State {
    pub(super) model: Model,
    pub(super) exposures: Exposures,
    /// Of the parameters over the last steps, once that is the scene.
    pub(super) average: Option<Average>,
    pub(super) step: u32,
    /// How far the training had come when a step was last taken from here, or is to be taken, 0 to 1.
    pub(super) progress: f64,
    /// Stages of nodes entered.
    pub(super) node_stages: usize,
    /// Times that what hardly moves was stood still.
    pub(super) stands: usize,
    /// Index of the size of photographs.
    pub(super) size: usize,
    /// Views drawn, those passed over included.
    pub(super) drawn: u64,
    pub(super) pull: ViewGradients,
    /// Gaussians that move together, once residuals have a price.
    pub(super) neighbourhoods: Neighbourhoods,
    pub(super) mean_loss: f64,
    /// Smallest running mean at this size of photographs.
    pub(super) lowest_loss: f64,
    pub(super) last_density: u32,
    pub(super) rollbacks: u32,
    pub(super) finishing: Finishing,
}

impl State {
    /// Before the first step.
    pub(super) fn begun(model: Model, exposures: Exposures) -> Self {
        let pull = ViewGradients::none(model.gaussians());
        Self {
            model,
            exposures,
            average: None,
            step: 0,
            progress: 0.0,
            node_stages: 0,
            stands: 0,
            size: 0,
            drawn: 0,
            pull,
            neighbourhoods: Neighbourhoods::default(),
            mean_loss: 0.0,
            lowest_loss: f64::INFINITY,
            last_density: 0,
            rollbacks: 0,
            finishing: Finishing::default(),
        }
    }

    /// The scene: the moving average of the parameters, where there is one.
    pub(super) fn scene(&self) -> Cow<'_, Model> {
        match &self.average {
            Some(average) => Cow::Owned(average.of(&self.model)),
            None => Cow::Borrowed(&self.model),
        }
    }

    /// Random numbers of this step and no other.
    pub(super) fn rng(&self, seed: u64) -> Pcg64Mcg {
        let attempt = u64::from(self.step) | u64::from(self.rollbacks) << 40;
        Pcg64Mcg::seed_from_u64(seed ^ attempt.wrapping_mul(0x9E37_79B9_7F4A_7C15))
    }

    /// From the next step on the loss is another, and its mean begins anew: a rise to it is no divergence.
    pub(super) fn begin_another_loss(&mut self) {
        (self.mean_loss, self.lowest_loss) = (f64::NAN, f64::INFINITY);
    }

    /// What is wrong with the loss of a step, if anything is. Follows its mean.
    pub(super) fn divergence(&mut self, loss: f64) -> Option<String> {
        if !loss.is_finite() {
            return Some("the loss is not a number".to_owned());
        }
        let begins = self.step == 0 || self.mean_loss.is_nan();
        self.mean_loss = if begins { loss } else { 0.99 * self.mean_loss + 0.01 * loss };
        let limit = (10.0 * self.lowest_loss + 0.1).min(self.lowest_loss + MAX_RISE);
        if self.mean_loss > limit {
            return Some(format!("the mean loss rose from {:.4} to {:.4}", self.lowest_loss, self.mean_loss));
        }
        self.lowest_loss = self.lowest_loss.min(self.mean_loss);
        None
    }

    /// Whether what was read from a file can be used: numbers that do not fit together would be out of bounds
    /// somewhere later.
    pub(super) fn is_sound(&self) -> bool {
        let counts = [self.step, self.last_density];
        self.model.is_sound()
            && self.exposures.is_sound()
            && self.average.as_ref().is_none_or(|average| average.fits(&self.model))
            && self.pull.is_sound(self.model.gaussians())
            && self.neighbourhoods.is_sound(self.model.gaussians())
            && counts.iter().all(|&count| count <= MAX_STEPS)
            && self.finishing.is_sound(self.model.gaussians())
            && self.rollbacks <= MAX_ROLLBACKS
            && (0.0..=1.0).contains(&self.progress)
            // The mean loss is none where what is compared has just become another.
            && !self.lowest_loss.is_nan()
    }
}
