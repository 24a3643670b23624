//! Losses that look further than one pixel, on the device: pictures of many worlds are drawn and kept, a
//! kernel makes gradients of them, and the way back starts from those.
//!
//! As many worlds at a time as fit the buffers that every WebGPU device binds, all in one submission; which
//! worlds go together does not show in any number.

use bytemuck::{Pod, Zeroable};

use super::super::states::{Batch, QUAD, STATES, Totals, filled, storage, uniform};
use super::super::wgsl::{Bind, LAYOUT, Source, TILE};
use super::super::{Device, GpuError, Kernel};
use super::{BLEND_BACK, FORWARD, Shared};
use crate::adjoint::loss::Mix;
use crate::adjoint::loss::ssim::{Dissimilarity, FARTHEST, MIDDLE};
use crate::image::Image;
use crate::metric::ssim::{C1, C2};

/// Bytes of the largest buffer that worlds share, unless four worlds need more: what every WebGPU device
/// binds.
pub(super) const KEPT_BYTES: usize = 1 << 27;
/// Vectors of worlds at a time: their planes are workgroups along z, at most 65535.
const MOST_QUADS: usize = 4096;
/// Values a pixel.
const CHANNELS: usize = 3;
/// Slopes per value.
const KINDS: usize = 3;

/// Constants of the loss that must have the same value in WGSL, by name.
pub const CONSTANTS: &[(&str, f64)] = &[
    ("MIDDLE", MIDDLE as f64),
    ("C1", C1 as f32 as f64),
    ("C2", C2 as f32 as f64),
    ("FARTHEST", FARTHEST as f64),
];

/// The forward way, with pictures as its end.
pub const FILM: Source = Source {
    name: "adjoint/film.wgsl",
    parts: &[LAYOUT, TILE, STATES, FORWARD, include_str!("../../adjoint/film.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("splats", Bind::Read),
        ("starts", Bind::Read),
        ("entries", Bind::Read),
        ("masks", Bind::Read),
        ("marks", Bind::Write),
        ("film", Bind::Write),
        ("found", Bind::Write),
    ],
};

/// `1 - SSIM` and squared error, and their gradients.
pub const STRUCTURE: Source = Source {
    name: "adjoint/loss/ssim.wgsl",
    parts: &[LAYOUT, TILE, STATES, include_str!("../../adjoint/loss/ssim.wgsl")],
    bindings: &[
        ("frame", Bind::Uniform),
        ("batch", Bind::Uniform),
        ("window", Bind::Uniform),
        ("wanted", Bind::Read),
        ("target_moments", Bind::Read),
        ("film", Bind::Write),
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

/// The compiled kernels.
#[derive(Debug)]
pub(super) struct Kernels {
    draw: Kernel,
    unlike: Kernel,
    pull: Kernel,
    pull_back: Kernel,
}

impl Kernels {
    pub(super) fn new(device: &Device) -> Result<Self, GpuError> {
        Self::of(device, &STRUCTURE)
    }

    /// With another text of the loss.
    pub(super) fn of(device: &Device, structure: &Source) -> Result<Self, GpuError> {
        Ok(Self {
            draw: Kernel::new(device, &FILM, "draw", &[])?,
            unlike: Kernel::new(device, structure, "unlike", &[])?,
            pull: Kernel::new(device, structure, "pull", &[])?,
            pull_back: Kernel::new(device, &BLEND_BACK, "pull_back", &[])?,
        })
    }
}

/// What the loss knows of the picture wanted.
#[derive(Debug)]
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
            window: uniform(device, "window", bytemuck::bytes_of(&window))?,
            moments: filled(device, "moments of the target", bytemuck::cast_slice(&moments))?,
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
    draw: wgpu::BindGroup,
    unlike: wgpu::BindGroup,
    pull: wgpu::BindGroup,
    pull_back: wgpu::BindGroup,
    quads: u32,
    planes: u32,
}

/// The batch of worlds, as many together as fit.
#[derive(Debug)]
pub(super) struct Chunks {
    chunks: Vec<Chunk>,
    totals: Totals,
}

/// Vectors of worlds that go together, of `quads`, in buffers of `kept` bytes each, when `pixels` pixels and
/// `marks` bytes of transmittances are kept for each.
fn together(quads: usize, kept: usize, pixels: usize, marks: usize) -> usize {
    let slopes = 4 * QUAD * CHANNELS * KINDS * pixels;
    (kept / slopes.max(marks).max(1)).clamp(1, quads.clamp(1, MOST_QUADS))
}

impl Chunks {
    /// Room for the worlds of `batch`; `marks` are the bytes of the transmittances of four worlds.
    pub(super) fn new(
        device: &Device,
        kernels: &super::Kernels,
        structure: &Structure,
        shared: &Shared,
        batch: Batch,
        marks: usize,
    ) -> Result<Self, GpuError> {
        let tiles = shared.tiles;
        let (worlds, pixels) = (batch.worlds as usize, structure.values / CHANNELS);
        let quads = together(worlds.div_ceil(QUAD), shared.kept, pixels, marks);
        let film = storage(device, "pictures", (4 * QUAD * CHANNELS * pixels * quads) as u64)?;
        let slopes = storage(device, "slopes", (4 * QUAD * CHANNELS * KINDS * pixels * quads) as u64)?;
        let marks = storage(device, "transmittances", (marks * quads) as u64)?;
        let rows = CHANNELS * tiles.count();
        let losses = storage(device, "losses of tiles", (4 * 2 * worlds * rows) as u64)?;
        let of = &kernels.structure;
        let (frame, splats, starts) = (&tiles.frame, &tiles.splats, &tiles.starts);
        let (entries, masks, found) = (shared.entries, shared.masks, shared.found);
        let chunks = (0..worlds).step_by(QUAD * quads).map(|first| {
            let past = (first + QUAD * quads).min(worlds);
            let here = Batch { first: first as u32, past: past as u32, ..batch };
            let here = uniform(device, "batch", bytemuck::bytes_of(&here))?;
            let lists = [frame, &here, splats, starts, entries, masks, &marks];
            let loss =
                [frame, &here, &structure.window, shared.wanted, &structure.moments, &film, &slopes, &losses];
            Ok(Chunk {
                draw: of.draw.bind(device, &[&lists[..], &[&film, found]].concat()),
                unlike: of.unlike.bind(device, &loss),
                pull: of.pull.bind(device, &loss),
                pull_back: of
                    .pull_back
                    .bind(device, &[&lists[..], &[&film, shared.partials, found]].concat()),
                quads: (past - first).div_ceil(QUAD) as u32,
                planes: (CHANNELS * (past - first)) as u32,
            })
        });
        Ok(Self {
            chunks: chunks.collect::<Result<_, GpuError>>()?,
            totals: Totals::new(device, &kernels.common, &losses, [rows, 2 * worlds, 1])?,
        })
    }

    /// All chunks, one after the other; then the losses.
    pub(super) fn encode(
        &self,
        kernels: &super::Kernels,
        [columns, rows]: [u32; 2],
        pass: &mut wgpu::ComputePass,
    ) {
        let of = &kernels.structure;
        for chunk in &self.chunks {
            of.draw.run(pass, &chunk.draw, [columns, rows, chunk.quads]);
            of.unlike.run(pass, &chunk.unlike, [columns, rows, chunk.planes]);
            of.pull.run(pass, &chunk.pull, [columns, rows, chunk.planes]);
            of.pull_back.run(pass, &chunk.pull_back, [columns, rows, 1]);
        }
        self.totals.add_up(&kernels.common, pass);
    }

    /// Waits, and reads the loss of each world.
    pub(super) fn read(&self, device: &Device, structure: &Structure) -> Result<Vec<f64>, GpuError> {
        Ok(structure.losses(&self.totals.read(device)?))
    }
}

#[cfg(test)]
mod tests;
