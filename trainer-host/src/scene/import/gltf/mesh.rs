//! Poses a mesh: moves vertices by node hierarchy, skin and morph targets.

use std::collections::BTreeMap;

use glam::{DMat4, DVec3};

use super::{
    document::{Document, FORMAT},
    pose::Pose,
};
use crate::scene::import::error::ImportError;

/// One primitive of one node: a range of vertices and what moves them.
pub(super) struct SkinnedPrimitive {
    pub node: usize,
    pub positions: Vec<DVec3>,
    /// Displacements per morph target.
    pub morphs: Vec<Vec<DVec3>>,
    pub skin: Option<Skin>,
}

/// The joints that move a primitive's vertices.
pub(super) struct Skin {
    /// Node and inverse bind matrix per joint.
    joints: Vec<(usize, DMat4)>,
    /// Up to eight (joint, weight) per vertex; weights sum to one.
    influences: Vec<[(u16, f32); 8]>,
}

/// Triangles whose vertices are those of all parts, in order.
#[derive(Default)]
pub(super) struct Mesh {
    pub parts: Vec<SkinnedPrimitive>,
    pub triangles: Vec<[u32; 3]>,
}

/// A number that stands for none.
const NONE: u32 = u32::MAX;

impl Mesh {
    /// World positions of all vertices in `pose`.
    pub fn posed(&self, pose: &Pose) -> Vec<DVec3> {
        let mut out = Vec::with_capacity(self.parts.iter().map(|p| p.positions.len()).sum());
        for part in &self.parts {
            part.posed(pose, &mut out);
        }
        out
    }

    /// The corners of a triangle among `vertices`.
    pub fn corners(&self, triangle: u32, vertices: &[DVec3]) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| vertices[v as usize])
    }

    /// A mesh of the `wanted` triangles and their vertices alone, and the number there of each of them:
    /// posing it takes no longer than what is wanted, however large the whole is.
    pub fn reduced(&self, wanted: impl Iterator<Item = u32>) -> (Self, Vec<u32>) {
        let mut triangles = Vec::new();
        let mut new_triangle = vec![NONE; self.triangles.len()];
        let mut renumbered = Vec::new();
        for triangle in wanted {
            let number = &mut new_triangle[triangle as usize];
            if *number == NONE {
                *number = triangles.len() as u32;
                triangles.push(self.triangles[triangle as usize]);
            }
            renumbered.push(*number);
        }
        let count: usize = self.parts.iter().map(|p| p.positions.len()).sum();
        let mut used = vec![false; count];
        triangles.iter().flatten().for_each(|&vertex| used[vertex as usize] = true);
        let mut new_vertex = vec![NONE; count];
        let (mut parts, mut first, mut next) = (Vec::new(), 0, 0);
        for part in &self.parts {
            let used = &used[first..first + part.positions.len()];
            for (local, _) in used.iter().enumerate().filter(|(_, used)| **used) {
                new_vertex[first + local] = next;
                next += 1;
            }
            if used.contains(&true) {
                parts.push(part.reduced(used));
            }
            first += part.positions.len();
        }
        triangles.iter_mut().flatten().for_each(|vertex| *vertex = new_vertex[*vertex as usize]);
        (Self { parts, triangles }, renumbered)
    }
}

impl SkinnedPrimitive {
    /// Appends the world positions of this part's vertices in `pose`.
    fn posed(&self, pose: &Pose, out: &mut Vec<DVec3>) {
        // Most targets of a face rest at any one time.
        let moving: Vec<(&Vec<DVec3>, f64)> = self
            .morphs
            .iter()
            .zip(&pose.weights[self.node])
            .filter(|(_, weight)| **weight != 0.0)
            .map(|(moves, &weight)| (moves, f64::from(weight)))
            .collect();
        let morphed = |i: usize| {
            self.positions[i] + moving.iter().map(|(moves, weight)| moves[i] * *weight).sum::<DVec3>()
        };
        let Some(skin) = &self.skin else {
            let world = pose.world[self.node];
            out.extend((0..self.positions.len()).map(|i| world.transform_point3(morphed(i))));
            return;
        };
        let joints: Vec<DMat4> =
            skin.joints.iter().map(|(node, inverse)| pose.world[*node] * *inverse).collect();
        for (i, influences) in skin.influences.iter().enumerate() {
            let at_rest = morphed(i);
            let mut moved = DVec3::ZERO;
            for &(joint, weight) in influences.iter().filter(|(_, weight)| *weight > 0.0) {
                moved += joints[usize::from(joint)].transform_point3(at_rest) * f64::from(weight);
            }
            out.push(moved);
        }
    }

    /// The part with its `used` vertices alone.
    fn reduced(&self, used: &[bool]) -> Self {
        fn of_used<T: Copy>(values: &[T], used: &[bool]) -> Vec<T> {
            values.iter().zip(used).filter(|(_, used)| **used).map(|(value, _)| *value).collect()
        }
        Self {
            node: self.node,
            positions: of_used(&self.positions, used),
            morphs: self.morphs.iter().map(|moves| of_used(moves, used)).collect(),
            skin: self.skin.as_ref().map(|skin| skin.reduced(of_used(&skin.influences, used))),
        }
    }
}

impl Skin {
    /// The skin of a primitive of `n` vertices.
    pub fn new(
        document: &Document,
        skin: &::gltf::Skin<'_>,
        primitive: &::gltf::Primitive<'_>,
        n: usize,
    ) -> Result<Self, ImportError> {
        use ::gltf::Semantic;
        let field = format!("skin {}", skin.index());
        let nodes: Vec<usize> = skin.joints().map(|j| j.index()).collect();
        let inverses = match skin.inverse_bind_matrices() {
            None => vec![DMat4::IDENTITY; nodes.len()],
            Some(a) => document
                .floats(&a, 16)?
                .chunks_exact(16)
                .map(|m| DMat4::from_cols_array(&std::array::from_fn(|i| f64::from(m[i]))))
                .collect(),
        };
        if inverses.len() < nodes.len() {
            return Err(FORMAT.malformed(
                field,
                inverses.len(),
                format_args!("{} inverse bind matrices", nodes.len()),
            ));
        }
        let mut influences = vec![[(0u16, 0.0f32); 8]; n];
        for set in 0..2 {
            let (Some(joints), Some(weights)) =
                (primitive.get(&Semantic::Joints(set)), primitive.get(&Semantic::Weights(set)))
            else {
                continue;
            };
            let (joints, weights) = (document.integers(&joints, 4)?, document.floats(&weights, 4)?);
            if joints.len() != n * 4 || weights.len() != n * 4 {
                return Err(FORMAT.malformed(
                    field,
                    "joints or weights of another length",
                    format_args!("{n} vertices"),
                ));
            }
            for (vertex, influence) in influences.iter_mut().enumerate() {
                for k in 0..4 {
                    let (joint, weight) = (joints[vertex * 4 + k], weights[vertex * 4 + k]);
                    if weight > 0.0 && joint as usize >= nodes.len() {
                        let allowed = format!("below {}", nodes.len());
                        return Err(FORMAT.malformed(format!("joint of vertex {vertex}"), joint, allowed));
                    }
                    if weight > 0.0 && weight.is_finite() {
                        influence[set as usize * 4 + k] = (joint as u16, weight);
                    }
                }
            }
        }
        for influence in &mut influences {
            let sum: f32 = influence.iter().map(|i| i.1).sum();
            if sum > 0.0 {
                influence.iter_mut().for_each(|i| i.1 /= sum);
            } else if let Some(i) = influence.first_mut() {
                // A vertex nothing moves stays with the first joint.
                *i = (0, 1.0);
            }
        }
        if nodes.is_empty() {
            return Err(FORMAT.empty(field));
        }
        Ok(Self { joints: nodes.into_iter().zip(inverses).collect(), influences })
    }

    /// The skin of the vertices that have these influences, with the joints that they name alone.
    fn reduced(&self, mut influences: Vec<[(u16, f32); 8]>) -> Self {
        let (mut joints, mut numbers) = (Vec::new(), BTreeMap::new());
        for (joint, weight) in influences.iter_mut().flatten() {
            if *weight > 0.0 {
                *joint = *numbers.entry(*joint).or_insert_with(|| {
                    joints.push(self.joints[usize::from(*joint)]);
                    (joints.len() - 1) as u16
                });
            }
        }
        Self { joints, influences }
    }
}
