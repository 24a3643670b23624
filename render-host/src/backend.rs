//! A backend makes pictures: the CPU's stages, or the same stages on a graphics device.
//!
//! ```
//! use render_host::{Backend, Camera, DeviceChoice, Gaussian, Settings, Splats};
//!
//! let scene = [Gaussian { scale: [0.3; 3], opacity: 0.9, sh0: [1.0; 3], ..Gaussian::ABSENT }];
//! let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, 1.0, 0.0], 0.8, 64, 48)?;
//! let backend = Backend::open(DeviceChoice::Auto)?;
//! let mut frames = backend.frames()?;
//! let picture = frames.render(&Splats::plain(&scene), &camera, &Settings::default())?;
//! assert!(picture.image.pixel(32, 24).is_some_and(|rgb| rgb[0] > 0.5));
//! # Ok::<(), Box<dyn std::error::Error>>(())
//! ```

mod differentiator;
mod error;

pub use differentiator::Differentiator;
pub use error::BackendError;

use crate::{
    Camera, Image, Rendered, SequenceRenderer, Settings, Splats,
    counterfactual::{States, Variants, render_worlds},
};
#[cfg(feature = "gpu")]
use crate::{
    counterfactual::CounterfactualError,
    gpu::{self, GpuError, Presence},
};

/// Which device is wanted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum DeviceChoice {
    /// This machine's processor: the same pictures on every machine.
    #[default]
    Cpu,
    /// A graphics device, of whatever kind; a software driver counts.
    Gpu,
    /// A graphics card where there is one, else the processor.
    Auto,
}

/// What makes pictures. Cheap to clone.
///
/// Pictures of the two kinds agree to 1e-4 per channel, except where a rounding decides on which side of a
/// cut-off a splat falls; see `tests/backend.rs`.
#[derive(Clone, Debug, Default)]
pub enum Backend {
    /// The stages on this machine's processor.
    #[default]
    Cpu,
    /// The stages on a graphics device.
    #[cfg(feature = "gpu")]
    Gpu(gpu::Executor),
}

impl Backend {
    /// Whether graphics devices are built in: feature `gpu`.
    pub const HAS_GPU: bool = cfg!(feature = "gpu");

    /// The backend that `choice` names. Of several graphics devices the best is taken: discrete before
    /// integrated before virtual before software; the environment variable `DGS_GPU`, part of an adapter's
    /// name, narrows them.
    ///
    /// # Errors
    /// [`DeviceChoice::Gpu`] without an adapter or without feature `gpu`, or a driver that refuses.
    pub fn open(choice: DeviceChoice) -> Result<Self, BackendError> {
        match choice {
            DeviceChoice::Cpu => Ok(Self::Cpu),
            DeviceChoice::Gpu => Self::open_gpu(false),
            DeviceChoice::Auto if Self::HAS_GPU => Self::open_gpu(true),
            DeviceChoice::Auto => Ok(Self::Cpu),
        }
    }

    /// A graphics device; with `or_cpu` the CPU where there is no adapter but software.
    #[cfg(feature = "gpu")]
    fn open_gpu(or_cpu: bool) -> Result<Self, BackendError> {
        match gpu::Device::open(&gpu::DeviceOptions::from_env()) {
            Ok(device) if or_cpu && device.facts().is_cpu => Ok(Self::Cpu),
            Ok(device) => Ok(Self::Gpu(gpu::Executor::new(&device))),
            Err(GpuError::NoAdapter { .. }) if or_cpu => Ok(Self::Cpu),
            Err(error) => Err(error.into()),
        }
    }

    #[cfg(not(feature = "gpu"))]
    fn open_gpu(_: bool) -> Result<Self, BackendError> {
        Err(BackendError::NotBuilt)
    }

    /// Name of the device for reports: `cpu`, or the adapter with its API and driver.
    pub fn name(&self) -> String {
        match self {
            Self::Cpu => "cpu".to_owned(),
            #[cfg(feature = "gpu")]
            Self::Gpu(executor) => {
                let facts = executor.device().facts();
                format!("{} ({}, {})", facts.name, facts.api, facts.driver.trim())
            }
        }
    }

    /// A renderer for frames that follow each other, with buffers of its own. Each thread takes one.
    ///
    /// # Errors
    /// The graphics device has no memory.
    pub fn frames(&self) -> Result<FrameRenderer, BackendError> {
        Ok(match self {
            Self::Cpu => FrameRenderer(Inner::Cpu(Box::default())),
            #[cfg(feature = "gpu")]
            Self::Gpu(executor) => FrameRenderer(Inner::Gpu(Box::new(OnGpu {
                renderer: gpu::Renderer::new(executor)?,
                scene: None,
                picture: Rendered::default(),
            }))),
        })
    }

    /// What takes losses of pictures back to everything they were made from, with buffers of its own. Each
    /// thread takes one.
    ///
    /// # Errors
    /// The graphics device has no memory.
    pub fn differentiator(&self) -> Result<Differentiator, BackendError> {
        match self {
            Self::Cpu => Ok(Differentiator::default()),
            #[cfg(feature = "gpu")]
            Self::Gpu(executor) => Differentiator::on_gpu(executor),
        }
    }

    /// Pictures of W worlds of one scene: project, sort and bin are done once for all. Picture `w` is bit for
    /// bit that of world `w` alone on the same backend.
    ///
    /// # Errors
    /// A setting out of range, states of another number of groups, or no memory on the device.
    pub fn render_worlds(
        &self,
        variants: &Variants,
        states: &States,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Vec<Image>, BackendError> {
        match self {
            Self::Cpu => Ok(render_worlds(variants, states, camera, settings)?),
            #[cfg(feature = "gpu")]
            Self::Gpu(executor) => {
                let (found, needed) = (states.groups(), variants.count());
                if found != needed {
                    return Err(CounterfactualError::States { found, needed }.into());
                }
                if states.is_empty() {
                    return Ok(Vec::new());
                }
                let device = executor.device();
                let scene = gpu::Scene::with_groups(device, &variants.splats(), variants.groups())?;
                let presence = Presence::new(device, states)?;
                let mut renderer = gpu::Renderer::new(executor)?;
                let drawn = renderer.render_worlds(&scene, &presence, camera, settings)?;
                Ok(drawn.into_iter().map(|world| world.image).collect())
            }
        }
    }
}

/// Renders frame after frame on one backend and keeps its buffers between them.
///
/// A picture does not depend on the frames before it.
#[derive(Debug)]
pub struct FrameRenderer(Inner);

#[derive(Debug)]
enum Inner {
    Cpu(Box<SequenceRenderer>),
    #[cfg(feature = "gpu")]
    Gpu(Box<OnGpu>),
}

#[cfg(feature = "gpu")]
#[derive(Debug)]
struct OnGpu {
    renderer: gpu::Renderer,
    scene: Option<gpu::Scene>,
    picture: Rendered,
}

impl FrameRenderer {
    /// The picture of `splats` as `camera` sees them.
    ///
    /// # Errors
    /// A setting out of range or one that the graphics device does not have, or no memory on it.
    pub fn render(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<&Rendered, BackendError> {
        match &mut self.0 {
            Inner::Cpu(sequence) => Ok(sequence.render(splats, camera, settings)?),
            #[cfg(feature = "gpu")]
            Inner::Gpu(on_gpu) => {
                let OnGpu { renderer, scene, picture } = &mut **on_gpu;
                let device = renderer.device().clone();
                let scene = match scene {
                    Some(scene) => {
                        scene.update(&device, splats, &vec![0; splats.len()])?;
                        scene
                    }
                    None => scene.insert(gpu::Scene::new(&device, splats)?),
                };
                *picture = renderer.render(scene, camera, settings)?;
                Ok(picture)
            }
        }
    }
}
