//! Keeps the packets that come before the manifest.

use crate::{
    cursor::Reader,
    error::{Error, Result},
};

/// Packets that came before the manifest: of each its length (u16, little-endian), then its bytes.
#[derive(Debug)]
pub(super) struct EarlyPackets<'a> {
    bytes: &'a mut [u8],
    /// Bytes in use, from the first on.
    used: usize,
}

impl<'a> EarlyPackets<'a> {
    /// No packets yet, in `bytes`.
    pub const fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, used: 0 }
    }

    /// Bytes for packets, in use or not.
    pub const fn room(&self) -> usize {
        self.bytes.len()
    }

    /// Keeps `packet`, which is no longer than a packet can be.
    pub fn push(&mut self, packet: &[u8]) -> Result<()> {
        let (have, needed) = (self.bytes.len() - self.used, packet.len() + 2);
        let full = || Error::too_small("caps.early_bytes", have, needed);
        let free = self.bytes.get_mut(self.used..).ok_or_else(full)?;
        let (len, free) = free.split_first_chunk_mut::<2>().ok_or_else(full)?;
        let target = free.get_mut(..packet.len()).ok_or_else(full)?;
        *len = (packet.len() as u16).to_le_bytes();
        target.copy_from_slice(packet);
        self.used += needed;
        Ok(())
    }

    /// A reader of the packets, in the order in which they came.
    pub fn packets(&self) -> Result<Reader<'_>> {
        let used = self.bytes.get(..self.used);
        Ok(Reader::new(
            used.ok_or_else(|| Error::too_small("caps.early_bytes", self.bytes.len(), self.used))?,
        ))
    }
}
