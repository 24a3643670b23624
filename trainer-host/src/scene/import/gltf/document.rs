//! Loads the file as data: JSON validated by the `gltf` crate, buffers at hand, accessors read with every
//! index checked. The crate's own accessor readers slice without checking and are not used.

use std::{collections::BTreeMap, fmt::Display};

use gltf::{
    accessor::{DataType, Dimensions},
    json,
};

use super::draco;
use crate::scene::import::{
    Limits,
    bytes::{array, u32_at},
    error::{ErrorKind, Format, ImportError},
    gltf_buffers::{Buffers, COMPRESSIONS, resource},
};

/// Extensions that a file may need: what is compressed is unfolded when it is loaded, whole numbers are read
/// as any others, and textures are moved when they are sampled.
const EXTENSIONS: [&str; 5] =
    ["KHR_mesh_quantization", "KHR_texture_transform", draco::EXTENSION, COMPRESSIONS[0], COMPRESSIONS[1]];

/// The format that errors of every file below name.
pub(super) const FORMAT: Format = Format::Gltf;

/// The error of a `field` that is more than the limits allow.
pub(super) fn too_large(field: &str, found: impl Display, allowed: impl Display) -> ImportError {
    FORMAT.error(ErrorKind::TooLarge, field, found, allowed)
}

/// A loaded file.
pub(super) struct Document {
    pub gltf: ::gltf::Document,
    buffers: Buffers,
    /// The elements of accessors that Draco has compressed, without gaps.
    unfolded: BTreeMap<usize, Vec<u8>>,
    /// The files of images, in their order; none where an image lies in a view.
    images: Vec<Vec<u8>>,
    max_values: usize,
}

impl Document {
    /// Names of the clips, in order; a clip without a name is its number.
    pub fn clip_names(&self) -> Vec<String> {
        let clips = self.gltf.animations();
        clips.map(|a| a.name().map_or_else(|| a.index().to_string(), str::to_owned)).collect()
    }

    /// The names of the clips in a sentence.
    pub fn clip_list(&self) -> String {
        let names = self.clip_names();
        if names.is_empty() { "none".to_owned() } else { names.join(", ") }
    }

    /// Loads text or binary glTF, its buffers included.
    pub fn load(
        bytes: &[u8],
        mut beside: impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
        limits: &Limits,
    ) -> Result<Self, ImportError> {
        let (text, blob) = if bytes.starts_with(b"glTF") { chunks(bytes)? } else { (bytes, None) };
        let mut root: json::Root = json::deserialize::from_slice(text)
            .map_err(|e| FORMAT.malformed("JSON", e, "the JSON of glTF 2.0"))?;
        // The crate knows fewer of them.
        for name in std::mem::take(&mut root.extensions_required) {
            if !EXTENSIONS.contains(&name.as_str()) {
                return Err(FORMAT.unsupported("extensionsRequired", name, EXTENSIONS.join(", ")));
            }
        }
        check_indices(&root)?;
        let buffers = Buffers::load(FORMAT, text, blob, &mut beside, limits)?;
        let unfolded = draco::unfolded(text, &buffers, limits)?;
        for (index, accessor) in root.accessors.iter_mut().enumerate() {
            // The crate wants a view of each, which nobody reads where there are unfolded elements.
            if unfolded.contains_key(&index) && !root.buffer_views.is_empty() {
                accessor.buffer_view = Some(json::Index::new(0));
            }
        }
        let gltf = ::gltf::Document::from_json(root)
            .map_err(|e| FORMAT.malformed("JSON", e, "a consistent document"))?;
        let max_values = limits.max_gaussians.saturating_mul(16);
        let mut document = Self { gltf, buffers, unfolded, images: Vec::new(), max_values };
        document.embed_images(beside)?;
        Ok(document)
    }

    /// Reads the image files the document names, so that nothing later needs file access.
    fn embed_images(
        &mut self,
        mut beside: impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
    ) -> Result<(), ImportError> {
        // Straight from the JSON: the crate's `Image::source` wants a mime type beside every view.
        for image in &self.gltf.as_json().images {
            let data = match &image.uri {
                None => Vec::new(),
                Some(uri) => resource(FORMAT, uri, &mut beside)?,
            };
            self.images.push(data);
        }
        Ok(())
    }

    /// The encoded bytes of an image.
    pub fn image_bytes(&self, image: &::gltf::Image<'_>) -> Result<&[u8], ImportError> {
        let view = self.gltf.as_json().images.get(image.index()).and_then(|i| i.buffer_view);
        match view {
            Some(view) => self.buffers.view(view.value()),
            None => Ok(self.images.get(image.index()).map_or(&[][..], Vec::as_slice)),
        }
    }

    /// An accessor's values as f32, `components` of them per element (normalised integers become
    /// 0..=1 or -1..=1).
    pub fn floats(
        &self,
        accessor: &::gltf::Accessor<'_>,
        components: usize,
    ) -> Result<Vec<f32>, ImportError> {
        let scale = if accessor.normalized() {
            match accessor.data_type() {
                DataType::U8 => 255.0,
                DataType::I8 => 127.0,
                DataType::U16 => 65_535.0,
                DataType::I16 => 32_767.0,
                _ => 1.0,
            }
        } else {
            1.0
        };
        let values = self.values(accessor, components)?;
        Ok(values
            .into_iter()
            .map(|v| (v / scale).max(if accessor.normalized() { -1.0 } else { f64::MIN }) as f32)
            .collect())
    }

    /// An accessor's values as unsigned integers, `components` of them per element.
    pub fn integers(
        &self,
        accessor: &::gltf::Accessor<'_>,
        components: usize,
    ) -> Result<Vec<u32>, ImportError> {
        Ok(self.values(accessor, components)?.into_iter().map(|v| v as u32).collect())
    }

    fn values(&self, accessor: &::gltf::Accessor<'_>, components: usize) -> Result<Vec<f64>, ImportError> {
        let field = format!("accessor {}", accessor.index());
        if multiplicity(accessor.dimensions()) != components {
            let found = format!("{:?}", accessor.dimensions());
            return Err(FORMAT.malformed(field, found, format_args!("{components} components")));
        }
        let total = accessor.count().checked_mul(components).filter(|t| *t <= self.max_values);
        let total = total.ok_or_else(|| {
            too_large(&field, format!("{} elements", accessor.count()), format!("{} values", self.max_values))
        })?;
        let size = accessor.data_type().size();
        let mut out = Vec::new();
        let elements = match (self.unfolded.get(&accessor.index()), accessor.view()) {
            (Some(bytes), _) => Some((&bytes[..], components * size, 0)),
            (None, Some(view)) => {
                let stride = view.stride().unwrap_or(components * size);
                Some((self.buffers.view(view.index())?, stride, accessor.offset()))
            }
            (None, None) => None,
        };
        match elements {
            None => {
                // Zeros for sparse values to replace. The mesh they belong to has its other attributes in
                // buffers, so there are never more of them than bytes.
                let bytes = self.buffers.bytes();
                if total > bytes {
                    let found = format!("{total} values without a buffer view");
                    return Err(too_large(&field, found, format!("{bytes}, as many as bytes")));
                }
                out.resize(total, 0.0);
            }
            Some((bytes, stride, offset)) => {
                let needed = match accessor.count().checked_sub(1) {
                    None => Some(0),
                    Some(last) => last
                        .checked_mul(stride)
                        .and_then(|o| o.checked_add(offset))
                        .and_then(|o| o.checked_add(components * size)),
                };
                if needed.is_none_or(|n| n > bytes.len()) {
                    let needed = needed.unwrap_or(usize::MAX) as u64;
                    return Err(FORMAT.truncated(field, bytes.len() as u64, needed));
                }
                out.reserve_exact(total);
                for element in 0..accessor.count() {
                    let at = offset + element * stride;
                    out.extend((0..components).map(|c| scalar(bytes, at + c * size, accessor.data_type())));
                }
            }
        }
        if let Some(sparse) = accessor.sparse() {
            let (indices, values) = (sparse.indices(), sparse.values());
            let index_bytes = self.buffers.view(indices.view().index())?;
            let value_bytes = self.buffers.view(values.view().index())?;
            let kind = match indices.index_type() {
                ::gltf::accessor::sparse::IndexType::U8 => DataType::U8,
                ::gltf::accessor::sparse::IndexType::U16 => DataType::U16,
                ::gltf::accessor::sparse::IndexType::U32 => DataType::U32,
            };
            if sparse.count() > accessor.count() {
                return Err(FORMAT.malformed(field, sparse.count(), "no more sparse values than elements"));
            }
            for i in 0..sparse.count() {
                let element = scalar(index_bytes, indices.offset().saturating_add(i * kind.size()), kind);
                if !(0.0..accessor.count() as f64).contains(&element) {
                    return Err(FORMAT.malformed(field, element, "a sparse index below the count"));
                }
                for c in 0..components {
                    let at = values.offset().saturating_add((i * components + c) * size);
                    out[element as usize * components + c] = scalar(value_bytes, at, accessor.data_type());
                }
            }
        }
        Ok(out)
    }
}

fn multiplicity(dimensions: Dimensions) -> usize {
    dimensions.multiplicity()
}

/// The value at `at`, NaN past the end.
fn scalar(bytes: &[u8], at: usize, kind: DataType) -> f64 {
    let value = match kind {
        DataType::I8 => array(bytes, at).map(|b| f64::from(i8::from_le_bytes(b))),
        DataType::U8 => array(bytes, at).map(|b| f64::from(u8::from_le_bytes(b))),
        DataType::I16 => array(bytes, at).map(|b| f64::from(i16::from_le_bytes(b))),
        DataType::U16 => array(bytes, at).map(|b| f64::from(u16::from_le_bytes(b))),
        DataType::U32 => array(bytes, at).map(|b| f64::from(u32::from_le_bytes(b))),
        DataType::F32 => array(bytes, at).map(|b| f64::from(f32::from_le_bytes(b))),
    };
    value.unwrap_or(f64::NAN)
}

/// Indices that the crate's own validation uses before it has checked them, or never checks.
fn check_indices(root: &json::Root) -> Result<(), ImportError> {
    let below = |what: &str, index: usize, count: usize| {
        if index < count { Ok(()) } else { Err(FORMAT.malformed(what, index, format_args!("below {count}"))) }
    };
    for primitive in root.meshes.iter().flat_map(|m| &m.primitives) {
        for accessor in primitive.attributes.values() {
            below("primitive attribute", accessor.value(), root.accessors.len())?;
        }
    }
    for animation in &root.animations {
        for channel in &animation.channels {
            below("channel target", channel.target.node.value(), root.nodes.len())?;
            below("channel sampler", channel.sampler.value(), animation.samplers.len())?;
            if matches!(channel.target.path, json::validation::Checked::Invalid) {
                let allowed = "translation, rotation, scale or weights";
                return Err(FORMAT.malformed("channel path", "another word", allowed));
            }
        }
    }
    Ok(())
}

/// The JSON and BIN chunks of a GLB.
pub(super) fn chunks(bytes: &[u8]) -> Result<(&[u8], Option<&[u8]>), ImportError> {
    let word = |at: usize| {
        u32_at(bytes, at)
            .ok_or_else(|| FORMAT.truncated("GLB header", bytes.len() as u64, at as u64 + 4).at(at))
    };
    if word(4)? != 2 {
        return Err(FORMAT.unsupported("GLB version", word(4)?, "2").at(4));
    }
    let length = word(8)? as usize;
    if length > bytes.len() {
        return Err(FORMAT.truncated("GLB", bytes.len() as u64, length as u64).at(8));
    }
    let (mut json, mut blob, mut offset) = (None, None, 12);
    while offset + 8 <= length {
        let (size, kind) = (word(offset)? as usize, word(offset + 4)?);
        let data = bytes[..length].get(offset + 8..(offset + 8).saturating_add(size)).ok_or_else(|| {
            FORMAT.truncated("GLB chunk", (length - offset - 8) as u64, size as u64).at(offset)
        })?;
        match kind {
            0x4e4f_534a => json = json.or(Some(data)),
            0x004e_4942 => blob = blob.or(Some(data)),
            _ => {}
        }
        offset += 8 + size;
    }
    let json = json.ok_or_else(|| FORMAT.malformed("GLB", "no JSON chunk", "a JSON chunk first").at(12))?;
    Ok((json, blob))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_chunk_longer_than_the_file_is_refused() {
        let mut glb = b"glTF\x02\0\0\0\x1c\0\0\0".to_vec();
        glb.extend([0xff, 0xff, 0xff, 0x7f]);
        glb.extend(b"JSON{}      ");
        assert!(chunks(&glb).unwrap_err().to_string().contains("GLB chunk at byte 12"));
    }
}
