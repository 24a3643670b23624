//! Evaluates node hierarchy and animation: where every node is at a time of the clip.

use glam::{DMat4, DQuat, DVec3, DVec4};
use gltf::animation::{Interpolation, Property};

use super::document::{Document, FORMAT, too_large};
use crate::scene::import::{
    Limits,
    error::{ErrorKind, ImportError},
};

/// Which animation of a file to play.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub enum Clip {
    /// The first, or the mesh as it stands if there is none.
    #[default]
    First,
    /// By place in the file, from 0.
    Index(usize),
    /// By name.
    Name(String),
}

/// A node's own transform.
#[derive(Clone, Copy)]
struct Local {
    translation: DVec3,
    rotation: DQuat,
    scale: DVec3,
    /// Nodes given as a matrix are not animated.
    matrix: Option<DMat4>,
}

/// What a channel drives, and its keys: `width` values per key, three times that for cubic splines.
struct Channel {
    node: usize,
    property: Property,
    interpolation: Interpolation,
    times: Vec<f32>,
    values: Vec<f32>,
    width: usize,
}

/// The hierarchy with the channels of one clip.
pub(super) struct Rig {
    locals: Vec<Local>,
    parents: Vec<Option<usize>>,
    /// Parents before children.
    order: Vec<usize>,
    /// Nodes of the scene that is shown.
    pub visible: Vec<bool>,
    weights: Vec<Vec<f32>>,
    channels: Vec<Channel>,
    name: String,
}

/// All nodes at one time.
pub(super) struct Pose {
    /// Node to world.
    pub world: Vec<DMat4>,
    /// Morph weights of each node.
    pub weights: Vec<Vec<f32>>,
}

impl Rig {
    /// The hierarchy of `document` driven by `clip`.
    ///
    /// # Errors
    /// Nodes that are no tree, an unknown clip, channels that contradict themselves, or more than `limits`
    /// allow.
    pub fn new(document: &Document, clip: &Clip, limits: &Limits) -> Result<Self, ImportError> {
        let gltf = &document.gltf;
        let nodes = gltf.nodes().len();
        let mut parents = vec![None; nodes];
        for node in gltf.nodes() {
            for child in node.children() {
                if parents[child.index()].replace(node.index()).is_some() {
                    return Err(FORMAT.malformed(format!("node {}", child.index()), "two parents", "one"));
                }
            }
        }
        let order = topological(&parents)
            .ok_or_else(|| FORMAT.malformed("nodes", "a node that is its own ancestor", "a tree"))?;
        let mut visible = vec![false; nodes];
        match gltf.default_scene().or_else(|| gltf.scenes().next()) {
            Some(scene) => scene.nodes().for_each(|n| visible[n.index()] = true),
            None => (0..nodes).for_each(|n| visible[n] = parents[n].is_none()),
        }
        for &node in &order {
            visible[node] |= parents[node].is_some_and(|p| visible[p]);
        }
        let locals = gltf.nodes().map(|n| Local::new(n.transform())).collect();
        let mut weights = Vec::with_capacity(nodes);
        let mut total = 0;
        for node in gltf.nodes() {
            let own = node.weights().or(node.mesh().and_then(|m| m.weights())).unwrap_or_default();
            total += own.len();
            if total > limits.max_gaussians {
                return Err(too_large("morph weights", total, limits.max_gaussians));
            }
            weights.push(own.to_vec());
        }
        let mut rig =
            Self { locals, parents, order, visible, weights, channels: Vec::new(), name: "none".to_owned() };
        rig.choose(document, clip)?;
        Ok(rig)
    }

    fn choose(&mut self, document: &Document, clip: &Clip) -> Result<(), ImportError> {
        let mut animations = document.gltf.animations();
        let chosen = match clip {
            Clip::First => animations.next(),
            Clip::Index(index) => animations.nth(*index),
            Clip::Name(name) => animations.find(|a| a.name() == Some(name)),
        };
        let Some(animation) = chosen else {
            return match clip {
                Clip::First => Ok(()),
                Clip::Index(index) => {
                    Err(FORMAT.error(ErrorKind::NotFound, "clip", index, document.clip_list()))
                }
                Clip::Name(name) => {
                    let name = format!("{name:?}");
                    Err(FORMAT.error(ErrorKind::NotFound, "clip", name, document.clip_list()))
                }
            };
        };
        self.name = animation.name().map_or_else(|| animation.index().to_string(), str::to_owned);
        for channel in animation.channels() {
            let node = channel.target().node().index();
            if self.locals[node].matrix.is_some()
                && channel.target().property() != Property::MorphTargetWeights
            {
                return Err(FORMAT.malformed(
                    format!("animated node {node}"),
                    "a matrix",
                    "translation, rotation, scale",
                ));
            }
            self.channels.push(Channel::new(document, &channel, self.weights[node].len())?);
        }
        Ok(())
    }

    /// Name or number of the clip, or "none".
    pub fn clip_name(&self) -> &str {
        &self.name
    }

    /// The times frames are evaluated at: from the first key on, one every `1 / fps`, up to the last.
    pub fn frame_times(&self, fps: f64, limits: &Limits) -> Result<Vec<f64>, ImportError> {
        let keys = || self.channels.iter().flat_map(|c| c.times.first().into_iter().chain(c.times.last()));
        let start = f64::from(keys().copied().fold(f32::INFINITY, f32::min));
        let end = f64::from(keys().copied().fold(f32::NEG_INFINITY, f32::max));
        if end <= start {
            return Ok(vec![if start.is_finite() { start } else { 0.0 }]);
        }
        let frames = ((end - start) * fps + 1e-6).floor() + 1.0;
        if frames > limits.max_gaussians as f64 {
            return Err(too_large("frames", frames, limits.max_gaussians));
        }
        Ok((0..frames as usize).map(|i| start + i as f64 / fps).collect())
    }

    /// The pose at `time`.
    pub fn at(&self, time: f64) -> Pose {
        let mut locals = self.locals.clone();
        let mut weights = self.weights.clone();
        for channel in &self.channels {
            let v = channel.at(time);
            let local = &mut locals[channel.node];
            match (channel.property, &v[..]) {
                (Property::Translation, &[x, y, z]) => local.translation = DVec3::new(x, y, z),
                (Property::Scale, &[x, y, z]) => local.scale = DVec3::new(x, y, z),
                (Property::Rotation, &[x, y, z, w]) => local.rotation = unit(DVec4::new(x, y, z, w)),
                _ => weights[channel.node] = v.iter().map(|&w| w as f32).collect(),
            }
        }
        let mut world = vec![DMat4::IDENTITY; locals.len()];
        for &node in &self.order {
            let parent = self.parents[node].map_or(DMat4::IDENTITY, |p| world[p]);
            world[node] = parent * locals[node].matrix();
        }
        Pose { world, weights }
    }
}

impl Local {
    fn new(transform: ::gltf::scene::Transform) -> Self {
        let matrix = match &transform {
            ::gltf::scene::Transform::Matrix { matrix } => {
                Some(DMat4::from_cols_array_2d(&matrix.map(|c| c.map(f64::from))))
            }
            ::gltf::scene::Transform::Decomposed { .. } => None,
        };
        let (t, r, s) = match transform {
            ::gltf::scene::Transform::Decomposed { translation, rotation, scale } => {
                (translation, rotation, scale)
            }
            ::gltf::scene::Transform::Matrix { .. } => ([0.0; 3], [0.0, 0.0, 0.0, 1.0], [1.0; 3]),
        };
        Self {
            translation: DVec3::from_array(t.map(f64::from)),
            rotation: unit(DVec4::from_array(r.map(f64::from))),
            scale: DVec3::from_array(s.map(f64::from)),
            matrix,
        }
    }

    fn matrix(&self) -> DMat4 {
        self.matrix.unwrap_or_else(|| {
            DMat4::from_scale_rotation_translation(self.scale, self.rotation, self.translation)
        })
    }
}

impl Channel {
    fn new(
        document: &Document,
        channel: &::gltf::animation::Channel<'_>,
        morphs: usize,
    ) -> Result<Self, ImportError> {
        let sampler = channel.sampler();
        let property = channel.target().property();
        let (components, width) = match property {
            Property::Translation | Property::Scale => (3, 3),
            Property::Rotation => (4, 4),
            Property::MorphTargetWeights => (1, morphs),
        };
        let times = document.floats(&sampler.input(), 1)?;
        let values = document.floats(&sampler.output(), components)?;
        let field = format!("animation channel {}", channel.index());
        let ordered = times.windows(2).all(|w| w[0] < w[1]) && times.iter().all(|t| t.is_finite());
        if times.is_empty() || !ordered {
            return Err(FORMAT.malformed(field, "key times that are none or do not rise", "rising times"));
        }
        let per_key = width * if sampler.interpolation() == Interpolation::CubicSpline { 3 } else { 1 };
        if values.len() != times.len().saturating_mul(per_key) {
            let allowed = format!("{} keys of {per_key}", times.len());
            return Err(FORMAT.malformed(field, format!("{} values", values.len()), allowed));
        }
        if values.iter().any(|v| !v.is_finite()) {
            return Err(FORMAT.malformed(field, "a value that is not finite", "finite values"));
        }
        let node = channel.target().node().index();
        Ok(Self { node, property, interpolation: sampler.interpolation(), times, values, width })
    }

    fn at(&self, time: f64) -> Vec<f64> {
        let cubic = self.interpolation == Interpolation::CubicSpline;
        let per_key = self.width * if cubic { 3 } else { 1 };
        // part 0: in-tangent, 1: value, 2: out-tangent; without splines there is the value alone.
        let key = |index: usize, part: usize| {
            let start = index * per_key + if cubic { part * self.width } else { 0 };
            self.values[start..start + self.width].iter().map(|&v| f64::from(v))
        };
        let after = self.times.partition_point(|&t| f64::from(t) <= time);
        let (Some(a), true) = (after.checked_sub(1), after < self.times.len()) else {
            return key(if after == 0 { 0 } else { after - 1 }, 1).collect();
        };
        let (t0, t1) = (f64::from(self.times[a]), f64::from(self.times[after]));
        let (span, s) = (t1 - t0, (time - t0) / (t1 - t0));
        match self.interpolation {
            Interpolation::Step => key(a, 1).collect(),
            Interpolation::Linear if self.property == Property::Rotation => {
                let q = |index| {
                    let mut v = key(index, 1);
                    let mut next = || v.next().unwrap_or(0.0);
                    unit(DVec4::new(next(), next(), next(), next()))
                };
                q(a).slerp(q(after), s).to_array().to_vec()
            }
            Interpolation::Linear => key(a, 1).zip(key(after, 1)).map(|(x, y)| x + (y - x) * s).collect(),
            Interpolation::CubicSpline => {
                let (s2, s3) = (s * s, s * s * s);
                let ends = key(a, 1).zip(key(after, 1));
                let tangents = key(a, 2).zip(key(after, 0));
                ends.zip(tangents)
                    .map(|((v0, v1), (m0, m1))| {
                        (2.0 * s3 - 3.0 * s2 + 1.0) * v0
                            + (s3 - 2.0 * s2 + s) * span * m0
                            + (3.0 * s2 - 2.0 * s3) * v1
                            + (s3 - s2) * span * m1
                    })
                    .collect()
            }
        }
    }
}

/// A quaternion of unit length; one without direction is the identity.
fn unit(v: DVec4) -> DQuat {
    v.try_normalize().map_or(DQuat::IDENTITY, DQuat::from_vec4)
}

/// Parents before children, or `None` if some node is its own ancestor.
fn topological(parents: &[Option<usize>]) -> Option<Vec<usize>> {
    let mut children = vec![Vec::new(); parents.len()];
    let mut order: Vec<usize> = Vec::with_capacity(parents.len());
    for (node, parent) in parents.iter().enumerate() {
        match parent {
            Some(p) => children[*p].push(node),
            None => order.push(node),
        }
    }
    let mut next = 0;
    while next < order.len() {
        order.extend_from_slice(&children[order[next]]);
        next += 1;
    }
    (order.len() == parents.len()).then_some(order)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn channel(interpolation: Interpolation, values: &[f32], width: usize) -> Channel {
        let (property, times) = (Property::Translation, vec![1.0, 3.0]);
        Channel { node: 0, property, interpolation, times, values: values.to_vec(), width }
    }

    #[test]
    fn keys_interpolate_and_clamp() {
        let linear = channel(Interpolation::Linear, &[0.0, 10.0], 1);
        assert_eq!([0.0, 1.0, 1.5, 3.0, 9.0].map(|t| linear.at(t)[0]), [0.0, 0.0, 2.5, 10.0, 10.0]);
        let step = channel(Interpolation::Step, &[0.0, 10.0], 1);
        assert_eq!([1.5, 2.999, 3.0].map(|t| step.at(t)[0]), [0.0, 0.0, 10.0]);
        // Tangents of the straight line 0..10 over 2 seconds give the straight line.
        let cubic = channel(Interpolation::CubicSpline, &[0.0, 0.0, 5.0, 5.0, 10.0, 0.0], 1);
        assert!((cubic.at(1.5)[0] - 2.5).abs() < 1e-12);
        assert_eq!(cubic.at(9.0)[0], 10.0);
        // Flat tangents give the smooth step.
        let cubic = channel(Interpolation::CubicSpline, &[0.0, 0.0, 0.0, 0.0, 10.0, 0.0], 1);
        assert!((cubic.at(1.5)[0] - 1.5625).abs() < 1e-12);
    }

    #[test]
    fn rotations_take_the_short_way() {
        let mut c = channel(Interpolation::Linear, &[0.0, 0.0, 0.0, 1.0, 0.0, 0.0, -1.0, 0.0], 4);
        c.property = Property::Rotation;
        let q = c.at(2.0);
        assert!((q[2].abs() - (0.5f64).sqrt()).abs() < 1e-9 && (q[3].abs() - (0.5f64).sqrt()).abs() < 1e-9);
    }

    #[test]
    fn rings_of_nodes_are_found() {
        assert_eq!(topological(&[None, Some(2), Some(1)]), None);
        assert_eq!(topological(&[Some(1), None]), Some(vec![1, 0]));
    }
}
