//! Estimates how good a picture is from what of its blocks has come: a receiver has no complete picture to
//! compare with.

use std::ops::Range;

use codec_core::internals::{
    ids::{ClusterId, Span},
    layout::Shape,
    receiver::Content,
};
use dgs_player::Result;
use render_host::Gaussian;

/// Levels there are, base included.
pub const LEVELS: usize = 4;

/// Share of a block's error that is gone at each level: three quarters with the base; refinements divide
/// steps by three unless told otherwise, and what is left by nine.
const GONE: [f32; LEVELS + 1] = [0.0, 0.75, 0.972, 0.997, 1.0];

/// A block of a frame.
pub(super) struct BlockOfFrame {
    pub(super) cluster: ClusterId,
    pub(super) block: usize,
    /// Levels that can be used, 0 to 4.
    pub(super) usable: usize,
    /// Its Gaussians among those of the frame.
    pub(super) gaussians: Range<usize>,
}

/// Blocks of a frame of `count` Gaussians in which `span` is shown, in their order.
///
/// # Errors
/// None in practice: content is as its manifest says.
pub(super) fn blocks_of(content: &Content, span: Span, count: usize) -> Result<Vec<BlockOfFrame>> {
    let mut blocks = Vec::new();
    let mut first = 0;
    for cluster in 0..content.manifest.clusters_of(span).unwrap_or(0) {
        let cluster = ClusterId(cluster as u16);
        let shape = Shape::in_lattice(content.manifest, span, cluster)?;
        let cell = content.cell_in_lattice(span, cluster)?;
        for block in 0..shape.blocks() {
            let usable = content.arrived(cell, block)?.usable().min(LEVELS);
            let start = (first + shape.first_of(block)).min(count);
            let past = (start + shape.block_gaussians(block)).min(count);
            blocks.push(BlockOfFrame { cluster, block, usable, gaussians: start..past });
        }
        first += shape.gaussians();
    }
    Ok(blocks)
}

/// How much of a picture Gaussians can cover: the sum of opacity times area of the largest cross-section.
fn coverage(gaussians: &[Gaussian]) -> f32 {
    gaussians.iter().map(coverage_of).sum()
}

/// The same of one.
pub(super) fn coverage_of(gaussian: &Gaussian) -> f32 {
    let [x, y, z] = gaussian.scale;
    let area = (x * y).max(y * z).max(z * x);
    if area.is_finite() { gaussian.opacity * area } else { 0.0 }
}

/// Of each block, how much error of a picture what has not come would take away, estimated; and the most that
/// it is of any of them without a level.
pub(super) fn missing(blocks: &[BlockOfFrame], gaussians: &[Gaussian]) -> (Vec<f32>, f32) {
    let mut most = f32::MIN_POSITIVE;
    let of_block = |block: &BlockOfFrame| {
        let covered = coverage(&gaussians[block.gaussians.clone()]);
        most = most.max(covered);
        covered * (1.0 - GONE[block.usable])
    };
    let each = blocks.iter().map(of_block).collect();
    (each, most)
}

/// An estimate between 0, nothing but stand-ins, and 1, everything there: the share of the error that is
/// gone, blocks counted by what they can cover.
pub(super) fn quality(blocks: &[BlockOfFrame], gaussians: &[Gaussian]) -> f32 {
    let (mut gone, mut all) = (0.0, 0.0);
    for block in blocks {
        let covered = coverage(&gaussians[block.gaussians.clone()]);
        gone += covered * GONE[block.usable];
        all += covered;
    }
    if all > 0.0 { gone / all } else { 1.0 }
}
