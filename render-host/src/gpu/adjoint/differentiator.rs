//! A differentiator draws one picture on the device and takes a gradient of it back to all it was made from.
//!
//! Between the two the picture and its gradient pass through the processor: any [`crate::Loss`] can evaluate
//! it. A picture then costs 16 bytes per pixel down and 12 up, and the device waits meanwhile.
//!
//! The kernels are those of many worlds, with one world of one group: three of four lanes are idle.

use bytemuck::cast_slice;

use super::{
    super::{
        BoundRecording, Device, Executor, GpuError, GrowableBuffer, Lists, Scene, Stages, Tiles,
        layout::WORKGROUP,
        lists::COUNT_BYTES,
        recording::{Recording, Workgroups},
        renderer::counters,
        source::Kernel,
        states::{Batch, QUAD, SharedLists, Totals, masks, set_bytes},
    },
    PROJECT_BACK, SEGMENT, VECTOR,
    blend_buffers::{BLEND_BACK, BlendBuffers},
    pose, pose_totals,
    rows::Rows,
    structure::FRAMEBUFFER,
};
use crate::{
    Camera, Settings, Splats,
    adjoint::{self, DensityStatistics},
    counterfactual::States,
    render::Rendered,
};

/// Places per tile for what is found there: one vector of worlds, and the background.
const COLUMNS: usize = 2 * QUAD;
/// Planes of a picture: r g b and transmittance.
const PLANES: usize = 4;

/// Draws pictures of whole scenes and differentiates them; frames use its kernels and buffers again.
///
/// The same splats, camera, settings and gradient give the same bits on one device, whatever was drawn
/// before.
#[derive(Debug)]
pub struct Differentiator {
    executor: Executor,
    stages: Stages,
    scene: Option<Scene>,
    /// One world of one group, and that it has it.
    batch: wgpu::Buffer,
    masks: wgpu::Buffer,
    buffers: Buffers,
    /// Of the last picture drawn.
    drawn: Option<Drawn>,
    drawing: Option<BoundRecording>,
    going_back: Option<BoundRecording>,
}

#[derive(Debug)]
struct Buffers {
    entries: GrowableBuffer,
    sets: GrowableBuffer,
    partials: GrowableBuffer,
    found: GrowableBuffer,
    marks: GrowableBuffer,
    /// The picture, plane by plane; then its gradient.
    planes: GrowableBuffer,
    gradients: GrowableBuffer,
}

/// A picture on the device.
#[derive(Debug)]
struct Drawn {
    lists: SharedLists,
    walk: BlendBuffers,
    sums: Sums,
}

/// Sums, and what they are sized for.
#[derive(Debug)]
struct Sums {
    rows: Rows,
    tiles: usize,
    gradients: wgpu::Buffer,
    background: Totals,
    /// The last ones first.
    pose: [Totals; 2],
}

impl Differentiator {
    /// No buffers of a picture yet.
    ///
    /// # Errors
    /// No memory for the little that every picture needs.
    pub fn new(executor: &Executor) -> Result<Self, GpuError> {
        let device = executor.device();
        let batch = Batch {
            groups: 1,
            words: 1,
            worlds: 1,
            quads: 1,
            columns: COLUMNS as u32,
            past: 1,
            ..Batch::default()
        };
        Ok(Self {
            executor: executor.clone(),
            stages: Stages::new(device)?,
            scene: None,
            batch: device.uniform("batch", bytemuck::bytes_of(&batch))?,
            masks: device.filled("masks", cast_slice(&masks(&States::full(1), 1)))?,
            buffers: Buffers {
                entries: GrowableBuffer::new("entries"),
                sets: GrowableBuffer::new("sets"),
                partials: GrowableBuffer::new("gradients of entries"),
                found: GrowableBuffer::new("backgrounds of tiles"),
                marks: GrowableBuffer::new("transmittances"),
                planes: GrowableBuffer::new("picture"),
                gradients: GrowableBuffer::new("gradients"),
            },
            drawn: None,
            drawing: None,
            going_back: None,
        })
    }

    /// Draws `splats` as `camera` sees them, and reads the picture into `out`.
    ///
    /// # Errors
    /// A setting out of range or one that only the CPU has, or no room on the device.
    pub fn draw(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
        out: &mut Rendered,
    ) -> Result<(), GpuError> {
        let device = self.executor.device().clone();
        let groups = vec![0; splats.len()];
        match &mut self.scene {
            Some(scene) => scene.update(&device, splats, &groups)?,
            None => self.scene = Some(Scene::with_groups(&device, splats, &groups)?),
        }
        self.submit(camera, settings)?;
        let first = self.read_picture(settings, out);
        let Err(GpuError::Entries { found, .. }) = first else { return first };
        self.stages.reserve_entries(found);
        self.submit(camera, settings)?;
        self.read_picture(settings, out)
    }

    /// Takes `gradient` (r g b per pixel of the last picture, row by row; where it is not finite it counts as
    /// 0) back to everything, into all of `out` but its picture and loss; if asked for, with the statistics
    /// of each Gaussian.
    ///
    /// # Errors
    /// Nothing was drawn, another number of values, no room, or a device that was lost.
    pub fn differentiate(
        &mut self,
        gradient: &[f32],
        statistics: Option<&mut Vec<DensityStatistics>>,
        out: &mut adjoint::Gradients,
    ) -> Result<(), GpuError> {
        let device = self.executor.device().clone();
        let drawn = self.drawn.as_ref().ok_or_else(nothing_drawn)?;
        let scene = self.scene.as_ref().ok_or_else(nothing_drawn)?;
        let [width, height] = drawn.lists.tiles.size.map(|side| side as usize);
        let (found, needed) = (gradient.len(), 3 * width * height);
        if found != needed {
            return Err(GpuError::Length { field: "gradient of the picture", found, needed });
        }
        let (planes, not_finite) = planes(gradient);
        device.queue().write_buffer(&drawn.walk.wanted, 0, cast_slice(&planes));

        let mut recording = Recording::new();
        self.record_way_back(drawn, scene, statistics.is_some(), &mut recording)?;
        let bound = self.executor.bind_again(recording, &mut self.going_back)?;
        self.executor.submit(bound, None);
        read_gradients(&device, &drawn.sums, statistics, out)?;
        out.non_finite += not_finite;
        Ok(())
    }

    /// Sends the camera, and submits the work of a picture.
    fn submit(&mut self, camera: &Camera, settings: &Settings) -> Result<(), GpuError> {
        let device = self.executor.device().clone();
        let scene = self.scene.as_ref().ok_or_else(nothing_drawn)?;
        self.stages.prepare(&device, scene, camera, settings)?;
        let tiles = self.stages.tiles()?;
        let rendered = settings.max_sh_degree.min(scene.degree());
        let rows = Rows::new(scene.len() as usize, scene.degree(), rendered);
        self.buffers.reserve(&device, &tiles, rows)?;
        let before = self.drawn.take().map(|drawn| drawn.sums);
        let sums = self.buffers.sums(&device, &tiles, rows, before)?;
        let lists = SharedLists {
            groups: 1,
            words: 1,
            entries: self.buffers.entries.get()?.clone(),
            sets: self.buffers.sets.get()?.clone(),
            batch: self.batch.clone(),
            tiles,
        };
        let walk = self.buffers.walk(&lists, &self.masks)?;

        let mut recording = Recording::new();
        self.stages.record(scene, &mut recording)?;
        recording.stage("blend");
        lists.record(&mut recording);
        let marks = self.buffers.marks.get()?;
        let buffers = [&walk.lists(&self.batch, marks)[..], &[&walk.wanted, &walk.found]].concat();
        let [columns, rows] = walk.grid;
        let kernel = Kernel::new(&FRAMEBUFFER, "draw").with("TRANSMITTANCE", 1);
        recording.dispatch(kernel, &buffers, [columns, rows, 1]);
        let bound = self.executor.bind_again(recording, &mut self.drawing)?;
        self.executor.submit(bound, None);
        self.drawn = Some(Drawn { lists, walk, sums });
        Ok(())
    }

    /// Waits, and reads the picture.
    fn read_picture(&self, settings: &Settings, out: &mut Rendered) -> Result<(), GpuError> {
        let drawn = self.drawn.as_ref().ok_or_else(nothing_drawn)?;
        let (lists, [width, height]) = (self.stages.lists(), drawn.lists.tiles.size);
        let pixels = width as usize * height as usize;
        let picture = (&drawn.walk.wanted, (4 * PLANES * pixels) as u64);
        let bytes = self.executor.device().read_all(&[(lists.counts(), COUNT_BYTES), picture])?;
        let (counts, planes) = bytes.split_at(COUNT_BYTES as usize);
        out.counters = counters(&Lists::checked_counts(counts)?, lists.frame(), settings.early_stop);
        let planes = floats(planes);
        let [r, g, b, t]: [&[f32]; PLANES] = std::array::from_fn(|plane| &planes[plane * pixels..][..pixels]);
        out.image.reset(width, height)?;
        for (at, rgb) in out.image.rgb_mut().chunks_exact_mut(3).enumerate() {
            rgb.copy_from_slice(&[r[at], g[at], b[at]]);
        }
        out.transmittance.clear();
        out.transmittance.extend_from_slice(t);
        let stopped = t.iter().filter(|&&t| settings.early_stop && t < settings.closed_below());
        out.counters.pixels_stopped = stopped.count() as u64;
        Ok(())
    }

    fn record_way_back(
        &self,
        drawn: &Drawn,
        scene: &Scene,
        statistics: bool,
        recording: &mut Recording,
    ) -> Result<(), GpuError> {
        let Drawn { lists, walk, sums } = drawn;
        // Sums of the pose also add up what is past the last Gaussian.
        recording.clear(&sums.gradients);
        let marks = self.buffers.marks.get()?;
        let back = [&walk.lists(&self.batch, marks)[..], &[&walk.wanted, &walk.partials, &walk.found]];
        let [columns, rows] = walk.grid;
        let kernel =
            Kernel::new(&BLEND_BACK, "back_from_gradients").with("STATISTICS", u32::from(statistics));
        recording.dispatch(kernel, &back.concat(), [columns, rows, 1]);
        sums.background.record(recording);
        let [gaussians, harmonics, _] = scene.buffers()?;
        let BlendBuffers { frame, splats, starts, entries, partials, .. } = walk;
        let ranks = &lists.tiles.ranks;
        let buffers =
            [frame, gaussians, harmonics, splats, ranks, starts, entries, partials, &sums.gradients];
        let workgroups = Workgroups::row(scene.len().div_ceil(WORKGROUP));
        recording.dispatch_in(Kernel::new(&PROJECT_BACK, "project_back"), &buffers, workgroups);
        sums.pose.iter().rev().for_each(|sums| sums.record(recording));
        Ok(())
    }
}

impl Buffers {
    /// Makes room for a picture of `tiles` and for gradients of `rows`.
    fn reserve(&mut self, device: &Device, tiles: &Tiles, rows: Rows) -> Result<(), GpuError> {
        let pixels = tiles.size.map(|side| side as usize).iter().product::<usize>();
        let segments = tiles.capacity / SEGMENT + tiles.count() + 1;
        self.entries.reserve(device, 8 * tiles.capacity as u64)?;
        self.sets.reserve(device, set_bytes(tiles, 1))?;
        self.partials.reserve(device, (3 * VECTOR * tiles.capacity) as u64)?;
        self.found.reserve(device, (4 * COLUMNS * tiles.count()) as u64)?;
        self.marks.reserve(device, (VECTOR * 256 * segments) as u64)?;
        self.planes.reserve(device, (4 * PLANES * pixels) as u64)?;
        self.gradients.reserve(device, rows.bytes())?;
        Ok(())
    }

    fn walk(&self, lists: &SharedLists, masks: &wgpu::Buffer) -> Result<BlendBuffers, GpuError> {
        let tiles = &lists.tiles;
        Ok(BlendBuffers {
            frame: tiles.frame.clone(),
            splats: tiles.splats.clone(),
            starts: tiles.starts.clone(),
            entries: lists.entries.clone(),
            masks: masks.clone(),
            partials: self.partials.get()?.clone(),
            found: self.found.get()?.clone(),
            wanted: self.planes.get()?.clone(),
            grid: tiles.grid(),
        })
    }

    /// Sums over `tiles` and `rows`; those of the picture `before`, if they are these.
    fn sums(
        &self,
        device: &Device,
        tiles: &Tiles,
        rows: Rows,
        before: Option<Sums>,
    ) -> Result<Sums, GpuError> {
        let (gradients, found) = (self.gradients.get()?, self.found.get()?);
        let count = tiles.count();
        let same = |sums: &Sums| sums.rows == rows && sums.tiles == count && sums.gradients == *gradients;
        if let Some(sums) = before.filter(same) {
            return Ok(sums);
        }
        Ok(Sums {
            rows,
            tiles: count,
            gradients: gradients.clone(),
            background: Totals::new(device, found, [count, COLUMNS, 1])?,
            pose: pose_totals(device, gradients, rows)?,
        })
    }
}

/// Waits, and reads gradients and statistics.
fn read_gradients(
    device: &Device,
    sums: &Sums,
    statistics: Option<&mut Vec<DensityStatistics>>,
    out: &mut adjoint::Gradients,
) -> Result<(), GpuError> {
    let Sums { rows, gradients, background, pose: poses, .. } = sums;
    let (of_background, of_pose) = (background.bytes(), poses[0].bytes());
    let parts = [(&background.buffer, of_background), (&poses[0].buffer, of_pose), (gradients, rows.bytes())];
    let values = floats(&device.read_all(&parts)?);
    let (background, values) = values.split_at(of_background as usize / 4);
    let (of_pose, values) = values.split_at(of_pose as usize / 4);
    rows.splats(values, &mut out.splats);
    rows.sh_rest(values, &mut out.sh_rest);
    out.non_finite = rows.overflowed(values);
    out.pose = pose(of_pose);
    let channels = &background[QUAD..];
    for (sum, &value) in out.background.iter_mut().zip(channels) {
        *sum = if value.is_finite() { f64::from(value) } else { 0.0 };
        out.non_finite += u64::from(!value.is_finite());
    }
    if let Some(statistics) = statistics {
        rows.statistics(values, statistics);
    }
    Ok(())
}

/// `gradient` plane by plane, with 0 for what is not finite; and how much was not.
fn planes(gradient: &[f32]) -> (Vec<f32>, u64) {
    let pixels = gradient.len() / 3;
    let mut out = vec![0.0; gradient.len()];
    let mut not_finite = 0;
    for (at, pixel) in gradient.chunks_exact(3).enumerate() {
        for (channel, &value) in pixel.iter().enumerate() {
            if value.is_finite() {
                out[channel * pixels + at] = value;
            } else {
                not_finite += 1;
            }
        }
    }
    (out, not_finite)
}

fn floats(bytes: &[u8]) -> Vec<f32> {
    bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect()
}

fn nothing_drawn() -> GpuError {
    GpuError::Refused { what: "gradients", message: "no picture was drawn".into() }
}
