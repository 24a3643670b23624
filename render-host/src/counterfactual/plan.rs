//! Walks tiles and their blocks for a fast mode, which says what the lanes are and where errors go.

use super::Engine;
use super::classes::members;
use super::lanes::Lanes;
use super::runs::Runs;
use crate::parallel;

/// Side of a block, pixels. Small blocks meet few groups, so worlds fall into few classes.
const BLOCK: usize = 4;

/// A fast mode.
pub(super) trait Plan: Sync {
    /// Numbers kept per tile that meets `groups`.
    fn size(&self, groups: &[u32]) -> usize;

    /// Passes over every block; each makes its own lanes.
    fn passes(&self) -> usize {
        1
    }

    /// Sets up the lanes of pass `pass` for a block that meets `block.present`; how many is its choice,
    /// and 0 skips the block.
    fn lanes(&self, pass: usize, block: &mut Block);

    /// Adds the errors of the lanes to the tile's numbers.
    fn gather(&self, pass: usize, block: &Block, out: &mut [f64]);
}

/// What a plan sees of a block of pixels.
#[derive(Debug, Default)]
pub(super) struct Block {
    /// Group of each local index of the tile.
    pub groups: Vec<u32>,
    /// Local indices of the groups that touch the block.
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
struct Room {
    runs: Runs,
    block: Block,
    seen: Vec<u64>,
    before: Vec<u64>,
}

/// Runs `plan` over all tiles.
pub(super) fn run(engine: &Engine, plan: &impl Plan) -> Sums {
    let shared = &engine.shared;
    let mut starts = vec![0];
    let mut end = 0;
    for tile in 0..shared.tiles() {
        end += plan.size(shared.groups(tile));
        starts.push(end);
    }
    let mut sums = Sums { values: vec![0.0; end], starts };
    rerun(engine, plan, |_| true, &mut sums);
    sums
}

/// Runs `plan` again over the tiles for which `wanted` says so. Returns how many.
pub(super) fn rerun(
    engine: &Engine,
    plan: &impl Plan,
    wanted: impl Fn(usize) -> bool,
    sums: &mut Sums,
) -> usize {
    let Sums { values, starts } = sums;
    let mut rest = values.as_mut_slice();
    let mut work = Vec::new();
    for (tile, bounds) in starts.windows(2).enumerate() {
        let (own, after) = rest.split_at_mut(bounds[1] - bounds[0]);
        rest = after;
        if wanted(tile) {
            work.push((tile, own));
        }
    }
    parallel::for_each_with(engine.settings.parallel, &mut work, |room: &mut Room, _, (tile, out)| {
        room.tile(engine, plan, *tile, out)
    });
    work.len()
}

impl Room {
    fn tile(&mut self, engine: &Engine, plan: &impl Plan, tile: usize, out: &mut [f64]) {
        let Self { runs, block, seen, before } = self;
        out.fill(0.0);
        runs.fill(&engine.shared, tile, &engine.settings);
        block.groups.clear();
        block.groups.extend_from_slice(engine.shared.groups(tile));
        let reference = &engine.reference[tile];
        let (width, height) = runs.inside;
        for pass in 0..plan.passes() {
            let mut fresh = true;
            for y in (0..height).step_by(BLOCK) {
                for x in (0..width).step_by(BLOCK) {
                    let range = [x..(x + BLOCK).min(width), y..(y + BLOCK).min(height)];
                    std::mem::swap(seen, before);
                    look(runs, &range, block.groups.len(), seen);
                    if fresh || seen != before {
                        block.present.clear();
                        block.present.extend(bits(seen));
                        plan.lanes(pass, block);
                        fresh = false;
                    }
                    if block.count > 0 {
                        block.lanes.composite(runs, range, reference, engine.settings.background);
                        plan.gather(pass, block, out);
                    }
                }
            }
        }
    }
}

/// The set of groups that touch the pixels of `range`, a bit per local index.
fn look(runs: &Runs, range: &[std::ops::Range<usize>; 2], groups: usize, seen: &mut Vec<u64>) {
    seen.clear();
    seen.resize(groups.div_ceil(64), 0);
    for y in range[1].clone() {
        for x in range[0].clone() {
            for run in runs.at(x, y) {
                seen[run.local as usize / 64] |= 1 << (run.local % 64);
            }
        }
    }
}

fn bits(words: &[u64]) -> impl Iterator<Item = u32> + '_ {
    let of = |(i, &word): (usize, &u64)| members(u128::from(word)).map(move |bit| (64 * i + bit) as u32);
    words.iter().enumerate().flat_map(of)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::TILE;

    #[test]
    fn bits_count_over_words() {
        assert_eq!(bits(&[1 << 63 | 2, 0, 1]).collect::<Vec<_>>(), [1, 63, 128]);
    }

    #[test]
    fn blocks_fill_a_tile() {
        assert_eq!(TILE % BLOCK, 0);
    }
}
