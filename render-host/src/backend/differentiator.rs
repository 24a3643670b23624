//! A differentiator renders a picture on one backend and takes a loss of it back to all it was made from.

use super::error::BackendError;
use crate::{
    Camera, Gradients, Loss, Settings, Splats, Workspace,
    adjoint::{DensityStatistics, render_and_gradients_into, render_and_gradients_with_statistics},
};
#[cfg(feature = "gpu")]
use crate::{
    adjoint::AdjointError,
    gpu::{self, Executor},
};

/// Renders pictures, evaluates losses and differentiates them; keeps its buffers between pictures.
///
/// What it finds does not depend on the pictures before, and on one device the same input gives the same
/// bits. Gradients and statistics of the two kinds of backend agree to 1e-4 (relative L2 distance per field),
/// except where a rounding decides on which side of a cut-off a splat falls; see `tests/backend.rs`.
///
/// A loss is always evaluated on the processor: with a graphics device, each picture is read back (16 bytes
/// per pixel) and its gradient sent (12 bytes per pixel).
///
/// ```
/// use render_host::{
///     Camera, Differentiator, Gaussian, Gradients, Image, Settings, Splats, adjoint::loss::Mse,
/// };
///
/// let scene = [Gaussian { scale: [0.3; 3], opacity: 0.9, sh0: [1.0; 3], ..Gaussian::ABSENT }];
/// let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 64, 48)?;
/// let loss = Mse::new(Image::filled(64, 48, [0.0; 3])?);
/// let mut cpu = Differentiator::default();
/// let (mut found, mut statistics) = (Gradients::default(), Vec::new());
/// let settings = Settings::default();
/// cpu.differentiate(&Splats::plain(&scene), &camera, &settings, &loss, &mut found, Some(&mut statistics))?;
/// assert!(found.splats[0].sh0[0] > 0.0 && statistics[0].pixels > 100);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Debug, Default)]
pub struct Differentiator(Inner);

#[derive(Debug)]
enum Inner {
    Cpu(Box<Workspace>),
    #[cfg(feature = "gpu")]
    Gpu(Box<OnGpu>),
}

impl Default for Inner {
    fn default() -> Self {
        Self::Cpu(Box::default())
    }
}

#[cfg(feature = "gpu")]
#[derive(Debug)]
struct OnGpu {
    device: gpu::adjoint::Differentiator,
    /// dLoss/dImage, r g b per pixel.
    image: Vec<f32>,
}

impl Differentiator {
    #[cfg(feature = "gpu")]
    pub(super) fn on_gpu(executor: &Executor) -> Result<Self, BackendError> {
        let device = gpu::adjoint::Differentiator::new(executor)?;
        Ok(Self(Inner::Gpu(Box::new(OnGpu { device, image: Vec::new() }))))
    }

    /// Renders `splats` as `camera` sees them, evaluates `loss`, and differentiates into `out`; if asked for,
    /// with the statistics of each Gaussian.
    ///
    /// # Errors
    /// A setting out of range or one that the backend does not have, a loss made for another size of picture,
    /// or no memory on the device; `out` then holds a mixture of old and new.
    pub fn differentiate(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
        loss: &dyn Loss,
        out: &mut Gradients,
        statistics: Option<&mut Vec<DensityStatistics>>,
    ) -> Result<(), BackendError> {
        match (&mut self.0, statistics) {
            (Inner::Cpu(workspace), None) => {
                render_and_gradients_into(workspace, splats, camera, settings, loss, out)?;
            }
            (Inner::Cpu(workspace), Some(statistics)) => {
                render_and_gradients_with_statistics(
                    workspace, splats, camera, settings, loss, out, statistics,
                )?;
            }
            #[cfg(feature = "gpu")]
            (Inner::Gpu(on_gpu), statistics) => {
                let OnGpu { device, image } = &mut **on_gpu;
                device.draw(splats, camera, settings, &mut out.rendered)?;
                let picture = &out.rendered.image;
                image.resize(picture.rgb().len(), 0.0);
                let value = loss.differentiate(picture, settings.parallel, image);
                out.loss = value.map_err(AdjointError::from)?;
                device.differentiate(image, statistics, out)?;
            }
        }
        Ok(())
    }
}
