//! Finds which tiles of a row a splat touches: the twin of `span.wgsl`.
//!
//! A span is exact: the cut-off ellipse over the pixel centres of one tile row is a convex piece, whose
//! left and right ends have a closed form (the idea of SnugBox/AccuTile in Speedy-Splat).

use std::ops::Range;

use super::{REACH_MARGIN, SMALL_BOX, Splat, TileSide};
use crate::settings::Settings;

/// How splats are given to tiles.
pub(crate) struct Spans {
    exact_tiles: bool,
    cull_entries: bool,
    opacity_bounds: bool,
    log2_cutoff: f64,
    tile: TileSide,
}

impl Spans {
    pub(crate) fn new(settings: &Settings) -> Self {
        let &Settings { exact_tiles, cull_entries, opacity_bounds, tile, .. } = settings;
        Self { exact_tiles, cull_entries, opacity_bounds, log2_cutoff: settings.log2_cutoff(), tile }
    }

    /// Calls `push` with each tile row of `band` in which `splat` is listed, and the columns where; never
    /// with an empty range. Returns the number of tiles of the band in its box.
    #[inline]
    pub(crate) fn spans(
        &self,
        splat: &Splat,
        band: &Range<usize>,
        push: &mut impl FnMut(usize, Range<usize>),
    ) -> u64 {
        let (rows, columns) = (splat.tile_rows(self.tile), splat.tile_columns(self.tile));
        let visible = rows.start.max(band.start)..rows.end.min(band.end);
        let boxed = (visible.len() * columns.len()) as u64;
        if !self.exact_tiles {
            visible.for_each(|row| push(row, columns.clone()));
        } else if rows.len() * columns.len() <= SMALL_BOX && !self.cull_entries {
            // Too few tiles could be left out to pay for the looking.
            visible.for_each(|row| push(row, columns.clone()));
        } else {
            self.exact(splat, visible, push);
        }
        boxed
    }

    /// Spans of the tiles that hold a pixel centre of the ellipse's bounding strip in each tile row.
    #[inline]
    fn exact(&self, splat: &Splat, visible: Range<usize>, push: &mut impl FnMut(usize, Range<usize>)) {
        let [xx, xy, yy] = splat.root;
        let log2_alpha = if self.opacity_bounds { f64::from(splat.log2_alpha) } else { 0.0 };
        let reach = log2_alpha - self.log2_cutoff + f64::from(REACH_MARGIN);
        // The ellipse is u² + v² ≤ reach. Its rightmost point lies at dy = extreme, its leftmost at -extreme.
        let (top, extreme) = (reach.sqrt() / yy, -xy * reach.sqrt() / (yy * yy.hypot(xy)));
        let [x0, x1, y0, y1] = splat.pixels.map(usize::from);
        let half = |dy: f64| (reach - (yy * dy) * (yy * dy)).max(0.0).sqrt();
        let right = |dy: f64| splat.mean[0] + (half(dy) - xy * dy) / xx;
        let left = |dy: f64| splat.mean[0] - (half(dy) + xy * dy) / xx;
        // Pixel centres are at halves; a hair of slack covers rounding of the two ends.
        let centres = |left: f64, right: f64| {
            let slack = 1e-6 + 1e-12 * (right - left);
            let from = (left - 0.5 - slack).ceil().max(x0 as f64);
            let past = ((right - 0.5 + slack).floor() + 1.0).min(x1 as f64);
            (from < past).then_some((from, past))
        };
        let side = self.tile.pixels();
        for row in visible {
            let first = (row * side).max(y0) as f64 + 0.5 - splat.mean[1];
            let last = ((row + 1) * side).min(y1) as f64 - 0.5 - splat.mean[1];
            let (low, high) = (first.max(-top), last.min(top));
            if low > high {
                continue;
            }
            let found = if !self.cull_entries {
                centres(left((-extreme).clamp(low, high)), right(extreme.clamp(low, high)))
            } else if last - first < 3.5 {
                // Few pixel rows, as specks have: each for itself, and the hull of those that are hit.
                let rows = (0..4).map(|k| first + f64::from(k)).filter(|dy| (low..=high).contains(dy));
                rows.filter_map(|dy| centres(left(dy), right(dy))).reduce(|a, b| (a.0.min(b.0), a.1.max(b.1)))
            } else {
                // An end is a concave function of dy, so the pixel row on one side of its peak has it.
                let around = |at: f64| {
                    let below = first + (at - first).floor().clamp(0.0, last - first);
                    [below, (below + 1.0).min(last)]
                };
                let [a, b] = around((-extreme).clamp(low, high)).map(left);
                let [c, d] = around(extreme.clamp(low, high)).map(right);
                centres(a.min(b), c.max(d))
            };
            if let Some((from, past)) = found {
                push(row, self.tile.of(from as usize)..self.tile.tiles(past as usize));
            }
        }
    }
}
