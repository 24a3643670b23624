//! Finds which splats of a tile reach which block of 4 × 4 pixels.
//!
//! A block is the unit of all fast modes: its sixteen pixels are one row of lanes, and all of them share
//! one list of splats. The culling is conservative, as every skip: what it leaves out is below the cut-off
//! on every pixel of the block.

use super::shared_lists::SharedLists;
use crate::{
    settings::Settings,
    stage::{
        REACH_MARGIN, Splat, TILE,
        blend::{Lanes, exp2},
    },
};

/// Side of a block, pixels. Small blocks meet few groups, so worlds fall into few classes.
pub(super) const SIDE: usize = 4;
/// Blocks along a side of a tile.
pub(super) const ACROSS: usize = TILE / SIDE;
/// Blocks of a tile.
pub(super) const BLOCKS: usize = ACROSS * ACROSS;

/// Column of each lane within its block.
pub(super) const COLUMN: Lanes = grid(false);
/// Row of each lane within its block.
pub(super) const ROW: Lanes = grid(true);

const fn grid(down: bool) -> Lanes {
    let mut out = [0.0; TILE];
    let mut i = 0;
    while i < TILE {
        out[i] = if down { (i / SIDE) as f32 } else { (i % SIDE) as f32 };
        i += 1;
    }
    out
}

/// A splat as one tile sees it.
#[derive(Clone, Copy, Debug)]
pub(super) struct TileSplat {
    /// `u` and `v` at the tile's first pixel centre.
    origin: [f32; 2],
    root: [f32; 3],
    log2_alpha: f32,
    pub colour: [f32; 3],
    /// Its group, as an index into the tile's groups.
    pub local: u32,
}

/// The splats of one tile, nearest first, and the blocks that each reaches.
#[derive(Debug, Default)]
pub(super) struct TileCulling {
    splats: Vec<TileSplat>,
    /// Bit `b` is set where the splat may reach block `b`.
    reach: Vec<u16>,
    /// The splats as they were projected, side by side.
    copies: Vec<Splat>,
}

impl TileCulling {
    /// Takes the splats of `tile`.
    pub(super) fn fill(&mut self, shared: &SharedLists, tile: usize, settings: &Settings) {
        pulp::Arch::new().dispatch(Fill { shared, tile, settings, culling: self });
    }

    /// The splats.
    pub(super) fn splats(&self) -> &[TileSplat] {
        &self.splats
    }

    /// The same as they were projected.
    pub(super) fn copies(&self) -> &[Splat] {
        &self.copies
    }

    /// Writes the positions of the splats that may reach `block`, nearest first, to the start of `out`.
    /// Returns how many.
    #[inline(always)]
    pub(super) fn block(&self, block: usize, out: &mut Vec<u32>) -> usize {
        if out.len() <= self.splats.len() {
            out.resize(self.splats.len() + 1, 0);
        }
        let mut count = 0;
        for (at, &reach) in (0..).zip(&self.reach) {
            out[count] = at;
            count += usize::from(reach >> block & 1);
        }
        count
    }
}

struct Fill<'a> {
    shared: &'a SharedLists,
    tile: usize,
    settings: &'a Settings,
    culling: &'a mut TileCulling,
}

impl pulp::NullaryFnOnce for Fill<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { shared, tile, settings, culling: TileCulling { splats, reach, copies } } = self;
        splats.clear();
        reach.clear();
        let corner = shared.corner(tile);
        let centre = [corner[0] as f64 + 0.5, corner[1] as f64 + 0.5];
        let margin = REACH_MARGIN - settings.log2_cutoff() as f32;
        // Copied first: reads from all over memory overlap when nothing waits for them.
        let entries = shared.entries(tile);
        copies.clear();
        copies.extend(entries.iter().map(|entry| shared.projected.splats[entry.splat as usize]));
        for (entry, splat) in entries.iter().zip(copies.iter()) {
            // As the blend sees it: the same origin, bit for bit.
            let (dx, dy) = (centre[0] - splat.mean[0], centre[1] - splat.mean[1]);
            let [xx, xy, yy] = splat.root;
            let near = TileSplat {
                origin: [(xx * dx + xy * dy) as f32, (yy * dy) as f32],
                root: splat.root.map(|v| v as f32),
                log2_alpha: splat.log2_alpha,
                colour: splat.colour,
                local: entry.local,
            };
            let first = usize::from(splat.pixels[2]).saturating_sub(corner[1]);
            let past = usize::from(splat.pixels[3]).saturating_sub(corner[1]).min(TILE);
            reach.push(near.blocks(splat.log2_alpha + margin, first..past));
            splats.push(near);
        }
    }
}

impl TileSplat {
    /// Alpha on the pixels of `block`, 0 below the cut-off: that of the blend, bit for bit.
    #[inline(always)]
    pub(super) fn alphas(&self, block: usize, [cutoff, max]: [f32; 2]) -> Lanes {
        let (left, top) = ((block % ACROSS * SIDE) as f32, (block / ACROSS * SIDE) as f32);
        let [xx, xy, yy] = self.root;
        let mut out = [0.0; TILE];
        for i in 0..TILE {
            let (x, y) = (left + COLUMN[i], top + ROW[i]);
            let (u, v) = (self.origin[0] + xy * y, self.origin[1] + yy * y);
            let q = u + xx * x;
            let alpha = exp2(self.log2_alpha - v * v - q * q);
            let alpha = if alpha < max { alpha } else { max };
            out[i] = if alpha >= cutoff { alpha } else { 0.0 };
        }
        out
    }

    /// `u` and `v` on the pixels of `block`.
    #[inline(always)]
    pub(super) fn axes(&self, block: usize) -> (Lanes, Lanes) {
        let (left, top) = ((block % ACROSS * SIDE) as f32, (block / ACROSS * SIDE) as f32);
        let [xx, xy, yy] = self.root;
        let (mut u, mut v) = ([0.0; TILE], [0.0; TILE]);
        for i in 0..TILE {
            let (x, y) = (left + COLUMN[i], top + ROW[i]);
            u[i] = self.origin[0] + xy * y + xx * x;
            v[i] = self.origin[1] + yy * y;
        }
        (u, v)
    }

    /// Blocks that hold a pixel centre near the ellipse `u² + v² ≤ reach` within `rows`.
    ///
    /// With `k = xy / yy`, a point of the ellipse lies at `xx·x = u - k·v + (k·v₀ - u₀)`, so the ends of a
    /// strip of rows are those of `±√(reach - v²) - k·v` over an interval of `v`.
    #[inline(always)]
    fn blocks(&self, reach: f32, rows: std::ops::Range<usize>) -> u16 {
        let [u0, v0] = self.origin;
        let [xx, xy, yy] = self.root;
        let (radius, k, per_x) = (reach.max(0.0).sqrt(), xy / yy, 1.0 / xx);
        let shift = k * v0 - u0;
        let extreme = k * radius / (1.0 + k * k).sqrt();
        // What rounding may hide, and a little more.
        let slack = 0.01 + 1e-5 * (radius + k.abs() * (radius + v0.abs()) + u0.abs()) * per_x;
        let mut ends = [[0.0f32; ACROSS]; 2];
        for (strip, row) in (0..ACROSS).zip([0.0, 4.0, 8.0, 12.0f32]) {
            let (low, high) = ((v0 + yy * row).max(-radius), (v0 + yy * (row + 3.0)).min(radius));
            let right = (-extreme).min(high).max(low);
            let left = extreme.min(high).max(low);
            let half = |v: f32| (reach - v * v).max(0.0).sqrt();
            ends[0][strip] = (shift - k * left - half(left)) * per_x - slack;
            ends[1][strip] = (shift - k * right + half(right)) * per_x + slack;
        }
        let mut hits = [0u16; BLOCKS];
        for (b, hit) in hits.iter_mut().enumerate() {
            let (strip, left) = (b / ACROSS, (b % ACROSS * SIDE) as f32);
            // A bound that is not a number leaves the whole strip.
            let out = (ends[0][strip] > left + 3.0) | (ends[1][strip] < left);
            *hit = u16::from(!out) << b;
        }
        let out = hits.iter().fold(0, |all, hit| all | hit);
        let strips = |rows: usize| (1u32 << (ACROSS * rows.div_ceil(SIDE))) - 1;
        let above = (1u32 << (rows.start / SIDE * ACROSS)) - 1;
        out & (strips(rows.end) & !above) as u16
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    /// A splat with its mean at `mean` from the tile's first pixel centre, and the reach of its cut-off.
    fn near(mean: [f32; 2], axes: [f32; 2], turn: f32, log2_alpha: f32) -> (TileSplat, f32) {
        // Root of the inverse covariance of an ellipse with these half axes, by its Cholesky factor.
        let (sin, cos) = turn.sin_cos();
        let [a, b] = axes.map(|axis| 1.0 / (axis * axis));
        let (xx, xy, yy) =
            (a * cos * cos + b * sin * sin, (a - b) * sin * cos, a * sin * sin + b * cos * cos);
        let root = [xx.sqrt(), xy / xx.sqrt(), (yy - xy * xy / xx).max(1e-12).sqrt()];
        let [dx, dy] = mean.map(|m| -m);
        let origin = [root[0] * dx + root[1] * dy, root[2] * dy];
        let near = TileSplat { origin, root, log2_alpha, colour: [1.0; 3], local: 0 };
        (near, REACH_MARGIN + log2_alpha - (1.0f32 / 255.0).log2())
    }

    proptest! {
        #![proptest_config(ProptestConfig::with_cases(2000))]

        #[test]
        fn no_block_that_is_touched_is_left_out(
            mean in [-40.0f32..56.0, -40.0f32..56.0], long in 0.3f32..60.0, ratio in 0.01f32..1.0,
            turn in 0.0f32..3.2, log2_alpha in -7.9f32..0.0,
        ) {
            let (near, reach) = near(mean, [long, (long * ratio).max(0.3)], turn, log2_alpha);
            let blocks = near.blocks(reach, 0..TILE);
            for block in 0..BLOCKS {
                let alphas = near.alphas(block, [1.0 / 255.0, 0.99]);
                let touched = alphas.iter().any(|&a| a > 0.0);
                prop_assert!(!touched || blocks >> block & 1 == 1, "block {block} of {blocks:#018b}");
            }
        }
    }

    #[test]
    fn blocks_far_from_a_splat_are_left_out() {
        let (speck, reach) = near([5.0, 9.0], [0.6, 0.6], 0.0, -0.1);
        assert_eq!(speck.blocks(reach, 8..11), 1 << 9);
        let (needle, reach) = near([7.5, 7.5], [9.0, 0.3], std::f32::consts::FRAC_PI_4, -0.1);
        let blocks = needle.blocks(reach, 0..TILE);
        assert!(blocks.count_ones() <= 10 && blocks & 0x8421 == 0x8421, "{blocks:#018b}");
        // Rows outside the splat's box do not count.
        assert_eq!(needle.blocks(reach, 4..8) & !0x00f0, 0);
        assert_eq!(needle.blocks(reach, 8..8), 0);
    }
}
