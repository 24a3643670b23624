//! A layer of control nodes: where each is, how it follows coarser nodes, and what it adds to their motion.

use glam::{Mat3, Vec3};
use serde::{Deserialize, Serialize};

use super::{
    FOLLOWED, TemporalBasis,
    trajectory::{self, Trajectory},
};
use crate::train::{
    parameter::{AdamStep, Parameter},
    rotation::{Quaternion, dot, matrix, matrix_gradient},
};

/// Numbers of a node per function of the basis: shift (3) and quaternion (4).
pub(super) const MOTION: usize = 7;
/// Other nodes that a node tries to move rigidly with.
const NEIGHBOURS: usize = 6;

/// The nodes that something follows, and how much of each: weights sum to 1.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(crate) struct Followed {
    pub(crate) nodes: [u32; FOLLOWED],
    pub(crate) weights: [f32; FOLLOWED],
}

/// A point of the scene and what has moved it so far.
#[derive(Clone, Copy, Debug)]
pub(crate) struct MovedPoint {
    /// At the canonical instant, scene units.
    pub(crate) place: [f32; 3],
    /// Of no meaning where there are no nodes yet.
    pub(crate) followed: Followed,
    pub(crate) trajectory: Trajectory,
}

impl MovedPoint {
    /// A point that nothing has moved.
    #[cfg(test)]
    pub(crate) fn at_rest(place: [f32; 3]) -> Self {
        let followed = Followed { nodes: [0; FOLLOWED], weights: [1.0, 0.0, 0.0, 0.0] };
        Self { place, followed, trajectory: [place; trajectory::INSTANTS] }
    }
}

/// A node at an instant.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct NodePose {
    /// Place at the canonical instant.
    pub(crate) place: Vec3,
    /// How far the place has moved.
    pub(crate) shift: Vec3,
    /// Turn about the place, of length 1.
    pub(crate) turn: Quaternion,
    /// The turn as a matrix.
    pub(crate) matrix: Mat3,
    /// Length of the quaternion before it was normalised.
    length: f32,
}

impl NodePose {
    /// Where the node takes a point.
    pub(super) fn carry(&self, point: Vec3) -> Vec3 {
        self.matrix * (point - self.place) + self.place + self.shift
    }
}

/// What the loss gains per unit of a node's pose.
#[derive(Clone, Copy, Debug)]
pub(crate) struct NodeGradient {
    pub(crate) shift: Vec3,
    pub(crate) matrix: Mat3,
    pub(crate) turn: Quaternion,
}

impl NodeGradient {
    /// Nothing. (The default of a matrix is the identity.)
    pub(crate) const ZERO: Self = Self { shift: Vec3::ZERO, matrix: Mat3::ZERO, turn: [0.0; 4] };

    pub(super) fn add(&mut self, other: &Self) {
        self.shift += other.shift;
        self.matrix += other.matrix;
        self.turn.iter_mut().zip(other.turn).for_each(|(sum, v)| *sum += v);
    }
}

/// Another node that moves nearly as a node does.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Neighbour {
    pub(super) node: u32,
    /// How firmly the two are joined, 0 to 1: less the more their distance has changed over the clip.
    pub(super) stiffness: f32,
}

/// Nodes of one density.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Layer {
    basis: TemporalBasis,
    /// Scene units per unit of shift: shifts and turns then learn at one rate.
    unit: f32,
    /// At the canonical instant, scene units.
    places: Vec<[f32; 3]>,
    /// Of each node, what it follows of the layer before; empty in the first layer.
    follows: Vec<Followed>,
    /// One over the square of the distance at which a node's influence falls off.
    falloff: Vec<f32>,
    /// Of each node, the others that it moves rigidly with.
    neighbours: Vec<Vec<Neighbour>>,
    /// Per function of the basis: shift and quaternion that a node adds to what it follows, [`MOTION`]
    /// numbers.
    motion: Parameter,
    /// Steps taken.
    steps: u32,
}

impl Layer {
    /// Nodes at `points` that add nothing yet to what they follow; `is_first` if there is no layer before.
    pub(super) fn new(points: &[MovedPoint], basis: TemporalBasis, unit: f32, is_first: bool) -> Self {
        let moved: Vec<Trajectory> = points.iter().map(|point| point.trajectory).collect();
        let near: Vec<Vec<u32>> = trajectory::nearest(&moved, &moved, NEIGHBOURS + 1)
            .into_iter()
            .enumerate()
            .map(|(node, near)| near.into_iter().filter(|&other| other as usize != node).collect())
            .collect();
        let place = |node: usize| Vec3::from_array(points[node].place);
        let falloff = near.iter().enumerate().map(|(node, near)| {
            let around = &near[..(FOLLOWED - 1).min(near.len())];
            let mean = around.iter().map(|&other| place(node).distance(place(other as usize))).sum::<f32>();
            let radius = mean / around.len().max(1) as f32;
            1.0 / (radius * radius).max(1e-8)
        });
        let joined = |(node, near): (usize, &Vec<u32>)| {
            let join = |&other: &u32| Neighbour {
                node: other,
                stiffness: trajectory::stiffness(&moved[node], &moved[other as usize]),
            };
            near.iter().take(NEIGHBOURS).map(join).collect()
        };
        let width = MOTION * basis.len();
        Self {
            unit,
            places: points.iter().map(|point| point.place).collect(),
            follows: if is_first { Vec::new() } else { points.iter().map(|point| point.followed).collect() },
            falloff: falloff.collect(),
            neighbours: near.iter().enumerate().map(joined).collect(),
            motion: Parameter::new(width, vec![0.0; width * points.len()]),
            steps: 0,
            basis,
        }
    }

    pub(super) fn len(&self) -> usize {
        self.places.len()
    }

    pub(super) fn neighbours(&self) -> &[Vec<Neighbour>] {
        &self.neighbours
    }

    pub(super) fn falloff(&self) -> &[f32] {
        &self.falloff
    }

    pub(super) fn basis(&self) -> &TemporalBasis {
        &self.basis
    }

    /// What the layer adds to the motion of its nodes: per node and function of the basis, [`MOTION`]
    /// numbers.
    pub(super) fn motion(&self) -> &Parameter {
        &self.motion
    }

    pub(super) fn motion_mut(&mut self) -> &mut Parameter {
        &mut self.motion
    }

    /// Every node at `time` (0 to 1), over the poses of the layer before.
    pub(super) fn poses(&self, time: f32, before: &[NodePose]) -> Vec<NodePose> {
        let functions = self.basis.at(time);
        let pose = |(index, place): (usize, &[f32; 3])| {
            let place = Vec3::from_array(*place);
            let (mut shift, mut turn) = match self.follows.get(index) {
                Some(followed) => blend(place, followed, before),
                None => (Vec3::ZERO, [1.0, 0.0, 0.0, 0.0]),
            };
            let motion = self.motion.item(index).chunks_exact(MOTION);
            for (numbers, &weight) in motion.zip(&functions).filter(|(_, weight)| **weight != 0.0) {
                shift += weight * self.unit * Vec3::new(numbers[0], numbers[1], numbers[2]);
                turn.iter_mut().zip(&numbers[3..]).for_each(|(sum, v)| *sum += weight * v);
            }
            let length = dot(turn, turn).sqrt().max(1e-6);
            let turn = turn.map(|v| v / length);
            NodePose { place, shift, turn, matrix: matrix(turn), length }
        };
        self.places.iter().enumerate().map(pose).collect()
    }

    /// Writes the gradient of the motion from those of the poses at `time`; adds to those of the layer
    /// before.
    pub(super) fn backward(
        &mut self,
        time: f32,
        poses: &[NodePose],
        gradients: &[NodeGradient],
        before: (&[NodePose], &mut [NodeGradient]),
    ) {
        let functions = self.basis.at(time);
        let width = MOTION * functions.len();
        let out = self.motion.gradient_mut().chunks_exact_mut(width.max(1));
        for (index, ((pose, gradient), out)) in poses.iter().zip(gradients).zip(out).enumerate() {
            let from_matrix = matrix_gradient(pose.turn, &gradient.matrix);
            let turn: Quaternion = std::array::from_fn(|j| from_matrix[j] + gradient.turn[j]);
            // The length of the quaternion does not matter.
            let along = dot(turn, pose.turn);
            let turn: Quaternion = std::array::from_fn(|j| (turn[j] - along * pose.turn[j]) / pose.length);
            for (out, &weight) in out.chunks_exact_mut(MOTION).zip(&functions) {
                out[..3].copy_from_slice(&(gradient.shift * (weight * self.unit)).to_array());
                out[3..].copy_from_slice(&turn.map(|v| v * weight));
            }
            if let Some(followed) = self.follows.get(index) {
                blend_backward(pose.place, followed, (gradient.shift, turn), before.0, before.1);
            }
        }
    }

    /// The same motion over a basis with one more spline, of `count` functions: finer motion can then be
    /// learnt. What Adam remembers is forgotten.
    pub(super) fn refine_time(&mut self, count: usize) {
        let (before, nodes) = (MOTION * self.basis.len(), self.len());
        self.basis = self.basis.with(count);
        let width = MOTION * self.basis.len();
        let mut motion = vec![0.0; width * nodes];
        for (to, from) in motion.chunks_exact_mut(width).zip(self.motion.values().chunks_exact(before)) {
            to[..before].copy_from_slice(from);
        }
        self.motion = Parameter::new(width, motion);
        self.steps = 0;
    }

    /// Takes a step of the motion.
    pub(super) fn step(&mut self, step: AdamStep) {
        self.steps = self.steps.saturating_add(1);
        self.motion.step(AdamStep { number: self.steps, ..step });
    }

    /// Whether what was read from a file can be used after a layer of `before` nodes.
    pub(super) fn is_sound(&self, before: Option<usize>) -> bool {
        let count = self.len();
        let follows = match before {
            None => self.follows.is_empty(),
            Some(before) => {
                let fits = |followed: &Followed| {
                    followed.nodes.iter().all(|&node| (node as usize) < before)
                        && followed.weights.iter().all(|weight| weight.is_finite())
                };
                self.follows.len() == count && self.follows.iter().all(fits)
            }
        };
        let joined = |near: &Neighbour| (near.node as usize) < count && near.stiffness.is_finite();
        follows
            && self.unit.is_finite()
            && self.basis.is_sound()
            && self.falloff.len() == count
            && self.neighbours.len() == count
            && self.neighbours.iter().flatten().all(joined)
            && self.places.iter().flatten().chain(&self.falloff).all(|v| v.is_finite())
            && self.motion.is_sound(MOTION * self.basis.len(), count)
    }
}

/// 1 or -1 for each followed node: whether its quaternion or its opposite, the same turn, is nearer to the
/// first one's.
pub(super) fn signs(nodes: &[u32; FOLLOWED], poses: &[NodePose]) -> [f32; FOLLOWED] {
    let first = poses[nodes[0] as usize].turn;
    std::array::from_fn(|k| if dot(first, poses[nodes[k] as usize].turn) < 0.0 { -1.0 } else { 1.0 })
}

/// Shift and turn (not normalised) of a place that follows nodes.
fn blend(place: Vec3, followed: &Followed, poses: &[NodePose]) -> (Vec3, Quaternion) {
    let signs = signs(&followed.nodes, poses);
    let (mut shift, mut turn) = (Vec3::ZERO, [0.0; 4]);
    for k in 0..FOLLOWED {
        let (pose, weight) = (&poses[followed.nodes[k] as usize], followed.weights[k]);
        shift += weight * (pose.carry(place) - place);
        (0..4).for_each(|j| turn[j] += signs[k] * weight * pose.turn[j]);
    }
    (shift, turn)
}

/// Takes the gradient of [`blend`] back to the nodes that are followed.
fn blend_backward(
    place: Vec3,
    followed: &Followed,
    (of_shift, of_turn): (Vec3, Quaternion),
    poses: &[NodePose],
    gradients: &mut [NodeGradient],
) {
    let each = followed.nodes.iter().zip(followed.weights).zip(signs(&followed.nodes, poses));
    for ((&node, weight), sign) in each {
        let (arrow, sum) = (place - poses[node as usize].place, &mut gradients[node as usize]);
        let of_shift = weight * of_shift;
        sum.shift += of_shift;
        sum.matrix += Mat3::from_cols(of_shift * arrow.x, of_shift * arrow.y, of_shift * arrow.z);
        (0..4).for_each(|j| sum.turn[j] += sign * weight * of_turn[j]);
    }
}
