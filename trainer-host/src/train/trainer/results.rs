//! Says what a training has led to so far.

use std::borrow::Cow;

use super::Trainer;
use crate::{
    encode::Decisions,
    train::{error::TrainError, finish::Pruning, model::Model, options::TrainOptions},
};

impl Trainer<'_> {
    /// The options in force.
    pub fn options(&self) -> &TrainOptions {
        &self.options
    }

    /// The scene as it is now; near the end of a training, the moving average of its parameters.
    pub fn model(&self) -> Cow<'_, Model> {
        self.state.scene()
    }

    /// The scene as a receiver has it, but for what is lost of its motion: the same as
    /// [`Trainer::model`] until values are rounded.
    pub fn shown(&self) -> Model {
        self.finisher.shown(&self.state.scene())
    }

    /// The choices of the encoder that the training has made its own, once values are rounded.
    ///
    /// # Errors
    /// Never for those that it made itself.
    pub fn decisions(&self) -> Result<Option<Decisions>, TrainError> {
        self.state.finishing.decisions()
    }

    /// What was removed, pruning by pruning.
    pub fn prunings(&self) -> &[Pruning] {
        &self.state.finishing.prunings
    }

    /// By place of several photographs, factors of r g b and offsets in display values that turn a picture of
    /// the scene into one that was taken there; none where none are learnt.
    pub fn exposures(&self) -> impl Iterator<Item = [[f32; 3]; 2]> {
        (0..self.state.exposures.len()).map(|index| self.state.exposures.get(index))
    }

    /// The exposure (factors of r g b, offsets in display values) of the place that the training view of
    /// index `view` was taken from; `None` past the last view, or where that place has none.
    pub fn exposure_of(&self, view: usize) -> Option<[[f32; 3]; 2]> {
        let index = self.exposures.get(view).copied().flatten();
        index.map(|index| self.state.exposures.get(index))
    }

    /// Bytes that the canonical values of the stream are estimated to take, once they are rounded.
    pub fn estimated_bytes(&self) -> Option<f64> {
        self.finisher.estimated_bytes(&self.state.scene())
    }

    /// Frames per second that the scene is encoded at.
    pub fn frames_per_second(&self) -> f64 {
        self.finisher.frames_per_second()
    }

    /// Steps taken.
    pub fn steps(&self) -> u32 {
        self.state.step
    }

    /// What the last step was taken at, 0 to 1; after a rollback, what the next step was taken at from the
    /// state that the training fell back to.
    pub fn progress(&self) -> f64 {
        self.state.progress
    }

    /// How many times smaller than the photographs the largest pictures of the training are.
    pub fn reduced(&self) -> u32 {
        self.pyramid.smallest_divisor()
    }
}
