//! Renders worlds exactly as they are rendered alone, bit for bit.
//!
//! A world's list is the shared list without the absent groups: the splats and their order are those of a
//! render of that world, and so is every operation on every pixel. What is shared is what does not change
//! a bit: alphas do not depend on the world, and worlds that hold the same of the groups met so far are one
//! until a group is met that only some of them hold.

use pulp::Simd;

use super::{
    Engine, States,
    culling::{ACROSS, BLOCKS, SIDE, TileCulling},
    fast::Worlds,
    operator::Operator,
    plan::{LanePlan, Pass, group_set},
    shared_lists::SharedLists,
    splat_runs::SplatRuns,
    squares::{Squares, add, inside, squares, wanted, within},
    states::CHUNK,
    tree::Tree,
};
use crate::{
    Camera,
    image::{Image, ImageError},
    parallel,
    settings::Settings,
    stage::TILE,
};

#[derive(Default)]
struct TileScratch {
    culling: TileCulling,
    runs: SplatRuns,
    passes: Vec<Pass>,
    seen: Vec<u64>,
    tree: Tree,
}

/// Where the pictures of a tile's blocks go.
trait Sink: Sync {
    type Tile: Send;

    /// The classes of a pass over a tile.
    fn classes(&self, tile: &mut Self::Tile, pass: usize, classes: &[u128]);

    /// What a block shows, given tile, pass and block: class `i` has the picture `found[of[i]]`.
    fn block(
        &self,
        tile: &mut Self::Tile,
        place: (usize, usize, usize),
        size: (usize, usize),
        of: &[u32],
        found: &[Operator],
    );
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct TileJob<'a, K: Sink> {
    scratch: &'a mut TileScratch,
    shared: &'a SharedLists,
    settings: &'a Settings,
    plan: &'a Worlds,
    tile: usize,
    sink: &'a K,
    out: &'a mut K::Tile,
}

impl<K: Sink> pulp::WithSimd for TileJob<'_, K> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { scratch, shared, settings, plan, tile, sink, out } = self;
        let TileScratch { culling, runs, passes, seen, tree } = scratch;
        let groups = shared.groups(tile);
        passes.resize_with(plan.passes(), Pass::default);
        for (index, pass) in passes.iter_mut().enumerate() {
            pass.start(groups);
            plan.lanes(index, &mut pass.block);
            sink.classes(out, index, &pass.block.classes);
        }
        culling.fill(shared, tile, settings);
        let size = inside(shared.corner(tile), shared.size);
        for block in (0..BLOCKS).filter(|&b| within(b, size)) {
            runs.find(culling, block, settings);
            group_set(&runs.locals, groups.len(), seen);
            for (index, pass) in passes.iter_mut().enumerate() {
                let at = pass.find_kinds(seen);
                let Pass { block: lanes, kinds, .. } = pass;
                let kinds = &kinds[at];
                tree.walk(simd, culling, runs, &lanes.lanes, &kinds.first, settings.closed_below());
                sink.block(out, (tile, index, block), size, &kinds.of, &tree.found);
            }
        }
    }
}

/// Squared errors.
struct Errors<'a>(&'a Engine);

/// Classes and squares of each pass.
type Sums = Vec<(Vec<u128>, Vec<Squares>)>;

impl Sink for Errors<'_> {
    type Tile = Sums;

    fn classes(&self, tile: &mut Sums, _: usize, classes: &[u128]) {
        tile.push((classes.to_vec(), vec![[0.0; TILE]; classes.len()]));
    }

    #[inline(always)]
    fn block(
        &self,
        tile: &mut Sums,
        (index, pass, block): (usize, usize, usize),
        size: (usize, usize),
        of: &[u32],
        found: &[Operator],
    ) {
        let wanted = wanted(&self.0.reference[index], block, size);
        let background = self.0.settings.background;
        let of_kinds: Vec<Squares> = found.iter().map(|f| squares(&over(f, background), &wanted)).collect();
        for (sum, &kind) in tile[pass].1.iter_mut().zip(of) {
            add(sum, &of_kinds[kind as usize]);
        }
    }
}

/// What shows over `background`.
#[inline(always)]
pub(super) fn over(found: &Operator, background: [f32; 3]) -> [[f32; TILE]; 3] {
    let mut out = found.rgb;
    for (out, back) in out.iter_mut().zip(background) {
        (0..TILE).for_each(|i| out[i] += found.t[i] * back);
    }
    out
}

/// Sum of squared errors of each world.
pub(super) fn errors(engine: &Engine, states: &States) -> Vec<f64> {
    let Engine { shared, settings, .. } = engine;
    let plan = Worlds::new(states);
    let sink = Errors(engine);
    let mut tiles: Vec<Vec<f64>> = vec![vec![]; shared.tiles()];
    parallel::for_each_with(settings.parallel, &mut tiles, |scratch: &mut TileScratch, tile, out| {
        let mut sums = Sums::new();
        let walk = TileJob { scratch, shared, settings, plan: &plan, tile, sink: &sink, out: &mut sums };
        pulp::Arch::new().dispatch(walk);
        out.resize(states.len(), 0.0);
        for (pass, (classes, squares)) in sums.iter().enumerate() {
            for (&class, squares) in classes.iter().zip(squares) {
                let total = squares.iter().sum::<f64>();
                super::classes::members(class).for_each(|world| out[pass * CHUNK + world] = total);
            }
        }
    });
    let mut out = vec![0.0; states.len()];
    for part in &tiles {
        out.iter_mut().zip(part).for_each(|(total, part)| *total += part);
    }
    out
}

/// Pictures.
struct Pictures {
    background: [f32; 3],
}

/// Per pass, the class of each world and the picture of each class.
#[derive(Clone, Default)]
struct Views {
    /// Class of each world of the pass.
    of: Vec<Vec<u32>>,
    /// Rows of a tile, r g b per pixel.
    pictures: Vec<Vec<[[f32; 3 * TILE]; TILE]>>,
}

impl Views {
    fn bytes(&self) -> usize {
        let of: usize = self.of.iter().map(|of| size_of_val(of.as_slice())).sum();
        of + self.pictures.iter().map(|p| size_of_val(p.as_slice())).sum::<usize>()
    }
}

impl Sink for Pictures {
    type Tile = Views;

    fn classes(&self, tile: &mut Views, _: usize, classes: &[u128]) {
        let mut of = vec![0; CHUNK];
        for (index, &class) in (0..).zip(classes) {
            super::classes::members(class).for_each(|world| of[world] = index);
        }
        tile.of.push(of);
        tile.pictures.push(vec![[[0.0; 3 * TILE]; TILE]; classes.len()]);
    }

    #[inline(always)]
    fn block(
        &self,
        tile: &mut Views,
        (_, pass, block): (usize, usize, usize),
        _: (usize, usize),
        of: &[u32],
        found: &[Operator],
    ) {
        let (left, top) = (block % ACROSS * SIDE, block / ACROSS * SIDE);
        let colours: Vec<_> = found.iter().map(|f| over(f, self.background)).collect();
        for (picture, &kind) in tile.pictures[pass].iter_mut().zip(of) {
            let colours = &colours[kind as usize];
            for (i, y) in (0..TILE).map(|i| (i, top + i / SIDE)) {
                let pixel = &mut picture[y][3 * (left + i % SIDE)..][..3];
                (0..3).for_each(|c| pixel[c] = colours[c][i]);
            }
        }
    }
}

/// Pictures, and what else it took to make them.
pub(super) struct Drawn {
    pub images: Vec<Image>,
    /// Bytes that were needed beside the pictures.
    pub scratch: usize,
}

/// The pictures of all worlds.
pub(super) fn images(
    shared: &SharedLists,
    camera: &Camera,
    settings: &Settings,
    states: &States,
) -> Result<Drawn, ImageError> {
    let plan = Worlds::new(states);
    let sink = Pictures { background: settings.background };
    let mut out = Vec::with_capacity(states.len());
    for _ in 0..states.len() {
        let mut image = Image::default();
        image.reset(camera.width(), camera.height())?;
        out.push(image);
    }
    let width = camera.width() as usize;
    // A row of tiles at a time, so that the pictures of tiles need not all be kept.
    let mut views = vec![Views::default(); shared.columns];
    let mut scratch = 0;
    for row in 0..shared.tiles() / shared.columns.max(1) {
        parallel::for_each_with(settings.parallel, &mut views, |scratch: &mut TileScratch, column, out| {
            out.of.clear();
            out.pictures.clear();
            let tile = row * shared.columns + column;
            let walk = TileJob { scratch, shared, settings, plan: &plan, tile, sink: &sink, out };
            pulp::Arch::new().dispatch(walk);
        });
        scratch = scratch.max(views.iter().map(Views::bytes).sum());
        parallel::for_each(settings.parallel, &mut out, |world, image| {
            let rows = image.rgb_mut().chunks_exact_mut(3 * width).skip(TILE * row).take(TILE);
            for (y, pixels) in rows.enumerate() {
                for (pixels, view) in pixels.chunks_mut(3 * TILE).zip(&views) {
                    let class = view.of[world / CHUNK][world % CHUNK] as usize;
                    pixels.copy_from_slice(&view.pictures[world / CHUNK][class][y][..pixels.len()]);
                }
            }
        });
    }
    Ok(Drawn { images: out, scratch })
}
