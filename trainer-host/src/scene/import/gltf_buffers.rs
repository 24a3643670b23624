//! Loads the buffers of a glTF file, and unfolds the views of them that are compressed.
//!
//! A buffer that compressed views would fall back to, and nothing else reads, is not loaded: in most files
//! it is not there.

use std::collections::BTreeSet;

use serde::Deserialize;

use super::{
    Limits,
    error::{ErrorKind, Format, ImportError},
    meshopt::Compressed,
};

/// Extensions that are dealt with here: whatever reads views does not see them.
pub(super) const COMPRESSIONS: [&str; 2] = ["EXT_meshopt_compression", "KHR_meshopt_compression"];

/// The parts of the JSON that describe bytes.
#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct Layout {
    #[serde(default)]
    buffer_views: Vec<ViewLayout>,
    #[serde(default)]
    buffers: Vec<BufferLayout>,
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct ViewLayout {
    buffer: usize,
    #[serde(default)]
    byte_offset: usize,
    byte_length: usize,
    #[serde(default)]
    extensions: ViewExtensions,
}

#[derive(Default, Deserialize)]
struct ViewExtensions {
    #[serde(rename = "EXT_meshopt_compression")]
    vendor: Option<Compressed>,
    #[serde(rename = "KHR_meshopt_compression")]
    ratified: Option<Compressed>,
}

impl ViewExtensions {
    fn compressed(&self) -> Option<&Compressed> {
        self.ratified.as_ref().or(self.vendor.as_ref())
    }
}

#[derive(Deserialize)]
#[serde(rename_all = "camelCase")]
struct BufferLayout {
    uri: Option<String>,
    byte_length: usize,
}

/// Where the bytes of a view lie.
enum View {
    /// In a buffer, from a byte on.
    Plain { buffer: usize, offset: usize, length: usize },
    /// Unfolded.
    Unfolded(Vec<u8>),
}

/// The bytes of a file, by view.
pub(super) struct Buffers {
    format: Format,
    /// Whether a view may end before it should.
    keeps: bool,
    buffers: Vec<Vec<u8>>,
    views: Vec<View>,
}

impl Buffers {
    /// Loads what the JSON `text` describes: from `blob`, the binary chunk, from the text itself, or from the
    /// files beside it. All buffers and unfolded views together may take `limits.max_bytes`.
    ///
    /// # Errors
    /// Bytes that are missing or damaged, or more than `limits` allow.
    pub fn load(
        format: Format,
        text: &[u8],
        blob: Option<&[u8]>,
        mut beside: impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
        limits: &Limits,
    ) -> Result<Self, ImportError> {
        let layout: Layout =
            serde_json::from_slice(text).map_err(|e| format.malformed("JSON", e, "the JSON of glTF 2.0"))?;
        let mut left = limits.max_bytes;
        let mut spend = |field: &str, bytes: usize| {
            let allowed = format_args!("{} bytes in all", limits.max_bytes);
            let rest = left.checked_sub(bytes as u64);
            left = rest.ok_or_else(|| format.error(ErrorKind::TooLarge, field, "more", allowed))?;
            Ok(())
        };
        // Of a mesh every part is needed; of Gaussians those count that are there.
        let keeps = limits.keep_readable && format == Format::GltfSplats;
        let fallbacks = layout.fallbacks();
        let mut buffers = Vec::new();
        for (i, buffer) in layout.buffers.iter().enumerate() {
            if fallbacks.contains(&i) {
                buffers.push(Vec::new());
                continue;
            }
            let field = format!("buffer {i}");
            let data = match (&buffer.uri, blob) {
                (Some(uri), _) => resource(format, uri, &mut beside)?,
                (None, Some(blob)) => blob.to_vec(),
                (None, None) => {
                    return Err(format.malformed(field, "no BIN chunk", "a BIN chunk or a uri"));
                }
            };
            if data.len() < buffer.byte_length && !keeps {
                return Err(format.truncated(field, data.len() as u64, buffer.byte_length as u64));
            }
            spend(&field, data.len())?;
            buffers.push(data);
        }
        let mut views = Vec::new();
        for (i, view) in layout.buffer_views.iter().enumerate() {
            let Some(compressed) = view.extensions.compressed() else {
                let (offset, length) = (view.byte_offset, view.byte_length);
                views.push(View::Plain { buffer: view.buffer, offset, length });
                continue;
            };
            let field = format!("buffer view {i}");
            let bytes = compressed.unfolded_bytes(format, &field, view.byte_length)?;
            spend(&field, bytes)?;
            let (buffer, offset) = (compressed.buffer, compressed.byte_offset);
            let unfolded = range(format, &buffers, buffer, offset, compressed.byte_length)
                .map_err(|e| ImportError { field: field.as_str().into(), ..e })
                .and_then(|stream| compressed.unfold(stream, format, &field));
            views.push(View::Unfolded(match unfolded {
                Err(_) if keeps => Vec::new(),
                unfolded => unfolded?,
            }));
        }
        Ok(Self { format, keeps, buffers, views })
    }

    /// The bytes of view `index`.
    ///
    /// # Errors
    /// No such view, or one that leads out of its buffer, unless that is kept as far as it goes.
    pub fn view(&self, index: usize) -> Result<&[u8], ImportError> {
        match self.views.get(index) {
            None => {
                Err(self.format.malformed("buffer view", index, format_args!("below {}", self.views.len())))
            }
            Some(View::Unfolded(bytes)) => Ok(bytes),
            Some(&View::Plain { buffer, offset, length }) => {
                let there = self.buffers.get(buffer).map_or(0, Vec::len).saturating_sub(offset);
                let length = if self.keeps { length.min(there) } else { length };
                let offset = if length == 0 { 0 } else { offset };
                range(self.format, &self.buffers, buffer, offset, length)
                    .map_err(|e| ImportError { field: format!("buffer view {index}").into(), ..e })
            }
        }
    }

    /// Bytes of all buffers and unfolded views.
    pub fn bytes(&self) -> usize {
        let unfolded = self.views.iter().map(|view| match view {
            View::Plain { .. } => 0,
            View::Unfolded(bytes) => bytes.len(),
        });
        self.buffers.iter().map(Vec::len).chain(unfolded).sum()
    }
}

impl Layout {
    /// The buffers that compressed views would fall back to, and that nothing reads.
    fn fallbacks(&self) -> BTreeSet<usize> {
        let compressed = |view: &&ViewLayout| view.extensions.compressed().is_some();
        let fallbacks = self.buffer_views.iter().filter(compressed).map(|view| view.buffer);
        let read: BTreeSet<usize> = self
            .buffer_views
            .iter()
            .map(|view| view.extensions.compressed().map_or(view.buffer, |compressed| compressed.buffer))
            .collect();
        fallbacks.filter(|buffer| !read.contains(buffer)).collect()
    }
}

/// `length` bytes of a buffer.
fn range(
    format: Format,
    buffers: &[Vec<u8>],
    buffer: usize,
    offset: usize,
    length: usize,
) -> Result<&[u8], ImportError> {
    let bytes = buffers.get(buffer).map_or(&[][..], Vec::as_slice);
    let end = offset.checked_add(length);
    end.and_then(|end| bytes.get(offset..end)).ok_or_else(|| {
        let needed = (offset as u64).saturating_add(length as u64);
        format.truncated("buffer view", bytes.len() as u64, needed)
    })
}

/// What a uri holds: base64 data, or a file beside this one.
pub(super) fn resource(
    format: Format,
    uri: &str,
    beside: &mut impl FnMut(&str) -> Result<Vec<u8>, ImportError>,
) -> Result<Vec<u8>, ImportError> {
    match uri.strip_prefix("data:") {
        None => {
            // Some write names as they are.
            let escaped = unescaped(uri).filter(|name| name != uri);
            let Some(name) = escaped else { return beside(uri) };
            beside(&name).or_else(|error| beside(uri).map_err(|_| error))
        }
        Some(data) => data
            .split_once(";base64,")
            .and_then(|(_, text)| base64(text.as_bytes()))
            .ok_or_else(|| format.malformed("data uri", "other text", "base64 data")),
    }
}

/// `uri` with its escapes resolved; none where that is no text, or an escape is none.
fn unescaped(uri: &str) -> Option<String> {
    let mut parts = uri.split('%');
    let mut bytes = parts.next()?.as_bytes().to_vec();
    for part in parts {
        let (digits, rest) = part.split_at_checked(2)?;
        let is_hexadecimal = digits.bytes().all(|digit| digit.is_ascii_hexdigit());
        bytes.push(u8::from_str_radix(digits, 16).ok().filter(|_| is_hexadecimal)?);
        bytes.extend(rest.bytes());
    }
    String::from_utf8(bytes).ok()
}

fn base64(text: &[u8]) -> Option<Vec<u8>> {
    let text = text.strip_suffix(b"==").or(text.strip_suffix(b"=")).unwrap_or(text);
    let mut out = Vec::with_capacity(text.len() / 4 * 3 + 3);
    for group in text.chunks(4) {
        let mut word = 0u32;
        for &byte in group {
            let digit = match byte {
                b'A'..=b'Z' => byte - b'A',
                b'a'..=b'z' => byte - b'a' + 26,
                b'0'..=b'9' => byte - b'0' + 52,
                b'+' | b'-' => 62,
                b'/' | b'_' => 63,
                _ => return None,
            };
            word = word << 6 | u32::from(digit);
        }
        if group.len() == 1 {
            return None;
        }
        word <<= 6 * (4 - group.len());
        out.extend(&word.to_be_bytes()[1..group.len()]);
    }
    Some(out)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn escapes_are_resolved_where_they_are_some() {
        assert_eq!(unescaped("a%20b%C3%9F.bin").as_deref(), Some("a b\u{df}.bin"));
        for other in ["50%.bin", "%+1", "%ff"] {
            assert_eq!(unescaped(other), None, "{other}");
        }
        let mut names = Vec::new();
        let read = resource(Format::Gltf, "a%20b", &mut |name: &str| {
            names.push(name.to_owned());
            if name == "a%20b" { Ok(vec![7]) } else { Err(Format::Gltf.empty("file")) }
        });
        assert_eq!((read.unwrap(), names), (vec![7], vec!["a b".to_owned(), "a%20b".to_owned()]));
    }

    #[test]
    fn base64_reads_with_and_without_padding() {
        assert_eq!(base64(b"TWFu").unwrap(), b"Man");
        assert_eq!(base64(b"TWE=").unwrap(), b"Ma");
        assert_eq!(base64(b"TQ==").unwrap(), b"M");
        assert_eq!(base64(b"T*=="), None);
    }

    #[test]
    fn only_what_nothing_reads_is_a_fallback() {
        let packed = |to: usize, from: usize| {
            serde_json::json!({"buffer": to, "byteLength": 8, "extensions": {"EXT_meshopt_compression":
                {"buffer": from, "byteLength": 9, "byteStride": 4, "count": 2, "mode": "INDICES"}}})
        };
        let plain = serde_json::json!({"buffer": 2, "byteLength": 8});
        let views = [packed(1, 0), packed(2, 0), plain, packed(3, 4), packed(4, 0)];
        let layout: Layout = serde_json::from_value(serde_json::json!({"bufferViews": views})).unwrap();
        assert_eq!(layout.fallbacks(), BTreeSet::from([1, 3]));
    }
}
