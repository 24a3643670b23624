//! Project, sort and bin on the device: what all blending kernels read.

use super::layout::{
    ARGS, ARGS_DRAWN, ARGS_SORT_DRAWN, ARGS_SORT_ENTRIES, ARGS_STRIDE, COUNT_ENTRIES, COUNT_WANTED, COUNTS,
    DIGITS, Frame, SORT_BLOCK, Splat, WORKGROUP,
};
use super::{Clock, Device, GpuError, Growing, Kernel, Scene, error, groups_2d, wgsl};
use crate::{Camera, Settings};
use wgpu::BufferUsages;

/// Bits of the digits of the radix sort.
const DIGIT_BITS: u32 = 8;
/// Tile entries per Gaussian that there is room for at first.
const FIRST_ROOM: u64 = 8;

/// Splats and tile lists of one frame, kept on the device, and the room to make them.
///
/// A frame is [`Lists::prepare`] (buffers, camera) and [`Lists::encode`] (commands). Nothing is read back.
#[derive(Debug)]
pub struct Lists {
    kernels: Kernels,
    buffers: Buffers,
    bound: Option<Bound>,
    frame: Frame,
    /// What `bound` was made for: version of the scene, passes of the tile sort.
    bound_for: (u64, usize),
    room: u32,
}

/// One digit of a sort.
#[derive(Debug)]
struct Digit {
    count: Kernel,
    scatter: Kernel,
}

#[derive(Debug)]
struct Kernels {
    project: Kernel,
    plan_drawn: Kernel,
    plan_entries: Kernel,
    /// `scan` by what is sorted.
    scan: [Kernel; 3],
    by_depth: Vec<Digit>,
    by_tile: Vec<Digit>,
    count_entries: Kernel,
    emit_entries: Kernel,
    find_starts: Kernel,
}

#[derive(Debug)]
struct Buffers {
    frame: wgpu::Buffer,
    counts: wgpu::Buffer,
    args: wgpu::Buffer,
    totals: wgpu::Buffer,
    splats: Growing,
    touched: Growing,
    /// Keys and values of the depth sort, before and after a pass.
    depth: [[Growing; 2]; 2],
    table: Growing,
    sums: Growing,
    /// Tiles and splats of the entries, before and after a pass.
    entries: [[Growing; 2]; 2],
    starts: Growing,
}

#[derive(Debug)]
struct Bound {
    project: wgpu::BindGroup,
    plan: wgpu::BindGroup,
    by_depth: Vec<wgpu::BindGroup>,
    bin: wgpu::BindGroup,
    by_tile: Vec<wgpu::BindGroup>,
    starts: wgpu::BindGroup,
}

impl Kernels {
    fn new(device: &Device) -> Result<Self, GpuError> {
        let kernel = |source, entry| Kernel::new(device, source, entry, &[]);
        let scan = |source: f64| Kernel::new(device, &wgsl::SORT, "scan", &[("SOURCE", source)]);
        let digit = |source: f64, pass: u32| {
            let constants = [("SOURCE", source), ("SHIFT", f64::from(pass * DIGIT_BITS))];
            let count = Kernel::new(device, &wgsl::SORT, "count_digits", &constants)?;
            Ok(Digit { count, scatter: Kernel::new(device, &wgsl::SORT, "scatter", &constants)? })
        };
        Ok(Self {
            project: kernel(&wgsl::PROJECT, "project")?,
            plan_drawn: kernel(&wgsl::PLAN, "plan_drawn")?,
            plan_entries: kernel(&wgsl::PLAN, "plan_entries")?,
            scan: [scan(0.0)?, scan(1.0)?, scan(2.0)?],
            by_depth: (0..4)
                .map(|pass| digit(if pass == 0 { 0.0 } else { 1.0 }, pass))
                .collect::<Result<_, GpuError>>()?,
            // 2²⁰ tiles at most, and one that does not exist.
            by_tile: (0..3).map(|pass| digit(2.0, pass)).collect::<Result<_, GpuError>>()?,
            count_entries: kernel(&wgsl::BIN, "count_entries")?,
            emit_entries: kernel(&wgsl::BIN, "emit_entries")?,
            find_starts: kernel(&wgsl::STARTS, "find_starts")?,
        })
    }
}

impl Buffers {
    fn new(device: &Device) -> Result<Self, GpuError> {
        let whole = BufferUsages::STORAGE | BufferUsages::COPY_SRC | BufferUsages::COPY_DST;
        let uniform = BufferUsages::UNIFORM | BufferUsages::COPY_DST;
        let word = 4;
        let grow = |what| Growing::new(what, BufferUsages::empty());
        let pair = |key, value| [grow(key), grow(value)];
        Ok(Self {
            frame: device.buffer("frame", size_of::<Frame>() as u64, uniform)?,
            counts: device.buffer("counts", word * u64::from(COUNTS), whole)?,
            args: device.buffer("dispatch sizes", ARGS * ARGS_STRIDE, whole | BufferUsages::INDIRECT)?,
            totals: device.buffer("digit totals", word * u64::from(DIGITS), whole)?,
            splats: grow("splats"),
            touched: grow("tiles per splat"),
            depth: [pair("depth keys", "depth order"), pair("depth keys", "depth order")],
            table: grow("digits per block"),
            sums: grow("entries per block"),
            entries: [pair("entry tiles", "tile entries"), pair("entry tiles", "tile entries")],
            starts: grow("tile starts"),
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
        pairs.chain(single).map(Growing::bytes).sum()
    }
}

impl Lists {
    /// Kernels, and no room yet.
    ///
    /// # Errors
    /// The device refuses a shader.
    pub fn new(device: &Device) -> Result<Self, GpuError> {
        Ok(Self {
            kernels: Kernels::new(device)?,
            buffers: Buffers::new(device)?,
            bound: None,
            frame: Frame::default(),
            bound_for: (0, 0),
            room: 0,
        })
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
        let wanted = (scene.version(), passes(frame.tiles()));
        if replaced || self.bound.is_none() || self.bound_for != wanted {
            self.bound = Some(self.bind(device, scene, wanted.1)?);
        }
        let moved = replaced || self.bound_for.1 != wanted.1;
        self.bound_for = wanted;
        device.queue().write_buffer(&self.buffers.frame, 0, bytemuck::bytes_of(&frame));
        Ok(moved)
    }

    fn bind(&self, device: &Device, scene: &Scene, passes: usize) -> Result<Bound, GpuError> {
        let (k, b) = (&self.kernels, &self.buffers);
        let [gaussians, harmonics, groups] = scene.buffers()?;
        let (splats, touched, sums) = (b.splats.get()?, b.touched.get()?, b.sums.get()?);
        let pair = |p: &'_ [Growing; 2]| Ok::<_, GpuError>([p[0].get()?.clone(), p[1].get()?.clone()]);
        let depth = [pair(&b.depth[0])?, pair(&b.depth[1])?];
        let entries = [pair(&b.entries[0])?, pair(&b.entries[1])?];
        let table = b.table.get()?;
        let sort = |kernel: &Kernel, pairs: &[[wgpu::Buffer; 2]; 2], pass: usize| {
            let ([keys, values], [keys_out, values_out]) = (&pairs[pass % 2], &pairs[(pass + 1) % 2]);
            let buffers = [&b.frame, &b.counts, keys, values, keys_out, values_out, table, &b.totals];
            kernel.bind(device, &buffers)
        };
        device.guarded("bind groups", || {
            Ok(Bound {
                project: k.project.bind(
                    device,
                    &[&b.frame, gaussians, harmonics, groups, splats, &depth[0][0], touched, &b.counts],
                ),
                plan: k.plan_drawn.bind(device, &[&b.frame, &b.counts, sums, &b.args]),
                by_depth: (0..4).map(|pass| sort(&k.scan[0], &depth, pass)).collect(),
                bin: k.count_entries.bind(
                    device,
                    &[
                        &b.frame,
                        &b.counts,
                        splats,
                        touched,
                        &depth[0][1],
                        sums,
                        &entries[0][0],
                        &entries[0][1],
                    ],
                ),
                by_tile: (0..passes).map(|pass| sort(&k.scan[2], &entries, pass)).collect(),
                starts: k
                    .find_starts
                    .bind(device, &[&b.frame, &b.counts, &entries[passes % 2][0], b.starts.get()?]),
            })
        })?
    }

    /// The commands of one frame: project, sort, bin. Timed stage by stage where there is a `clock`.
    ///
    /// # Errors
    /// [`Lists::prepare`] was not called.
    pub fn encode(
        &self,
        encoder: &mut wgpu::CommandEncoder,
        mut clock: Option<&mut Clock>,
    ) -> Result<(), GpuError> {
        let (k, b) = (&self.kernels, &self.buffers);
        let Some(bound) = &self.bound else {
            return Err(GpuError::Refused { what: "encode", message: "nothing was prepared".into() });
        };
        encoder.clear_buffer(&b.counts, 0, None);
        let gaussians = self.frame.gaussians;
        {
            let mut pass = begin(encoder, "project", clock.as_deref_mut());
            k.project.run(&mut pass, &bound.project, groups_2d(gaussians.div_ceil(WORKGROUP)));
            k.plan_drawn.run(&mut pass, &bound.plan, [1, 1, 1]);
        }
        {
            let mut pass = begin(encoder, "sort", clock.as_deref_mut());
            for (i, (digit, group)) in k.by_depth.iter().zip(&bound.by_depth).enumerate() {
                let blocks = groups_2d(gaussians.div_ceil(SORT_BLOCK));
                if i == 0 {
                    digit.count.run(&mut pass, group, blocks);
                    k.scan[0].run(&mut pass, group, [DIGITS, 1, 1]);
                    digit.scatter.run(&mut pass, group, blocks);
                } else {
                    digit.count.run_indirect(&mut pass, group, &b.args, ARGS_SORT_DRAWN);
                    k.scan[1].run(&mut pass, group, [DIGITS, 1, 1]);
                    digit.scatter.run_indirect(&mut pass, group, &b.args, ARGS_SORT_DRAWN);
                }
            }
        }
        let mut pass = begin(encoder, "bin", clock);
        k.count_entries.run_indirect(&mut pass, &bound.bin, &b.args, ARGS_DRAWN);
        k.plan_entries.run(&mut pass, &bound.plan, [1, 1, 1]);
        k.emit_entries.run_indirect(&mut pass, &bound.bin, &b.args, ARGS_DRAWN);
        for (digit, group) in k.by_tile.iter().zip(&bound.by_tile) {
            digit.count.run_indirect(&mut pass, group, &b.args, ARGS_SORT_ENTRIES);
            k.scan[2].run(&mut pass, group, [DIGITS, 1, 1]);
            digit.scatter.run_indirect(&mut pass, group, &b.args, ARGS_SORT_ENTRIES);
        }
        let groups = groups_2d((self.frame.tiles() + 1).div_ceil(WORKGROUP));
        k.find_starts.run(&mut pass, &bound.starts, groups);
        Ok(())
    }

    /// What the kernels are told of the frame.
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

    /// Sizes of indirect dispatches, [`ARGS`] places.
    pub fn args(&self) -> &wgpu::Buffer {
        &self.buffers.args
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
        self.buffers.entries[self.bound_for.1 % 2][1].get()
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
        let bytes = device.read(&self.buffers.counts, 4 * u64::from(COUNTS))?;
        let mut counts = [0; COUNTS as usize];
        counts.iter_mut().zip(bytes.chunks_exact(4)).for_each(|(c, b)| *c = bytemuck::pod_read_unaligned(b));
        let (found, room) = (counts[COUNT_WANTED as usize], counts[COUNT_ENTRIES as usize]);
        if found > room { Err(GpuError::Entries { found, room }) } else { Ok(counts) }
    }
}

/// A compute pass, timed as stage `name` where there is a clock.
pub(super) fn begin<'a>(
    encoder: &'a mut wgpu::CommandEncoder,
    name: &'static str,
    clock: Option<&mut Clock>,
) -> wgpu::ComputePass<'a> {
    let timestamp_writes = clock.and_then(|clock| clock.stage(name));
    encoder.begin_compute_pass(&wgpu::ComputePassDescriptor { label: Some(name), timestamp_writes })
}

/// Digits of the largest tile number, which is one past the last tile.
fn passes(tiles: u32) -> usize {
    (u32::BITS - tiles.leading_zeros()).div_ceil(DIGIT_BITS).max(1) as usize
}

#[cfg(test)]
mod tests {
    #[test]
    fn every_tile_number_has_enough_digits() {
        for (tiles, digits) in [(1, 1), (255, 1), (256, 2), (65_535, 2), (65_536, 3), (1 << 20, 3)] {
            assert_eq!(super::passes(tiles), digits, "{tiles}");
        }
    }
}
