//! The adjoint of stage 4 takes gradients of pixels back to the ellipses that were blended into them.
//!
//! With `behind` the colour behind a splat, a pixel is `… + T·(a·c + (1 - a)·behind)`. So for a pixel
//! gradient `g`: `dL/dc = T·a·g`, `dL/da = T·(g·c - g·behind)`, and one number per pixel, `g·behind`, is
//! carried from back to front. Nothing is divided.

use std::{ops::Range, sync::Mutex};

use pulp::Simd;

use super::{
    gradients::DensityStatistics,
    term::{Term, dropped, flipped, keep},
    trace::{Rows, Trace},
};
use crate::{
    parallel,
    settings::Settings,
    stage::{
        Splat, TILE,
        bin::Bins,
        blend::{self, SEGMENT, Tile, Transmittances},
        reach::{LANE, Lanes, Rules, offset},
    },
};

/// Numbers per splat: centre (2), root (3), log₂ alpha, colour (3).
pub(crate) const PARTS: usize = 9;
/// Gradient of one ellipse, summed over tiles.
pub(crate) type Ellipse = [f64; PARTS];
/// The part of log₂ alpha.
pub(super) fn log2_alpha(ellipse: &Ellipse) -> f64 {
    ellipse[5]
}

/// Gradient of one ellipse from one tile.
pub(crate) type Partial = [f32; PARTS];

/// Sums over the pixels of a tile: h, h·q, h·q·y, h·v, h·v·y and three colours, where h = dL/d(exponent).
const SUMS: usize = 8;

/// Statistics of one splat in one tile: sum of lengths of the centre's gradient, of blend weights, pixels.
type TileStatistics = [f32; STATISTICS];
/// Numbers in [`TileStatistics`].
const STATISTICS: usize = 3;

/// Gradients of the tiles of a band.
#[derive(Debug, Default)]
pub(super) struct Tiles {
    tiles: Vec<TileGradients>,
    /// Scratch memory, passed from tile to tile; what it held does not matter.
    pool: Mutex<Vec<Box<Scratch>>>,
}

#[derive(Clone, Debug, Default)]
struct TileGradients {
    /// One per entry of the tile's list; none where no pixel has a gradient.
    partials: Vec<Partial>,
    /// Likewise, if asked for.
    statistics: Vec<TileStatistics>,
    background: [f32; 3],
    /// Values of the picture's gradient that were not finite and count as 0.
    non_finite: u64,
}

#[derive(Debug, Default)]
struct Scratch {
    trace: Trace,
    /// Pixel gradient times the colour behind.
    behind: Rows,
    /// Pixel gradients, r g b.
    gradient: [Rows; 3],
}

/// A picture as it was blended, and the gradient of a loss with respect to it.
#[derive(Clone, Copy)]
pub(super) struct Picture<'a> {
    /// Width and height, pixels.
    pub(super) size: [usize; 2],
    /// dLoss/dImage, r g b per pixel; where it is not finite it counts as 0.
    pub(super) gradient: &'a [f32],
    /// The tiles of the band, with marks.
    pub(super) cells: &'a blend::Tiles,
}

/// Differentiates the tiles of a band. A tile without a pixel that has a gradient is not walked, unless
/// `statistics` are asked for.
pub(super) fn blend(
    splats: &[Splat],
    bins: &Bins,
    band: &Range<usize>,
    picture: Picture<'_>,
    settings: &Settings,
    statistics: bool,
    out: &mut Tiles,
) {
    let Picture { size, gradient: image, cells } = picture;
    let columns = size[0].div_ceil(TILE);
    let Tiles { tiles, pool } = out;
    let pool = &*pool;
    tiles.resize(columns * band.len(), TileGradients::default());
    let arch = pulp::Arch::new();
    parallel::for_each(settings.parallel, tiles, |index, found| {
        let (row, column) = (index / columns, index % columns);
        let corner = [column * TILE, (band.start + row) * TILE];
        let list = bins.rows()[row].tile(column);
        let mut scratch = pool.lock().ok().and_then(|mut pool| pool.pop()).unwrap_or_default();
        let cell = &cells.tiles[index];
        let scratch_memory = &mut *scratch;
        arch.dispatch(Backward {
            splats,
            list,
            cell,
            corner,
            size,
            settings,
            image,
            statistics,
            found,
            scratch: scratch_memory,
        });
        if let Ok(mut pool) = pool.lock() {
            pool.push(scratch);
        }
    });
}

/// Adds the statistics of the tiles of a band to those of each Gaussian, in order of tiles.
pub(super) fn gather_statistics(
    tiles: &Tiles,
    bins: &Bins,
    columns: usize,
    parallel: bool,
    out: &mut [DensityStatistics],
) {
    // As in `gather`.
    let size = out.len().div_ceil(pieces(parallel)).max(1);
    parallel::for_each_chunk(parallel, out, size, |piece, out| {
        let first = piece * size;
        for (index, tile) in tiles.tiles.iter().enumerate() {
            let list = bins.rows()[index / columns].tile(index % columns);
            for (&splat, &[gradient, weight, pixels]) in list.iter().zip(&tile.statistics) {
                let Some(sum) = out.get_mut((splat as usize).wrapping_sub(first)) else { continue };
                sum.gradient += gradient;
                sum.weight += weight;
                // A whole number of at most 256.
                sum.pixels += pixels as u32;
            }
        }
    });
}

/// Pieces that sums over tiles are made in.
fn pieces(parallel: bool) -> usize {
    if parallel { rayon::current_num_threads() } else { 1 }
}

/// Adds what the tiles of a band found to each ellipse, in order of tiles; returns how many values of the
/// picture's gradient were not finite.
pub(super) fn gather(
    tiles: &Tiles,
    bins: &Bins,
    columns: usize,
    parallel: bool,
    ellipses: &mut [Ellipse],
    background: &mut [f64; 3],
) -> u64 {
    // Each piece reads every list and keeps what is its own: the order of each sum is that of the tiles,
    // however many pieces there are.
    let size = ellipses.len().div_ceil(pieces(parallel)).max(1);
    parallel::for_each_chunk(parallel, ellipses, size, |piece, ellipses| {
        let first = piece * size;
        for (index, found) in tiles.tiles.iter().enumerate() {
            let list = bins.rows()[index / columns].tile(index % columns);
            for (&splat, partial) in list.iter().zip(&found.partials) {
                if let Some(sum) = ellipses.get_mut((splat as usize).wrapping_sub(first)) {
                    (0..PARTS).for_each(|k| sum[k] += f64::from(partial[k]));
                }
            }
        }
    });
    for found in &tiles.tiles {
        (0..3).for_each(|c| background[c] += f64::from(found.background[c]));
    }
    tiles.tiles.iter().map(|tile| tile.non_finite).sum()
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct Backward<'a> {
    splats: &'a [Splat],
    list: &'a [u32],
    /// The tile as it was blended; anything if the list is empty.
    cell: &'a Tile,
    corner: [usize; 2],
    size: [usize; 2],
    settings: &'a Settings,
    image: &'a [f32],
    statistics: bool,
    found: &'a mut TileGradients,
    scratch: &'a mut Scratch,
}

impl pulp::WithSimd for Backward<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { splats, list, cell, corner, size, settings, image, statistics, found, scratch } = self;
        found.partials.clear();
        found.statistics.clear();
        (found.background, found.non_finite) = ([0.0; 3], 0);
        if !statistics && is_zero(image, corner, size) {
            return;
        }
        let rules = Rules::new(settings);
        found.partials.resize(list.len(), [0.0; PARTS]);
        if statistics {
            found.statistics.resize(list.len(), [0.0; STATISTICS]);
        }
        found.non_finite = scratch.open(image, corner, size);
        // Columns of the picture.
        let columns = size[0] - corner[0];
        let inside: Lanes = std::array::from_fn(|i| if i < columns { 1.0 } else { 0.0 });

        let now = if list.is_empty() { [[1.0; TILE]; TILE] } else { cell.transmittances() };
        found.background = scratch.turn(settings.background, &now);
        for (k, (segment, before)) in list.chunks(SEGMENT).zip(&cell.marks).enumerate().rev() {
            let start = k * SEGMENT;
            scratch.trace.walk(splats, segment, corner, &rules, before);
            let partials = &mut found.partials[start..start + segment.len()];
            for (i, partial) in partials.iter_mut().enumerate().rev() {
                let visits = scratch.trace.visits(i);
                if !visits.is_empty() {
                    let splat = scratch.trace.near[i];
                    let sums = if statistics {
                        let (sums, of_visits) =
                            scratch.sweep::<S, true>(simd, visits, &splat, rules.max, &inside);
                        found.statistics[start + i] = totals_of_statistics(&of_visits);
                        sums
                    } else {
                        scratch.sweep::<S, false>(simd, visits, &splat, rules.max, &inside).0
                    };
                    *partial = chain(&sums, &splat, corner);
                }
            }
        }
    }
}

impl Scratch {
    /// Starts a tile: pixel gradients of the image, 0 outside it and where they are not finite. Returns how
    /// many were not.
    #[inline(always)]
    fn open(&mut self, image: &[f32], corner: [usize; 2], size: [usize; 2]) -> u64 {
        self.gradient.iter_mut().for_each(|rows| rows.0 = [[0.0; TILE]; TILE]);
        let mut non_finite = 0;
        for (y, row) in rows(image, corner, size).enumerate() {
            for (x, pixel) in row.chunks_exact(3).enumerate() {
                for (rows, &value) in self.gradient.iter_mut().zip(pixel) {
                    non_finite += u64::from(!value.is_finite());
                    rows.0[y][x] = if value.is_finite() { value } else { 0.0 };
                }
            }
        }
        non_finite
    }

    /// From front-to-back to back-to-front: behind everything is the background. Returns its gradient.
    #[inline(always)]
    fn turn(&mut self, background: [f32; 3], now: &Transmittances) -> [f32; 3] {
        let mut sums = [[0.0f32; TILE]; 3];
        self.behind.0 = [[0.0; TILE]; TILE];
        for ((rows, colour), sum) in self.gradient.iter().zip(background).zip(&mut sums) {
            let rows = rows.0.iter().zip(now).zip(&mut self.behind.0);
            for ((gradient, now), behind) in rows {
                for i in 0..TILE {
                    behind[i] += gradient[i] * colour;
                    sum[i] += gradient[i] * now[i];
                }
            }
        }
        sums.map(|sum| keep(Term::Background, f64::from(total(&sum))) as f32)
    }

    /// Differentiates one splat's visits and steps in front of it. With statistics, finds those of its
    /// visits too, in the columns that are `inside` the picture (1, else 0).
    #[inline(always)]
    fn sweep<S: Simd, const WITH_STATISTICS: bool>(
        &mut self,
        simd: S,
        visits: Range<usize>,
        splat: &Splat,
        max: f32,
        inside: &Lanes,
    ) -> ([Lanes; SUMS], [Lanes; STATISTICS]) {
        let Self { behind, gradient: [red, green, blue], trace } = self;
        let (records, visits) = (&trace.records[visits.clone()], &trace.visits[visits]);
        let [xx, xy, yy] = splat.root.map(|v| simd.splat_f32s(v as f32));
        let [r, g, b] = splat.colour.map(|c| simd.splat_f32s(c));
        let (max, zero) = (simd.splat_f32s(max), simd.splat_f32s(0.0));
        let clamped = if dropped(Term::AlphaClamp) { simd.splat_f32s(2.0) } else { max };
        let (add, sub) = (|a, b| simd.add_f32s(a, b), |a, b| simd.sub_f32s(a, b));
        let mul = |a, b| simd.mul_f32s(a, b);
        let mut out = [[0.0; TILE]; SUMS];
        let mut out_statistics = [[0.0; TILE]; STATISTICS];
        for part in 0..TILE / S::F32_LANES {
            let (lane, inside) = (lanes::<S>(&LANE, part), lanes::<S>(inside, part));
            let mut sums = [zero; SUMS];
            let mut statistics = [zero; STATISTICS];
            for (visit, record) in visits.iter().zip(records) {
                let y = visit.y as usize % TILE;
                let (u, v) = (simd.splat_f32s(visit.u), simd.splat_f32s(visit.v));
                let down = simd.splat_f32s(visit.y as f32);
                let alpha = lanes::<S>(&record.alpha, part);
                let (gr, gg) = (lanes::<S>(&red.0[y], part), lanes::<S>(&green.0[y], part));
                let gb = lanes::<S>(&blue.0[y], part);
                let behind = lanes_mut::<S>(&mut behind.0[y], part);

                let own = add(add(mul(gr, r), mul(gg, g)), mul(gb, b));
                let ahead = sub(own, *behind);
                let weight = mul(alpha, lanes::<S>(&record.transmittance, part));
                let nearer = mul(alpha, ahead);
                if flipped(Term::Behind) {
                    *behind = sub(*behind, nearer);
                } else if !dropped(Term::Behind) {
                    *behind = add(*behind, nearer);
                }
                let free = simd.less_than_f32s(alpha, clamped);
                let h = simd.select_f32s(free, mul(weight, ahead), zero);
                let q = add(u, mul(xx, lane));
                let hq = mul(h, q);
                let hv = mul(h, v);
                sums[0] = add(sums[0], h);
                sums[1] = add(sums[1], hq);
                sums[2] = add(sums[2], mul(hq, down));
                sums[3] = add(sums[3], hv);
                sums[4] = add(sums[4], mul(hv, down));
                sums[5] = add(sums[5], mul(weight, gr));
                sums[6] = add(sums[6], mul(weight, gg));
                sums[7] = add(sums[7], mul(weight, gb));
                if WITH_STATISTICS {
                    // The exponent falls by u² + v² in bits, and both fall with the centre.
                    let (along, below) = (mul(h, mul(xx, q)), mul(h, add(mul(xy, q), mul(yy, v))));
                    let length = simd.sqrt_f32s(add(mul(along, along), mul(below, below)));
                    let is_seen = simd.less_than_f32s(zero, alpha);
                    statistics[0] = add(statistics[0], length);
                    statistics[1] = add(statistics[1], mul(weight, inside));
                    statistics[2] = add(statistics[2], simd.select_f32s(is_seen, inside, zero));
                }
            }
            for (out, sum) in out_statistics.iter_mut().zip(statistics) {
                *lanes_mut::<S>(out, part) = sum;
            }
            for (out, sum) in out.iter_mut().zip(sums) {
                *lanes_mut::<S>(out, part) = sum;
            }
        }
        (out, out_statistics)
    }
}

/// Rows of the tile at `corner` of a picture of `size`, r g b per pixel.
#[inline(always)]
fn rows(image: &[f32], corner: [usize; 2], size: [usize; 2]) -> impl Iterator<Item = &[f32]> {
    let (w, h) = ((size[0] - corner[0]).min(TILE), (size[1] - corner[1]).min(TILE));
    (corner[1]..corner[1] + h).map(move |y| &image[3 * (y * size[0] + corner[0])..][..3 * w])
}

/// Whether every value of the tile at `corner` is 0.
#[inline(always)]
fn is_zero(image: &[f32], corner: [usize; 2], size: [usize; 2]) -> bool {
    // Without a way out inside a row, so that it becomes vectors.
    rows(image, corner, size).all(|row| row.iter().fold(true, |zero, &value| zero & (value == 0.0)))
}

#[inline(always)]
fn lanes<S: Simd>(row: &Lanes, part: usize) -> S::f32s {
    S::as_simd_f32s(row).0[part]
}

#[inline(always)]
fn lanes_mut<S: Simd>(row: &mut Lanes, part: usize) -> &mut S::f32s {
    &mut S::as_mut_simd_f32s(row).0[part]
}

/// Sum of a row in a fixed tree.
#[inline(always)]
fn total(row: &Lanes) -> f32 {
    let mut sum = *row;
    for half in [8, 4, 2, 1] {
        for i in 0..half {
            sum[i] += sum[i + half];
        }
    }
    sum[0]
}

/// Sums of all rows, each in the tree of [`total`], side by side.
#[inline(always)]
fn totals(rows: &[Lanes; SUMS]) -> [f32; SUMS] {
    let mut turned = [[0.0; SUMS]; TILE / 2];
    for (k, row) in rows.iter().enumerate() {
        for i in 0..TILE / 2 {
            turned[i][k] = row[i] + row[i + TILE / 2];
        }
    }
    for half in [4, 2, 1] {
        for i in 0..half {
            let other = turned[i + half];
            turned[i].iter_mut().zip(other).for_each(|(sum, other)| *sum += other);
        }
    }
    turned[0]
}

/// Statistics from sums over the visits of a splat.
#[inline(always)]
fn totals_of_statistics(sums: &[Lanes; STATISTICS]) -> TileStatistics {
    let [gradient, weight, pixels] = sums.each_ref().map(total);
    [2.0 * std::f32::consts::LN_2 * gradient, weight, pixels]
}

/// From sums over the tile, about its first pixel, to the ellipse.
#[inline(always)]
fn chain(sums: &[Lanes; SUMS], splat: &Splat, corner: [usize; 2]) -> Partial {
    let along = std::array::from_fn(|i| sums[1][i] * LANE[i]);
    let [h, q, q_down, v, v_down, r, g, b] = totals(sums).map(f64::from);
    ellipse([h, q, f64::from(total(&along)), q_down, v, v_down, r, g, b], splat, corner)
}

/// From sums over the pixels of a tile, in its columns x and rows y, to the ellipse: h, h·u, h·u·x, h·u·y,
/// h·v, h·v·y and three colours, where h ln 2 is the gradient of the exponent.
#[inline(always)]
pub(crate) fn ellipse(sums: [f64; PARTS], splat: &Splat, corner: [usize; 2]) -> Partial {
    // exponent = log2_alpha - u² - v², alpha = 2^exponent.
    let slope = -2.0 * std::f64::consts::LN_2;
    let [h, q, q_along, q_down, v, v_down, r, g, b] = sums;
    let (du, dv) = (slope * q, slope * v);
    let (du_along, du_down, dv_down) = (slope * q_along, slope * q_down, slope * v_down);
    let [dx, dy] = offset(splat, corner);
    let [xx, xy, yy] = splat.root;
    [
        keep(Term::Centre, -xx * du),
        -(xy * du + yy * dv),
        du * dx + keep(Term::Along, du_along),
        du * dy + keep(Term::Shear, du_down),
        dv * dy + keep(Term::Down, dv_down),
        keep(Term::Exponent, std::f64::consts::LN_2 * h),
        keep(Term::Colour, r),
        keep(Term::Colour, g),
        keep(Term::Colour, b),
    ]
    .map(|v| v as f32)
}

#[cfg(test)]
mod tests;
