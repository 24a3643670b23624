//! Trains scenes: fits Gaussians that move to photographs.
//!
//! ```text
//! dataset (photographs, cameras, times) ─▶ Trainer (one view per step) ─▶ Model ─▶ Scene
//!                                             └─▶ Checkpoint                └─▶ evaluate
//! ```
//!
//! Deliberately absent: clocks and files (`dgs train` has them); how far the training has come is an argument
//! of every step.

mod average;
mod checkpoint;
pub mod dataset;
pub mod delivery;
mod density;
pub mod epochs;
mod error;
pub mod evaluation;
mod exposure;
mod finish;
mod freeze;
mod gaussians;
mod model;
pub mod motion;
mod moving_region;
mod options;
mod parameter;
mod photographs;
mod pixel_mask;
mod reduction;
mod rotation;
mod schedule;
mod start;
mod state;
mod step_report;
mod trainer;
mod view_order;
mod views;

pub use checkpoint::{Checkpoint, CheckpointError};
pub use error::TrainError;
pub use evaluation::{
    Clip, DynamicScene, Evaluation, EvaluationError, Perceptual, compare, evaluate, perceptual,
};
pub use finish::{Encoding, Pruning};
pub use model::Model;
pub use options::{DensityControl, Finish, OptionsError, Rates, Schedule, TrainOptions};
pub use pixel_mask::PixelMask;
pub use reduction::Trimmed;
pub(crate) use reduction::trimmed;
pub use step_report::StepReport;
pub use trainer::Trainer;
pub use views::{
    ColouredPoint, Dataset, FreeSpace, PosedPhotograph, Start, Test, Training, Validation, Views, ViewsError,
};

#[cfg(test)]
mod tests;
