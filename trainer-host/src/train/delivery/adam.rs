//! Steps parameters downhill with Adam: steps scaled by running moments of their gradients.

use super::parameters::{COMPONENTS, Parameters};

/// Decay of the first moment. Source: Kingma and Ba 2015, section 2.
const FIRST: f64 = 0.9;
/// Decay of the second moment: shorter than the usual 0.999, since a fine-tuning takes a few hundred updates.
const SECOND: f64 = 0.99;
/// Added to the root of the second moment, in units of gradients.
const EPSILON: f64 = 1e-12;

/// Running moments of gradients.
#[derive(Clone, Debug, serde::Serialize, serde::Deserialize)]
pub(super) struct Adam {
    first: Vec<[f64; COMPONENTS]>,
    second: Vec<[f64; COMPONENTS]>,
    updates: i32,
}

impl Adam {
    /// For `count` Gaussians, no gradient seen.
    pub(super) fn new(count: usize) -> Self {
        Self { first: vec![[0.0; COMPONENTS]; count], second: vec![[0.0; COMPONENTS]; count], updates: 0 }
    }

    /// Whether it is for `count` Gaussians and every moment is a number.
    pub(super) fn is_sound(&self, count: usize) -> bool {
        let fits = |moments: &Vec<[f64; COMPONENTS]>| {
            moments.len() == count && moments.as_flattened().iter().all(|value| value.is_finite())
        };
        fits(&self.first) && fits(&self.second) && self.updates >= 0
    }

    /// Moves `parameters` against `gradient`, one list per Gaussian and per proxy, at most about `rates` in
    /// each component: the first of Gaussians, the second of proxies.
    pub(super) fn step(
        &mut self,
        parameters: &mut Parameters,
        gradient: &[[f64; COMPONENTS]],
        rates: &[[f64; COMPONENTS]; 2],
    ) {
        let first_proxy = parameters.first_of(parameters.proxies_of(0));
        self.updates += 1;
        let bias = [1.0 - FIRST.powi(self.updates), 1.0 - SECOND.powi(self.updates)];
        let moments = self.first.iter_mut().zip(&mut self.second);
        let each = parameters.all_mut().zip(gradient).zip(moments);
        for (index, ((values, gradient), (first, second))) in each.enumerate() {
            let rates = &rates[usize::from(index >= first_proxy)];
            for c in 0..COMPONENTS {
                first[c] = FIRST * first[c] + (1.0 - FIRST) * gradient[c];
                second[c] = SECOND * second[c] + (1.0 - SECOND) * gradient[c] * gradient[c];
                let step = (first[c] / bias[0]) / ((second[c] / bias[1]).sqrt() + EPSILON);
                values[c] -= (rates[c] * step) as f32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn it_reaches_the_bottom_of_a_bowl_and_leaves_what_has_no_slope() {
        let mut parameters = Parameters::zeros(&[2]);
        let mut adam = Adam::new(2);
        let rates = [[0.05; COMPONENTS]; 2];
        for _ in 0..400 {
            let gradient: Vec<[f64; COMPONENTS]> = parameters
                .all_mut()
                .map(|values| {
                    let mut gradient = [0.0; COMPONENTS];
                    gradient[0] = 1e-6 * (f64::from(values[0]) - 1.0);
                    gradient[12] = 1e3 * (f64::from(values[12]) + 0.5);
                    gradient
                })
                .collect();
            adam.step(&mut parameters, &gradient, &rates);
        }
        for values in parameters.all_mut() {
            assert!((values[0] - 1.0).abs() < 0.03 && (values[12] + 0.5).abs() < 0.03, "{values:?}");
            assert_eq!(values[5], 0.0);
        }
    }

    #[test]
    fn the_first_step_is_the_rate_against_the_sign() {
        let mut parameters = Parameters::zeros(&[1]).with_proxies(vec![vec![1.0]]);
        let mut gradient = [0.0; COMPONENTS];
        (gradient[3], gradient[4]) = (1e-4, -7.0);
        Adam::new(2).step(&mut parameters, &[gradient; 2], &[[0.01; COMPONENTS], [0.02; COMPONENTS]]);
        let found: Vec<_> = parameters.all_mut().collect();
        for (values, rate) in found.into_iter().zip([0.01, 0.02]) {
            assert!((values[3] + rate).abs() < 1e-6 && (values[4] - rate).abs() < 1e-6, "{values:?}");
        }
    }
}
