//! The raw plane: low bits of values, several values to a load.

use crate::error::Error;

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

    /// Values of `tokens`, each with the next `raw_bits` bits: `(token − 128) << raw_bits | bits`.
    /// `None` if fewer bits are left.
    pub fn values(&mut self, raw_bits: u8, tokens: &[u8], out: &mut [i16]) -> Option<()> {
        if self.end - self.at < tokens.len() * usize::from(raw_bits) {
            return None;
        }
        // A constant width turns the shifts into constants, or into one vector operation.
        match raw_bits {
            0 => {
                for (value, &token) in out.iter_mut().zip(tokens) {
                    *value = i16::from(token) - 128;
                }
                Some(())
            }
            1 => self.fixed::<1>(tokens, out),
            2 => self.fixed::<2>(tokens, out),
            3 => self.fixed::<3>(tokens, out),
            4 => self.fixed::<4>(tokens, out),
            5 => self.fixed::<5>(tokens, out),
            6 => self.fixed::<6>(tokens, out),
            7 => self.fixed::<7>(tokens, out),
            _ => self.fixed::<8>(tokens, out),
        }
    }

    /// As [`Raw::values`], the first of them by `wide`: it is given the plane from the byte of the
    /// next raw bit on, how many bits of that byte are read, `tokens` and `out`, and returns how
    /// many values it has written.
    pub fn values_by(
        &mut self,
        raw_bits: u8,
        tokens: &[u8],
        out: &mut [i16],
        wide: impl FnOnce(&[u8], usize, &[u8], &mut [i16]) -> usize,
    ) -> Option<()> {
        let mut done = 0;
        if self.end - self.at >= tokens.len() * usize::from(raw_bits) {
            let plane = self.plane.get(self.at / 8..)?;
            done = wide(plane, self.at % 8, tokens, out).min(tokens.len()).min(out.len());
            self.at += done * usize::from(raw_bits);
        }
        self.values(raw_bits, tokens.get(done..)?, out.get_mut(done..)?)
    }

    /// The error of one who needs `needed` bits.
    pub(super) const fn short(&self, needed: usize) -> Error {
        Error::short("body.raw", 0, self.end - self.at, needed)
    }

    // Apart from the loops over tokens, which need the registers.
    #[inline(never)]
    fn fixed<const K: u32>(&mut self, tokens: &[u8], out: &mut [i16]) -> Option<()> {
        let (plane, mut at) = (self.plane, self.at);
        // At least 57 bits from bit `at` on.
        let window = |at: usize| -> Option<u64> {
            let bytes = plane.get(at / 8..)?.first_chunk::<8>()?;
            Some(u64::from_le_bytes(*bytes) >> (at % 8))
        };
        let (quads, rest) = out.as_chunks_mut::<4>();
        for quad in quads {
            // Four fields of K bits, moved apart into four of 16 within one register.
            let pair = window(at)? & mask(4 * K);
            let pair = (pair | pair << (32 - 2 * K)) & (mask(2 * K) | mask(2 * K) << 32);
            let four = (pair | pair << (16 - K)) & (mask(K) * 0x0001_0001_0001_0001);
            *quad = [four as i16, (four >> 16) as i16, (four >> 32) as i16, (four >> 48) as i16];
            at += 4 * K as usize;
        }
        for place in rest {
            *place = (window(at)? & mask(K)) as i16;
            at += K as usize;
        }
        self.at = at;
        for (value, &token) in out.iter_mut().zip(tokens) {
            *value |= (i16::from(token) - 128) << K;
        }
        Some(())
    }
}

const fn mask(bits: u32) -> u64 {
    (1 << bits) - 1
}
