//! Makes what all worlds share: projection, depth order, exact tile lists and the groups of each tile.

use super::{Variants, hidden::HiddenInGroup};
use crate::{
    Camera, Settings, parallel,
    stage::{Splat, TILE, bin, project, sort},
};

/// One splat of a tile's list.
#[derive(Clone, Copy, Debug)]
pub(super) struct Entry {
    /// Index of the splat.
    pub splat: u32,
    /// Its group, as an index into the tile's groups.
    pub local: u32,
}

/// Tile lists of every variant, nearest first, and the groups met in each.
#[derive(Clone, Debug, Default)]
pub(super) struct SharedLists {
    pub projected: project::Projected,
    /// Width and height, pixels.
    pub size: [usize; 2],
    pub columns: usize,
    /// Of each row of tiles.
    rows: Vec<Lists>,
}

/// The lists of one row of tiles.
#[derive(Clone, Debug)]
struct Lists {
    /// Tile `t` is `entries[starts[t]..starts[t + 1]]`.
    starts: Vec<usize>,
    entries: Vec<Entry>,
    /// Groups of tile `t`, each once: `sets[set_starts[t]..set_starts[t + 1]]`.
    set_starts: Vec<usize>,
    sets: Vec<u32>,
}

/// What a thread needs to make lists.
#[derive(Default)]
struct TileScratch {
    /// Of each group, the tile it was last met in, from 1, and its place there.
    slots: Vec<(usize, u32)>,
    hidden: HiddenInGroup,
}

impl SharedLists {
    pub(super) fn new(variants: &Variants, camera: &Camera, settings: &Settings) -> Self {
        let size = [camera.width() as usize, camera.height() as usize];
        let columns = size[0].div_ceil(TILE);
        let mut projected = project::Projected::default();
        let (mut order, mut bands, mut bins) = (sort::Order::default(), Vec::new(), bin::Bins::default());
        project::project(&variants.splats(), camera, settings, &mut projected);
        sort::sort(&projected.keys, settings.parallel, &mut order);
        bin::bands(&projected, &order, size, settings, &mut bands);

        let mut rows = vec![Lists::new(); size[1].div_ceil(TILE)];
        for band in &bands {
            let classes = (variants.groups(), variants.count());
            bin::bin_by_class(&projected, &order, band, columns, settings, classes, &mut bins);
            let (bins, splats, first) = (bins.rows(), &projected.splats[..], band.start);
            let make = |scratch: &mut TileScratch, row: usize, lists: &mut Lists| {
                scratch.slots.resize(variants.count(), (0, 0));
                for column in 0..columns {
                    let tile = (first + row) * columns + column;
                    let corner = [column * TILE, (first + row) * TILE];
                    let list = bins[row].tile(column);
                    lists.push(tile, corner, list, (splats, variants.groups()), scratch, settings);
                }
            };
            parallel::for_each_with(settings.parallel, &mut rows[band.clone()], make);
        }
        Self { projected, size, columns, rows }
    }

    /// Number of tiles.
    pub(super) fn tiles(&self) -> usize {
        self.columns * self.rows.len()
    }

    /// First pixel of a tile.
    pub(super) fn corner(&self, tile: usize) -> [usize; 2] {
        [tile % self.columns * TILE, tile / self.columns * TILE]
    }

    /// A tile's splats, nearest first.
    pub(super) fn entries(&self, tile: usize) -> &[Entry] {
        let (row, column) = (&self.rows[tile / self.columns], tile % self.columns);
        &row.entries[row.starts[column]..row.starts[column + 1]]
    }

    /// A tile's groups, in order of first appearance.
    pub(super) fn groups(&self, tile: usize) -> &[u32] {
        let (row, column) = (&self.rows[tile / self.columns], tile % self.columns);
        &row.sets[row.set_starts[column]..row.set_starts[column + 1]]
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> u64 {
        let words =
            |row: &Lists| row.starts.len() + row.set_starts.len() + row.sets.len() / 2 + row.entries.len();
        let words: usize = self.rows.iter().map(words).sum();
        (size_of_val(self.projected.splats.as_slice()) + 4 * self.projected.keys.len() + 8 * words) as u64
    }
}

impl Lists {
    fn new() -> Self {
        Self { starts: vec![0], entries: Vec::new(), set_starts: vec![0], sets: Vec::new() }
    }

    /// Adds the list of the row's next tile, which is `tile` of all.
    fn push(
        &mut self,
        tile: usize,
        corner: [usize; 2],
        list: &[u32],
        (splats, groups): (&[Splat], &[u32]),
        scratch: &mut TileScratch,
        settings: &Settings,
    ) {
        let TileScratch { slots, hidden } = scratch;
        let first = self.sets.len();
        hidden.open(list.len(), settings);
        for &splat in list {
            let group = groups[splat as usize];
            let slot = &mut slots[group as usize];
            if slot.0 != tile + 1 {
                *slot = (tile + 1, (self.sets.len() - first) as u32);
                self.sets.push(group);
            }
            if hidden.shows(&splats[splat as usize], slot.1, corner, settings) {
                self.entries.push(Entry { splat, local: slot.1 });
            }
        }
        self.starts.push(self.entries.len());
        self.set_starts.push(self.sets.len());
    }
}
