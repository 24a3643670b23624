//! Retains the tile lists of a whole picture between frames.

use std::ops::Range;

use super::inputs::Change;
use crate::{
    Counters, parallel,
    stage::{
        bin::Bins,
        project::{Projected, SKIPPED},
        span::Spans,
    },
};

/// Entries per tile, on average over a row, from which on lists are made and not mended: merging would cost
/// more than binning, and a maker of lists may end such lists where nothing behind shows.
const LONG: u64 = 512;

/// One tile.
#[derive(Debug, Default)]
struct StoredList {
    list: Vec<u32>,
    /// Its pixels are not those of its list.
    dirty: bool,
    /// A splat left it or came.
    mend: bool,
    /// Splats that came, nearest first.
    came: Vec<u32>,
}

/// Tile lists, nearest first, row by row of tiles.
#[derive(Debug, Default)]
pub(super) struct Lists {
    tiles: Vec<StoredList>,
    columns: usize,
    rows: usize,
    /// Tiles in the boxes of all splats.
    boxed: u64,
    /// Entries that splats ask for, by row of tiles.
    requested: Vec<u64>,
    /// Splats drawn when the lists were last made as a whole.
    pub(super) drawn: usize,
    /// Splats that came, as entries of the depth order.
    came: Vec<u64>,
    moved: Vec<bool>,
}

impl Lists {
    /// Empty lists of an image of so many tiles, all dirty.
    pub(super) fn reset(&mut self, columns: usize, rows: usize) {
        (self.columns, self.rows, self.boxed) = (columns, rows, 0);
        self.requested.clear();
        self.requested.resize(rows, 0);
        self.tiles.resize_with(columns * rows, StoredList::default);
        for tile in &mut self.tiles {
            tile.list.clear();
            (tile.dirty, tile.mend) = (true, false);
        }
    }

    /// Indices of the splats of a tile, nearest first.
    pub(super) fn list(&self, tile: usize) -> &[u32] {
        &self.tiles[tile].list
    }

    /// Whether something in a tile changed.
    pub(super) fn is_dirty(&self, tile: usize) -> bool {
        self.tiles[tile].dirty
    }

    /// Whether some lists are too long to mend.
    pub(super) fn are_long(&self) -> bool {
        self.requested.iter().any(|&requested| requested > LONG * self.columns as u64)
    }

    /// Says that all pixels are what the lists say.
    pub(super) fn clean(&mut self) {
        self.tiles.iter_mut().for_each(|tile| tile.dirty = false);
    }

    /// Gets ready for the lists of a frame in which so many splats are drawn.
    pub(super) fn begin(&mut self, drawn: usize) {
        (self.boxed, self.drawn) = (0, drawn);
    }

    /// Takes over the lists of the tile rows `band`. A tile becomes dirty if its list differs from the one
    /// before, or holds a splat that `changed`; all do where that is not known.
    pub(super) fn take(
        &mut self,
        bins: &Bins,
        band: &Range<usize>,
        changed: Option<&[bool]>,
        parallel: bool,
    ) {
        let columns = self.columns;
        self.boxed += bins.boxed();
        for row in band.clone() {
            self.requested[row] = bins.requested(row - band.start);
        }
        let tiles = &mut self.tiles[band.start * columns..band.end * columns];
        parallel::for_each(parallel, tiles, |index, tile| {
            let list = bins.rows()[index / columns].tile(index % columns);
            let same = tile.list == list;
            tile.dirty |= !same || changed.is_none_or(|changed| tile.holds_any(changed));
            if !same {
                tile.list.clear();
                tile.list.extend_from_slice(list);
            }
        });
    }

    /// Takes splats out of the lists of tiles they left and puts them into those of tiles they came to;
    /// marks these tiles and those of splats that only changed colour, which are looked for in all lists if
    /// `scan` says which they are. `projected` is the frame after the changes; the lists are those of the
    /// frame before, and clean. Returns the number of lists mended.
    pub(super) fn mend<'a>(
        &mut self,
        changes: impl Iterator<Item = &'a Change> + Clone,
        scan: Option<&[bool]>,
        projected: &Projected,
        shape: &Spans,
        parallel: bool,
    ) -> u64 {
        let Self { tiles, columns, rows, boxed, requested, came, moved, .. } = self;
        let (columns, all) = (*columns, 0..*rows);
        moved.resize(projected.keys.len(), false);
        came.clear();
        for change in changes.clone() {
            let key = projected.keys[change.index as usize];
            if !change.moved && scan.is_some() {
                continue;
            }
            if !change.moved {
                shape.spans(&projected.splats[change.index as usize], &all, &mut |row, span| {
                    let row = &mut tiles[row * columns..];
                    row[span].iter_mut().for_each(|tile| tile.dirty = true);
                });
                continue;
            }
            moved[change.index as usize] = true;
            if change.old_key != SKIPPED {
                *boxed -= shape.spans(&change.old, &all, &mut |row, span| {
                    requested[row] -= span.len() as u64;
                    let row = &mut tiles[row * columns..];
                    row[span].iter_mut().for_each(|tile| tile.mend = true);
                });
            }
            if key != SKIPPED {
                came.push(u64::from(key) << 32 | u64::from(change.index));
            }
        }
        came.sort_unstable();
        for &entry in came.iter() {
            let index = entry as u32;
            *boxed += shape.spans(&projected.splats[index as usize], &all, &mut |row, span| {
                requested[row] += span.len() as u64;
                for tile in &mut tiles[row * columns..][span] {
                    tile.came.push(index);
                    tile.mend = true;
                }
            });
        }
        let moved_now = &*moved;
        parallel::for_each_with(parallel, tiles, |merged: &mut Vec<u32>, _, tile| {
            if tile.mend {
                tile.merge(moved_now, &projected.keys, merged);
            }
            tile.dirty |= tile.mend || scan.is_some_and(|changed| tile.holds_any(changed));
        });
        let mut mended = 0;
        for tile in tiles.iter_mut() {
            mended += u64::from(std::mem::take(&mut tile.mend));
        }
        changes.for_each(|change| moved[change.index as usize] = false);
        mended
    }

    /// Adds what the lists hold to `counters`.
    pub(super) fn count(&self, counters: &mut Counters) {
        counters.boxed += self.boxed;
        for tile in &self.tiles {
            counters.intersections += tile.list.len() as u64;
            counters.tiles_touched += u64::from(!tile.list.is_empty());
        }
    }
}

impl StoredList {
    fn holds_any(&self, splats: &[bool]) -> bool {
        self.list.iter().any(|&splat| splats[splat as usize])
    }

    /// The list without splats that moved, and with those that came, by (key, index).
    fn merge(&mut self, moved: &[bool], keys: &[u32], room: &mut Vec<u32>) {
        let entry = |index: u32| (keys[index as usize], index);
        room.clear();
        let mut came = self.came.iter().copied().peekable();
        for &index in self.list.iter().filter(|&&index| !moved[index as usize]) {
            while let Some(next) = came.next_if(|&next| entry(next) < entry(index)) {
                room.push(next);
            }
            room.push(index);
        }
        room.extend(came);
        std::mem::swap(&mut self.list, room);
        self.came.clear();
    }
}
