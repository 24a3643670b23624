//! A schedule says what applies at each share of the training: sizes, rates, numbers of nodes.

use codec_core::ShDegree;
use serde::{Deserialize, Serialize};

use super::{
    gaussians::AttributeRates,
    options::{Schedule, TrainOptions},
};

/// Shortest side of reduced photographs, pixels.
pub(super) const MIN_SIDE: u32 = 64;

/// Functions of the spline that comes at [`Schedule::fine_time`].
const FINE_TIME: usize = 32;
/// Functions of the spline that comes at [`Schedule::finest_time`].
const FINEST_TIME: usize = 64;
/// Different times of photographs that each function of the finest spline needs: with fewer it would follow
/// single photographs.
const INSTANTS_PER_FUNCTION: usize = 2;

/// How the photographs shrink for a part of the training.
#[derive(Clone, Debug, PartialEq, Eq, Serialize, Deserialize)]
pub(super) struct Sizes(Vec<u32>);

impl Sizes {
    /// The reductions (a divisor each, coarsest first, 1 last) that divide `common`, which divides every
    /// side, and leave the shortest side 64 pixels at least.
    pub(super) fn of(common: u32, shortest: u32) -> Self {
        let fits = |by: &u32| common.is_multiple_of(*by) && shortest / by >= MIN_SIDE;
        let mut divisors: Vec<u32> = [8, 4, 2].into_iter().filter(fits).collect();
        divisors.push(1);
        Self(divisors)
    }

    pub(super) fn divisors(&self) -> &[u32] {
        &self.0
    }

    /// Index of the reduction that applies.
    pub(super) fn at(&self, schedule: &Schedule, progress: f64) -> usize {
        let last = (self.0.len() - 1).min(schedule.sizes.len());
        let ends = &schedule.sizes[..last];
        ends.iter().filter(|&&end| progress >= end).count()
    }
}

/// Largest distance in time from the canonical instant of a view that is used.
pub(super) fn time_span(schedule: &Schedule, progress: f64) -> f32 {
    let grown = ((progress - schedule.still) / schedule.growth.max(1e-9)).clamp(0.0, 1.0);
    (f64::from(super::start::HULL_TIME) + grown) as f32
}

/// Numbers of nodes of the layers and the shares of the training at which they begin.
pub(super) fn node_stages(options: &TrainOptions) -> Vec<(f64, usize)> {
    let (nodes, schedule) = (options.nodes, &options.schedule);
    if nodes == 0 {
        return Vec::new();
    }
    let stages = [
        (schedule.still, (nodes / 16).max(8)),
        (schedule.quarter_of_nodes, (nodes / 4).max(8)),
        (schedule.all_nodes, nodes),
    ];
    stages.map(|(from, count)| (from, count.min(nodes))).into()
}

/// Functions over time that the finest spline of nodes must have by now, where training photographs have
/// `instants` different times; 0: those that nodes begin with are enough.
pub(super) fn finest_spline(schedule: &Schedule, progress: f64, instants: usize) -> usize {
    let has_begun = |from: f64| (from..1.0).contains(&progress);
    if has_begun(schedule.finest_time) && instants >= INSTANTS_PER_FUNCTION * FINEST_TIME {
        FINEST_TIME
    } else if has_begun(schedule.fine_time) {
        FINE_TIME
    } else {
        0
    }
}

/// Shares of the training at which Gaussians that hardly move are stood still.
pub(super) fn stands(options: &TrainOptions) -> Vec<f64> {
    let (from, to) = (options.schedule.stand_still_from, options.finish.round_from);
    let shares = [0.0, 0.25, 0.5, 0.75].map(|share| from + share * (to - from));
    if options.stand_still_within > 0.0 && from < to { shares.into() } else { Vec::new() }
}

/// Degree of the harmonics whose bands have begun.
pub(super) fn degree(options: &TrainOptions, progress: f64) -> ShDegree {
    let every = options.schedule.harmonics_every;
    let has_begun = |band: &u8| progress >= every * f64::from(*band);
    (1..=options.sh_degree).rev().find(has_begun).and_then(ShDegree::new).unwrap_or_default()
}

/// Number of Gaussians to have.
pub(super) fn gaussians(options: &TrainOptions, progress: f64) -> usize {
    let (from, to) = (options.initial_gaussians as f64, options.max_gaussians as f64);
    let grown = ((progress - 0.02) / (0.8 * options.schedule.density_end).max(1e-9)).clamp(0.0, 1.0);
    (from + (to - from) * grown).max(0.0) as usize
}

/// From 1 to `end` in equal ratios.
fn decay(progress: f64, end: f64) -> f32 {
    end.powf(progress) as f32
}

/// Rates of the Gaussians' attributes; `extent` is the scene's, scene units.
pub(super) fn attribute_rates(options: &TrainOptions, progress: f64, extent: f32) -> AttributeRates {
    let (slow, fast) =
        (decay(progress, options.schedule.decay), decay(progress, options.schedule.motion_decay));
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
pub(super) fn node_rate(options: &TrainOptions, progress: f64) -> f32 {
    options.rates.node_motion * decay(progress, options.schedule.motion_decay)
}

/// Rate of exposures.
pub(super) fn exposure_rate(options: &TrainOptions, progress: f64) -> f32 {
    options.rates.exposure * decay(progress, options.schedule.motion_decay)
}

/// Weight of rigidity.
pub(super) fn rigidity(options: &TrainOptions, progress: f64) -> f32 {
    options.rigidity * (1.0 - progress).max(options.schedule.rigidity_decay) as f32
}

/// Weight of what residuals of motion cost.
pub(super) fn residual_weight(options: &TrainOptions, progress: f64) -> f32 {
    let from = options.schedule.residual_from;
    if from < 1.0 && progress >= from { options.residual_weight } else { 0.0 }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn residuals_have_a_price_from_a_share_on_or_never() {
        let weights = |residual_from: f64| {
            let schedule = Schedule { residual_from, ..Schedule::default() };
            let options = TrainOptions { schedule, residual_weight: 0.5, ..TrainOptions::default() };
            [0.0, 0.29, 0.3, 1.0].map(|progress| residual_weight(&options, progress))
        };
        assert_eq!(weights(0.3), [0.0, 0.0, 0.5, 0.5]);
        assert_eq!(weights(1.0), [0.0; 4]);
    }

    #[test]
    fn motion_becomes_as_fast_as_photographs_tell_of() {
        let schedule = Schedule { fine_time: 0.3, finest_time: 0.5, ..Schedule::default() };
        let finest = |progress, instants| finest_spline(&schedule, progress, instants);
        assert_eq!([0.29, 0.3, 0.49, 0.5].map(|progress| finest(progress, 128)), [0, 32, 32, 64]);
        // Of fewer instants than two per function the finest spline would follow single photographs.
        assert_eq!([0.3, 0.5, 0.9].map(|progress| finest(progress, 127)), [32, 32, 32]);
        let never = Schedule { fine_time: 1.0, finest_time: 1.0, ..schedule };
        assert_eq!(finest_spline(&never, 1.0, 128), 0);
    }
}
