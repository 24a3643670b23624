//! Walks tiles and their blocks for a fast mode, which decides what the lanes are and where errors go.

use pulp::Simd;

use super::{
    Engine,
    culling::{BLOCKS, TileCulling},
    lanes::{Kinds, Lanes},
    segments::{self, RunSegments},
    splat_runs::SplatRuns,
    squares::{inside, wanted, within},
};
use crate::parallel;

/// A fast mode.
pub(super) trait LanePlan: Sync {
    /// Numbers kept per tile that meets `groups`.
    fn size(&self, groups: &[u32]) -> usize;

    /// About how many lanes a block of `groups` groups can tell apart. A guess that does not depend on the
    /// question, so that a world's number does not depend on what else was asked.
    fn kinds(&self, groups: usize) -> usize;

    /// Passes over every block; each makes its own lanes.
    fn passes(&self) -> usize {
        1
    }

    /// Sets up the lanes of pass `pass` for a tile that meets `block.groups`; how many is its choice, and 0
    /// skips the tile. The order of `block.present` is the plan's.
    fn lanes(&self, pass: usize, block: &mut Block);

    /// Writes the errors of the lanes to the tile's numbers.
    fn gather(&self, pass: usize, block: &Block, errors: &[f64], out: &mut [f64]);
}

/// What a plan sees of a tile.
#[derive(Debug, Default)]
pub(super) struct Block {
    /// Group of each local index of the tile.
    pub groups: Vec<u32>,
    /// All local indices.
    pub present: Vec<u32>,
    pub lanes: Lanes,
    pub count: usize,
    /// Room for classes of worlds.
    pub classes: Vec<u128>,
}

impl Block {
    pub(super) fn reset(&mut self, count: usize) {
        self.count = count;
        self.lanes.reset(count, self.groups.len());
    }
}

/// Numbers per tile.
#[derive(Debug)]
pub(super) struct Sums {
    values: Vec<f64>,
    starts: Vec<usize>,
}

impl Sums {
    pub(super) fn tile(&self, tile: usize) -> &[f64] {
        &self.values[self.starts[tile]..self.starts[tile + 1]]
    }
}

#[derive(Default)]
struct TileScratch {
    culling: TileCulling,
    runs: SplatRuns,
    passes: Vec<Pass>,
    seen: Vec<u64>,
}

/// What a tile keeps from block to block.
#[derive(Default)]
pub(super) struct Pass {
    pub block: Block,
    pub segments: RunSegments,
    /// Kinds met so far; `known` of them count.
    pub kinds: Vec<Kinds>,
    known: usize,
}

impl Pass {
    /// Starts a tile that meets `groups`.
    pub(super) fn start(&mut self, groups: &[u32]) {
        self.block.groups.clear();
        self.block.groups.extend_from_slice(groups);
        self.block.present.clear();
        self.block.present.extend(0..groups.len() as u32);
        self.segments.reset();
        self.known = 0;
    }

    /// The place of the kinds of lanes in a block that meets the groups of `seen`.
    #[inline(always)]
    pub(super) fn find_kinds(&mut self, seen: &[u64]) -> usize {
        let Self { block, kinds, known, .. } = self;
        kinds[..*known].iter().position(|kinds| kinds.are_for(seen)).unwrap_or_else(|| {
            if kinds.len() == *known {
                kinds.push(Kinds::default());
            }
            block.lanes.kinds(seen, &mut kinds[*known]);
            *known += 1;
            *known - 1
        })
    }

    /// Cuts a block into segments that suit its kinds of lanes. Returns the place of those kinds.
    #[inline(always)]
    pub(super) fn cut<S: Simd>(
        &mut self,
        simd: S,
        runs: &mut SplatRuns,
        seen: &[u64],
        guess: impl Fn(usize) -> usize,
    ) -> usize {
        let at = self.find_kinds(seen);
        let Self { block, segments, kinds, .. } = self;
        if kinds[at].limit == 0 {
            let groups = seen.iter().map(|word| word.count_ones() as usize).sum();
            kinds[at].limit = segments::limit(&runs.locals, guess(groups));
        }
        segments.fill(simd, runs, &block.lanes, kinds[at].limit);
        at
    }
}

/// Runs `plan` over all tiles.
pub(super) fn run(engine: &Engine, plan: &impl LanePlan) -> Sums {
    let shared = &engine.shared;
    let mut starts = vec![0];
    let mut end = 0;
    for tile in 0..shared.tiles() {
        end += plan.size(shared.groups(tile));
        starts.push(end);
    }
    let mut values = vec![0.0; end];
    let mut rest = values.as_mut_slice();
    let mut work = Vec::with_capacity(shared.tiles());
    for (tile, bounds) in starts.windows(2).enumerate() {
        let (own, after) = rest.split_at_mut(bounds[1] - bounds[0]);
        rest = after;
        work.push((tile, own));
    }
    parallel::for_each_with(
        engine.settings.parallel,
        &mut work,
        |scratch: &mut TileScratch, _, (tile, out)| {
            pulp::Arch::new().dispatch(TileJob { scratch, engine, plan, tile: *tile, out });
        },
    );
    Sums { values, starts }
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct TileJob<'a, P> {
    scratch: &'a mut TileScratch,
    engine: &'a Engine,
    plan: &'a P,
    tile: usize,
    out: &'a mut [f64],
}

impl<P: LanePlan> pulp::WithSimd for TileJob<'_, P> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { scratch, engine, plan, tile, out } = self;
        let TileScratch { culling, runs, passes, seen } = scratch;
        let Engine { shared, settings, .. } = engine;
        let groups = shared.groups(tile);
        out.fill(0.0);
        passes.resize_with(plan.passes(), Pass::default);
        for (index, pass) in passes.iter_mut().enumerate() {
            pass.start(groups);
            plan.lanes(index, &mut pass.block);
        }
        if passes.iter().all(|pass| pass.block.count == 0) {
            return;
        }
        culling.fill(shared, tile, settings);
        let size = inside(shared.corner(tile), shared.size);
        for index in (0..BLOCKS).filter(|&b| within(b, size)) {
            runs.find(culling, index, settings);
            runs.compose(simd, culling, false);
            let wanted = wanted(&engine.reference[tile], index, size);
            group_set(&runs.locals, groups.len(), seen);
            for pass in passes.iter_mut().filter(|pass| pass.block.count > 0) {
                let at = pass.cut(simd, runs, seen, |groups| plan.kinds(groups));
                let Pass { block, segments, kinds, .. } = pass;
                block.lanes.composite(simd, runs, segments, &kinds[at], &wanted, settings.background);
            }
        }
        for (index, pass) in passes.iter_mut().enumerate().filter(|(_, pass)| pass.block.count > 0) {
            let errors = pass.block.lanes.errors();
            plan.gather(index, &pass.block, &errors, out);
        }
    }
}

/// The set of groups of `locals`, a bit each.
pub(super) fn group_set(locals: &[u32], groups: usize, seen: &mut Vec<u64>) {
    seen.clear();
    seen.resize(groups.div_ceil(64).max(1), 0);
    locals.iter().for_each(|&local| seen[local as usize / 64] |= 1 << (local % 64));
}
