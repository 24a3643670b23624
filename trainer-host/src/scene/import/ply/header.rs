//! Reads a PLY header and the rows of one element, whatever the encoding.
//!
//! Binary rows are read where they lie. Text rows are first turned into little-endian binary rows, so
//! that there is one reader of values. Offsets of properties come from the header; nothing assumes an
//! order. Absent: list properties inside the element that is read (skipped in elements before it).

use std::borrow::Cow;

use crate::scene::import::{
    Limits,
    bytes::array,
    error::{ErrorKind, Format, ImportError},
};

const MAX_HEADER_BYTES: usize = 1 << 16;

/// How values are written after the header.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Encoding {
    Ascii,
    LittleEndian,
    BigEndian,
}

/// A scalar type of PLY.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Scalar {
    I8,
    U8,
    I16,
    U16,
    I32,
    U32,
    F32,
    F64,
}

impl Scalar {
    fn new(name: &str) -> Option<Self> {
        Some(match name {
            "char" | "int8" => Self::I8,
            "uchar" | "uint8" => Self::U8,
            "short" | "int16" => Self::I16,
            "ushort" | "uint16" => Self::U16,
            "int" | "int32" => Self::I32,
            "uint" | "uint32" => Self::U32,
            "float" | "float32" => Self::F32,
            "double" | "float64" => Self::F64,
            _ => return None,
        })
    }

    fn size(self) -> usize {
        match self {
            Self::I8 | Self::U8 => 1,
            Self::I16 | Self::U16 => 2,
            Self::I32 | Self::U32 | Self::F32 => 4,
            Self::F64 => 8,
        }
    }

    /// The value as f64, which holds every PLY scalar exactly.
    fn read(self, bytes: &[u8], offset: usize, big: bool) -> Option<f64> {
        macro_rules! number {
            ($type:ty) => {{
                let raw = array(bytes, offset)?;
                f64::from(if big { <$type>::from_be_bytes(raw) } else { <$type>::from_le_bytes(raw) })
            }};
        }
        Some(match self {
            Self::I8 => number!(i8),
            Self::U8 => number!(u8),
            Self::I16 => number!(i16),
            Self::U16 => number!(u16),
            Self::I32 => number!(i32),
            Self::U32 => number!(u32),
            Self::F32 => number!(f32),
            Self::F64 => number!(f64),
        })
    }

    fn write(self, value: f64, out: &mut Vec<u8>) {
        match self {
            Self::I8 => out.extend((value as i8).to_le_bytes()),
            Self::U8 => out.extend((value as u8).to_le_bytes()),
            Self::I16 => out.extend((value as i16).to_le_bytes()),
            Self::U16 => out.extend((value as u16).to_le_bytes()),
            Self::I32 => out.extend((value as i32).to_le_bytes()),
            Self::U32 => out.extend((value as u32).to_le_bytes()),
            Self::F32 => out.extend((value as f32).to_le_bytes()),
            Self::F64 => out.extend(value.to_le_bytes()),
        }
    }
}

#[derive(Clone, Copy, Debug)]
enum Kind {
    Scalar(Scalar),
    List { count: Scalar, item: Scalar },
}

#[derive(Debug)]
struct Property {
    name: String,
    kind: Kind,
}

/// An element as declared.
#[derive(Debug)]
pub(crate) struct Element {
    name: String,
    count: u64,
    properties: Vec<Property>,
}

impl Element {
    /// Bytes a row takes, unless a list makes rows differ.
    fn stride(&self) -> Option<usize> {
        self.properties.iter().try_fold(0usize, |sum, p| match p.kind {
            Kind::Scalar(s) => Some(sum + s.size()),
            Kind::List { .. } => None,
        })
    }
}

/// A parsed header; rows start at byte `body`.
#[derive(Debug)]
pub(crate) struct Header {
    pub encoding: Encoding,
    elements: Vec<Element>,
    body: usize,
}

/// A property of an element: where it lies in a row and how it is written.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Column {
    offset: usize,
    scalar: Scalar,
}

/// Rows of one element.
pub(crate) struct Rows<'a> {
    bytes: Cow<'a, [u8]>,
    element: &'a Element,
    stride: usize,
    big: bool,
    /// Rows that are there.
    pub count: usize,
    /// Rows the header promised.
    pub declared: u64,
}

impl Header {
    /// Reads the header of `bytes` on behalf of `format`.
    pub fn parse(bytes: &[u8], format: Format) -> Result<Self, ImportError> {
        if !bytes.starts_with(b"ply") {
            return Err(format.malformed("magic", "other bytes", "a first line \"ply\"").at(0));
        }
        let (mut encoding, mut elements, mut offset) = (None, Vec::<Element>::new(), 0);
        loop {
            let line_start = offset;
            let rest = &bytes[offset..bytes.len().min(MAX_HEADER_BYTES)];
            let Some(end) = rest.iter().position(|&b| b == b'\n') else {
                return Err(format
                    .malformed("header", "no end_header", "end_header within 64 KiB")
                    .at(offset));
            };
            offset += end + 1;
            let line = std::str::from_utf8(&rest[..end])
                .map_err(|_| format.malformed("header", "bytes that are not text", "text").at(line_start))?;
            let words: Vec<&str> = line.split_ascii_whitespace().collect();
            let wrong =
                |allowed: &str| format.malformed("header line", line.trim_end(), allowed).at(line_start);
            let scalar = |name: &str| {
                Scalar::new(name).ok_or_else(|| wrong("a scalar type such as float, uchar or uint"))
            };
            match words[..] {
                ["ply"] | [] | ["comment" | "obj_info", ..] => {}
                ["format", name, _version] => {
                    encoding = Some(match name {
                        "ascii" => Encoding::Ascii,
                        "binary_little_endian" => Encoding::LittleEndian,
                        "binary_big_endian" => Encoding::BigEndian,
                        _ => return Err(wrong("ascii, binary_little_endian or binary_big_endian")),
                    });
                }
                ["element", name, count] => elements.push(Element {
                    name: name.to_owned(),
                    count: count.parse().map_err(|_| wrong("element NAME COUNT"))?,
                    properties: Vec::new(),
                }),
                ["property", ref kind @ .., name] => {
                    let kind = match kind {
                        ["list", count, item] => Kind::List { count: scalar(count)?, item: scalar(item)? },
                        [one] => Kind::Scalar(scalar(one)?),
                        _ => return Err(wrong("property TYPE NAME")),
                    };
                    let element = elements.last_mut().ok_or_else(|| wrong("element before property"))?;
                    if element.properties.iter().any(|p| p.name == name) {
                        return Err(wrong("each property once"));
                    }
                    element.properties.push(Property { name: name.to_owned(), kind });
                }
                ["end_header"] => break,
                _ => return Err(wrong("format, element, property, comment or end_header")),
            }
        }
        let encoding = encoding.ok_or_else(|| format.malformed("format", "none", "a format line").at(0))?;
        Ok(Self { encoding, elements, body: offset })
    }

    /// Whether the header declares `element` with `property`.
    pub fn declares(&self, element: &str, property: &str) -> bool {
        self.elements.iter().any(|e| e.name == element && e.properties.iter().any(|p| p.name == property))
    }

    /// The rows of element `name`, or `None` if there is no such element. Rows may be fewer than
    /// declared when the file ends early; the caller decides what that means.
    pub fn rows<'a>(
        &'a self,
        bytes: &'a [u8],
        name: &str,
        limits: &Limits,
        format: Format,
    ) -> Result<Option<Rows<'a>>, ImportError> {
        let Some(index) = self.elements.iter().position(|e| e.name == name) else { return Ok(None) };
        let element = &self.elements[index];
        limits.gaussians(format, element.count)?;
        let stride = element.stride().filter(|&s| s > 0).ok_or_else(|| {
            format.unsupported(format!("element {name}"), "a list or no property", "scalars")
        })?;
        let before = &self.elements[..index];
        if self.encoding == Encoding::Ascii {
            return self.text_rows(bytes, before, element, stride, format).map(Some);
        }
        let big = self.encoding == Encoding::BigEndian;
        let mut offset = self.body;
        for skipped in before {
            offset = skip(bytes, offset, skipped, big).ok_or_else(|| {
                let found = bytes.len().saturating_sub(offset) as u64;
                let field = format!("element {}", skipped.name);
                let rows = skipped.count;
                match skipped.stride() {
                    Some(stride) => format.truncated(field, found, rows.saturating_mul(stride as u64)),
                    None => {
                        let allowed = format_args!("{rows} lists");
                        format.error(ErrorKind::Truncated, field, format_args!("{found} bytes"), allowed)
                    }
                }
            })?;
        }
        let body = bytes.get(offset..).unwrap_or_default();
        let fit = (body.len() / stride) as u64;
        let count = fit.min(element.count) as usize;
        Ok(Some(Rows { bytes: Cow::Borrowed(body), element, stride, big, count, declared: element.count }))
    }

    fn text_rows<'a>(
        &'a self,
        bytes: &'a [u8],
        before: &[Element],
        element: &'a Element,
        stride: usize,
        format: Format,
    ) -> Result<Rows<'a>, ImportError> {
        let skipped = before.iter().fold(0u64, |sum, e| sum.saturating_add(e.count));
        let mut out = Vec::new();
        let mut offset = self.body;
        let mut count = 0usize;
        let lines = bytes[self.body..].split(|&b| b == b'\n').filter(|l| !l.trim_ascii().is_empty());
        for line in lines.skip(usize::try_from(skipped).unwrap_or(usize::MAX)) {
            if count as u64 == element.count {
                break;
            }
            let text = std::str::from_utf8(line).unwrap_or("?");
            let mut words = text.split_ascii_whitespace();
            for property in &element.properties {
                let Kind::Scalar(scalar) = property.kind else { continue };
                let word = words.next().unwrap_or("end of line");
                let value: f64 = word.parse().map_err(|_| {
                    format.malformed(format!("{} in row {count}", property.name), word, "a number").at(offset)
                })?;
                scalar.write(value, &mut out);
            }
            count += 1;
            offset = line.as_ptr() as usize - bytes.as_ptr() as usize + line.len() + 1;
        }
        let declared = element.count;
        Ok(Rows { bytes: Cow::Owned(out), element, stride, big: false, count, declared })
    }
}

fn skip(bytes: &[u8], offset: usize, element: &Element, big: bool) -> Option<usize> {
    if let Some(stride) = element.stride() {
        let length = usize::try_from(element.count).ok()?.checked_mul(stride)?;
        return offset.checked_add(length).filter(|&o| o <= bytes.len());
    }
    let mut offset = offset;
    for _ in 0..element.count {
        for property in &element.properties {
            offset = match property.kind {
                Kind::Scalar(s) => offset + s.size(),
                Kind::List { count, item } => {
                    let items = count.read(bytes, offset, big)?.max(0.0) as usize;
                    offset.checked_add(count.size())?.checked_add(items.checked_mul(item.size())?)?
                }
            };
            if offset > bytes.len() {
                return None;
            }
        }
    }
    Some(offset)
}

impl Rows<'_> {
    /// The column of property `name`.
    pub fn column(&self, name: &str) -> Option<Column> {
        let mut offset = 0;
        for property in &self.element.properties {
            let Kind::Scalar(scalar) = property.kind else { return None };
            if property.name == name {
                return Some(Column { offset, scalar });
            }
            offset += scalar.size();
        }
        None
    }

    /// The columns of all `names`, or the names that are missing.
    pub fn columns<const N: usize>(&self, names: [&str; N]) -> Result<[Column; N], Vec<String>> {
        let found = names.map(|name| self.column(name));
        let missing: Vec<String> =
            names.iter().zip(&found).filter(|(_, c)| c.is_none()).map(|(n, _)| (*n).to_owned()).collect();
        if missing.is_empty() {
            Ok(found.map(|c| c.unwrap_or(Column { offset: 0, scalar: Scalar::U8 })))
        } else {
            Err(missing)
        }
    }

    /// The value of `column` in `row`; rows below `count` are there.
    pub fn value(&self, row: usize, column: Column) -> f64 {
        column.scalar.read(&self.bytes, row * self.stride + column.offset, self.big).unwrap_or(f64::NAN)
    }

    /// An unsigned 32-bit value of `column` in `row`.
    pub fn word(&self, row: usize, column: Column) -> u32 {
        self.value(row, column) as u32
    }

    /// Fewer rows than declared: an error naming the element, or with `keep_readable` a note.
    pub fn short(&self, limits: &Limits, format: Format) -> Result<Option<String>, ImportError> {
        if self.count as u64 == self.declared {
            return Ok(None);
        }
        let name = &self.element.name;
        if limits.keep_readable {
            return Ok(Some(format!(
                "file ends early: {} of {} {name} rows read",
                self.count, self.declared
            )));
        }
        let needed = self.declared.saturating_mul(self.stride as u64);
        Err(format.truncated(format!("element {name}"), self.bytes.len() as u64, needed))
    }
}
