//! The raw plane: low bits of values, several values to a load.

use crate::error::{Error, Result};

/// `bits` ≤ 32 bits from bit `at` of `plane`, low bits first; `None` if they are not there.
pub(super) fn bits(plane: &[u8], at: usize, bits: u32) -> Option<u32> {
    let mut value = 0u64;
    let first = at / 8;
    let last = (at + bits as usize).div_ceil(8);
    for (i, &byte) in plane.get(first..last)?.iter().enumerate() {
        value |= u64::from(byte) << (8 * i);
    }
    Some(((value >> (at % 8)) & ((1u64 << bits) - 1)) as u32)
}

/// A reader of the raw bits of one body.
#[derive(Clone, Copy, Debug)]
pub struct Raw<'a> {
    /// From the first raw bit to the end of the body: 8 bytes or more lie behind every raw bit's
    /// byte, that byte included.
    plane: &'a [u8],
    at: usize,
    end: usize,
}

impl<'a> Raw<'a> {
    /// A reader of the first `bits` bits of `plane`.
    pub const fn new(plane: &'a [u8], bits: usize) -> Self {
        Self { plane, at: 0, end: bits }
    }

    /// Whether every raw bit has been read.
    pub const fn is_used_up(&self) -> bool {
        self.at == self.end
    }

    /// Appends the next `raw_bits` bits to each of `values`: `value << raw_bits | bits`.
    ///
    /// # Errors
    /// [`ErrorKind::Short`](crate::ErrorKind::Short) if fewer bits are left.
    pub fn append(&mut self, raw_bits: u8, values: &mut [i16]) -> Result<()> {
        let needed = values.len() * usize::from(raw_bits);
        if self.end - self.at < needed {
            return Err(Error::short("body.raw", 0, self.end - self.at, needed));
        }
        // A constant width turns the shifts into constants, or into one vector operation.
        let whole = match raw_bits {
            0 => Some(()),
            1 => self.fixed::<1>(values),
            2 => self.fixed::<2>(values),
            3 => self.fixed::<3>(values),
            4 => self.fixed::<4>(values),
            5 => self.fixed::<5>(values),
            6 => self.fixed::<6>(values),
            7 => self.fixed::<7>(values),
            _ => self.fixed::<8>(values),
        };
        whole.ok_or(Error::short("body.raw", 0, self.plane.len(), self.at.div_ceil(8) + 8))
    }

    #[inline]
    fn fixed<const K: u32>(&mut self, values: &mut [i16]) -> Option<()> {
        let mask = (1u64 << K) - 1;
        let mut quads = values.chunks_exact_mut(4);
        for quad in &mut quads {
            let window = self.window()?;
            for (i, value) in quad.iter_mut().enumerate() {
                *value = *value << K | (window >> (K * i as u32) & mask) as i16;
            }
            self.at += 4 * K as usize;
        }
        for value in quads.into_remainder() {
            *value = *value << K | (self.window()? & mask) as i16;
            self.at += K as usize;
        }
        Some(())
    }

    /// At least 57 bits from the next one on.
    #[inline(always)]
    fn window(&self) -> Option<u64> {
        let bytes = self.plane.get(self.at / 8..)?.first_chunk::<8>()?;
        Some(u64::from_le_bytes(*bytes) >> (self.at % 8))
    }
}
