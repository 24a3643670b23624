//! The stages of rendering, one file each, in the order of the walk: project → sort → bin → blend.
//!
//! Depth order is made once, for the whole image; tile lists are then filled by a counting scatter in
//! that order, so they are sorted without being sorted. What a stage decides is written down and read
//! back by the next: no decision is made twice.
//!
//! `NAME.wgsl` beside `NAME.rs` is the same stage on a graphics device; `layout.wgsl`, `span.wgsl` and
//! `tile.wgsl` are what several share, `plan.wgsl` and `starts.wgsl` the steps between, `worlds.wgsl` is
//! blend for a batch of worlds.

pub mod bin;
pub mod blend;
mod fade;
mod half;
mod power;
pub mod project;
pub(crate) mod reach;
mod side;
pub mod sort;
pub(crate) mod span;

pub use side::{TileSide, TileSideError};

/// Side of a tile, pixels, unless [`TileSide`] says otherwise; and of a cell, in which pixels are blended
/// and kept whatever the tiles are.
pub const TILE: usize = 16;

/// log₂ of alpha by which skips reach past the cut-off, so that rounding in the blend (about 2e-6) can
/// never make a skip visible.
pub(crate) const REACH_MARGIN: f32 = 1e-4;

/// A projected splat: one cache line, all that bin and blend read.
///
/// Alpha at pixel centre `p`, with `d = p - mean`, is `2^(log2_alpha - u² - v²)` where
/// `u = root[0]·dx + root[1]·dy` and `v = root[2]·dy`: the Cholesky factor of half the inverse
/// covariance, in base-2 units. A sum of squares cannot cancel as the usual `a·dx² + 2b·dx·dy + c·dy²`
/// does for needles, and `v` is constant along a row. Mean and factor are f64 because they are only used
/// once per tile, to find `u` and `v` at its corner; what is left inside a tile fits f32 well.
#[derive(Clone, Copy, Debug, PartialEq)]
#[repr(C, align(64))]
pub struct Splat {
    /// Centre, pixels from the top left corner of the image.
    pub mean: [f64; 2],
    /// Upper triangular factor `[xx, xy, yy]`, 1 / pixels; `xx` and `yy` are above 0.
    pub root: [f64; 3],
    /// Display colour r g b, ≥ 0 and finite.
    pub colour: [f32; 3],
    /// log₂ of alpha at the centre, ≤ 0.
    pub log2_alpha: f32,
    /// Half-open pixel box `[x0, x1, y0, y1]` inside the image; outside it alpha is below the cut-off.
    pub pixels: [u16; 4],
}

impl Splat {
    /// Fills slots of Gaussians that were skipped.
    pub const NONE: Self =
        Self { mean: [0.0; 2], root: [1.0, 0.0, 1.0], colour: [0.0; 3], log2_alpha: -200.0, pixels: [0; 4] };

    /// Half-open range of tile columns of the pixel box.
    #[inline]
    pub fn tile_columns(&self, side: TileSide) -> std::ops::Range<usize> {
        side.of(self.pixels[0].into())..side.tiles(self.pixels[1].into())
    }

    /// Half-open range of tile rows of the pixel box.
    #[inline]
    pub fn tile_rows(&self, side: TileSide) -> std::ops::Range<usize> {
        side.of(self.pixels[2].into())..side.tiles(self.pixels[3].into())
    }
}

/// Tiles in the box of a splat up to which it is listed in all of them. Measured: the exact bounds of so
/// small a box cost more than the entries that they leave out.
pub(crate) const SMALL_BOX: usize = 6;

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_splat_is_one_cache_line() {
        assert_eq!((size_of::<Splat>(), align_of::<Splat>()), (64, 64));
    }

    #[test]
    fn tile_ranges_cover_the_pixel_box() {
        let splat = Splat { pixels: [15, 17, 32, 48], ..Splat::NONE };
        let ranges = |side| (splat.tile_columns(side), splat.tile_rows(side));
        assert_eq!(TileSide::ALL.map(ranges), [(1..3, 4..6), (0..2, 2..3), (0..1, 1..2)]);
        assert!(Splat::NONE.tile_rows(TileSide::Sixteen).is_empty());
    }
}
