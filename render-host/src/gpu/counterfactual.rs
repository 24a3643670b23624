//! The counterfactual engine on the device: fast errors of whole worlds and utilities of all groups.
//!
//! A workgroup is a tile and a thread a pixel. Sixteen worlds of a pixel are registers; per block of
//! 8 × 4 pixels, consecutive splats of one group are composed once to a run and then applied to the
//! sixteen. Sums go over pixels, then over tiles, in fixed trees: the same bits every time, and a world's
//! number does not depend on the worlds beside it.
//!
//! *Fast* is without early stop, as [`crate::counterfactual::Engine::fast`]; against it, fed with the same f32
//! ellipses, errors differ by less than 2e-6 relative. *Strict* does the operations of the device's
//! [`super::Renderer`] in its order.

use super::states::{Common, QUAD, STATES, Scaffold, Totals, filled, masks, storage, submit, uniform};
use super::wgsl::{Bind, LAYOUT, Source, TILE};
use super::{Device, GpuError, Kernel, Tiles};
use crate::counterfactual::{States, Utilities, Variants};
use crate::image::{Image, same_size};
use crate::{Camera, Settings};

/// Worlds that one thread composes.
const LANES: usize = 16;
/// Bytes of the table of utilities of one dispatch; more contexts take several.
const TABLE_BYTES: usize = 1 << 26;

const SHARED: &str = include_str!("../counterfactual/lanes.wgsl");

/// Squared errors of worlds.
pub const FAST: Source = Source {
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
pub const STRICT: Source = Source {
    name: "strict.wgsl",
    parts: &[LAYOUT, TILE, STATES, SHARED, include_str!("../counterfactual/strict.wgsl")],
    bindings: FAST.bindings,
};

/// Utilities of groups.
pub const UTILITIES: Source = Source {
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

/// The compiled kernels: once per device.
#[derive(Debug)]
pub struct Kernels {
    common: Common,
    fast: Kernel,
    strict: Kernel,
    utilities: Kernel,
}

impl Kernels {
    /// Compiles.
    ///
    /// # Errors
    /// The device refuses a shader.
    pub fn new(device: &Device) -> Result<Self, GpuError> {
        Ok(Self {
            common: Common::new(device)?,
            fast: Kernel::new(device, &FAST, "fast", &[])?,
            strict: Kernel::new(device, &STRICT, "strict", &[])?,
            utilities: Kernel::new(device, &UTILITIES, "utilities", &[])?,
        })
    }
}

/// What all worlds share, ready for questions: one scene, one camera, one reference image.
#[derive(Debug)]
pub struct Engine<'k> {
    device: Device,
    kernels: &'k Kernels,
    scaffold: Scaffold,
    wanted: wgpu::Buffer,
}

/// Worlds whose errors are asked for, on the device.
#[derive(Debug)]
pub struct Worlds {
    count: usize,
    bound: wgpu::BindGroup,
    strict: wgpu::BindGroup,
    totals: Totals,
    workgroups: [u32; 3],
}

/// Contexts whose utilities are asked for, on the device.
#[derive(Debug)]
pub struct Contexts {
    states: States,
    pieces: Vec<Piece>,
}

/// As many contexts as one table holds.
#[derive(Debug)]
struct Piece {
    bound: wgpu::BindGroup,
    totals: Totals,
    workgroups: [u32; 3],
}

impl<'k> Engine<'k> {
    /// Projects, orders and bins all variants as `camera` sees them, and uploads. Errors are measured
    /// against `reference`, as sums of squares over all channels of all pixels.
    ///
    /// # Errors
    /// A setting out of range, a reference of another size than the camera, or a buffer that the device
    /// does not grant.
    pub fn new(
        device: &Device,
        kernels: &'k Kernels,
        variants: &Variants,
        camera: &Camera,
        reference: &Image,
        settings: &Settings,
    ) -> Result<Self, GpuError> {
        let tiles = Tiles::from_cpu(device, variants, camera, settings)?;
        let out = Self::with_tiles(device, kernels, tiles, variants.count(), reference)?;
        submit(device, |pass| out.encode_lists(pass));
        Ok(out)
    }

    /// As [`Engine::new`], from lists that are made on the device: after them, and before any question,
    /// [`Engine::encode_lists`] must run.
    ///
    /// # Errors
    /// A reference of another size than the tiles, or a buffer that the device does not grant.
    pub fn with_tiles(
        device: &Device,
        kernels: &'k Kernels,
        tiles: Tiles,
        groups: usize,
        reference: &Image,
    ) -> Result<Self, GpuError> {
        let mut film = Image::default();
        film.reset(tiles.size[0], tiles.size[1])?;
        same_size(&film, reference)?;
        let wanted = filled(device, "reference", bytemuck::cast_slice(reference.rgb()))?;
        let scaffold = Scaffold::new(device, &kernels.common, tiles, groups)?;
        Ok(Self { device: device.clone(), kernels, scaffold, wanted })
    }

    /// Squared error of each world without early stop.
    ///
    /// # Errors
    /// States of another number of groups, no memory, or a device that was lost.
    pub fn fast(&self, states: &States) -> Result<Vec<f64>, GpuError> {
        let worlds = self.worlds(states)?;
        self.submit_fast(&worlds);
        self.read_fast(&worlds)
    }

    /// Squared error of each world as it is drawn alone: of each pixel and each sum the bits of a scene of
    /// what the world holds.
    ///
    /// # Errors
    /// As [`Engine::fast`].
    pub fn strict(&self, states: &States) -> Result<Vec<f64>, GpuError> {
        let worlds = self.worlds(states)?;
        submit(&self.device, |pass| self.encode_strict(&worlds, pass));
        self.read_fast(&worlds)
    }

    /// The commands of [`Engine::strict`].
    pub fn encode_strict(&self, worlds: &Worlds, pass: &mut wgpu::ComputePass) {
        self.kernels.strict.run(pass, &worlds.strict, worlds.workgroups);
        worlds.totals.add_up(&self.kernels.common, pass);
    }

    /// Uploads worlds.
    ///
    /// # Errors
    /// States of another number of groups, or no memory.
    pub fn worlds(&self, states: &States) -> Result<Worlds, GpuError> {
        self.scaffold.check(states)?;
        let (device, tiles) = (&self.device, &self.scaffold.tiles);
        let [columns, rows] = tiles.grid();
        let pieces = states.len().div_ceil(LANES);
        let quads = pieces * LANES / QUAD;
        let batch = self.scaffold.batch(states.len(), quads);
        let batch = uniform(device, "batch", bytemuck::bytes_of(&batch))?;
        let masks = filled(device, "masks", bytemuck::cast_slice(&masks(states, quads)))?;
        let stride = QUAD * quads;
        let partials = storage(device, "partials", (4 * stride * tiles.count()) as u64)?;
        let buffers = self.buffers(&batch, &masks, &partials);
        let bound = self.kernels.fast.bind(device, &buffers);
        let strict = self.kernels.strict.bind(device, &buffers);
        let totals = Totals::new(device, &self.kernels.common, &partials, [tiles.count(), stride, 1])?;
        let workgroups = [columns, rows, pieces as u32];
        Ok(Worlds { count: states.len(), bound, strict, totals, workgroups })
    }

    /// Starts computing the errors of `worlds`; nothing is waited for.
    pub fn submit_fast(&self, worlds: &Worlds) {
        submit(&self.device, |pass| self.encode_fast(worlds, pass));
    }

    /// The commands of [`Engine::submit_fast`].
    pub fn encode_fast(&self, worlds: &Worlds, pass: &mut wgpu::ComputePass) {
        self.kernels.fast.run(pass, &worlds.bound, worlds.workgroups);
        worlds.totals.add_up(&self.kernels.common, pass);
    }

    /// The commands that look through the lists again: where they are made anew for each frame.
    pub fn encode_lists(&self, pass: &mut wgpu::ComputePass) {
        self.scaffold.fill(&self.kernels.common, pass);
    }

    /// Waits, and reads the errors.
    ///
    /// # Errors
    /// A device that was lost.
    pub fn read_fast(&self, worlds: &Worlds) -> Result<Vec<f64>, GpuError> {
        let found = worlds.totals.read(&self.device)?;
        Ok(found.into_iter().take(worlds.count).map(f64::from).collect())
    }

    /// Δ_g(m) of every group g in every context m: leave-one-out of those present and add-one-in of those
    /// absent. Arithmetic as in [`Engine::fast`].
    ///
    /// # Errors
    /// As [`Engine::fast`].
    pub fn utilities(&self, contexts: &States) -> Result<Utilities, GpuError> {
        let contexts = self.contexts(contexts)?;
        self.submit_utilities(&contexts);
        self.read_utilities(&contexts)
    }

    /// Uploads contexts.
    ///
    /// # Errors
    /// As [`Engine::worlds`].
    pub fn contexts(&self, states: &States) -> Result<Contexts, GpuError> {
        self.scaffold.check(states)?;
        let (device, tiles) = (&self.device, &self.scaffold.tiles);
        let [columns, rows] = tiles.grid();
        let quads = states.len().div_ceil(QUAD);
        let width = self.scaffold.groups + 1;
        let table = width * tiles.count();
        let most = (TABLE_BYTES / (4 * table).max(1)).clamp(1, 65_535);
        let masks = filled(device, "masks", bytemuck::cast_slice(&masks(states, quads)))?;
        let partials = storage(device, "utilities", (4 * table * most.min(states.len())) as u64)?;
        let mut pieces = Vec::new();
        for first in (0..states.len()).step_by(most) {
            let count = most.min(states.len() - first);
            let batch = self.scaffold.batch(states.len(), quads);
            let batch = super::states::Batch { first: first as u32, ..batch };
            let batch = uniform(device, "batch", bytemuck::bytes_of(&batch))?;
            let [frame, batch, splats, starts, entries, masks, wanted, partials] =
                self.buffers(&batch, &masks, &partials);
            let sets = &self.scaffold.sets;
            let buffers = [frame, batch, splats, starts, entries, masks, wanted, partials, sets];
            let bound = self.kernels.utilities.bind(device, &buffers);
            let totals = Totals::new(device, &self.kernels.common, partials, [tiles.count(), width, count])?;
            pieces.push(Piece { bound, totals, workgroups: [columns, rows, count as u32] });
        }
        Ok(Contexts { states: states.clone(), pieces })
    }

    /// Starts computing the utilities of all groups in `contexts`; nothing is waited for.
    pub fn submit_utilities(&self, contexts: &Contexts) {
        submit(&self.device, |pass| self.encode_utilities(contexts, pass));
    }

    /// The commands of [`Engine::submit_utilities`].
    pub fn encode_utilities(&self, contexts: &Contexts, pass: &mut wgpu::ComputePass) {
        for piece in &contexts.pieces {
            self.kernels.utilities.run(pass, &piece.bound, piece.workgroups);
            piece.totals.add_up(&self.kernels.common, pass);
        }
    }

    /// Waits, and reads the utilities.
    ///
    /// # Errors
    /// A device that was lost.
    pub fn read_utilities(&self, contexts: &Contexts) -> Result<Utilities, GpuError> {
        let groups = self.scaffold.groups;
        let mut out = Utilities { groups, sse: Vec::new(), delta: Vec::new() };
        for piece in &contexts.pieces {
            for row in piece.totals.read(&self.device)?.chunks_exact(groups + 1) {
                out.sse.push(f64::from(row[0]));
                out.delta.extend(row[1..].iter().map(|&v| f64::from(v)));
            }
        }
        debug_assert_eq!(out.sse.len(), contexts.states.len());
        Ok(out)
    }

    /// Number of groups.
    pub fn groups(&self) -> usize {
        self.scaffold.groups
    }

    fn buffers<'a>(
        &'a self,
        batch: &'a wgpu::Buffer,
        masks: &'a wgpu::Buffer,
        partials: &'a wgpu::Buffer,
    ) -> [&'a wgpu::Buffer; 8] {
        let Scaffold { tiles, entries, .. } = &self.scaffold;
        [&tiles.frame, batch, &tiles.splats, &tiles.starts, entries, masks, &self.wanted, partials]
    }
}

#[cfg(test)]
mod tests;
