//! Project, sort and bin on the device make the splats and tile lists that all blending kernels read.

use wgpu::BufferUsages;

use super::{
    Device, GpuError, GrowableBuffer, Scene, error,
    layout::{
        ARGS, ARGS_DRAWN, ARGS_SCAN_DRAWN, ARGS_SCAN_ENTRIES, ARGS_SORT_DRAWN, ARGS_SORT_ENTRIES,
        ARGS_STRIDE, COUNT_ENTRIES, COUNT_WANTED, COUNTS, DIGITS, FEW_BLOCKS, Frame, SORT_BLOCK, Splat,
        WORKGROUP,
    },
    recording::{Recording, Workgroups},
    source::{Bind, Kernel, LAYOUT, SPAN, Source},
};
use crate::{Camera, Settings};

/// Stage 1.
pub static PROJECT: Source = Source {
    name: "project.wgsl",
    parts: &[LAYOUT, SPAN, include_str!("../stage/project.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("gaussians", Bind::Read),
        ("harmonics", Bind::Read),
        ("groups", Bind::Read),
        ("splats", Bind::Write),
        ("keys", Bind::Write),
        ("touched", Bind::Write),
        ("counts", Bind::Write),
    ],
};

/// Sizes of indirect dispatches.
pub static PLAN: Source = Source {
    name: "plan.wgsl",
    parts: &[LAYOUT, include_str!("../stage/plan.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("counts", Bind::Write),
        ("sums", Bind::Write),
        ("dispatch", Bind::Write),
    ],
};

/// Stage 2, and the gathering of entries by tile.
pub static SORT: Source = Source {
    name: "sort.wgsl",
    parts: &[LAYOUT, include_str!("../stage/sort.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("counts", Bind::Read),
        ("keys", Bind::Read),
        ("values", Bind::Read),
        ("keys_out", Bind::Write),
        ("values_out", Bind::Write),
        ("table", Bind::Write),
        ("totals", Bind::Write),
        ("sort_pass", Bind::Uniform),
    ],
};

/// Stage 3.
pub static BIN: Source = Source {
    name: "bin.wgsl",
    parts: &[LAYOUT, SPAN, include_str!("../stage/bin.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("counts", Bind::Read),
        ("splats", Bind::Read),
        ("touched", Bind::Read),
        ("order", Bind::Read),
        ("sums", Bind::Write),
        ("keys", Bind::Write),
        ("values", Bind::Write),
    ],
};

/// The end of stage 3: where lists start.
pub static STARTS: Source = Source {
    name: "starts.wgsl",
    parts: &[LAYOUT, include_str!("../stage/starts.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("counts", Bind::Write),
        ("keys", Bind::Read),
        ("starts", Bind::Write),
    ],
};

/// Bits of the digits of the radix sort.
const DIGIT_BITS: u32 = 8;
/// Digits of a depth key, and of a tile number at most.
const DEPTH_DIGITS: usize = 4;
const TILE_DIGITS: usize = 4;
/// `source` of sort.wgsl: depth keys of all Gaussians, of those drawn, tile numbers of entries.
const SORT_ALL: u32 = 0;
const SORT_DRAWN: u32 = 1;
const SORT_ENTRIES: u32 = 2;
/// Bytes of the counts.
pub(super) const COUNT_BYTES: u64 = 4 * COUNTS as u64;
/// Tile entries per Gaussian that there is room for at first.
const FIRST_ROOM: u64 = 8;

/// Splats and tile lists of one frame, on the device, and the room to make them.
///
/// A frame is [`Lists::prepare`] (buffers, camera) and [`Lists::record`] (work). Nothing is read back.
#[derive(Debug)]
pub struct Lists {
    buffers: Buffers,
    frame: Frame,
    /// Digits of the tile numbers: passes of the sort by tile.
    tile_digits: usize,
    room: u32,
}

#[derive(Debug)]
struct Buffers {
    frame: wgpu::Buffer,
    counts: wgpu::Buffer,
    args: wgpu::Buffer,
    totals: wgpu::Buffer,
    /// `SortPass` of sort.wgsl for every digit of the depth keys, and of the tile numbers.
    depth_passes: [wgpu::Buffer; DEPTH_DIGITS],
    tile_passes: [wgpu::Buffer; TILE_DIGITS],
    splats: GrowableBuffer,
    touched: GrowableBuffer,
    /// Keys and values of the depth sort, before and after a pass.
    depth: [[GrowableBuffer; 2]; 2],
    table: GrowableBuffer,
    sums: GrowableBuffer,
    /// Tiles and splats of the entries, before and after a pass.
    entries: [[GrowableBuffer; 2]; 2],
    starts: GrowableBuffer,
}

impl Buffers {
    fn new(device: &Device) -> Result<Self, GpuError> {
        let whole = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let word = 4;
        let pair = |key, value| [GrowableBuffer::new(key), GrowableBuffer::new(value)];
        let pass = |source: u32, digit: u32| {
            device.uniform("sort pass", bytemuck::bytes_of(&[source, digit * DIGIT_BITS, 0, 0]))
        };
        Ok(Self {
            frame: device.buffer("frame", size_of::<Frame>() as u64, uniform)?,
            counts: device.buffer("counts", word * u64::from(COUNTS), whole)?,
            args: device.buffer("dispatch sizes", ARGS * ARGS_STRIDE, whole | BufferUsages::INDIRECT)?,
            totals: device.buffer("digit totals", word * u64::from(DIGITS), whole)?,
            depth_passes: [
                pass(SORT_ALL, 0)?,
                pass(SORT_DRAWN, 1)?,
                pass(SORT_DRAWN, 2)?,
                pass(SORT_DRAWN, 3)?,
            ],
            tile_passes: [
                pass(SORT_ENTRIES, 0)?,
                pass(SORT_ENTRIES, 1)?,
                pass(SORT_ENTRIES, 2)?,
                pass(SORT_ENTRIES, 3)?,
            ],
            splats: GrowableBuffer::new("splats"),
            touched: GrowableBuffer::new("tiles per splat"),
            depth: [pair("depth keys", "depth order"), pair("depth keys", "depth order")],
            table: GrowableBuffer::new("digits per block"),
            sums: GrowableBuffer::new("entries per block"),
            entries: [pair("entry tiles", "tile entries"), pair("entry tiles", "tile entries")],
            starts: GrowableBuffer::new("tile starts"),
        })
    }

    /// Makes room; true when a buffer was replaced.
    fn reserve(&mut self, device: &Device, gaussians: u64, tiles: u64, room: u64) -> Result<bool, GpuError> {
        let block = u64::from(SORT_BLOCK);
        let table = gaussians.div_ceil(block).max(room.div_ceil(block)) * u64::from(DIGITS);
        let mut replaced = self.splats.reserve(device, gaussians * size_of::<Splat>() as u64)?;
        replaced |= self.touched.reserve(device, 4 * gaussians)?;
        replaced |= self.table.reserve(device, 4 * table)?;
        replaced |= self.sums.reserve(device, 4 * gaussians.div_ceil(u64::from(WORKGROUP)))?;
        replaced |= self.starts.reserve(device, 4 * (tiles + 1))?;
        for buffer in self.depth.iter_mut().flatten() {
            replaced |= buffer.reserve(device, 4 * gaussians)?;
        }
        for buffer in self.entries.iter_mut().flatten() {
            replaced |= buffer.reserve(device, 4 * room)?;
        }
        Ok(replaced)
    }

    fn bytes(&self) -> u64 {
        let pairs = self.depth.iter().chain(&self.entries).flatten();
        let single = [&self.splats, &self.touched, &self.table, &self.sums, &self.starts];
        pairs.chain(single).map(GrowableBuffer::bytes).sum()
    }
}

impl Lists {
    /// No room yet.
    ///
    /// # Errors
    /// No memory for the little that every frame needs.
    pub fn new(device: &Device) -> Result<Self, GpuError> {
        Ok(Self { buffers: Buffers::new(device)?, frame: Frame::default(), tile_digits: 1, room: 0 })
    }

    /// Makes room for `scene` at the camera's size and sends the camera. `change` may set what a blending
    /// kernel needs besides ([`Frame::worlds`] and [`Frame::world_words`]).
    ///
    /// True when a buffer that [`Lists`] hands out was replaced: what is bound to it must be bound again.
    ///
    /// # Errors
    /// A setting out of range, or no room on the device.
    pub fn prepare(
        &mut self,
        device: &Device,
        scene: &Scene,
        camera: &Camera,
        settings: &Settings,
        change: impl FnOnce(&mut Frame),
    ) -> Result<bool, GpuError> {
        error::check(settings)?;
        let degree = settings.max_sh_degree.min(scene.degree());
        let mut frame = Frame::new(camera, settings, scene.len(), degree);
        change(&mut frame);
        let most = device.facts().max_binding_bytes / 4;
        let first = (FIRST_ROOM * u64::from(scene.len())).clamp(1 << 16, most.max(1 << 16));
        self.room = self.room.max(first.min(u64::from(u32::MAX)) as u32);
        frame.capacity = self.room;
        let (gaussians, tiles) = (u64::from(scene.len()), u64::from(frame.tiles()));
        let replaced = self.buffers.reserve(device, gaussians, tiles, u64::from(self.room))?;
        self.frame = frame;
        let tile_digits = digits(frame.tiles());
        let moved = replaced || self.tile_digits != tile_digits;
        self.tile_digits = tile_digits;
        device.queue().write_buffer(&self.buffers.frame, 0, bytemuck::bytes_of(&frame));
        Ok(moved)
    }

    /// Records the work of one frame of `scene` in the stages project, sort and bin.
    ///
    /// # Errors
    /// [`Lists::prepare`] was not called.
    pub fn record(&self, scene: &Scene, recording: &mut Recording) -> Result<(), GpuError> {
        let b = &self.buffers;
        let (splats, touched, sums) = (b.splats.get()?, b.touched.get()?, b.sums.get()?);
        let [gaussians, harmonics, groups] = scene.buffers()?;
        let [depth_keys, order] = [b.depth[0][0].get()?, b.depth[0][1].get()?];
        let plan = [&b.frame, &b.counts, sums, &b.args];
        let count = self.frame.gaussians;

        recording.stage("project");
        recording.clear(&b.counts);
        let project = [&b.frame, gaussians, harmonics, groups, splats, depth_keys, touched, &b.counts];
        let workgroups = Workgroups::row(count.div_ceil(WORKGROUP));
        recording.dispatch_in(Kernel::new(&PROJECT, "project"), &project, workgroups);
        recording.dispatch(Kernel::new(&PLAN, "plan_drawn"), &plan, [1, 1, 1]);

        recording.stage("sort");
        let all = count.div_ceil(SORT_BLOCK);
        let all = [Workgroups::row(all), Workgroups::row(if all <= FEW_BLOCKS { 1 } else { DIGITS })];
        let drawn = [self.indirect(ARGS_SORT_DRAWN), self.indirect(ARGS_SCAN_DRAWN)];
        for (digit, pass) in b.depth_passes.iter().enumerate() {
            // The first leaves out what is skipped.
            self.record_sort(recording, &b.depth, digit, pass, if digit == 0 { &all } else { &drawn })?;
        }

        recording.stage("bin");
        let [tiles, list] = [b.entries[0][0].get()?, b.entries[0][1].get()?];
        let bin = [&b.frame, &b.counts, splats, touched, order, sums, tiles, list];
        recording.dispatch_in(Kernel::new(&BIN, "count_entries"), &bin, self.indirect(ARGS_DRAWN));
        recording.dispatch(Kernel::new(&PLAN, "plan_entries"), &plan, [1, 1, 1]);
        recording.dispatch_in(Kernel::new(&BIN, "emit_entries"), &bin, self.indirect(ARGS_DRAWN));
        let entries = [self.indirect(ARGS_SORT_ENTRIES), self.indirect(ARGS_SCAN_ENTRIES)];
        for (digit, pass) in b.tile_passes.iter().enumerate().take(self.tile_digits) {
            self.record_sort(recording, &b.entries, digit, pass, &entries)?;
        }
        let sorted_tiles = b.entries[self.tile_digits % 2][0].get()?;
        let starts = [&b.frame, &b.counts, sorted_tiles, b.starts.get()?];
        let workgroups = Workgroups::row((self.frame.tiles() + 1).div_ceil(WORKGROUP));
        recording.dispatch_in(Kernel::new(&STARTS, "find_starts"), &starts, workgroups);
        Ok(())
    }

    /// Records the sort of keys and values by one digit, from one pair of buffers to the other: in workgroups
    /// per block of keys, and in those that sum up digits.
    fn record_sort(
        &self,
        recording: &mut Recording,
        pairs: &[[GrowableBuffer; 2]; 2],
        digit: usize,
        pass: &wgpu::Buffer,
        [blocks, scans]: &[Workgroups; 2],
    ) -> Result<(), GpuError> {
        let b = &self.buffers;
        let ([keys, values], [keys_out, values_out]) = (&pairs[digit % 2], &pairs[(digit + 1) % 2]);
        let [keys, values] = [keys.get()?, values.get()?];
        let [keys_out, values_out] = [keys_out.get()?, values_out.get()?];
        let bound =
            [&b.frame, &b.counts, keys, values, keys_out, values_out, b.table.get()?, &b.totals, pass];
        recording.dispatch_in(Kernel::new(&SORT, "count_digits"), &bound, blocks.clone());
        recording.dispatch_in(Kernel::new(&SORT, "scan"), &bound, scans.clone());
        recording.dispatch_in(Kernel::new(&SORT, "scatter"), &bound, blocks.clone());
        Ok(())
    }

    /// As many workgroups as the device plans at `place`.
    fn indirect(&self, place: u64) -> Workgroups {
        Workgroups::Indirect { arguments: self.buffers.args.clone(), place }
    }

    /// The frame as kernels see it.
    pub fn frame(&self) -> &Frame {
        &self.frame
    }

    /// The uniform buffer that holds it.
    pub fn frame_buffer(&self) -> &wgpu::Buffer {
        &self.buffers.frame
    }

    /// Counts, [`COUNTS`] words.
    pub fn counts(&self) -> &wgpu::Buffer {
        &self.buffers.counts
    }

    /// [`Splat`] of every Gaussian; those skipped hold nothing of use.
    ///
    /// # Errors
    /// [`Lists::prepare`] was not called.
    pub fn splats(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffers.splats.get()
    }

    /// Indices of the splats drawn, nearest first.
    ///
    /// # Errors
    /// [`Lists::prepare`] was not called.
    pub fn order(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffers.depth[0][1].get()
    }

    /// Depth keys of the splats drawn, nearest first.
    ///
    /// # Errors
    /// [`Lists::prepare`] was not called.
    pub fn depth_keys(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffers.depth[0][0].get()
    }

    /// Indices of splats, tile after tile, nearest first.
    ///
    /// # Errors
    /// [`Lists::prepare`] was not called.
    pub fn entries(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffers.entries[self.tile_digits % 2][1].get()
    }

    /// Where the list of each tile starts, and where the last one ends.
    ///
    /// # Errors
    /// [`Lists::prepare`] was not called.
    pub fn starts(&self) -> Result<&wgpu::Buffer, GpuError> {
        self.buffers.starts.get()
    }

    /// Tile entries there is room for.
    pub fn room(&self) -> u32 {
        self.room
    }

    /// Asks for room for `entries` tile entries in the next frame.
    pub fn reserve_entries(&mut self, entries: u32) {
        self.room = self.room.max(entries);
    }

    /// Bytes on the device.
    pub fn bytes(&self) -> u64 {
        self.buffers.bytes()
    }

    /// The counts of the last frame submitted. Waits for it.
    ///
    /// # Errors
    /// [`GpuError::Entries`] when the tile lists did not fit (see [`Lists::reserve_entries`]), or the
    /// device was lost.
    pub fn read_counts(&self, device: &Device) -> Result<[u32; COUNTS as usize], GpuError> {
        Self::checked_counts(&device.read(&self.buffers.counts, COUNT_BYTES)?)
    }

    /// The counts in `bytes`, read from [`Lists::counts`].
    ///
    /// # Errors
    /// [`GpuError::Entries`] when the tile lists did not fit.
    pub(super) fn checked_counts(bytes: &[u8]) -> Result<[u32; COUNTS as usize], GpuError> {
        let mut counts = [0; COUNTS as usize];
        counts.iter_mut().zip(bytes.chunks_exact(4)).for_each(|(c, b)| *c = bytemuck::pod_read_unaligned(b));
        let (found, room) = (counts[COUNT_WANTED as usize], counts[COUNT_ENTRIES as usize]);
        if found > room { Err(GpuError::Entries { found, room }) } else { Ok(counts) }
    }
}

/// Digits of the largest tile number, which is one past the last tile.
fn digits(tiles: u32) -> usize {
    (u32::BITS - tiles.leading_zeros()).div_ceil(DIGIT_BITS).max(1) as usize
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_tile_number_has_enough_digits() {
        for (tiles, expected) in [(1, 1), (255, 1), (256, 2), (65_535, 2), (65_536, 3), (1 << 20, 3)] {
            assert_eq!(super::digits(tiles), expected, "{tiles}");
        }
    }
}
