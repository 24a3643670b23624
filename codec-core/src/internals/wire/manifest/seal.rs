//! The envelope of the manifest: head, packed body, CRC.

use crate::{
    caps::{Caps, within},
    cursor::{Reader, Writer, in_range},
    error::{Error, ErrorKind, Result},
    limits,
    pack::{pack, unpack},
    wire::crc::{CRC_BYTES, Crc32, checked, crc32},
};

/// First four bytes of a manifest.
pub const MAGIC: [u8; 4] = *b"DGSM";
/// Version this crate reads and writes.
pub const VERSION: u8 = 2;
/// Bytes before the packed body.
pub const HEADER_BYTES: usize = 16;

/// What the head of a DGSM message says, before anything is unpacked.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ManifestHead {
    /// Bytes of the body once unpacked.
    pub raw_len: usize,
    /// Bytes of the whole message.
    pub wire_len: usize,
}

impl ManifestHead {
    /// Reads the 16-byte head.
    ///
    /// # Errors
    /// Short bytes, another magic or version, lengths over the limits.
    pub fn parse(message: &[u8]) -> Result<Self> {
        let mut reader = Reader::new(message);
        let magic = u32::from_le_bytes(reader.array("manifest.magic")?);
        let wanted = u32::from_le_bytes(MAGIC);
        in_range("manifest.magic", 0, magic, wanted, wanted).map_err(|e| e.kind(ErrorKind::Unknown))?;
        let version = reader.u8("manifest.version")?;
        in_range("manifest.version", 4, version, VERSION, VERSION).map_err(|e| e.kind(ErrorKind::Unknown))?;
        for byte in reader.array::<3>("manifest.reserved")? {
            in_range("manifest.reserved", 5, byte, 0, 0)?;
        }
        let most = limits::MAX_MANIFEST_BYTES as u32;
        let raw_len = in_range("manifest.raw_len", 8, reader.u32("manifest.raw_len")?, 1, most)?;
        let packed = in_range("manifest.packed_len", 12, reader.u32("manifest.packed_len")?, 1, most)?;
        Ok(Self { raw_len: raw_len as usize, wire_len: HEADER_BYTES + packed as usize + CRC_BYTES })
    }

    /// The same, if the body may be unpacked: ask before memory for it is set aside.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] if the body is larger than `caps` allow.
    pub fn within(self, caps: &Caps) -> Result<Self> {
        within("manifest.raw_len", self.raw_len as u64, caps.manifest_bytes).map(|()| self)
    }

    /// As [`open`], of the `message` that this is the head of.
    ///
    /// # Errors
    /// As [`open`].
    pub fn open<'a>(self, message: &[u8], crc: Crc32, raw: &'a mut [u8]) -> Result<&'a [u8]> {
        let whole = message.get(..self.wire_len);
        let whole = whole.ok_or(Error::short("manifest", 0, message.len(), self.wire_len))?;
        let content = checked("manifest.crc", whole, crc)?;
        if message.len() > whole.len() {
            let over = (message.len() - whole.len()) as u64;
            return Err(Error::illegal("manifest.leftover", whole.len(), over, (0, 0)));
        }
        let room = raw.len();
        let target = raw.get_mut(..self.raw_len);
        let short = Error::short("manifest.raw_len", 8, room, self.raw_len);
        let target = target.ok_or(short.kind(ErrorKind::Capacity))?;
        let short = Error::short("manifest.packed_len", 12, content.len(), HEADER_BYTES);
        unpack(content.get(HEADER_BYTES..).ok_or(short)?, target)?;
        Ok(target)
    }
}

/// Checks a whole DGSM message and unpacks its body into the front of `raw`.
///
/// # Errors
/// What [`ManifestHead::parse`] refuses; a CRC that does not match; leftovers;
/// [`ErrorKind::Capacity`] if `raw` is too small.
pub fn open<'a>(message: &[u8], crc: Crc32, raw: &'a mut [u8]) -> Result<&'a [u8]> {
    ManifestHead::parse(message)?.open(message, crc, raw)
}

/// Packs `raw` and seals it as a DGSM message at the front of `out`; returns its length.
///
/// # Errors
/// [`ErrorKind::Capacity`] if `out` is too small; an empty or oversized body.
pub fn seal(raw: &[u8], out: &mut [u8]) -> Result<usize> {
    let most = limits::MAX_MANIFEST_BYTES as u64;
    in_range("manifest.raw_len", 8, raw.len() as u64, 1, most)?;
    let room = out.len();
    let body = out.get_mut(HEADER_BYTES..);
    let body = body.ok_or(Error::short("manifest", 0, room, HEADER_BYTES).kind(ErrorKind::Capacity))?;
    let packed = pack(raw, body)?;
    let mut writer = Writer::new(out);
    writer.bytes(&MAGIC)?;
    writer.bytes(&[VERSION, 0, 0, 0])?;
    writer.bytes(&(raw.len() as u32).to_le_bytes())?;
    writer.bytes(&(packed as u32).to_le_bytes())?;
    let end = HEADER_BYTES + packed;
    let full = Error::short("manifest.crc", end, room - end, CRC_BYTES).kind(ErrorKind::Capacity);
    let (content, rest) = out.split_at_mut_checked(end).ok_or(full)?;
    *rest.first_chunk_mut::<CRC_BYTES>().ok_or(full)? = crc32(content).to_le_bytes();
    Ok(end + CRC_BYTES)
}
