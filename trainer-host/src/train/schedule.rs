//! A schedule says what applies at each share of the training: sizes, rates, numbers of nodes.

use serde::{Deserialize, Serialize};

use super::{gaussians::AttributeRates, options::Options};

/// Share of the training in which only views near the canonical instant are used, and nothing moves.
pub(super) const STILL: f64 = 0.03;
/// Share after it over which the span of time grows to all of the clip.
const GROWTH: f64 = 0.12;
/// Share after which Gaussians are neither added nor removed.
pub(super) const DENSITY_END: f64 = 0.6;

/// How the photographs shrink for a part of the training.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Sizes(Vec<u32>);

impl Sizes {
    /// The reductions (a divisor each, coarsest first, 1 last) that divide `common`, which divides every side,
    /// and leave the shortest side 64 pixels at least.
    pub(super) fn of(common: u32, shortest: u32) -> Self {
        let fits = |by: &u32| common.is_multiple_of(*by) && shortest / by >= 64;
        let mut divisors: Vec<u32> = [8, 4, 2].into_iter().filter(fits).collect();
        divisors.push(1);
        Self(divisors)
    }

    pub(super) fn divisors(&self) -> &[u32] {
        &self.0
    }

    /// Index of the reduction that applies.
    pub(super) fn at(&self, progress: f64) -> usize {
        // Shares of the training after which each size but the last is done.
        let ends: &[f64] = match self.0.len() {
            0 | 1 => &[],
            2 => &[0.3],
            3 => &[0.12, 0.42],
            _ => &[0.10, 0.32, 0.6],
        };
        ends.iter().filter(|&&end| progress >= end).count()
    }
}

/// Largest distance in time from the canonical instant of a view that is used.
pub(super) fn time_span(progress: f64) -> f32 {
    let grown = ((progress - STILL) / GROWTH).clamp(0.0, 1.0);
    (f64::from(super::start::HULL_TIME) + grown) as f32
}

/// Numbers of nodes and the shares of the training at which they take over.
pub(super) fn node_stages(nodes: usize) -> Vec<(f64, usize)> {
    if nodes == 0 {
        return Vec::new();
    }
    let stages = [(STILL, (nodes / 16).max(8)), (0.10, (nodes / 4).max(8)), (0.22, nodes)];
    stages.map(|(from, count)| (from, count.min(nodes))).into()
}

/// Number of Gaussians to have.
pub(super) fn gaussians(options: &Options, progress: f64) -> usize {
    let (from, to) = (options.initial_gaussians as f64, options.max_gaussians as f64);
    let grown = ((progress - 0.02) / (0.8 * DENSITY_END)).clamp(0.0, 1.0);
    (from + (to - from) * grown).max(0.0) as usize
}

/// From 1 to `end` in equal ratios.
fn decay(progress: f64, end: f64) -> f32 {
    end.powf(progress) as f32
}

/// Rates of the Gaussians' attributes; `extent` is the scene's, scene units.
pub(super) fn attribute_rates(options: &Options, progress: f64, extent: f32) -> AttributeRates {
    let (slow, fast) = (decay(progress, 0.1), decay(progress, 0.02));
    let rates = &options.rates;
    AttributeRates {
        position: rates.position * extent * fast,
        log_scale: rates.log_scale * slow,
        rotation: rates.rotation * slow,
        opacity: rates.opacity * slow,
        sh0: rates.sh0 * slow,
        sh_rest: rates.sh_rest * slow,
        skin: rates.skin * slow,
    }
}

/// Rate of the nodes' motion.
pub(super) fn node_rate(options: &Options, progress: f64) -> f32 {
    options.rates.node_motion * decay(progress, 0.02)
}

/// Weight of rigidity.
pub(super) fn rigidity(options: &Options, progress: f64) -> f32 {
    options.rigidity * ((1.0 - progress).max(0.05)) as f32
}
