//! Decodes the primitives of `KHR_draco_mesh_compression` into what their accessors describe.

use std::collections::BTreeMap;

use draco_core::{
    DataType, DecodeLimits, DecoderBuffer, Mesh, MeshDecoder, PointAttribute, geometry_indices::PointIndex,
};
use serde::Deserialize;

use crate::scene::import::{
    Limits,
    error::{ErrorKind, Format, ImportError},
    gltf_buffers::Buffers,
};

const FORMAT: Format = Format::Gltf;
/// Name of the extension.
pub(super) const EXTENSION: &str = "KHR_draco_mesh_compression";
/// The mode of primitives of separate triangles.
const TRIANGLES: u32 = 4;

/// The parts of the JSON that describe compressed primitives.
#[derive(Deserialize)]
struct Layout {
    #[serde(default)]
    meshes: Vec<MeshLayout>,
    #[serde(default)]
    accessors: Vec<AccessorLayout>,
}

#[derive(Deserialize)]
struct MeshLayout {
    primitives: Vec<PrimitiveLayout>,
}

#[derive(Deserialize)]
struct PrimitiveLayout {
    #[serde(default)]
    attributes: BTreeMap<String, usize>,
    indices: Option<usize>,
    mode: Option<u32>,
    #[serde(default)]
    extensions: Extensions,
}

#[derive(Default, Deserialize)]
struct Extensions {
    #[serde(rename = "KHR_draco_mesh_compression")]
    draco: Option<Compressed>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Compressed {
    buffer_view: usize,
    /// The number of each attribute in the compressed data.
    attributes: BTreeMap<String, u32>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct AccessorLayout {
    component_type: u32,
    count: usize,
    #[serde(rename = "type")]
    kind: String,
}

/// Decodes meshes, each stream once, within what is left of the limits.
struct Unfolding<'a> {
    buffers: &'a Buffers,
    limits: &'a Limits,
    /// Bytes that may still be decoded.
    left: u64,
    meshes: BTreeMap<usize, Mesh>,
}

/// The elements of every accessor whose primitive is compressed, one after the other, by its number.
///
/// # Errors
/// JSON or streams that are damaged or contradict each other, or more than `limits` allow.
pub(super) fn unfolded(
    text: &[u8],
    buffers: &Buffers,
    limits: &Limits,
) -> Result<BTreeMap<usize, Vec<u8>>, ImportError> {
    let layout: Layout =
        serde_json::from_slice(text).map_err(|e| FORMAT.malformed("JSON", e, "the JSON of glTF 2.0"))?;
    let mut unfolding = Unfolding { buffers, limits, left: limits.max_bytes, meshes: BTreeMap::new() };
    let mut out = BTreeMap::new();
    // Which attribute of which view an accessor describes; triangles have no number.
    let mut described: BTreeMap<usize, (usize, Option<u32>)> = BTreeMap::new();
    let mut is_new = |index: usize, source: (usize, Option<u32>)| match described.insert(index, source) {
        None => Ok(true),
        Some(earlier) if earlier == source => Ok(false),
        Some(_) => {
            let (field, found) = (format!("accessor {index}"), "two compressed attributes");
            Err(FORMAT.malformed(field, found, "one"))
        }
    };
    let accessor = |index: usize| {
        let found = layout.accessors.get(index);
        found.ok_or_else(|| {
            FORMAT.malformed("accessor", index, format_args!("below {}", layout.accessors.len()))
        })
    };
    for primitive in layout.meshes.iter().flat_map(|mesh| &mesh.primitives) {
        let Some(compressed) = &primitive.extensions.draco else { continue };
        if primitive.mode.is_some_and(|mode| mode != TRIANGLES) {
            let found = format!("{EXTENSION} of mode {}", primitive.mode.unwrap_or_default());
            return Err(FORMAT.unsupported("primitive", found, "separate triangles, mode 4"));
        }
        let view = compressed.buffer_view;
        unfolding.decode(view)?;
        if let Some(index) = primitive.indices
            && is_new(index, (view, None))?
        {
            let field = format!("indices of compressed buffer view {view}");
            let bytes = unfolding.indices(view, accessor(index)?, &field)?;
            out.insert(index, bytes);
        }
        for (name, &number) in &compressed.attributes {
            let Some(&index) = primitive.attributes.get(name) else { continue };
            if !is_new(index, (view, Some(number)))? {
                continue;
            }
            let field = format!("{name} of compressed buffer view {view}");
            let bytes = unfolding.attribute(view, number, accessor(index)?, &field)?;
            out.insert(index, bytes);
        }
    }
    Ok(out)
}

impl Unfolding<'_> {
    /// Decodes the mesh of a view, unless it has been.
    fn decode(&mut self, view: usize) -> Result<(), ImportError> {
        if self.meshes.contains_key(&view) {
            return Ok(());
        }
        let most = self.limits.max_gaussians as u64;
        let limits = DecodeLimits::default()
            .with_max_points(most)
            .with_max_faces(most.saturating_mul(2))
            .with_max_decoded_bytes(self.left);
        let mut source = DecoderBuffer::new(self.buffers.view(view)?).with_limits(limits);
        let mut mesh = Mesh::new();
        MeshDecoder::new().decode(&mut source, &mut mesh).map_err(|e| {
            FORMAT.malformed(format!("compressed buffer view {view}"), e, "an undamaged Draco mesh")
        })?;
        let attributes = (0..mesh.num_attributes()).filter_map(|id| mesh.try_attribute(id).ok());
        let bytes: usize = attributes.map(|attribute| attribute.buffer().data().len()).sum();
        self.spend(bytes.saturating_add(mesh.num_faces().saturating_mul(12)), "Draco meshes")?;
        self.meshes.insert(view, mesh);
        Ok(())
    }

    /// Takes `bytes` from what is left.
    fn spend(&mut self, bytes: usize, field: &str) -> Result<(), ImportError> {
        let allowed = format_args!("{} bytes in all", self.limits.max_bytes);
        let left = self.left.checked_sub(bytes as u64);
        self.left = left.ok_or_else(|| FORMAT.error(ErrorKind::TooLarge, field, "more", allowed))?;
        Ok(())
    }

    fn mesh(&self, view: usize, field: &str) -> Result<&Mesh, ImportError> {
        self.meshes.get(&view).ok_or_else(|| FORMAT.empty(field))
    }

    /// The corners of all triangles, as `accessor` has them.
    fn indices(
        &mut self,
        view: usize,
        accessor: &AccessorLayout,
        field: &str,
    ) -> Result<Vec<u8>, ImportError> {
        let count = self.mesh(view, field)?.num_faces().saturating_mul(3);
        if accessor.count != count || accessor.kind != "SCALAR" {
            let found = format!("{} of type {}", accessor.count, accessor.kind);
            return Err(FORMAT.malformed(field, found, format_args!("{count} of type SCALAR")));
        }
        let width = match accessor.component_type {
            5121 => 1,
            5123 => 2,
            5125 => 4,
            other => return Err(FORMAT.malformed(field, other, "component type 5121, 5123 or 5125")),
        };
        self.spend(count.saturating_mul(width), field)?;
        let most = if width == 4 { u32::MAX } else { (1 << (8 * width)) - 1 };
        let mut out = Vec::with_capacity(count * width);
        for corner in self.mesh(view, field)?.faces().iter().flatten() {
            if corner.0 > most {
                return Err(FORMAT.malformed(field, corner.0, format_args!("up to {most}")));
            }
            out.extend(&corner.0.to_le_bytes()[..width]);
        }
        Ok(out)
    }

    /// The values of an attribute for all vertices, as `accessor` has them.
    fn attribute(
        &mut self,
        view: usize,
        number: u32,
        accessor: &AccessorLayout,
        field: &str,
    ) -> Result<Vec<u8>, ImportError> {
        let mesh = self.mesh(view, field)?;
        let points = mesh.num_points();
        if accessor.count != points {
            return Err(FORMAT.malformed(field, format_args!("{} elements", accessor.count), points));
        }
        let attribute = mesh.attribute_by_unique_id(number);
        let attribute =
            attribute.ok_or_else(|| FORMAT.malformed(field, number, "an attribute of the stream"))?;
        let element = element_bytes(attribute, accessor, field)?;
        self.spend(points.saturating_mul(element), field)?;
        let attribute = self.mesh(view, field)?.attribute_by_unique_id(number);
        let attribute = attribute.ok_or_else(|| FORMAT.empty(field))?;
        let (values, stride) = (attribute.buffer().data(), attribute.byte_stride() as usize);
        let mut out = Vec::with_capacity(points * element);
        for point in 0..points {
            let start = (attribute.mapped_index(PointIndex(point as u32)).0 as usize).saturating_mul(stride);
            let value = values.get(start..start.saturating_add(element));
            out.extend(value.ok_or_else(|| FORMAT.truncated(field, values.len() as u64, start as u64))?);
        }
        Ok(out)
    }
}

/// Bytes of an element that the stream and the accessor describe alike.
fn element_bytes(
    attribute: &PointAttribute,
    accessor: &AccessorLayout,
    field: &str,
) -> Result<usize, ImportError> {
    let (component, size) = match attribute.data_type() {
        DataType::Int8 => (5120, 1),
        DataType::Uint8 => (5121, 1),
        DataType::Int16 => (5122, 2),
        DataType::Uint16 => (5123, 2),
        DataType::Uint32 => (5125, 4),
        DataType::Float32 => (5126, 4),
        other => return Err(FORMAT.malformed(field, format_args!("{other:?}"), "a type of glTF")),
    };
    let kind = match attribute.num_components() {
        1 => "SCALAR",
        2 => "VEC2",
        3 => "VEC3",
        4 => "VEC4",
        other => return Err(FORMAT.malformed(field, format_args!("{other} components"), "one to four")),
    };
    if (accessor.component_type, accessor.kind.as_str()) != (component, kind) {
        let found = format!("component type {component} and type {kind}");
        let allowed = format!("{} and {}, as the accessor has them", accessor.component_type, accessor.kind);
        return Err(FORMAT.malformed(field, found, allowed));
    }
    Ok(usize::from(attribute.num_components()) * size)
}
