//! Finishing makes a trained scene small: Gaussians that pictures hardly need go, and the rest learns to be
//! rounded.
//!
//! ```text
//! training ─▶ prune ─▶ recover ─▶ prune ─▶ recover ─▶ encode once ─▶ train as rounded, values at a price
//!             [`importance`]                          decisions      [`coding`]           [`price`]
//! ```
//!
//! From the first encoding on its choices (clusters, orders, steps, degrees) stay; the last one writes by
//! them.

mod coding;
mod importance;
mod price;

use render_host::Differentiator;
use serde::{Deserialize, Serialize};

use self::coding::Coding;
pub(super) use self::importance::Pictures;
use super::{
    error::TrainError,
    gaussians::TrainedGaussians,
    model::Model,
    options::{Finish, TrainOptions},
};
use crate::{
    encode::{self, Decisions, EncodeError, EncodeOptions, Target},
    scene::{SceneError, Up},
};

/// Values are priced in one step out of so many, and their slopes count so many times.
const PRICE_EVERY: u32 = 8;
/// Size of the first encoding, relative to the target, with motion and without: the rate term takes off what
/// is above, and with motion so do its steps.
const ROOM: (f64, f64) = (1.1, 0.99);

/// How the scene will be encoded.
#[derive(Clone, Debug, PartialEq)]
pub struct Encoding {
    /// Options of the encoder; steps and target are the training's.
    pub options: EncodeOptions,
    /// Frames of the clip.
    pub frames: usize,
    /// Frames per second.
    pub frames_per_second: f64,
    /// Which way is up: the encoder may choose by pictures from cameras that stand upright.
    pub up: Up,
}

/// What finishing adds to the state of a training.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct Finishing {
    pub(super) prunings: Vec<Pruning>,
    /// Choices of the encoder that the rest of the training keeps, as JSON: their own form is not one that
    /// checkpoints hold.
    decisions: Option<String>,
}

/// A pruning of a training.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct Pruning {
    /// Gaussians before.
    pub before: usize,
    /// Gaussians after.
    pub after: usize,
    /// Share of what all of them add to pictures (sum of squared errors without each) that went.
    pub error_share: f64,
}

impl Finishing {
    /// Whether what was read from a file can be used.
    pub(super) fn is_sound(&self, gaussians: usize) -> bool {
        let fits = |p: &Pruning| p.after <= p.before && p.after >= gaussians && p.error_share.is_finite();
        self.prunings.iter().all(fits)
    }

    /// The choices of the encoder that hold.
    ///
    /// # Errors
    /// Choices that are none.
    pub(super) fn decisions(&self) -> Result<Option<Decisions>, TrainError> {
        let failed = |error: serde_json::Error| TrainError::Checkpoint(error.to_string());
        self.decisions.as_deref().map(|text| serde_json::from_str(text).map_err(failed)).transpose()
    }

    /// Whether rounding has begun.
    pub(super) fn has_rounded(&self) -> bool {
        self.decisions.is_some()
    }

    /// Whether rounding is to begin.
    pub(super) fn rounding_due(&self, finish: &Finish, progress: f64) -> bool {
        !self.has_rounded() && finish.round_from < 1.0 && progress >= finish.round_from
    }

    /// Indices of the Gaussians that stay, if a pruning is due.
    ///
    /// # Errors
    /// A view that cannot be rendered.
    pub(super) fn pruned(
        &mut self,
        options: &TrainOptions,
        progress: f64,
        model: &Model,
        pictures: Pictures<'_>,
        differentiator: &mut Differentiator,
    ) -> Result<Option<Vec<usize>>, TrainError> {
        let finish = &options.finish;
        let due = |at: &f64| *at < 1.0 && progress >= *at;
        let is_due = finish.prune > 0.0 && finish.prune_at.get(self.prunings.len()).is_some_and(due);
        if self.decisions.is_some() || !is_due {
            return Ok(None);
        }
        let errors = importance::removal_errors(model, pictures, differentiator)?;
        let needed = importance::most_needed(&errors, finish.prune);
        let of_needed: f64 = needed.iter().map(|&index| errors[index]).sum();
        let all = errors.iter().sum::<f64>().max(f64::MIN_POSITIVE);
        let error_share = 1.0 - of_needed / all;
        self.prunings.push(Pruning { before: errors.len(), after: needed.len(), error_share });
        Ok(Some(needed))
    }
}

/// Finishes a training.
#[derive(Debug)]
pub(super) struct Finisher {
    encoding: Encoding,
    coding: Option<Coding>,
    /// The Gaussians as they are rounded; memory that steps use again.
    rounded: TrainedGaussians,
}

impl Finisher {
    pub(super) fn new(encoding: Encoding, gaussians: &TrainedGaussians) -> Self {
        Self { encoding, coding: None, rounded: gaussians.clone() }
    }

    pub(super) fn frames_per_second(&self) -> f64 {
        self.encoding.frames_per_second
    }

    pub(super) fn set_encoding(&mut self, encoding: Encoding) {
        self.encoding = encoding;
    }

    /// Takes up what `state` says of a scene of `gaussians` Gaussians.
    ///
    /// # Errors
    /// Choices that are none.
    pub(super) fn take_up(&mut self, state: &Finishing, gaussians: usize) -> Result<(), TrainError> {
        self.coding = match state.decisions()? {
            Some(decisions) => Coding::of(&decisions, gaussians).map_err(TrainError::Encode)?,
            None => None,
        };
        Ok(())
    }

    /// Chooses how `model` is encoded: from now on it is rounded so.
    ///
    /// # Errors
    /// A scene that the encoder refuses, or a size that it cannot have.
    pub(super) fn encode_first(
        &mut self,
        finish: &Finish,
        model: &Model,
        state: &mut Finishing,
    ) -> Result<(), TrainError> {
        let Encoding { options, frames, frames_per_second, up } = &self.encoding;
        let refused = |error: SceneError| TrainError::Scene(error);
        let mut scene = model.scene(*frames, *frames_per_second).map_err(refused)?;
        scene.up = *up;
        let mut options = options.clone();
        options.quality = options.quality.scaled(finish.coarseness);
        // Steps of motion are relative to the others.
        options.quality.motion *= finish.motion / finish.coarseness;
        let still = scene.epochs().iter().all(|epoch| epoch.attributes().is_constant());
        let room = if still { ROOM.1 } else { ROOM.0 };
        options.target = (finish.target_bytes > 0)
            .then(|| Target::Bytes(((finish.target_bytes as f64 * room) as u64).max(1)));
        let plain = EncodeOptions { target: None, ..options.clone() };
        let encoded = match encode::encode(&scene, &options, &crate::encode::no_progress) {
            // Whether the size can be met is decided where the scene is encoded at last.
            Err(EncodeError::Unreachable { .. }) => {
                encode::encode(&scene, &plain, &crate::encode::no_progress)
            }
            encoded => encoded,
        };
        let encoded = encoded.map_err(TrainError::Encode)?;
        let text = serde_json::to_string(&encoded.decisions);
        state.decisions = Some(text.map_err(|error| TrainError::Checkpoint(error.to_string()))?);
        self.take_up(state, model.gaussians())
    }

    /// The Gaussians of `model` as they are rounded, once they are.
    pub(super) fn rounded(&mut self, model: &Model) -> Option<&TrainedGaussians> {
        self.coding.as_ref()?.round(model, &mut self.rounded);
        Some(&self.rounded)
    }

    /// The Gaussians that [`Finisher::rounded`] gave last, if they are of as many as `count`.
    pub(super) fn last_rounded(&self, count: usize) -> Option<&TrainedGaussians> {
        self.coding.as_ref().map(|_| &self.rounded).filter(|rounded| rounded.len() == count)
    }

    /// `model` with its Gaussians as they are rounded, once they are.
    pub(super) fn shown(&self, model: &Model) -> Model {
        let mut shown = model.clone();
        if let Some(coding) = &self.coding {
            coding.round(model, &mut shown.gaussians);
        }
        shown
    }

    /// Adds the slopes of what values cost to the gradients of `model`, if it is time.
    pub(super) fn price(&self, finish: &Finish, step: u32, model: &mut Model) {
        let Some(coding) = self.coding.as_ref().filter(|_| step.is_multiple_of(PRICE_EVERY)) else { return };
        if finish.rate_weight > 0.0 {
            let unit = 1000.0 * model.gaussians().max(1) as f32;
            coding.add_slopes(model, PRICE_EVERY as f32 * finish.rate_weight / unit);
        }
    }

    /// Bytes that the canonical values of `model` are estimated to take, once they are rounded.
    pub(super) fn estimated_bytes(&self, model: &Model) -> Option<f64> {
        let bits: f64 = self.coding.as_ref()?.bits(model).iter().sum();
        Some(bits / 8.0)
    }
}
