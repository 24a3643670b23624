//! What kernels over many states of one scene share: `counterfactual/states.wgsl` in Rust.

use bytemuck::{Pod, Zeroable};

use super::wgsl::{LAYOUT, TILE};
use super::{Device, GpuError, Kernel, Tiles, wgsl};
use crate::counterfactual::States;

/// Structs and constants of kernels over many states.
pub(super) const STATES: &str = include_str!("../counterfactual/states.wgsl");

/// The blocks that entries touch and the groups that blocks meet.
pub const SCAFFOLD: wgsl::Source = wgsl::Source {
    name: "scaffold.wgsl",
    parts: &[LAYOUT, TILE, STATES, include_str!("../counterfactual/scaffold.wgsl")],
    bindings: &[
        ("frame", wgsl::Bind::Uniform),
        ("batch", wgsl::Bind::Uniform),
        ("splats", wgsl::Bind::Read),
        ("starts", wgsl::Bind::Read),
        ("list", wgsl::Bind::Read),
        ("entries", wgsl::Bind::Write),
        ("sets", wgsl::Bind::Write),
    ],
};

/// Sums of columns of a table.
pub const SQUARES: wgsl::Source = wgsl::Source {
    name: "squares.wgsl",
    parts: &[LAYOUT, include_str!("../counterfactual/squares.wgsl")],
    bindings: &[("table", wgsl::Bind::Uniform), ("values", wgsl::Bind::Read), ("totals", wgsl::Bind::Write)],
};

/// Worlds per vector.
pub const QUAD: usize = 4;
/// Blocks of a tile.
const BLOCKS: u64 = 8;

/// What a kernel over many states is told, besides the frame.
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

/// Kernels that every engine over states runs.
#[derive(Debug)]
pub(super) struct Common {
    pub(super) scaffold: Kernel,
    pub(super) squares: Kernel,
}

impl Common {
    pub(super) fn new(device: &Device) -> Result<Self, GpuError> {
        Ok(Self {
            scaffold: Kernel::new(device, &SCAFFOLD, "scaffold", &[])?,
            squares: Kernel::new(device, &SQUARES, "squares", &[])?,
        })
    }
}

/// Tile lists with what blocks they touch: the same for every batch of states.
#[derive(Debug)]
pub(super) struct Scaffold {
    pub(super) tiles: Tiles,
    pub(super) groups: usize,
    pub(super) words: usize,
    pub(super) entries: wgpu::Buffer,
    pub(super) sets: wgpu::Buffer,
    bound: wgpu::BindGroup,
}

impl Scaffold {
    pub(super) fn new(
        device: &Device,
        common: &Common,
        tiles: Tiles,
        groups: usize,
    ) -> Result<Self, GpuError> {
        let words = groups.div_ceil(32).max(1);
        let entries = storage(device, "entries", 8 * tiles.capacity as u64)?;
        let sets = storage(device, "sets", tiles.count() as u64 * BLOCKS * 8 * words as u64)?;
        let batch = Batch { groups: groups as u32, words: words as u32, ..Batch::default() };
        let batch = uniform(device, "batch", bytemuck::bytes_of(&batch))?;
        let buffers = [&tiles.frame, &batch, &tiles.splats, &tiles.starts, &tiles.list, &entries, &sets];
        let bound = common.scaffold.bind(device, &buffers);
        Ok(Self { tiles, groups, words, entries, sets, bound })
    }

    /// Fills the entries: once for lists that stay, each frame for lists that change.
    pub(super) fn fill(&self, common: &Common, pass: &mut wgpu::ComputePass) {
        let [columns, rows] = self.tiles.grid();
        common.scaffold.run(pass, &self.bound, [columns, rows, 1]);
    }

    /// The batch of `worlds` worlds whose rows of masks have `quads` vectors.
    pub(super) fn batch(&self, worlds: usize, quads: usize) -> Batch {
        let [groups, words] = [self.groups, self.words].map(|v| v as u32);
        let worlds = worlds as u32;
        Batch { groups, words, worlds, quads: quads as u32, past: worlds, ..Batch::default() }
    }

    /// An error unless `states` are of this scaffold's groups.
    pub(super) fn check(&self, states: &States) -> Result<(), GpuError> {
        let (found, needed) = (states.groups(), self.groups);
        if found == needed {
            Ok(())
        } else {
            Err(GpuError::Length { field: "groups of the states", found, needed })
        }
    }
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
    bound: wgpu::BindGroup,
    columns: u32,
    count: u32,
}

impl Totals {
    pub(super) fn new(
        device: &Device,
        common: &Common,
        values: &wgpu::Buffer,
        [rows, columns, count]: [usize; 3],
    ) -> Result<Self, GpuError> {
        let [rows, columns, count] = [rows, columns, count].map(|v| v as u32);
        let table = Table { rows, columns, unused: [0; 2] };
        let table = uniform(device, "table", bytemuck::bytes_of(&table))?;
        let buffer = storage(device, "totals", 4 * u64::from(columns) * u64::from(count))?;
        let bound = common.squares.bind(device, &[&table, values, &buffer]);
        Ok(Self { buffer, bound, columns, count })
    }

    pub(super) fn add_up(&self, common: &Common, pass: &mut wgpu::ComputePass) {
        common.squares.run(pass, &self.bound, [self.columns.div_ceil(16), 1, self.count]);
    }

    pub(super) fn read(&self, device: &Device) -> Result<Vec<f32>, GpuError> {
        read(device, &self.buffer, (self.columns * self.count) as usize)
    }
}

/// The first `count` numbers of `buffer`.
pub(super) fn read(device: &Device, buffer: &wgpu::Buffer, count: usize) -> Result<Vec<f32>, GpuError> {
    let bytes = device.read(buffer, 4 * count as u64)?;
    Ok(bytes.chunks_exact(4).map(bytemuck::pod_read_unaligned).collect())
}

/// A storage buffer that can be copied both ways.
pub(super) fn storage(device: &Device, what: &'static str, bytes: u64) -> Result<wgpu::Buffer, GpuError> {
    use wgpu::BufferUsages as Usage;
    device.buffer(what, bytes, Usage::STORAGE | Usage::COPY_SRC | Usage::COPY_DST)
}

/// A storage buffer that holds `data`.
pub(super) fn filled(device: &Device, what: &'static str, data: &[u8]) -> Result<wgpu::Buffer, GpuError> {
    let buffer = storage(device, what, data.len() as u64)?;
    if !data.is_empty() {
        device.queue().write_buffer(&buffer, 0, data);
    }
    Ok(buffer)
}

/// A uniform buffer that holds `data`.
pub(super) fn uniform(device: &Device, what: &'static str, data: &[u8]) -> Result<wgpu::Buffer, GpuError> {
    use wgpu::BufferUsages as Usage;
    let buffer = device.buffer(what, data.len() as u64, Usage::UNIFORM | Usage::COPY_DST)?;
    device.queue().write_buffer(&buffer, 0, data);
    Ok(buffer)
}

/// Records one compute pass and submits it; nothing is waited for.
pub(super) fn submit(device: &Device, record: impl FnOnce(&mut wgpu::ComputePass)) {
    let mut encoder = device.raw().create_command_encoder(&wgpu::CommandEncoderDescriptor::default());
    record(&mut encoder.begin_compute_pass(&wgpu::ComputePassDescriptor::default()));
    device.queue().submit([encoder.finish()]);
}
