//! Refines steps beyond what sensitivity requires, where that costs little.
//!
//! Half the step costs a bit per value only where values spread over many steps. Where an attribute is
//! the same for many Gaussians it costs nothing, and what is gained is more than the share of one value:
//! equal values have equal errors, which add up.

use std::collections::BTreeMap;

use codec_core::internals::quant::Class;

use super::epoch_classes::EpochClasses;
use crate::{
    encode::{
        EncodeError, EncodeOptions, QuantiserSteps, cluster,
        dgs1::{
            indices::{indices, spread_bits},
            rate_estimate::PER_D,
        },
        sensitivity::CLASSES,
        steps::{self, DGS1_MOST_RATIO, Factors, Grid},
    },
    scene::Epoch,
};

/// Finer steps that are tried: thirds of thirds, so that all follow from the finest indices.
const FINER: u32 = 4;
/// Clusters of a class that are looked at, about.
const CLUSTERS: usize = 24;
/// Bits by which a finer step must be better, per value.
const MIN_GAIN: f64 = 0.02;
/// Bits of a run's choice of a table.
const TABLE_INDEX_BITS: f64 = 2.0;
/// Bits that a value of its own in a table takes.
const ENTRY_BITS: f64 = 16.0;

/// Factors on the steps of each class of `classes`, at most 1.
///
/// # Errors
/// Steps that the format does not hold.
pub(super) fn finer(
    epoch: &Epoch,
    classes: &EpochClasses<'_>,
    options: &EncodeOptions,
) -> Result<Vec<Factors>, EncodeError> {
    let positions = epoch.attributes().positions.frame(0, epoch.count());
    let grid = Grid::of(epoch, DGS1_MOST_RATIO);
    let thirds = 3f32.powi(FINER as i32);
    let of_class = |(class_index, quality): (usize, &QuantiserSteps)| {
        let own: Vec<&Vec<u32>> = classes.sets.iter().filter(|set| classes.of(set) == class_index).collect();
        let quality = quality.scaled(1.0 / thirds);
        let plain = [false; Class::COUNT + Class::MOVING];
        let quant = steps::dgs1(&quality, &grid, 1, &plain, &[false; Class::COUNT])?;
        // Values by class and component, blocks one after the other.
        let mut values: Vec<Vec<Vec<i32>>> =
            Class::ALL.map(|class| vec![Vec::new(); class.components()]).to_vec();
        for set in own.iter().step_by((own.len() / CLUSTERS).max(1)) {
            let set = cluster::block_order(set, positions, options.block_len);
            // Whole blocks, so that the next cluster's begin where one ends.
            let rest = if set.len() < options.block_len { 0 } else { set.len() % options.block_len };
            let found = indices(epoch, &set[..set.len() - rest], &quant, grid.origin);
            for (all, found) in values.iter_mut().zip(found) {
                all.iter_mut().zip(found).for_each(|(all, found)| all.extend(found));
            }
        }
        let mut factors: Factors = [1.0; CLASSES];
        for (c, factor) in factors.iter_mut().enumerate() {
            let components = || values.iter().skip(c).take(if c + 1 == CLASSES { 3 } else { 1 }).flatten();
            let count = components().map(Vec::len).sum::<usize>() as f64;
            let mut best = f64::INFINITY;
            for finer in 0..=FINER {
                let ratio = 3i32.pow(FINER - finer);
                let bits: f64 = components().map(|values| bits(values, ratio, options.block_len)).sum();
                let cost = bits / count.max(1.0) + PER_D * 9f64.powi(-(finer as i32));
                if cost + MIN_GAIN < best {
                    (best, *factor) = (cost, 3f32.powi(-(finer as i32)));
                }
            }
        }
        Ok(factors)
    };
    classes.qualities.iter().enumerate().map(of_class).collect()
}

/// Bits of `values` over `ratio`, rounded: the base by its spread within blocks or by a table of it,
/// then a third of a step per level by the entropy of each run.
fn bits(values: &[i32], ratio: i32, block_len: usize) -> f64 {
    let third = |q: i32, by: i32| (q + q.signum() * (by / 2)) / by;
    let mut q: Vec<i32> = values.iter().map(|&q| third(q, ratio)).collect();
    let mut sum = 0.0;
    for _ in 0..3 {
        for run in q.chunks_mut(block_len) {
            let mut counts = [0u32; 3];
            for q in run.iter_mut() {
                let coarse = third(*q, 3);
                counts[(*q - 3 * coarse + 1).clamp(0, 2) as usize] += 1;
                *q = coarse;
            }
            let n = run.len() as f64;
            let entropy = |c: u32| if c == 0 { 0.0 } else { f64::from(c) * (n / f64::from(c)).log2() };
            sum += n.min(TABLE_INDEX_BITS) + counts.into_iter().map(entropy).sum::<f64>();
        }
    }
    let mut counts: BTreeMap<i32, f64> = BTreeMap::new();
    q.iter().for_each(|&q| *counts.entry(q).or_default() += 1.0);
    let n = q.len() as f64;
    let table: f64 = counts.into_values().map(|c| c * (n / c).log2() + ENTRY_BITS).sum();
    sum + spread_bits(&q, block_len).min(table)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode::quantiser_class::QuantiserClasses,
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        scene::{Attributes, Scene, Track},
    };

    fn noise(n: usize, span: i32) -> Vec<i32> {
        (0..n as i32)
            .map(|i| (i.wrapping_mul(7919) ^ i.wrapping_mul(104_729) >> 3).rem_euclid(2 * span + 1) - span)
            .collect()
    }

    #[test]
    fn a_third_of_a_step_costs_its_logarithm_where_values_spread_and_nothing_where_they_do_not() {
        let values = noise(4096, 40_000);
        let each = |ratio| bits(&values, ratio, 64) / 4096.0;
        assert!((each(3) - each(9) - 3f64.log2()).abs() < 0.1, "{} {}", each(3), each(9));
        // The same for all: no bits but choices of tables, at any step.
        let same = vec![12_345; 4096];
        assert!(bits(&same, 3, 64) - bits(&same, 81, 64) < 1.0);
        assert!(bits(&same, 3, 64) < 0.2 * 4096.0);
        // By block: only the base differs.
        let blocks: Vec<i32> = (0..4096).map(|i| i / 64 * 10_007).collect();
        assert!(bits(&blocks, 1, 64) < 0.5 * 4096.0);
    }

    #[test]
    fn attributes_that_are_alike_get_finer_steps_and_others_do_not() {
        let options =
            synth::SynthOptions { gaussians: 2000, frames: 1, kind: SynthKind::Cloth, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let epoch = &scene.epochs()[0];
        let n = epoch.count();
        let attributes = Attributes {
            opacity_logits: Track::Constant(vec![2.0; n]),
            sh0: Track::Constant(
                noise(3 * n, 1000).chunks(3).map(|c| [c[0], c[1], c[2]].map(|v| v as f32 * 1e-3)).collect(),
            ),
            ..epoch.attributes().clone()
        };
        let scene = Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap();
        let options = EncodeOptions::default();
        let classes = QuantiserClasses::one(&scene, &options).unwrap();
        let steps = classes.of_epoch(0, &QuantiserSteps::default()).qualities[0];
        assert!(steps.opacity < 0.2 * QuantiserSteps::default().opacity, "{steps:?}");
        assert_eq!(steps.sh0, QuantiserSteps::default().sh0);
    }
}
