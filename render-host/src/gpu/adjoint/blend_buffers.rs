//! A walk holds the buffers that blending worlds front to back and back again reads and adds to.

use super::super::{
    source::{Bind, LAYOUT, Source, TILE},
    states::STATES,
};

/// Blending front to back, and what stays in workgroup memory on the way back.
pub const FORWARD: &str = include_str!("../../adjoint/forward.wgsl");

/// Adjoint of stage 4, and squared error.
pub static BLEND_BACK: Source = Source {
    name: "adjoint/blend.wgsl",
    parts: &[LAYOUT, TILE, STATES, FORWARD, include_str!("../../adjoint/blend.wgsl")],
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

/// What all worlds of a batch share.
#[derive(Debug)]
pub struct BlendBuffers {
    /// The camera and its settings.
    pub frame: wgpu::Buffer,
    /// Projected splats.
    pub splats: wgpu::Buffer,
    /// Where tile lists start.
    pub starts: wgpu::Buffer,
    /// Tile lists with their blocks.
    pub entries: wgpu::Buffer,
    /// Which worlds include which groups.
    pub masks: wgpu::Buffer,
    /// Gradients of every entry.
    pub partials: wgpu::Buffer,
    /// Losses of every tile, then gradients of the background.
    pub found: wgpu::Buffer,
    /// The picture wanted.
    pub wanted: wgpu::Buffer,
    /// Columns and rows of tiles.
    pub grid: [u32; 2],
}

impl BlendBuffers {
    /// The first seven bindings of every kernel that blends.
    pub fn lists<'a>(&'a self, batch: &'a wgpu::Buffer, marks: &'a wgpu::Buffer) -> [&'a wgpu::Buffer; 7] {
        [&self.frame, batch, &self.splats, &self.starts, &self.entries, &self.masks, marks]
    }
}
