//! Reads one `.npy` array of an archive: its header first, its values when their number is accepted.

use half::f16;

use crate::scene::import::{
    archive::{Archive, Member},
    bytes::array,
    error::ImportError,
};

/// Longest header, bytes: that of version 1 counts them in 16 bits.
const MAX_HEADER: usize = u16::MAX as usize;
/// Bytes unpacked at a time, about.
const PIECE: usize = 1 << 16;

/// Type of an array's elements.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(in crate::scene::import) enum Element {
    U8,
    I32,
    I64,
    F16,
    F32,
    F64,
}

impl Element {
    fn bytes(self) -> usize {
        match self {
            Element::U8 => 1,
            Element::F16 => 2,
            Element::I32 | Element::F32 => 4,
            Element::I64 | Element::F64 => 8,
        }
    }

    /// The element that starts `at`.
    fn value(self, at: &[u8]) -> f64 {
        match self {
            Element::U8 => f64::from(at.first().copied().unwrap_or_default()),
            Element::I32 => f64::from(i32::from_le_bytes(array(at, 0).unwrap_or_default())),
            Element::I64 => i64::from_le_bytes(array(at, 0).unwrap_or_default()) as f64,
            Element::F16 => f16::from_le_bytes(array(at, 0).unwrap_or_default()).to_f64(),
            Element::F32 => f64::from(f32::from_le_bytes(array(at, 0).unwrap_or_default())),
            Element::F64 => f64::from_le_bytes(array(at, 0).unwrap_or_default()),
        }
    }
}

/// An array whose header has been read and whose values have not.
pub(in crate::scene::import) struct Array<'m, 'a> {
    name: &'m str,
    element: Element,
    shape: Vec<usize>,
    values: Member<'m, 'a>,
}

impl<'m, 'a> Array<'m, 'a> {
    /// Opens member `name`.npy and reads its header.
    ///
    /// # Errors
    /// No such member, or a header of another format, element type or order.
    pub fn open(archive: &'m mut Archive<'a>, name: &'m str) -> Result<Self, ImportError> {
        let mut values = archive.member(&format!("{name}.npy"), u64::MAX)?;
        let format = values.format();
        let bad = |found: &str, allowed: &str| format.malformed(format!("{name}.npy"), found, allowed);
        let header = header(&mut values, &bad)?;
        let field = |key: &str| header.split_once(&format!("'{key}':")).map(|(_, rest)| rest.trim_start());
        let descr = field("descr").and_then(|f| f.strip_prefix('\'')).and_then(|f| f.split_once('\''));
        let element = match descr.map(|d| d.0) {
            Some("|u1") => Element::U8,
            Some("<i4") => Element::I32,
            Some("<i8") => Element::I64,
            Some("<f2") => Element::F16,
            Some("<f4") => Element::F32,
            Some("<f8") => Element::F64,
            other => return Err(bad(other.unwrap_or("no descr"), "|u1, <i4, <i8, <f2, <f4 or <f8")),
        };
        if !field("fortran_order").is_some_and(|f| f.starts_with("False")) {
            return Err(bad("Fortran order", "C order"));
        }
        let lengths = field("shape").and_then(|f| f.strip_prefix('(')).and_then(|f| f.split_once(')'));
        let lengths = lengths.map(|(lengths, _)| lengths.split(',').map(str::trim).filter(|d| !d.is_empty()));
        let shape: Option<Vec<usize>> = lengths.and_then(|l| l.map(|d| d.parse().ok()).collect());
        let shape = shape.ok_or_else(|| bad("no shape", "a tuple of lengths"))?;
        Ok(Self { name, element, shape, values })
    }

    /// Lengths along the axes. The caller accepts them before it asks for values.
    pub fn shape(&self) -> &[usize] {
        &self.shape
    }

    /// Type of the elements.
    pub fn element(&self) -> Element {
        self.element
    }

    /// Gives every `width` values in a row to `take`, the last axis first. Memory is that of one piece.
    ///
    /// # Errors
    /// Fewer values than the shape says, or a damaged member.
    pub fn rows(mut self, width: usize, mut take: impl FnMut(&[f64])) -> Result<(), ImportError> {
        let too_large = || {
            self.values.format().malformed(
                format!("shape of {}", self.name),
                format!("{:?}", self.shape),
                "less",
            )
        };
        let count = self.shape.iter().try_fold(1usize, |n, length| n.checked_mul(*length));
        let needed = count.and_then(|n| n.checked_mul(self.element.bytes())).ok_or_else(too_large)?;
        let row = width * self.element.bytes();
        let mut piece = vec![0; row * (PIECE / row).max(1)];
        let mut values = Vec::with_capacity(width);
        let mut read = 0;
        while read < needed {
            let wanted = piece.len().min(needed - read);
            let filled = self.values.fill(&mut piece[..wanted])?;
            read += filled;
            if filled < wanted {
                return Err(self.values.format().truncated(
                    format!("{}.npy", self.name),
                    read as u64,
                    needed as u64,
                ));
            }
            for bytes in piece[..filled].chunks_exact(row) {
                values.clear();
                values.extend(bytes.chunks_exact(self.element.bytes()).map(|at| self.element.value(at)));
                take(&values);
            }
        }
        // Only at its end does the archive compare a member with its checksum.
        self.values.fill(&mut [0])?;
        Ok(())
    }

    /// All values, the last axis first.
    ///
    /// # Errors
    /// As [`Array::rows`].
    pub fn values(self) -> Result<Vec<f64>, ImportError> {
        let mut values = Vec::new();
        self.rows(1, |row| values.extend_from_slice(row))?;
        Ok(values)
    }

    /// The error of a shape that is not `allowed`.
    pub fn misshapen(&self, allowed: &str) -> ImportError {
        self.values.format().malformed(
            format!("shape of {}", self.name),
            format!("{:?}", self.shape),
            allowed,
        )
    }
}

/// The text of an array's header.
fn header(
    member: &mut Member<'_, '_>,
    bad: &impl Fn(&str, &str) -> ImportError,
) -> Result<String, ImportError> {
    let mut start = [0; 8];
    if member.fill(&mut start)? < start.len() || !start.starts_with(b"\x93NUMPY") {
        return Err(bad("other bytes", "the magic of a .npy array"));
    }
    let mut length = [0; 4];
    let width = match start[6] {
        1 => 2,
        2 | 3 => 4,
        _ => return Err(bad("another version", "version 1, 2 or 3")),
    };
    member.fill(&mut length[..width])?;
    let length = u32::from_le_bytes(length) as usize;
    if length > MAX_HEADER {
        return Err(bad(&format!("a header of {length} bytes"), &format!("up to {MAX_HEADER}")));
    }
    let mut text = vec![0; length];
    let filled = member.fill(&mut text)?;
    match String::from_utf8(text) {
        Ok(text) if filled == length => Ok(text),
        _ => Err(bad("a header that is cut off or no text", "a header of text")),
    }
}
