//! Control nodes hold the motion of a scene: where each is, and how it turns and shifts over time.

use glam::{Mat3, Vec3};
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    FOLLOWED, TemporalBasis,
    skinning::{Skinned, node_weights},
};
use crate::{
    scene::import::nearest::Tree,
    train::{
        parameter::Parameter,
        rotation::{Quaternion, dot, matrix, matrix_gradient},
    },
};

/// Numbers of a node per function of the basis: shift (3) and quaternion (4).
const MOTION: usize = 7;
/// Other nodes that a node tries to move rigidly with.
pub(super) const NEIGHBOURS: usize = 6;

/// Places and motions of control nodes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ControlNodes {
    basis: TemporalBasis,
    /// Scene units per unit of shift: shifts and turns then learn at one rate.
    unit: f32,
    /// At the canonical instant, scene units.
    places: Vec<[f32; 3]>,
    /// One over the square of the distance at which a node's influence falls off.
    falloff: Vec<f32>,
    /// Of each node, its nearest others.
    neighbours: Vec<Vec<u32>>,
    /// Per function of the basis: shift and quaternion (less the identity), [`MOTION`] numbers.
    motion: Parameter,
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

impl NodePose {
    /// Where the node takes a point.
    pub(super) fn carry(&self, point: Vec3) -> Vec3 {
        self.matrix * (point - self.place) + self.place + self.shift
    }
}

impl ControlNodes {
    /// No nodes: nothing moves.
    pub(crate) fn none(basis: TemporalBasis, unit: f32) -> Self {
        Self { basis, unit, ..Self::default() }
    }

    pub(crate) fn len(&self) -> usize {
        self.places.len()
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.places.is_empty()
    }

    #[cfg(test)]
    pub(crate) fn motion_mut(&mut self) -> &mut Parameter {
        &mut self.motion
    }

    pub(super) fn neighbours(&self) -> &[Vec<u32>] {
        &self.neighbours
    }

    pub(super) fn falloff(&self) -> &[f32] {
        &self.falloff
    }

    /// Every node at `time` (0 to 1).
    pub(crate) fn poses(&self, time: f32) -> Vec<NodePose> {
        let functions = self.basis.at(time);
        let pose = |(index, place): (usize, &[f32; 3])| {
            let mut sum = [0.0f32, 0.0, 0.0, 1.0, 0.0, 0.0, 0.0];
            let motion = self.motion.item(index).chunks_exact(MOTION);
            for (numbers, &weight) in motion.zip(&functions).filter(|(_, weight)| **weight != 0.0) {
                sum.iter_mut().zip(numbers).for_each(|(sum, v)| *sum += weight * v);
            }
            let [x, y, z, turn @ ..] = sum;
            let length = dot(turn, turn).sqrt().max(1e-6);
            let turn = turn.map(|v| v / length);
            let place = Vec3::from_array(*place);
            NodePose { place, shift: self.unit * Vec3::new(x, y, z), turn, matrix: matrix(turn), length }
        };
        self.places.iter().enumerate().map(pose).collect()
    }

    /// Writes the gradient of the motion from those of the poses at `time`.
    pub(crate) fn backward(&mut self, time: f32, poses: &[NodePose], gradients: &[NodeGradient]) {
        let functions = self.basis.at(time);
        let width = MOTION * functions.len();
        let out = self.motion.gradient_mut().chunks_exact_mut(width.max(1));
        for ((pose, gradient), out) in poses.iter().zip(gradients).zip(out) {
            let from_matrix = matrix_gradient(pose.turn, &gradient.matrix);
            let turn: Quaternion = std::array::from_fn(|j| from_matrix[j] + gradient.turn[j]);
            // The length of the quaternion does not matter.
            let along = dot(turn, pose.turn);
            let turn: Quaternion = std::array::from_fn(|j| (turn[j] - along * pose.turn[j]) / pose.length);
            for (out, &weight) in out.chunks_exact_mut(MOTION).zip(&functions) {
                out[..3].copy_from_slice(&(gradient.shift * (weight * self.unit)).to_array());
                out[3..].copy_from_slice(&turn.map(|v| v * weight));
            }
        }
    }

    /// Spreads `count` nodes over `points` (each as far from the others as it can be), that move as the
    /// present ones move those places.
    pub(crate) fn spread(&self, points: &[[f32; 3]], count: usize) -> Self {
        let places = farthest_points(points, count);
        let functions = self.basis.len();
        let motion = if self.is_empty() {
            vec![0.0; MOTION * functions * places.len()]
        } else {
            self.motion_at(&places)
        };
        let near = nearest(&places, &places, NEIGHBOURS + 1);
        let distance =
            |a: usize, b: u32| Vec3::from_array(places[a]).distance(Vec3::from_array(places[b as usize]));
        let falloff = near.iter().enumerate().map(|(node, near)| {
            let around = &near[1.min(near.len())..FOLLOWED.min(near.len())];
            let mean = around.iter().map(|&other| distance(node, other)).sum::<f32>();
            let radius = mean / around.len().max(1) as f32;
            1.0 / (radius * radius).max(1e-8)
        });
        Self {
            basis: self.basis.clone(),
            unit: self.unit,
            falloff: falloff.collect(),
            neighbours: near.iter().map(|near| near[1.min(near.len())..].to_vec()).collect(),
            motion: Parameter::new(MOTION * functions, motion),
            places,
        }
    }

    /// Functions of the finest spline over time.
    pub(crate) fn finest(&self) -> usize {
        self.basis.finest()
    }

    /// The same motion over a basis with one more spline, of `count` functions: finer motion can then be
    /// learnt. What Adam remembers is forgotten.
    pub(crate) fn refine_time(&mut self, count: usize) {
        let (before, nodes) = (MOTION * self.basis.len(), self.len());
        self.basis = self.basis.with(count);
        let width = MOTION * self.basis.len();
        let mut motion = vec![0.0; width * nodes];
        for (to, from) in motion.chunks_exact_mut(width).zip(self.motion.values().chunks_exact(before)) {
            to[..before].copy_from_slice(from);
        }
        self.motion = Parameter::new(width, motion);
    }

    /// Motions of nodes at other places: those of the present nodes there.
    fn motion_at(&self, places: &[[f32; 3]]) -> Vec<f32> {
        let followed = self.followed(places);
        let functions = self.basis.len();
        let instants = 4 * functions;
        let mut samples = Vec::with_capacity(instants);
        for instant in 0..instants {
            let poses = self.poses(instant as f32 / (instants - 1) as f32);
            let mut sample = Vec::with_capacity(MOTION * places.len());
            for (place, followed) in places.iter().zip(&followed) {
                let place = Vec3::from_array(*place);
                let weights = node_weights(place, followed, &[0.0; FOLLOWED], self, &poses);
                let mut sum = [0.0f32, 0.0, 0.0, -1.0, 0.0, 0.0, 0.0];
                for (weight, &node) in weights.iter().zip(followed) {
                    let pose = &poses[node as usize];
                    let shift = (pose.carry(place) - place) / self.unit;
                    let turn = pose.turn.map(|v| v * pose.length);
                    let all = shift.to_array().into_iter().chain(turn);
                    sum.iter_mut().zip(all).for_each(|(sum, v)| *sum += weight * v);
                }
                sample.extend(sum.map(f64::from));
            }
            samples.push(sample);
        }
        let fitted = self.basis.fit(&samples);
        let of_node = |node: usize| {
            fitted.iter().flat_map(move |values| values[MOTION * node..][..MOTION].iter().map(|&v| v as f32))
        };
        (0..places.len()).flat_map(of_node).collect()
    }

    /// The nodes that each point follows; of fewer nodes than [`FOLLOWED`], the last again.
    pub(crate) fn followed(&self, points: &[[f32; 3]]) -> Vec<[u32; FOLLOWED]> {
        nearest(points, &self.places, FOLLOWED)
            .into_iter()
            .map(|near| std::array::from_fn(|k| near.get(k).or(near.last()).copied().unwrap_or(0)))
            .collect()
    }

    /// What keeps neighbours moving rigidly: adds `weight` times its gradient to that of the poses.
    pub(crate) fn keep_rigid(&self, weight: f32, poses: &[NodePose], gradients: &mut [NodeGradient]) {
        super::rigidity::add_gradient(self, weight, poses, gradients);
    }

    /// Whether what was read from a file can be used.
    pub(crate) fn is_sound(&self) -> bool {
        let count = self.places.len();
        self.unit.is_finite()
            && self.basis.is_sound()
            && self.falloff.len() == count
            && self.neighbours.len() == count
            && self.neighbours.iter().flatten().all(|&node| (node as usize) < count)
            && self.places.iter().flatten().chain(&self.falloff).all(|v| v.is_finite())
            && (count == 0 || self.motion.is_sound(MOTION * self.basis.len(), count))
    }

    /// Takes a step of the motion.
    pub(crate) fn step(&mut self, step: crate::train::parameter::AdamStep) {
        self.motion.step(step);
    }

    /// Poses blended by the skin: see [`Skinned`].
    pub(crate) fn skin<'a>(&'a self, poses: &'a [NodePose]) -> Skinned<'a> {
        Skinned { nodes: self, poses }
    }
}

/// `count` of the points, each the one farthest from those before; the first is the one nearest to their
/// mean.
fn farthest_points(points: &[[f32; 3]], count: usize) -> Vec<[f32; 3]> {
    let vectors: Vec<Vec3> = points.iter().map(|p| Vec3::from_array(*p)).collect();
    let mean = vectors.iter().sum::<Vec3>() / vectors.len().max(1) as f32;
    let lowest = |values: &[f32]| (0..values.len()).min_by(|&a, &b| values[a].total_cmp(&values[b]));
    let from_mean: Vec<f32> = vectors.iter().map(|p| p.distance_squared(mean)).collect();
    let mut at = lowest(&from_mean);
    let mut distances = vec![f32::MAX; vectors.len()];
    let mut chosen = Vec::with_capacity(count.min(points.len()));
    while let Some(index) = at {
        if chosen.len() >= count.min(points.len()) {
            break;
        }
        chosen.push(points[index]);
        let place = vectors[index];
        distances
            .par_iter_mut()
            .with_min_len(8192)
            .zip(&vectors)
            .for_each(|(distance, p)| *distance = distance.min(p.distance_squared(place)));
        at = (0..distances.len()).max_by(|&a, &b| distances[a].total_cmp(&distances[b]));
    }
    chosen
}

/// Of each point, the indices of the `count` nearest `places`, nearest first; of equal ones the first.
fn nearest(points: &[[f32; 3]], places: &[[f32; 3]], count: usize) -> Vec<Vec<u32>> {
    let tree = Tree::new(places);
    let of_point = |point: &[f32; 3]| {
        tree.nearest(*point, count, |_| true).into_iter().map(|(_, index)| index as u32).collect()
    };
    points.par_iter().with_min_len(256).map(of_point).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(count: usize) -> Vec<[f32; 3]> {
        let at = |i: usize, k: f32| ((i as f32 * k).sin() * 43758.547).fract();
        (0..count).map(|i| [at(i, 12.9), at(i, 78.2), at(i, 37.7)]).collect()
    }

    #[test]
    fn a_finer_basis_moves_nodes_as_before_and_can_do_more() {
        let mut nodes = ControlNodes::none(TemporalBasis::new(&[4, 8]), 1.3).spread(&cloud(60), 7);
        for (i, v) in nodes.motion.values_mut().iter_mut().enumerate() {
            *v = 0.3 * (i as f32 * 1.3).sin();
        }
        let mut finer = nodes.clone();
        finer.refine_time(16);
        assert_eq!((nodes.finest(), finer.finest()), (8, 16));
        assert!(finer.is_sound());
        let shift =
            |nodes: &ControlNodes, time: f32| nodes.poses(time).iter().map(|pose| pose.shift).collect();
        for time in [0.0, 0.31, 0.8, 1.0] {
            let (before, after): (Vec<Vec3>, Vec<Vec3>) = (shift(&nodes, time), shift(&finer, time));
            assert_eq!(before, after);
        }
        // A function of the new spline is nobody else's.
        let last = finer.motion.width() - MOTION;
        finer.motion.item_mut(3)[last] = 0.5;
        let (before, after): (Vec<Vec3>, Vec<Vec3>) = (shift(&nodes, 1.0), shift(&finer, 1.0));
        assert!(before[3] != after[3] && before[2] == after[2]);
    }

    #[test]
    fn nodes_spread_further_than_by_chance() {
        let points = cloud(500);
        let chosen = farthest_points(&points, 20);
        let closest = |places: &[[f32; 3]]| {
            let near = nearest(places, places, 2);
            let pairs = near.iter().enumerate().map(|(i, near)| {
                Vec3::from_array(places[i]).distance(Vec3::from_array(places[near[1] as usize]))
            });
            pairs.fold(f32::MAX, f32::min)
        };
        assert_eq!(chosen.len(), 20);
        assert!(closest(&chosen) > 2.0 * closest(&points[..20]));
    }

    #[test]
    fn more_nodes_move_as_the_fewer_did() {
        let points = cloud(400);
        let mut few = ControlNodes::none(TemporalBasis::default(), 1.3).spread(&points, 8);
        for (i, v) in few.motion_mut().values_mut().iter_mut().enumerate() {
            *v = 0.02 * (i as f32 * 0.37).sin();
        }
        // A node at the same place, so the same neighbours: its motion is that of the old ones there.
        let many = few.spread(&points, 60);
        for time in [0.0, 0.31, 0.9] {
            let (old, new) = (few.poses(time), many.poses(time));
            let followed = few.followed(&many.places);
            for (pose, followed) in new.iter().zip(&followed) {
                let weights = node_weights(pose.place, followed, &[0.0; FOLLOWED], &few, &old);
                let there: Vec3 = weights
                    .iter()
                    .zip(followed)
                    .map(|(w, &node)| *w * old[node as usize].carry(pose.place))
                    .sum();
                let error = (pose.place + pose.shift - there).length();
                assert!(error < 2e-3, "{time}: {error}");
            }
        }
    }
}
