//! Keeps neighbouring nodes moving as one rigid body where the pictures do not say otherwise.
//!
//! As rigid as possible (Sorkine and Alexa 2007, equation 3; SC-GS section 4.3): each node's turn should take
//! the arrows to its neighbours to where they are at the instant.

use glam::Mat3;

use super::layer::{Layer, Neighbour, NodeGradient, NodePose};

/// Adds the gradient of `weight / nodes · Σ k_ij |(c_j + s_j) - (c_i + s_i) - R_i (c_j - c_i)|²` over nodes
/// `i` and their neighbours `j`, joined with stiffness `k_ij`.
pub(super) fn add_gradient(layer: &Layer, weight: f32, poses: &[NodePose], gradients: &mut [NodeGradient]) {
    let scale = 2.0 * weight / layer.len().max(1) as f32;
    for (node, neighbours) in layer.neighbours().iter().enumerate() {
        for &Neighbour { node: other, stiffness } in neighbours {
            let (from, to) = (&poses[node], &poses[other as usize]);
            let arrow = to.place - from.place;
            let error = scale * stiffness * (arrow + to.shift - from.shift - from.matrix * arrow);
            gradients[other as usize].shift += error;
            gradients[node].shift -= error;
            gradients[node].matrix -= Mat3::from_cols(error * arrow.x, error * arrow.y, error * arrow.z);
        }
    }
}

#[cfg(test)]
pub(super) mod tests {
    use super::*;
    use crate::train::motion::{MovedPoint, TemporalBasis};

    fn energy(layer: &Layer, poses: &[NodePose]) -> f64 {
        let mut sum = 0.0;
        for (node, neighbours) in layer.neighbours().iter().enumerate() {
            for &Neighbour { node: other, stiffness } in neighbours {
                let (from, to) = (&poses[node], &poses[other as usize]);
                let arrow = to.place - from.place;
                let error = arrow + to.shift - from.shift - from.matrix * arrow;
                sum += f64::from(stiffness * error.length_squared());
            }
        }
        sum / layer.len() as f64
    }

    /// Compares a gradient of poses, taken back to the motion, with difference quotients of what it is the
    /// gradient of.
    pub(in crate::train::motion) fn agrees_with_differences(
        value: impl Fn(&Layer, &[NodePose]) -> f64,
        add: impl Fn(&Layer, &[NodePose], &mut [NodeGradient]),
    ) {
        is_difference_quotient(
            |layer, time| value(layer, &layer.poses(time, &[])),
            |layer, time| {
                let poses = layer.poses(time, &[]);
                let mut gradients = vec![NodeGradient::ZERO; layer.len()];
                add(layer, &poses, &mut gradients);
                layer.backward(time, &poses, &gradients, (&[], &mut []));
            },
        );
    }

    /// Compares the gradient of the motion that `write` leaves in a layer with difference quotients of
    /// `value`.
    pub(in crate::train::motion) fn is_difference_quotient(
        value: impl Fn(&Layer, f32) -> f64,
        write: impl Fn(&mut Layer, f32),
    ) {
        let place = |i: f32| [i.sin(), (1.7 * i).cos(), (0.3 * i).sin()];
        let points: Vec<MovedPoint> = (0..9).map(|i| MovedPoint::at_rest(place(i as f32))).collect();
        let mut layer = Layer::new(&points, TemporalBasis::new(&[4]), 1.3, true);
        for (i, v) in layer.motion_mut().values_mut().iter_mut().enumerate() {
            *v = 0.3 * (i as f32 * 1.3).sin();
        }
        let time = 0.4;
        write(&mut layer, time);
        let found = layer.motion_mut().gradient_mut().to_vec();
        let largest = found.iter().fold(0.0f32, |a, v| a.max(v.abs()));
        for index in (0..found.len()).step_by(5) {
            let at = |change: f32| {
                let mut changed = layer.clone();
                changed.motion_mut().values_mut()[index] += change;
                value(&changed, time)
            };
            let expected = (8.0 * (at(1e-2) - at(-1e-2)) - (at(2e-2) - at(-2e-2))) / 0.12;
            let error = (f64::from(found[index]) - expected).abs() / f64::from(largest);
            assert!(error < 2e-3, "component {index}: {} instead of {expected}", found[index]);
        }
    }

    #[test]
    fn gradient_of_the_motion_is_the_difference_quotient() {
        agrees_with_differences(energy, |layer, poses, gradients| {
            add_gradient(layer, 1.0, poses, gradients);
        });
    }

    #[test]
    #[should_panic(expected = "instead of")]
    fn another_gradient_is_noticed() {
        agrees_with_differences(energy, |layer, poses, gradients| {
            add_gradient(layer, 1.01, poses, gradients);
        });
    }
}
