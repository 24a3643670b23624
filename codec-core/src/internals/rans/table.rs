//! A frequency table of the `dgs1` coder says how often each token comes: in every packet the same.
//!
//! A value `v` (any i16) is a token and `k` raw low bits: token `(v >> k) + 128` if that lies in
//! 1..=255, else token 0, the escape, and the whole i16 travels in a section of its own.
//!
//! On the wire (manifest): 0x80 and the index of a table of the [`family`], or `k: u8`, `first: u8`,
//! `count: u8`, `escape: u16`, then `count` frequencies `u16` of tokens `first ..`. Frequencies and
//! the escape sum to exactly 2048.

pub use super::scale::{ESCAPE, PRECISION, SCALE, SLOTS};

use super::family::{self, Frequencies};
use crate::{
    cursor::{Reader, in_range},
    error::{Error, Result},
};

/// Largest number of raw low bits.
pub const MAX_RAW_BITS: u8 = 8;
/// Bytes of a table on the wire before its frequencies.
pub const TABLE_HEADER_BYTES: usize = 5;

/// A frequency table: 256 token frequencies that sum to exactly [`SCALE`], and a raw-bit count.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Table {
    /// Invariant: sums to [`SCALE`].
    frequency: [u16; 256],
    /// Invariant: the sum of the frequencies before.
    start: [u16; 256],
    /// Invariant: at most [`MAX_RAW_BITS`].
    raw_bits: u8,
    /// Its name in the family, if it has one.
    index: Option<u8>,
}

/// The sum of the frequencies before each, for frequencies that sum to less than 2^16.
#[inline(never)]
pub(super) fn starts(frequency: &[u16; 256]) -> [u16; 256] {
    let (mut starts, mut sum) = ([0u16; 256], 0u16);
    for (start, &f) in starts.iter_mut().zip(frequency) {
        *start = sum;
        sum += f;
    }
    starts
}

/// First byte of a table of the family on the wire.
pub const NAMED: u8 = 0x80;

impl Table {
    /// A table of `frequency`, with `raw_bits` raw low bits per value.
    ///
    /// # Errors
    /// If the frequencies do not sum to [`SCALE`] or `raw_bits` is over [`MAX_RAW_BITS`].
    pub fn new(frequency: [u16; 256], raw_bits: u8) -> Result<Self> {
        in_range("table.raw_bits", 0, raw_bits, 0, MAX_RAW_BITS)?;
        let sum = frequency.iter().map(|&f| u32::from(f)).sum();
        in_range("table.sum", 0, sum, SCALE, SCALE)?;
        Ok(Self { frequency, start: starts(&frequency), raw_bits, index: None })
    }

    /// Table `index` of the family.
    ///
    /// # Errors
    /// An index that names none.
    pub fn named(index: u8) -> Result<Self> {
        let unknown = Error::illegal("table.index", 1, index.into(), (0, 172));
        let Frequencies { of, raw_bits } = family::frequencies(index).ok_or(unknown)?;
        Ok(Self { index: Some(index), ..Self::new(of, raw_bits)? })
    }

    /// The best table of 11-bit probabilities for tokens seen `counts` times: largest-remainder
    /// rounding with every seen token, and the escape, at least 1. Nothing seen gives a table
    /// that holds only the token of zero and the escape.
    ///
    /// # Errors
    /// If `raw_bits` is over [`MAX_RAW_BITS`].
    pub fn from_counts(counts: &[u64; 256], raw_bits: u8) -> Result<Self> {
        let mut counts = *counts;
        if counts.iter().all(|&c| c == 0) {
            counts[128] = 1;
        }
        let total: u64 = counts.iter().sum();
        let mut frequency = [0u16; 256];
        let mut left = i64::from(SCALE);
        for (token, (f, &c)) in frequency.iter_mut().zip(&counts).enumerate() {
            let share = (c as u128 * u128::from(SCALE) / u128::from(total)) as u16;
            *f = if c > 0 || token == usize::from(ESCAPE) { share.max(1) } else { 0 };
            left -= i64::from(*f);
        }
        // Hand out (or take back) one unit at a time where it saves (or costs) the fewest bits:
        // a unit more on frequency f of a token seen c times saves about c / f.
        while left != 0 {
            let mut best: Option<(usize, u64)> = None;
            for (token, (&f, &c)) in frequency.iter().zip(&counts).enumerate() {
                let f = u64::from(f);
                let candidate = if left > 0 {
                    (f > 0).then(|| (c << 16) / f)
                } else {
                    (f > 1).then(|| u64::MAX - (c << 16) / (f - 1))
                };
                if let Some(gain) = candidate
                    && best.is_none_or(|(_, b)| gain > b)
                {
                    best = Some((token, gain));
                }
            }
            let Some((token, _)) = best else { break };
            if left > 0 {
                frequency[token] += 1;
                left -= 1;
            } else {
                frequency[token] -= 1;
                left += 1;
            }
        }
        Self::new(frequency, raw_bits)
    }

    /// Raw low bits per value, 0..=8.
    pub const fn raw_bits(&self) -> u8 {
        self.raw_bits
    }

    /// Frequency of `token`, 0..=2048.
    pub const fn frequency(&self, token: u8) -> u32 {
        self.frequency[token as usize] as u32
    }

    /// Sum of the frequencies before `token`.
    pub const fn start(&self, token: u8) -> u32 {
        self.start[token as usize] as u32
    }

    /// The token that codes `value` with `raw_bits` raw bits: 0 (escape) if none does.
    pub const fn token(value: i16, raw_bits: u8) -> u8 {
        let token = (value >> raw_bits) as i32 + 128;
        if token >= 1 && token <= 255 { token as u8 } else { ESCAPE }
    }

    /// The token for `value` in this table: the escape if the token's frequency is zero.
    pub const fn code(&self, value: i16) -> u8 {
        let token = Self::token(value, self.raw_bits);
        if self.frequency(token) == 0 { ESCAPE } else { token }
    }

    /// The lowest and highest token with a frequency, the escape left out.
    pub fn token_span(&self) -> Option<(u8, u8)> {
        let first = (1..=255u8).find(|&t| self.frequency(t) > 0)?;
        let last = (1..=255u8).rev().find(|&t| self.frequency(t) > 0)?;
        Some((first, last))
    }

    /// Bytes of this table on the wire.
    pub fn wire_len(&self) -> usize {
        if self.index.is_some() {
            return 2;
        }
        TABLE_HEADER_BYTES + self.token_span().map_or(0, |(first, last)| 2 * (usize::from(last - first) + 1))
    }

    /// Calls `emit` with the bytes of this table on the wire.
    pub fn write(&self, mut emit: impl FnMut(&[u8])) {
        if let Some(index) = self.index {
            return emit(&[NAMED, index]);
        }
        let span = self.token_span();
        let (first, count) = span.map_or((0, 0), |(first, last)| (first, last - first + 1));
        emit(&[self.raw_bits, first, count]);
        emit(&self.frequency[usize::from(ESCAPE)].to_le_bytes());
        for f in self.frequency.iter().skip(usize::from(first)).take(usize::from(count)) {
            emit(&f.to_le_bytes());
        }
    }

    /// The next table of `reader`.
    ///
    /// # Errors
    /// Short bytes, a raw-bit count over 8, tokens past 255, a sum other than 2048.
    pub fn read(reader: &mut Reader<'_>) -> Result<Self> {
        let start = reader.offset();
        let raw_bits = reader.u8("table.raw_bits")?;
        if raw_bits == NAMED {
            return Self::named(reader.u8("table.index")?)
                .map_err(|e| Error { offset: e.offset + start as u32, ..e });
        }
        let first = reader.u8("table.first")?;
        let count = reader.u8("table.count")?;
        let mut frequency = [0u16; 256];
        frequency[usize::from(ESCAPE)] = reader.u16("table.escape")?;
        if count > 0 {
            let last = u32::from(first) + u32::from(count) - 1;
            in_range("table.first", start + 1, u32::from(first), 1, 255)?;
            in_range("table.count", start + 2, last, 1, 255)?;
        }
        for target in frequency.iter_mut().skip(usize::from(first)).take(usize::from(count)) {
            *target = reader.u16("table.frequency")?;
        }
        Self::new(frequency, raw_bits).map_err(|e| Error { offset: start as u32, ..e })
    }

    /// Fills decode slots: slot `s` holds the token whose range holds `s`, packed as
    /// `frequency << 20 | (s - start) << 8 | token`.
    pub fn fill_slots(&self, slots: &mut [u32; SLOTS]) {
        let mut at = slots.iter_mut();
        for (token, &f) in self.frequency.iter().enumerate() {
            for (bias, slot) in at.by_ref().take(usize::from(f)).enumerate() {
                *slot = u32::from(f) << 20 | (bias as u32) << 8 | token as u32;
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::vec::Vec;

    #[test]
    fn a_sum_off_by_one_is_refused() {
        let mut frequency = [0u16; 256];
        frequency[0] = 1;
        frequency[128] = 2047;
        assert!(Table::new(frequency, 0).is_ok());
        frequency[129] = 1;
        let error = Table::new(frequency, 0).unwrap_err();
        assert_eq!((error.field, error.found), ("table.sum", 2049));
    }

    proptest! {
        #[test]
        fn counts_give_a_full_table_in_which_everything_seen_is_codable(
            seen in proptest::collection::vec(
                (1u8..=255, 1u64..1_000_000),
                0..if cfg!(miri) { 40 } else { 255 },
            ),
            raw_bits in 0u8..=8,
        ) {
            let mut counts = [0u64; 256];
            for &(token, count) in &seen { counts[usize::from(token)] += count; }
            let table = Table::from_counts(&counts, raw_bits).unwrap();
            for (token, _) in seen { prop_assert!(table.frequency(token) > 0); }
            prop_assert!(table.frequency(ESCAPE) > 0);
            let mut bytes = Vec::new();
            table.write(|b| bytes.extend_from_slice(b));
            prop_assert_eq!(bytes.len(), table.wire_len());
            let mut reader = Reader::new(&bytes);
            prop_assert_eq!(Table::read(&mut reader).unwrap(), table);
        }

        #[test]
        fn any_bytes_are_a_table_or_an_error(
            bytes in proptest::collection::vec(any::<u8>(), 0..if cfg!(miri) { 100 } else { 600 }),
        ) {
            let _ = Table::read(&mut Reader::new(&bytes));
        }
    }
}
