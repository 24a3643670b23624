//! Differentiates losses that look further than one pixel: pictures of many worlds are blended and retained,
//! a kernel replaces them by their gradients, and the way back starts from those.
//!
//! As many worlds at a time as fit the buffers that every WebGPU device binds, all in one submission; which
//! worlds go together does not show in any number.

use bytemuck::{Pod, Zeroable};

use super::{
    super::{
        Device, GpuError,
        recording::Recording,
        source::{Bind, Kernel, LAYOUT, Source, TILE},
        states::{Batch, QUAD, STATES, Totals},
    },
    blend_buffers::{BLEND_BACK, BlendBuffers, FORWARD},
};
use crate::{
    adjoint::loss::{Mix, ssim::Dissimilarity},
    image::Image,
};

/// Bytes of the largest buffer that worlds share, unless four worlds need more: what every WebGPU device
/// binds.
pub(super) const CHUNK_BYTES: usize = 1 << 27;
/// Vectors of worlds at a time: their planes are workgroups along z, at most 65535.
const MAX_QUADS: usize = 4096;
/// Values a pixel.
const CHANNELS: usize = 3;
/// Slopes per value.
const KINDS: usize = 3;

/// Blending front to back, with pictures at its end.
pub static FRAMEBUFFER: Source = Source {
    name: "adjoint/framebuffer.wgsl",
    parts: &[LAYOUT, TILE, STATES, FORWARD, include_str!("../../adjoint/framebuffer.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("splats", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("masks", Bind::Read),
        ("marks", Bind::Write),
        ("framebuffer", Bind::Write),
        ("found", Bind::Write),
    ],
};

/// `1 - SSIM` and squared error, and their gradients.
pub static STRUCTURE: Source = Source {
    name: "adjoint/loss/ssim.wgsl",
    parts: &[LAYOUT, TILE, STATES, include_str!("../../adjoint/loss/ssim.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("window", Bind::Uniform),
        ("wanted", Bind::Read),
        ("target_moments", Bind::Read),
        ("framebuffer", Bind::Write),
        ("slopes", Bind::Write),
        ("losses", Bind::Write),
    ],
};

/// Of `1 - SSIM` and its mix with the squared error: a uniform buffer.
#[derive(Clone, Copy, Debug, Default, PartialEq, Pod, Zeroable)]
#[repr(C)]
pub struct Window {
    /// Weights along a row by distance from the middle, 0 beyond the window and in the padding.
    pub along: [f32; 8],
    /// Weights down a column, likewise.
    pub down: [f32; 8],
    /// First and half-open last column, then row, on which a window can be centred.
    pub centres: [u32; 4],
    /// Of the gradients of half a squared difference and of a window's `1 - SSIM`.
    pub scale: [f32; 2],
    /// Padding.
    pub unused: [u32; 2],
}

/// What the loss knows of the picture wanted.
#[derive(Clone, Debug)]
pub(super) struct Structure {
    mix: Mix,
    window: wgpu::Buffer,
    moments: wgpu::Buffer,
    /// Values of a picture.
    values: usize,
    /// Windows of all channels.
    windows: usize,
}

impl Structure {
    pub(super) fn new(device: &Device, target: &Image, mix: Mix) -> Result<Self, GpuError> {
        let loss = Dissimilarity::new(target.clone());
        let values = target.rgb().len();
        let windows = loss.windows().count();
        let [along, down] = loss.weights();
        let padded = |half: &[f32]| std::array::from_fn(|k| half.get(k).copied().unwrap_or(0.0));
        let [columns, rows] = loss.columns_and_rows();
        let window = Window {
            along: padded(along),
            down: padded(down),
            centres: [columns.start, columns.end, rows.start, rows.end].map(|v| v as u32),
            scale: [2.0 * mix.mse / values as f64, mix.structure / windows as f64].map(|v| v as f32),
            unused: [0; 2],
        };
        let moments = loss.target_planes();
        Ok(Self {
            mix,
            window: device.uniform("window", bytemuck::bytes_of(&window))?,
            moments: device.filled("moments of the target", bytemuck::cast_slice(&moments))?,
            values,
            windows,
        })
    }

    /// Loss of each world from the sums over all pixels and over all windows.
    fn losses(&self, sums: &[f32]) -> Vec<f64> {
        let mean = |sum: f32, count: usize| f64::from(sum) / count as f64;
        let loss = |s: &[f32; 2]| {
            self.mix.mse * mean(s[0], self.values) + self.mix.structure * mean(s[1], self.windows)
        };
        sums.as_chunks().0.iter().map(loss).collect()
    }
}

/// Worlds that go together.
#[derive(Debug)]
struct Chunk {
    batch: wgpu::Buffer,
    quads: u32,
    planes: u32,
}

/// The batch of worlds, as many together as fit.
#[derive(Debug)]
pub(super) struct Chunks {
    structure: Structure,
    chunks: Vec<Chunk>,
    framebuffer: wgpu::Buffer,
    slopes: wgpu::Buffer,
    marks: wgpu::Buffer,
    losses: wgpu::Buffer,
    totals: Totals,
}

/// Vectors of worlds that go together, of `quads`, in buffers of `bytes` bytes each, when `pixels` pixels and
/// `marks` bytes of transmittances are retained for each.
fn together(quads: usize, bytes: usize, pixels: usize, marks: usize) -> usize {
    let slopes = 4 * QUAD * CHANNELS * KINDS * pixels;
    (bytes / slopes.max(marks).max(1)).clamp(1, quads.clamp(1, MAX_QUADS))
}

impl Chunks {
    /// Room for the worlds of `batch` on `tiles` tiles; `marks` are the bytes of the transmittances of four
    /// worlds, `bytes` those of the largest buffer.
    pub(super) fn new(
        device: &Device,
        structure: &Structure,
        tiles: usize,
        batch: Batch,
        marks: usize,
        bytes: usize,
    ) -> Result<Self, GpuError> {
        let (worlds, pixels) = (batch.worlds as usize, structure.values / CHANNELS);
        let quads = together(worlds.div_ceil(QUAD), bytes, pixels, marks);
        let planes = QUAD * CHANNELS * pixels * quads;
        let rows = CHANNELS * tiles;
        let mut chunks = Vec::new();
        for first in (0..worlds).step_by(QUAD * quads) {
            let past = (first + QUAD * quads).min(worlds);
            let batch = Batch { first: first as u32, past: past as u32, ..batch };
            chunks.push(Chunk {
                batch: device.uniform("batch", bytemuck::bytes_of(&batch))?,
                quads: (past - first).div_ceil(QUAD) as u32,
                planes: (CHANNELS * (past - first)) as u32,
            });
        }
        let losses = device.storage("losses of tiles", (4 * 2 * worlds * rows) as u64)?;
        Ok(Self {
            structure: structure.clone(),
            chunks,
            framebuffer: device.storage("pictures", (4 * planes) as u64)?,
            slopes: device.storage("slopes", (4 * KINDS * planes) as u64)?,
            marks: device.storage("transmittances", (marks * quads) as u64)?,
            totals: Totals::new(device, &losses, [rows, 2 * worlds, 1])?,
            losses,
        })
    }

    /// Records all chunks, one after the other; then the losses.
    pub(super) fn record(&self, walk: &BlendBuffers, recording: &mut Recording) {
        let [columns, rows] = walk.grid;
        for Chunk { batch, quads, planes } in &self.chunks {
            let lists = walk.lists(batch, &self.marks);
            let forward = [&lists[..], &[&self.framebuffer, &walk.found]].concat();
            let back = [&lists[..], &[&self.framebuffer, &walk.partials, &walk.found]].concat();
            recording.dispatch(Kernel::new(&FRAMEBUFFER, "draw"), &forward, [columns, rows, *quads]);
            let (frame, wanted) = (&walk.frame, &walk.wanted);
            self.record_loss(&STRUCTURE, [frame, batch, wanted], [columns, rows, *planes], recording);
            recording.dispatch(Kernel::new(&BLEND_BACK, "back_from_gradients"), &back, [columns, rows, 1]);
        }
        self.totals.record(recording);
    }

    /// Records how the pictures become their gradients, by the kernels of `source`.
    fn record_loss(
        &self,
        source: &'static Source,
        [frame, batch, wanted]: [&wgpu::Buffer; 3],
        workgroups: [u32; 3],
        recording: &mut Recording,
    ) {
        let Structure { window, moments, .. } = &self.structure;
        let Self { framebuffer, slopes, losses, .. } = self;
        let buffers = [frame, batch, window, wanted, moments, framebuffer, slopes, losses];
        for entry in ["window_gradients", "pixel_gradients"] {
            recording.dispatch(Kernel::new(source, entry), &buffers, workgroups);
        }
    }

    /// Waits, and reads the loss of each world.
    pub(super) fn read(&self, device: &Device) -> Result<Vec<f64>, GpuError> {
        Ok(self.structure.losses(&self.totals.read(device)?))
    }
}

#[cfg(test)]
mod tests;
