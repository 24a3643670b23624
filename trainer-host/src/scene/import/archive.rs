//! Reads members of a zip archive, each up to a bound whatever the archive says of its length.

use std::io::{Cursor, Read, Take};

use super::{
    Limits,
    error::{ErrorKind, Format, ImportError},
};

/// An archive over bytes, read on behalf of one format.
pub(super) struct Archive<'a> {
    zip: zip::ZipArchive<Cursor<&'a [u8]>>,
    format: Format,
    /// Bytes that further members may hold.
    left: u64,
}

impl<'a> Archive<'a> {
    /// Opens `bytes`; all members together may hold `limits.max_bytes`.
    pub fn new(bytes: &'a [u8], limits: &Limits, format: Format) -> Result<Self, ImportError> {
        limits.bytes(format, "file", bytes.len() as u64)?;
        let zip = zip::ZipArchive::new(Cursor::new(bytes))
            .map_err(|e| format.malformed("zip directory", e, "an undamaged zip archive"))?;
        Ok(Self { zip, format, left: limits.max_bytes })
    }

    /// Whether there is a member of this name.
    pub fn has(&self, name: &str) -> bool {
        self.zip.file_names_raw().any(|n| n == name.as_bytes())
    }

    /// The names that are text.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.zip.file_names_raw().filter_map(|name| str::from_utf8(name).ok())
    }

    /// Whether there is a member whose name ends so.
    pub fn has_ending(&self, ending: &str) -> bool {
        self.zip.file_names_raw().any(|n| n.ends_with(ending.as_bytes()))
    }

    /// The bytes of a member that may hold `most` of them.
    pub fn read(&mut self, name: &str, most: u64) -> Result<Vec<u8>, ImportError> {
        let mut member = self.member(name, most)?;
        let mut out = Vec::new();
        member.read_to_end(&mut out)?;
        Ok(out)
    }

    /// A member to be read piece by piece, `most` bytes of it: nothing is unpacked before it is asked for.
    pub fn member(&mut self, name: &str, most: u64) -> Result<Member<'_, 'a>, ImportError> {
        let format = self.format;
        let file = self.zip.by_name(name).map_err(|e| format.malformed(name, e, "a member of this name"))?;
        let allowed = most.min(self.left);
        Ok(Member { name: name.into(), format, allowed, left: &mut self.left, file: file.take(allowed) })
    }
}

/// A member that is being read.
pub(super) struct Member<'m, 'a> {
    name: Box<str>,
    format: Format,
    /// Bytes that it may hold.
    allowed: u64,
    /// Bytes that the archive's members may still hold.
    left: &'m mut u64,
    file: Take<zip::read::ZipFile<'m, Cursor<&'a [u8]>>>,
}

impl Member<'_, '_> {
    /// The format on whose behalf it is read.
    pub fn format(&self) -> Format {
        self.format
    }

    /// Fills `buffer` as far as there are bytes, and says how far.
    pub fn fill(&mut self, buffer: &mut [u8]) -> Result<usize, ImportError> {
        let mut filled = 0;
        while filled < buffer.len() {
            match self.file.read(&mut buffer[filled..]) {
                Ok(0) => break,
                Ok(n) => filled += n,
                Err(e) if e.kind() == std::io::ErrorKind::Interrupted => {}
                Err(e) => return Err(self.damaged(&e)),
            }
        }
        *self.left -= filled as u64;
        Ok(filled)
    }

    /// Appends what is left of the member.
    fn read_to_end(&mut self, out: &mut Vec<u8>) -> Result<(), ImportError> {
        let read = self.file.read_to_end(out).map_err(|e| self.damaged(&e))?;
        *self.left -= read as u64;
        // One byte more than is allowed tells a member that is full from one that is too long.
        self.file.set_limit(1);
        let mut beyond = [0];
        if self.file.read(&mut beyond).map_err(|e| self.damaged(&e))? == 0 {
            return Ok(());
        }
        let (found, allowed) = ("more bytes", format!("up to {} bytes", self.allowed));
        Err(self.format.error(ErrorKind::TooLarge, &*self.name, found, allowed))
    }

    fn damaged(&self, error: &std::io::Error) -> ImportError {
        self.format.malformed(&*self.name, error, "an undamaged member")
    }
}
