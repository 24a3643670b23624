//! Single bits, low bits of each byte first; code words most significant bit first.

use crate::error::{Error, ErrorKind, Result};

/// A reader of bits.
#[derive(Clone, Copy, Debug)]
pub struct Bits<'a> {
    bytes: &'a [u8],
    at: usize,
}

impl<'a> Bits<'a> {
    /// A reader at the first bit of `bytes`.
    pub const fn new(bytes: &'a [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// The next bit.
    ///
    /// # Errors
    /// [`ErrorKind::Short`].
    #[inline]
    pub fn bit(&mut self) -> Result<bool> {
        let Some(byte) = self.bytes.get(self.at / 8) else {
            return Err(Error::short("body.table_indices", self.at / 8, 0, 1));
        };
        let bit = byte >> (self.at % 8) & 1 == 1;
        self.at += 1;
        Ok(bit)
    }

    /// Bytes of which at least one bit has been read.
    pub const fn used_bytes(&self) -> usize {
        self.at.div_ceil(8)
    }

    /// Splits the bytes behind the last one used off; the bits that are left in that one must be zero.
    ///
    /// # Errors
    /// [`ErrorKind::Illegal`] for a bit that is set.
    pub fn finish(self) -> Result<&'a [u8]> {
        let short = Error::short("body.table_indices", 0, self.bytes.len(), self.used_bytes());
        let (used, rest) = self.bytes.split_at_checked(self.used_bytes()).ok_or(short)?;
        let padding = match (self.at % 8, used.last()) {
            (left @ 1.., Some(last)) => last >> left,
            _ => 0,
        };
        if padding == 0 {
            return Ok(rest);
        }
        Err(Error::illegal("body.table_indices", used.len().saturating_sub(1), padding.into(), (0, 0)))
    }
}

/// A writer of bits into a caller's buffer.
#[derive(Debug)]
pub struct BitWriter<'a> {
    bytes: &'a mut [u8],
    at: usize,
}

impl<'a> BitWriter<'a> {
    /// A writer at the first bit of `bytes`.
    pub const fn new(bytes: &'a mut [u8]) -> Self {
        Self { bytes, at: 0 }
    }

    /// Appends `code`, `length` bits, most significant first.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`].
    pub fn code(&mut self, code: u32, length: u8) -> Result<()> {
        for i in (0..length).rev() {
            let room = self.bytes.len();
            let Some(byte) = self.bytes.get_mut(self.at / 8) else {
                return Err(Error::short("buffer", self.at / 8, room, room + 1).kind(ErrorKind::Capacity));
            };
            if self.at.is_multiple_of(8) {
                *byte = 0;
            }
            *byte |= ((code >> i & 1) as u8) << (self.at % 8);
            self.at += 1;
        }
        Ok(())
    }

    /// Bytes written; the bits left in the last one are zero.
    pub const fn finish(self) -> usize {
        self.at.div_ceil(8)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bits_lie_low_first_and_padding_is_checked() {
        let mut bytes = [0xff; 3];
        let mut writer = BitWriter::new(&mut bytes);
        writer.code(0b110, 3).unwrap();
        writer.code(0b1_0000_0001, 9).unwrap();
        assert_eq!(writer.finish(), 2);
        assert_eq!(bytes[..2], [0b0000_1011, 0b0000_1000]);
        let mut bits = Bits::new(&bytes);
        let read: std::vec::Vec<bool> = (0..12).map(|_| bits.bit().unwrap()).collect();
        assert_eq!(read.iter().filter(|b| **b).count(), 4);
        assert_eq!(bits.finish().unwrap(), [0xff]);
        let mut bits = Bits::new(&[0b101]);
        bits.bit().unwrap();
        assert_eq!(bits.finish().unwrap_err().kind, ErrorKind::Illegal);
    }

    #[test]
    fn the_end_is_short_for_readers_and_full_for_writers() {
        assert_eq!(Bits::new(&[]).bit().unwrap_err().kind, ErrorKind::Short);
        let mut bytes = [0; 1];
        let mut writer = BitWriter::new(&mut bytes);
        writer.code(0, 8).unwrap();
        assert_eq!(writer.code(1, 1).unwrap_err().kind, ErrorKind::Capacity);
    }

    extern crate std;
}
