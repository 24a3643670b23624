//! Reads glTF and GLB with `KHR_gaussian_splatting`: points whose attributes are those of Gaussians.
//!
//! Rotation is xyzw, scale and opacity are linear, harmonics one accessor a coefficient; integers may be
//! normalised. Colours are of the screen, or linear where the file says so: then band 0 is encoded, and
//! higher bands, which cannot be exactly, are kept. Nodes turn, move and evenly scale what hangs on them.
//! Other transforms, kernels, projections and colour spaces are refused. Axes are kept: y up. Views
//! compressed by meshopt are unfolded. Absent: primitives compressed as SPZ, which are refused by name.

mod accessor;

use std::{collections::BTreeMap, ops::RangeInclusive};

use codec_core::ShDegree;
use nalgebra::{Matrix3, Matrix4, Quaternion, Rotation3, UnitQuaternion, Vector3};
use serde::Deserialize;

use self::accessor::{Accessor, View};
use super::{
    Limits,
    bytes::{array, u32_at},
    error::{Format, ImportError},
    gltf_buffers::{Buffers, COMPRESSIONS},
    snapshot::{Columns, SH_C0, Snapshot, logit, screen, sh0_of_colour},
};
use crate::scene::{
    Scene,
    edit::{self, Similarity},
    export::gltf::EXTENSION,
};

const FORMAT: Format = Format::GltfSplats;
/// Extensions that a file may need: whole numbers are read as any others, what is compressed is unfolded.
const EXTENSIONS: [&str; 4] = [EXTENSION, "KHR_mesh_quantization", COMPRESSIONS[0], COMPRESSIONS[1]];
/// The kernel that is read, and the names of colours that a screen takes and of linear ones.
const KERNEL: &str = "ellipse";
const SCREEN: [&str; 2] = ["srgb_rec709_display", "BT.709-sRGB"];
const LINEAR: [&str; 2] = ["lin_rec709_display", "BT.709-linear"];
/// The projection that is read.
const PROJECTION: &str = "perspective";
/// Opacities, linear, with what rounding may add.
const OPACITIES: RangeInclusive<f32> = -1e-3..=1.001;
/// Deepest tree of nodes.
const MAX_DEPTH: usize = 64;
/// Most primitives, over all nodes.
const MAX_PRIMITIVES: usize = 10_000;

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Document {
    #[serde(default)]
    extensions_required: Vec<String>,
    #[serde(default)]
    scene: usize,
    #[serde(default)]
    scenes: Vec<Nodes>,
    #[serde(default)]
    nodes: Vec<Node>,
    #[serde(default)]
    meshes: Vec<Mesh>,
    #[serde(default)]
    accessors: Vec<Accessor>,
    #[serde(default)]
    buffer_views: Vec<View>,
}

#[derive(Deserialize)]
struct Nodes {
    #[serde(default)]
    nodes: Vec<usize>,
}

#[derive(Deserialize)]
struct Node {
    mesh: Option<usize>,
    #[serde(default)]
    children: Vec<usize>,
    matrix: Option<[f64; 16]>,
    translation: Option<[f64; 3]>,
    rotation: Option<[f64; 4]>,
    scale: Option<[f64; 3]>,
}

#[derive(Deserialize)]
struct Mesh {
    primitives: Vec<Primitive>,
}

#[derive(Deserialize)]
struct Primitive {
    attributes: BTreeMap<String, usize>,
    #[serde(default)]
    extensions: serde_json::Map<String, serde_json::Value>,
}

/// Whether a glTF file is of this kind.
pub(super) fn is_splats(bytes: &[u8]) -> bool {
    let text = if bytes.starts_with(b"glTF") { json_chunk(bytes, true).map(|c| c.0) } else { Ok(bytes) };
    text.is_ok_and(|text| {
        let name = EXTENSION.as_bytes();
        text.windows(name.len()).any(|window| window == name)
    })
}

/// Reads a glTF or GLB file of Gaussians. `beside` reads the files it names.
///
/// # Errors
/// JSON or binary data that contradicts itself, no Gaussians, a transform that Gaussians cannot follow, or
/// more than `limits` allow.
pub fn parse(
    bytes: &[u8],
    beside: impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
    limits: &Limits,
) -> Result<Snapshot, ImportError> {
    limits.bytes(FORMAT, "file", bytes.len() as u64)?;
    let (text, blob) =
        if bytes.starts_with(b"glTF") { json_chunk(bytes, limits.keep_readable)? } else { (bytes, None) };
    let document: Document =
        serde_json::from_slice(text).map_err(|e| FORMAT.malformed("JSON", e, "the JSON of glTF 2.0"))?;
    if let Some(name) = document.extensions_required.iter().find(|name| !EXTENSIONS.contains(&name.as_str()))
    {
        return Err(FORMAT.unsupported("extensionsRequired", name, EXTENSIONS.join(", ")));
    }
    let buffers = Buffers::load(FORMAT, text, blob, beside, limits)?;
    let mut reader = Reader {
        document: &document,
        buffers,
        limits,
        primitives: 0,
        parts: Vec::new(),
        count: 0,
        notes: Vec::new(),
    };
    let roots = match (document.scenes.get(document.scene), document.scenes.len()) {
        (Some(scene), _) => scene.nodes.clone(),
        (None, 0) if document.scene == 0 => roots(&document.nodes),
        (None, scenes) => {
            let allowed = format!("one of the file's {scenes}, counted from 0");
            return Err(FORMAT.malformed("scene", document.scene, allowed));
        }
    };
    for node in roots {
        reader.node(node, &Similarity::default(), 0)?;
    }
    reader.snapshot()
}

/// The nodes that are nobody's child.
fn roots(nodes: &[Node]) -> Vec<usize> {
    let mut is_child = vec![false; nodes.len()];
    for child in nodes.iter().flat_map(|node| &node.children) {
        if let Some(is_child) = is_child.get_mut(*child) {
            *is_child = true;
        }
    }
    (0..nodes.len()).filter(|&node| !is_child[node]).collect()
}

/// Whether the colours of a primitive with the extension's object `object` are linear; what is absent is as
/// usual.
fn is_linear(object: &serde_json::Value) -> Result<bool, ImportError> {
    let named = |key: &str, usual: &'static str| match object.get(key) {
        None => Ok(usual.to_owned()),
        Some(value) => {
            value.as_str().map(str::to_owned).ok_or_else(|| FORMAT.malformed(key, value, "a name"))
        }
    };
    for (key, read) in [("kernel", KERNEL), ("projection", PROJECTION)] {
        let found = named(key, read)?;
        if found != read {
            return Err(FORMAT.unsupported(key, found, read));
        }
    }
    // The second of each is what drafts called it.
    let space = named("colorSpace", SCREEN[0])?;
    let is_one_of = |names: [&str; 2]| names.iter().any(|name| name.eq_ignore_ascii_case(&space));
    match (is_one_of(SCREEN), is_one_of(LINEAR)) {
        (true, _) => Ok(false),
        (_, true) => Ok(true),
        _ => Err(FORMAT.unsupported("colorSpace", space, format_args!("{} or {}", SCREEN[0], LINEAR[0]))),
    }
}

/// The highest degree of harmonics of which a primitive has a coefficient.
fn stored_degree(primitive: &Primitive) -> u8 {
    let prefix = format!("{EXTENSION}:SH_DEGREE_");
    let of_key = |key: &String| key.strip_prefix(&prefix)?.split_once("_COEF_")?.0.parse::<u8>().ok();
    primitive.attributes.keys().filter_map(of_key).max().unwrap_or(0)
}

/// The band-0 coefficient of a colour of the screen, of that of a linear one.
fn encoded(linear: f32) -> f32 {
    sh0_of_colour(screen(0.5 + SH_C0 * linear))
}

/// The JSON of a GLB, and its binary chunk if there is one; with `keeps` as much of that as is there.
fn json_chunk(bytes: &[u8], keeps: bool) -> Result<(&[u8], Option<&[u8]>), ImportError> {
    let mut chunks = Vec::new();
    let mut at = 12usize;
    while chunks.len() < 2 && at < bytes.len() {
        let length =
            u32_at(bytes, at).ok_or_else(|| FORMAT.truncated("chunk", bytes.len() as u64, at as u64 + 8))?;
        let start = at + 8;
        let end = start.saturating_add(length as usize);
        let content = bytes
            .get(start..end)
            .or_else(|| bytes.get(start..).filter(|_| keeps && !chunks.is_empty()))
            .ok_or_else(|| FORMAT.truncated("GLB", bytes.len() as u64, end as u64).at(at))?;
        chunks.push((array::<4>(bytes, at + 4).unwrap_or_default(), content));
        at = end;
    }
    match chunks[..] {
        [(kind, text)] if &kind == b"JSON" => Ok((text, None)),
        [(kind, text), (_, binary)] if &kind == b"JSON" => Ok((text, Some(binary))),
        _ => Err(FORMAT.malformed("GLB", "no JSON chunk first", "a JSON chunk, then a BIN chunk")),
    }
}

struct Reader<'a> {
    document: &'a Document,
    buffers: Buffers,
    limits: &'a Limits,
    primitives: usize,
    /// What each primitive holds, with the transform of its node.
    parts: Vec<(Snapshot, Similarity)>,
    /// Gaussians read.
    count: usize,
    /// What a person should know of primitives of which nothing is there.
    notes: Vec<String>,
}

impl Reader<'_> {
    fn node(&mut self, index: usize, parent: &Similarity, depth: usize) -> Result<(), ImportError> {
        let field = || format!("node {index}");
        if depth > MAX_DEPTH {
            return Err(FORMAT.malformed(field(), "a tree without end", format_args!("{MAX_DEPTH} levels")));
        }
        let document = self.document;
        let node = document
            .nodes
            .get(index)
            .ok_or_else(|| FORMAT.malformed(field(), "no such node", "a node of the file"))?;
        let own = similarity(node).ok_or_else(|| {
            let allowed = "turns, shifts and one scale for all axes";
            FORMAT.unsupported(format!("transform of node {index}"), "another transform", allowed)
        })?;
        let whole = own.then(parent);
        if let Some(mesh) = node.mesh {
            let mesh = document.meshes.get(mesh);
            let mesh = mesh.ok_or_else(|| FORMAT.malformed(field(), "no such mesh", "a mesh of the file"))?;
            for primitive in mesh.primitives.iter().filter(|p| p.extensions.contains_key(EXTENSION)) {
                self.primitive(primitive, whole)?;
            }
        }
        for &child in &node.children {
            self.primitives += 1;
            if self.primitives > MAX_PRIMITIVES {
                return Err(FORMAT.malformed("nodes", "more", format_args!("up to {MAX_PRIMITIVES}")));
            }
            self.node(child, &whole, depth + 1)?;
        }
        Ok(())
    }

    fn primitive(&mut self, primitive: &Primitive, place: Similarity) -> Result<(), ImportError> {
        self.primitives += 1;
        if self.primitives > MAX_PRIMITIVES {
            return Err(FORMAT.malformed("primitives", "more", format_args!("up to {MAX_PRIMITIVES}")));
        }
        if let Some(name) =
            primitive.extensions[EXTENSION].get("extensions").and_then(|e| e.as_object()?.keys().next())
        {
            return Err(FORMAT.unsupported("primitive", name, "Gaussians that are not compressed"));
        }
        let is_linear = is_linear(&primitive.extensions[EXTENSION])?;
        let own = |name: &str| format!("{EXTENSION}:{name}");
        let (positions, _) = self.attribute(primitive, "POSITION", &["VEC3"])?;
        let mut count = positions.len() / 3;
        self.count += count;
        if count > 0 {
            self.limits.gaussians(FORMAT, self.count as u64)?;
        }
        let (rotations, _) = self.attribute(primitive, &own("ROTATION"), &["VEC4"])?;
        let (scales, _) = self.attribute(primitive, &own("SCALE"), &["VEC3"])?;
        let stored = stored_degree(primitive);
        let degree = stored.min(ShDegree::MAX.get());
        let sh_degree = ShDegree::new(degree).unwrap_or(ShDegree::ZERO);
        let mut columns = Columns::with_capacity(count, sh_degree);
        let has_band0 = primitive.attributes.contains_key(&own("SH_DEGREE_0_COEF_0"));
        let (mut band0, opacities) = if has_band0 {
            let opacity = self.attribute(primitive, &own("OPACITY"), &["SCALAR"])?.0;
            (self.attribute(primitive, &own("SH_DEGREE_0_COEF_0"), &["VEC3"])?.0, opacity)
        } else {
            // Drafts of the extension kept both in the colour of points.
            let (colours, width) = self.attribute(primitive, "COLOR_0", &["VEC4"])?;
            let band0 =
                colours.chunks_exact(width).flat_map(|c| [c[0], c[1], c[2]].map(sh0_of_colour)).collect();
            (band0, colours.chunks_exact(width).map(|c| c[3]).collect())
        };
        let mut notes = Vec::new();
        if degree < stored {
            notes.push(format!("harmonics of degree {stored} are cut to degree {degree}"));
        }
        if is_linear {
            band0.iter_mut().for_each(|value| *value = encoded(*value));
            let rest =
                if degree > 0 { "; higher bands are kept as they are, which is approximate" } else { "" };
            notes.push(format!("colours are linear, and are encoded as a screen takes them{rest}"));
        }
        let mut bands = Vec::new();
        for degree in 1..=usize::from(degree) {
            for coefficient in 0..2 * degree + 1 {
                let name = own(&format!("SH_DEGREE_{degree}_COEF_{coefficient}"));
                bands.push(self.attribute(primitive, &name, &["VEC3"])?.0);
            }
        }
        let lengths = [(rotations.len(), 4), (scales.len(), 3), (band0.len(), 3), (opacities.len(), 1)];
        let bands_fit = bands.iter().all(|band| band.len() == 3 * count);
        let mut with_bands = count;
        if self.limits.keep_readable {
            let declared = self.declared(primitive);
            count = lengths.iter().map(|(length, width)| length / width).min().unwrap_or(0).min(count);
            with_bands = bands.iter().map(|band| band.len() / 3).min().unwrap_or(count).min(count);
            if count < declared {
                notes.push(format!(
                    "of {declared} Gaussians the first {count} are there; the rest is left out"
                ));
            }
            if with_bands < count {
                notes.push(format!("{} Gaussians lack harmonics, which are left out", count - with_bands));
            }
        } else if lengths.iter().any(|&(length, width)| length != width * count) || !bands_fit {
            return Err(FORMAT.malformed("attributes", "other counts", format_args!("{count} of each")));
        }
        if count == 0 {
            self.notes.extend(notes);
            return Ok(());
        }
        let beyond = |opacity: &&f32| !opacity.is_nan() && !OPACITIES.contains(*opacity);
        let clamped = opacities[..count].iter().filter(beyond).count();
        if clamped > 0 {
            notes.push(format!("opacities of {clamped} Gaussians were not within 0 to 1, and are clamped"));
        }
        let three = |values: &[f32], i: usize| [values[3 * i], values[3 * i + 1], values[3 * i + 2]];
        for i in 0..count {
            let scale = three(&scales, i);
            if scale.iter().any(|&s| s < 0.0) && !self.limits.keep_readable {
                let found = format_args!("{scale:?}").to_string();
                let field = format!("scale of Gaussian {i}");
                return Err(FORMAT.malformed(field, found, "standard deviations, not negative"));
            }
            let opacity = opacities[i];
            if !OPACITIES.contains(&opacity) && !self.limits.keep_readable {
                let field = format!("opacity of Gaussian {i}");
                return Err(FORMAT.malformed(field, opacity, "0 to 1"));
            }
            let [x, y, z, w] = [0, 1, 2, 3].map(|c| rotations[4 * i + c]);
            columns.positions.push(three(&positions, i));
            columns.rotations.push([w, x, y, z]);
            columns.log_scales.push(scale.map(f32::ln));
            columns.opacity_logits.push(logit(opacity.clamp(0.0, 1.0)));
            columns.sh0.push(three(&band0, i));
            let band = |values: &Vec<f32>| if i < with_bands { three(values, i) } else { [0.0; 3] };
            columns.sh_rest.extend(bands.iter().flat_map(band));
        }
        self.parts.push((columns.finish(FORMAT, self.limits, notes)?, place));
        Ok(())
    }

    /// The Gaussians that a primitive says it has.
    fn declared(&self, primitive: &Primitive) -> usize {
        let accessor =
            primitive.attributes.get("POSITION").and_then(|&index| self.document.accessors.get(index));
        accessor.map_or(0, |accessor| accessor.count)
    }

    /// The values of an attribute and how many there are per element. Where `keep_readable` is set, as many
    /// elements as there are bytes for.
    fn attribute(
        &self,
        primitive: &Primitive,
        name: &str,
        kinds: &[&str],
    ) -> Result<(Vec<f32>, usize), ImportError> {
        let missing = || FORMAT.malformed(name, "nothing", "an accessor of the file");
        let index = primitive.attributes.get(name).ok_or_else(missing)?;
        let accessor = self.document.accessors.get(*index).ok_or_else(missing)?;
        if !kinds.contains(&accessor.kind.as_str()) {
            return Err(FORMAT.malformed(name, &accessor.kind, kinds.join(" or ")));
        }
        accessor.values(name, &self.document.buffer_views, &self.buffers, self.limits)
    }

    /// All primitives as one, each where its nodes put it.
    fn snapshot(self) -> Result<Snapshot, ImportError> {
        let failed = |e: &dyn std::fmt::Display| FORMAT.malformed("nodes", e, "Gaussians that stay finite");
        let (mut scenes, mut notes) = (Vec::new(), self.notes);
        for (part, place) in self.parts {
            // Of several primitives the same is said once.
            notes.extend(part.notes.into_iter().filter(|note| !notes.contains(note)).collect::<Vec<_>>());
            let part = Scene::new(vec![part.epoch], 1.0).map_err(|e| failed(&e))?;
            scenes.push(edit::transform(&part, &place).map_err(|e| failed(&e))?);
        }
        // Two by two, so that no Gaussian is moved often.
        while scenes.len() > 1 {
            let pairs = scenes.chunks(2).map(|pair| match pair {
                [a, b] => edit::merged(a, b),
                _ => Ok(pair[0].clone()),
            });
            scenes = pairs.collect::<Result<_, _>>().map_err(|e| failed(&e))?;
        }
        let scene = scenes.pop().ok_or_else(|| FORMAT.empty("primitives with Gaussians"))?;
        Ok(Snapshot { epoch: scene.epochs()[0].clone(), footprint: None, notes })
    }
}

/// The transform of a node, if it is a similarity.
fn similarity(node: &Node) -> Option<Similarity> {
    let matrix = match (node.matrix, node.translation, node.rotation, node.scale) {
        (Some(columns), ..) => Matrix4::from_column_slice(&columns),
        (None, translation, rotation, scale) => {
            let [x, y, z, w] = rotation.unwrap_or([0.0, 0.0, 0.0, 1.0]);
            let turn = UnitQuaternion::try_new(Quaternion::new(w, x, y, z), 1e-9)?;
            let turn = turn.to_rotation_matrix().into_inner();
            let linear = turn * Matrix3::from_diagonal(&Vector3::from(scale.unwrap_or([1.0; 3])));
            let mut whole = linear.to_homogeneous();
            whole.fixed_view_mut::<3, 1>(0, 3).copy_from(&Vector3::from(translation.unwrap_or_default()));
            whole
        }
    };
    let linear = matrix.fixed_view::<3, 3>(0, 0).into_owned();
    let scale = linear.determinant().cbrt();
    if !(scale > 1e-9 && scale.is_finite()) {
        return None;
    }
    let turn = linear / scale;
    let off = (turn.transpose() * turn - Matrix3::identity()).abs().max();
    let last = matrix.row(3);
    if off.is_nan() || off > 1e-4 || last[0] != 0.0 || last[1] != 0.0 || last[2] != 0.0 || last[3] != 1.0 {
        return None;
    }
    let translation = [matrix[(0, 3)], matrix[(1, 3)], matrix[(2, 3)]];
    let rotation = Rotation3::from_matrix_unchecked(turn);
    translation.iter().all(|v| v.is_finite()).then_some(Similarity { rotation, scale, translation })
}

#[cfg(test)]
#[path = "gltf_splats/tests.rs"]
pub(super) mod tests;
