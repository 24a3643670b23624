//! A sequence renders frames of one scene seen by one camera, each from what the one before left.
//!
//! Between two frames, or between two delivery states of one frame, most Gaussians often stay what they
//! were. A [`SequenceRenderer`] projects only those that changed, keeps the depth order and the tile lists
//! where nothing moved, updates the lists of the tiles that a few moved splats leave or enter, and blends
//! only tiles in which something changed. The picture and its [`Counters`](crate::Counters) are those of a
//! fresh [`render`](crate::render()) of the same frame, bit for bit: what is kept is what would be computed
//! again, and a tile is kept only if its list holds the same splats, equal in every bit, in the same order.
//!
//! Another camera, other settings, another number of Gaussians or another degree start from nothing.

mod inputs;
mod lists;

use serde::{Deserialize, Serialize};

use self::{
    inputs::{Inputs, View},
    lists::Lists,
};
use crate::{
    Renderer, Splats,
    camera::Camera,
    parallel,
    render::{RenderError, Rendered},
    settings::Settings,
    stage::{
        TILE, bin,
        blend::{self, Tile},
        sort,
        span::Spans,
    },
};

/// Tiles blended at a time, so that room stays bounded.
const BATCH: usize = 1 << 14;
/// Entries that are kept at most; a picture with more is made afresh.
const MAX_ENTRIES: u64 = 1 << 26;
/// Splats are looked up one by one while at most one drawn splat in this many changed; else one looks at all.
const FEW: usize = 16;

/// What may be kept between frames. Every choice gives the same picture.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReuseOptions {
    /// Projections of Gaussians that did not change.
    pub projection: bool,
    /// Depth order and tile lists, where nothing moved or little did.
    pub order: bool,
    /// Tiles in which nothing changed.
    pub tiles: bool,
}

impl Default for ReuseOptions {
    fn default() -> Self {
        Self { projection: true, order: true, tiles: true }
    }
}

/// What the last frame kept and what it made, for judging [`ReuseOptions`].
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
pub struct ReuseCounts {
    /// Gaussians projected.
    pub projected: u64,
    /// Gaussians not projected, because they are what they were.
    pub projections_reused: u64,
    /// Splats that changed on the image plane: came, went, moved, or took another colour.
    pub changed: u64,
    /// Entries of the depth order that were sorted.
    pub sorted: u64,
    /// Tile lists made by binning everything.
    pub lists_made: u64,
    /// Tile lists mended: left or entered by a splat, without binning everything.
    pub lists_mended: u64,
    /// Tile lists kept.
    pub lists_reused: u64,
    /// Tiles blended.
    pub tiles_blended: u64,
    /// Tiles that hold no splat and took the background.
    pub tiles_emptied: u64,
    /// Tiles whose pixels were kept.
    pub tiles_reused: u64,
}

/// A renderer that keeps what the frame before made. See the module documentation.
#[derive(Debug)]
pub struct SequenceRenderer {
    reuse: ReuseOptions,
    view: Option<View>,
    inputs: Inputs,
    /// Of `inputs`: projection, order, and room for binning.
    renderer: Renderer,
    /// The order is that of the projection.
    ordered: bool,
    /// `None` where the lists are not those of the projection.
    lists: Option<Lists>,
    spare: Lists,
    work: Vec<blend::Work>,
    dirty: Vec<u32>,
    room: Vec<Tile>,
    most_entries: u64,
    picture: Rendered,
    reused: ReuseCounts,
}

impl Default for SequenceRenderer {
    fn default() -> Self {
        Self::new(ReuseOptions::default())
    }
}

impl SequenceRenderer {
    /// A sequence without a frame.
    pub fn new(reuse: ReuseOptions) -> Self {
        Self {
            reuse,
            view: None,
            inputs: Inputs::default(),
            renderer: Renderer::new(),
            ordered: false,
            lists: None,
            spare: Lists::default(),
            work: Vec::new(),
            dirty: Vec::new(),
            room: Vec::new(),
            most_entries: MAX_ENTRIES,
            picture: Rendered::default(),
            reused: ReuseCounts::default(),
        }
    }

    /// The last picture; empty before the first.
    pub fn picture(&self) -> &Rendered {
        &self.picture
    }

    /// With a bound on memory: pictures with more than `entries` entries in the boxes of all tile lists (4
    /// bytes each) keep their projection only. 2²⁶ unless set.
    #[must_use]
    pub fn keeping_at_most(mut self, entries: u64) -> Self {
        self.most_entries = entries;
        self
    }

    /// What the last frame kept and made.
    pub fn reused(&self) -> ReuseCounts {
        self.reused
    }

    /// Forgets the frame before.
    pub fn forget(&mut self) {
        self.view = None;
    }

    /// Renders the next frame: `splats` as `camera` sees them.
    ///
    /// # Errors
    /// A setting out of range, or tiles of another side than the usual; the sequence is then as it was.
    pub fn render(
        &mut self,
        splats: &Splats,
        camera: &Camera,
        settings: &Settings,
    ) -> Result<&Rendered, RenderError> {
        settings.validate_for_one_tile_side()?;
        let view = View::new(splats, camera, settings);
        let fresh = self.view.as_ref() != Some(&view);
        // Until this frame is whole, there is none to go on from.
        self.view = None;
        self.reused = ReuseCounts::default();
        let size = [camera.width() as usize, camera.height() as usize];
        if fresh {
            self.picture.image.reset(camera.width(), camera.height())?;
            self.picture.transmittance.resize(size[0] * size[1], 1.0);
            self.ordered = false;
            self.drop_lists();
        }
        let keep = self.reuse.projection && !fresh;
        let projected = &mut self.renderer.projected;
        let mut counters = self.inputs.update(splats, camera, settings, fresh, keep, projected);
        self.reused.projected = self.inputs.projected();
        self.reused.projections_reused = splats.len() as u64 - self.reused.projected;
        self.reused.changed = if fresh { counters.drawn } else { self.inputs.changed() as u64 };
        self.ordered &= self.inputs.moved() == 0;

        let [columns, rows] = size.map(|side| side.div_ceil(TILE));
        self.update_lists(size, settings);
        match &self.lists {
            None => {
                // Too many entries to keep: the picture is made the plain way.
                self.renderer.compose(size, settings, &mut self.picture, &mut counters);
                self.reused.tiles_blended = (columns * rows) as u64;
            }
            Some(lists) => {
                self.dirty.clear();
                let all = !self.reuse.tiles || self.work.len() != columns * rows;
                self.dirty
                    .extend((0..(columns * rows) as u32).filter(|&t| all || lists.is_dirty(t as usize)));
                self.work.resize(columns * rows, blend::Work::default());
                self.blend(size, settings);
                if let Some(lists) = &self.lists {
                    lists.count(&mut counters);
                }
                self.work.iter().for_each(|work| work.add_to(&mut counters));
                counters.tiles = (columns * rows) as u64;
                counters.pixels = (size[0] * size[1]) as u64;
            }
        }
        self.picture.counters = counters;
        self.view = Some(view);
        Ok(&self.picture)
    }

    /// Brings the tile lists up to the projection, and marks the tiles in which something changed.
    fn update_lists(&mut self, size: [usize; 2], settings: &Settings) {
        let [columns, rows] = size.map(|side| side.div_ceil(TILE));
        let all = (columns * rows) as u64;
        let Renderer { projected, order, bands, bins, .. } = &mut self.renderer;
        if let Some(lists) = &mut self.lists {
            lists.clean();
        }
        if let Some(lists) = self.lists.as_mut().filter(|_| self.reuse.order) {
            if self.inputs.changed() == 0 {
                self.reused.lists_reused = all;
                return;
            }
            let few = lists.drawn / FEW;
            let (changed, moved) = (self.inputs.changed(), self.inputs.moved());
            if moved <= few && !lists.are_long() {
                let scan = (changed - moved > few).then(|| self.inputs.flags());
                let mended = lists.mend(
                    self.inputs.changes(),
                    scan,
                    projected,
                    &Spans::new(settings),
                    settings.parallel,
                );
                if !lists.are_long() {
                    self.reused.lists_mended = mended;
                    self.reused.lists_reused = all - mended;
                    return;
                }
            }
        }
        if !self.ordered {
            sort::sort(&projected.keys, settings.parallel, order);
            self.reused.sorted = order.entries().len() as u64;
            self.ordered = true;
        }
        let boxes = order.indices().map(|index| {
            let splat = &projected.splats[index as usize];
            (splat.tile_columns(settings.tile).len() * splat.tile_rows(settings.tile).len()) as u64
        });
        bin::bands(projected, order, size, settings, bands);
        if boxes.sum::<u64>() > self.most_entries {
            self.drop_lists();
            return;
        }
        let known = self.lists.is_some();
        let mut lists = self.lists.take().unwrap_or_else(|| std::mem::take(&mut self.spare));
        if !known {
            lists.reset(columns, rows);
        }
        lists.begin(order.entries().len());
        let changed = self.inputs.flags();
        for band in bands.iter() {
            bin::bin(projected, order, band, columns, settings, bins);
            lists.take(bins, band, known.then_some(changed), settings.parallel);
        }
        self.reused.lists_made = all;
        self.lists = Some(lists);
    }

    /// Says that neither lists nor pixels are known; keeps the room.
    fn drop_lists(&mut self) {
        if let Some(lists) = self.lists.take() {
            self.spare = lists;
        }
        self.work.clear();
    }

    /// Blends the dirty tiles and puts them into the picture.
    fn blend(&mut self, size: [usize; 2], settings: &Settings) {
        let Self { renderer, lists: Some(lists), work, dirty, room, picture, reused, .. } = self else {
            return;
        };
        let columns = size[0].div_ceil(TILE);
        let splats = &renderer.projected.splats;
        reused.tiles_reused = work.len() as u64 - dirty.len() as u64;
        for batch in dirty.chunks(BATCH) {
            let empty = |tile: u32| settings.skip_empty_tiles && lists.list(tile as usize).is_empty();
            room.resize(room.len().max(batch.len()), Tile::EMPTY);
            parallel::for_each(settings.parallel, &mut room[..batch.len()], |i, room| {
                let tile = batch[i] as usize;
                if !empty(batch[i]) {
                    let corner = [tile % columns * TILE, tile / columns * TILE];
                    blend::blend_tile(splats, lists.list(tile), corner, size, settings, false, room);
                }
            });
            for (&tile, room) in batch.iter().zip(room.iter()) {
                let emptied = empty(tile);
                work[tile as usize] = if emptied { blend::Work::default() } else { room.work };
                reused.tiles_emptied += u64::from(emptied);
                reused.tiles_blended += u64::from(!emptied);
            }
            let Rendered { image, transmittance, .. } = &mut *picture;
            let rgb = image.rgb_mut().chunks_mut(TILE * size[0] * 3);
            let mut rows: Vec<_> = rgb.zip(transmittance.chunks_mut(TILE * size[0])).collect();
            parallel::for_each(settings.parallel, &mut rows, |row, (rgb, transmittance)| {
                let first = batch.partition_point(|&tile| (tile as usize) < row * columns);
                let past = batch.partition_point(|&tile| (tile as usize) < (row + 1) * columns);
                for (&tile, room) in batch[first..past].iter().zip(&room[first..past]) {
                    let drawn = (!empty(tile)).then_some(room);
                    let x =
                        tile as usize % columns * TILE..(tile as usize % columns * TILE + TILE).min(size[0]);
                    let lines = rgb.chunks_mut(3 * size[0]).zip(transmittance.chunks_mut(size[0]));
                    for (y, (rgb, transmittance)) in lines.enumerate() {
                        let (rgb, transmittance) =
                            (&mut rgb[3 * x.start..3 * x.end], &mut transmittance[x.clone()]);
                        blend::resolve_row(drawn, y, settings.background, rgb, transmittance);
                    }
                }
            });
        }
    }
}
