//! What all worlds share: projection, depth order, exact tile lists and the groups of each tile.

use super::Variants;
use super::faded::Faded;
use crate::stage::{Splat, TILE, bin, project, sort};
use crate::{Camera, Settings, parallel};

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
        let mut parts: Vec<Part> = Vec::new();
        for band in &bands {
            let classes = (variants.groups(), variants.count());
            bin::bin_by_class(&projected, &order, band, columns, settings, classes, &mut bins);
            parts.resize_with(parts.len().max(band.len()), Part::default);
            let parts = &mut parts[..band.len()];
            parallel::for_each_with(settings.parallel, parts, |room: &mut Room, row, part| {
                part.clear();
                for column in 0..columns {
                    let corner = [column * TILE, (band.start + row) * TILE];
                    let list = bins.rows()[row].tile(column);
                    room.tile(list, corner, variants, &projected.splats, settings, part);
                }
            });
            parts.iter().for_each(|part| out.append(part));
        }
        out.projected = projected;
        out
    }

    /// Adds a row of tiles.
    fn append(&mut self, part: &Part) {
        let (entries, sets) = (self.entries.len(), self.sets.len());
        self.starts.extend(part.ends.iter().map(|end| entries + end));
        self.set_starts.extend(part.set_ends.iter().map(|end| sets + end));
        self.entries.extend_from_slice(&part.entries);
        self.sets.extend_from_slice(&part.sets);
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

/// A row of tiles.
#[derive(Debug, Default)]
struct Part {
    entries: Vec<Entry>,
    /// Where each tile's entries end.
    ends: Vec<usize>,
    sets: Vec<u32>,
    /// Where each tile's groups end.
    set_ends: Vec<usize>,
}

impl Part {
    fn clear(&mut self) {
        self.entries.clear();
        self.ends.clear();
        self.sets.clear();
        self.set_ends.clear();
    }
}

/// What one thread needs to make tiles.
#[derive(Default)]
struct Room {
    /// Per group, the tile it was last met in, from 1, and its place there.
    slots: Vec<(u64, u32)>,
    /// Tiles made.
    made: u64,
    faded: Faded,
}

impl Room {
    /// Adds the tile at `corner` to `part`: its entries, each with its group's place.
    fn tile(
        &mut self,
        list: &[u32],
        corner: [usize; 2],
        variants: &Variants,
        splats: &[Splat],
        settings: &Settings,
        part: &mut Part,
    ) {
        let Self { slots, made, faded } = self;
        slots.resize(variants.count(), (0, 0));
        *made += 1;
        let first = part.sets.len();
        faded.open(list.len(), settings);
        for &splat in list {
            let group = variants.groups()[splat as usize];
            let slot = &mut slots[group as usize];
            if slot.0 != *made {
                *slot = (*made, (part.sets.len() - first) as u32);
                part.sets.push(group);
            }
            if faded.shows(&splats[splat as usize], slot.1, corner, settings) {
                part.entries.push(Entry { splat, local: slot.1 });
            }
        }
        part.ends.push(part.entries.len());
        part.set_ends.push(part.sets.len());
    }
}
