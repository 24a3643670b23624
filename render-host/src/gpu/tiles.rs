//! Tile lists, made by the CPU or by the device, serve the engines over states.

use super::{
    Device, GpuError, Lists, Scene,
    layout::{Frame, Splat, WORKGROUP},
    recording::{Recording, Workgroups},
    source::{Bind, Kernel, LAYOUT, Source},
};
use crate::{
    Camera, Settings,
    counterfactual::Variants,
    stage::{self, TILE, bin, project, sort},
};

/// The place of every splat in the order of depth.
pub static RANK: Source = Source {
    name: "rank.wgsl",
    parts: &[LAYOUT, include_str!("../counterfactual/rank.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("counts", Bind::Read),
        ("order", Bind::Read),
        ("ranks", Bind::Write),
    ],
};

/// What one camera sees of a scene: ellipses, and per tile the list of those that touch it.
#[derive(Clone, Debug)]
pub struct Tiles {
    pub(super) size: [u32; 2],
    /// Entries there is room for; at least as many as there are.
    pub(super) capacity: usize,
    /// A [`Frame`].
    pub(super) frame: wgpu::Buffer,
    /// A [`Splat`] per Gaussian.
    pub(super) splats: wgpu::Buffer,
    /// Per Gaussian its place in the order of depth, from 1; 0 when it was skipped.
    pub(super) ranks: wgpu::Buffer,
    /// Tile `t` is `list[starts[t]..starts[t + 1]]`.
    pub(super) starts: wgpu::Buffer,
    /// Indices of splats, nearest first, ties by index.
    pub(super) list: wgpu::Buffer,
}

impl Tiles {
    /// The lists that the CPU's stages make, uploaded: the twin that judges lists made on the device.
    ///
    /// # Errors
    /// A setting out of range, or a buffer that the device does not grant.
    pub fn from_cpu(
        device: &Device,
        variants: &Variants,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<Self, GpuError> {
        settings.validate_for_one_tile_side()?;
        let size = [camera.width(), camera.height()];
        let pixels = size.map(|side| side as usize);
        let columns = pixels[0].div_ceil(TILE);
        let mut projected = project::Projected::default();
        let (mut order, mut bands, mut bins) = (sort::Order::default(), Vec::new(), bin::Bins::default());
        let scene = variants.splats();
        project::project(&scene, camera, settings, &mut projected);
        sort::sort(&projected.keys, settings.parallel, &mut order);
        bin::bands(&projected, &order, pixels, settings, &mut bands);
        let (mut starts, mut list) = (vec![0u32], Vec::new());
        for band in &bands {
            bin::bin(&projected, &order, band, columns, settings, &mut bins);
            for row in bins.rows() {
                for column in 0..columns {
                    list.extend_from_slice(row.tile(column));
                    starts.push(list.len() as u32);
                }
            }
        }
        let splats: Vec<Splat> =
            projected.splats.iter().zip(variants.groups()).map(|(s, &group)| rounded(s, group)).collect();
        let mut ranks = vec![0u32; scene.len()];
        (1..).zip(order.indices()).for_each(|(rank, splat)| ranks[splat as usize] = rank);
        let degree = settings.degree(scene.sh_degree());
        let frame = Frame::new(camera, settings, scene.len() as u32, degree);
        Ok(Self {
            size,
            capacity: list.len(),
            frame: device.uniform("frame", bytemuck::bytes_of(&frame))?,
            splats: device.filled("splats", bytemuck::cast_slice(&splats))?,
            ranks: device.filled("ranks", bytemuck::cast_slice(&ranks))?,
            starts: device.filled("starts", bytemuck::cast_slice(&starts))?,
            list: device.filled("list", bytemuck::cast_slice(&list))?,
        })
    }

    /// Columns and rows of tiles.
    pub(super) fn grid(&self) -> [u32; 2] {
        self.size.map(|side| side.div_ceil(TILE as u32))
    }

    /// Number of tiles.
    pub(super) fn count(&self) -> usize {
        let [columns, rows] = self.grid();
        columns as usize * rows as usize
    }
}

/// Tile lists made on the device, frame by frame, for engines over states. Nothing is read back; whether
/// the lists fitted their buffer, [`Lists::read_counts`] says when asked.
#[derive(Debug)]
pub struct Stages {
    lists: Lists,
    ranks: Option<wgpu::Buffer>,
}

impl Stages {
    /// No room yet.
    ///
    /// # Errors
    /// No memory for the little that every frame needs.
    pub fn new(device: &Device) -> Result<Self, GpuError> {
        Ok(Self { lists: Lists::new(device)?, ranks: None })
    }

    /// Makes room for `scene` and sends the camera. True when a buffer was replaced: then what was bound to
    /// [`Stages::tiles`] must be bound again.
    ///
    /// # Errors
    /// A setting out of range, or no room on the device.
    pub fn prepare(
        &mut self,
        device: &Device,
        scene: &Scene,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<bool, GpuError> {
        let moved = self.lists.prepare(device, scene, camera, settings, |_| ())?;
        let needed = 4 * u64::from(scene.len());
        if !moved && self.ranks.as_ref().is_some_and(|ranks| ranks.size() >= needed) {
            return Ok(false);
        }
        self.ranks = Some(device.storage("ranks", needed)?);
        Ok(true)
    }

    /// The buffers of the frame that was prepared.
    ///
    /// # Errors
    /// [`Stages::prepare`] was not called.
    pub fn tiles(&self) -> Result<Tiles, GpuError> {
        let lists = &self.lists;
        let ranks = self.ranks()?;
        let [width, height, ..] = lists.frame().size;
        Ok(Tiles {
            size: [width, height],
            capacity: lists.room() as usize,
            frame: lists.frame_buffer().clone(),
            splats: lists.splats()?.clone(),
            ranks: ranks.clone(),
            starts: lists.starts()?.clone(),
            list: lists.entries()?.clone(),
        })
    }

    /// Records the work of one frame of `scene`: project, sort, bin and ranks.
    ///
    /// # Errors
    /// [`Stages::prepare`] was not called.
    pub fn record(&self, scene: &Scene, recording: &mut Recording) -> Result<(), GpuError> {
        let (lists, ranks) = (&self.lists, self.ranks()?);
        lists.record(scene, recording)?;
        recording.clear(ranks);
        let buffers = [lists.frame_buffer(), lists.counts(), lists.order()?, ranks];
        let workgroups = Workgroups::row(lists.frame().gaussians.div_ceil(WORKGROUP));
        recording.dispatch_in(Kernel::new(&RANK, "rank"), &buffers, workgroups);
        Ok(())
    }

    fn ranks(&self) -> Result<&wgpu::Buffer, GpuError> {
        let missing = || GpuError::Refused { what: "ranks", message: "nothing was prepared".into() };
        self.ranks.as_ref().ok_or_else(missing)
    }

    /// Asks for room for `entries` tile entries in the next frame.
    pub fn reserve_entries(&mut self, entries: u32) {
        self.lists.reserve_entries(entries);
    }

    /// The lists, and how many entries they wanted.
    pub fn lists(&self) -> &Lists {
        &self.lists
    }
}

/// A splat as kernels read it.
fn rounded(s: &stage::Splat, group: u32) -> Splat {
    let [x0, x1, y0, y1] = s.pixels.map(u32::from);
    let anchor = [(x0 + x1) / 2, (y0 + y1) / 2];
    Splat {
        mean: std::array::from_fn(|k| (s.mean[k] - f64::from(anchor[k]) - 0.5) as f32),
        columns: x0 | x1 << 16,
        rows: y0 | y1 << 16,
        root: s.root.map(|v| v as f32),
        log2_alpha: s.log2_alpha,
        colour: s.colour,
        group,
    }
}
