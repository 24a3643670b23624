//! The drawn surface: triangles of every visible mesh, posed per frame, and points placed on them.
//!
//! Placement draws four times as many candidates as wanted, stratified by area, and removes the most
//! crowded one by one (weighted sample elimination): what is left is close to blue noise, so discs of
//! one size cover the surface without holes. Candidates crowd each other only where their surfaces
//! face the same way, so both sides of a thin sheet are covered.

use std::collections::BinaryHeap;

use ::gltf::mesh::Mode;
use glam::{DMat3, DMat4, DQuat, DVec3};
use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};
use rayon::prelude::*;

use super::{
    FORMAT,
    document::Document,
    pose::{Pose, Rig},
    texture::Material,
    too_large,
};
use crate::import::{Limits, error::ImportError, nearest::Tree};

/// Candidates per wanted sample.
const OVERSAMPLING: usize = 4;

/// One primitive of one node: a range of vertices and what moves them.
struct Part {
    node: usize,
    first: usize,
    positions: Vec<DVec3>,
    /// Displacements per morph target.
    morphs: Vec<Vec<DVec3>>,
    skin: Option<Skin>,
}

struct Skin {
    /// Node and inverse bind matrix per joint.
    joints: Vec<(usize, DMat4)>,
    /// Up to eight (joint, weight) per vertex; weights sum to one.
    influences: Vec<[(u16, f32); 8]>,
}

/// All parts, with what does not move.
pub(super) struct Surface {
    parts: Vec<Part>,
    triangles: Vec<[u32; 3]>,
    /// Material of each triangle.
    of: Vec<u32>,
    materials: Vec<Material>,
    uvs: Vec<[f32; 2]>,
    colours: Vec<[f32; 4]>,
    pub notes: Vec<String>,
}

/// A point that stays with its triangle.
#[derive(Clone, Copy, Debug)]
struct Sample {
    triangle: u32,
    weights: [f64; 3],
    colour: [f32; 4],
    sigma: f32,
}

/// The points placed on a surface.
pub(super) struct Placed(Vec<Sample>);

/// The samples of one frame.
pub(super) struct Carried {
    pub positions: Vec<[f32; 3]>,
    /// wxyz; all zero where a triangle has no direction.
    pub rotations: Vec<[f32; 4]>,
    /// Length of each sample's triangle over its length in the first frame.
    pub stretch: Vec<f32>,
}

impl Surface {
    /// Collects the triangles of every visible mesh.
    pub fn new(document: &Document, rig: &Rig, limits: &Limits) -> Result<Self, ImportError> {
        let (parts, triangles, of, materials) = (Vec::new(), Vec::new(), Vec::new(), Vec::new());
        let (uvs, colours, notes) = (Vec::new(), Vec::new(), Vec::new());
        let mut surface = Self { parts, triangles, of, materials, uvs, colours, notes };
        for node in document.gltf.nodes().filter(|n| rig.visible[n.index()]) {
            let Some(mesh) = node.mesh() else { continue };
            for primitive in mesh.primitives() {
                if surface.uvs.len() > limits.max_gaussians || surface.triangles.len() > limits.max_gaussians
                {
                    return Err(too_large("vertices", surface.uvs.len(), limits.max_gaussians));
                }
                surface.add(document, &node, &primitive, limits)?;
            }
        }
        if surface.triangles.is_empty() {
            return Err(FORMAT.empty("triangles"));
        }
        Ok(surface)
    }

    fn add(
        &mut self,
        document: &Document,
        node: &::gltf::Node<'_>,
        primitive: &::gltf::Primitive<'_>,
        limits: &Limits,
    ) -> Result<(), ImportError> {
        use ::gltf::Semantic;
        let place = format!("node {} primitive {}", node.index(), primitive.index());
        let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(()) };
        let positions = vectors(&document.floats(&positions, 3)?);
        let n = positions.len();
        let fits = |what: &str, found: usize| {
            if found == n { Ok(()) } else { Err(FORMAT.malformed(format!("{what} of {place}"), found, n)) }
        };
        let material = Material::new(document, &primitive.material(), limits)?;
        let uvs = match primitive.get(&Semantic::TexCoords(material.uv_set)) {
            Some(a) => document.floats(&a, 2)?.chunks_exact(2).map(|v| [v[0], v[1]]).collect(),
            None => vec![[0.0; 2]; n],
        };
        fits("texture coordinates", uvs.len())?;
        let colours: Vec<[f32; 4]> = match primitive.get(&Semantic::Colors(0)) {
            None => vec![[1.0; 4]; n],
            Some(a) if a.dimensions().multiplicity() == 3 => {
                document.floats(&a, 3)?.chunks_exact(3).map(|v| [v[0], v[1], v[2], 1.0]).collect()
            }
            Some(a) => document.floats(&a, 4)?.chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]).collect(),
        };
        fits("colours", colours.len())?;
        let mut morphs = Vec::new();
        for target in primitive.morph_targets() {
            let moves = match target.positions() {
                Some(a) => vectors(&document.floats(&a, 3)?),
                None => vec![DVec3::ZERO; n],
            };
            fits("morph target", moves.len())?;
            morphs.push(moves);
        }
        let skin = match node.skin() {
            Some(skin) if primitive.get(&Semantic::Joints(0)).is_some() => {
                Some(Skin::new(document, &skin, primitive, n)?)
            }
            _ => None,
        };
        let indices = match primitive.indices() {
            Some(a) => document.integers(&a, 1)?,
            None => (0..n as u32).collect(),
        };
        if let Some(index) = indices.iter().find(|&&i| i as usize >= n) {
            return Err(FORMAT.malformed(format!("indices of {place}"), index, format_args!("below {n}")));
        }
        let first = self.uvs.len();
        let corner = |i: usize| indices[i] + first as u32;
        let last = indices.len().saturating_sub(2);
        match primitive.mode() {
            Mode::Triangles => self.triangles.extend(
                (0..indices.len() / 3).map(|t| [corner(3 * t), corner(3 * t + 1), corner(3 * t + 2)]),
            ),
            Mode::TriangleStrip => self
                .triangles
                .extend((0..last).map(|t| [corner(t), corner(t + 1 + t % 2), corner(t + 2 - t % 2)])),
            Mode::TriangleFan => {
                self.triangles.extend((0..last).map(|t| [corner(0), corner(t + 1), corner(t + 2)]))
            }
            other => {
                self.notes.push(format!("{place} is {other:?}, which has no surface, and is left out"));
                return Ok(());
            }
        }
        self.of.resize(self.triangles.len(), self.materials.len() as u32);
        self.materials.push(material);
        self.uvs.extend(uvs);
        self.colours.extend(colours);
        self.parts.push(Part { node: node.index(), first, positions, morphs, skin });
        Ok(())
    }

    /// World positions of all vertices in `pose`.
    pub fn pose(&self, pose: &Pose) -> Vec<DVec3> {
        let mut out = Vec::with_capacity(self.uvs.len());
        for part in &self.parts {
            debug_assert_eq!(part.first, out.len());
            let weights = &pose.weights[part.node];
            let morphed = |i: usize| {
                let moves = part.morphs.iter().zip(weights).map(|(m, &w)| m[i] * f64::from(w));
                part.positions[i] + moves.sum::<DVec3>()
            };
            match &part.skin {
                None => {
                    let world = pose.world[part.node];
                    out.extend((0..part.positions.len()).map(|i| world.transform_point3(morphed(i))));
                }
                Some(skin) => {
                    let joints: Vec<DMat4> =
                        skin.joints.iter().map(|(node, inverse)| pose.world[*node] * *inverse).collect();
                    out.extend(skin.influences.iter().enumerate().map(|(i, influences)| {
                        let p = morphed(i);
                        let moved = influences.iter().filter(|(_, w)| *w > 0.0);
                        moved
                            .map(|&(j, w)| joints[usize::from(j)].transform_point3(p) * f64::from(w))
                            .sum::<DVec3>()
                    }));
                }
            }
        }
        out
    }

    fn corners(&self, triangle: u32, vertices: &[DVec3]) -> [DVec3; 3] {
        self.triangles[triangle as usize].map(|v| vertices[v as usize])
    }

    /// Places `count` samples over the surface as posed in `vertices`.
    pub fn place(&self, vertices: &[DVec3], count: usize, seed: u64) -> Result<Placed, ImportError> {
        if let Some(i) = vertices.iter().position(|v| !v.is_finite()) {
            return Err(FORMAT.malformed(
                format!("vertex {i}"),
                "a value that is not finite",
                "finite values",
            ));
        }
        let mut total = 0.0;
        let cumulative: Vec<f64> = (0..self.triangles.len() as u32)
            .map(|t| {
                total += area(self.corners(t, vertices));
                total
            })
            .collect();
        if !(total.is_finite() && total > 0.0) {
            return Err(FORMAT.malformed("surface area", total, "a positive area"));
        }
        let mut rng = Pcg64Mcg::seed_from_u64(seed);
        let drawn = count.saturating_mul(OVERSAMPLING);
        let mut candidates = Vec::with_capacity(drawn);
        let mut visible = 0usize;
        for i in 0..drawn {
            let at = (i as f64 + rng.random::<f64>()) / drawn as f64 * total;
            let triangle = cumulative.partition_point(|&c| c < at).min(self.triangles.len() - 1);
            let (u, v): (f64, f64) = (rng.random(), rng.random());
            let weights = [1.0 - u.sqrt(), u.sqrt() * (1.0 - v), u.sqrt() * v];
            if let Some(colour) = self.colour(triangle, weights) {
                visible += 1;
                candidates.push(Sample { triangle: triangle as u32, weights, colour, sigma: 0.0 });
            }
        }
        if candidates.is_empty() {
            return Err(FORMAT.malformed("surface", "no texel that is drawn", "some"));
        }
        let area = total * visible as f64 / drawn as f64;
        let count = count.min(candidates.len());
        let points: Vec<[f32; 3]> =
            candidates.iter().map(|s| self.point(s, vertices).as_vec3().to_array()).collect();
        let normals: Vec<DVec3> = candidates
            .iter()
            .map(|s| normal(self.corners(s.triangle, vertices)).unwrap_or(DVec3::ZERO))
            .collect();
        // Twice the largest radius discs of this number can have on this area.
        let reach = 2.0 * (area / (2.0 * 3f64.sqrt() * count as f64)).sqrt();
        let kept = thin(&points, &normals, count, reach as f32);
        let spacing = (2.0 * area / (3f64.sqrt() * count as f64)).sqrt() as f32;
        let points: Vec<[f32; 3]> = kept.iter().map(|&i| points[i]).collect();
        let normals: Vec<DVec3> = kept.iter().map(|&i| normals[i]).collect();
        let mut samples: Vec<Sample> = kept.iter().map(|&i| candidates[i]).collect();
        for (sample, sigma) in samples.iter_mut().zip(sigmas(&points, &normals, spacing)) {
            sample.sigma = sigma;
        }
        Ok(Placed(samples))
    }

    fn colour(&self, triangle: usize, weights: [f64; 3]) -> Option<[f32; 4]> {
        let corners = self.triangles[triangle].map(|v| v as usize);
        let mix = |value: &dyn Fn(usize) -> f32| {
            corners.iter().zip(weights).map(|(&v, w)| value(v) * w as f32).sum::<f32>()
        };
        let uv = [0, 1].map(|i| mix(&|v| self.uvs[v][i]));
        let vertex = [0, 1, 2, 3].map(|i| mix(&|v| self.colours[v][i]));
        self.materials[self.of[triangle] as usize].colour(uv, vertex)
    }

    fn point(&self, sample: &Sample, vertices: &[DVec3]) -> DVec3 {
        let corners = self.corners(sample.triangle, vertices);
        corners.iter().zip(sample.weights).map(|(&c, w)| c * w).sum()
    }
}

impl Placed {
    pub fn len(&self) -> usize {
        self.0.len()
    }

    /// Standard deviation of each disc along the surface, at the first frame.
    pub fn sigmas(&self) -> impl Iterator<Item = f32> + '_ {
        self.0.iter().map(|s| s.sigma)
    }

    /// Display colour and alpha of each.
    pub fn colours(&self) -> impl Iterator<Item = [f32; 4]> + '_ {
        self.0.iter().map(|s| s.colour)
    }

    /// The samples with the surface posed as `vertices`; `first` is the pose they were placed in.
    pub fn carry(&self, surface: &Surface, first: &[DVec3], vertices: &[DVec3]) -> Carried {
        let turn = |s: &Sample| {
            let corners = surface.corners(s.triangle, vertices);
            frame(corners).map_or([0.0; 4], |q| [q.w, q.x, q.y, q.z].map(|v| v as f32))
        };
        let stretch = |s: &Sample| {
            let before = area(surface.corners(s.triangle, first));
            let now = area(surface.corners(s.triangle, vertices));
            if before > 0.0 { (now / before).sqrt().clamp(0.1, 10.0) as f32 } else { 1.0 }
        };
        Carried {
            positions: self.0.iter().map(|s| surface.point(s, vertices).as_vec3().to_array()).collect(),
            rotations: self.0.iter().map(turn).collect(),
            stretch: self.0.iter().map(stretch).collect(),
        }
    }
}

impl Skin {
    fn new(
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
}

/// The `count` least crowded of `points`, in their order. A point is crowded by those within `reach`
/// whose normals face its way; the most crowded goes first.
fn thin(points: &[[f32; 3]], normals: &[DVec3], count: usize, reach: f32) -> Vec<usize> {
    let tree = Tree::new(points);
    let near = |i: usize| tree.within(points[i], reach, |j| j != i && normals[i].dot(normals[j]) >= 0.0);
    let crowding = |squared: f32| (1.0 - f64::from((squared.sqrt() / reach).min(1.0))).powi(8);
    let mut weights: Vec<f64> = (0..points.len())
        .into_par_iter()
        .map(|i| near(i).into_iter().map(|(d, _)| crowding(d)).fold(0.0, |sum, c| sum + c))
        .collect();
    // Weights are never negative (nor -0), so their bits order as they do. Entries go stale when a
    // neighbour goes; they are put back at their true place when they come up.
    let mut heap: BinaryHeap<(u64, usize)> =
        weights.iter().enumerate().map(|(i, w)| (w.to_bits(), i)).collect();
    let mut alive = vec![true; points.len()];
    let mut left = points.len();
    while left > count {
        let Some((bits, i)) = heap.pop() else { break };
        if weights[i].to_bits() != bits {
            heap.push((weights[i].to_bits(), i));
            continue;
        }
        alive[i] = false;
        left -= 1;
        for (d, j) in near(i) {
            weights[j] = (weights[j] - crowding(d)).max(0.0);
        }
    }
    (0..points.len()).filter(|&i| alive[i]).collect()
}

/// Disc sizes from the distance to the six nearest on the same side, within a factor of two of what
/// even `spacing` gives. At 0.6 of the spacing, three neighbours leave no hole between them.
fn sigmas(points: &[[f32; 3]], normals: &[DVec3], spacing: f32) -> Vec<f32> {
    let tree = Tree::new(points);
    (0..points.len())
        .into_par_iter()
        .map(|i| {
            let near = tree.nearest(points[i], 6, |j| j != i && normals[i].dot(normals[j]) >= 0.0);
            let mean = near.iter().map(|n| n.0.sqrt()).sum::<f32>() / near.len().max(1) as f32;
            0.6 * mean.clamp(0.5 * spacing, 2.0 * spacing)
        })
        .collect()
}

fn vectors(values: &[f32]) -> Vec<DVec3> {
    values.chunks_exact(3).map(|v| DVec3::new(v[0].into(), v[1].into(), v[2].into())).collect()
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

fn normal([a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    (b - a).cross(c - a).try_normalize()
}

/// The rotation that takes x along the first edge and z along the normal.
fn frame(corners: [DVec3; 3]) -> Option<DQuat> {
    let z = normal(corners)?;
    let x = (corners[1] - corners[0]).try_normalize()?;
    Some(DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)))
}
