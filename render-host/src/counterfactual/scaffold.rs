//! What all worlds share: projection, depth order, exact tile lists and the groups of each tile.

use super::Variants;
use super::faded::Faded;
use crate::stage::{Splat, TILE, bin, project, sort};
use crate::{Camera, Settings};

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
pub(super) struct Shared {
    pub projected: project::Projected,
    /// Width and height, pixels.
    pub size: [usize; 2],
    pub columns: usize,
    /// Tile `t` is `entries[starts[t]..starts[t + 1]]`.
    starts: Vec<usize>,
    entries: Vec<Entry>,
    /// Groups of tile `t`, each once: `sets[set_starts[t]..set_starts[t + 1]]`.
    set_starts: Vec<usize>,
    sets: Vec<u32>,
}

impl Shared {
    pub(super) fn new(variants: &Variants, camera: &Camera, settings: &Settings) -> Self {
        let size = [camera.width() as usize, camera.height() as usize];
        let columns = size[0].div_ceil(TILE);
        let mut projected = project::Projected::default();
        let (mut order, mut bands, mut bins) = (sort::Order::default(), Vec::new(), bin::Bins::default());
        project::project(&variants.splats(), camera, settings, &mut projected);
        sort::sort(&projected.keys, settings.parallel, &mut order);
        bin::bands(&projected, &order, size, settings.tile, &mut bands);

        let mut out = Self { size, columns, starts: vec![0], set_starts: vec![0], ..Self::default() };
        const NOWHERE: (usize, u32) = (usize::MAX, 0);
        let mut slots = vec![NOWHERE; variants.count()]; // (tile last met in, place there)
        let mut faded = Faded::default();
        for band in &bands {
            let classes = (variants.groups(), variants.count());
            bin::bin_by_class(&projected, &order, band, columns, settings, classes, &mut bins);
            for row in bins.rows() {
                for list in (0..columns).map(|column| row.tile(column)) {
                    let seen = (&projected.splats[..], &mut faded, settings);
                    out.push_tile(list, variants.groups(), &mut slots, seen);
                }
            }
        }
        out.projected = projected;
        out
    }

    fn push_tile(
        &mut self,
        list: &[u32],
        groups: &[u32],
        slots: &mut [(usize, u32)],
        (splats, faded, settings): (&[Splat], &mut Faded, &Settings),
    ) {
        let (tile, first) = (self.starts.len() - 1, self.sets.len());
        let corner = self.corner(tile);
        faded.open(list.len(), settings);
        for &splat in list {
            let group = groups[splat as usize];
            let slot = &mut slots[group as usize];
            if slot.0 != tile {
                *slot = (tile, (self.sets.len() - first) as u32);
                self.sets.push(group);
            }
            if faded.shows(&splats[splat as usize], slot.1, corner, settings) {
                self.entries.push(Entry { splat, local: slot.1 });
            }
        }
        self.starts.push(self.entries.len());
        self.set_starts.push(self.sets.len());
    }

    /// Number of tiles.
    pub(super) fn tiles(&self) -> usize {
        self.starts.len() - 1
    }

    /// First pixel of a tile.
    pub(super) fn corner(&self, tile: usize) -> [usize; 2] {
        [tile % self.columns * TILE, tile / self.columns * TILE]
    }

    /// A tile's splats, nearest first.
    pub(super) fn entries(&self, tile: usize) -> &[Entry] {
        &self.entries[self.starts[tile]..self.starts[tile + 1]]
    }

    /// A tile's groups, in order of first appearance.
    pub(super) fn groups(&self, tile: usize) -> &[u32] {
        &self.sets[self.set_starts[tile]..self.set_starts[tile + 1]]
    }

    /// Bytes held.
    pub(super) fn bytes(&self) -> u64 {
        let words = self.starts.len() + self.set_starts.len() + self.sets.len() / 2 + self.entries.len();
        (size_of_val(self.projected.splats.as_slice()) + 4 * self.projected.keys.len() + 8 * words) as u64
    }
}
