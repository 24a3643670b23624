//! A screen draws Gaussians on a canvas: the stages of `render-host`, then one triangle that shows them.

use std::{
    cell::{Cell, RefCell},
    rc::Rc,
    sync::{
        Arc,
        atomic::{AtomicBool, AtomicU32, Ordering},
    },
};

use render_host::{
    Camera, Settings, Splats,
    gpu::{
        Device, DeviceOptions, Executor, GpuError, Renderer, Scene,
        layout::{COUNT_ENTRIES, COUNT_WANTED, COUNTS},
        wgpu,
    },
};
use web_sys::HtmlCanvasElement;

/// Bytes of the counts that say whether tile lists fitted.
const COUNT_BYTES: u64 = 4 * COUNTS as u64;

/// What cannot be drawn, and why.
#[derive(Debug, thiserror::Error)]
pub enum ScreenError {
    /// No adapter that can draw on this canvas.
    #[error("no WebGPU adapter: {0}")]
    Adapter(#[from] wgpu::RequestAdapterError),
    /// The canvas has another kind of context.
    #[error("the canvas cannot be drawn on: {0}")]
    Canvas(#[from] wgpu::CreateSurfaceError),
    /// The device refuses.
    #[error(transparent)]
    Device(#[from] GpuError),
    /// The canvas is not supported by the adapter.
    #[error("the adapter offers no format for this canvas")]
    Format,
}

/// A device, a canvas, and what is drawn. Dropped when the device is lost; the session stays.
pub struct Screen {
    device: Device,
    surface: wgpu::Surface<'static>,
    config: wgpu::SurfaceConfiguration,
    renderer: Renderer,
    scene: Option<Scene>,
    present: wgpu::RenderPipeline,
    shape: wgpu::Buffer,
    bound: Option<(wgpu::Buffer, wgpu::BindGroup)>,
    lost: Arc<AtomicBool>,
    /// Frames submitted, and those of them that the device has finished.
    submitted: u32,
    finished: Arc<AtomicU32>,
    counts: Counts,
}

/// What the tile lists needed, read without waiting: the answer comes between frames.
struct Counts {
    landing: wgpu::Buffer,
    /// Whether a copy is on its way.
    busy: Rc<Cell<bool>>,
    /// Entries that a frame needed and had no room for.
    wanted: Rc<Cell<u32>>,
}

impl Screen {
    /// Opens a device that can draw on `canvas`.
    pub async fn open(canvas: HtmlCanvasElement) -> Result<Self, ScreenError> {
        let mut descriptor = wgpu::InstanceDescriptor::new_without_display_handle();
        descriptor.backends = wgpu::Backends::BROWSER_WEBGPU;
        let instance = wgpu::Instance::new(descriptor);
        let surface = instance.create_surface(wgpu::SurfaceTarget::Canvas(canvas))?;
        let wishes = wgpu::RequestAdapterOptions {
            power_preference: wgpu::PowerPreference::HighPerformance,
            compatible_surface: Some(&surface),
            ..Default::default()
        };
        let adapter = instance.request_adapter(&wishes).await?;
        let device = Device::request(&adapter, &DeviceOptions::default()).await?;
        let lost = Arc::new(AtomicBool::new(false));
        let heard = Arc::clone(&lost);
        device.raw().set_device_lost_callback(move |_, _| heard.store(true, Ordering::Relaxed));
        // Never an sRGB format: display colours are written as they are.
        let formats = surface.get_capabilities(&adapter).formats;
        let format = formats.into_iter().find(|format| !format.is_srgb()).ok_or(ScreenError::Format)?;
        let config = wgpu::SurfaceConfiguration {
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            format,
            color_space: Default::default(),
            width: 0,
            height: 0,
            present_mode: wgpu::PresentMode::Fifo,
            desired_maximum_frame_latency: 2,
            alpha_mode: wgpu::CompositeAlphaMode::Opaque,
            view_formats: Vec::new(),
        };
        let renderer = Renderer::new(&Executor::new(&device))?;
        let uniform = wgpu::BufferUsages::UNIFORM | wgpu::BufferUsages::COPY_DST;
        let shape = device.buffer("shape", 32, uniform)?;
        let mapped = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let landing = device.buffer("counts to read", COUNT_BYTES, mapped)?;
        Ok(Self {
            present: present(device.raw(), format),
            counts: Counts { landing, busy: Rc::default(), wanted: Rc::default() },
            scene: None,
            bound: None,
            device,
            surface,
            config,
            renderer,
            shape,
            lost,
            submitted: 0,
            finished: Arc::default(),
        })
    }

    /// What draws: adapter, API, driver.
    pub fn adapter(&self) -> String {
        let facts = self.device.facts();
        format!("{} {}", facts.name, facts.driver).trim().to_owned()
    }

    /// Whether the device is gone.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }

    /// Frames that the device has finished.
    pub fn finished(&self) -> u32 {
        self.finished.load(Ordering::Relaxed)
    }

    /// Frames that the device still draws.
    pub fn pending(&self) -> u32 {
        self.submitted.wrapping_sub(self.finished())
    }

    /// Gives the device up, as a browser may at any time.
    pub fn destroy(&self) {
        self.device.raw().destroy();
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.renderer.bytes() + self.scene.as_ref().map_or(0, Scene::bytes)
    }

    /// Uploads what is to be drawn; with `only_moved` all but its harmonics.
    pub fn upload(&mut self, splats: &Splats, only_moved: bool) -> Result<(), ScreenError> {
        match &mut self.scene {
            Some(scene) if only_moved && scene.len() as usize == splats.len() => {
                scene.update_moved(&self.device, splats)?;
            }
            Some(scene) => scene.update(&self.device, splats, &vec![0; splats.len()])?,
            None => self.scene = Some(Scene::new(&self.device, splats)?),
        }
        Ok(())
    }

    /// Draws what was uploaded as `camera` sees it, with room for all that earlier frames had no room for.
    pub fn draw(&mut self, camera: &Camera, settings: &Settings) -> Result<(), ScreenError> {
        let Some(scene) = &self.scene else { return Ok(()) };
        let (width, height) = (camera.width(), camera.height());
        if (self.config.width, self.config.height) != (width, height) {
            (self.config.width, self.config.height) = (width, height);
            self.surface.configure(self.device.raw(), &self.config);
        }
        let wanted = self.counts.wanted.take();
        self.renderer.reserve_entries(wanted);
        self.renderer.draw(scene, camera, settings)?;
        self.show(settings.background)?;
        self.submitted = self.submitted.wrapping_add(1);
        let finished = Arc::clone(&self.finished);
        self.device.queue().on_submitted_work_done(move || {
            finished.fetch_add(1, Ordering::Relaxed);
        });
        self.counts.copy(&self.device, self.renderer.lists().counts());
        Ok(self.device.check()?)
    }

    /// Whether tile lists had no room in a frame since the last [`Screen::draw`].
    pub fn must_draw_again(&self) -> bool {
        self.counts.wanted.get() > 0
    }

    fn show(&mut self, background: [f32; 3]) -> Result<(), ScreenError> {
        use wgpu::CurrentSurfaceTexture::{Suboptimal, Success};
        let (Success(texture) | Suboptimal(texture)) = self.surface.get_current_texture() else {
            // The browser shows no picture now; the next frame tries again.
            return Ok(());
        };
        let raw = self.device.raw();
        let mut shape = [0u8; 32];
        let [r, g, b] = background;
        let words = [r.to_bits(), g.to_bits(), b.to_bits(), 0, self.config.width, self.config.height, 0, 0];
        for (out, word) in shape.chunks_exact_mut(4).zip(words) {
            out.copy_from_slice(&word.to_le_bytes());
        }
        self.device.queue().write_buffer(&self.shape, 0, &shape);
        let image = self.renderer.image()?;
        let group = match &self.bound {
            Some((bound, group)) if bound == image => group.clone(),
            _ => {
                let group = raw.create_bind_group(&wgpu::BindGroupDescriptor {
                    label: Some("picture"),
                    layout: &self.present.get_bind_group_layout(0),
                    entries: &[
                        wgpu::BindGroupEntry { binding: 0, resource: self.shape.as_entire_binding() },
                        wgpu::BindGroupEntry { binding: 1, resource: image.as_entire_binding() },
                    ],
                });
                self.bound = Some((image.clone(), group.clone()));
                group
            }
        };
        let view = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
        let mut encoder = raw.create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
        {
            let mut pass = encoder.begin_render_pass(&wgpu::RenderPassDescriptor {
                label: Some("present"),
                color_attachments: &[Some(wgpu::RenderPassColorAttachment {
                    view: &view,
                    depth_slice: None,
                    resolve_target: None,
                    ops: wgpu::Operations {
                        load: wgpu::LoadOp::Clear(wgpu::Color::BLACK),
                        store: wgpu::StoreOp::Store,
                    },
                })],
                ..Default::default()
            });
            pass.set_pipeline(&self.present);
            pass.set_bind_group(0, &group, &[]);
            pass.draw(0..3, 0..1);
        }
        self.device.queue().submit([encoder.finish()]);
        self.device.queue().present(texture);
        Ok(())
    }
}

impl Counts {
    /// Copies `counts` of the frame just drawn, unless a copy is on its way already.
    fn copy(&self, device: &Device, counts: &wgpu::Buffer) {
        if self.busy.replace(true) {
            return;
        }
        let descriptor = wgpu::CommandEncoderDescriptor::default();
        let mut encoder = device.raw().create_command_encoder(&descriptor);
        encoder.copy_buffer_to_buffer(counts, 0, &self.landing, 0, COUNT_BYTES);
        device.queue().submit([encoder.finish()]);
        let (landing, busy, wanted) = (self.landing.clone(), self.busy.clone(), self.wanted.clone());
        let arrived = RefCell::new(move |mapped: bool| {
            if let (true, Ok(view)) = (mapped, landing.slice(..).get_mapped_range()) {
                let word = |at: u32| {
                    let at = 4 * at as usize;
                    view.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                };
                let (needed, fitted) = (word(COUNT_WANTED), word(COUNT_ENTRIES));
                if needed > fitted {
                    wanted.set(needed.max(wanted.get()));
                }
                drop(view);
                landing.unmap();
            }
            busy.set(false);
        });
        self.landing.slice(..).map_async(wgpu::MapMode::Read, move |result| {
            (arrived.borrow_mut())(result.is_ok());
        });
    }
}

/// The pipeline of the triangle.
fn present(device: &wgpu::Device, format: wgpu::TextureFormat) -> wgpu::RenderPipeline {
    let source = wgpu::ShaderSource::Wgsl(include_str!("present.wgsl").into());
    let module =
        device.create_shader_module(wgpu::ShaderModuleDescriptor { label: Some("present.wgsl"), source });
    device.create_render_pipeline(&wgpu::RenderPipelineDescriptor {
        label: Some("present"),
        layout: None,
        vertex: wgpu::VertexState {
            module: &module,
            entry_point: Some("corner"),
            compilation_options: Default::default(),
            buffers: &[],
        },
        primitive: wgpu::PrimitiveState::default(),
        depth_stencil: None,
        multisample: wgpu::MultisampleState::default(),
        fragment: Some(wgpu::FragmentState {
            module: &module,
            entry_point: Some("colour"),
            compilation_options: Default::default(),
            targets: &[Some(format.into())],
        }),
        multiview_mask: None,
        cache: None,
    })
}
