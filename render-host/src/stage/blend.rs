//! Stage 4: every pixel of a tile takes its list of splats, nearest first.
//!
//! `C += T·a·c; T -= T·a`, where alpha `a` is clamped to `alpha_max` and left out below `alpha_cutoff`,
//! until `T` is below the stop (inclusive: the splat that crosses it is blended), or below 1e-30 where there
//! is no stop.
//!
//! A row of a tile is 16 pixels in arrays of fixed size, written so that the compiler turns it into
//! vectors; `pulp` picks the widest ones at run time. Nothing is fused or reordered, so every vector
//! width, every machine and every number of threads gives the same bits.

use std::ops::Range;

use super::{
    Splat, TILE, TileSide,
    bin::Bins,
    reach::{Local, Rules, for_each_row, row_bits},
};
pub(crate) use super::{
    power::exp2,
    reach::{LANE, Lanes},
};
use crate::{Counters, parallel, settings::Settings};

/// Splats between two looks at which rows of a tile are finished.
pub(crate) const LOOK_EVERY: usize = 16;

/// Splats between two transmittances that are kept for the adjoint. A multiple of [`LOOK_EVERY`]; so few that
/// what the adjoint writes down about them stays in the nearest cache.
pub(crate) const SEGMENT: usize = 128;

/// Transmittances of a cell.
pub(crate) type Transmittances = [Lanes; TILE];

/// What the pixels of a cell have gathered.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(crate) struct Tile {
    /// Rows of 16 pixels: r, g, b (without background) and transmittance.
    rows: [[Lanes; 4]; TILE],
    /// What it took.
    pub(crate) work: Work,
    /// Transmittances before each segment of the list that was begun, if they are kept.
    pub(crate) marks: Vec<Transmittances>,
}

/// What blending a tile took and left out; sums over tiles fit too.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub(crate) struct Work {
    /// Pixels inside the image whose transmittance is below the stop.
    pub stopped: u64,
    /// Entries never read, because every pixel was finished before them.
    pub unread: u64,
    /// Entries read that reached no row.
    pub idle: u64,
    /// Rows in the boxes of splats read.
    pub rows: u64,
    /// Rows not blended because they are out of reach.
    pub unreached: u64,
    /// Rows not blended because all their pixels are finished.
    pub finished: u64,
}

impl Work {
    const NONE: Self = Self { stopped: 0, unread: 0, idle: 0, rows: 0, unreached: 0, finished: 0 };

    /// Adds this work to the counts of a picture.
    pub(crate) fn add_to(&self, counters: &mut Counters) {
        counters.pixels_stopped += self.stopped;
        counters.entries_unread += self.unread;
        counters.entries_idle += self.idle;
        counters.rows += self.rows;
        counters.rows_unreached += self.unreached;
        counters.rows_finished += self.finished;
    }
}

impl Tile {
    pub(crate) const EMPTY: Self = Self { rows: Self::ROWS, work: Work::NONE, marks: Vec::new() };
    /// Nothing blended yet.
    const ROWS: [[Lanes; 4]; TILE] = [[[0.0; TILE], [0.0; TILE], [0.0; TILE], [1.0; TILE]]; TILE];

    /// Transmittances now.
    #[inline(always)]
    pub(crate) fn transmittances(&self) -> Transmittances {
        std::array::from_fn(|y| self.rows[y][3])
    }

    /// Row `y` over `background`: r, g, b of its 16 pixels.
    #[cfg(test)]
    pub(crate) fn over(&self, y: usize, background: [f32; 3]) -> [Lanes; 3] {
        let [r, g, b, t] = &self.rows[y];
        let mut out = [*r, *g, *b];
        for (out, back) in out.iter_mut().zip(background) {
            (0..TILE).for_each(|i| out[i] += t[i] * back);
        }
        out
    }
}

/// Room for the cells of one band.
#[derive(Debug, Default)]
pub struct Tiles {
    pub(crate) tiles: Vec<Tile>,
    /// Tiles whose room holds nothing of use, because their lists are empty; past its end none is.
    pub(crate) empty: Vec<bool>,
    /// Whether transmittances before each segment of a list are kept.
    pub(crate) keeps_marks: bool,
}

impl Tiles {
    /// Adds the work of all tiles to `counters`.
    pub(crate) fn count(&self, counters: &mut Counters) {
        let drawn = |index: usize| !self.is_empty(index);
        self.tiles.iter().enumerate().filter(|(i, _)| drawn(*i)).for_each(|(_, t)| t.work.add_to(counters));
    }

    fn is_empty(&self, index: usize) -> bool {
        self.empty.get(index).copied().unwrap_or(false)
    }
}

/// Lists of one cell: those of its four tiles, row by row, where tiles are smaller than cells; else the first
/// is that of its tile.
type CellLists<'a> = [&'a [u32]; 4];

/// Blends one cell, whose first pixel is `corner`, from the list of its tile, which is of the usual side.
/// `marks` says whether transmittances before each segment of the list are kept.
pub(crate) fn blend_tile(
    splats: &[Splat],
    list: &[u32],
    corner: [usize; 2],
    size: [usize; 2],
    settings: &Settings,
    marks: bool,
    tile: &mut Tile,
) {
    let lists = [list, &[], &[], &[]];
    pulp::Arch::new().dispatch(Blend { splats, lists, corner, size, settings, marks, tile });
}

/// Blends the tiles of a band. `band` is its tile rows, `size` the image's width and height in pixels.
/// Returns the number of pixels that finished early.
pub fn blend(
    splats: &[Splat],
    bins: &Bins,
    band: &Range<usize>,
    size: [usize; 2],
    settings: &Settings,
    out: &mut Tiles,
) -> u64 {
    let side = settings.tile;
    let columns = size[0].div_ceil(TILE);
    let top = band.start * side.pixels();
    let height = (band.end * side.pixels()).min(size[1]).saturating_sub(top);
    out.tiles.resize(columns * height.div_ceil(TILE), Tile::EMPTY);
    out.empty.clear();
    let lists =
        |index: usize| cell_lists(bins, side, side.tiles(size[0]), [index % columns, index / columns]);
    let none = |index: usize| lists(index).iter().all(|list| list.is_empty());
    out.empty.extend((0..out.tiles.len()).map(|i| settings.skip_empty_tiles && none(i)));
    let Tiles { tiles, empty, keeps_marks } = out;
    let marks = *keeps_marks && side == TileSide::Sixteen;
    let arch = pulp::Arch::new();
    let work = |index: usize, tile: &mut Tile| {
        if empty[index] {
            return;
        }
        let corner = [index % columns * TILE, top + index / columns * TILE];
        arch.dispatch(Blend { splats, lists: lists(index), corner, size, settings, marks, tile });
    };
    parallel::for_each(settings.parallel, tiles, work);
    let stopped = |(tile, empty): (&Tile, &bool)| if *empty { 0 } else { tile.work.stopped };
    tiles.iter().zip(empty.iter()).map(stopped).sum()
}

/// The lists of the cell at column `x`, row `y` of a band that is `columns` tiles wide.
fn cell_lists(bins: &Bins, side: TileSide, columns: usize, [x, y]: [usize; 2]) -> CellLists<'_> {
    let rows = bins.rows();
    match side {
        TileSide::Eight => std::array::from_fn(|i| {
            let (column, row) = (2 * x + i % 2, 2 * y + i / 2);
            // At the edges, part of a cell is outside the image.
            rows.get(row).filter(|_| column < columns).map_or(&[][..], |row| row.tile(column))
        }),
        TileSide::Sixteen => [rows[y].tile(x), &[], &[], &[]],
        TileSide::ThirtyTwo => [rows[y / 2].tile(x / 2), &[], &[], &[]],
    }
}

/// Copies row `y` of a tile, or of an empty one, to pixels of the image; both slices may end early.
#[inline(always)]
pub(crate) fn resolve_row(
    tile: Option<&Tile>,
    y: usize,
    background: [f32; 3],
    rgb: &mut [f32],
    transmittance: &mut [f32],
) {
    let [br, bg, bb] = background;
    let Some(tile) = tile else {
        // What 0 + 1 · background gives: no negative zero.
        let [br, bg, bb] = [0.0 + br, 0.0 + bg, 0.0 + bb];
        rgb.chunks_exact_mut(3).for_each(|pixel| pixel.copy_from_slice(&[br, bg, bb]));
        transmittance.fill(1.0);
        return;
    };
    let [r, g, b, t] = &tile.rows[y];
    for (i, pixel) in rgb.chunks_exact_mut(3).enumerate() {
        pixel[0] = r[i] + t[i] * br;
        pixel[1] = g[i] + t[i] * bg;
        pixel[2] = b[i] + t[i] * bb;
    }
    transmittance.copy_from_slice(&t[..transmittance.len()]);
}

/// Copies the cells of a band to the image rows of that band, over the background. `rgb` and
/// `transmittance` begin at the band's first pixel row.
pub fn resolve(tiles: &Tiles, width: usize, settings: &Settings, rgb: &mut [f32], transmittance: &mut [f32]) {
    let columns = width.div_ceil(TILE);
    let mut rows: Vec<(&mut [f32], &mut [f32])> =
        rgb.chunks_mut(width * 3).zip(transmittance.chunks_mut(width)).collect();
    parallel::for_each(settings.parallel, &mut rows, |y, (rgb, transmittance)| {
        let first = y / TILE * columns;
        let parts = rgb.chunks_mut(3 * TILE).zip(transmittance.chunks_mut(TILE));
        for (index, (rgb, transmittance)) in (first..).zip(parts) {
            let tile = (!tiles.is_empty(index)).then(|| &tiles.tiles[index]);
            resolve_row(tile, y % TILE, settings.background, rgb, transmittance);
        }
    });
}

/// One cell's work, as a value, so that it can be compiled once per vector width.
struct Blend<'a> {
    splats: &'a [Splat],
    lists: CellLists<'a>,
    corner: [usize; 2],
    size: [usize; 2],
    settings: &'a Settings,
    marks: bool,
    tile: &'a mut Tile,
}

impl pulp::NullaryFnOnce for Blend<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { splats, lists, corner, size, settings, marks, tile } = self;
        (tile.rows, tile.work) = (Tile::ROWS, Work::NONE);
        tile.marks.clear();
        let rules = Rules::new(settings);
        match settings.tile {
            TileSide::Eight => {
                for (k, top) in [(0, 0), (2, 8)] {
                    walk::<0, 8, false, false>(splats, lists[k], corner, top..top + 8, &rules, tile);
                    walk::<8, 8, false, false>(splats, lists[k + 1], corner, top..top + 8, &rules, tile);
                }
            }
            TileSide::Sixteen if marks => {
                walk::<0, TILE, false, true>(splats, lists[0], corner, 0..TILE, &rules, tile);
            }
            TileSide::Sixteen => {
                walk::<0, TILE, false, false>(splats, lists[0], corner, 0..TILE, &rules, tile);
            }
            TileSide::ThirtyTwo => {
                walk::<0, TILE, true, false>(splats, lists[0], corner, 0..TILE, &rules, tile)
            }
        }
        if settings.early_stop {
            let (w, h) = ((size[0] - corner[0]).min(TILE), (size[1] - corner[1]).min(TILE));
            let finished = |row: &[Lanes; 4]| row[3][..w].iter().filter(|&&t| t < rules.stop).count();
            tile.work.stopped = tile.rows[..h].iter().map(finished).sum::<usize>() as u64;
        }
    }
}

/// Blends a list into `WIDTH` columns from `LEFT` on of the rows `part` of a cell. `SHARED` says that the
/// list is that of other cells too, so that boxes need not meet this one; `MARKS` that transmittances before
/// each segment are kept.
#[inline(always)]
fn walk<const LEFT: usize, const WIDTH: usize, const SHARED: bool, const MARKS: bool>(
    splats: &[Splat],
    list: &[u32],
    corner: [usize; 2],
    part: Range<usize>,
    rules: &Rules,
    tile: &mut Tile,
) {
    let mut work = tile.work;
    let (mut open, part_rows) = (u32::MAX, row_bits(part.start, part.end));
    let mut near = [Splat::NONE; LOOK_EVERY];
    for k in 0..list.len() {
        if k % LOOK_EVERY == 0 {
            if k > 0 {
                open = open_rows::<LEFT, WIDTH>(&tile.rows, &part, rules.stop);
                if open == 0 {
                    work.unread += (list.len() - k) as u64;
                    break;
                }
            }
            if MARKS && k % SEGMENT == 0 {
                let now = tile.transmittances();
                tile.marks.push(now);
            }
            fetch(splats, &list[k..], &mut near);
        }
        let splat = &near[k % LOOK_EVERY];
        if SHARED {
            let [x0, x1] = [splat.pixels[0], splat.pixels[1]].map(usize::from);
            if x0 >= corner[0] + TILE || x1 <= corner[0] {
                work.idle += 1;
                continue;
            }
        }
        let local = Local::new(splat, corner, rules);
        let reached = local.rows();
        let (boxed, rows) = (row_bits(local.first, local.past) & part_rows, reached.rows & part_rows);
        for_each_row(rows & open, |y| {
            let (u, v) = (reached.u[y], reached.v[y]);
            let (row, exponent) = (&mut tile.rows[y], splat.log2_alpha - v * v);
            blend_row::<LEFT, WIDTH>(row, u, local.root[0], exponent, &splat.colour, rules);
        });
        work.rows += u64::from(boxed.count_ones());
        work.unreached += u64::from((boxed & !rows).count_ones());
        work.finished += u64::from((rows & !open).count_ones());
        work.idle += u64::from(rows == 0);
    }
    tile.work = work;
}

/// Copies the next splats of a list. Together, because they lie far apart in memory: the processor
/// waits for all of them at once instead of for one after the other.
#[inline(always)]
pub(crate) fn fetch(splats: &[Splat], list: &[u32], near: &mut [Splat]) {
    for (near, &index) in near.iter_mut().zip(list) {
        *near = splats[index as usize];
    }
}

#[inline(always)]
fn blend_row<const LEFT: usize, const WIDTH: usize>(
    [r, g, b, t]: &mut [Lanes; 4],
    u: f32,
    xx: f32,
    exponent: f32,
    colour: &[f32; 3],
    rules: &Rules,
) {
    for i in LEFT..LEFT + WIDTH {
        let q = u + xx * LANE[i];
        let weight = rules.alpha(exponent - q * q, t[i]) * t[i];
        r[i] += weight * colour[0];
        g[i] += weight * colour[1];
        b[i] += weight * colour[2];
        t[i] -= weight;
    }
}

/// Bit `y` is set while a pixel of row `y` of `part` is not finished, of `WIDTH` columns from `LEFT` on.
#[inline(always)]
fn open_rows<const LEFT: usize, const WIDTH: usize>(
    rows: &[[Lanes; 4]; TILE],
    part: &Range<usize>,
    stop: f32,
) -> u32 {
    let mut open = 0;
    for (y, row) in rows.iter().enumerate().take(part.end).skip(part.start) {
        open |= u32::from(is_open(&row[3][LEFT..LEFT + WIDTH], stop)) << y;
    }
    open
}

/// True while a pixel of transmittances `t` is not finished.
#[inline(always)]
pub(crate) fn is_open(t: &[f32], stop: f32) -> bool {
    let mut most = 0.0f32;
    for &t in t {
        most = if t > most { t } else { most };
    }
    most >= stop
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_splat_that_crosses_the_stop_is_blended_and_the_next_is_not() {
        let rules = Rules { cutoff: 0.0, max: 0.99, stop: 0.02, reach: 0.0 };
        let mut row = Tile::EMPTY.rows[0];
        for colour in [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]] {
            blend_row::<0, TILE>(&mut row, 0.0, 0.0, (0.9f32).log2(), &colour, &rules);
        }
        let [r, g, b, t] = row;
        assert!((r[3] - 0.9).abs() < 1e-6 && (g[3] - 0.09).abs() < 1e-6);
        assert_eq!(b[3], 0.0, "transmittance was 0.01, below the stop");
        assert!((t[3] - 0.01).abs() < 1e-6);
    }

    #[test]
    fn every_vector_width_gives_the_same_bits() {
        use pulp::NullaryFnOnce;
        let splats: Vec<Splat> = (0..200)
            .map(|i| {
                let t = f64::from(i);
                Splat {
                    mean: [8.0 + 9.0 * (1.7 * t).sin(), 8.0 + 9.0 * (2.3 * t).cos()],
                    root: [0.1 + 0.002 * t, 0.3 * (0.9 * t).sin(), 0.7 - 0.003 * t],
                    colour: [0.3, 0.001 * i as f32, 1.5],
                    log2_alpha: -0.02 * i as f32,
                    pixels: [0, 16, 0, 16],
                }
            })
            .collect();
        let list: Vec<u32> = (0..200).collect();
        let settings = Settings::default();
        let work = |tile| Blend {
            splats: &splats,
            lists: [&list, &[], &[], &[]],
            corner: [0, 0],
            size: [16, 16],
            settings: &settings,
            marks: true,
            tile,
        };
        let (mut plain, mut wide) = (Tile::EMPTY, Tile::EMPTY);
        work(&mut plain).call();
        pulp::Arch::new().dispatch(work(&mut wide));
        let bits = |tile: &Tile| {
            tile.rows.as_flattened().as_flattened().iter().map(|v| v.to_bits()).collect::<Vec<_>>()
        };
        assert!(plain.work.stopped > 0 && plain.work == wide.work);
        assert_eq!(bits(&plain), bits(&wide));
    }

    #[test]
    fn open_rows_sees_one_open_pixel() {
        let mut tile = Tile::EMPTY;
        tile.rows.iter_mut().for_each(|row| row[3] = [0.0; TILE]);
        assert_eq!(open_rows::<0, TILE>(&tile.rows, &(0..TILE), 1e-4), 0);
        tile.rows[5][3][9] = 1e-3;
        assert_eq!(open_rows::<0, TILE>(&tile.rows, &(0..TILE), 1e-4), 1 << 5);
        assert_eq!(open_rows::<8, 8>(&tile.rows, &(0..8), 1e-4), 1 << 5);
        assert_eq!(open_rows::<0, 8>(&tile.rows, &(0..TILE), 1e-4), 0);
        assert_eq!(open_rows::<8, 8>(&tile.rows, &(8..TILE), 1e-4), 0);
    }
}
