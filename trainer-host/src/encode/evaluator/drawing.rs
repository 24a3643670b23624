//! Draws pictures one after another on a backend.

use render_host::{BackendError, Camera, FrameRenderer, Image, Settings, Splats};

/// A renderer, or why there is none.
pub(super) type Drawing = Result<FrameRenderer, BackendError>;

/// The next picture of a renderer; equal to a fresh render, whatever came before.
pub(super) fn next(
    renderer: &mut Drawing,
    splats: &Splats<'_>,
    camera: &Camera,
    settings: &Settings,
) -> Result<Image, BackendError> {
    let renderer = renderer.as_mut().map_err(|error| error.clone())?;
    Ok(renderer.render(splats, camera, settings)?.image.clone())
}

/// As [`next`], with the share of the picture that is covered, 0 to 1.
pub(super) fn with_coverage(
    renderer: &mut Drawing,
    splats: &Splats<'_>,
    camera: &Camera,
    settings: &Settings,
) -> Result<(Image, f64), BackendError> {
    let renderer = renderer.as_mut().map_err(|error| error.clone())?;
    let rendered = renderer.render(splats, camera, settings)?;
    let shown: f64 = rendered.transmittance.iter().map(|&t| f64::from(t)).sum();
    let covered = 1.0 - shown / rendered.transmittance.len().max(1) as f64;
    Ok((rendered.image.clone(), covered.max(0.0)))
}
