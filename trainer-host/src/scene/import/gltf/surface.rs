//! Collects the drawn surface: the triangles of every visible mesh, with what colours them.

use glam::DVec3;
use gltf::{Semantic, mesh::Mode};

use super::{
    document::{Document, FORMAT, too_large},
    mesh::{Mesh, Skin, SkinnedPrimitive},
    pose::Rig,
    texture::{Material, Textures},
};
use crate::scene::import::{Limits, error::ImportError};

/// The triangles of all visible meshes and their materials.
#[derive(Default)]
pub(super) struct Surface {
    pub mesh: Mesh,
    /// Material of each triangle.
    of: Vec<u32>,
    materials: Vec<Material>,
    uvs: Vec<[f32; 2]>,
    colours: Vec<[f32; 4]>,
    /// Displacements of all morph targets so far: nodes that share a mesh have them each.
    displacements: usize,
    pub notes: Vec<String>,
}

impl Surface {
    /// Collects the triangles of every visible mesh.
    ///
    /// # Errors
    /// Data that contradicts itself, no triangle, or more than `limits` allow.
    pub fn new(document: &Document, rig: &Rig, limits: &Limits) -> Result<Self, ImportError> {
        let mut surface = Self::default();
        let mut textures = Textures::new(limits);
        for node in document.gltf.nodes().filter(|n| rig.visible[n.index()]) {
            let Some(mesh) = node.mesh() else { continue };
            for primitive in mesh.primitives() {
                let (vertices, triangles) = (surface.uvs.len(), surface.mesh.triangles.len());
                if vertices.max(triangles) > limits.max_gaussians {
                    return Err(too_large("vertices", vertices.max(triangles), limits.max_gaussians));
                }
                surface.add(document, &node, &primitive, &mut textures, limits)?;
            }
        }
        if surface.mesh.triangles.is_empty() {
            return Err(FORMAT.empty("triangles"));
        }
        Ok(surface)
    }

    /// Adds one primitive of one node.
    fn add(
        &mut self,
        document: &Document,
        node: &::gltf::Node<'_>,
        primitive: &::gltf::Primitive<'_>,
        textures: &mut Textures,
        limits: &Limits,
    ) -> Result<(), ImportError> {
        let place = format!("node {} primitive {}", node.index(), primitive.index());
        let Some(positions) = primitive.get(&Semantic::Positions) else { return Ok(()) };
        let positions = vectors(&document.floats(&positions, 3)?);
        let n = positions.len();
        let Some(triangles) = triangles(document, primitive, n, &place)? else {
            let mode = primitive.mode();
            self.notes.push(format!("{place} is {mode:?}, which has no surface, and is left out"));
            return Ok(());
        };
        let morphs = self.morphs(document, primitive, n, &place, limits)?;
        let material = Material::new(document, &primitive.material(), textures)?;
        let uvs = match primitive.get(&Semantic::TexCoords(material.uv_set)) {
            Some(a) => document.floats(&a, 2)?.chunks_exact(2).map(|v| [v[0], v[1]]).collect(),
            None => vec![[0.0; 2]; n],
        };
        fits("texture coordinates", &place, uvs.len(), n)?;
        let colours: Vec<[f32; 4]> = match primitive.get(&Semantic::Colors(0)) {
            None => vec![[1.0; 4]; n],
            Some(a) if a.dimensions().multiplicity() == 3 => {
                document.floats(&a, 3)?.chunks_exact(3).map(|v| [v[0], v[1], v[2], 1.0]).collect()
            }
            Some(a) => document.floats(&a, 4)?.chunks_exact(4).map(|v| [v[0], v[1], v[2], v[3]]).collect(),
        };
        fits("colours", &place, colours.len(), n)?;
        let skin = match node.skin() {
            Some(skin) if primitive.get(&Semantic::Joints(0)).is_some() => {
                Some(Skin::new(document, &skin, primitive, n)?)
            }
            _ => None,
        };
        let first = self.uvs.len() as u32;
        self.mesh.triangles.extend(triangles.into_iter().map(|corners| corners.map(|v| v + first)));
        self.of.resize(self.mesh.triangles.len(), self.materials.len() as u32);
        self.materials.push(material);
        self.uvs.extend(uvs);
        self.colours.extend(colours);
        self.mesh.parts.push(SkinnedPrimitive { node: node.index(), positions, morphs, skin });
        Ok(())
    }

    /// The displacements of each morph target of a primitive of `n` vertices.
    fn morphs(
        &mut self,
        document: &Document,
        primitive: &::gltf::Primitive<'_>,
        n: usize,
        place: &str,
        limits: &Limits,
    ) -> Result<Vec<Vec<DVec3>>, ImportError> {
        let mut morphs = Vec::new();
        for target in primitive.morph_targets() {
            self.displacements += n;
            if self.displacements > limits.max_gaussians {
                let field = "displacements of morph targets";
                return Err(too_large(field, self.displacements, limits.max_gaussians));
            }
            let moves = match target.positions() {
                Some(a) => vectors(&document.floats(&a, 3)?),
                None => vec![DVec3::ZERO; n],
            };
            fits("morph target", place, moves.len(), n)?;
            morphs.push(moves);
        }
        Ok(morphs)
    }

    /// Display colour and alpha at a point of a triangle; `None` where nothing is drawn.
    pub fn colour(&self, triangle: u32, weights: [f64; 3]) -> Option<[f32; 4]> {
        let triangle = triangle as usize;
        let corners = self.mesh.triangles[triangle].map(|v| v as usize);
        let blend = |value: &dyn Fn(usize) -> f32| {
            corners.iter().zip(weights).map(|(&v, w)| value(v) * w as f32).sum::<f32>()
        };
        let uv = [0, 1].map(|i| blend(&|v| self.uvs[v][i]));
        let vertex = [0, 1, 2, 3].map(|i| blend(&|v| self.colours[v][i]));
        self.materials[self.of[triangle] as usize].colour(uv, vertex)
    }
}

/// The triangles of a primitive of `n` vertices; `None` if it consists of points or lines.
fn triangles(
    document: &Document,
    primitive: &::gltf::Primitive<'_>,
    n: usize,
    place: &str,
) -> Result<Option<Vec<[u32; 3]>>, ImportError> {
    let corners = match primitive.indices() {
        Some(a) => document.integers(&a, 1)?,
        None => (0..n as u32).collect(),
    };
    if let Some(index) = corners.iter().find(|&&i| i as usize >= n) {
        return Err(FORMAT.malformed(format!("indices of {place}"), index, format_args!("below {n}")));
    }
    let last = corners.len().saturating_sub(2);
    let triangles = match primitive.mode() {
        Mode::Triangles => corners.chunks_exact(3).map(|c| [c[0], c[1], c[2]]).collect(),
        // Every second triangle of a strip is turned, so that all face the same way.
        Mode::TriangleStrip => {
            (0..last).map(|t| [corners[t], corners[t + 1 + t % 2], corners[t + 2 - t % 2]]).collect()
        }
        Mode::TriangleFan => (0..last).map(|t| [corners[0], corners[t + 1], corners[t + 2]]).collect(),
        Mode::Points | Mode::Lines | Mode::LineLoop | Mode::LineStrip => return Ok(None),
    };
    Ok(Some(triangles))
}

/// Refuses an attribute that is not there for every vertex.
fn fits(what: &str, place: &str, found: usize, vertices: usize) -> Result<(), ImportError> {
    if found == vertices {
        return Ok(());
    }
    Err(FORMAT.malformed(format!("{what} of {place}"), found, vertices))
}

fn vectors(values: &[f32]) -> Vec<DVec3> {
    values.chunks_exact(3).map(|v| DVec3::new(v[0].into(), v[1].into(), v[2].into())).collect()
}
