//! Writes glTF with `KHR_gaussian_splatting`, as GLB or as JSON with its buffer beside it: one primitive of
//! points, an accessor per attribute.
//!
//! Lossless but for the domains: sizes and opacities are linear there, quaternions xyzw. `COLOR_0` shows
//! points where the extension is not known.

use serde_json::{Value, json};

use super::{byte, display_colour, sigmoid};
use crate::scene::Epoch;

/// Name of the extension.
pub(crate) const EXTENSION: &str = "KHR_gaussian_splatting";
/// Component types of accessors: bytes and floats.
const UNSIGNED_BYTE: u32 = 5121;
const FLOAT: u32 = 5126;

/// The binary chunk and what describes it.
#[derive(Default)]
struct Buffer {
    bytes: Vec<u8>,
    views: Vec<Value>,
    accessors: Vec<Value>,
}

impl Buffer {
    /// Adds an accessor of `count` elements of `kind` over `bytes`, and gives its number.
    fn add(&mut self, count: usize, kind: &str, component: u32, bytes: &[u8]) -> usize {
        let view = json!({
            "buffer": 0, "byteOffset": self.bytes.len(), "byteLength": bytes.len(), "target": 34962,
        });
        self.views.push(view);
        self.bytes.extend(bytes);
        self.bytes.resize(self.bytes.len().next_multiple_of(4), 0);
        let mut accessor = json!({
            "bufferView": self.views.len() - 1, "componentType": component, "count": count, "type": kind,
        });
        if component == UNSIGNED_BYTE {
            accessor["normalized"] = json!(true);
        }
        self.accessors.push(accessor);
        self.accessors.len() - 1
    }

    fn floats(&mut self, count: usize, kind: &str, values: impl Iterator<Item = f32>) -> usize {
        let bytes: Vec<u8> = values.flat_map(f32::to_le_bytes).collect();
        self.add(count, kind, FLOAT, &bytes)
    }
}

/// Frame `t` of `epoch` as GLB. `t` must be below the epoch's frame count.
///
/// # Errors
/// More bytes than the format's 32-bit lengths hold.
pub fn encode(epoch: &Epoch, t: usize) -> std::io::Result<Vec<u8>> {
    let (document, buffer) = document(epoch, t);
    let mut text = document.to_string().into_bytes();
    text.resize(text.len().next_multiple_of(4), b' ');
    let length = |bytes: usize| {
        let why = "more bytes than a GLB holds";
        u32::try_from(bytes).map_err(|_| std::io::Error::new(std::io::ErrorKind::InvalidInput, why))
    };
    let mut out = b"glTF\x02\0\0\0".to_vec();
    out.extend(length(12 + 8 + text.len() + 8 + buffer.len())?.to_le_bytes());
    for (kind, chunk) in [(b"JSON", &text), (b"BIN\0", &buffer)] {
        out.extend(length(chunk.len())?.to_le_bytes());
        out.extend(kind);
        out.extend(chunk);
    }
    Ok(out)
}

/// Frame `t` of `epoch` as the JSON of glTF, and the buffer that it reads from the file `buffer_name` beside
/// it. `t` must be below the epoch's frame count.
pub(super) fn encode_apart(epoch: &Epoch, t: usize, buffer_name: &str) -> (Vec<u8>, Vec<u8>) {
    let (mut document, buffer) = document(epoch, t);
    document["buffers"][0]["uri"] = json!(uri_of(buffer_name));
    (format!("{document:#}\n").into_bytes(), buffer)
}

/// A file's name as a relative reference of RFC 3986: what is not unreserved there is escaped.
fn uri_of(name: &str) -> String {
    let escaped = |byte: u8| match byte {
        b'A'..=b'Z' | b'a'..=b'z' | b'0'..=b'9' | b'-' | b'.' | b'_' | b'~' => char::from(byte).to_string(),
        _ => format!("%{byte:02X}"),
    };
    name.bytes().map(escaped).collect()
}

/// The JSON of frame `t` of `epoch`, and its one buffer, of which it does not say where it lies.
fn document(epoch: &Epoch, t: usize) -> (Value, Vec<u8>) {
    let (n, a) = (epoch.count(), epoch.attributes());
    let (p, q) = (a.positions.frame(t, n), a.rotations.frame(t, n));
    let (s, o, c) = (a.log_scales.frame(t, n), a.opacity_logits.frame(t, n), a.sh0.frame(t, n));
    let mut buffer = Buffer::default();
    let mut attributes = serde_json::Map::new();
    let position = buffer.floats(n, "VEC3", p.iter().flatten().copied());
    let bound = |least: bool| {
        let pick = if least { f32::min } else { f32::max };
        let start = if least { f32::INFINITY } else { f32::NEG_INFINITY };
        [0, 1, 2].map(|axis| p.iter().fold(start, |bound, p| pick(bound, p[axis])))
    };
    if n > 0 {
        buffer.accessors[position]["min"] = json!(bound(true));
        buffer.accessors[position]["max"] = json!(bound(false));
    }
    attributes.insert("POSITION".to_owned(), json!(position));
    let colours: Vec<u8> =
        (0..n).flat_map(|i| c[i].map(display_colour).into_iter().chain([sigmoid(o[i])]).map(byte)).collect();
    attributes.insert("COLOR_0".to_owned(), json!(buffer.add(n, "VEC4", UNSIGNED_BYTE, &colours)));
    let mut put =
        |name: String, accessor: usize| attributes.insert(format!("{EXTENSION}:{name}"), json!(accessor));
    put("ROTATION".into(), buffer.floats(n, "VEC4", q.iter().flat_map(|&[w, x, y, z]| [x, y, z, w])));
    put("SCALE".into(), buffer.floats(n, "VEC3", s.iter().flatten().map(|v| v.exp())));
    put("OPACITY".into(), buffer.floats(n, "SCALAR", o.iter().copied().map(sigmoid)));
    put("SH_DEGREE_0_COEF_0".into(), buffer.floats(n, "VEC3", c.iter().flatten().copied()));
    let rest = a.sh_degree.rest_len();
    for degree in 1..=usize::from(a.sh_degree.get()) {
        for coefficient in 0..2 * degree + 1 {
            let first = 3 * (degree * degree - 1 + coefficient);
            let values = (0..n).flat_map(|i| a.sh_rest[i * rest + first..][..3].iter().copied());
            let accessor = buffer.floats(n, "VEC3", values);
            put(format!("SH_DEGREE_{degree}_COEF_{coefficient}"), accessor);
        }
    }
    let document = json!({
        "asset": { "version": "2.0", "generator": "dgs" },
        "extensionsUsed": [EXTENSION],
        "scene": 0, "scenes": [{ "nodes": [0] }], "nodes": [{ "mesh": 0 }],
        "meshes": [{ "primitives": [{
            "mode": 0, "attributes": attributes,
            "extensions": { EXTENSION: {
                "kernel": "ellipse", "colorSpace": "srgb_rec709_display", "projection": "perspective",
                "sortingMethod": "cameraDistance",
            } },
        }] }],
        "buffers": [{ "byteLength": buffer.bytes.len() }],
        "bufferViews": buffer.views, "accessors": buffer.accessors,
    });
    (document, buffer.bytes)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{
        export::tests::{assert_close, epoch},
        import::{self, Limits},
    };

    #[test]
    fn names_are_escaped_as_addresses_are() {
        assert_eq!(uri_of("a-1_b~.bin"), "a-1_b~.bin");
        assert_eq!(uri_of("mein Fuß #1.bin"), "mein%20Fu%C3%9F%20%231.bin");
    }

    #[test]
    fn files_read_back_but_for_rounding() {
        for degree in [0, 3] {
            let epoch = epoch(50, degree);
            let bytes = encode(&epoch, 0).unwrap();
            let nothing = |name: &str| panic!("{name} is not in the file");
            let again = import::gltf_splats::parse(&bytes, nothing, &Limits::default()).unwrap().epoch;
            let (text, buffer) = encode_apart(&epoch, 0, "50 %.bin");
            let beside = |name: &str| {
                assert_eq!(name, "50 %.bin");
                Ok(buffer.clone())
            };
            let apart = import::gltf_splats::parse(&text, beside, &Limits::default()).unwrap().epoch;
            assert_eq!(apart.attributes(), again.attributes(), "the same in two files");
            let (a, b) = (epoch.attributes(), again.attributes());
            assert_eq!((&a.positions, &a.sh0, &a.sh_rest), (&b.positions, &b.sh0, &b.sh_rest));
            assert_close("scale", &epoch, &again, 1e-5, |a, n, i| a.log_scales.frame(0, n)[i].to_vec());
            assert_close("rotation", &epoch, &again, 1e-6, |a, n, i| a.rotations.frame(0, n)[i].to_vec());
            assert_close("opacity", &epoch, &again, 1e-3, |a, n, i| vec![a.opacity_logits.frame(0, n)[i]]);
        }
    }
}
