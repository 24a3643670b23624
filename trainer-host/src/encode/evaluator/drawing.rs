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
