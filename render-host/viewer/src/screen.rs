//! A screen draws Gaussians on a canvas, in a window or into memory: the stages of `render-host`, then one
//! triangle that shows them.

use std::sync::{
    Arc,
    atomic::{AtomicBool, AtomicU32, Ordering},
};

#[cfg(not(target_family = "wasm"))]
use render_host::Image;
use render_host::{
    CameraError, Footprint, Settings,
    gpu::{
        Device, DeviceOptions, Executor, GpuError, Renderer, Scene,
        layout::{COUNT_ENTRIES, COUNT_WANTED, COUNTS},
        wgpu,
    },
};
#[cfg(target_family = "wasm")]
use render_host::{Splats, gpu::Packed};

use crate::{
    orbit::Orbit,
    present::{Presenter, Shape},
    session::{Session, Shown},
};

/// Bytes of the counts that say whether tile lists fitted.
const COUNT_BYTES: u64 = 4 * COUNTS as u64;

/// What a picture in memory is made of.
#[cfg(not(target_family = "wasm"))]
const MEMORY_FORMAT: wgpu::TextureFormat = wgpu::TextureFormat::Rgba8Unorm;

/// What cannot be drawn, and why.
#[derive(Debug, thiserror::Error)]
pub enum ScreenError {
    /// No adapter that can draw there.
    #[error("no graphics adapter: {0}")]
    Adapter(#[from] wgpu::RequestAdapterError),
    /// The canvas or the window cannot be drawn on.
    #[error("it cannot be drawn on: {0}")]
    Surface(#[from] wgpu::CreateSurfaceError),
    /// The device refuses.
    #[error(transparent)]
    Device(#[from] GpuError),
    /// The adapter cannot show pictures there.
    #[error("the adapter offers no format in which to show pictures here")]
    Format,
    /// A size that no picture has.
    #[error(transparent)]
    Camera(#[from] CameraError),
    /// The stream cannot be decoded.
    #[error(transparent)]
    Decode(#[from] dgs_player::Error),
}

/// How a frame is drawn.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct DrawOptions {
    /// Width and height of the picture, pixels.
    pub size: [u32; 2],
    /// Width and height of what it is shown on: the picture is scaled to it.
    pub shown: [u32; 2],
    /// What is behind everything, 0 to 1 each.
    pub background: [f32; 3],
    /// Bands of harmonics above this degree, 0 to 3, are not drawn.
    pub sh_degree: u8,
}

/// What a screen was given last: content and frame of a session. Another session, or another screen, begins
/// with none.
pub type Drawn = Option<(u64, u32)>;

/// Where pictures go.
enum Target {
    Surface(wgpu::Surface<'static>, wgpu::SurfaceConfiguration),
    #[cfg(not(target_family = "wasm"))]
    Memory(Option<wgpu::Texture>),
}

/// A device, a target, and what is drawn. Dropped when the device is lost; the session stays.
pub struct Screen {
    device: Device,
    target: Target,
    renderer: Renderer,
    scene: Option<Scene>,
    /// How what was uploaded is drawn.
    footprint: Footprint,
    presenter: Presenter,
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
    busy: Arc<AtomicBool>,
    /// Entries that a frame needed and had no room for.
    wanted: Arc<AtomicU32>,
}

impl Screen {
    /// Opens a device that can draw on `surface`.
    ///
    /// # Errors
    /// No such device.
    pub async fn open(
        instance: &wgpu::Instance,
        surface: wgpu::Surface<'static>,
    ) -> Result<Self, ScreenError> {
        let adapter = adapter(instance, &surface).await?;
        let device = Device::request(&adapter, &DeviceOptions::default()).await?;
        let offered = surface.get_capabilities(&adapter);
        let alpha = offered.alpha_modes.iter().find(|&&mode| mode == wgpu::CompositeAlphaMode::Opaque);
        let alpha_mode = *alpha.or(offered.alpha_modes.first()).ok_or(ScreenError::Format)?;
        let config = wgpu::SurfaceConfiguration {
            usage: wgpu::TextureUsages::RENDER_ATTACHMENT,
            format: format(&offered.formats).ok_or(ScreenError::Format)?,
            color_space: Default::default(),
            width: 0,
            height: 0,
            present_mode: wgpu::PresentMode::Fifo,
            desired_maximum_frame_latency: 2,
            alpha_mode,
            view_formats: Vec::new(),
        };
        let format = config.format;
        Self::of(device, Target::Surface(surface, config), format)
    }

    /// A screen in memory, on `device`, that [`Screen::read`] reads.
    ///
    /// # Errors
    /// No memory on the device.
    #[cfg(not(target_family = "wasm"))]
    pub fn in_memory(device: Device) -> Result<Self, ScreenError> {
        Self::of(device, Target::Memory(None), MEMORY_FORMAT)
    }

    fn of(device: Device, target: Target, format: wgpu::TextureFormat) -> Result<Self, ScreenError> {
        let lost = Arc::new(AtomicBool::new(false));
        let heard = Arc::clone(&lost);
        device.raw().set_device_lost_callback(move |_, _| heard.store(true, Ordering::Relaxed));
        let mapped = wgpu::BufferUsages::MAP_READ | wgpu::BufferUsages::COPY_DST;
        let landing = device.buffer("counts to read", COUNT_BYTES, mapped)?;
        Ok(Self {
            renderer: Renderer::new(&Executor::new(&device))?,
            presenter: Presenter::new(&device, format)?,
            counts: Counts { landing, busy: Arc::default(), wanted: Arc::default() },
            scene: None,
            footprint: Footprint::default(),
            device,
            target,
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

    /// Whether the device, or what it draws on, is gone.
    pub fn is_lost(&self) -> bool {
        self.lost.load(Ordering::Relaxed)
    }

    /// Frames that the device has finished.
    pub fn finished(&self) -> u32 {
        self.finished.load(Ordering::Relaxed)
    }

    /// Frames that the device still draws.
    pub fn pending(&self) -> u32 {
        self.listen();
        self.submitted.wrapping_sub(self.finished())
    }

    /// Hears what the device has finished; a browser says that by itself.
    fn listen(&self) {
        if cfg!(not(target_family = "wasm")) {
            // A device that is lost says so through its callback.
            let _ = self.device.raw().poll(wgpu::PollType::Poll);
        }
    }

    /// Gives the device up, as a system may at any time.
    pub fn destroy(&self) {
        self.device.raw().destroy();
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.renderer.bytes() + self.scene.as_ref().map_or(0, Scene::bytes)
    }

    /// Draws the frame of `session` that is due. What `drawn` says is there is not uploaded again.
    ///
    /// # Errors
    /// A size that no picture has, or the device refuses.
    pub fn draw(
        &mut self,
        session: &mut Session,
        drawn: &mut Drawn,
        look: &DrawOptions,
    ) -> Result<(), ScreenError> {
        let fresh = (session.content(), session.playback().frame());
        if *drawn != Some(fresh) {
            let anew = drawn.is_none();
            self.footprint = session.player().info().footprint;
            self.upload(&session.show()?, anew)?;
            *drawn = Some(fresh);
        }
        self.draw_uploaded(session.orbit(), look)
    }

    /// Uploads what another thread has packed, of a stream whose Gaussians are drawn with `footprint`.
    ///
    /// # Errors
    /// It does not fit what was uploaded before, or the device refuses.
    #[cfg(target_family = "wasm")]
    pub(crate) fn upload_packed(
        &mut self,
        packed: &Packed<'_>,
        footprint: Footprint,
    ) -> Result<(), ScreenError> {
        self.footprint = footprint;
        let scene = match &mut self.scene {
            Some(scene) => scene,
            None => self.scene.insert(Scene::new(&self.device, &Splats::plain(&[]))?),
        };
        Ok(scene.update_packed(&self.device, packed)?)
    }

    /// Uploads what is to be drawn: with `anew` all of it, else what has changed.
    fn upload(&mut self, shown: &Shown<'_>, anew: bool) -> Result<(), ScreenError> {
        let splats = &shown.splats;
        let moved = shown.only_moved && !anew;
        match &mut self.scene {
            Some(scene) if moved && scene.len() as usize == splats.len() => {
                scene.update_moved(&self.device, splats)?;
            }
            Some(scene) => scene.update(&self.device, splats, &vec![0; splats.len()])?,
            None => self.scene = Some(Scene::new(&self.device, splats)?),
        }
        Ok(())
    }

    /// Draws what was uploaded, with room for all that earlier frames had no room for.
    pub(crate) fn draw_uploaded(&mut self, orbit: &Orbit, look: &DrawOptions) -> Result<(), ScreenError> {
        let Some(scene) = &self.scene else { return Ok(()) };
        let camera = orbit.camera(look.size[0], look.size[1])?;
        self.renderer.reserve_entries(self.counts.wanted.swap(0, Ordering::Relaxed));
        let over = Settings::over(look.background).with_footprint(self.footprint);
        let settings = Settings { max_sh_degree: look.sh_degree.min(over.max_sh_degree), ..over };
        self.renderer.draw(scene, &camera, &settings)?;
        self.show(look)?;
        self.submitted = self.submitted.wrapping_add(1);
        let finished = Arc::clone(&self.finished);
        self.device.queue().on_submitted_work_done(move || {
            finished.fetch_add(1, Ordering::Relaxed);
        });
        self.counts.copy(&self.device, self.renderer.lists().counts());
        self.listen();
        Ok(self.device.check()?)
    }

    /// Whether tile lists had no room in a frame since the last [`Screen::draw`].
    pub fn must_draw_again(&self) -> bool {
        self.counts.wanted.load(Ordering::Relaxed) > 0
    }

    fn show(&mut self, look: &DrawOptions) -> Result<(), ScreenError> {
        let shape = Shape { background: look.background, size: look.size, shown: look.shown };
        let image = self.renderer.image()?;
        match &mut self.target {
            Target::Surface(surface, config) => {
                if [config.width, config.height] != look.shown {
                    [config.width, config.height] = look.shown;
                    surface.configure(self.device.raw(), config);
                }
                let Some(texture) = next_texture(&self.device, surface, config, &self.lost) else {
                    // Nothing is shown now; the next frame tries again.
                    return Ok(());
                };
                let view = texture.texture.create_view(&wgpu::TextureViewDescriptor::default());
                self.presenter.show(&self.device, image, &view, shape);
                self.device.queue().present(texture);
            }
            #[cfg(not(target_family = "wasm"))]
            Target::Memory(memory) => {
                let fitting = memory.take().filter(|t| [t.width(), t.height()] == look.shown);
                let texture = match fitting {
                    Some(texture) => texture,
                    None => memory_texture(&self.device, look.shown)?,
                };
                let view = texture.create_view(&wgpu::TextureViewDescriptor::default());
                self.presenter.show(&self.device, image, &view, shape);
                *memory = Some(texture);
            }
        }
        Ok(())
    }

    /// Waits for what was drawn into memory, and reads it; `None` where nothing was drawn there, or the tile
    /// lists had no room: then draw again.
    ///
    /// # Errors
    /// The device was lost.
    #[cfg(not(target_family = "wasm"))]
    pub fn read(&self) -> Result<Option<Image>, ScreenError> {
        self.device.wait()?;
        match &self.target {
            Target::Memory(Some(texture)) if !self.must_draw_again() => {
                Ok(Some(read_texture(&self.device, texture)?))
            }
            _ => Ok(None),
        }
    }
}

/// The next texture of `surface`; `None` while it has none. A surface that is gone counts as a lost device.
fn next_texture(
    device: &Device,
    surface: &wgpu::Surface<'_>,
    config: &wgpu::SurfaceConfiguration,
    lost: &AtomicBool,
) -> Option<wgpu::SurfaceTexture> {
    use wgpu::CurrentSurfaceTexture::{Lost, Outdated, Suboptimal, Success};
    match surface.get_current_texture() {
        Success(texture) | Suboptimal(texture) => Some(texture),
        Outdated => {
            surface.configure(device.raw(), config);
            match surface.get_current_texture() {
                Success(texture) | Suboptimal(texture) => Some(texture),
                _ => None,
            }
        }
        Lost => {
            lost.store(true, Ordering::Relaxed);
            None
        }
        _ => None,
    }
}

/// The adapter for `surface` that the browser prefers.
#[cfg(target_family = "wasm")]
async fn adapter(
    instance: &wgpu::Instance,
    surface: &wgpu::Surface<'_>,
) -> Result<wgpu::Adapter, ScreenError> {
    let wishes = wgpu::RequestAdapterOptions {
        power_preference: wgpu::PowerPreference::HighPerformance,
        compatible_surface: Some(surface),
        ..Default::default()
    };
    Ok(instance.request_adapter(&wishes).await?)
}

/// The adapter for `surface` that the environment wishes for, else the best.
#[cfg(not(target_family = "wasm"))]
async fn adapter(
    instance: &wgpu::Instance,
    surface: &wgpu::Surface<'_>,
) -> Result<wgpu::Adapter, ScreenError> {
    Ok(Device::adapter(instance, Some(surface), &DeviceOptions::from_env()).await?)
}

/// Never an sRGB format: display colours are written as they are. Eight bits where they are offered.
fn format(offered: &[wgpu::TextureFormat]) -> Option<wgpu::TextureFormat> {
    use wgpu::TextureFormat::{Bgra8Unorm, Rgba8Unorm};
    let eight = offered.iter().find(|format| matches!(format, Bgra8Unorm | Rgba8Unorm));
    eight.or_else(|| offered.iter().find(|format| !format.is_srgb())).copied()
}

#[cfg(not(target_family = "wasm"))]
fn memory_texture(device: &Device, [width, height]: [u32; 2]) -> Result<wgpu::Texture, GpuError> {
    let descriptor = wgpu::TextureDescriptor {
        label: Some("picture in memory"),
        size: wgpu::Extent3d { width, height, depth_or_array_layers: 1 },
        mip_level_count: 1,
        sample_count: 1,
        dimension: wgpu::TextureDimension::D2,
        format: MEMORY_FORMAT,
        usage: wgpu::TextureUsages::RENDER_ATTACHMENT | wgpu::TextureUsages::COPY_SRC,
        view_formats: &[],
    };
    device.guarded("picture in memory", || device.raw().create_texture(&descriptor))
}

#[cfg(not(target_family = "wasm"))]
fn read_texture(device: &Device, texture: &wgpu::Texture) -> Result<Image, ScreenError> {
    let (width, height) = (texture.width(), texture.height());
    let row = (4 * width).next_multiple_of(wgpu::COPY_BYTES_PER_ROW_ALIGNMENT);
    let bytes = u64::from(row) * u64::from(height);
    let usage = wgpu::BufferUsages::COPY_DST | wgpu::BufferUsages::COPY_SRC;
    let buffer = device.buffer("picture to read", bytes, usage)?;
    let mut encoder = device.raw().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    let layout = wgpu::TexelCopyBufferLayout { offset: 0, bytes_per_row: Some(row), rows_per_image: None };
    encoder.copy_texture_to_buffer(
        texture.as_image_copy(),
        wgpu::TexelCopyBufferInfo { buffer: &buffer, layout },
        texture.size(),
    );
    device.queue().submit([encoder.finish()]);
    let read = device.read(&buffer, bytes)?;
    let rows = read.chunks_exact(row as usize).map(|row| &row[..4 * width as usize]);
    let texels = rows.flat_map(|row| row.chunks_exact(4));
    let rgb = texels.flat_map(|texel| [texel[0], texel[1], texel[2]]).map(|v| f32::from(v) / 255.0).collect();
    // As many values as the texture has pixels.
    Image::new(width, height, rgb).map_err(|error| {
        ScreenError::Device(GpuError::Refused { what: "picture in memory", message: error.to_string() })
    })
}

impl Counts {
    /// Copies `counts` of the frame just drawn, unless a copy is on its way already.
    fn copy(&self, device: &Device, counts: &wgpu::Buffer) {
        if self.busy.swap(true, Ordering::Relaxed) {
            return;
        }
        let descriptor = wgpu::CommandEncoderDescriptor::default();
        let mut encoder = device.raw().create_command_encoder(&descriptor);
        encoder.copy_buffer_to_buffer(counts, 0, &self.landing, 0, COUNT_BYTES);
        device.queue().submit([encoder.finish()]);
        let (landing, busy, wanted) = (self.landing.clone(), self.busy.clone(), self.wanted.clone());
        let arrived = move |mapped: bool| {
            if let (true, Ok(view)) = (mapped, landing.slice(..).get_mapped_range()) {
                let word = |at: u32| {
                    let at = 4 * at as usize;
                    view.get(at..at + 4).map_or(0, |b| u32::from_le_bytes([b[0], b[1], b[2], b[3]]))
                };
                let (needed, fitted) = (word(COUNT_WANTED), word(COUNT_ENTRIES));
                if needed > fitted {
                    wanted.fetch_max(needed, Ordering::Relaxed);
                }
                drop(view);
                landing.unmap();
            }
            busy.store(false, Ordering::Relaxed);
        };
        self.landing.slice(..).map_async(wgpu::MapMode::Read, move |result| arrived(result.is_ok()));
    }
}
