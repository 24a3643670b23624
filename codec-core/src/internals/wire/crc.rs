//! CRC-32 (ISO-HDLC, the CRC of Ethernet and zip): rejects damaged packets, manifests, receipts.
//!
//! The table takes 1 KiB of flash; with the feature `crc-16k` it takes 16 KiB and sixteen bytes at
//! a time. A host that has a faster implementation passes it as a [`Crc32`] function to the
//! receiver; all must give the same value.

use crc::{CRC_32_ISO_HDLC, Crc, Table};

use crate::error::{Error, ErrorKind, Result};

/// A CRC-32/ISO-HDLC implementation: bytes to checksum.
pub type Crc32 = fn(&[u8]) -> u32;

/// Bytes of a CRC on the wire.
pub const CRC_BYTES: usize = 4;

#[cfg(not(feature = "crc-16k"))]
type Width = Table<1>;
#[cfg(feature = "crc-16k")]
type Width = Table<16>;

static TABLE: Crc<u32, Width> = Crc::<u32, Width>::new(&CRC_32_ISO_HDLC);

/// CRC-32/ISO-HDLC of `bytes` by a table.
pub fn crc32(bytes: &[u8]) -> u32 {
    TABLE.checksum(bytes)
}

/// [`crc32`] of bytes that come in pieces.
pub struct RunningCrc(crc::Digest<'static, u32, Width>);

impl RunningCrc {
    /// No bytes yet.
    #[allow(clippy::new_without_default)]
    pub fn new() -> Self {
        Self(TABLE.digest())
    }

    /// Takes the next bytes.
    pub fn update(&mut self, bytes: &[u8]) {
        self.0.update(bytes);
    }

    /// The CRC of all bytes taken.
    pub fn finish(self) -> u32 {
        self.0.finalize()
    }
}

/// Splits the trailing CRC off `bytes` and checks it.
///
/// # Errors
/// [`ErrorKind::Short`] under four bytes, [`ErrorKind::Checksum`] if it does not match.
pub fn checked<'a>(field: &'static str, bytes: &'a [u8], crc: Crc32) -> Result<&'a [u8]> {
    let Some((content, &tail)) = bytes.split_last_chunk::<CRC_BYTES>() else {
        return Err(Error::short(field, 0, bytes.len(), CRC_BYTES));
    };
    let (found, computed) = (u32::from_le_bytes(tail), crc(content));
    if found != computed {
        let allowed = (u64::from(computed), u64::from(computed));
        return Err(Error::illegal(field, content.len(), u64::from(found), allowed).kind(ErrorKind::Checksum));
    }
    Ok(content)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_check_value_of_the_catalogue() {
        assert_eq!(crc32(b"123456789"), 0xcbf4_3926);
    }

    #[test]
    fn any_flipped_bit_is_found() {
        let mut bytes = *b"dynamic Gaussians\0\0\0\0";
        let content = bytes.len() - 4;
        let crc = crc32(&bytes[..content]);
        bytes[content..].copy_from_slice(&crc.to_le_bytes());
        assert_eq!(checked("t", &bytes, crc32).unwrap().len(), content);
        for bit in 0..bytes.len() * 8 {
            bytes[bit / 8] ^= 1 << (bit % 8);
            assert_eq!(checked("t", &bytes, crc32).unwrap_err().kind, ErrorKind::Checksum);
            bytes[bit / 8] ^= 1 << (bit % 8);
        }
    }
}
