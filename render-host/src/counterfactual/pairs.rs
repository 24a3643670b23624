//! Synergies: what two groups are worth together beyond the sum of both.

use super::plan::{Block, Plan, run};
use super::{CounterfactualError, Engine, States};

/// Squared errors around one context with one and with two of the chosen groups toggled.
#[derive(Clone, Debug, PartialEq)]
pub struct Pairs {
    /// The chosen groups.
    pub groups: Vec<u32>,
    /// Squared error of the context.
    pub base: f64,
    /// Change of squared error when `groups[i]` is toggled.
    pub single: Vec<f64>,
    /// Change when `groups[i]` and `groups[j]` are toggled, less both single changes; `j < i` at
    /// `i · (i - 1) / 2 + j`.
    pub interaction: Vec<f64>,
}

impl Pairs {
    /// Squared error with `groups[i]` and `groups[j]` toggled; with one toggled when `i == j`.
    pub fn sse(&self, i: usize, j: usize) -> f64 {
        if i == j {
            return self.base + self.single[i];
        }
        self.base + (self.single[i] + self.single[j]) + self.interaction[index(i, j)]
    }
}

/// Place of an unordered pair, `i != j`.
fn index(i: usize, j: usize) -> usize {
    let (low, high) = (i.min(j), i.max(j));
    high * (high - 1) / 2 + low
}

/// Number of pairs of `n`.
fn pairs(n: usize) -> usize {
    n * n.saturating_sub(1) / 2
}

struct Plans<'a> {
    base: &'a [bool],
    /// Place of each group among the chosen.
    place: &'a [Option<u32>],
}

impl Plans<'_> {
    /// Chosen groups of the block, as local indices.
    fn chosen<'b>(&self, block: &'b Block) -> impl Iterator<Item = u32> + use<'b, '_> {
        let place = self.place;
        block.present.iter().copied().filter(move |&l| place[block.groups[l as usize] as usize].is_some())
    }

    /// Chosen groups of a tile.
    fn here(&self, groups: &[u32]) -> Vec<usize> {
        groups.iter().filter_map(|&g| self.place[g as usize].map(|p| p as usize)).collect()
    }
}

impl Plan for Plans<'_> {
    fn size(&self, groups: &[u32]) -> usize {
        let n = self.here(groups).len();
        1 + n + pairs(n)
    }

    fn kinds(&self, groups: usize) -> usize {
        1 + groups + pairs(groups)
    }

    fn lanes(&self, _: usize, block: &mut Block) {
        let chosen: Vec<u32> = self.chosen(block).collect();
        let n = chosen.len();
        block.reset(1 + n + pairs(n));
        for &local in &block.present {
            let held = self.base[block.groups[local as usize] as usize];
            let at = chosen.iter().position(|&c| c == local);
            let except = at.into_iter().flat_map(|i| {
                let pairs = (0..n).filter(move |&j| j != i).map(move |j| 1 + n + index(i, j));
                std::iter::once(1 + i).chain(pairs)
            });
            block.lanes.row_except(local, held, except);
        }
    }

    fn gather(&self, _: usize, block: &Block, errors: &[f64], out: &mut [f64]) {
        let error = |lane: usize| errors[lane];
        // Places of the chosen groups within the tile, as `size` counts them.
        let mut rank = vec![0; block.groups.len()];
        let mut here = 0;
        for (rank, &group) in rank.iter_mut().zip(&block.groups) {
            *rank = here;
            here += usize::from(self.place[group as usize].is_some());
        }
        let chosen: Vec<usize> = self.chosen(block).map(|local| rank[local as usize]).collect();
        let n = chosen.len();
        out[0] += error(0);
        for i in 0..n {
            out[1 + chosen[i]] += error(1 + i) - error(0);
            for j in 0..i {
                let both = error(1 + n + index(i, j)) - error(1 + i) - error(1 + j) + error(0);
                out[1 + here + index(chosen[i], chosen[j])] += both;
            }
        }
    }
}

/// All pairs of `groups` around the one world of `base`.
pub(super) fn around(engine: &Engine, base: &States, groups: &[u32]) -> Result<Pairs, CounterfactualError> {
    let held: Vec<bool> = (0..engine.groups).map(|group| base.has(0, group)).collect();
    let place = engine.places(groups)?;
    let plan = Plans { base: &held, place: &place };
    let sums = run(engine, &plan);
    let n = groups.len();
    let mut out =
        Pairs { groups: groups.to_vec(), base: 0.0, single: vec![0.0; n], interaction: vec![0.0; pairs(n)] };
    for tile in 0..engine.shared.tiles() {
        let here = plan.here(engine.shared.groups(tile));
        let part = sums.tile(tile);
        out.base += part[0];
        for i in 0..here.len() {
            out.single[here[i]] += part[1 + i];
            for j in 0..i {
                out.interaction[index(here[i], here[j])] += part[1 + here.len() + index(i, j)];
            }
        }
    }
    Ok(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn every_pair_has_its_own_place() {
        let mut seen: Vec<usize> = (0..9).flat_map(|i| (0..i).map(move |j| index(j, i))).collect();
        seen.sort_unstable();
        assert_eq!(seen, (0..pairs(9)).collect::<Vec<_>>());
        assert_eq!((pairs(0), pairs(1), index(4, 2)), (0, 0, index(2, 4)));
    }
}
