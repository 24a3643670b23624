//! Caps bound a receiver's memory and work, whatever a manifest or a packet claims.
//!
//! The format's own limits ([`limits`](crate::limits)) say what can be written down; caps say what
//! this receiver takes on. A stream beyond a cap is refused before anything is allocated or walked,
//! with an [`ErrorKind::Capacity`] that names the field, what was found and what is allowed.

use crate::{
    error::{Error, ErrorKind, Result},
    limits,
};

/// The most that a receiver takes on. Every field is a largest allowed value.
///
/// ```
/// use codec_core::Caps;
///
/// let phone = Caps { gaussians_per_epoch: 200_000, symbols: 16 << 20, ..Caps::HOST };
/// assert!(phone.arena_words() < Caps::HOST.arena_words());
/// ```
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Caps {
    /// Gaussians of one epoch. A decoded frame takes at most 292 bytes of each, apart from the
    /// receiver's memory. `HOST`: 4,194,304; `SMALL`: 4,096.
    pub gaussians_per_epoch: u32,
    /// Frames of the stream. `HOST`: 1,048,576; `SMALL`: 16,384.
    pub frames: u32,
    /// Cells: clusters of all epochs, and again of every window; 8 bytes each. `HOST`: 4,194,304;
    /// `SMALL`: 4,096.
    pub cells: u32,
    /// Symbols of all cells, 2 bytes each. `HOST`: 335,544,320; `SMALL`: 131,072.
    pub symbols: u32,
    /// Blocks of all cells, a byte each. `HOST`: 33,554,432; `SMALL`: 16,384.
    pub blocks: u32,
    /// Packets of the stream, a bit each. `HOST`: 1,048,576; `SMALL`: 16,384.
    pub packets: u32,
    /// Entropy tables, 8 KiB each (3 KiB in the compact form). `HOST`: 255; `SMALL`: 64.
    pub tables: u32,
    /// Bytes of the unpacked manifest. `HOST`: 67,108,864; `SMALL`: 32,768.
    pub manifest_bytes: u32,
    /// Bytes of the sums of repair. A stream that asks for more is received all the same; sets whose
    /// sums lie beyond are not repaired. `HOST`: 67,108,864; `SMALL`: 65,536.
    pub parity_bytes: u32,
    /// Bytes of media kept until the manifest comes. `HOST`: 8,388,608; `SMALL`: 4,096.
    pub early_bytes: u32,
    /// Values of one packet, which bound the work on it, refused or not. `HOST` and `SMALL`:
    /// [`limits::MAX_PACKET_VALUES`].
    pub values_per_packet: u32,
    /// Blocks that the extents of one packet span, likewise. `HOST` and `SMALL`:
    /// [`limits::MAX_PACKET_BLOCKS`].
    pub blocks_per_packet: u32,
}

impl Caps {
    /// For computers and telephones: under 1 GiB of receiver memory, all fields together. An arena of
    /// [`Caps::arena_words`] also has a place for the decoder and for the frame shown: under 3 GiB.
    pub const HOST: Self = Self {
        gaussians_per_epoch: 4 << 20,
        frames: limits::MAX_FRAMES,
        cells: 4 << 20,
        symbols: 320 << 20,
        blocks: 32 << 20,
        packets: 1 << 20,
        tables: limits::MAX_TABLES as u32,
        manifest_bytes: limits::MAX_MANIFEST_BYTES as u32,
        parity_bytes: 64 << 20,
        early_bytes: 8 << 20,
        values_per_packet: limits::MAX_PACKET_VALUES,
        blocks_per_packet: limits::MAX_PACKET_BLOCKS,
    };

    /// For microcontrollers: under 1 MiB of receiver memory, all fields together. An arena of
    /// [`Caps::arena_words`] also has a place for the decoder and for the frame shown: under 2.25 MiB.
    pub const SMALL: Self = Self {
        gaussians_per_epoch: 4096,
        frames: 16_384,
        cells: 4096,
        symbols: 128 << 10,
        blocks: 16_384,
        packets: 16_384,
        tables: 64,
        manifest_bytes: 32 << 10,
        parity_bytes: 64 << 10,
        early_bytes: 4096,
        values_per_packet: limits::MAX_PACKET_VALUES,
        blocks_per_packet: limits::MAX_PACKET_BLOCKS,
    };
}

impl Default for Caps {
    fn default() -> Self {
        Self::HOST
    }
}

/// Refuses `found` above `most`.
///
/// # Errors
/// [`ErrorKind::Capacity`] naming `field`.
pub(crate) fn within(field: &'static str, found: u64, most: u32) -> Result<()> {
    if found <= most as u64 {
        return Ok(());
    }
    Err(Error::illegal(field, 0, found, (0, most as u64)).kind(ErrorKind::Capacity))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_refusal_names_field_found_and_allowed() {
        assert_eq!(within("manifest.frames", 7, 7), Ok(()));
        let error = within("manifest.frames", 8, 7).unwrap_err();
        let wanted = Error::illegal("manifest.frames", 0, 8, (0, 7)).kind(ErrorKind::Capacity);
        assert_eq!(error, wanted);
    }
}
