//! Renders the pictures: on the CPU, and on a graphics device where there is one.

use anyhow::{Context, Result};
use render_host::{
    Camera, Image, Rendered, Renderer, Settings, Splats,
    gpu::{self, Device, DeviceOptions, Executor, GpuError},
    stage::TileSide,
};

/// Something that makes pictures.
pub trait Backend {
    /// Name in tables.
    fn name(&self) -> &'static str;

    /// Takes the scene that the next pictures show; not timed.
    fn take(&mut self, splats: &Splats) -> Result<()>;

    /// Makes the picture of the scene taken last, which is `splats`, and keeps it.
    fn render(&mut self, splats: &Splats, camera: &Camera, settings: &Settings) -> Result<()>;

    /// The last picture.
    fn image(&self) -> &Image;

    /// Whether it can render so, within reasonable time.
    fn takes(&self, settings: &Settings) -> bool;

    /// Runs worth the wait.
    fn most_runs(&self) -> usize;
}

/// Backends, in the order of tables.
pub type Backends = Vec<Box<dyn Backend>>;

/// All backends of this machine, the CPU first; and the name of the graphics device, or why there is none.
pub fn all(quick: bool) -> Result<(Backends, Result<String, String>)> {
    let mut out = vec![cpu()];
    let device = match Device::open(&DeviceOptions::from_env()) {
        Ok(device) => device,
        Err(error @ GpuError::NoAdapter { .. }) => return Ok((out, Err(error.to_string()))),
        Err(error) => return Err(error.into()),
    };
    let facts = device.facts();
    let name = format!("{} ({}, {})", facts.name, facts.api, facts.driver);
    let most_runs = match (facts.is_cpu, quick) {
        (true, true) => 1,
        (true, false) => 3,
        (false, _) => usize::MAX,
    };
    let renderer = gpu::Renderer::new(&Executor::new(&device))?;
    out.push(Box::new(Gpu { device, renderer, scene: None, rendered: Rendered::default(), most_runs }));
    Ok((out, Ok(name)))
}

/// The CPU.
pub fn cpu() -> Box<dyn Backend> {
    Box::<Cpu>::default()
}

#[derive(Default)]
struct Cpu {
    renderer: Renderer,
    rendered: Rendered,
}

impl Backend for Cpu {
    fn name(&self) -> &'static str {
        "cpu"
    }

    fn take(&mut self, _: &Splats) -> Result<()> {
        Ok(())
    }

    fn render(&mut self, splats: &Splats, camera: &Camera, settings: &Settings) -> Result<()> {
        Ok(self.renderer.render_into(splats, camera, settings, &mut self.rendered)?)
    }

    fn image(&self) -> &Image {
        &self.rendered.image
    }

    fn takes(&self, _: &Settings) -> bool {
        true
    }

    fn most_runs(&self) -> usize {
        usize::MAX
    }
}

struct Gpu {
    device: Device,
    renderer: gpu::Renderer,
    scene: Option<gpu::Scene>,
    rendered: Rendered,
    most_runs: usize,
}

impl Backend for Gpu {
    fn name(&self) -> &'static str {
        "gpu"
    }

    fn take(&mut self, splats: &Splats) -> Result<()> {
        self.scene = Some(gpu::Scene::new(&self.device, splats)?);
        Ok(())
    }

    fn render(&mut self, _: &Splats, camera: &Camera, settings: &Settings) -> Result<()> {
        let scene = self.scene.as_ref().context("no scene was taken")?;
        self.rendered = self.renderer.render(scene, camera, settings)?;
        Ok(())
    }

    fn image(&self) -> &Image {
        &self.rendered.image
    }

    fn takes(&self, settings: &Settings) -> bool {
        let limitless = settings.alpha_cutoff == 0.0;
        let same_stages = settings.depth_bits == 32 && !settings.half_attributes;
        same_stages && settings.tile == TileSide::default() && !(limitless && self.device.facts().is_cpu)
    }

    fn most_runs(&self) -> usize {
        self.most_runs
    }
}
