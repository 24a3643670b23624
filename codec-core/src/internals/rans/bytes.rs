//! The `paper` chunk body: byte-wise rANS over i16 symbols (paper section 3).
//!
//! Each symbol is two bytes, low then high, each coded with its own 12-bit table of 256
//! frequencies. One 32-bit state with the lower bound 2^23, renormalised by bytes. Layout:
//! `[state: u32][bytes …]`. A body is whole only if the state ends at 2^23 and every byte is used.

use super::table::starts;
use crate::error::{Error, ErrorKind, Result};

/// log2 of the sum of a byte table's frequencies.
pub const PRECISION: u32 = 12;
/// The sum of a byte table's frequencies.
pub const SCALE: u32 = 1 << PRECISION;
/// Slots of a decode table.
pub const SLOTS: usize = SCALE as usize;
/// Bytes of one byte table in the manifest: 256 × u16.
pub const TABLE_BYTES: usize = 512;
/// Bytes of the final state in front of every body.
pub const STATE_BYTES: usize = 4;
const LOW: u32 = 1 << 23;

/// Frequencies of the 256 byte values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct ByteTable {
    /// Invariant: sums to [`SCALE`].
    frequency: [u16; 256],
    /// Invariant: the sum of the frequencies before.
    start: [u16; 256],
}

impl ByteTable {
    /// A table of `frequency`.
    ///
    /// # Errors
    /// If the frequencies do not sum to 4096.
    pub fn new(frequency: [u16; 256]) -> Result<Self> {
        let sum: u32 = frequency.iter().map(|&f| u32::from(f)).sum();
        if sum != SCALE {
            let allowed = (u64::from(SCALE), u64::from(SCALE));
            return Err(Error::illegal("byte_table.sum", 0, u64::from(sum), allowed));
        }
        Ok(Self { frequency, start: starts(&frequency) })
    }

    /// A table for bytes seen `counts` times, every seen byte at least 1 in 4096; a table of
    /// nothing seen holds only byte 0.
    ///
    /// # Errors
    /// None: what is left to hand out always has a taker.
    pub fn from_counts(counts: &[u64; 256]) -> Result<Self> {
        let mut counts = *counts;
        if counts.iter().all(|&c| c == 0) {
            counts[0] = 1;
        }
        let total: u128 = counts.iter().map(|&c| u128::from(c)).sum();
        let mut frequency = [0u16; 256];
        let mut left = i64::from(SCALE);
        for (f, &c) in frequency.iter_mut().zip(&counts) {
            if c > 0 {
                *f = ((u128::from(c) * u128::from(SCALE) / total) as u16).max(1);
                left -= i64::from(*f);
            }
        }
        while left != 0 {
            let gain = |&(f, c): &(u16, u64)| match left > 0 {
                true => (u128::from(c) << 32) / u128::from(f.max(1)),
                false => u128::MAX - (u128::from(c) << 32) / u128::from(f.saturating_sub(1).max(1)),
            };
            let best = (0..256usize)
                .filter(|&b| if left > 0 { frequency[b] > 0 } else { frequency[b] > 1 })
                .max_by_key(|&b| (gain(&(frequency[b], counts[b])), core::cmp::Reverse(b)));
            let Some(best) = best else { break };
            if left > 0 {
                frequency[best] += 1;
                left -= 1;
            } else {
                frequency[best] -= 1;
                left += 1;
            }
        }
        Self::new(frequency)
    }

    /// From its 512 bytes in the manifest.
    ///
    /// # Errors
    /// As [`ByteTable::new`].
    #[inline(never)]
    pub fn from_bytes(bytes: &[u8; TABLE_BYTES]) -> Result<Self> {
        let mut frequency = [0u16; 256];
        for (f, pair) in frequency.iter_mut().zip(bytes.as_chunks().0) {
            *f = u16::from_le_bytes(*pair);
        }
        Self::new(frequency)
    }

    /// Its 512 bytes in the manifest.
    pub fn to_bytes(&self) -> [u8; TABLE_BYTES] {
        let mut bytes = [0u8; TABLE_BYTES];
        for (pair, f) in bytes.chunks_exact_mut(2).zip(self.frequency) {
            pair.copy_from_slice(&f.to_le_bytes());
        }
        bytes
    }

    /// Frequency of `byte`, 0..=4096.
    pub const fn frequency(&self, byte: u8) -> u32 {
        self.frequency[byte as usize] as u32
    }

    /// Fills decode slots with the byte whose range holds each slot.
    pub fn fill_slots(&self, slots: &mut [u8; SLOTS]) {
        let mut at = slots.iter_mut();
        for (byte, &f) in self.frequency.iter().enumerate() {
            at.by_ref().take(usize::from(f)).for_each(|slot| *slot = byte as u8);
        }
    }
}

/// Decodes `out.len()` symbols of `body`; `slots` are the low and high tables' slots.
///
/// # Errors
/// [`ErrorKind::Short`] if bytes run out, [`ErrorKind::Illegal`] for a state out of range, a
/// wrong end state, or bytes left over.
pub fn decode(body: &[u8], tables: [&ByteTable; 2], slots: [&[u8; SLOTS]; 2], out: &mut [i16]) -> Result<()> {
    let Some((state, mut rest)) = body.split_first_chunk::<STATE_BYTES>() else {
        return Err(Error::short("chunk.state", 0, body.len(), STATE_BYTES));
    };
    let mut x = u32::from_le_bytes(*state);
    if !(LOW..LOW << 8).contains(&x) {
        let allowed = (u64::from(LOW), u64::from((LOW << 8) - 1));
        return Err(Error::illegal("chunk.state", 0, u64::from(x), allowed));
    }
    for value in out {
        let mut pair = [0u8; 2];
        for (byte, (table, slots)) in pair.iter_mut().zip(tables.iter().zip(slots)) {
            let slot = x & (SCALE - 1);
            *byte = slots[slot as usize];
            let start = u32::from(table.start[usize::from(*byte)]);
            // `slots` may belong to another table only by the caller's mistake; wrapping keeps
            // even that free of panics, and the end-state check refuses the result.
            x = table.frequency(*byte).wrapping_mul(x >> PRECISION).wrapping_add(slot.wrapping_sub(start));
            while x < LOW {
                let Some((&next, tail)) = rest.split_first() else {
                    return Err(Error::short("chunk.bytes", body.len(), 0, 1));
                };
                x = x << 8 | u32::from(next);
                rest = tail;
            }
        }
        *value = i16::from_le_bytes(pair);
    }
    if x != LOW {
        return Err(Error::illegal("chunk.state", 0, u64::from(x), (LOW.into(), LOW.into())));
    }
    if !rest.is_empty() {
        return Err(Error::illegal("chunk.bytes", body.len() - rest.len(), rest.len() as u64, (0, 0)));
    }
    Ok(())
}

/// Encodes `values` at the END of `out` and returns where the body starts, so that a caller can
/// try ever more symbols without moving bytes.
///
/// # Errors
/// [`ErrorKind::Capacity`] if `out` is too small, [`ErrorKind::Illegal`] for a byte the table
/// does not hold.
pub fn encode(values: &[i16], tables: [&ByteTable; 2], out: &mut [u8]) -> Result<usize> {
    let room = out.len();
    let full = Error::short("chunk", 0, room, room + 1).kind(ErrorKind::Capacity);
    let mut at = room;
    let mut x = LOW;
    for &value in values.iter().rev() {
        let [low, high] = value.to_le_bytes();
        for (byte, table) in [(high, tables[1]), (low, tables[0])] {
            let f = table.frequency(byte);
            if f == 0 {
                return Err(Error::illegal("encode.byte", 0, u64::from(byte), (0, 0)));
            }
            while u64::from(x) >= u64::from(f) << (31 - PRECISION) {
                at = at.checked_sub(1).ok_or(full)?;
                out[at] = x as u8;
                x >>= 8;
            }
            x = ((x / f) << PRECISION) + x % f + u32::from(table.start[usize::from(byte)]);
        }
    }
    at = at.checked_sub(STATE_BYTES).ok_or(full)?;
    out[at..at + STATE_BYTES].copy_from_slice(&x.to_le_bytes());
    Ok(at)
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::vec;

    fn tables(values: &[i16]) -> [ByteTable; 2] {
        let mut counts = [[0u64; 256]; 2];
        for value in values {
            for (counts, byte) in counts.iter_mut().zip(value.to_le_bytes()) {
                counts[usize::from(byte)] += 1;
            }
        }
        counts.map(|c| ByteTable::from_counts(&c).unwrap())
    }

    proptest! {
        #[test]
        fn round_trip_and_damage(
            values in proptest::collection::vec(any::<i16>(), 0..if cfg!(miri) { 12 } else { 800 }),
            flip: usize,
        ) {
            let [low, high] = tables(&values);
            for table in [&low, &high] {
                prop_assert_eq!(&ByteTable::from_bytes(&table.to_bytes()).unwrap(), table);
            }
            let mut slots = [[0u8; SLOTS]; 2];
            low.fill_slots(&mut slots[0]);
            high.fill_slots(&mut slots[1]);
            let mut out = vec![0u8; 4096];
            let at = encode(&values, [&low, &high], &mut out).unwrap();
            let mut back = vec![0i16; values.len()];
            decode(&out[at..], [&low, &high], [&slots[0], &slots[1]], &mut back).unwrap();
            prop_assert_eq!(&back, &values);
            let flip = at * 8 + flip % ((out.len() - at) * 8);
            out[flip / 8] ^= 1 << (flip % 8);
            let damaged = decode(&out[at..], [&low, &high], [&slots[0], &slots[1]], &mut back);
            prop_assert!(damaged.is_err() || back != values);
        }
    }

    #[test]
    fn a_full_buffer_is_a_capacity_error() {
        let values = [1i16, -1, 300, 9];
        let [low, high] = tables(&values);
        let mut out = [0u8; 4];
        assert_eq!(encode(&values, [&low, &high], &mut out).unwrap_err().kind, ErrorKind::Capacity);
    }
}
