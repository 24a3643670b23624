//! Skinning blends the motions of the nodes that a Gaussian follows, and takes gradients back through it.
//!
//! With weights `w = softmax(-|p - c|² / 2r² + logits)`: position `Σ w (R (p - c) + c + s)`, rotation
//! `(Σ ± w q) q_own`, signs such that the turns do not cancel.

use codec_core::internals::math::quat_mul;
use glam::{Mat3, Vec3};
use rayon::prelude::*;

use super::{
    FOLLOWED,
    layer::{NodeGradient, NodePose, signs},
};
use crate::train::rotation::{Quaternion, conjugate, dot};

/// Gaussians that one task sums over: fixed, so that sums do not depend on the number of threads.
const CHUNK: usize = 4096;

/// Nodes at an instant, ready to move Gaussians.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Skinned<'a> {
    /// Of each node, one over the square of the distance at which its influence falls off.
    pub(super) falloff: &'a [f32],
    pub(super) poses: &'a [NodePose],
}

/// What of a Gaussian takes part in its motion.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Rest<'a> {
    /// Position at the canonical instant.
    pub(crate) position: Vec3,
    /// Raw quaternion at the canonical instant.
    pub(crate) rotation: Quaternion,
    /// The nodes it follows; none if it stands still.
    pub(crate) followed: Option<&'a [u32; FOLLOWED]>,
    /// Added to the logarithms of their weights.
    pub(crate) logits: &'a [f32; FOLLOWED],
}

/// A Gaussian at the instant.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub(crate) struct Posed {
    pub(crate) position: Vec3,
    /// Not normalised.
    pub(crate) rotation: Quaternion,
}

/// What the loss gains per unit of a Gaussian at the instant.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PosedGradient {
    pub(crate) position: Vec3,
    pub(crate) rotation: Quaternion,
}

/// What the loss gains per unit of a Gaussian at the canonical instant.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct SkinnedGradient {
    pub(crate) position: Vec3,
    pub(crate) rotation: Quaternion,
    pub(crate) logits: [f32; FOLLOWED],
}

impl Skinned<'_> {
    /// Weights of the nodes that a Gaussian follows; they sum to 1, or are 0 where it follows none.
    pub(crate) fn weights(&self, rest: &Rest) -> [f32; FOLLOWED] {
        let Some(followed) = rest.followed else { return [0.0; FOLLOWED] };
        let scores: [f32; FOLLOWED] = std::array::from_fn(|k| {
            let node = followed[k] as usize;
            let distance = rest.position.distance_squared(self.poses[node].place);
            rest.logits[k] - 0.5 * distance * self.falloff[node]
        });
        let top = scores.iter().copied().fold(f32::MIN, f32::max);
        let shares = scores.map(|score| (score - top).exp());
        let sum: f32 = shares.iter().sum();
        shares.map(|share| share / sum)
    }

    /// The Gaussian at the instant.
    pub(crate) fn pose(&self, rest: &Rest) -> Posed {
        let Some(followed) = rest.followed else {
            return Posed { position: rest.position, rotation: rest.rotation };
        };
        let weights = self.weights(rest);
        let signs = signs(followed, self.poses);
        let (mut position, mut turn) = (Vec3::ZERO, [0.0; 4]);
        for k in 0..FOLLOWED {
            let pose = &self.poses[followed[k] as usize];
            position += weights[k] * pose.carry(rest.position);
            (0..4).for_each(|j| turn[j] += signs[k] * weights[k] * pose.turn[j]);
        }
        Posed { position, rotation: quat_mul(turn, rest.rotation) }
    }

    /// Gradient with respect to the Gaussian at the canonical instant; adds to those of the nodes.
    pub(crate) fn backward(
        &self,
        rest: &Rest,
        gradient: &PosedGradient,
        nodes: &mut [NodeGradient],
    ) -> SkinnedGradient {
        let Some(followed) = rest.followed else {
            let PosedGradient { position, rotation } = *gradient;
            return SkinnedGradient { position, rotation, logits: [0.0; FOLLOWED] };
        };
        let point = rest.position;
        let weights = self.weights(rest);
        let signs = signs(followed, self.poses);
        let of_turn = quat_mul(gradient.rotation, conjugate(rest.rotation));
        let (mut turn, mut position) = ([0.0; 4], Vec3::ZERO);
        let (mut of_weight, mut mean) = ([0.0; FOLLOWED], 0.0);
        for k in 0..FOLLOWED {
            let node = followed[k] as usize;
            let (pose, sum) = (&self.poses[node], &mut nodes[node]);
            let arrow = point - pose.place;
            let weighted = weights[k] * gradient.position;
            sum.shift += weighted;
            sum.matrix += Mat3::from_cols(weighted * arrow.x, weighted * arrow.y, weighted * arrow.z);
            for j in 0..4 {
                sum.turn[j] += signs[k] * weights[k] * of_turn[j];
                turn[j] += signs[k] * weights[k] * pose.turn[j];
            }
            position += pose.matrix.transpose() * weighted;
            of_weight[k] = gradient.position.dot(pose.carry(point)) + signs[k] * dot(of_turn, pose.turn);
            mean += weights[k] * of_weight[k];
        }
        // Softmax, and the distances in it, which move with the Gaussian.
        let logits: [f32; FOLLOWED] = std::array::from_fn(|k| weights[k] * (of_weight[k] - mean));
        for (slope, &node) in logits.iter().zip(followed) {
            let node = node as usize;
            position -= *slope * self.falloff[node] * (point - self.poses[node].place);
        }
        SkinnedGradient { position, rotation: quat_mul(conjugate(turn), gradient.rotation), logits }
    }

    /// Takes the gradients of many Gaussians back, in order: `one(index, nodes)` handles one of them and adds
    /// to the nodes' gradients. Returns what all have added to the nodes.
    pub(crate) fn backward_all<T: Send>(
        &self,
        out: &mut [T],
        one: impl Fn(usize, &mut T, &mut [NodeGradient]) + Sync,
    ) -> Vec<NodeGradient> {
        let count = self.poses.len();
        let partial: Vec<Vec<NodeGradient>> = out
            .par_chunks_mut(CHUNK)
            .enumerate()
            .map(|(chunk, out)| {
                let mut sums = vec![NodeGradient::ZERO; count];
                out.iter_mut().enumerate().for_each(|(i, out)| one(chunk * CHUNK + i, out, &mut sums));
                sums
            })
            .collect();
        let mut sums = vec![NodeGradient::ZERO; count];
        for partial in &partial {
            sums.iter_mut().zip(partial).for_each(|(sum, part)| sum.add(part));
        }
        sums
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::train::motion::{ControlNodes, MovedPoint, TemporalBasis, layer::Layer};

    const WEIGHTS: [f32; 7] = [0.7, -0.3, 0.5, 0.2, -0.9, 0.4, 0.6];
    const FOLLOWS: [u32; FOLLOWED] = [2, 0, 5, 3];

    fn nodes() -> Layer {
        let place = |i: f32| [i.sin(), (1.7 * i).cos(), (0.3 * i).sin()];
        let points: Vec<MovedPoint> = (0..6).map(|i| MovedPoint::at_rest(place(i as f32))).collect();
        let mut nodes = Layer::new(&points, TemporalBasis::new(&[4, 6]), 1.3, true);
        for (i, v) in nodes.motion_mut().values_mut().iter_mut().enumerate() {
            *v = 0.4 * (i as f32 * 1.3).sin();
        }
        nodes
    }

    /// Position (3), rotation (4) and logits (4) of a Gaussian.
    type Numbers = [f32; 11];

    fn rest(numbers: &Numbers) -> (Vec3, Quaternion, [f32; FOLLOWED]) {
        let [x, y, z, a, b, c, d, e, f, g, h] = *numbers;
        (Vec3::new(x, y, z), [a, b, c, d], [e, f, g, h])
    }

    fn skinned<'a>(nodes: &'a Layer, poses: &'a [NodePose]) -> Skinned<'a> {
        Skinned { falloff: nodes.falloff(), poses }
    }

    fn value(nodes: &Layer, time: f32, numbers: &Numbers) -> f64 {
        let poses = nodes.poses(time, &[]);
        let (position, rotation, logits) = rest(numbers);
        let posed = skinned(nodes, &poses).pose(&Rest {
            position,
            rotation,
            followed: Some(&FOLLOWS),
            logits: &logits,
        });
        let values = posed.position.to_array().into_iter().chain(posed.rotation);
        values.zip(WEIGHTS).map(|(v, w)| f64::from(v * w)).sum()
    }

    #[test]
    fn gradients_are_difference_quotients() {
        let (mut nodes, time) = (nodes(), 0.37);
        let numbers: Numbers = [0.1, 0.4, -0.2, 0.8, -0.1, 0.3, 0.5, 0.2, -0.4, 0.1, 0.3];
        let poses = nodes.poses(time, &[]);
        let mut sums = vec![NodeGradient::ZERO; nodes.len()];
        let gradient = PosedGradient {
            position: Vec3::new(WEIGHTS[0], WEIGHTS[1], WEIGHTS[2]),
            rotation: [WEIGHTS[3], WEIGHTS[4], WEIGHTS[5], WEIGHTS[6]],
        };
        let (position, rotation, logits) = rest(&numbers);
        let rest = Rest { position, rotation, followed: Some(&FOLLOWS), logits: &logits };
        let found = skinned(&nodes, &poses).backward(&rest, &gradient, &mut sums);
        let found: Vec<f32> =
            found.position.to_array().into_iter().chain(found.rotation).chain(found.logits).collect();
        for (index, found) in found.into_iter().enumerate() {
            let at = |change: f32| {
                let mut changed = numbers;
                changed[index] += change;
                value(&nodes, time, &changed)
            };
            let expected = (8.0 * (at(1e-2) - at(-1e-2)) - (at(2e-2) - at(-2e-2))) / 0.12;
            assert!((f64::from(found) - expected).abs() < 2e-3, "{index}: {found} {expected}");
        }
        nodes.backward(time, &poses, &sums, (&[], &mut []));
        let found = nodes.motion_mut().gradient_mut().to_vec();
        for index in (0..found.len()).step_by(3) {
            let at = |change: f32| {
                let mut changed = nodes.clone();
                changed.motion_mut().values_mut()[index] += change;
                value(&changed, time, &numbers)
            };
            let expected = (8.0 * (at(1e-2) - at(-1e-2)) - (at(2e-2) - at(-2e-2))) / 0.12;
            assert!(
                (f64::from(found[index]) - expected).abs() < 2e-3,
                "{index}: {} {expected}",
                found[index]
            );
        }
    }

    #[test]
    fn without_nodes_nothing_moves() {
        let nodes = ControlNodes::none(TemporalBasis::default(), 1.3);
        let numbers: Numbers = [0.1, 0.4, -0.2, 0.8, -0.1, 0.3, 0.5, 0.0, 0.0, 0.0, 0.0];
        let (position, rotation, logits) = rest(&numbers);
        let rest = Rest { position, rotation, followed: None, logits: &logits };
        assert_eq!(nodes.skin(&nodes.poses(0.5)).pose(&rest), Posed { position, rotation });
    }
}
