//! Measures what each group adds in each context: leave one out of those present, add one of those absent.
//!
//! Lanes are the contexts that a tile can tell apart, each as it is and with one of the tile's groups
//! toggled. Their number does not depend on how many groups the scene has.

use super::{
    Engine, States,
    classes::{members, split},
    plan::{Block, LanePlan, Sums, run},
    states::CHUNK,
};

/// Δ_g(m) of all groups g in all contexts m.
#[derive(Clone, Debug, PartialEq)]
pub struct Utilities {
    /// Number of groups.
    pub groups: usize,
    /// Sum of squared errors of each context.
    pub sse: Vec<f64>,
    /// Context by context, group by group: squared error without the group minus with it, all else as in
    /// the context. Above 0 where the group helps.
    pub delta: Vec<f64>,
}

impl Utilities {
    /// Δ_g(m).
    pub fn of(&self, context: usize, group: usize) -> f64 {
        self.delta[context * self.groups + group]
    }

    /// Adds up the numbers of all tiles, in order of tiles.
    fn add_up(engine: &Engine, contexts: usize, sums: &Sums) -> Self {
        let groups = engine.groups;
        let mut out = Self { groups, sse: vec![0.0; contexts], delta: vec![0.0; contexts * groups] };
        for tile in 0..engine.shared.tiles() {
            let here = engine.shared.groups(tile);
            for (context, part) in sums.tile(tile).chunks_exact(here.len() + 1).enumerate() {
                out.sse[context] += part[0];
                for (&group, delta) in here.iter().zip(&part[1..]) {
                    out.delta[context * groups + group as usize] += delta;
                }
            }
        }
        out
    }
}

struct Toggles {
    contexts: usize,
    chunks: Vec<(u128, Vec<u128>)>,
}

impl LanePlan for Toggles {
    fn size(&self, groups: &[u32]) -> usize {
        self.contexts * (groups.len() + 1)
    }

    fn kinds(&self, groups: usize) -> usize {
        groups + 1
    }

    fn passes(&self) -> usize {
        self.chunks.len()
    }

    fn lanes(&self, pass: usize, block: &mut Block) {
        let (contexts, columns) = &self.chunks[pass];
        let column = |local: u32| columns[block.groups[local as usize] as usize];
        split(*contexts, block.present.iter().map(|&local| column(local)), &mut block.classes);
        let each = block.present.len() + 1;
        block.reset(block.classes.len() * each);
        for (i, &local) in block.present.iter().enumerate() {
            let column = columns[block.groups[local as usize] as usize];
            let classes = &block.classes;
            block.lanes.row(local, |lane| (classes[lane / each] & column != 0) != (lane % each == i + 1));
        }
    }

    fn gather(&self, pass: usize, block: &Block, errors: &[f64], out: &mut [f64]) {
        let (stride, each) = (block.groups.len() + 1, block.present.len() + 1);
        let columns = &self.chunks[pass].1;
        for (&class, errors) in block.classes.iter().zip(errors.chunks_exact(each)) {
            let base = errors[0];
            for context in members(class) {
                let out = &mut out[(pass * CHUNK + context) * stride..][..stride];
                out[0] += base;
                for (&local, &error) in block.present.iter().zip(&errors[1..]) {
                    let present = columns[block.groups[local as usize] as usize] & class != 0;
                    let rise = error - base;
                    out[local as usize + 1] += if present { rise } else { -rise };
                }
            }
        }
    }
}

/// All utilities in all contexts.
pub(super) fn utilities(engine: &Engine, contexts: &States) -> Utilities {
    let plan = Toggles { contexts: contexts.len(), chunks: contexts.chunks() };
    Utilities::add_up(engine, contexts.len(), &run(engine, &plan))
}
