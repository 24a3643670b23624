//! Reads the values of an accessor: floats, or whole numbers that may be normalised.

use serde::Deserialize;

use crate::scene::import::{
    Limits,
    bytes::array,
    error::{Format, ImportError},
    gltf_buffers::Buffers,
};

const FORMAT: Format = Format::GltfSplats;

/// An accessor as the file describes it.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Accessor {
    buffer_view: Option<usize>,
    #[serde(default)]
    byte_offset: usize,
    component_type: u32,
    #[serde(default)]
    normalized: bool,
    /// How many elements there are.
    pub count: usize,
    /// What an element is: SCALAR, VEC3 and the like.
    #[serde(rename = "type")]
    pub kind: String,
    sparse: Option<serde_json::Value>,
}

/// What lies in a buffer view, as far as accessors need to know.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct View {
    byte_stride: Option<usize>,
}

impl Accessor {
    /// Its values, and how many there are per element. `name` is what errors call it. Where `keep_readable`
    /// is set, as many elements as there are bytes for.
    ///
    /// # Errors
    /// Sparse values, a component type or a stride that the format does not have, or fewer bytes than values.
    pub fn values(
        &self,
        name: &str,
        views: &[View],
        buffers: &Buffers,
        limits: &Limits,
    ) -> Result<(Vec<f32>, usize), ImportError> {
        let width = match self.kind.as_str() {
            "SCALAR" => 1,
            "VEC3" => 3,
            _ => 4,
        };
        if self.sparse.is_some() {
            return Err(FORMAT.unsupported(name, "a sparse accessor", "plain values"));
        }
        limits.gaussians(FORMAT, self.count as u64)?;
        let view =
            self.buffer_view.ok_or_else(|| FORMAT.malformed(name, "no buffer view", "a buffer view"))?;
        let bytes = buffers.view(view).map_err(|e| ImportError { field: name.into(), ..e })?;
        let (size, full) = match (self.component_type, self.normalized) {
            (5126, _) => (4, 1.0),
            (5120, true) => (1, 127.0),
            (5121, true) => (1, 255.0),
            (5122, true) => (2, 32_767.0),
            (5123, true) => (2, 65_535.0),
            (5120 | 5121, false) => (1, 1.0),
            (5122 | 5123, false) => (2, 1.0),
            (other, _) => return Err(FORMAT.malformed(name, other, "component type 5120 to 5123 or 5126")),
        };
        let element = width * size;
        let stride = match views.get(view).and_then(|view| view.byte_stride) {
            None => element,
            // What is shorter would give one Gaussian the values of another.
            Some(stride)
                if stride >= element && (4..=252).contains(&stride) && stride.is_multiple_of(size) =>
            {
                stride
            }
            Some(stride) => {
                let field = format!("byteStride of {name}");
                let least = element.max(4);
                let allowed = format!("{least} to 252 bytes, a multiple of {size}");
                return Err(FORMAT.malformed(field, stride, allowed));
            }
        };
        let needed = (self.count - 1)
            .checked_mul(stride)
            .and_then(|bytes| bytes.checked_add(self.byte_offset)?.checked_add(element));
        let mut count = self.count;
        if needed.is_none_or(|needed| needed > bytes.len()) {
            if !limits.keep_readable {
                let needed = needed.unwrap_or(usize::MAX) as u64;
                return Err(FORMAT.truncated(name, bytes.len() as u64, needed));
            }
            let behind_first =
                bytes.len().checked_sub(self.byte_offset).and_then(|left| left.checked_sub(element));
            count = behind_first.map_or(0, |left| count.min(left / stride + 1));
        }
        let scalar = |at: usize| -> f32 {
            let value = match self.component_type {
                5126 => return f32::from_le_bytes(array(bytes, at).unwrap_or_default()),
                5120 => f32::from(i8::from_le_bytes(array(bytes, at).unwrap_or_default())),
                5121 => f32::from(bytes[at]),
                5122 => f32::from(i16::from_le_bytes(array(bytes, at).unwrap_or_default())),
                _ => f32::from(u16::from_le_bytes(array(bytes, at).unwrap_or_default())),
            };
            (value / full).max(if self.normalized { -1.0 } else { f32::MIN })
        };
        let components = |i: usize| (0..width).map(move |c| self.byte_offset + i * stride + c * size);
        Ok(((0..count).flat_map(components).map(scalar).collect(), width))
    }
}
