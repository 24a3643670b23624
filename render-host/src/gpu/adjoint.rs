//! The adjoint differentiates losses of many worlds on the device.
//!
//! Losses are squared error and `1 - SSIM` against one picture, in any mix, summed over the worlds of a
//! camera. Gradients are with respect to everything a Gaussian has, the background and the camera's pose.
//!
//! For squared error alone, `adjoint/blend.wgsl` goes front to back, takes the error, and goes back to front,
//! four worlds at once. With `1 - SSIM` in the mix that kernel only goes back: `adjoint/framebuffer.wgsl` has
//! blended front to back and retained pictures and transmittances, and `adjoint/loss/ssim.wgsl` has replaced
//! the pictures by their gradients. The gradient of a splat is added up over worlds before it goes further;
//! `adjoint/project.wgsl` takes those sums back to the Gaussians, once for all worlds. Sums have one order,
//! and nothing is divided by `1 - alpha` or a transmittance.
//!
//! What is differentiated, and where gradients are 0, is as in [`crate::adjoint`]; arithmetic is f32.

use self::{
    blend_buffers::{BLEND_BACK, BlendBuffers},
    rows::{POSE_ROWS, Rows},
    structure::{CHUNK_BYTES, Chunks, Structure},
};
use super::{
    Device, Executor, GpuError, Scene, Tiles,
    layout::WORKGROUP,
    recording::{Recording, Workgroups},
    source::{Bind, Kernel, LAYOUT, Source, TILE},
    states::{Batch, QUAD, STATES, SharedLists, Totals, masks},
};
use crate::{
    Camera, Settings,
    adjoint::{Pose, SplatGradient, loss::Mix},
    counterfactual::{States, Variants},
    image::{Image, same_size},
};

pub(super) mod blend_buffers;
mod differentiator;
mod rows;
pub(super) mod structure;

pub(crate) use differentiator::Differentiator;

/// Entries between two retained transmittances.
const SEGMENT: usize = 32;
/// Bytes of a vector of four.
const VECTOR: usize = 16;

/// Adjoint of stage 1.
pub(super) static PROJECT_BACK: Source = Source {
    name: "adjoint/project.wgsl",
    parts: &[LAYOUT, TILE, STATES, include_str!("../adjoint/project.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("gaussians", Bind::Read),
        ("harmonics", Bind::Read),
        ("splats", Bind::Read),
        ("ranks", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("partials", Bind::Read),
        ("gradients", Bind::Write),
    ],
};

/// What worlds are to look like.
#[derive(Clone, Copy, Debug)]
pub struct Objective<'a> {
    /// The picture wanted.
    pub target: &'a Image,
    /// What counts as how far from it.
    pub mix: Mix,
}

/// One scene and one camera, ready to be differentiated.
#[derive(Debug)]
pub struct Engine {
    executor: Executor,
    lists: SharedLists,
    scene: Scene,
    wanted: wgpu::Buffer,
    mix: Mix,
    /// `None` where the mix is of squared error alone.
    structure: Option<Structure>,
    /// Bytes of a buffer of what is retained of worlds.
    chunk_bytes: usize,
    /// Degree that is rendered.
    degree: u8,
}

/// Worlds whose gradients are wanted, on the device.
#[derive(Debug)]
pub struct Worlds {
    count: usize,
    walk: BlendBuffers,
    blend: Blend,
    totals: Totals,
    /// Sums of the pose over every 256th Gaussian, and over those.
    pose: [Totals; 2],
    gradients: wgpu::Buffer,
}

/// How worlds are blended back.
#[derive(Debug)]
enum Blend {
    /// Forward, squared error and back in one, with this batch and these transmittances.
    AtOnce { batch: wgpu::Buffer, marks: wgpu::Buffer },
    /// With pictures in between.
    WithPictures(Box<Chunks>),
}

/// Loss of each world, and gradients summed over the worlds.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// The objective's mix of mean squared error and `1 - SSIM`, of each world.
    pub loss: Vec<f64>,
    /// One per Gaussian.
    pub splats: Vec<SplatGradient>,
    /// Higher harmonic bands, laid out as in [`crate::Splats`]; 0 above the degree that was rendered.
    pub sh_rest: Vec<f32>,
    /// The settings' background.
    pub background: [f64; 3],
    /// Camera pose.
    pub pose: Pose,
}

impl Engine {
    /// Projects, orders and bins all variants as `camera` sees them, and uploads.
    ///
    /// # Errors
    /// A setting out of range, a target of another size than the camera, or a buffer that the device does
    /// not grant.
    pub fn new(
        executor: &Executor,
        variants: &Variants,
        camera: &Camera,
        objective: &Objective,
        settings: &Settings,
    ) -> Result<Self, GpuError> {
        let device = executor.device();
        let tiles = Tiles::from_cpu(device, variants, camera, settings)?;
        let scene = Scene::with_groups(device, &variants.splats(), variants.groups())?;
        Self::with_tiles(executor, scene, tiles, variants.count(), objective, settings)
    }

    /// As [`Engine::new`], from a scene and tile lists that are on the device already.
    ///
    /// # Errors
    /// A target of another size than the lists, or a buffer that the device does not grant.
    pub fn with_tiles(
        executor: &Executor,
        scene: Scene,
        tiles: Tiles,
        groups: usize,
        objective: &Objective,
        settings: &Settings,
    ) -> Result<Self, GpuError> {
        let Objective { target, mix } = *objective;
        let mut blank = Image::default();
        blank.reset(tiles.size[0], tiles.size[1])?;
        same_size(&blank, target)?;
        let device = executor.device();
        let degree = settings.max_sh_degree.min(scene.degree());
        let wanted = device.filled("target", bytemuck::cast_slice(target.rgb()))?;
        let structure = if mix.structure == 0.0 { None } else { Some(Structure::new(device, target, mix)?) };
        let lists = SharedLists::new(device, tiles, groups)?;
        let (executor, chunk_bytes) = (executor.clone(), CHUNK_BYTES);
        Ok(Self { executor, lists, scene, wanted, mix, structure, chunk_bytes, degree })
    }

    /// The scene: what lists made on the device are made of.
    pub fn scene(&self) -> &Scene {
        &self.scene
    }

    /// Loss of each world and gradients summed over them.
    ///
    /// # Errors
    /// States of another number of groups, no memory, or a device that was lost.
    pub fn gradients(&self, states: &States) -> Result<Gradients, GpuError> {
        let worlds = self.worlds(states)?;
        let mut recording = Recording::new();
        self.record(&worlds, &mut recording)?;
        self.executor.run(recording)?;
        self.read(&worlds)
    }

    /// Uploads worlds and makes room for their gradients.
    ///
    /// # Errors
    /// States of another number of groups, or no memory.
    pub fn worlds(&self, states: &States) -> Result<Worlds, GpuError> {
        self.lists.check(states)?;
        let (device, tiles) = (self.executor.device(), &self.lists.tiles);
        let quads = states.len().div_ceil(QUAD);
        let columns = QUAD * quads + QUAD;
        let values = 3 * u64::from(tiles.size[0]) * u64::from(tiles.size[1]);
        let batch = Batch {
            scale: (2.0 * self.mix.mse / values as f64) as f32,
            columns: columns as u32,
            ..self.lists.batch(states.len(), quads)
        };
        let walk = BlendBuffers {
            frame: tiles.frame.clone(),
            splats: tiles.splats.clone(),
            starts: tiles.starts.clone(),
            entries: self.lists.entries.clone(),
            masks: device.filled("masks", bytemuck::cast_slice(&masks(states, quads)))?,
            partials: device.storage("gradients of entries", (3 * VECTOR * tiles.capacity) as u64)?,
            found: device.storage("losses of tiles", (4 * columns * tiles.count()) as u64)?,
            wanted: self.wanted.clone(),
            grid: tiles.grid(),
        };
        let segments = tiles.capacity / SEGMENT + tiles.count() + 1;
        let marks = VECTOR * 256 * segments;
        let rows = self.rows();
        let gradients = device.storage("gradients", rows.bytes())?;
        let pose = pose_totals(device, &gradients, rows)?;
        let blend = if let Some(structure) = &self.structure {
            let chunks = Chunks::new(device, structure, tiles.count(), batch, marks, self.chunk_bytes)?;
            Blend::WithPictures(Box::new(chunks))
        } else {
            Blend::AtOnce {
                batch: device.uniform("batch", bytemuck::bytes_of(&batch))?,
                marks: device.storage("transmittances", marks as u64)?,
            }
        };
        let totals = Totals::new(device, &walk.found, [tiles.count(), columns, 1])?;
        Ok(Worlds { count: states.len(), walk, blend, totals, pose, gradients })
    }

    /// Records the work of [`Engine::gradients`], after that which makes the lists.
    ///
    /// # Errors
    /// Never, once the scene was made.
    pub fn record(&self, worlds: &Worlds, recording: &mut Recording) -> Result<(), GpuError> {
        let Worlds { walk, blend, totals, pose, gradients, .. } = worlds;
        self.lists.record(recording);
        match blend {
            Blend::AtOnce { batch, marks } => {
                let buffers = [&walk.lists(batch, marks)[..], &[&walk.wanted, &walk.partials, &walk.found]];
                let [columns, rows] = walk.grid;
                let kernel = Kernel::new(&BLEND_BACK, "blend_back");
                recording.dispatch(kernel, &buffers.concat(), [columns, rows, 1]);
            }
            Blend::WithPictures(chunks) => chunks.record(walk, recording),
        }
        totals.record(recording);
        let [gaussians, harmonics, _] = self.scene.buffers()?;
        let BlendBuffers { frame, splats, starts, entries, partials, .. } = walk;
        let ranks = &self.lists.tiles.ranks;
        let buffers = [frame, gaussians, harmonics, splats, ranks, starts, entries, partials, gradients];
        let workgroups = Workgroups::row(self.scene.len().div_ceil(WORKGROUP));
        recording.dispatch_in(Kernel::new(&PROJECT_BACK, "project_back"), &buffers, workgroups);
        pose.iter().rev().for_each(|sums| sums.record(recording));
        Ok(())
    }

    /// Waits, and reads the gradients.
    ///
    /// # Errors
    /// A device that was lost.
    pub fn read(&self, worlds: &Worlds) -> Result<Gradients, GpuError> {
        let device = self.executor.device();
        let size = self.lists.tiles.size;
        let values = 3.0 * f64::from(size[0]) * f64::from(size[1]);
        let totals = worlds.totals.read(device)?;
        let loss = match &worlds.blend {
            Blend::WithPictures(chunks) => chunks.read(device)?,
            Blend::AtOnce { .. } => {
                let mean = |&sum: &f32| self.mix.mse * f64::from(sum) / values;
                totals.iter().take(worlds.count).map(mean).collect()
            }
        };
        let last = totals.len() - QUAD;
        let rows = self.rows();
        let values = device.read_f32(&worlds.gradients, rows.len())?;
        let (mut splats, mut sh_rest) = (Vec::new(), Vec::new());
        rows.splats(&values, &mut splats);
        rows.sh_rest(&values, &mut sh_rest);
        let pose = pose(&worlds.pose[0].read(device)?);
        let background = std::array::from_fn(|c| f64::from(totals[last + c]));
        Ok(Gradients { loss, splats, sh_rest, background, pose })
    }

    fn rows(&self) -> Rows {
        Rows::new(self.scene.len() as usize, self.scene.degree(), self.degree)
    }
}

/// Sums of the pose over every 256th Gaussian in `gradients`, and over those: the last ones first.
fn pose_totals(device: &Device, gradients: &wgpu::Buffer, rows: Rows) -> Result<[Totals; 2], GpuError> {
    let parts = Totals::new(device, gradients, [rows.pose_stride() / 256, 256, POSE_ROWS])?;
    Ok([Totals::new(device, &parts.buffer, [256, 1, POSE_ROWS])?, parts])
}

/// The pose from its sums.
fn pose(sums: &[f32]) -> Pose {
    let sum = |k: usize| sums.get(k).map_or(0.0, |&v| f64::from(v));
    Pose { translation: [0, 1, 2].map(sum), rotation: [3, 4, 5].map(sum) }
}

#[cfg(test)]
mod tests;
