//! Keeps the motion of nodes even over time where the pictures do not say otherwise.
//!
//! Each instant has few views. Where motion cannot change from one instant to the next at will, those of the
//! instants around count too. The penalty grows as a logarithm: it stops nodes that only tremble, and hardly
//! hinders a ball that bounces.

use super::layer::{Layer, MOTION};

/// Acceleration from which on the penalty rises more slowly: extents, and half radians, per square of a
/// tenth of the clip.
const LARGE: f32 = 0.1;
/// Accelerations below this count as their squares do.
const SOFT: f32 = 1e-3;
/// Tenths of a clip per clip, squared: accelerations over the clip divided by it are those above.
const TENTHS_SQUARED: f32 = 100.0;

/// Adds to the gradient of the motion that of `weight / nodes · Σ L ln(1 + √(|a_i|² + ε²) / L)` over nodes
/// `i`, which `layer` gives the acceleration `a_i` (shift and quaternion) at `time`.
pub(super) fn add_gradient(layer: &mut Layer, weight: f32, time: f32) {
    let scale = weight / layer.len().max(1) as f32;
    let functions: Vec<f32> =
        layer.basis().accelerations_at(time).into_iter().map(|v| v / TENTHS_SQUARED).collect();
    let width = MOTION * functions.len();
    let (values, gradient) = layer.motion_mut().values_and_gradient();
    for (motion, out) in values.chunks_exact(width).zip(gradient.chunks_exact_mut(width)) {
        let acceleration = acceleration(motion, &functions);
        let length = length(&acceleration);
        let pull = scale * LARGE / ((LARGE + length) * length);
        for (out, &function) in out.chunks_exact_mut(MOTION).zip(&functions).filter(|(_, v)| **v != 0.0) {
            out.iter_mut().zip(acceleration).for_each(|(out, v)| *out += pull * function * v);
        }
    }
}

/// The sum of `functions`, each times its numbers in the motion of a node.
fn acceleration(motion: &[f32], functions: &[f32]) -> [f32; MOTION] {
    let mut sum = [0.0; MOTION];
    for (numbers, &function) in motion.chunks_exact(MOTION).zip(functions).filter(|(_, v)| **v != 0.0) {
        sum.iter_mut().zip(numbers).for_each(|(sum, v)| *sum += function * v);
    }
    sum
}

fn length(acceleration: &[f32; MOTION]) -> f32 {
    (acceleration.iter().map(|v| v * v).sum::<f32>() + SOFT * SOFT).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::motion::{MovedPoint, TemporalBasis, rigidity::tests::is_difference_quotient};

    fn unevenness(layer: &Layer, time: f32) -> f64 {
        let functions: Vec<f32> =
            layer.basis().accelerations_at(time).into_iter().map(|v| v / TENTHS_SQUARED).collect();
        let mut layer = layer.clone();
        let nodes = layer.len();
        let motion = layer.motion_mut();
        let of_node = |node| {
            let length = f64::from(length(&acceleration(motion.item(node), &functions)));
            f64::from(LARGE) * (1.0 + length / f64::from(LARGE)).ln()
        };
        (0..nodes).map(of_node).sum::<f64>() / nodes as f64
    }

    #[test]
    fn gradient_of_the_motion_is_the_difference_quotient() {
        is_difference_quotient(unevenness, |layer, time| add_gradient(layer, 1.0, time));
    }

    #[test]
    fn what_moves_evenly_is_left_alone() {
        // Knots of uniform splines that rise evenly make a line over time.
        let points: Vec<_> = (0..3).map(|i| MovedPoint::at_rest([i as f32, 0.0, 0.0])).collect();
        let mut layer = Layer::new(&points, TemporalBasis::new(&[6]), 1.0, true);
        for (index, value) in layer.motion_mut().values_mut().iter_mut().enumerate() {
            *value = ((index / MOTION) % 6) as f32;
        }
        add_gradient(&mut layer, 1.0, 0.3);
        assert!(layer.motion_mut().gradient_mut().iter().all(|v| v.abs() < 1e-3));
        layer.motion_mut().values_mut()[2 * MOTION] += 1.0;
        add_gradient(&mut layer, 1.0, 0.3);
        assert!(layer.motion_mut().gradient_mut()[2 * MOTION].abs() > 1e-2);
    }
}
