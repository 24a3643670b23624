//! Control nodes hold the motion of a scene, in layers from few nodes to many.
//!
//! Each layer moves with the one before and adds to it, so that what moves as one body keeps being moved by
//! few numbers, which many views agree on, and only what is left is learnt node by node.

use serde::{Deserialize, Serialize};

use super::{
    FOLLOWED, TemporalBasis,
    layer::{Layer, MovedPoint, NodeGradient, NodePose},
    rigidity,
    skinning::Skinned,
    smoothness, stillness,
    trajectory::{self, Trajectory},
};
use crate::train::parameter::{AdamStep, Parameter};

/// Learning rate of a layer, of that of the next finer one.
const COARSER_RATE: f32 = 0.3;
/// Most layers.
const MAX_LAYERS: usize = 8;

/// Places and motions of control nodes.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct ControlNodes {
    /// Of layers to come.
    basis: TemporalBasis,
    /// Scene units per unit of shift.
    unit: f32,
    /// Gaussians follow the last.
    layers: Vec<Layer>,
}

/// Every node at an instant, layer by layer.
#[derive(Clone, Debug, Default)]
pub(crate) struct NodePoses(Vec<Vec<NodePose>>);

impl NodePoses {
    /// Poses of the nodes that Gaussians follow.
    fn last(&self) -> &[NodePose] {
        self.0.last().map_or(&[], Vec::as_slice)
    }
}

impl ControlNodes {
    /// No nodes: nothing moves.
    pub(crate) fn none(basis: TemporalBasis, unit: f32) -> Self {
        Self { basis, unit, layers: Vec::new() }
    }

    /// Nodes that Gaussians follow.
    pub(crate) fn len(&self) -> usize {
        self.layers.last().map_or(0, Layer::len)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.len() == 0
    }

    /// Every node at `time` (0 to 1).
    pub(crate) fn poses(&self, time: f32) -> NodePoses {
        let mut poses = NodePoses::default();
        for layer in &self.layers {
            let of_layer = layer.poses(time, poses.last());
            poses.0.push(of_layer);
        }
        poses
    }

    /// Writes the gradient of the motion from those of the poses, at `time`, of the nodes that Gaussians
    /// follow.
    pub(crate) fn backward(&mut self, time: f32, poses: &NodePoses, gradients: Vec<NodeGradient>) {
        let mut gradients = gradients;
        for (index, layer) in self.layers.iter_mut().enumerate().rev() {
            let before = index.checked_sub(1).map_or(&[][..], |before| &poses.0[before]);
            let mut of_before = vec![NodeGradient::ZERO; before.len()];
            layer.backward(time, &poses.0[index], &gradients, (before, &mut of_before));
            gradients = of_before;
        }
    }

    /// The same with a layer of `count` nodes more, spread over `points` (each as far from the others as it
    /// can be, over the clip), that move as the points do.
    pub(crate) fn spread(mut self, points: &[MovedPoint], count: usize) -> Self {
        let all: Vec<Trajectory> = points.iter().map(|point| point.trajectory).collect();
        let chosen: Vec<MovedPoint> =
            trajectory::farthest(&all, count).into_iter().map(|index| points[index]).collect();
        let is_first = self.layers.is_empty();
        self.layers.push(Layer::new(&chosen, self.basis.clone(), self.unit, is_first));
        self
    }

    /// Functions of the finest spline over time.
    pub(crate) fn finest(&self) -> usize {
        self.layers.last().map_or(0, |layer| layer.basis().finest())
    }

    /// The same motion, which can learn to change faster; see [`Layer::refine_time`]. Layers that have a
    /// spline of `count` functions stay as they are.
    pub(crate) fn refine_time(&mut self, count: usize) {
        let coarse = self.layers.iter_mut().filter(|layer| layer.basis().finest() < count);
        coarse.for_each(|layer| layer.refine_time(count));
    }

    /// Where each node is over the clip.
    fn trajectories(&self) -> Vec<Trajectory> {
        let mut trajectories = vec![Trajectory::default(); self.len()];
        for (instant, time) in trajectory::times().enumerate() {
            for (trajectory, pose) in trajectories.iter_mut().zip(self.poses(time).last()) {
                trajectory[instant] = (pose.place + pose.shift).to_array();
            }
        }
        trajectories
    }

    /// The nodes that each point follows, those nearest to it over the clip; of fewer nodes than
    /// [`FOLLOWED`], the last again.
    pub(crate) fn followed(&self, points: &[Trajectory]) -> Vec<[u32; FOLLOWED]> {
        trajectory::nearest(points, &self.trajectories(), FOLLOWED)
            .into_iter()
            .map(|near| std::array::from_fn(|k| near.get(k).or(near.last()).copied().unwrap_or(0)))
            .collect()
    }

    /// What keeps neighbours moving rigidly: adds `weight` times its gradient to that of the poses.
    pub(crate) fn add_rigidity_gradient(
        &self,
        weight: f32,
        poses: &NodePoses,
        gradients: &mut [NodeGradient],
    ) {
        if let Some(layer) = self.layers.last() {
            rigidity::add_gradient(layer, weight, poses.last(), gradients);
        }
    }

    /// What keeps nodes where they are: adds `weight` times its gradient to that of the poses.
    pub(crate) fn add_stillness_gradient(
        &self,
        weight: f32,
        poses: &NodePoses,
        gradients: &mut [NodeGradient],
    ) {
        stillness::add_gradient(weight, self.unit, poses.last(), gradients);
    }

    /// What keeps motion even over time: adds `weight` times its gradient at `time` to that of the motion.
    pub(crate) fn add_smoothness_gradient(&mut self, weight: f32, time: f32) {
        self.layers.iter_mut().for_each(|layer| smoothness::add_gradient(layer, weight, time));
    }

    /// Whether what was read from a file can be used.
    pub(crate) fn is_sound(&self) -> bool {
        let mut before = None;
        self.unit.is_finite()
            && self.basis.is_sound()
            && self.layers.len() <= MAX_LAYERS
            && self.layers.iter().all(|layer| layer.is_sound(before.replace(layer.len())))
    }

    /// The motion of each layer.
    pub(crate) fn motions(&self) -> impl Iterator<Item = &Parameter> {
        self.layers.iter().map(Layer::motion)
    }

    /// As [`ControlNodes::motions`], to be changed from outside a step.
    pub(crate) fn motions_mut(&mut self) -> impl Iterator<Item = &mut Parameter> {
        self.layers.iter_mut().map(Layer::motion_mut)
    }

    /// Takes a step of the motion; each layer numbers its own. Layers add up, and so does the noise of their
    /// steps: the last learns at the rate of `step`, each before it at [`COARSER_RATE`] of the next one's.
    pub(crate) fn step(&mut self, step: AdamStep) {
        let mut rate = step.rate;
        for layer in self.layers.iter_mut().rev() {
            layer.step(AdamStep { rate, ..step });
            rate *= COARSER_RATE;
        }
    }

    /// Poses blended by the skin: see [`Skinned`].
    pub(crate) fn skin<'a>(&'a self, poses: &'a NodePoses) -> Skinned<'a> {
        Skinned { falloff: self.layers.last().map_or(&[], Layer::falloff), poses: poses.last() }
    }
}

#[cfg(test)]
mod tests {
    use glam::Vec3;

    use super::*;
    use crate::train::motion::{Followed, layer::MOTION};

    fn cloud(count: usize) -> Vec<MovedPoint> {
        let at = |i: usize, k: f32| ((i as f32 * k).sin() * 43758.547).fract();
        (0..count).map(|i| MovedPoint::at_rest([at(i, 12.9), at(i, 78.2), at(i, 37.7)])).collect()
    }

    fn set_in_motion(layer: &mut Layer, amount: f32) {
        for (i, v) in layer.motion_mut().values_mut().iter_mut().enumerate() {
            *v = amount * (i as f32 * 1.3).sin();
        }
    }

    /// Nodes in two layers that both move.
    fn layered() -> ControlNodes {
        let mut points = cloud(60);
        let mut nodes = ControlNodes::none(TemporalBasis::new(&[4, 6]), 1.3).spread(&points, 7);
        set_in_motion(&mut nodes.layers[0], 0.3);
        let follows = nodes.followed(&points.iter().map(|point| point.trajectory).collect::<Vec<_>>());
        for (point, nodes) in points.iter_mut().zip(follows) {
            point.followed = Followed { nodes, weights: [0.4, 0.3, 0.2, 0.1] };
        }
        let mut nodes = nodes.spread(&points, 20);
        set_in_motion(&mut nodes.layers[1], 0.1);
        nodes
    }

    fn shifts(nodes: &ControlNodes, time: f32) -> Vec<Vec3> {
        nodes.poses(time).last().iter().map(|pose| pose.shift).collect()
    }

    #[test]
    fn a_finer_basis_moves_nodes_as_before_and_can_do_more() {
        let nodes = layered();
        let mut finer = nodes.clone();
        finer.refine_time(16);
        assert_eq!((nodes.finest(), finer.finest()), (6, 16));
        assert!(finer.is_sound());
        let mut again = finer.clone();
        again.refine_time(16);
        assert!(again == finer);
        for time in [0.0, 0.31, 0.8, 1.0] {
            assert_eq!(shifts(&nodes, time), shifts(&finer, time));
        }
        // A function of the new spline is nobody else's.
        let last = finer.layers[1].motion_mut().width() - MOTION;
        finer.layers[1].motion_mut().item_mut(3)[last] = 0.5;
        let (before, after) = (shifts(&nodes, 1.0), shifts(&finer, 1.0));
        assert!(before[3] != after[3] && before[2] == after[2]);
    }

    #[test]
    fn a_new_layer_moves_as_the_one_before_did() {
        let mut nodes = layered();
        nodes.layers[1].motion_mut().values_mut().fill(0.0);
        for time in [0.0, 0.31, 0.9] {
            let poses = nodes.poses(time);
            for pose in poses.last() {
                let point = cloud(60).into_iter().find(|point| Vec3::from_array(point.place) == pose.place);
                let near = nodes.clone();
                let first = ControlNodes { layers: near.layers[..1].to_vec(), ..near };
                let follows = first.followed(&[point.unwrap().trajectory])[0];
                let moved = follows.map(|node| poses.0[0][node as usize].carry(pose.place));
                let there: Vec3 = moved.into_iter().zip([0.4, 0.3, 0.2, 0.1]).map(|(p, w)| p * w).sum();
                assert!((pose.place + pose.shift - there).length() < 1e-5, "{time}");
            }
        }
    }

    /// A loss of the last layer's poses that every number of them takes part in.
    fn value(nodes: &ControlNodes, time: f32) -> f64 {
        let poses = nodes.poses(time);
        let numbers = poses.last().iter().flat_map(|pose| pose.shift.to_array().into_iter().chain(pose.turn));
        numbers.enumerate().map(|(i, v)| f64::from(v) * (0.7 * i as f64).cos()).sum()
    }

    #[test]
    fn gradients_of_all_layers_are_difference_quotients() {
        let (mut nodes, time) = (layered(), 0.37);
        let poses = nodes.poses(time);
        let weight = |i: usize| (0.7 * i as f64).cos() as f32;
        let of_node = |node: usize| NodeGradient {
            shift: Vec3::from_array(std::array::from_fn(|j| weight(MOTION * node + j))),
            turn: std::array::from_fn(|j| weight(MOTION * node + 3 + j)),
            ..NodeGradient::ZERO
        };
        let gradients = (0..nodes.len()).map(of_node).collect();
        nodes.backward(time, &poses, gradients);
        for layer in 0..2 {
            let found = nodes.layers[layer].motion_mut().gradient_mut().to_vec();
            let largest = found.iter().fold(0.0f32, |a, v| a.max(v.abs()));
            for index in (0..found.len()).step_by(7) {
                let at = |change: f32| {
                    let mut changed = nodes.clone();
                    changed.layers[layer].motion_mut().values_mut()[index] += change;
                    value(&changed, time)
                };
                let expected = (8.0 * (at(1e-2) - at(-1e-2)) - (at(2e-2) - at(-2e-2))) / 0.12;
                let error = (f64::from(found[index]) - expected).abs() / f64::from(largest);
                assert!(error < 2e-3, "layer {layer}, {index}: {} {expected}", found[index]);
            }
        }
    }

    #[test]
    fn nodes_that_do_not_fit_together_are_not_sound() {
        let nodes = layered();
        assert!(nodes.is_sound());
        let mut swapped = nodes.clone();
        swapped.layers.swap(0, 1);
        let mut alone = nodes.clone();
        alone.layers.remove(0);
        assert!(!swapped.is_sound() && !alone.is_sound());
    }
}
