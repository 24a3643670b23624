//! Delivery order: groups arrive one by one; the squared error after each.
//!
//! A tile changes only when one of its groups arrives, so its lanes are its groups in order of arrival.

use super::plan::{Block, Plan, run};
use super::{CounterfactualError, Engine, States};

struct Arrivals<'a> {
    base: &'a [bool],
    /// When each group arrives.
    place: &'a [Option<u32>],
}

impl Arrivals<'_> {
    /// When local group `local` arrives; after all others when never, and first when it is there already.
    fn when(&self, block: &Block, local: u32) -> u32 {
        let group = block.groups[local as usize] as usize;
        if self.base[group] { 0 } else { self.place[group].map_or(u32::MAX, |at| at + 1) }
    }
}

impl Plan for Arrivals<'_> {
    fn size(&self, groups: &[u32]) -> usize {
        1 + groups.len()
    }

    fn kinds(&self, groups: usize) -> usize {
        groups + 1
    }

    fn lanes(&self, _: usize, block: &mut Block) {
        let mut present = std::mem::take(&mut block.present);
        present.sort_by_key(|&local| self.when(block, local));
        let here = |&&local: &&u32| self.when(block, local) == 0;
        let first = present.iter().take_while(here).count();
        let past = present.iter().take_while(|&&local| self.when(block, local) < u32::MAX).count();
        block.reset(1 + past - first);
        for (i, &local) in present.iter().enumerate() {
            block.lanes.row(local, |lane| i < first + lane);
        }
        block.present = present;
    }

    fn gather(&self, _: usize, block: &Block, errors: &[f64], out: &mut [f64]) {
        let arriving = block.present.iter().skip_while(|&&local| self.when(block, local) == 0);
        out[0] += errors[0];
        for (&local, pair) in arriving.zip(errors.windows(2)) {
            out[local as usize + 1] += pair[1] - pair[0];
        }
    }
}

/// Squared error of the one world of `base`, and after each group of `order` has come.
pub(super) fn along(engine: &Engine, base: &States, order: &[u32]) -> Result<Vec<f64>, CounterfactualError> {
    let held: Vec<bool> = (0..engine.groups).map(|group| base.has(0, group)).collect();
    let place = engine.places(order)?;
    let plan = Arrivals { base: &held, place: &place };
    let sums = run(engine, &plan);
    let mut steps = vec![0.0; order.len() + 1];
    for tile in 0..engine.shared.tiles() {
        let part = sums.tile(tile);
        steps[0] += part[0];
        for (&group, step) in engine.shared.groups(tile).iter().zip(&part[1..]) {
            if let Some(at) = place[group as usize] {
                steps[at as usize + 1] += step;
            }
        }
    }
    let mut sum = 0.0;
    steps.iter_mut().for_each(|step| {
        sum += *step;
        *step = sum;
    });
    Ok(steps)
}
