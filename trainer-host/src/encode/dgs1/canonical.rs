//! Quantises canonical attributes to nested symbols.

use std::num::NonZero;

use codec_core::internals::{
    ids::Level,
    layout::Shape,
    quant::Class,
    wire::manifest::{self, Cluster, Quant},
};
use rayon::prelude::*;

use super::{
    super::{
        EncodeError, EncodeOptions, QuantiserSteps,
        decisions::{ClusterDecisions, EpochDecisions},
        packetise::CellSymbols,
        quantiser_class::EpochClasses,
        steps::{self, Grid},
    },
    indices::{Indices, indices, split, spread_bits},
    pruning,
};
use crate::scene::Epoch;

/// The canonical cells of an epoch.
pub(super) struct Canonical {
    pub origin: [f32; 3],
    pub cells: Vec<CellSymbols>,
    pub saturated: u64,
}

/// The quantisers of each quantiser class of an epoch with nothing predicted, its Gaussians in `sets` of
/// blocks, and its grid.
pub(super) fn plain(
    epoch: &Epoch,
    sets: &[Vec<u32>],
    classes: &EpochClasses<'_>,
    options: &EncodeOptions,
) -> Result<(Vec<Quant>, Grid), EncodeError> {
    let grid = Grid::of(epoch, steps::DGS1_MOST_RATIO);
    let of_class = |(class_index, quality): (usize, &QuantiserSteps)| {
        let quant = |decorrelated: [bool; Class::COUNT]| {
            let predicted = [false; Class::COUNT + Class::MOVING];
            steps::dgs1(quality, &grid, epoch.frames(), &predicted, &decorrelated)
        };
        let sets: Vec<&Vec<u32>> = sets.iter().filter(|set| classes.of(set) == class_index).collect();
        // What the spread of the indices within their blocks costs, per class.
        let bits = |quant: &Quant| -> [f64; Class::COUNT] {
            let each = |set: &&Vec<u32>| {
                let indices = indices(epoch, set, quant, grid.origin);
                indices.map(|class| class.iter().map(|q| spread_bits(q, options.block_len)).sum::<f64>())
            };
            let each: Vec<[f64; Class::COUNT]> = sets.par_iter().map(each).collect();
            Class::ALL.map(|class| each.iter().map(|bits| bits[class.index()]).sum())
        };
        let plain = bits(&quant([false; Class::COUNT])?);
        let decorrelated = bits(&quant(Class::ALL.map(Class::decorrelates))?);
        let values = sets.iter().map(|set| set.len()).sum::<usize>() as f64;
        let pays = Class::ALL.map(|class| {
            let margin = MIN_GAIN * values * class.components() as f64;
            class.decorrelates() && decorrelated[class.index()] + margin < plain[class.index()]
        });
        quant(pays)
    };
    let quants: Result<Vec<Quant>, EncodeError> =
        classes.qualities.iter().enumerate().map(of_class).collect();
    Ok((quants?, grid))
}

/// Bits per value that decorrelating must save: sums of independent values are closer to their mean than the
/// values, for what they cost.
const MIN_GAIN: f64 = 0.1;

/// What is decided of an epoch's canonical cells: quantisers, clusters, origin.
pub(super) type Decided = (Vec<Quant>, Vec<ClusterDecisions>, [f32; 3]);

/// Chooses the quantisers of each class of `classes`, and with which of them and up to which harmonic degree
/// each cluster of `members` is sent. Also gives the epoch's origin.
pub(super) fn decide(
    epoch: &Epoch,
    members: Vec<Vec<u32>>,
    classes: &EpochClasses<'_>,
    options: &EncodeOptions,
) -> Result<Decided, EncodeError> {
    let (unpredicted, grid) = plain(epoch, &members, classes, options)?;
    let mut quants = Vec::new();
    let mut degrees = vec![0u8; members.len()];
    for (class_index, (plain, quality)) in unpredicted.iter().zip(&classes.qualities).enumerate() {
        let places: Vec<usize> =
            (0..members.len()).filter(|&k| classes.of(&members[k]) == class_index).collect();
        let indices: Vec<Indices> =
            places.par_iter().map(|&k| indices(epoch, &members[k], plain, grid.origin)).collect();
        let mut predicted = [false; Class::COUNT + Class::MOVING];
        predicted[Class::COUNT..].fill(true);
        for class in Class::ALL {
            predicted[class.index()] = prediction_pays(&indices, class, plain, options.block_len);
        }
        let decorrelated = plain.canonical.map(|quantiser| quantiser.decorrelated());
        quants.push(steps::dgs1(quality, &grid, epoch.frames(), &predicted, &decorrelated)?);
        let found = pruning::degrees(&indices, epoch.attributes().sh_degree.get());
        for (&k, degree) in places.iter().zip(found) {
            degrees[k] = degree;
        }
    }
    let decide = |(gaussians, harmonic_degree): (Vec<u32>, u8)| ClusterDecisions {
        quantisers: classes.of(&gaussians),
        harmonic_degree,
        highest_level: 3,
        gaussians,
        table_indices: Default::default(),
    };
    Ok((quants, members.into_iter().zip(degrees).map(decide).collect(), grid.origin))
}

/// Quantises frame 0 of `epoch` as `decisions` say; `quants` are their quantisers. Every level is there.
pub(super) fn quantise(
    epoch: &Epoch,
    decisions: &EpochDecisions,
    quants: &[Quant],
    block_len: usize,
) -> codec_core::Result<Canonical> {
    let block_len = manifest::block_len(block_len as u64)?;
    let quantised: Vec<(CellSymbols, u64)> = decisions
        .clusters
        .par_iter()
        .map(|cluster| {
            let quant = &quants[cluster.quantisers];
            let indices = indices(epoch, &cluster.gaussians, quant, decisions.origin);
            cell(&indices, quant, cluster.harmonic_degree, block_len)
        })
        .collect();
    let saturated = quantised.iter().map(|(_, saturated)| saturated).sum();
    let cells = quantised.into_iter().map(|(cell, _)| cell).collect();
    Ok(Canonical { origin: decisions.origin, cells, saturated })
}

/// Whether differences to the Gaussian before are smaller than the values themselves.
fn prediction_pays(clusters: &[Indices], class: Class, quant: &Quant, block_len: usize) -> bool {
    let quantiser = quant.canonical[class.index()];
    let bits = |v: i32| (1.0 + 2.0 * f64::from(v.unsigned_abs())).log2();
    let (mut plain, mut differences) = (0.0, 0.0);
    for component in clusters.iter().flat_map(|c| &c[class.index()]) {
        for block in component.chunks(block_len) {
            let mut previous = 0;
            for &q in block {
                let q = split(&quantiser, class, q)[class.first_level().index()];
                plain += bits(q);
                differences += bits(q.saturating_sub(previous));
                previous = q;
            }
        }
    }
    class == Class::Position || differences < plain
}

fn cell(indices: &Indices, quant: &Quant, sh_degree: u8, block_len: NonZero<u32>) -> (CellSymbols, u64) {
    let position = quant.canonical[Class::Position.index()];
    let base = |component: usize| -> Vec<i32> {
        indices[0][component].iter().map(|&q| split(&position, Class::Position, q)[0]).collect()
    };
    let base = [base(0), base(1), base(2)];
    let n = base[0].len();
    let centre = [0, 1, 2].map(|d| {
        let sum: i64 = base[d].iter().map(|&q| i64::from(q)).sum();
        (sum as f64 / n.max(1) as f64).round() as i16
    });
    let radius2 = (0..n)
        .map(|i| (0..3).map(|d| (f64::from(base[d][i]) - f64::from(centre[d])).powi(2)).sum::<f64>())
        .fold(0.0f64, f64::max);
    let cluster = Cluster {
        gaussians: n as u16,
        quant: 0,
        kind: Cluster::kind_of(sh_degree, Level::ALL[3]),
        centre_x: centre[0],
        centre_y: centre[1],
        centre_z: centre[2],
        radius: radius2.sqrt().ceil().clamp(1.0, 65_535.0) as u16,
    };
    let shape = Shape::dgs1(cluster, *quant, None, 0, block_len);
    let mut levels: [Vec<i16>; Level::COUNT] = Default::default();
    let mut saturated = 0;
    for level in Level::ALL {
        let out = &mut levels[level.index()];
        out.reserve(shape.level_len(level));
        for block in 0..shape.blocks() {
            let first = shape.first_of(block);
            let range = first..first + shape.block_gaussians(block);
            for (class, _, dims) in shape.components(level) {
                let quantiser = quant.canonical[class.index()];
                for d in 0..dims {
                    let start = if class == Class::Position { i32::from(centre[d]) } else { 0 };
                    let mut previous = start;
                    for &q in &indices[class.index()][d][range.clone()] {
                        let symbols = split(&quantiser, class, q);
                        let mut symbol = symbols[level.index()];
                        if level == class.first_level() {
                            symbol -= previous;
                            if quantiser.predicted() {
                                previous = symbols[level.index()];
                            }
                        }
                        out.push(to_symbol(symbol, &mut saturated));
                    }
                }
            }
        }
    }
    (CellSymbols { shape, levels, table_indices: Default::default() }, saturated)
}

/// `value` as a symbol; what does not fit is clamped and counted.
pub(super) fn to_symbol(value: i32, saturated: &mut u64) -> i16 {
    i16::try_from(value).unwrap_or_else(|_| {
        *saturated += 1;
        if value < 0 { i16::MIN } else { i16::MAX }
    })
}
