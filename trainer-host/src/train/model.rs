//! A model is a scene under training: Gaussians at the canonical instant and the nodes that move them.

use codec_core::Footprint;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use super::{
    gaussians::TrainedGaussians,
    motion::{ControlNodes, FOLLOWED, MovedPoint, Trajectory, trajectory_times},
    moving_region::MovingRegion,
    parameter::Parameter,
};
use crate::scene::{Attributes, Epoch, Instant, Scene, SceneError, Track, footprint_name};

/// A scene that can be posed at any time from 0 to 1.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct Model {
    pub(super) gaussians: TrainedGaussians,
    pub(super) nodes: ControlNodes,
    /// Nodes that each Gaussian follows; none of those that stand still.
    pub(super) followed: Vec<Option<[u32; FOLLOWED]>>,
    /// How the Gaussians are drawn.
    #[serde(with = "footprint_name")]
    pub(super) footprint: Footprint,
}

impl Model {
    /// Number of Gaussians.
    pub fn gaussians(&self) -> usize {
        self.gaussians.len()
    }

    /// Number of control nodes.
    pub fn nodes(&self) -> usize {
        self.nodes.len()
    }

    /// The Gaussians at `time` (0 to 1), into memory that is used again.
    pub fn instant_into(&self, time: f32, out: &mut Instant) {
        let poses = self.nodes.poses(time);
        self.gaussians.pose_into(&self.nodes.skin(&poses), &self.followed, out);
    }

    /// As [`Model::instant_into`], of `gaussians` in place of its own.
    pub(super) fn instant_of(&self, gaussians: &TrainedGaussians, time: f32, out: &mut Instant) {
        let poses = self.nodes.poses(time);
        gaussians.pose_into(&self.nodes.skin(&poses), &self.followed, out);
    }

    /// The clip as `frames` frames, evenly spread over it from the first instant to the last.
    ///
    /// # Errors
    /// No frames, a frame rate that is not positive, or a Gaussian that is not finite.
    pub fn scene(&self, frames: usize, frames_per_second: f64) -> Result<Scene, SceneError> {
        let instants: Vec<Instant> = (0..frames)
            .into_par_iter()
            .map(|frame| {
                let mut instant = Instant::default();
                self.instant_into(frame as f32 / frames.saturating_sub(1).max(1) as f32, &mut instant);
                instant
            })
            .collect();
        let all = || instants.iter().flat_map(|instant| &instant.gaussians);
        let values = &self.gaussians;
        let attributes = Attributes {
            positions: Track::PerFrame(all().map(|g| g.position).collect()),
            rotations: Track::PerFrame(all().map(|g| g.rotation).collect()),
            log_scales: Track::Constant(values.log_scale.values().as_chunks().0.to_vec()),
            opacity_logits: Track::Constant(values.opacity.values().to_vec()),
            sh0: Track::Constant(values.sh0.values().as_chunks().0.to_vec()),
            sh_rest: values.sh_rest.values().to_vec(),
            sh_degree: codec_core::ShDegree::new(values.degree).unwrap_or_default(),
        };
        let mut scene = Scene::new(vec![Epoch::new(frames, attributes)?], frames_per_second)?;
        scene.footprint = self.footprint;
        Ok(scene)
    }

    /// All that is trained: the attributes of the Gaussians, then the motion of each layer of nodes.
    pub(super) fn parameters(&self) -> impl Iterator<Item = &Parameter> {
        self.gaussians.parameters().into_iter().chain(self.nodes.motions())
    }

    /// As [`Model::parameters`], to be changed from outside a step.
    pub(super) fn parameters_mut(&mut self) -> impl Iterator<Item = &mut Parameter> {
        self.gaussians.parameters_mut().into_iter().chain(self.nodes.motions_mut())
    }

    /// Keeps the Gaussians of these indices, in this order.
    pub(super) fn select(&mut self, indices: &[usize]) {
        self.gaussians.select(indices, indices.len());
        self.followed = indices.iter().map(|&index| self.followed[index]).collect();
    }

    /// Adds a layer of `count` nodes that move as the Gaussians do that they stand at; Gaussians follow those
    /// nearest to them over the clip. Where it is known in which space something moves, Gaussians outside of
    /// it stand still.
    pub(super) fn spread_nodes(&mut self, count: usize, changing: Option<&MovingRegion>) {
        // A space that no Gaussian is in does not tell which of them move.
        let is_in =
            |changing: &&MovingRegion| self.gaussians.positions().iter().any(|&p| changing.contains(p));
        let changing = changing.filter(is_in);
        if let Some(changing) = changing {
            self.follow_where(changing);
        }
        let trajectories = self.trajectories();
        let poses = self.nodes.poses(0.0);
        let skin = self.nodes.skin(&poses);
        let point = |index: usize| MovedPoint {
            place: self.gaussians.positions()[index],
            followed: self.gaussians.follows(index, &skin, &self.followed),
            trajectory: trajectories[index],
        };
        let opacity = self.gaussians.opacity.values();
        // Those that stand still need none.
        let moves = |index: &usize| {
            let may_move =
                || changing.is_none_or(|changing| changing.contains(self.gaussians.positions()[*index]));
            if self.nodes.is_empty() { may_move() } else { self.followed[*index].is_some() }
        };
        let moving: Vec<usize> = (0..self.gaussians.len()).filter(moves).collect();
        let visible = moving.iter().copied().filter(|&index| opacity[index] > VISIBLE);
        let mut points: Vec<MovedPoint> = visible.map(point).collect();
        if points.is_empty() {
            points = moving.iter().copied().map(point).collect();
        }
        if points.is_empty() {
            return;
        }
        self.nodes = std::mem::take(&mut self.nodes).spread(&points, count);
        if !self.nodes.is_empty() {
            let nearest = self.nodes.followed(&trajectories);
            moving.into_iter().for_each(|index| self.followed[index] = Some(nearest[index]));
        }
        // Corrections were of other nodes, and so were their gradients.
        self.gaussians.skin = Parameter::new(FOLLOWED, vec![0.0; FOLLOWED * self.gaussians.len()]);
    }

    /// Lets those Gaussians follow nodes that are where something moves, and no others.
    fn follow_where(&mut self, changing: &MovingRegion) {
        if self.nodes.is_empty() {
            return;
        }
        let nearest = self.nodes.followed(&self.trajectories());
        for (index, followed) in self.followed.iter_mut().enumerate() {
            let moves = changing.contains(self.gaussians.positions()[index]);
            *followed = if moves { followed.or(Some(nearest[index])) } else { None };
        }
    }

    /// Where each Gaussian is over the clip.
    pub(super) fn trajectories(&self) -> Vec<Trajectory> {
        let mut trajectories: Vec<Trajectory> = self.gaussians.positions().iter().map(|&p| [p; _]).collect();
        if self.nodes.is_empty() {
            return trajectories;
        }
        let mut posed = Instant::default();
        for (instant, time) in trajectory_times().enumerate() {
            self.instant_into(time, &mut posed);
            let moved = trajectories.iter_mut().zip(&posed.gaussians);
            moved.for_each(|(trajectory, g)| trajectory[instant] = g.position);
        }
        trajectories
    }

    /// Whether what was read from a file can be used.
    pub(super) fn is_sound(&self) -> bool {
        let nodes = self.nodes.len();
        self.gaussians.is_sound()
            && self.nodes.is_sound()
            && self.followed.len() == self.gaussians.len()
            && self.followed.iter().flatten().flatten().all(|&node| (node as usize) < nodes)
    }
}

/// Nodes stand among Gaussians of at least this logit (10 %).
const VISIBLE: f32 = -2.2;
