//! Gradients of many worlds on the device: squared error and `1 - SSIM` against one picture, in any mix,
//! summed over the worlds of a camera, with respect to everything a Gaussian has, the background and the
//! camera's pose.
//!
//! Of squared error alone, `adjoint/blend.wgsl` goes front to back, judges, and goes back to front, four
//! worlds in lanes. With `1 - SSIM` in the mix it only goes back: `adjoint/film.wgsl` has gone to the front
//! and kept pictures and transmittances, and `adjoint/loss/ssim.wgsl` has made gradients of the pictures.
//! What pulls at a splat is added up over worlds before it is taken further; `adjoint/project.wgsl` takes
//! those sums back to the Gaussians, once for all worlds. Sums have one order, and nothing is divided by
//! `1 - alpha` or a transmittance.
//!
//! What is differentiated, and where gradients are 0, is as in [`crate::adjoint`]; arithmetic is f32.

use super::states::{
    Batch, Common, QUAD, STATES, Scaffold, Totals, filled, masks, read, storage, submit, uniform,
};
use super::wgsl::{Bind, LAYOUT, Source, TILE};
use super::{Device, GpuError, Kernel, Scene, Tiles, groups_2d};
use crate::adjoint::loss::Mix;
use crate::adjoint::{Pose, SplatGradient};
use crate::counterfactual::{States, Variants};
use crate::harmonics::count;
use crate::image::{Image, same_size};
use crate::{Camera, Settings};
use structure::{Chunks, KEPT_BYTES, Structure};

pub mod structure;

/// Entries between two kept transmittances.
const SEGMENT: usize = 32;
/// Rows of gradients before those of higher bands.
const ROWS: usize = 16;
/// Rows of the pose.
const POSE_ROWS: usize = 6;
/// Bytes of a vector of four.
const VECTOR: usize = 16;

/// What goes from front to back, and what stays in workgroup memory on the way back.
const FORWARD: &str = include_str!("../adjoint/forward.wgsl");

/// Adjoint of stage 4, and squared error.
pub const BLEND_BACK: Source = Source {
    name: "adjoint/blend.wgsl",
    parts: &[LAYOUT, TILE, STATES, FORWARD, include_str!("../adjoint/blend.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("splats", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("masks", Bind::Read),
        ("marks", Bind::Write),
        ("wanted", Bind::Read),
        ("partials", Bind::Write),
        ("found", Bind::Write),
    ],
};

/// Adjoint of stage 1.
pub const PROJECT_BACK: Source = Source {
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

/// The compiled kernels: once per device.
#[derive(Debug)]
pub struct Kernels {
    common: Common,
    blend: Kernel,
    structure: structure::Kernels,
    project: Kernel,
}

impl Kernels {
    /// Compiles.
    ///
    /// # Errors
    /// The device refuses a shader.
    pub fn new(device: &Device) -> Result<Self, GpuError> {
        Ok(Self {
            common: Common::new(device)?,
            blend: Kernel::new(device, &BLEND_BACK, "blend_back", &[])?,
            structure: structure::Kernels::new(device)?,
            project: Kernel::new(device, &PROJECT_BACK, "project_back", &[])?,
        })
    }
}

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
pub struct Engine<'k> {
    device: Device,
    kernels: &'k Kernels,
    scaffold: Scaffold,
    scene: Scene,
    wanted: wgpu::Buffer,
    mix: Mix,
    /// `None` where the mix is of squared error alone.
    structure: Option<Structure>,
    /// Bytes of a buffer of what is kept of worlds.
    kept: usize,
    /// Degree that is rendered.
    degree: u8,
}

/// Worlds whose gradients are asked for, on the device.
#[derive(Debug)]
pub struct Worlds {
    count: usize,
    blend: Blend,
    project: wgpu::BindGroup,
    totals: Totals,
    /// Sums of the pose over every 256th Gaussian, and over those.
    pose: [Totals; 2],
    gradients: wgpu::Buffer,
}

/// How worlds are blended back.
#[derive(Debug)]
enum Blend {
    /// Forward, squared error and back in one.
    AtOnce(wgpu::BindGroup),
    /// With pictures in between.
    Kept(Chunks),
}

/// Buffers that all chunks of worlds read or add to.
struct Shared<'a> {
    tiles: &'a Tiles,
    entries: &'a wgpu::Buffer,
    masks: &'a wgpu::Buffer,
    wanted: &'a wgpu::Buffer,
    partials: &'a wgpu::Buffer,
    found: &'a wgpu::Buffer,
    /// Bytes of a buffer that chunks share.
    kept: usize,
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

impl<'k> Engine<'k> {
    /// Projects, orders and bins all variants as `camera` sees them, and uploads.
    ///
    /// # Errors
    /// A setting out of range, a target of another size than the camera, or a buffer that the device does
    /// not grant.
    pub fn new(
        device: &Device,
        kernels: &'k Kernels,
        variants: &Variants,
        camera: &Camera,
        objective: &Objective,
        settings: &Settings,
    ) -> Result<Self, GpuError> {
        let tiles = Tiles::from_cpu(device, variants, camera, settings)?;
        let scene = Scene::with_groups(device, &variants.splats(), variants.groups())?;
        Self::with_tiles(device, kernels, scene, tiles, variants.count(), objective, settings)
    }

    /// As [`Engine::new`], from a scene and tile lists that are on the device already.
    ///
    /// # Errors
    /// A target of another size than the lists, or a buffer that the device does not grant.
    pub fn with_tiles(
        device: &Device,
        kernels: &'k Kernels,
        scene: Scene,
        tiles: Tiles,
        groups: usize,
        objective: &Objective,
        settings: &Settings,
    ) -> Result<Self, GpuError> {
        let Objective { target, mix } = *objective;
        let mut film = Image::default();
        film.reset(tiles.size[0], tiles.size[1])?;
        same_size(&film, target)?;
        let degree = settings.max_sh_degree.min(scene.degree());
        let wanted = filled(device, "target", bytemuck::cast_slice(target.rgb()))?;
        let structure = if mix.structure == 0.0 { None } else { Some(Structure::new(device, target, mix)?) };
        let scaffold = Scaffold::new(device, &kernels.common, tiles, groups)?;
        let (device, kept) = (device.clone(), KEPT_BYTES);
        Ok(Self { device, kernels, scaffold, scene, wanted, mix, structure, kept, degree })
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
        self.submit(&worlds);
        self.read(&worlds)
    }

    /// Uploads worlds and makes room for their gradients.
    ///
    /// # Errors
    /// States of another number of groups, or no memory.
    pub fn worlds(&self, states: &States) -> Result<Worlds, GpuError> {
        self.scaffold.check(states)?;
        let (device, tiles) = (&self.device, &self.scaffold.tiles);
        let quads = states.len().div_ceil(QUAD);
        let columns = QUAD * quads + QUAD;
        let values = 3 * u64::from(tiles.size[0]) * u64::from(tiles.size[1]);
        let batch = Batch {
            scale: (2.0 * self.mix.mse / values as f64) as f32,
            columns: columns as u32,
            ..self.scaffold.batch(states.len(), quads)
        };
        let masks = filled(device, "masks", bytemuck::cast_slice(&masks(states, quads)))?;
        let partials = storage(device, "pulls of entries", (3 * VECTOR * tiles.capacity) as u64)?;
        let segments = tiles.capacity / SEGMENT + tiles.count() + 1;
        let marks = VECTOR * 256 * segments;
        let found = storage(device, "losses of tiles", (4 * columns * tiles.count()) as u64)?;
        let rows = ROWS + 3 * count(self.degree);
        let n = self.scene.len() as usize;
        let stride = n.next_multiple_of(256);
        let gradients = storage(device, "gradients", 4 * (POSE_ROWS * stride + rows * n) as u64)?;
        let common = &self.kernels.common;
        let pose = Totals::new(device, common, &gradients, [stride / 256, 256, POSE_ROWS])?;
        let pose = [Totals::new(device, common, &pose.buffer, [256, 1, POSE_ROWS])?, pose];
        let [gaussians, harmonics, _] = self.scene.buffers()?;
        let (frame, splats, starts) = (&tiles.frame, &tiles.splats, &tiles.starts);
        let entries = &self.scaffold.entries;
        let wanted = &self.wanted;
        let blend = if let Some(structure) = &self.structure {
            let (masks, partials, found) = (&masks, &partials, &found);
            let shared = Shared { tiles, entries, masks, wanted, partials, found, kept: self.kept };
            Blend::Kept(Chunks::new(device, self.kernels, structure, &shared, batch, marks)?)
        } else {
            let batch = uniform(device, "batch", bytemuck::bytes_of(&batch))?;
            let marks = storage(device, "transmittances", marks as u64)?;
            let bound = [frame, &batch, splats, starts, entries, &masks, &marks, wanted, &partials, &found];
            Blend::AtOnce(self.kernels.blend.bind(device, &bound))
        };
        let project =
            [frame, gaussians, harmonics, splats, &tiles.ranks, starts, entries, &partials, &gradients];
        Ok(Worlds {
            count: states.len(),
            blend,
            project: self.kernels.project.bind(device, &project),
            totals: Totals::new(device, &self.kernels.common, &found, [tiles.count(), columns, 1])?,
            pose,
            gradients,
        })
    }

    /// Starts computing the gradients of `worlds`; nothing is waited for.
    pub fn submit(&self, worlds: &Worlds) {
        submit(&self.device, |pass| self.encode(worlds, pass));
    }

    /// The commands of [`Engine::submit`], after those that make the lists.
    pub fn encode(&self, worlds: &Worlds, pass: &mut wgpu::ComputePass) {
        let [columns, rows] = self.scaffold.tiles.grid();
        self.scaffold.fill(&self.kernels.common, pass);
        match &worlds.blend {
            Blend::AtOnce(bound) => self.kernels.blend.run(pass, bound, [columns, rows, 1]),
            Blend::Kept(chunks) => chunks.encode(self.kernels, [columns, rows], pass),
        }
        worlds.totals.add_up(&self.kernels.common, pass);
        self.kernels.project.run(pass, &worlds.project, groups_2d(self.scene.len().div_ceil(256)));
        worlds.pose.iter().rev().for_each(|sums| sums.add_up(&self.kernels.common, pass));
    }

    /// Waits, and reads the gradients.
    ///
    /// # Errors
    /// A device that was lost.
    pub fn read(&self, worlds: &Worlds) -> Result<Gradients, GpuError> {
        let size = self.scaffold.tiles.size;
        let values = 3.0 * f64::from(size[0]) * f64::from(size[1]);
        let totals = worlds.totals.read(&self.device)?;
        let loss = match (&worlds.blend, &self.structure) {
            (Blend::Kept(chunks), Some(structure)) => chunks.read(&self.device, structure)?,
            _ => totals.iter().take(worlds.count).map(|&v| self.mix.mse * f64::from(v) / values).collect(),
        };
        let last = totals.len() - QUAD;
        let (n, degree) = (self.scene.len() as usize, self.scene.degree());
        let (bands, each) = (3 * count(self.degree), 3 * count(degree));
        let first = POSE_ROWS * n.next_multiple_of(256);
        let rows = read(&self.device, &worlds.gradients, first + (ROWS + bands) * n)?;
        let at = |row: usize, i: usize| rows[first + row * n + i];
        let pose: Vec<f64> = worlds.pose[0].read(&self.device)?.into_iter().map(f64::from).collect();
        let splats = (0..n).map(|i| SplatGradient {
            position: [0, 1, 2].map(|row| at(row, i)),
            log_scale: [3, 4, 5].map(|row| at(row, i)),
            rotation: [6, 7, 8, 9].map(|row| at(row, i)),
            opacity_logit: at(10, i),
            sh0: [11, 12, 13].map(|row| at(row, i)),
            film: [14, 15].map(|row| at(row, i)),
        });
        let mut sh_rest = vec![0.0; n * each];
        for (i, rest) in sh_rest.chunks_exact_mut(each.max(1)).enumerate() {
            (0..bands).for_each(|k| rest[k] = at(ROWS + k, i));
        }
        Ok(Gradients {
            loss,
            splats: splats.collect(),
            sh_rest,
            background: std::array::from_fn(|c| f64::from(totals[last + c])),
            pose: Pose {
                translation: std::array::from_fn(|k| pose[k]),
                rotation: std::array::from_fn(|k| pose[3 + k]),
            },
        })
    }
}

#[cfg(test)]
mod tests;
