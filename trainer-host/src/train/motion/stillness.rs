//! Keeps nodes where they are where the pictures do not say otherwise.
//!
//! A view says little about motion along its own rays, and each instant has few views: what never moves
//! would wander there. The weight is on how far it moves and not on the square of that, which leaves what
//! does move alone.

use glam::Vec3;

use super::layer::{NodeGradient, NodePose};

/// Lengths below this share of the unit count as their squares do.
const SOFT: f32 = 1e-3;

/// Adds the gradient of `weight / nodes · Σ (√(|s_i / unit|² + ε²) + √(|v_i|² + ε²))` over nodes `i`, shifted
/// by `s_i` and turned by a quaternion with vector part `v_i`.
pub(super) fn add_gradient(weight: f32, unit: f32, poses: &[NodePose], gradients: &mut [NodeGradient]) {
    let scale = weight / poses.len().max(1) as f32;
    for (pose, gradient) in poses.iter().zip(gradients) {
        let shift = pose.shift / unit;
        gradient.shift += scale / unit * shift / (shift.length_squared() + SOFT * SOFT).sqrt();
        let [_, x, y, z] = pose.turn;
        let part = Vec3::new(x, y, z);
        let part = scale * part / (part.length_squared() + SOFT * SOFT).sqrt();
        gradient.turn.iter_mut().skip(1).zip(part.to_array()).for_each(|(sum, v)| *sum += v);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::motion::rigidity::tests::agrees_with_differences;

    const UNIT: f32 = 1.3;

    fn moved(poses: &[NodePose]) -> f64 {
        let soft = |squared: f32| f64::from(squared + SOFT * SOFT).sqrt();
        let one = |pose: &NodePose| {
            let [_, x, y, z] = pose.turn;
            soft((pose.shift / UNIT).length_squared()) + soft(x * x + y * y + z * z)
        };
        poses.iter().map(one).sum::<f64>() / poses.len() as f64
    }

    #[test]
    fn gradient_of_the_motion_is_the_difference_quotient() {
        agrees_with_differences(
            |_, poses| moved(poses),
            |_, poses, gradients| add_gradient(1.0, UNIT, poses, gradients),
        );
    }
}
