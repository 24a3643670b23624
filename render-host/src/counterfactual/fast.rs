//! Adds up squared errors of whole worlds, a lane for each class of worlds that a tile can tell apart.

use super::{
    Engine, States,
    classes::{members, split},
    plan::{Block, LanePlan, run},
    states::CHUNK,
};

/// All worlds: a lane per class that a tile can tell apart.
pub(super) struct Worlds {
    count: usize,
    chunks: Vec<(u128, Vec<u128>)>,
}

impl Worlds {
    pub(super) fn new(states: &States) -> Self {
        Self { count: states.len(), chunks: states.chunks() }
    }
}

impl LanePlan for Worlds {
    fn size(&self, _: &[u32]) -> usize {
        self.count
    }

    fn kinds(&self, groups: usize) -> usize {
        1.75f32.powi(groups.min(9) as i32) as usize
    }

    fn passes(&self) -> usize {
        self.chunks.len()
    }

    fn lanes(&self, pass: usize, block: &mut Block) {
        let (worlds, columns) = &self.chunks[pass];
        let column = |local: u32| columns[block.groups[local as usize] as usize];
        split(*worlds, block.present.iter().map(|&local| column(local)), &mut block.classes);
        block.reset(block.classes.len());
        for &local in &block.present {
            let column = columns[block.groups[local as usize] as usize];
            block.lanes.row(local, |lane| block.classes[lane] & column != 0);
        }
    }

    fn gather(&self, pass: usize, block: &Block, errors: &[f64], out: &mut [f64]) {
        let out = &mut out[pass * CHUNK..];
        for (&class, &error) in block.classes.iter().zip(errors) {
            members(class).for_each(|world| out[world] = error);
        }
    }
}

/// Sum of squared errors of each world.
pub(super) fn errors(engine: &Engine, states: &States) -> Vec<f64> {
    let plan = Worlds::new(states);
    let sums = run(engine, &plan);
    let mut out = vec![0.0; states.len()];
    for tile in 0..engine.shared.tiles() {
        out.iter_mut().zip(sums.tile(tile)).for_each(|(total, part)| *total += part);
    }
    out
}
