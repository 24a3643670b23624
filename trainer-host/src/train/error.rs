//! Defines why a training cannot start or go on.

use render_host::{BackendError, CameraError, SplatsError};

use super::{evaluation::EvaluationError, options::OptionsError};
use crate::{encode::EncodeError, scene::SceneError};

/// Training that cannot start or go on.
#[derive(Debug, thiserror::Error)]
pub enum TrainError {
    /// An option out of range.
    #[error("option {0}")]
    Options(#[from] OptionsError),
    /// No view to train on.
    #[error("{dataset}: the training split is empty; at least one image is needed")]
    Empty {
        /// The dataset.
        dataset: String,
    },
    /// A dataset that no training can finish with.
    #[error("{dataset}: {field} is {found}; {allowed} is allowed")]
    Dataset {
        /// The dataset.
        dataset: String,
        /// Which of its fields.
        field: &'static str,
        /// What it holds.
        found: String,
        /// What it may hold.
        allowed: String,
    },
    /// A view that cannot be rendered or compared.
    #[error("{view}: {source}")]
    View {
        /// The view.
        view: String,
        /// What is wrong.
        source: BackendError,
    },
    /// A graphics device that cannot be used.
    #[error("graphics device: {0}")]
    Device(BackendError),
    /// Gaussians whose arrays do not fit together.
    #[error("{view}: {source}")]
    Splats {
        /// The view.
        view: String,
        /// What is wrong.
        source: SplatsError,
    },
    /// A camera that cannot be made smaller or cut.
    #[error("{view}: {source}")]
    Camera {
        /// The view.
        view: String,
        /// What is wrong.
        source: CameraError,
    },
    /// A trial that cannot be judged.
    #[error("trial: {0}")]
    Trial(#[from] EvaluationError),
    /// A scene that the encoder refuses.
    #[error("encoding for the end of the training: {0}")]
    Encode(EncodeError),
    /// A scene that is none.
    #[error("encoding for the end of the training: {0}")]
    Scene(SceneError),
    /// Training left what numbers can hold, again and again.
    #[error(
        "training diverged at step {step}: {what}; it fell back {rollbacks} times and did so again; a new \
         training with lower rates or more rigidity may not"
    )]
    Diverged {
        /// The step.
        step: u32,
        /// What was found.
        what: String,
        /// How often training had fallen back.
        rollbacks: u32,
    },
    /// A checkpoint that does not belong to this dataset and these options.
    #[error("checkpoint: {0}")]
    Checkpoint(String),
}
