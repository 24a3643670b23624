//! Members of a zip archive, each read up to a bound whatever the archive says of its length.

use std::io::{Cursor, Read};

use super::{
    Limits,
    error::{Format, ImportError},
};

/// An archive over bytes, read on behalf of one format.
pub(super) struct Archive<'a> {
    zip: zip::ZipArchive<Cursor<&'a [u8]>>,
    format: Format,
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

    /// The bytes of a member.
    pub fn read(&mut self, name: &str) -> Result<Vec<u8>, ImportError> {
        let format = self.format;
        let member =
            self.zip.by_name(name).map_err(|e| format.malformed(name, e, "a member of this name"))?;
        let mut out = Vec::new();
        member
            .take(self.left.saturating_add(1))
            .read_to_end(&mut out)
            .map_err(|e| format.malformed(name, e, "an undamaged member"))?;
        let length = out.len() as u64;
        if length > self.left {
            return Err(format.error(
                super::ErrorKind::TooLarge,
                name,
                "more bytes than are left",
                format_args!("up to {} bytes", self.left),
            ));
        }
        self.left -= length;
        Ok(out)
    }
}
