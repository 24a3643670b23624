//! One error for everything this crate reads: what is wrong, in which field, where, what was
//! found and what is allowed.
//!
//! `Copy`, no heap, no formatting until somebody prints it. Kinds are kept apart by who is to blame and
//! what helps: see [`ErrorKind`].

use core::fmt;

/// Who is to blame.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ErrorKind {
    /// The bytes end before the field does.
    Short,
    /// The field holds a value the format forbids.
    Illegal,
    /// A magic, version or profile this crate does not know.
    Unknown,
    /// A CRC does not match.
    Checksum,
    /// Legal on its own, but at odds with the manifest or with what already arrived.
    Contradiction,
    /// Arrived before: nothing new in it.
    Duplicate,
    /// The caller's memory is too small for it, or it is over the caller's limit.
    Capacity,
}

impl ErrorKind {
    /// Number of kinds, for counters indexed by kind.
    pub const COUNT: usize = 7;

    /// Position in counters, 0..[`ErrorKind::COUNT`].
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Short name, as printed.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Short => "short",
            Self::Illegal => "illegal",
            Self::Unknown => "unknown",
            Self::Checksum => "checksum",
            Self::Contradiction => "contradiction",
            Self::Duplicate => "duplicate",
            Self::Capacity => "capacity",
        }
    }
}

/// A refusal: kind, field, byte offset, value found, values allowed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Error {
    /// Who is to blame.
    pub kind: ErrorKind,
    /// Field name as in `SPEC.md`, for example `"manifest.epochs"`.
    pub field: &'static str,
    /// Byte offset in the input where the field, or the record that holds it, starts.
    pub offset: u32,
    /// The value found. For [`ErrorKind::Short`], the bytes that there are; for [`ErrorKind::Capacity`] of
    /// memory, the elements that it has.
    pub found: u64,
    /// Smallest and largest allowed value. For [`ErrorKind::Short`] and for [`ErrorKind::Capacity`] of
    /// memory, where `found` is below both, what is needed.
    pub allowed: (u64, u64),
}

impl Error {
    /// The input ends early: `there` bytes at `offset`, `needed` bytes needed.
    pub const fn short(field: &'static str, offset: usize, there: usize, needed: usize) -> Self {
        let needed = needed as u64;
        Self {
            kind: ErrorKind::Short,
            field,
            offset: offset as u32,
            found: there as u64,
            allowed: (needed, needed),
        }
    }

    /// The caller's memory `field` has `have` elements; `need` are needed.
    #[cold]
    pub(crate) const fn too_small(field: &'static str, have: usize, need: usize) -> Self {
        Self::short(field, 0, have, need).kind(ErrorKind::Capacity)
    }

    /// `found` lies outside `allowed`.
    pub const fn illegal(field: &'static str, offset: usize, found: u64, allowed: (u64, u64)) -> Self {
        Self { kind: ErrorKind::Illegal, field, offset: offset as u32, found, allowed }
    }

    /// The same error under another kind.
    #[must_use]
    pub const fn kind(mut self, kind: ErrorKind) -> Self {
        self.kind = kind;
        self
    }
}

impl fmt::Display for Error {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Self { kind, field, offset, found, allowed: (low, high) } = *self;
        match kind {
            ErrorKind::Short => {
                write!(f, "{field} at byte {offset}: {found} bytes left, {low} needed")
            }
            ErrorKind::Checksum => {
                write!(f, "{field} at byte {offset}: found {found:#010x}, the bytes give {low:#010x}")
            }
            // Memory of the caller's; a count over a cap is said as any other value that is too large.
            ErrorKind::Capacity if found < low => {
                write!(f, "{field}: {found} there, {low} needed (capacity)")
            }
            ErrorKind::Duplicate => write!(f, "{field} at byte {offset}: {found} arrived before"),
            _ if low == high => {
                write!(f, "{field} at byte {offset}: found {found}, allowed is {low} ({})", kind.name())
            }
            _ => {
                write!(
                    f,
                    "{field} at byte {offset}: found {found}, allowed is {low}..={high} ({})",
                    kind.name()
                )
            }
        }
    }
}

impl core::error::Error for Error {}

/// This crate's result.
pub type Result<T> = core::result::Result<T, Error>;

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::string::ToString;

    #[test]
    fn a_message_names_field_place_found_and_allowed() {
        let text = Error::illegal("slice.level", 7, 9, (0, 3)).to_string();
        assert_eq!(text, "slice.level at byte 7: found 9, allowed is 0..=3 (illegal)");
        let text = Error::short("packet.crc", 20, 3, 4).to_string();
        assert_eq!(text, "packet.crc at byte 20: 3 bytes left, 4 needed");
        let text = Error::too_small("arena", 6144, 6152).to_string();
        assert_eq!(text, "arena: 6144 there, 6152 needed (capacity)");
        let text = Error::illegal("manifest.frames", 0, 8, (0, 7)).kind(ErrorKind::Capacity).to_string();
        assert_eq!(text, "manifest.frames at byte 0: found 8, allowed is 0..=7 (capacity)");
    }
}
