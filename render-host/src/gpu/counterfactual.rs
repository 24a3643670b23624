//! The counterfactual engine computes errors of worlds and utilities of all groups on the device.
//!
//! A workgroup is a tile and a thread a pixel. Sixteen worlds of a pixel are registers; per block of
//! 8 × 4 pixels, consecutive splats of one group are composed once to a run and then applied to the
//! sixteen. Sums go over pixels, then over tiles, in fixed trees: the same bits every time, and a world's
//! number does not depend on the worlds beside it.
//!
//! *Fast* is without early stop, as [`crate::counterfactual::Engine::fast`]; against it, fed with the same
//! f32 ellipses, errors differ by less than 2e-6 relative. *Strict* does the operations of the device's
//! [`super::Renderer`] in its order.

use super::{
    Executor, GpuError, Tiles,
    recording::Recording,
    source::{Bind, Kernel, LAYOUT, Source, TILE},
    states::{Batch, QUAD, STATES, SharedLists, Totals, masks},
};
use crate::{
    Camera, Settings,
    counterfactual::{States, Utilities, Variants},
    image::{Image, same_size},
};

/// Worlds that one thread composes.
const LANES: usize = 16;
/// Bytes of the table of utilities of one dispatch; more contexts take several.
const TABLE_BYTES: usize = 1 << 26;

const SHARED: &str = include_str!("../counterfactual/world_lanes.wgsl");

/// Squared errors of worlds.
pub static FAST: Source = Source {
    name: "fast.wgsl",
    parts: &[LAYOUT, TILE, STATES, SHARED, include_str!("../counterfactual/fast.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("splats", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("masks", Bind::Read),
        ("wanted", Bind::Read),
        ("partials", Bind::Write),
    ],
};

/// Squared errors of worlds, each as it is drawn alone.
pub static STRICT: Source = Source {
    name: "strict.wgsl",
    parts: &[LAYOUT, TILE, STATES, SHARED, include_str!("../counterfactual/strict.wgsl")],
    bindings: FAST.bindings,
};

/// Utilities of groups.
pub static UTILITIES: Source = Source {
    name: "utilities.wgsl",
    parts: &[LAYOUT, TILE, STATES, SHARED, include_str!("../counterfactual/utilities.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("splats", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("masks", Bind::Read),
        ("wanted", Bind::Read),
        ("partials", Bind::Write),
        ("sets", Bind::Read),
    ],
};

/// What all worlds share, ready for questions: one scene, one camera, one reference image.
#[derive(Debug)]
pub struct Engine {
    executor: Executor,
    lists: SharedLists,
    wanted: wgpu::Buffer,
}

/// Worlds whose errors are wanted, on the device.
#[derive(Debug)]
pub struct Worlds {
    count: usize,
    batch: wgpu::Buffer,
    masks: wgpu::Buffer,
    partials: wgpu::Buffer,
    totals: Totals,
    workgroups: [u32; 3],
}

/// Contexts whose utilities are wanted, on the device.
#[derive(Debug)]
pub struct Contexts {
    count: usize,
    masks: wgpu::Buffer,
    partials: wgpu::Buffer,
    pieces: Vec<Piece>,
}

/// As many contexts as one table holds.
#[derive(Debug)]
struct Piece {
    batch: wgpu::Buffer,
    totals: Totals,
    workgroups: [u32; 3],
}

impl Engine {
    /// Projects, orders and bins all variants as `camera` sees them, and uploads. Errors are measured
    /// against `reference`, as sums of squares over all channels of all pixels.
    ///
    /// # Errors
    /// A setting out of range, a reference of another size than the camera, or a buffer that the device
    /// does not grant.
    pub fn new(
        executor: &Executor,
        variants: &Variants,
        camera: &Camera,
        reference: &Image,
        settings: &Settings,
    ) -> Result<Self, GpuError> {
        let tiles = Tiles::from_cpu(executor.device(), variants, camera, settings)?;
        let out = Self::with_tiles(executor, tiles, variants.count(), reference)?;
        let mut recording = Recording::new();
        out.record_lists(&mut recording);
        executor.run(recording)?;
        Ok(out)
    }

    /// As [`Engine::new`], from lists that are made on the device: after them, and before any question,
    /// the work of [`Engine::record_lists`] must run.
    ///
    /// # Errors
    /// A reference of another size than the tiles, or a buffer that the device does not grant.
    pub fn with_tiles(
        executor: &Executor,
        tiles: Tiles,
        groups: usize,
        reference: &Image,
    ) -> Result<Self, GpuError> {
        let mut blank = Image::default();
        blank.reset(tiles.size[0], tiles.size[1])?;
        same_size(&blank, reference)?;
        let device = executor.device();
        let wanted = device.filled("reference", bytemuck::cast_slice(reference.rgb()))?;
        let lists = SharedLists::new(device, tiles, groups)?;
        Ok(Self { executor: executor.clone(), lists, wanted })
    }

    /// Squared error of each world without early stop.
    ///
    /// # Errors
    /// States of another number of groups, no memory, or a device that was lost.
    pub fn fast(&self, states: &States) -> Result<Vec<f64>, GpuError> {
        let worlds = self.worlds(states)?;
        let mut recording = Recording::new();
        self.record_fast(&worlds, &mut recording);
        self.executor.run(recording)?;
        self.read_errors(&worlds)
    }

    /// Squared error of each world as it is drawn alone: of each pixel and each sum the bits of a scene of
    /// what the world holds.
    ///
    /// # Errors
    /// As [`Engine::fast`].
    pub fn strict(&self, states: &States) -> Result<Vec<f64>, GpuError> {
        let worlds = self.worlds(states)?;
        let mut recording = Recording::new();
        self.record_strict(&worlds, &mut recording);
        self.executor.run(recording)?;
        self.read_errors(&worlds)
    }

    /// Uploads worlds.
    ///
    /// # Errors
    /// States of another number of groups, or no memory.
    pub fn worlds(&self, states: &States) -> Result<Worlds, GpuError> {
        self.lists.check(states)?;
        let (device, tiles) = (self.executor.device(), &self.lists.tiles);
        let [columns, rows] = tiles.grid();
        let pieces = states.len().div_ceil(LANES);
        let quads = pieces * LANES / QUAD;
        let batch = self.lists.batch(states.len(), quads);
        let stride = QUAD * quads;
        let partials = device.storage("partials", (4 * stride * tiles.count()) as u64)?;
        Ok(Worlds {
            count: states.len(),
            batch: device.uniform("batch", bytemuck::bytes_of(&batch))?,
            masks: device.filled("masks", bytemuck::cast_slice(&masks(states, quads)))?,
            totals: Totals::new(device, &partials, [tiles.count(), stride, 1])?,
            partials,
            workgroups: [columns, rows, pieces as u32],
        })
    }

    /// Records the work of [`Engine::fast`].
    pub fn record_fast(&self, worlds: &Worlds, recording: &mut Recording) {
        self.record_errors(&FAST, "fast", worlds, recording);
    }

    /// Records the work of [`Engine::strict`].
    pub fn record_strict(&self, worlds: &Worlds, recording: &mut Recording) {
        self.record_errors(&STRICT, "strict", worlds, recording);
    }

    fn record_errors(
        &self,
        source: &'static Source,
        entry: &'static str,
        worlds: &Worlds,
        recording: &mut Recording,
    ) {
        let Worlds { batch, masks, partials, totals, workgroups, .. } = worlds;
        let buffers = self.buffers(batch, masks, partials);
        recording.dispatch(Kernel::new(source, entry), &buffers, *workgroups);
        totals.record(recording);
    }

    /// Records looking through the lists again: where they are made anew for each frame.
    pub fn record_lists(&self, recording: &mut Recording) {
        self.lists.record(recording);
    }

    /// Waits, and reads the errors.
    ///
    /// # Errors
    /// A device that was lost.
    pub fn read_errors(&self, worlds: &Worlds) -> Result<Vec<f64>, GpuError> {
        let found = worlds.totals.read(self.executor.device())?;
        Ok(found.into_iter().take(worlds.count).map(f64::from).collect())
    }

    /// Δ_g(m) of every group g in every context m: leave-one-out of those present and add-one-in of those
    /// absent. Arithmetic as in [`Engine::fast`].
    ///
    /// # Errors
    /// As [`Engine::fast`].
    pub fn utilities(&self, contexts: &States) -> Result<Utilities, GpuError> {
        let contexts = self.contexts(contexts)?;
        let mut recording = Recording::new();
        self.record_utilities(&contexts, &mut recording);
        self.executor.run(recording)?;
        self.read_utilities(&contexts)
    }

    /// Uploads contexts.
    ///
    /// # Errors
    /// As [`Engine::worlds`].
    pub fn contexts(&self, states: &States) -> Result<Contexts, GpuError> {
        self.lists.check(states)?;
        let (device, tiles) = (self.executor.device(), &self.lists.tiles);
        let [columns, rows] = tiles.grid();
        let quads = states.len().div_ceil(QUAD);
        let width = self.lists.groups + 1;
        let table = width * tiles.count();
        let most = (TABLE_BYTES / (4 * table).max(1)).clamp(1, 65_535);
        let masks = device.filled("masks", bytemuck::cast_slice(&masks(states, quads)))?;
        let partials = device.storage("utilities", (4 * table * most.min(states.len())) as u64)?;
        let mut pieces = Vec::new();
        for first in (0..states.len()).step_by(most) {
            let count = most.min(states.len() - first);
            let batch = Batch { first: first as u32, ..self.lists.batch(states.len(), quads) };
            pieces.push(Piece {
                batch: device.uniform("batch", bytemuck::bytes_of(&batch))?,
                totals: Totals::new(device, &partials, [tiles.count(), width, count])?,
                workgroups: [columns, rows, count as u32],
            });
        }
        Ok(Contexts { count: states.len(), masks, partials, pieces })
    }

    /// Records the work of [`Engine::utilities`].
    pub fn record_utilities(&self, contexts: &Contexts, recording: &mut Recording) {
        let Contexts { masks, partials, pieces, .. } = contexts;
        for Piece { batch, totals, workgroups } in pieces {
            let [frame, batch, splats, starts, entries, masks, wanted, partials] =
                self.buffers(batch, masks, partials);
            let sets = &self.lists.sets;
            let buffers = [frame, batch, splats, starts, entries, masks, wanted, partials, sets];
            recording.dispatch(Kernel::new(&UTILITIES, "utilities"), &buffers, *workgroups);
            totals.record(recording);
        }
    }

    /// Waits, and reads the utilities.
    ///
    /// # Errors
    /// A device that was lost.
    pub fn read_utilities(&self, contexts: &Contexts) -> Result<Utilities, GpuError> {
        let groups = self.lists.groups;
        let mut out = Utilities { groups, sse: Vec::new(), delta: Vec::new() };
        for piece in &contexts.pieces {
            for row in piece.totals.read(self.executor.device())?.chunks_exact(groups + 1) {
                out.sse.push(f64::from(row[0]));
                out.delta.extend(row[1..].iter().map(|&v| f64::from(v)));
            }
        }
        debug_assert_eq!(out.sse.len(), contexts.count);
        Ok(out)
    }

    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.lists.groups
    }

    fn buffers<'a>(
        &'a self,
        batch: &'a wgpu::Buffer,
        masks: &'a wgpu::Buffer,
        partials: &'a wgpu::Buffer,
    ) -> [&'a wgpu::Buffer; 8] {
        let SharedLists { tiles, entries, .. } = &self.lists;
        [&tiles.frame, batch, &tiles.splats, &tiles.starts, entries, masks, &self.wanted, partials]
    }
}

#[cfg(test)]
mod tests;
