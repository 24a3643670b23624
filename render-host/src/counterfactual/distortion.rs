//! Answers the paper's question: D = MSE + 0.20 (1 − SSIM) of many states that differ in one cluster.
//!
//! ```text
//! contexts ─▶ blocks of 4 × 4 pixels in every version that can be told apart there (patches)
//!          ─▶ picture of each context, squared error of its blocks, similarity of its windows
//!          ─▶ per version of a cluster: its patches' squares, the windows that its patches reach
//! ```
//!
//! Pixels are bit for bit those of each state rendered alone. Where a version changes no pixel of a block,
//! the block and the windows beyond its reach keep the context's numbers; sums are f64, so a distortion is
//! within 1e-12 of [`crate::metric::distortion`] of the picture ([`super::brute::distortions`] is the twin).

use std::ops::Range;

use super::{
    Engine,
    culling::{ACROSS, BLOCKS, SIDE},
    patches::{self, Changes, Patch, Pixels},
    squares::Planes as TilePlanes,
    versions::{Distortions, Versions},
};
use crate::{
    metric::{
        distortion::STRUCTURE_WEIGHT,
        ssim::target::{Planes, Rectangle, Scratch, Target},
    },
    parallel,
};

/// Contexts times blocks whose patches are kept at once: bounds memory, and shares alphas among contexts.
const BLOCKS_AT_ONCE: usize = 16 * 1600;
/// Rows of windows that are compared together.
const BAND: usize = 16;

/// All distortions of all contexts.
pub(super) fn distortions(
    engine: &Engine,
    versions: &Versions,
    contexts: &[Vec<u32>],
    counted: Option<&[u8]>,
) -> Distortions {
    let comparison = &Comparison { engine, target: Target::new(&engine.against), counted };
    let blocks = engine.shared.tiles() * BLOCKS;
    let mut base = Vec::with_capacity(contexts.len());
    let mut changed = Vec::new();
    for some in contexts.chunks((BLOCKS_AT_ONCE / blocks.max(1)).max(1)) {
        let first = base.len();
        let tiles = patches::draw(engine, versions, some);
        let pictures: Vec<Base> = (0..some.len()).map(|i| Base::new(comparison, &tiles, i)).collect();
        base.extend(pictures.iter().map(|picture| picture.distortion(&comparison.target)));
        let mut worlds = by_world(&tiles, some.len() * versions.groups());
        parallel::for_each_with(
            engine.settings.parallel,
            &mut worlds,
            |scratch: &mut TileScratch, _, world| {
                let context = world.at / versions.groups();
                world.distortion =
                    scratch.distortion(comparison, &tiles, (context, &pictures[context]), world);
            },
        );
        for World { at, distortion, .. } in worlds {
            changed.push((first + at / versions.groups(), at % versions.groups(), distortion));
        }
    }
    let mut out = Distortions::new(versions, base);
    changed.into_iter().for_each(|(context, group, distortion)| out.set(context, group, distortion));
    out
}

/// What pictures are compared with, and where.
struct Comparison<'a> {
    engine: &'a Engine,
    target: Target,
    /// 0 of pixels that are taken as equal, where some are.
    counted: Option<&'a [u8]>,
}

impl Comparison<'_> {
    /// `pixels` of a block of a tile, with those of the reference where they do not count.
    fn counted(&self, tile: usize, block: usize, place: &Place, pixels: &Pixels) -> Pixels {
        let mut out = *pixels;
        let Some(counted) = self.counted else { return out };
        let (left, top) = (block % ACROSS * SIDE, block / ACROSS * SIDE);
        for (row, y) in place.rows.clone().enumerate() {
            for (column, x) in place.columns.clone().enumerate() {
                if counted[y * self.engine.shared.size[0] + x] == 0 {
                    let reference = &self.engine.reference[tile][top + row];
                    (0..3).for_each(|c| out[c][SIDE * row + column] = reference[c][left + column]);
                }
            }
        }
        out
    }
}

/// A context with one cluster at another version, and where it differs.
struct World {
    /// Context of the batch times the number of groups, plus the group.
    at: usize,
    /// Tile and patch.
    patches: Vec<(u32, Patch)>,
    distortion: f64,
}

/// The patches of each world that has any, in order of worlds, each in order of tiles.
fn by_world(tiles: &[Changes], worlds: usize) -> Vec<World> {
    let mut places = vec![u32::MAX; worlds];
    let mut out: Vec<World> = Vec::new();
    for (tile, changes) in (0..).zip(tiles) {
        for &patch in &changes.patches {
            let place = &mut places[patch.world as usize];
            if *place == u32::MAX {
                *place = out.len() as u32;
                out.push(World { at: patch.world as usize, patches: Vec::new(), distortion: 0.0 });
            }
            out[*place as usize].patches.push((tile, patch));
        }
    }
    out.sort_unstable_by_key(|world| world.at);
    out
}

/// The picture of a context and what it is made of.
struct Base {
    planes: Planes,
    /// Squared error of each block, tile by tile.
    squares: Vec<f64>,
    /// Sum of them.
    error: f64,
    /// Similarity of each window, added over channels.
    similarities: Vec<f64>,
    /// Sum of them.
    similarity: f64,
}

impl Base {
    fn new(comparison: &Comparison<'_>, tiles: &[Changes], context: usize) -> Self {
        let Comparison { engine, target, .. } = comparison;
        let shared = &engine.shared;
        let [width, height] = shared.size;
        let mut planes: Planes = [0; 3].map(|_| vec![0.0; width * height]);
        let mut squares = Vec::with_capacity(tiles.len() * BLOCKS);
        for (tile, changes) in tiles.iter().enumerate() {
            for (block, pixels) in changes.base(context).iter().enumerate() {
                let place = Place::of(shared.corner(tile), block, shared.size);
                let pixels = &comparison.counted(tile, block, &place, pixels);
                place.write(pixels, width, &mut planes);
                squares.push(square(pixels, &engine.reference[tile], block, &place));
            }
        }
        let all = target.all();
        let mut similarities = vec![0.0; all.len()];
        // A band at a time, so that what is filtered stays in the cache.
        let mut bands: Vec<&mut [f64]> = similarities.chunks_mut(BAND * all.columns.len().max(1)).collect();
        parallel::for_each_with(engine.settings.parallel, &mut bands, |scratch: &mut Scratch, band, out| {
            let rows = BAND * band..(BAND * (band + 1)).min(all.rows.end);
            let part = Rectangle { columns: all.columns.clone(), rows };
            target.similarities(&planes, &part, scratch, out);
        });
        let (error, similarity) = (squares.iter().sum(), similarities.iter().sum());
        Self { planes, squares, error, similarities, similarity }
    }

    fn distortion(&self, target: &Target) -> f64 {
        whole(target, self.planes[0].len(), self.error, self.similarity)
    }
}

/// MSE + 0.20 (1 − SSIM) of a picture of `pixels` pixels from the sums that it is made of.
fn whole(target: &Target, pixels: usize, error: f64, similarity: f64) -> f64 {
    error / (3 * pixels) as f64 + STRUCTURE_WEIGHT * (1.0 - similarity / target.windows().count() as f64)
}

/// Pixels of a block that lie inside the image.
struct Place {
    columns: Range<usize>,
    rows: Range<usize>,
}

impl Place {
    fn of(corner: [usize; 2], block: usize, [width, height]: [usize; 2]) -> Self {
        let (left, top) = (corner[0] + block % ACROSS * SIDE, corner[1] + block / ACROSS * SIDE);
        let (right, bottom) = ((left + SIDE).min(width), (top + SIDE).min(height));
        Self { columns: left.min(right)..right, rows: top.min(bottom)..bottom }
    }

    /// Copies `pixels` into planes of a picture of `width` columns.
    fn write(&self, pixels: &Pixels, width: usize, planes: &mut Planes) {
        for (plane, pixels) in planes.iter_mut().zip(pixels) {
            for (row, y) in self.rows.clone().enumerate() {
                let n = self.columns.len();
                plane[y * width + self.columns.start..][..n].copy_from_slice(&pixels[SIDE * row..][..n]);
            }
        }
    }

    /// Copies these pixels of another picture of the same size.
    fn restore(&self, from: &Planes, width: usize, planes: &mut Planes) {
        for (plane, from) in planes.iter_mut().zip(from) {
            for y in self.rows.clone() {
                let row = y * width + self.columns.start..y * width + self.columns.end;
                plane[row.clone()].copy_from_slice(&from[row]);
            }
        }
    }
}

/// Squared error of a block of a tile whose reference is `reference`.
fn square(pixels: &Pixels, reference: &TilePlanes, block: usize, place: &Place) -> f64 {
    let (left, top) = (block % ACROSS * SIDE, block / ACROSS * SIDE);
    let mut sum = 0.0;
    for y in 0..place.rows.len() {
        for (pixels, reference) in pixels.iter().zip(&reference[top + y]) {
            for x in 0..place.columns.len() {
                sum += (f64::from(pixels[SIDE * y + x]) - f64::from(reference[left + x])).powi(2);
            }
        }
    }
    sum
}

/// What a thread keeps from world to world.
#[derive(Default)]
struct TileScratch {
    /// Context whose picture `planes` is between two worlds.
    context: Option<usize>,
    planes: Planes,
    scratch: Scratch,
    similarities: Vec<f64>,
    /// Windows reached, band by band of rows.
    reached: Vec<Rectangle>,
}

impl TileScratch {
    /// Distortion of a world of `context`, whose picture is `base`.
    fn distortion(
        &mut self,
        comparison: &Comparison<'_>,
        tiles: &[Changes],
        (context, base): (usize, &Base),
        world: &World,
    ) -> f64 {
        let Self { context: shown, planes, scratch, similarities, reached } = self;
        let Comparison { engine, target, .. } = comparison;
        if shown.replace(context) != Some(context) {
            planes.clone_from(&base.planes);
        }
        let size = engine.shared.size;
        let place = |tile: u32, patch: &Patch| {
            Place::of(engine.shared.corner(tile as usize), patch.block as usize, size)
        };
        let mut error = base.error;
        reached.clear();
        reached.resize(target.windows().rows.div_ceil(BAND), Rectangle { columns: 0..0, rows: 0..0 });
        for (tile, patch) in &world.patches {
            let (at, block, place) = (*tile as usize, patch.block as usize, place(*tile, patch));
            let pixels = &tiles[at].pixels[patch.pixels as usize];
            let pixels = &comparison.counted(at, block, &place, pixels);
            error += square(pixels, &engine.reference[at], block, &place) - base.squares[at * BLOCKS + block];
            place.write(pixels, size[0], planes);
            reach(target, &place, reached);
        }
        let all = target.windows().columns;
        let mut similarity = base.similarity;
        for part in reached.iter().filter(|part| part.len() > 0) {
            if similarities.len() < part.len() {
                similarities.resize(part.len(), 0.0);
            }
            target.similarities(planes, part, scratch, similarities);
            for (row, after) in part.rows.clone().zip(similarities.chunks_exact(part.columns.len())) {
                let before = &base.similarities[row * all..][part.columns.clone()];
                similarity += after.iter().zip(before).map(|(after, before)| after - before).sum::<f64>();
            }
        }
        for (tile, patch) in &world.patches {
            place(*tile, patch).restore(&base.planes, size[0], planes);
        }
        whole(target, size[0] * size[1], error, similarity)
    }
}

/// Adds the windows that hold a pixel of `place` to those reached.
fn reach(target: &Target, place: &Place, reached: &mut [Rectangle]) {
    let (columns, rows) = (target.columns_with(&place.columns), target.rows_with(&place.rows));
    for (band, part) in reached.iter_mut().enumerate() {
        let here = rows.start.max(BAND * band)..rows.end.min(BAND * (band + 1));
        if here.is_empty() || columns.is_empty() {
            continue;
        }
        if part.len() == 0 {
            *part = Rectangle { columns: columns.clone(), rows: here };
        } else {
            part.columns = part.columns.start.min(columns.start)..part.columns.end.max(columns.end);
            part.rows = part.rows.start.min(here.start)..part.rows.end.max(here.end);
        }
    }
}
