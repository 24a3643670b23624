//! Names why a scene cannot be fine-tuned for delivery.

use std::path::PathBuf;

use render_host::{BackendError, CameraError, ImageError, RenderError, SplatsError};

use crate::{encode::EncodeError, scene::SceneError};

/// Why a scene cannot be fine-tuned for delivery.
#[derive(Debug, thiserror::Error)]
pub enum DeliveryError {
    /// A setting out of range.
    #[error("{field} is {found}; {allowed} is allowed")]
    Setting {
        /// Which field of the configuration.
        field: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        allowed: String,
    },
    /// A file that cannot be read or written.
    #[error("{path}: {error}", path = path.display())]
    File {
        /// The file.
        path: PathBuf,
        /// What the system says.
        error: std::io::Error,
    },
    /// A file that holds something else.
    #[error("{path}: {message}", path = path.display())]
    Content {
        /// The file.
        path: PathBuf,
        /// What is wrong: field, found, allowed.
        message: String,
    },
    /// A picture that does not fit its camera or the scene.
    #[error("reference {index}: {field} is {found}; {allowed} is allowed")]
    Reference {
        /// Which reference, from 0.
        index: usize,
        /// Which field.
        field: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        allowed: String,
    },
    /// No picture to learn from, or none to validate on.
    #[error("found {found} reference pictures for {purpose}; at least 1 is needed")]
    NoReference {
        /// References found.
        found: usize,
        /// What for.
        purpose: &'static str,
    },
    /// A checkpoint of another fine-tuning.
    #[error("{what} not as in the checkpoint that is gone on from")]
    Resumed {
        /// What differs, in words, with its verb.
        what: &'static str,
    },
    /// The objective is not a finite number.
    #[error("update {update}: the objective is {found}; lower learning rates may help")]
    Diverged {
        /// Which update, from 0.
        update: usize,
        /// The objective.
        found: f64,
    },
    /// The scene cannot be encoded.
    #[error(transparent)]
    Encode(#[from] EncodeError),
    /// A stream that does not decode.
    #[error(transparent)]
    Decode(#[from] codec_core::Error),
    /// Parameters that make no scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
    /// A camera that cannot be placed.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// Gaussians that cannot be rendered.
    #[error(transparent)]
    Splats(#[from] SplatsError),
    /// A picture that cannot be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// Pictures that cannot be compared.
    #[error(transparent)]
    Image(#[from] ImageError),
    /// Pictures or gradients of a state that a device, the processor or another, cannot make.
    #[error(transparent)]
    Drawing(#[from] BackendError),
    /// Worlds that cannot be rendered together.
    #[error(transparent)]
    Worlds(#[from] render_host::counterfactual::CounterfactualError),
}
