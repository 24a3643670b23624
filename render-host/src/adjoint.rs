//! The adjoint differentiates a loss of a picture with respect to everything the picture was made from.
//!
//! ```text
//! Splats + Camera ─▶ render ─▶ Image ─▶ loss ─▶ number
//!                                         │
//! Gradients ◀─ project ◀─ gather ◀─ blend ◀ dLoss/dImage      (harmonics is a part of project)
//! ```
//!
//! One file per stage, the adjoint of the stage of the same name. Blending goes back to front and never
//! divides by `1 - alpha` or a transmittance: a tile is walked again front to back, with the decisions of
//! the forward pass (the same code takes them), alpha and transmittance of every visited row are written
//! down, and read in reverse.
//!
//! Sums have one order: within a tile, rows from the top, lanes in a fixed tree; over tiles, in order of
//! tiles; over Gaussians (camera pose), in order of index by chunks of fixed size. The same input gives
//! the same bits, for any number of threads and any vector width.
//!
//! What is differentiated is the picture between its jumps. At the alpha cut-off, the transmittance stop
//! and a change of depth order the picture jumps, and the jump has no gradient. Where a value is clamped
//! (alpha at `alpha_max`, a colour at 0, the Jacobian's slope, the dimming floor) the gradient is 0.
//!
//! A Gaussian that was skipped has gradient 0. One whose gradient overflows or is not a number gets 0 and is
//! counted in [`Gradients::non_finite`], and so is a value of the picture about which the loss says nothing
//! finite: it counts as 0.

mod blend;
pub mod check;
mod gradients;
mod harmonics;
pub mod loss;
mod project;
mod term;
pub(crate) mod trace;

pub(crate) use blend::{Ellipse, PARTS, Partial, ellipse};
pub use check::{Check, ClassError, check};
pub use gradients::{AdjointError, DensityStatistics, Gradients, Pose, SplatGradient};
pub use loss::Loss;

use crate::{
    Camera, Settings, Splats,
    render::{RenderError, Renderer},
    stage::{self, TILE, bin},
};

/// Buffers to differentiate with: frames of the same size and count allocate nothing large.
#[derive(Debug, Default)]
pub struct Workspace {
    renderer: Renderer,
    /// dLoss/dImage, r g b per pixel.
    image: Vec<f32>,
    tiles: blend::Tiles,
    /// Per Gaussian, summed over tiles.
    ellipses: Vec<blend::Ellipse>,
    chunks: Vec<project::Chunk>,
}

impl Workspace {
    /// A workspace with empty buffers.
    pub fn new() -> Self {
        Self::default()
    }

    /// Of the last call: how the loss changes with a factor at 1 before every alpha of a group, `count`
    /// numbers, where Gaussian `i` is in group `groups[i]`. So `-presence` is what the group adds to
    /// first order, for any loss. Alpha at its clamp counts as 0.
    ///
    /// A poor estimate where a group hides what is behind it (the derivative of an opaque surface is 0):
    /// [`crate::counterfactual::Engine::utilities`] is exact, for squared errors.
    ///
    /// # Errors
    /// Another number of ids than Gaussians of the last call, or an id that is not below `count`.
    pub fn presence(&self, groups: &[u32], count: usize) -> Result<Vec<f64>, AdjointError> {
        let (found, needed) = (groups.len(), self.ellipses.len());
        if found != needed {
            return Err(AdjointError::Ids { found, needed });
        }
        let mut out = vec![0.0; count];
        for (&group, ellipse) in groups.iter().zip(&self.ellipses) {
            let sum = out.get_mut(group as usize).ok_or(AdjointError::Group { group, count })?;
            // dL / d log₂ alpha = ln 2 · alpha · dL / d alpha
            *sum += blend::log2_alpha(ellipse) / std::f64::consts::LN_2;
        }
        Ok(out)
    }
}

/// Renders `splats`, judges the picture with `loss`, and differentiates.
///
/// # Errors
/// A setting out of range, tiles of another side than the usual, or a loss made for another size of picture.
pub fn render_and_gradients(
    workspace: &mut Workspace,
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    loss: &dyn Loss,
) -> Result<Gradients, AdjointError> {
    let mut out = Gradients::default();
    render_and_gradients_into(workspace, splats, camera, settings, loss, &mut out)?;
    Ok(out)
}

/// As [`render_and_gradients`], into memory that is used again.
///
/// # Errors
/// As [`render_and_gradients`]; `out` then holds a mixture of old and new.
pub fn render_and_gradients_into(
    workspace: &mut Workspace,
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    loss: &dyn Loss,
    out: &mut Gradients,
) -> Result<(), AdjointError> {
    differentiate(workspace, splats, camera, settings, loss, out, None)
}

/// As [`render_and_gradients_into`], with statistics of each Gaussian in `statistics`. The gradients are the
/// same bit for bit.
///
/// # Errors
/// As [`render_and_gradients_into`].
pub(crate) fn render_and_gradients_with_statistics(
    workspace: &mut Workspace,
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    loss: &dyn Loss,
    out: &mut Gradients,
    statistics: &mut Vec<DensityStatistics>,
) -> Result<(), AdjointError> {
    statistics.clear();
    statistics.resize(splats.len(), DensityStatistics::default());
    differentiate(workspace, splats, camera, settings, loss, out, Some(statistics.as_mut_slice()))
}

fn differentiate(
    workspace: &mut Workspace,
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    loss: &dyn Loss,
    out: &mut Gradients,
    mut statistics: Option<&mut [DensityStatistics]>,
) -> Result<(), AdjointError> {
    let Workspace { renderer, image, tiles, ellipses, chunks } = workspace;
    settings.validate_for_one_tile_side().map_err(RenderError::from)?;
    renderer.tiles.keeps_marks = true;
    renderer.render_into(splats, camera, settings, &mut out.rendered)?;
    image.resize(out.rendered.image.rgb().len(), 0.0);
    out.loss = loss.differentiate(&out.rendered.image, settings.parallel, image)?;
    let mut non_finite = 0;

    let size = [camera.width() as usize, camera.height() as usize];
    let columns = size[0].div_ceil(TILE);
    let Renderer { projected, order, bands, bins, tiles: cells } = renderer;
    ellipses.clear();
    ellipses.resize(splats.len(), [0.0; blend::PARTS]);
    let mut background = [0.0; 3];
    for band in bands.iter() {
        // The lists and tiles of the last band are still there.
        if bands.len() > 1 {
            bin::bin(projected, order, band, columns, settings, bins);
            stage::blend::blend(&projected.splats, bins, band, size, settings, cells);
        }
        let picture = blend::Picture { size, gradient: image, cells };
        blend::blend(&projected.splats, bins, band, picture, settings, statistics.is_some(), tiles);
        non_finite += blend::gather(tiles, bins, columns, settings.parallel, ellipses, &mut background);
        if let Some(statistics) = &mut statistics {
            blend::gather_statistics(tiles, bins, columns, settings.parallel, statistics);
        }
    }
    project::project(splats, camera, settings, projected, ellipses, chunks, out);
    out.background = background;
    for value in &mut out.background {
        if !value.is_finite() {
            *value = 0.0;
            out.non_finite += 1;
        }
    }
    out.non_finite += non_finite;
    Ok(())
}

/// Takes the gradients of projected ellipses back to Gaussians and to the pose, in `out`.
pub(crate) fn chain(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    projected: &stage::project::Projected,
    ellipses: &[Ellipse],
    out: &mut Gradients,
) {
    project::project(splats, camera, settings, projected, ellipses, &mut Vec::new(), out);
}

#[cfg(test)]
mod tests;
