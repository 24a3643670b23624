//! Stage 3 lists for each tile the splats that touch it, nearest first.
//!
//! Work is done one *band* of tile rows at a time, so that memory stays bounded however large the image
//! or the splats ([`bands`]); most pictures are one band. In a band, equal pieces of the depth order each
//! write down the *spans* of their splats (a run of tiles in one row), sorted by row; then each row
//! gathers its spans piece by piece into tile lists. Every list comes out in depth order for any number
//! of threads.
//!
//! Rows whose lists would be long end each list where its tile is surely finished (`fade.rs`).

use std::ops::Range;

use super::{Splat, fade::Fade, project::Projected, sort::Order, span::Spans};
use crate::{parallel, settings::Settings};

/// Tile lists a band may need at most, by the boxes of its splats. One row is always allowed.
const BAND_ENTRIES: u64 = 1 << 24;
/// Pixels a band may have at most. One row is always allowed.
const BAND_PIXELS: usize = 1 << 22;
/// Entries per tile of a row, on average, from which on tiles that are finished are looked for.
const LONG: usize = 1024;
/// Splats counted by one thread.
const SPLATS_PER_PART: usize = 16_384;
/// Pieces looked at first, to tell a crowd.
const HEAD: usize = 8;
/// Splats in one piece of the depth order.
const PIECE: usize = 4096;

/// A run of tiles of one row.
#[derive(Clone, Copy, Debug, Default)]
struct Span {
    splat: u32,
    /// Tile row, counted in the band.
    row: u16,
    first: u16,
    past: u16,
}

/// The spans of one piece of the depth order.
#[derive(Debug, Default)]
struct Piece {
    found: Vec<Span>,
    /// `found`, stably sorted by row.
    by_row: Vec<Span>,
    /// Row `r` is `by_row[starts[r]..starts[r + 1]]`.
    starts: Vec<usize>,
    /// Tiles of the band in the boxes of the piece's splats.
    boxed: u64,
}

/// The tile lists of one tile row.
#[derive(Debug, Default)]
pub struct TileRow {
    starts: Vec<usize>,
    entries: Vec<u32>,
}

impl TileRow {
    /// Indices of the splats of tile `column`, nearest first.
    pub fn tile(&self, column: usize) -> &[u32] {
        &self.entries[self.starts[column]..self.starts[column + 1]]
    }
}

/// Tile lists of a band, and room to make the next one.
#[derive(Debug, Default)]
pub struct Bins {
    pieces: Vec<Piece>,
    rows: Vec<TileRow>,
    height: usize,
}

impl Bins {
    /// The rows of the band, top first.
    pub fn rows(&self) -> &[TileRow] {
        &self.rows[..self.height]
    }

    /// Entries that the splats found in tile row `row` of the band ask for.
    pub fn requested(&self, row: usize) -> u64 {
        let spans = self.pieces.iter().flat_map(|p| &p.by_row[p.starts[row]..p.starts[row + 1]]);
        spans.map(|span| u64::from(span.past - span.first)).sum()
    }

    /// Tiles of the band in the boxes of the splats looked at: entries there would be without exact bounds.
    pub fn boxed(&self) -> u64 {
        self.pieces.iter().map(|piece| piece.boxed).sum()
    }

    /// Entries in all lists of the band, and tiles with at least one.
    pub fn totals(&self) -> (u64, u64) {
        let entries = self.rows().iter().map(|row| row.entries.len() as u64).sum();
        let touched = |row: &TileRow| row.starts.windows(2).filter(|w| w[0] < w[1]).count() as u64;
        (entries, self.rows().iter().map(touched).sum())
    }
}

/// Splits an image of `size` (width and height in pixels) into bands of tile rows, of bounded memory. A band
/// begins with a row of cells.
pub fn bands(
    projected: &Projected,
    order: &Order,
    size: [usize; 2],
    settings: &Settings,
    out: &mut Vec<Range<usize>>,
) {
    let tile = settings.tile;
    let [columns, rows] = size.map(|side| tile.tiles(side));
    let entries = order.entries();
    // Whole numbers, so how they are added up does not show.
    let mut parts =
        vec![Vec::new(); if settings.parallel { entries.len().div_ceil(SPLATS_PER_PART).max(1) } else { 1 }];
    let per_part = entries.len().div_ceil(parts.len());
    parallel::for_each(settings.parallel, &mut parts, |part, change: &mut Vec<i64>| {
        change.resize(rows + 1, 0);
        for &entry in entries.iter().skip(part * per_part).take(per_part) {
            let splat = &projected.splats[entry as u32 as usize];
            let (width, span) = (splat.tile_columns(tile).len() as i64, splat.tile_rows(tile));
            change[span.start] += width;
            change[span.end] -= width;
        }
    });
    let change = |row: usize| parts.iter().map(|part| part[row]).sum::<i64>();
    out.clear();
    let (mut start, mut entries, mut row_entries) = (0, 0u64, 0i64);
    for row in 0..rows {
        row_entries += change(row);
        let pixels = (row + 1 - start) * columns * tile.pixels().pow(2);
        let may_begin = row > start && row % tile.rows_per_cell() == 0;
        if may_begin && (entries + row_entries as u64 > BAND_ENTRIES || pixels > BAND_PIXELS) {
            out.push(start..row);
            (start, entries) = (row, 0);
        }
        entries += row_entries as u64;
    }
    out.push(start..rows);
}

/// Fills `out` with the lists of the tile rows `band` of an image `columns` tiles wide.
///
/// A long list may lack splats that are behind a finished tile.
pub fn bin(
    projected: &Projected,
    order: &Order,
    band: &Range<usize>,
    columns: usize,
    settings: &Settings,
    out: &mut Bins,
) {
    let fade = Fade::of_picture(settings);
    fill(projected, order, band, columns, settings, &Classes { fade, of: &[], count: 1 }, out);
}

/// As [`bin`], where `classes` gives each Gaussian one of `count` classes, and any of these may be missing
/// when the list is blended: a long list may lack splats that are behind a tile their own class finishes.
pub(crate) fn bin_by_class(
    projected: &Projected,
    order: &Order,
    band: &Range<usize>,
    columns: usize,
    settings: &Settings,
    (classes, count): (&[u32], usize),
    out: &mut Bins,
) {
    let fade = Fade::of_class(settings);
    fill(projected, order, band, columns, settings, &Classes { fade, of: classes, count }, out);
}

/// Occlusion classes: opaque Gaussians of a class hide only Gaussians of their own class.
struct Classes<'a> {
    fade: Option<Fade>,
    /// Class of each Gaussian; empty where all are of class 0.
    of: &'a [u32],
    count: usize,
}

fn fill(
    projected: &Projected,
    order: &Order,
    band: &Range<usize>,
    columns: usize,
    settings: &Settings,
    classes: &Classes,
    out: &mut Bins,
) {
    let pieces = order.entries().len().div_ceil(PIECE);
    out.pieces.resize_with(pieces, Piece::default);
    out.height = band.len();
    if out.rows.len() < band.len() {
        out.rows.resize_with(band.len(), TileRow::default);
    }
    let (shape, side) = (Spans::new(settings), settings.tile.pixels());
    let find = |i: usize, piece: &mut Piece| {
        let entries = &order.entries()[i * PIECE..];
        let Piece { found, boxed, .. } = &mut *piece;
        found.clear();
        *boxed = 0;
        for &entry in &entries[..entries.len().min(PIECE)] {
            let index = entry as u32;
            let splat = &projected.splats[index as usize];
            *boxed += shape.spans(splat, band, &mut |row, tiles: Range<usize>| {
                let (first, past) = (tiles.start as u16, tiles.end as u16);
                found.push(Span { splat: index, row: (row - band.start) as u16, first, past });
            });
        }
        piece.sort_by_row(band.len());
    };
    let Bins { pieces, rows, height } = out;
    let (rows, count) = (&mut rows[..*height], pieces.len());
    let head = if classes.fade.is_some() && count > 2 * HEAD { HEAD } else { count };
    let splats = &projected.splats;
    parallel::for_each(settings.parallel, &mut pieces[..head], find);
    let width = |span: &Span| usize::from(span.past - span.first);
    if let Some(fade) = &classes.fade
        && head < count
        && pieces[..head].iter().flat_map(|p| &p.found).map(width).sum::<usize>()
            > LONG * columns * rows.len()
    {
        // A crowd: the tiles may be finished long before the last piece.
        let mut open: Vec<Open> = rows.iter().map(|_| Open::new(columns, classes.count)).collect();
        let mut at = 0;
        while at < count && open.iter().any(|row| row.left > 0) {
            let batch = &mut pieces[at..count.min(at + HEAD)];
            if at > 0 {
                parallel::for_each(settings.parallel, batch, |i, piece| find(at + i, piece));
            }
            parallel::for_each(settings.parallel, &mut open, |row, open| {
                open.take(batch, (row, (band.start + row) * side), splats, fade, classes);
            });
            at += HEAD;
        }
        // What was never looked at has neither spans nor boxes, whatever it held for another band or picture.
        pieces[at.min(count)..].iter_mut().for_each(|piece| piece.forget(rows.len()));
        rows.iter_mut().zip(open).for_each(|(row, open)| row.hold(&open.lists));
        return;
    }
    parallel::for_each(settings.parallel, &mut pieces[head..], |i, piece| find(head + i, piece));
    parallel::for_each(settings.parallel, rows, |row, list| {
        let entries = pieces.iter().flat_map(|p| p.row(row)).map(width).sum::<usize>();
        match &classes.fade {
            Some(fade) if entries > LONG * columns => {
                let mut open = Open::new(columns, classes.count);
                open.take(pieces, (row, (band.start + row) * side), splats, fade, classes);
                list.hold(&open.lists);
            }
            _ => list.gather(pieces, row, columns),
        }
    });
}

/// The tile lists of one row while they are made: a list per column, and which still need it.
struct Open {
    lists: Vec<Vec<u32>>,
    /// Upper bounds of log₂ transmittance, per column and class.
    bounds: Vec<f64>,
    /// Bounds that are not below the stop.
    left: usize,
}

impl Open {
    fn new(columns: usize, classes: usize) -> Self {
        let bounds = vec![0.0; columns * classes];
        Self { lists: vec![Vec::new(); columns], left: bounds.len(), bounds }
    }

    /// Takes the spans of `pieces` in `row` of the band, whose first pixel row is `y`.
    fn take(
        &mut self,
        pieces: &[Piece],
        (row, y): (usize, usize),
        splats: &[Splat],
        fade: &Fade,
        classes: &Classes,
    ) {
        for span in pieces.iter().flat_map(|p| p.row(row)) {
            if self.left == 0 {
                return;
            }
            let class = classes.of.get(span.splat as usize).map_or(0, |&class| class as usize);
            for column in usize::from(span.first)..usize::from(span.past) {
                let bound = &mut self.bounds[column * classes.count + class];
                if *bound < fade.stop {
                    continue;
                }
                self.lists[column].push(span.splat);
                *bound += fade.step(&splats[span.splat as usize], [column * fade.side, y]);
                self.left -= usize::from(*bound < fade.stop);
            }
        }
    }
}

impl Piece {
    /// Spans in row `row` of the band, nearest first.
    fn row(&self, row: usize) -> &[Span] {
        &self.by_row[self.starts[row]..self.starts[row + 1]]
    }

    /// Holds no span in any of `rows` rows.
    fn forget(&mut self, rows: usize) {
        self.found.clear();
        self.boxed = 0;
        self.sort_by_row(rows);
    }

    fn sort_by_row(&mut self, rows: usize) {
        self.starts.clear();
        self.starts.resize(rows + 1, 0);
        self.found.iter().for_each(|span| self.starts[usize::from(span.row)] += 1);
        let mut sum = 0;
        for start in &mut self.starts {
            sum += std::mem::replace(start, sum);
        }
        self.by_row.resize(self.found.len(), Span::default());
        for span in &self.found {
            let slot = &mut self.starts[usize::from(span.row)];
            self.by_row[*slot] = *span;
            *slot += 1;
        }
        // Each start has moved to the next one; move them back.
        self.starts.rotate_right(1);
        self.starts[0] = 0;
    }
}

impl TileRow {
    fn gather(&mut self, pieces: &[Piece], row: usize, columns: usize) {
        let spans = || pieces.iter().flat_map(|p| p.row(row));
        self.starts.clear();
        self.starts.resize(columns + 1, 0);
        for span in spans() {
            for column in span.first..span.past {
                self.starts[usize::from(column)] += 1;
            }
        }
        let mut sum = 0;
        for start in &mut self.starts {
            sum += std::mem::replace(start, sum);
        }
        self.entries.resize(sum, 0);
        for span in spans() {
            for column in span.first..span.past {
                let slot = &mut self.starts[usize::from(column)];
                self.entries[*slot] = span.splat;
                *slot += 1;
            }
        }
        self.starts.rotate_right(1);
        self.starts[0] = 0;
    }

    /// Takes the lists of all columns.
    fn hold(&mut self, lists: &[Vec<u32>]) {
        self.starts.clear();
        self.entries.clear();
        for list in lists {
            self.starts.push(self.entries.len());
            self.entries.extend_from_slice(list);
        }
        self.starts.push(self.entries.len());
    }
}

#[cfg(test)]
mod tests {
    use super::super::REACH_MARGIN;
    use super::*;
    use crate::stage::TileSide;
    use crate::stage::sort;
    use proptest::prelude::*;

    /// Tile lists of a scene of splats whose depth key is their index.
    fn lists(splats: Vec<Splat>, columns: usize, rows: usize, exact: bool) -> Vec<Vec<u32>> {
        let settings = Settings { exact_tiles: exact, early_stop: false, ..Settings::default() };
        lists_with(splats, columns, rows, &settings)
    }

    fn lists_with(splats: Vec<Splat>, columns: usize, rows: usize, settings: &Settings) -> Vec<Vec<u32>> {
        let keys = (0..splats.len() as u32).collect::<Vec<_>>();
        let projected = Projected { splats, keys, ..Projected::default() };
        let (mut order, mut out) = (Order::default(), Bins::default());
        sort::sort(&projected.keys, false, &mut order);
        let mut all = Vec::new();
        let mut parts = Vec::new();
        bands(&projected, &order, [columns, rows].map(|n| 16 * n), settings, &mut parts);
        for band in &parts {
            bin(&projected, &order, band, columns, settings, &mut out);
            out.rows().iter().for_each(|row| all.extend((0..columns).map(|c| row.tile(c).to_vec())));
        }
        all
    }

    fn splat(mean: [f64; 2], root: [f64; 3], side: usize) -> Splat {
        let whole = side as u16;
        Splat { mean, root, log2_alpha: -0.5, pixels: [0, whole, 0, whole], ..Splat::NONE }
    }

    proptest! {
        /// Against the obvious test of every pixel centre: no tile missed, none listed in vain.
        #[test]
        fn exact_lists_are_exact(
            x in -20.0..84.0f64, y in -20.0..84.0f64,
            xx in 0.02..1.5f64, xy in -1.0..1.0f64, yy in 0.02..1.5f64,
        ) {
            let s = splat([x, y], [xx, xy, yy], 64);
            let reach = -0.5 - Settings::default().log2_cutoff() + f64::from(REACH_MARGIN);
            let got = lists(vec![s], 4, 4, true);
            for (tile, list) in got.iter().enumerate() {
                let inside = |slack: f64| (0..256).any(|p| {
                    let px = ((tile % 4) * 16 + p % 16) as f64 + 0.5 - x;
                    let py = ((tile / 4) * 16 + p / 16) as f64 + 0.5 - y;
                    (xx * px + xy * py).powi(2) + (yy * py).powi(2) <= reach + slack
                });
                prop_assert!(!inside(0.0) || list == &[0], "tile {} missed", tile);
                // The strip is continuous in y, pixels are not, so a tile may be listed for a sliver
                // between rows; it is never listed when the ellipse is a pixel away.
                let near = (0..32 * 32).any(|p| {
                    let px = (tile % 4) as f64 * 16.0 + f64::from(p % 32) * 0.5 + 0.25 - x;
                    let py = (tile / 4) as f64 * 16.0 + f64::from(p / 32) * 0.5 + 0.25 - y;
                    let d = 0.75;
                    let u = ((xx * px + xy * py).abs() - d * (xx + xy.abs())).max(0.0);
                    let v = ((yy * py).abs() - d * yy).max(0.0);
                    u * u + v * v <= reach
                });
                prop_assert!(near || list.is_empty(), "tile {} listed in vain", tile);
            }
        }
    }

    #[test]
    fn lists_are_in_depth_order_over_pieces_and_bands() {
        // Enough full-image splats that the entries do not fit one band: 9000 · 64 · 64 > 2²⁴.
        let n = 2 * SPLATS_PER_PART + 9000;
        let wide = splat([500.0, 500.0], [1e-4, 0.0, 1e-4], 1024);
        let exact = lists(vec![wide; n], 64, 64, true);
        let expected: Vec<u32> = (0..n as u32).collect();
        assert!(exact.iter().all(|list| *list == expected));
        assert_eq!(exact.len(), 64 * 64);
    }

    #[test]
    fn long_lists_end_where_their_tile_is_finished() {
        let wide = splat([500.0, 500.0], [1e-4, 0.0, 1e-4], 1024);
        // 2^-0.5 of light is taken by each: eight are below 1e-4.
        let ended = lists_with(vec![wide; 9000], 64, 64, &Settings::default());
        assert!(ended.iter().all(|list| *list == (0..8).collect::<Vec<u32>>()), "{:?}", ended[0]);
        // A row of short lists keeps them whole, and so does one that is covered by halves.
        let few = lists_with(vec![wide; LONG], 64, 64, &Settings::default());
        assert!(few.iter().all(|list| list.len() == LONG));
        let half = Splat { pixels: [0, 16, 8, 16], ..wide };
        assert_eq!(lists_with(vec![half; 3000], 1, 1, &Settings::default())[0].len(), 3000);
    }

    #[test]
    fn bands_are_whole_and_bounded() {
        let n = 2 * SPLATS_PER_PART + 9000;
        let wide = splat([500.0, 500.0], [1e-4, 0.0, 1e-4], 1024);
        let projected = Projected { splats: vec![wide; n], keys: vec![1; n], ..Projected::default() };
        let mut order = Order::default();
        sort::sort(&projected.keys, false, &mut order);
        let mut parts = Vec::new();
        bands(&projected, &order, [1024; 2], &Settings::default(), &mut parts);
        let mut serial = Vec::new();
        let settings = Settings { parallel: false, ..Settings::default() };
        bands(&projected, &order, [1024; 2], &settings, &mut serial);
        assert_eq!(parts, serial);
        assert!(parts.len() > 1);
        assert_eq!((parts[0].start, parts.last().unwrap().end), (0, 64));
        assert!(parts.windows(2).all(|w| w[0].end == w[1].start && !w[0].is_empty()));
        assert!(parts.iter().all(|b| (b.len() * 64 * n) as u64 <= BAND_ENTRIES));
    }
    #[test]
    fn bands_of_small_tiles_begin_with_a_cell() {
        let wide = Splat { pixels: [0, 1024, 0, 1016], ..splat([500.0; 2], [1e-4, 0.0, 1e-4], 1024) };
        let projected = Projected { splats: vec![wide; 5000], keys: vec![1; 5000], ..Projected::default() };
        let mut order = Order::default();
        sort::sort(&projected.keys, false, &mut order);
        let mut parts = Vec::new();
        let settings = Settings { tile: TileSide::Eight, ..Settings::default() };
        bands(&projected, &order, [1024, 1016], &settings, &mut parts);
        assert!(parts.len() > 1 && parts.iter().all(|band| band.start % 2 == 0), "{parts:?}");
        assert_eq!(parts.last().unwrap().end, 127);
    }
}
