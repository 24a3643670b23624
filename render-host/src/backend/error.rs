//! A backend error says why a backend cannot be had, or what it cannot make.

#[cfg(feature = "gpu")]
use crate::gpu::GpuError;
use crate::{adjoint::AdjointError, counterfactual::CounterfactualError, render::RenderError};

/// Why a backend cannot be had, or cannot make a picture.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum BackendError {
    /// Feature `gpu` is off.
    #[error(
        "this program was built without graphics devices; `cargo build --release --features gpu` adds them"
    )]
    NotBuilt,
    /// The CPU refused.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The CPU refused worlds.
    #[error(transparent)]
    Worlds(#[from] CounterfactualError),
    /// The CPU refused gradients, or the loss does not fit the picture.
    #[error(transparent)]
    Gradients(#[from] AdjointError),
    /// The graphics device refused.
    #[cfg(feature = "gpu")]
    #[error(transparent)]
    Gpu(#[from] GpuError),
}
