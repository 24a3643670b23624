//! An average is the moving average of a model's parameters over the steps of a training.
//!
//! Each step follows the gradient of one view, so parameters fluctuate around the optimum of all views, more
//! so while learning rates stay high; their average is nearer to it (Polyak and Juditsky, "Acceleration of
//! Stochastic Approximation by Averaging", 1992).

use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{model::Model, parameter::Parameter};

/// Window of the average, steps: it is the plain mean of as many at first, then exponential.
const WINDOW: u32 = 100;
/// Values that one task averages.
const CHUNK: usize = 32_768;

/// Values of all parameters of a model, in the order of [`Model::parameters`].
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Average {
    steps: u32,
    values: Vec<Vec<f32>>,
}

impl Average {
    /// Takes in `model` after a step, or begins anew with it: after other steps, or where it has gained or
    /// lost Gaussians or nodes.
    pub(super) fn follow(average: &mut Option<Self>, model: &Model) {
        if let Some(average) = average.as_mut().filter(|average| average.is_like(model)) {
            average.steps = average.steps.saturating_add(1).min(WINDOW);
            let share = 1.0 / average.steps as f32;
            for (average, parameter) in average.values.iter_mut().zip(model.parameters()) {
                let chunks = average.par_chunks_mut(CHUNK).zip(parameter.values().par_chunks(CHUNK));
                chunks.for_each(|(average, values)| {
                    let pairs = average.iter_mut().zip(values);
                    pairs.for_each(|(average, value)| *average += share * (value - *average));
                });
            }
        } else {
            let values = model.parameters().map(|parameter| parameter.values().to_vec()).collect();
            *average = Some(Self { steps: 1, values });
        }
    }

    /// `model` with the average's values in place of its own.
    pub(super) fn of(&self, model: &Model) -> Model {
        let mut model = model.clone();
        for (parameter, values) in model.parameters_mut().zip(&self.values) {
            parameter.values_mut().copy_from_slice(values);
        }
        model
    }

    /// Whether it is one of a model like `model`: what was read from a file may not be.
    pub(super) fn fits(&self, model: &Model) -> bool {
        (1..=WINDOW).contains(&self.steps)
            && self.is_like(model)
            && self.values.iter().flatten().all(|value| value.is_finite())
    }

    /// Whether it is of as many values.
    fn is_like(&self, model: &Model) -> bool {
        let lengths = |(values, parameter): (&Vec<f32>, &Parameter)| values.len() == parameter.values().len();
        self.values.len() == model.parameters().count()
            && self.values.iter().zip(model.parameters()).all(lengths)
    }
}

#[cfg(test)]
mod tests {
    use codec_core::{Footprint, Gaussian, ShDegree};

    use super::*;
    use crate::{
        scene::Instant,
        train::{
            gaussians::TrainedGaussians,
            motion::{ControlNodes, TemporalBasis},
        },
    };

    /// A model of `count` Gaussians, none of which moves.
    fn model(count: usize) -> Model {
        let instant = Instant { gaussians: vec![Gaussian::ABSENT; count], ..Instant::default() };
        Model {
            gaussians: TrainedGaussians::new(&instant, ShDegree::default()),
            nodes: ControlNodes::none(TemporalBasis::default(), 1.0),
            followed: vec![None; count],
            footprint: Footprint::default(),
        }
    }

    /// The average of the opacity logits `logits`, of one step each.
    fn averaged(average: &mut Option<Average>, model: &mut Model, logits: impl Iterator<Item = f32>) -> f32 {
        for logit in logits {
            model.gaussians.opacity.values_mut().fill(logit);
            Average::follow(average, model);
        }
        average.as_ref().unwrap().of(model).gaussians.opacity.values()[0]
    }

    #[test]
    fn a_young_average_is_the_mean_of_all_steps_and_an_old_one_forgets() {
        let (mut average, mut model) = (None, model(2));
        let mean = averaged(&mut average, &mut model, (0..WINDOW).map(|step| step as f32));
        assert!((mean - (WINDOW - 1) as f32 / 2.0).abs() < 1e-3, "{mean}");
        let first = averaged(&mut average, &mut model, [0.0].into_iter());
        assert!((first / mean - (1.0 - 1.0 / WINDOW as f32)).abs() < 1e-5, "{first} after {mean}");
        let later = averaged(&mut average, &mut model, std::iter::repeat_n(7.0, 10 * WINDOW as usize));
        assert!((later - 7.0).abs() < 0.01, "{later}");
    }

    #[test]
    fn it_begins_anew_where_gaussians_went() {
        let mut average = None;
        averaged(&mut average, &mut model(3), [5.0, 6.0].into_iter());
        assert!(!average.as_ref().unwrap().fits(&model(2)));
        assert_eq!(averaged(&mut average, &mut model(2), [9.0].into_iter()), 9.0);
        assert!(average.as_ref().unwrap().fits(&model(2)));
        average.as_mut().unwrap().values[0][0] = f32::NAN;
        assert!(!average.unwrap().fits(&model(2)));
    }
}
