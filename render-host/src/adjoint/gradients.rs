//! Gradients of a loss, as a caller gets them, and why there may be none.

use crate::{
    ImageError,
    render::{RenderError, Rendered},
};

/// Gradients that could not be computed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum AdjointError {
    /// The picture could not be rendered.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The loss does not fit the picture.
    #[error("loss: {0}")]
    Loss(#[from] ImageError),
    /// Another number of group ids than of Gaussians.
    #[error("groups: found {found} ids for {needed} Gaussians")]
    Ids {
        /// Ids found.
        found: usize,
        /// Gaussians of the last picture, hence ids needed.
        needed: usize,
    },
    /// A group id out of range.
    #[error("group {group}; ids below {count} are allowed")]
    Group {
        /// The id.
        group: u32,
        /// Number of groups.
        count: usize,
    },
}

/// What a Gaussian's parameters add to the loss, per unit of each.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct SplatGradient {
    /// Centre, per scene unit.
    pub position: [f32; 3],
    /// Natural logarithm of each scale.
    pub log_scale: [f32; 3],
    /// Raw quaternion wxyz, as stored: always across it, since its length does not matter.
    pub rotation: [f32; 4],
    /// Logit of opacity, `ln(o / (1 - o))`; 0 at opacity 1 and above.
    pub opacity_logit: f32,
    /// Band 0 of the harmonics.
    pub sh0: [f32; 3],
    /// Centre on the image plane, per pixel; what densification looks at.
    pub image_mean: [f32; 2],
}

/// What density control asks of a Gaussian in one picture: whether it should be split, and whether it shows.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct DensityStatistics {
    /// Sum over pixels of the length of that pixel's gradient of the centre on the image plane, loss per
    /// pixel of way. Pulls in opposite directions do not cancel, as they do in
    /// [`SplatGradient::image_mean`]. Source: AbsGS (Ye et al. 2024).
    pub gradient: f32,
    /// Sum over pixels of blend weights `alpha · T`.
    pub weight: f32,
    /// Pixels in which it was blended.
    pub pixels: u32,
}

/// A loss, the picture it judged, and its gradients.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Gradients {
    /// Value of the loss.
    pub loss: f64,
    /// The picture, as [`crate::Renderer::render`] gives it.
    pub rendered: Rendered,
    /// One per Gaussian.
    pub splats: Vec<SplatGradient>,
    /// Higher harmonic bands, laid out as in [`crate::Splats`]; 0 above the degree that was rendered.
    pub sh_rest: Vec<f32>,
    /// The settings' background.
    pub background: [f64; 3],
    /// Camera pose: see [`Pose`].
    pub pose: Pose,
    /// Gradients that were not finite in f32 and were set to 0: of Gaussians (one each), of values of the
    /// picture (a target that is not a number gives such) and of channels of the background.
    pub non_finite: u64,
}

/// Gradient with respect to the world-to-camera transform `x ↦ R·x + t`.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Pose {
    /// Of `t`, with `R` held; per scene unit.
    pub translation: [f64; 3],
    /// Of `ω` at 0 in `exp([ω]×)·R`, with `t` held; per radian, about camera axes.
    pub rotation: [f64; 3],
}
