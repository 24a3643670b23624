//! Says which rows of a tile a splat reaches, and what alpha it has there.

use super::{REACH_MARGIN, Splat, TILE, power::exp2};
use crate::settings::Settings;

/// A value per pixel of one row of a tile.
pub(crate) type Lanes = [f32; TILE];

/// 0, 1, … 15.
pub(crate) const LANE: Lanes = {
    let mut lane = [0.0; TILE];
    let mut i = 0;
    while i < TILE {
        lane[i] = i as f32;
        i += 1;
    }
    lane
};

/// What decides whether a splat is blended into a pixel.
#[derive(Clone, Copy)]
pub(crate) struct Rules {
    pub(crate) cutoff: f32,
    pub(crate) max: f32,
    pub(crate) stop: f32,
    /// Added to `log2_alpha` gives the largest `u² + v²` worth a look.
    pub(super) reach: f32,
}

impl Rules {
    pub(crate) fn new(settings: &Settings) -> Self {
        let reach =
            if settings.row_reach { REACH_MARGIN - settings.log2_cutoff() as f32 } else { f32::INFINITY };
        Self { cutoff: settings.cutoff(), max: settings.alpha_max, stop: settings.closed_below(), reach }
    }

    /// Alpha of a pixel of transmittance `t`, 0 where the splat is left out.
    #[inline(always)]
    pub(crate) fn alpha(&self, log2: f32, t: f32) -> f32 {
        let alpha = exp2(log2);
        let alpha = if alpha < self.max { alpha } else { self.max };
        if (alpha >= self.cutoff) & (t >= self.stop) { alpha } else { 0.0 }
    }
}

/// A splat as one tile sees it. The adjoint walks the same rows.
pub(crate) struct Local {
    /// `u` and `v` at the tile's first pixel centre.
    pub(crate) origin: [f32; 2],
    pub(crate) root: [f32; 3],
    reach: f32,
    /// Half-open range of rows of its pixel box.
    pub(crate) first: usize,
    pub(crate) past: usize,
}

impl Local {
    #[inline(always)]
    pub(crate) fn new(splat: &Splat, corner: [usize; 2], rules: &Rules) -> Self {
        // Position of the tile's first pixel centre in the splat's own axes, in f64: what remains is
        // at most 16 pixels long.
        let [dx, dy] = offset(splat, corner);
        let [xx, xy, yy] = splat.root;
        Self {
            origin: [(xx * dx + xy * dy) as f32, (yy * dy) as f32],
            root: splat.root.map(|v| v as f32),
            reach: splat.log2_alpha + rules.reach,
            first: usize::from(splat.pixels[2]).saturating_sub(corner[1]),
            past: usize::from(splat.pixels[3]).saturating_sub(corner[1]).min(TILE),
        }
    }

    /// `u` and `v` at the first pixel centre of every row, and which rows of the box are within reach.
    #[inline(always)]
    pub(crate) fn rows(&self) -> Reached {
        let [xx, xy, yy] = self.root;
        let (mut u, mut v, mut bits) = ([0.0; TILE], [0.0; TILE], [0; TILE]);
        for y in 0..TILE {
            u[y] = self.origin[0] + xy * LANE[y];
            v[y] = self.origin[1] + yy * LANE[y];
            let left = self.reach - v[y] * v[y];
            // Distance of the row's 16 centres from the splat's axis; 0 when they straddle it.
            let right = -(u[y] + 15.0 * xx);
            let gap = if u[y] > right { u[y] } else { right };
            let gap = if gap > 0.0 { gap } else { 0.0 };
            bits[y] = if gap * gap > left { 0 } else { ROW_BITS[y] };
        }
        let within = bits.iter().fold(0, |all, bit| all | bit);
        Reached { u, v, rows: within & row_bits(self.first, self.past) }
    }
}

/// Rows that a splat reaches.
pub(crate) struct Reached {
    /// `u` and `v` at the first pixel centre of each row.
    pub(crate) u: Lanes,
    pub(crate) v: Lanes,
    /// Bit `y` is set where row `y` is reached.
    pub(crate) rows: u32,
}

/// Bit `y` of row `y`.
const ROW_BITS: [u32; TILE] = {
    let mut bits = [0; TILE];
    let mut y = 0;
    while y < TILE {
        bits[y] = 1 << y;
        y += 1;
    }
    bits
};

/// Bits of rows `first` to `past`, half-open, of at most [`TILE`].
#[inline(always)]
pub(crate) fn row_bits(first: usize, past: usize) -> u32 {
    let below = |row: usize| (1u32 << row.min(TILE)) - 1;
    below(past) & !below(first)
}

/// Calls `work` with each row of `rows`, from the top.
#[inline(always)]
pub(crate) fn for_each_row(mut rows: u32, mut work: impl FnMut(usize)) {
    while rows != 0 {
        // Below TILE, which the compiler cannot know.
        work(rows.trailing_zeros() as usize % TILE);
        rows &= rows - 1;
    }
}

/// First pixel centre of the tile at `corner`, from the splat's centre, pixels.
#[inline(always)]
pub(crate) fn offset(splat: &Splat, corner: [usize; 2]) -> [f64; 2] {
    [corner[0] as f64 + 0.5 - splat.mean[0], corner[1] as f64 + 0.5 - splat.mean[1]]
}
