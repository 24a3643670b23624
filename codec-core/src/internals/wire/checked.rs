//! Checks a packet once: its length, its CRC and its header.

use super::{
    crc::{CRC_BYTES, Crc32, checked},
    packet::Packet,
};
use crate::{
    cursor::in_range,
    error::{Error, Result},
    ids::PacketId,
    limits::MAX_PACKET_BYTES,
};

/// A packet whose length, CRC and header are in order. Everything behind the door takes this type, so
/// that nothing is checked twice.
///
/// ```
/// use codec_core::{
///     PacketId,
///     internals::wire::{checked::Checked, crc::crc32, packet::Parity},
/// };
///
/// let mut bytes = [0; 16];
/// let parity = Parity { id: PacketId::default(), length: 9, content: &[1, 2, 3] };
/// let len = parity.write(&mut bytes)?;
/// assert_eq!(Checked::new(&bytes[..len], crc32)?.id(), PacketId::default());
/// bytes[5] ^= 1;
/// assert!(Checked::new(&bytes[..len], crc32).is_err());
/// # Ok::<(), codec_core::Error>(())
/// ```
#[derive(Clone, Debug, PartialEq)]
pub struct Checked<'a> {
    bytes: &'a [u8],
    packet: Packet<'a>,
}

impl<'a> Checked<'a> {
    /// Checks `bytes`, a whole packet of 1..=1280 bytes with its CRC, by `crc`.
    ///
    /// # Errors
    /// Another length, a CRC that does not match, or what [`Packet::parse`] refuses.
    pub fn new(bytes: &'a [u8], crc: Crc32) -> Result<Self> {
        in_range("packet", 0, bytes.len() as u64, 1, MAX_PACKET_BYTES as u64)?;
        let content = checked("packet.crc", bytes, crc)?;
        Ok(Self { bytes, packet: Packet::parse(content)? })
    }

    /// Reads the header of `bytes`, whose CRC the caller has checked before and vouches for.
    ///
    /// # Errors
    /// Another length, or what [`Packet::parse`] refuses.
    pub fn without_crc_check(bytes: &'a [u8]) -> Result<Self> {
        in_range("packet", 0, bytes.len() as u64, 1, MAX_PACKET_BYTES as u64)?;
        let (content, _) = bytes.split_last_chunk::<CRC_BYTES>().ok_or(Error::short(
            "packet.crc",
            0,
            bytes.len(),
            CRC_BYTES,
        ))?;
        Ok(Self { bytes, packet: Packet::parse(content)? })
    }

    /// The whole packet, CRC included.
    pub const fn bytes(&self) -> &'a [u8] {
        self.bytes
    }

    /// What the header says, and the body.
    pub const fn packet(&self) -> &Packet<'a> {
        &self.packet
    }

    /// The packet's id.
    pub const fn id(&self) -> PacketId {
        self.packet.id()
    }
}
