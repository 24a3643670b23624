//! A photograph is what a camera saw, as 8-bit colours with transparency; a loss borrows it.
//!
//! Nothing is prepared per background or per step: 4 bytes per pixel are kept, put over a background row by
//! row while they are compared, and where neither the photograph nor the picture shows anything but the
//! background nothing is compared at all.

mod areas;
mod comparison;
mod source;
mod sweep;

pub use comparison::{PhotographLoss, Weights};
pub use source::Photograph;

#[cfg(test)]
mod tests;
