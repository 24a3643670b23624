//! The renderer draws pictures on the device: tile lists, then one blending kernel.

use super::{
    BoundRecording, Clock, Device, Executor, GpuError, GrowableBuffer, Lists, Presence, Scene, StageTime,
    layout::{
        COUNT_ABSENT, COUNT_BEHIND_NEAR, COUNT_DEGENERATE, COUNT_DRAWN, COUNT_ENTRIES, COUNT_NON_FINITE,
        COUNT_OUTSIDE, COUNT_STOPPED, COUNT_SUB_PIXEL, COUNT_TOUCHED, COUNT_TRANSPARENT, COUNTS, Frame,
        LANES,
    },
    recording::Recording,
    source::{Bind, Kernel, LAYOUT, STAGED, Source, TILE},
};
use crate::{Camera, Counters, Settings, Splats, image::Image, render::Rendered};

/// Stage 4.
pub static BLEND: Source = Source {
    name: "blend.wgsl",
    parts: &[LAYOUT, TILE, STAGED, include_str!("../stage/blend.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("splats", Bind::Read),
        ("entries", Bind::Read),
        ("starts", Bind::Read),
        ("counts", Bind::Write),
        ("image", Bind::Write),
    ],
};

/// Stage 4 for a batch of worlds.
pub static WORLDS: Source = Source {
    name: "worlds.wgsl",
    parts: &[LAYOUT, TILE, STAGED, include_str!("../stage/worlds.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("splats", Bind::Read),
        ("entries", Bind::Read),
        ("starts", Bind::Read),
        ("presence", Bind::Read),
        ("images", Bind::Write),
    ],
};

/// Bytes of a pixel: r, g, b, transmittance.
const PIXEL: u64 = 16;

/// A renderer that keeps its kernels and buffers.
///
/// Same scene, camera and settings give the same bits on one device, whatever was drawn before.
#[derive(Debug)]
pub struct Renderer {
    executor: Executor,
    lists: Lists,
    image: GrowableBuffer,
    bound: Option<BoundRecording>,
    clock: Option<Clock>,
    background: [f32; 3],
    early_stop: bool,
}

impl Renderer {
    /// A renderer without buffers.
    ///
    /// # Errors
    /// No memory for the little that every frame needs.
    pub fn new(executor: &Executor) -> Result<Self, GpuError> {
        Ok(Self {
            executor: executor.clone(),
            lists: Lists::new(executor.device())?,
            image: GrowableBuffer::new("image"),
            bound: None,
            clock: None,
            background: [0.0; 3],
            early_stop: false,
        })
    }

    /// The device.
    pub fn device(&self) -> &Device {
        self.executor.device()
    }

    /// Splats and tile lists of the last frame.
    pub fn lists(&self) -> &Lists {
        &self.lists
    }

    /// The picture of the last frame on the device, row by row: r, g, b without background and transmittance,
    /// f32 each. For kernels that show it.
    ///
    /// # Errors
    /// No frame was drawn.
    pub fn image(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.image.get()
    }

    /// Times the stages of the frames that follow, or no longer. False where the device cannot.
    ///
    /// # Errors
    /// No memory for it.
    pub fn time_stages(&mut self, on: bool) -> Result<bool, GpuError> {
        self.clock = if on { Clock::new(self.device())? } else { None };
        Ok(self.clock.is_some() == on)
    }

    /// Device time of each stage of the last frame; empty when stages are not timed. Waits for it.
    ///
    /// # Errors
    /// The device was lost.
    pub fn stage_times(&self) -> Result<Vec<StageTime>, GpuError> {
        self.clock.as_ref().map_or(Ok(Vec::new()), |clock| clock.read(self.device()))
    }

    /// Asks for room for `entries` tile entries in the next frame.
    pub fn reserve_entries(&mut self, entries: u32) {
        self.lists.reserve_entries(entries);
    }

    /// Bytes on the device, the scene's own apart.
    pub fn bytes(&self) -> u64 {
        self.lists.bytes() + self.image.bytes()
    }

    /// Submits a frame. Nothing is waited for and nothing read back; [`Renderer::read`] fetches the
    /// picture, and says whether the tile lists fitted.
    ///
    /// # Errors
    /// A setting out of range, or no room on the device.
    pub fn draw(&mut self, scene: &Scene, camera: &Camera, settings: &Settings) -> Result<(), GpuError> {
        self.submit(scene, None, camera, settings)
    }

    /// As [`Renderer::draw`], a picture per world. Project, sort and bin run once; a world that lacks a
    /// group is drawn without it, and equals the picture of what it holds drawn alone bit for bit.
    ///
    /// # Errors
    /// As [`Renderer::draw`]; or the scene has a group that `worlds` does not know.
    pub fn draw_worlds(
        &mut self,
        scene: &Scene,
        worlds: &Presence,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<(), GpuError> {
        let (found, needed) = (worlds.groups() as usize, scene.groups() as usize);
        if found < needed {
            return Err(GpuError::Length { field: "groups of worlds", found, needed });
        }
        self.submit(scene, Some(worlds), camera, settings)
    }

    fn submit(
        &mut self,
        scene: &Scene,
        worlds: Option<&Presence>,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<(), GpuError> {
        let device = self.executor.device();
        let count = worlds.map_or(1, Presence::worlds);
        self.lists.prepare(device, scene, camera, settings, |frame| {
            frame.worlds = count;
            frame.world_words = worlds.map_or(1, Presence::words);
        })?;
        let frame = *self.lists.frame();
        self.image.reserve(device, PIXEL * pixels(&frame) * u64::from(count))?;
        self.background = settings.background;
        self.early_stop = settings.early_stop;

        let mut recording = Recording::new();
        self.lists.record(scene, &mut recording)?;
        recording.stage("blend");
        let (lists, image) = (&self.lists, self.image.get()?);
        let [splats, entries, starts] = [lists.splats()?, lists.entries()?, lists.starts()?];
        let [_, _, columns, rows] = frame.size;
        if let Some(worlds) = worlds {
            let buffers = [lists.frame_buffer(), splats, entries, starts, worlds.buffer()?, image];
            let workgroups = [columns, rows, count.div_ceil(LANES)];
            recording.dispatch(Kernel::new(&WORLDS, "blend_worlds"), &buffers, workgroups);
        } else {
            let buffers = [lists.frame_buffer(), splats, entries, starts, lists.counts(), image];
            recording.dispatch(Kernel::new(&BLEND, "blend"), &buffers, [columns, rows, 1]);
        }
        let bound = self.executor.bind_again(recording, &mut self.bound)?;
        self.executor.submit(bound, self.clock.as_mut());
        Ok(())
    }

    /// The picture of the last frame, over its background. Waits for it.
    ///
    /// # Errors
    /// [`GpuError::Entries`] when the tile lists did not fit: call [`Renderer::reserve_entries`] and draw
    /// again, as [`Renderer::render`] does. Or the device was lost.
    pub fn read(&self) -> Result<Rendered, GpuError> {
        let mut all = self.read_worlds()?;
        all.pop().ok_or(GpuError::Length { field: "worlds", found: 0, needed: 1 })
    }

    /// As [`Renderer::read`], a picture per world; all have the counters of the whole batch.
    ///
    /// # Errors
    /// As [`Renderer::read`].
    pub fn read_worlds(&self) -> Result<Vec<Rendered>, GpuError> {
        let frame = self.lists.frame();
        let counters = counters(&self.lists.read_counts(self.device())?, frame, self.early_stop);
        let world = PIXEL * pixels(frame);
        let bytes = self.device().read(self.image.get()?, world * u64::from(frame.worlds))?;
        bytes
            .chunks_exact((world as usize).max(1))
            .map(|bytes| {
                let mut image = Image::default();
                image.reset(frame.size[0], frame.size[1])?;
                let mut transmittance = vec![1.0; pixels(frame) as usize];
                let texels = bytes.chunks_exact(PIXEL as usize).map(bytemuck::pod_read_unaligned);
                let out = image.rgb_mut().chunks_exact_mut(3).zip(&mut transmittance);
                for ([r, g, b, t], (rgb, through)) in texels.map(|v: [f32; 4]| v).zip(out) {
                    for ((out, sum), back) in rgb.iter_mut().zip([r, g, b]).zip(self.background) {
                        *out = sum + t * back;
                    }
                    *through = t;
                }
                Ok(Rendered { image, transmittance, counters })
            })
            .collect()
    }

    /// Draws and reads; makes room for the tile lists and draws again when they did not fit.
    ///
    /// # Errors
    /// A setting out of range, or no room on the device.
    pub fn render(
        &mut self,
        scene: &Scene,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Rendered, GpuError> {
        self.draw(scene, camera, settings)?;
        let first = self.read();
        let Err(GpuError::Entries { found, .. }) = first else { return first };
        self.reserve_entries(found);
        self.draw(scene, camera, settings)?;
        self.read()
    }

    /// As [`Renderer::render`], a picture per world.
    ///
    /// # Errors
    /// As [`Renderer::draw_worlds`].
    pub fn render_worlds(
        &mut self,
        scene: &Scene,
        worlds: &Presence,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Vec<Rendered>, GpuError> {
        self.draw_worlds(scene, worlds, camera, settings)?;
        let first = self.read_worlds();
        let Err(GpuError::Entries { found, .. }) = first else { return first };
        self.reserve_entries(found);
        self.draw_worlds(scene, worlds, camera, settings)?;
        self.read_worlds()
    }

    /// Uploads `splats` and renders them once. To render many frames, keep a [`Scene`].
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn render_splats(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Rendered, GpuError> {
        let scene = Scene::new(self.device(), splats)?;
        self.render(&scene, camera, settings)
    }

    /// Waits for the last frame; true when its tile lists did not fit and there is room for them in the
    /// next.
    ///
    /// # Errors
    /// The device was lost.
    pub fn make_room(&mut self) -> Result<bool, GpuError> {
        match self.lists.read_counts(self.device()) {
            Ok(_) => Ok(false),
            Err(GpuError::Entries { found, .. }) => {
                self.lists.reserve_entries(found);
                Ok(true)
            }
            Err(other) => Err(other),
        }
    }
}

fn pixels(frame: &Frame) -> u64 {
    u64::from(frame.size[0]) * u64::from(frame.size[1])
}

/// Counters from what the device counted.
pub(super) fn counters(counts: &[u32; COUNTS as usize], frame: &Frame, early_stop: bool) -> Counters {
    let at = |i: u32| u64::from(counts[i as usize]);
    Counters {
        gaussians: u64::from(frame.gaussians),
        drawn: at(COUNT_DRAWN),
        absent: at(COUNT_ABSENT),
        non_finite: at(COUNT_NON_FINITE),
        transparent: at(COUNT_TRANSPARENT),
        degenerate: at(COUNT_DEGENERATE),
        behind_near: at(COUNT_BEHIND_NEAR),
        outside: at(COUNT_OUTSIDE),
        sub_pixel: at(COUNT_SUB_PIXEL),
        tiles: u64::from(frame.tiles()),
        tiles_touched: at(COUNT_TOUCHED),
        intersections: at(COUNT_ENTRIES),
        pixels: pixels(frame),
        // Without early stop, a pixel behind which nothing shows is no pixel that was stopped.
        pixels_stopped: if early_stop { at(COUNT_STOPPED) } else { 0 },
        // What only the CPU stages count.
        ..Counters::default()
    }
}
