//! Holds the gradients of many worlds together.

use crate::adjoint::{Pose, SplatGradient};

/// What all worlds together say about each parameter.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct WorldGradients {
    /// Mean squared error of each world, data range 1.
    pub losses: Vec<f64>,
    /// Their weighted sum; all gradients are of this.
    pub loss: f64,
    /// One per Gaussian of the variants.
    pub splats: Vec<SplatGradient>,
    /// Higher harmonic bands, laid out as in [`crate::Splats`]; 0 above the degree that was rendered.
    pub sh_rest: Vec<f32>,
    /// The settings' background.
    pub background: [f64; 3],
    /// Camera pose.
    pub pose: Pose,
    /// Gaussians whose gradient was not finite in f32, and was set to 0.
    pub non_finite: u64,
}
