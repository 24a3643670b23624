//! Decodes buffer views of `EXT_meshopt_compression` and `KHR_meshopt_compression`, of both versions of the
//! stream, in all modes and with all filters.

mod attributes;
mod filters;
mod indices;
mod source;

use serde::Deserialize;

use self::source::Fault;
use super::error::{Format, ImportError};

/// What a stream holds.
#[derive(Clone, Copy, Debug, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "UPPERCASE")]
enum Mode {
    Attributes,
    Triangles,
    Indices,
}

/// What is done to attributes after they are decoded.
#[derive(Clone, Copy, Debug, Default, Deserialize, PartialEq, Eq)]
#[serde(rename_all = "UPPERCASE")]
enum Filter {
    #[default]
    None,
    Octahedral,
    Quaternion,
    Exponential,
    Color,
}

/// Where a view's stream lies and what it holds.
#[derive(Clone, Debug, Deserialize)]
#[serde(rename_all = "camelCase")]
pub(super) struct Compressed {
    /// The buffer that holds the stream.
    pub buffer: usize,
    /// Where in it.
    #[serde(default)]
    pub byte_offset: usize,
    /// Bytes of the stream.
    pub byte_length: usize,
    byte_stride: usize,
    count: usize,
    mode: Mode,
    #[serde(default)]
    filter: Filter,
}

impl Compressed {
    /// Bytes that the stream unfolds to, when its numbers fit together. `length` is that of the view.
    pub fn unfolded_bytes(&self, format: Format, field: &str, length: usize) -> Result<usize, ImportError> {
        let stride = self.byte_stride;
        let malformed = |what: &str, found: &dyn std::fmt::Display, allowed: &str| {
            Err(format.malformed(format!("{what} of {field}"), found, allowed))
        };
        if self.mode == Mode::Attributes {
            if !(4..=256).contains(&stride) || !stride.is_multiple_of(4) {
                return malformed("byteStride", &stride, "a multiple of 4 up to 256");
            }
        } else {
            if stride != 2 && stride != 4 {
                return malformed("byteStride", &stride, "2 or 4");
            }
            if self.filter != Filter::None {
                return malformed(
                    "filter",
                    &format_args!("{:?}", self.filter),
                    "none where there are indices",
                );
            }
        }
        if self.mode == Mode::Triangles && !self.count.is_multiple_of(3) {
            return malformed("count", &self.count, "a multiple of 3");
        }
        let strides: &[usize] = match self.filter {
            Filter::None | Filter::Exponential => &[],
            Filter::Octahedral | Filter::Color => &[4, 8],
            Filter::Quaternion => &[8],
        };
        if !strides.is_empty() && !strides.contains(&stride) {
            return malformed("byteStride", &stride, "what its filter takes: 8, or 4 unless of quaternions");
        }
        match self.count.checked_mul(stride) {
            Some(bytes) if bytes == length => Ok(bytes),
            _ => malformed("byteLength", &length, &format!("{} elements of {stride} bytes", self.count)),
        }
    }

    /// The elements of `stream`. The caller has accepted [`Compressed::unfolded_bytes`].
    pub fn unfold(&self, stream: &[u8], format: Format, field: &str) -> Result<Vec<u8>, ImportError> {
        let unfolded = match self.mode {
            Mode::Attributes => {
                attributes::decode(stream, self.count, self.byte_stride).map(|v| self.filtered(v))
            }
            Mode::Triangles => indices::triangles(stream, self.count).map(|v| self.narrowed(&v)),
            Mode::Indices => indices::indices(stream, self.count).map(|v| self.narrowed(&v)),
        };
        unfolded.map_err(|Fault { field: what, found, allowed }| {
            format.malformed(format!("{what} of compressed {field}"), found, allowed)
        })
    }

    fn filtered(&self, mut data: Vec<u8>) -> Vec<u8> {
        match self.filter {
            Filter::None => {}
            Filter::Octahedral => filters::octahedral(&mut data, self.byte_stride),
            Filter::Quaternion => filters::quaternion(&mut data),
            Filter::Exponential => filters::exponential(&mut data),
            Filter::Color => filters::colour(&mut data, self.byte_stride),
        }
        data
    }

    /// Indices in as many bytes as the view says.
    fn narrowed(&self, indices: &[u32]) -> Vec<u8> {
        if self.byte_stride == 2 {
            return indices.iter().flat_map(|&index| (index as u16).to_le_bytes()).collect();
        }
        indices.iter().flat_map(|index| index.to_le_bytes()).collect()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::ErrorKind;

    const FORMAT: Format = Format::Gltf;

    /// A view as the encoder of others wrote it, and what their decoder made of it.
    struct Stream {
        name: String,
        compressed: Compressed,
        stream: Vec<u8>,
        unfolded: Vec<u8>,
    }

    fn streams() -> Vec<Stream> {
        let text = include_str!("../../../tests/compressed/streams.json");
        let all: Vec<serde_json::Value> = serde_json::from_str(text).unwrap();
        let hex = |value: &serde_json::Value| -> Vec<u8> {
            let text = value.as_str().unwrap();
            (0..text.len()).step_by(2).map(|i| u8::from_str_radix(&text[i..i + 2], 16).unwrap()).collect()
        };
        let stream = |value: &serde_json::Value| {
            let (stream, unfolded) = (hex(&value["stream"]), hex(&value["unfolded"]));
            let compressed = serde_json::json!({
                "buffer": 0, "byteLength": stream.len(), "byteStride": value["stride"],
                "count": value["count"], "mode": value["mode"], "filter": value["filter"],
            });
            let name = value["name"].as_str().unwrap().to_owned();
            Stream { name, compressed: serde_json::from_value(compressed).unwrap(), stream, unfolded }
        };
        all.iter().map(stream).collect()
    }

    #[test]
    fn what_others_wrote_is_read_as_they_read_it() {
        let streams = streams();
        assert!(streams.len() > 20);
        for Stream { name, compressed, stream, unfolded } in &streams {
            let bytes = compressed.unfolded_bytes(FORMAT, name, unfolded.len()).unwrap();
            assert_eq!(bytes, unfolded.len(), "{name}");
            let ours = compressed.unfold(stream, FORMAT, name).unwrap();
            assert_eq!(ours.len(), unfolded.len(), "{name}");
            // The specification allows filters, but for that of floats, one unit of what they write.
            let wide = compressed.byte_stride == 8;
            let number = |bytes: &[u8]| match bytes {
                [one] => i32::from(*one),
                [low, high] => i32::from(u16::from_le_bytes([*low, *high])),
                _ => 0,
            };
            let exact = matches!(compressed.filter, Filter::None | Filter::Exponential);
            let size = if wide { 2 } else { 1 };
            for (ours, theirs) in ours.chunks(size).zip(unfolded.chunks(size)) {
                let off = (number(ours) - number(theirs)).abs();
                assert!(off <= i32::from(!exact), "{name}: {ours:?} is not {theirs:?}");
            }
        }
    }

    #[test]
    fn streams_with_a_byte_missing_are_refused() {
        for Stream { name, compressed, stream, .. } in &streams() {
            let error = compressed.unfold(&stream[..stream.len() - 1], FORMAT, name).map(|v| v.len());
            // What a stream of one element lacks may be padding.
            assert!(error.is_err() || compressed.count == 1, "{name}: {error:?}");
            assert!(compressed.unfold(&[], FORMAT, name).is_err());
        }
    }

    #[test]
    fn damaged_streams_do_no_harm() {
        for Stream { name, compressed, stream, unfolded } in &streams() {
            for place in 0..stream.len() {
                let mut damaged = stream.clone();
                damaged[place] ^= 1 << (place % 8);
                if let Ok(bytes) = compressed.unfold(&damaged, FORMAT, name) {
                    assert_eq!(bytes.len(), unfolded.len());
                }
            }
        }
    }

    #[test]
    fn numbers_that_do_not_fit_together_are_named() {
        let with = |edit: &dyn Fn(&mut Compressed)| {
            let mut compressed = Compressed {
                buffer: 0,
                byte_offset: 0,
                byte_length: 0,
                byte_stride: 8,
                count: 6,
                mode: Mode::Attributes,
                filter: Filter::None,
            };
            edit(&mut compressed);
            compressed.unfolded_bytes(FORMAT, "buffer view 3", 48)
        };
        assert_eq!(with(&|_| {}).unwrap(), 48);
        type Edit<'a> = &'a dyn Fn(&mut Compressed);
        let edits: [(Edit<'_>, &str); 6] = [
            (&|c| c.byte_stride = 6, "byteStride of buffer view 3: found 6"),
            (&|c| c.count = 7, "byteLength of buffer view 3: found 48; allowed: 7 elements of 8 bytes"),
            (&|c| c.count = usize::MAX, "byteLength"),
            (&|c| c.mode = Mode::Indices, "byteStride of buffer view 3: found 8; allowed: 2 or 4"),
            (
                &|c| (c.byte_stride, c.filter) = (16, Filter::Quaternion),
                "byteStride of buffer view 3: found 16",
            ),
            (
                &|c| (c.byte_stride, c.mode, c.count) = (4, Mode::Triangles, 8),
                "count of buffer view 3: found 8",
            ),
        ];
        for (edit, says) in edits {
            let error = with(edit).unwrap_err();
            assert_eq!(error.kind, ErrorKind::Malformed);
            assert!(error.to_string().contains(says), "{says}: {error}");
        }
    }
}
