//! Draws contexts, and of each state that differs from its context in one cluster only what differs.
//!
//! A tile meets few clusters, and only their versions can change it. Alphas of all versions are computed
//! once per block of pixels for all contexts; a version that leaves a block as it is leaves no patch.

use pulp::Simd;

use super::{
    Engine, Versions,
    culling::{BLOCKS, TileCulling},
    lanes::Lanes,
    plan::{Pass, group_set},
    segments::NONE,
    splat_runs::SplatRuns,
    squares::{inside, within},
    strict::over,
    tree::Tree,
};
use crate::{
    parallel,
    stage::{TILE, blend},
};

/// r, g, b of the sixteen pixels of a block, over the background.
pub(super) type Pixels = [blend::Lanes; 3];

/// A block that differs from the context's.
#[derive(Clone, Copy, Debug)]
pub(super) struct Patch {
    /// Context of the batch times the number of groups, plus the group that is shown instead.
    pub world: u32,
    /// Block of the tile.
    pub block: u32,
    /// Place in [`Changes::pixels`].
    pub pixels: u32,
}

/// What a tile shows.
#[derive(Clone, Debug, Default)]
pub(super) struct Changes {
    /// Context by context, block by block.
    base: Vec<Pixels>,
    /// In order of blocks.
    pub patches: Vec<Patch>,
    pub pixels: Vec<Pixels>,
}

impl Changes {
    /// Blocks of a context.
    pub(super) fn base(&self, context: usize) -> &[Pixels] {
        &self.base[context * BLOCKS..(context + 1) * BLOCKS]
    }
}

/// Draws every tile.
pub(super) fn draw(engine: &Engine, versions: &Versions, contexts: &[Vec<u32>]) -> Vec<Changes> {
    let mut out = vec![Changes::default(); engine.shared.tiles()];
    parallel::for_each_with(engine.settings.parallel, &mut out, |scratch: &mut TileScratch, tile, out| {
        pulp::Arch::new().dispatch(Draw { scratch, engine, versions, contexts, tile, out });
    });
    out
}

/// The states that a tile can tell apart, each a lane: every context, followed by its toggled versions.
#[derive(Default)]
struct Toggles {
    /// Context of each lane.
    contexts: Vec<u32>,
    /// Group that each lane shows instead of the context's, or [`NONE`].
    groups: Vec<u32>,
    /// Cluster of that group, or [`NONE`].
    clusters: Vec<u32>,
    /// First lane of each context, then the number of lanes.
    starts: Vec<usize>,
    /// Clusters of the tile.
    present: Vec<u32>,
}

impl Toggles {
    /// Lists the states of a tile that meets `groups`.
    fn list(&mut self, groups: &[u32], versions: &Versions, contexts: &[Vec<u32>]) {
        self.present.clear();
        self.present.extend(groups.iter().map(|&group| versions.of(group).0));
        self.present.sort_unstable();
        self.present.dedup();
        self.contexts.clear();
        self.groups.clear();
        self.clusters.clear();
        self.starts.clear();
        for (context, shown) in (0..).zip(contexts) {
            self.starts.push(self.groups.len());
            self.groups.push(NONE);
            self.clusters.push(NONE);
            for &cluster in &self.present {
                for version in 0..versions.count(cluster as usize) {
                    if version != shown[cluster as usize] as usize {
                        self.groups.push(versions.group(cluster as usize, version) as u32);
                        self.clusters.push(cluster);
                    }
                }
            }
            self.contexts.resize(self.groups.len(), context);
        }
        self.starts.push(self.groups.len());
    }

    /// Says for every lane which groups of the tile it holds.
    fn fill(&self, groups: &[u32], versions: &Versions, contexts: &[Vec<u32>], lanes: &mut Lanes) {
        for (local, &group) in (0..).zip(groups) {
            let (cluster, version) = versions.of(group);
            lanes.row(local, |lane| {
                if self.clusters[lane] == cluster {
                    return self.groups[lane] == group;
                }
                contexts[self.contexts[lane] as usize][cluster as usize] == version
            });
        }
    }
}

/// What a thread keeps from tile to tile.
#[derive(Default)]
struct TileScratch {
    culling: TileCulling,
    runs: SplatRuns,
    pass: Pass,
    seen: Vec<u64>,
    tree: Tree,
    toggles: Toggles,
    /// What each kind of lane shows, and its place in the tile's pixels.
    shown: Vec<(Pixels, u32)>,
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct Draw<'a> {
    scratch: &'a mut TileScratch,
    engine: &'a Engine,
    versions: &'a Versions,
    contexts: &'a [Vec<u32>],
    tile: usize,
    out: &'a mut Changes,
}

impl pulp::WithSimd for Draw<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { scratch, engine, versions, contexts, tile, out } = self;
        let TileScratch { culling, runs, pass, seen, tree, toggles, shown } = scratch;
        let (shared, settings) = (&engine.shared, &engine.settings);
        let groups = shared.groups(tile);
        toggles.list(groups, versions, contexts);
        pass.start(groups);
        pass.block.reset(toggles.groups.len());
        toggles.fill(groups, versions, contexts, &mut pass.block.lanes);
        culling.fill(shared, tile, settings);
        out.base.resize(contexts.len() * BLOCKS, [[0.0; TILE]; 3]);
        let size = inside(shared.corner(tile), shared.size);
        for block in (0..BLOCKS).filter(|&block| within(block, size)) {
            runs.find(culling, block, settings);
            group_set(&runs.locals, groups.len(), seen);
            let at = pass.find_kinds(seen);
            let kinds = &pass.kinds[at];
            tree.walk(simd, culling, runs, &pass.block.lanes, &kinds.first, settings.closed_below());
            shown.clear();
            shown.extend(tree.found.iter().map(|found| (over(found, settings.background), NONE)));
            for (context, lanes) in toggles.starts.windows(2).enumerate() {
                let base = shown[kinds.of[lanes[0]] as usize].0;
                out.base[context * BLOCKS + block] = base;
                for lane in lanes[0] + 1..lanes[1] {
                    let (pixels, place) = &mut shown[kinds.of[lane] as usize];
                    if is_same(pixels, &base) {
                        continue;
                    }
                    if *place == NONE {
                        *place = out.pixels.len() as u32;
                        out.pixels.push(*pixels);
                    }
                    let world = (context * versions.groups()) as u32 + toggles.groups[lane];
                    out.patches.push(Patch { world, block: block as u32, pixels: *place });
                }
            }
        }
    }
}

/// Whether two blocks are equal bit for bit.
#[inline(always)]
fn is_same(a: &Pixels, b: &Pixels) -> bool {
    let mut differ = 0;
    for (a, b) in a.as_flattened().iter().zip(b.as_flattened()) {
        differ |= a.to_bits() ^ b.to_bits();
    }
    differ == 0
}
