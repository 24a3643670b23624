//! Kernels over many states of one scene share structs, tile lists and sums (`counterfactual/states.wgsl`).

use bytemuck::{Pod, Zeroable};

use super::{
    Device, GpuError, Tiles,
    recording::Recording,
    source::{Bind, Kernel, LAYOUT, Source, TILE},
};
use crate::counterfactual::States;

/// Structs and constants of kernels over many states.
pub(super) const STATES: &str = include_str!("../counterfactual/states.wgsl");

/// The blocks that entries touch and the groups that blocks meet.
pub static SHARED_LISTS: Source = Source {
    name: "shared_lists.wgsl",
    parts: &[LAYOUT, TILE, STATES, include_str!("../counterfactual/shared_lists.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("splats", Bind::Read),
        ("starts", Bind::Read),
        ("list", Bind::Read),
        ("entries", Bind::Write),
        ("sets", Bind::Write),
    ],
};

/// Sums of columns of a table.
pub static COLUMN_SUMS: Source = Source {
    name: "column_sums.wgsl",
    parts: &[LAYOUT, include_str!("../counterfactual/column_sums.wgsl")],
    bindings: &[("table", Bind::Uniform), ("values", Bind::Read), ("totals", Bind::Write)],
};

/// Worlds per vector.
pub const QUAD: usize = 4;
/// Blocks of a tile.
const BLOCKS: u64 = 8;

/// A batch of worlds: a uniform buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Batch {
    /// Number of groups.
    pub groups: u32,
    /// Words of a set of groups.
    pub words: u32,
    /// Number of worlds.
    pub worlds: u32,
    /// Vectors of four worlds per row of masks.
    pub quads: u32,
    /// Gradient of the loss with respect to half a squared difference.
    pub scale: f32,
    /// Places for what tiles find, per tile.
    pub columns: u32,
    /// First world.
    pub first: u32,
    /// World after the last one.
    pub past: u32,
}

/// One splat of a tile's list.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Entry {
    /// Index of the splat.
    pub splat: u32,
    /// A bit per block of the tile that the splat may touch.
    pub blocks: u32,
}

/// Size of a table whose columns are added up.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Table {
    /// Rows.
    pub rows: u32,
    /// Columns.
    pub columns: u32,
    /// Padding.
    pub unused: [u32; 2],
}

/// Tile lists with the blocks that their entries touch: the same for every batch of states.
#[derive(Debug)]
pub(super) struct SharedLists {
    pub(super) tiles: Tiles,
    pub(super) groups: usize,
    pub(super) words: usize,
    pub(super) entries: wgpu::Buffer,
    pub(super) sets: wgpu::Buffer,
    /// A [`Batch`], of which groups and words are read.
    pub(super) batch: wgpu::Buffer,
}

impl SharedLists {
    pub(super) fn new(device: &Device, tiles: Tiles, groups: usize) -> Result<Self, GpuError> {
        let words = groups.div_ceil(32).max(1);
        let entries = device.storage("entries", 8 * tiles.capacity as u64)?;
        let sets = device.storage("sets", set_bytes(&tiles, words))?;
        let batch = Batch { groups: groups as u32, words: words as u32, ..Batch::default() };
        let batch = device.uniform("batch", bytemuck::bytes_of(&batch))?;
        Ok(Self { tiles, groups, words, entries, sets, batch })
    }

    /// Records filling the entries: once for lists that stay, each frame for lists that change.
    pub(super) fn record(&self, recording: &mut Recording) {
        let Self { tiles, entries, sets, batch, .. } = self;
        let [columns, rows] = tiles.grid();
        let buffers = [&tiles.frame, batch, &tiles.splats, &tiles.starts, &tiles.list, entries, sets];
        recording.dispatch(Kernel::new(&SHARED_LISTS, "shared_lists"), &buffers, [columns, rows, 1]);
    }

    /// The batch of `worlds` worlds whose rows of masks have `quads` vectors.
    pub(super) fn batch(&self, worlds: usize, quads: usize) -> Batch {
        let [groups, words] = [self.groups, self.words].map(|v| v as u32);
        let worlds = worlds as u32;
        Batch { groups, words, worlds, quads: quads as u32, past: worlds, ..Batch::default() }
    }

    /// An error unless `states` are of these lists' groups.
    pub(super) fn check(&self, states: &States) -> Result<(), GpuError> {
        let (found, needed) = (states.groups(), self.groups);
        if found == needed {
            Ok(())
        } else {
            Err(GpuError::Length { field: "groups of the states", found, needed })
        }
    }
}

/// Bytes of the sets of groups of all blocks, of `words` words each.
pub(super) fn set_bytes(tiles: &Tiles, words: usize) -> u64 {
    tiles.count() as u64 * BLOCKS * 8 * words as u64
}

/// Per group a row of `quads` vectors: 1 for the worlds that hold it, 0 for the others and for padding.
pub(super) fn masks(states: &States, quads: usize) -> Vec<f32> {
    let stride = QUAD * quads;
    let mut out = vec![0.0; states.groups() * stride];
    for (group, row) in out.chunks_exact_mut(stride.max(1)).enumerate() {
        for (world, mask) in row.iter_mut().take(states.len()).enumerate() {
            *mask = f32::from(u8::from(states.has(world, group)));
        }
    }
    out
}

/// Sums over the rows of `count` tables, on the device.
#[derive(Debug)]
pub(super) struct Totals {
    pub(super) buffer: wgpu::Buffer,
    table: wgpu::Buffer,
    values: wgpu::Buffer,
    columns: u32,
    count: u32,
}

impl Totals {
    /// Room for the sums of `values`: `count` tables of `rows` by `columns` numbers.
    pub(super) fn new(
        device: &Device,
        values: &wgpu::Buffer,
        [rows, columns, count]: [usize; 3],
    ) -> Result<Self, GpuError> {
        let [rows, columns, count] = [rows, columns, count].map(|v| v as u32);
        let table = Table { rows, columns, unused: [0; 2] };
        let table = device.uniform("table", bytemuck::bytes_of(&table))?;
        let buffer = device.storage("totals", 4 * u64::from(columns) * u64::from(count))?;
        Ok(Self { buffer, table, values: values.clone(), columns, count })
    }

    /// Records adding up.
    pub(super) fn record(&self, recording: &mut Recording) {
        let buffers = [&self.table, &self.values, &self.buffer];
        let workgroups = [self.columns.div_ceil(16), 1, self.count];
        recording.dispatch(Kernel::new(&COLUMN_SUMS, "column_sums"), &buffers, workgroups);
    }

    /// Bytes of the sums.
    pub(super) fn bytes(&self) -> u64 {
        4 * u64::from(self.columns) * u64::from(self.count)
    }

    /// Waits, and reads the sums, table after table.
    pub(super) fn read(&self, device: &Device) -> Result<Vec<f32>, GpuError> {
        device.read_f32(&self.buffer, (self.columns * self.count) as usize)
    }
}
