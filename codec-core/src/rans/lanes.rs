//! The `dgs1` packet body: four interleaved rANS lanes.
//!
//! Symbol `i` of a packet is coded on lane `i mod 4`. States are 32-bit with the lower bound
//! 2^15, renormalised by 16-bit words, at most one per symbol. Layout:
//!
//! ```text
//! [words: u16 …][states: 4 × u32][raw plane: ceil(bits / 8)][escapes: i16 …]
//! ```
//!
//! The words are read from the front; the states follow them, so a reader may fetch past the last
//! word without leaving the packet. Escape count and raw-plane size are known from the header and
//! the slices. A body is whole only if all four states end at 2^15 and every word is used: a free
//! integrity check. Invariant between symbols: `2^15 <= state < 2^31`.

use super::table::{ESCAPE, PRECISION, SCALE, SLOTS, Table};
use crate::error::{Error, ErrorKind, Result};

/// Number of lanes.
pub const LANES: usize = 4;
/// Bytes of the four states.
pub const STATES_BYTES: usize = 4 * LANES;
const LOW: u32 = 1 << 15;

/// Bytes that `bits` raw bits take.
pub const fn raw_plane_bytes(bits: usize) -> usize {
    bits.div_ceil(8)
}

/// A decoder over one packet body.
#[derive(Debug)]
pub struct Decoder<'a> {
    words: &'a [u8],
    state: [u32; LANES],
    /// Lane of the next symbol, 0..4.
    lane: usize,
    raw: &'a [u8],
    raw_at: usize,
    escapes: &'a [u8],
    body_len: usize,
}

impl<'a> Decoder<'a> {
    /// A decoder of `body`, which holds `raw_bits` raw bits and `escapes` escaped values.
    ///
    /// # Errors
    /// [`ErrorKind::Short`] if the body cannot hold its fixed parts, [`ErrorKind::Illegal`] for
    /// half a word or a state out of range.
    pub fn new(body: &'a [u8], raw_bits: usize, escapes: usize) -> Result<Self> {
        let tail = STATES_BYTES + raw_plane_bytes(raw_bits) + 2 * escapes;
        let Some(words_len) = body.len().checked_sub(tail) else {
            return Err(Error::short("body", 0, body.len(), tail));
        };
        if words_len % 2 != 0 {
            return Err(Error::illegal("body.words", 0, words_len as u64, (0, words_len as u64 - 1)));
        }
        let (words, rest) = body.split_at(words_len);
        let (states, rest) = rest.split_at(STATES_BYTES);
        let (raw, escapes) = rest.split_at(raw_plane_bytes(raw_bits));
        let mut state = [0u32; LANES];
        for (state, bytes) in state.iter_mut().zip(states.chunks_exact(4)) {
            *state = u32::from_le_bytes([bytes[0], bytes[1], bytes[2], bytes[3]]);
            if !(LOW..LOW << 16).contains(state) {
                let allowed = (u64::from(LOW), u64::from((LOW << 16) - 1));
                return Err(Error::illegal("body.state", words_len, u64::from(*state), allowed));
            }
        }
        Ok(Self { words, state, lane: 0, raw, raw_at: 0, escapes, body_len: body.len() })
    }

    /// Decodes `out.len()` values with the table behind `slots` and its `raw_bits`.
    ///
    /// # Errors
    /// [`ErrorKind::Short`] if words, raw bits or escapes run out.
    pub fn run(&mut self, slots: &[u32; SLOTS], raw_bits: u8, out: &mut [i16]) -> Result<()> {
        let mut rest = out;
        if self.lane == 0 {
            let quads = rest.len() / LANES * LANES;
            let (head, tail) = rest.split_at_mut(quads);
            for quad in head.chunks_exact_mut(LANES) {
                let mut tokens = [0u8; LANES];
                for (token, state) in tokens.iter_mut().zip(&mut self.state) {
                    *token = step(slots, state);
                    if *state < LOW {
                        *state = refill(&mut self.words, *state, self.body_len)?;
                    }
                }
                for (value, token) in quad.iter_mut().zip(tokens) {
                    *value = self.value(token, raw_bits)?;
                }
            }
            rest = tail;
        }
        for value in rest {
            // `lane` is below 4 by the mask, so the lookup cannot fail.
            let state = &mut self.state[self.lane & (LANES - 1)];
            let token = step(slots, state);
            if *state < LOW {
                *state = refill(&mut self.words, *state, self.body_len)?;
            }
            self.lane = (self.lane + 1) % LANES;
            *value = self.value(token, raw_bits)?;
        }
        Ok(())
    }

    #[inline]
    fn value(&mut self, token: u8, raw_bits: u8) -> Result<i16> {
        let low = if raw_bits == 0 { 0 } else { self.raw(raw_bits)? };
        if token != ESCAPE {
            return Ok(((i16::from(token) - 128) << raw_bits) | low);
        }
        let Some((head, tail)) = self.escapes.split_first_chunk::<2>() else {
            return Err(Error::short("body.escapes", self.body_len, 0, 2));
        };
        self.escapes = tail;
        Ok(i16::from_le_bytes(*head))
    }

    #[inline]
    fn raw(&mut self, bits: u8) -> Result<i16> {
        let (byte, shift) = (self.raw_at / 8, self.raw_at % 8);
        let Some(&low) = self.raw.get(byte) else {
            return Err(Error::short("body.raw", self.body_len, self.raw.len(), byte + 1));
        };
        let high = self.raw.get(byte + 1).copied().unwrap_or(0);
        self.raw_at += usize::from(bits);
        let window = u32::from(low) | u32::from(high) << 8;
        Ok(((window >> shift) & ((1 << bits) - 1)) as i16)
    }

    /// Accepts the body if it is used up and every lane ends where the encoder began.
    ///
    /// # Errors
    /// [`ErrorKind::Illegal`] naming what is left over.
    pub fn finish(self) -> Result<()> {
        for state in self.state {
            if state != LOW {
                return Err(Error::illegal("body.state", 0, u64::from(state), (LOW.into(), LOW.into())));
            }
        }
        let used = self.raw_at.div_ceil(8);
        for (field, left) in [
            ("body.words", self.words.len()),
            ("body.escapes", self.escapes.len()),
            ("body.raw", self.raw.len().saturating_sub(used)),
        ] {
            if left != 0 {
                return Err(Error::illegal(field, self.body_len, left as u64, (0, 0)));
            }
        }
        Ok(())
    }
}

/// Pops one token off `state`. Every slot holds frequency ≥ 1, so the state stays below 2^31.
#[inline(always)]
fn step(slots: &[u32; SLOTS], state: &mut u32) -> u8 {
    let slot = slots[(*state & (SCALE - 1)) as usize];
    *state = (slot >> 20) * (*state >> PRECISION) + ((slot >> 8) & 0xfff);
    slot as u8
}

#[inline(always)]
fn refill(words: &mut &[u8], state: u32, body_len: usize) -> Result<u32> {
    let Some((head, tail)) = words.split_first_chunk::<2>() else {
        return Err(Error::short("body.words", body_len, 0, 2));
    };
    *words = tail;
    Ok(state << 16 | u32::from(u16::from_le_bytes(*head)))
}

/// What [`encode`] wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoded {
    /// Bytes of the body.
    pub len: usize,
    /// Escaped values in it.
    pub escapes: usize,
    /// Raw bits in it.
    pub raw_bits: usize,
}

/// Encodes `values`, value `i` with `tables[table_of[i]]`, as one packet body at the front of
/// `out`.
///
/// # Errors
/// [`ErrorKind::Capacity`] if `out` is too small, [`ErrorKind::Illegal`] for a table index out of
/// range or lists of different lengths.
pub fn encode(values: &[i16], table_of: &[u8], tables: &[Table], out: &mut [u8]) -> Result<Encoded> {
    if values.len() != table_of.len() {
        let n = values.len() as u64;
        return Err(Error::illegal("encode.table_of", 0, table_of.len() as u64, (n, n)));
    }
    let full = |needed| Error::short("body", 0, out_len(needed), needed).kind(ErrorKind::Capacity);
    let room = out.len();
    let mut state = [LOW; LANES];
    let mut at = room;
    let (mut escapes, mut raw_bits) = (0usize, 0usize);
    for (i, (&value, &table)) in values.iter().zip(table_of).enumerate().rev() {
        let Some(table) = tables.get(usize::from(table)) else {
            let most = tables.len().saturating_sub(1) as u64;
            return Err(Error::illegal("encode.table", i, u64::from(table), (0, most)));
        };
        let token = table.code(value);
        escapes += usize::from(token == ESCAPE);
        raw_bits += usize::from(table.raw_bits());
        let (f, start) = (table.frequency(token), table.start(token));
        if f == 0 {
            return Err(Error::illegal("encode.escape", i, 0, (1, u64::from(SCALE))));
        }
        let x = &mut state[i % LANES];
        if u64::from(*x) >= u64::from(f) << (31 - PRECISION) {
            at = at.checked_sub(2).ok_or(full(room + 2))?;
            let word = out.get_mut(at..at + 2).ok_or(full(room + 2))?;
            word.copy_from_slice(&(*x as u16).to_le_bytes());
            *x >>= 16;
        }
        *x = ((*x / f) << PRECISION) + *x % f + start;
    }
    let words = room - at;
    let raw_start = words + STATES_BYTES;
    let escapes_start = raw_start + raw_plane_bytes(raw_bits);
    let len = escapes_start + 2 * escapes;
    if len > room {
        return Err(full(len));
    }
    out.copy_within(at.., 0);
    for (target, state) in out[words..].chunks_exact_mut(4).zip(state) {
        target.copy_from_slice(&state.to_le_bytes());
    }
    out[raw_start..escapes_start].fill(0);
    let (mut bit, mut escape_at) = (0usize, escapes_start);
    for (&value, &table) in values.iter().zip(table_of) {
        let table = &tables[usize::from(table)];
        let k = table.raw_bits();
        let escaped = table.code(value) == ESCAPE;
        if k > 0 {
            // An escaped value's raw bits stay zero: there is one encoding of each packet.
            let low = if escaped { 0 } else { (value as u16 & ((1 << k) - 1)) as u32 };
            let window = low << (bit % 8);
            out[raw_start + bit / 8] |= window as u8;
            if bit % 8 + usize::from(k) > 8 {
                out[raw_start + bit / 8 + 1] |= (window >> 8) as u8;
            }
            bit += usize::from(k);
        }
        if escaped {
            out[escape_at..escape_at + 2].copy_from_slice(&value.to_le_bytes());
            escape_at += 2;
        }
    }
    Ok(Encoded { len, escapes, raw_bits })
}

const fn out_len(needed: usize) -> usize {
    needed.saturating_sub(1)
}

/// The slow, obvious decoder that the fast one is tested against: searches the table for every
/// symbol, one symbol at a time, with wide integers.
#[doc(hidden)]
pub mod naive {
    use super::*;

    /// As [`Decoder::run`] over a whole body of one table per value.
    ///
    /// # Errors
    /// As [`Decoder`].
    pub fn decode(
        body: &[u8],
        raw_bits: usize,
        escapes: usize,
        table_of: &[u8],
        tables: &[Table],
        out: &mut [i16],
    ) -> Result<()> {
        let short = Error::short("body", 0, body.len(), STATES_BYTES);
        let tail = STATES_BYTES + raw_plane_bytes(raw_bits) + 2 * escapes;
        let words_len = body.len().checked_sub(tail).ok_or(short)?;
        let mut states = [0u64; LANES];
        for (lane, state) in states.iter_mut().enumerate() {
            for byte in 0..4 {
                *state |= u64::from(body[words_len + 4 * lane + byte]) << (8 * byte);
            }
        }
        let (mut word, mut bit) = (0usize, 0usize);
        let mut escape = words_len + STATES_BYTES + raw_plane_bytes(raw_bits);
        for (i, (value, &table)) in out.iter_mut().zip(table_of).enumerate() {
            let table = tables.get(usize::from(table)).ok_or(short)?;
            let x = &mut states[i % LANES];
            let slot = (*x % u64::from(SCALE)) as u32;
            let token = (0..=255u8)
                .find(|&t| slot >= table.start(t) && slot < table.start(t) + table.frequency(t))
                .ok_or(short)?;
            *x = u64::from(table.frequency(token)) * (*x >> PRECISION) + u64::from(slot - table.start(token));
            if *x < u64::from(LOW) {
                if word + 2 > words_len {
                    return Err(short);
                }
                *x = *x << 16 | u64::from(body[word]) | u64::from(body[word + 1]) << 8;
                word += 2;
            }
            let mut low = 0i32;
            for k in 0..table.raw_bits() {
                let byte = body.get(words_len + STATES_BYTES + bit / 8).ok_or(short)?;
                low |= i32::from(byte >> (bit % 8) & 1) << k;
                bit += 1;
            }
            *value = if token == ESCAPE {
                let pair = body.get(escape..escape + 2).ok_or(short)?;
                escape += 2;
                i16::from_le_bytes([pair[0], pair[1]])
            } else {
                ((i32::from(token) - 128) * (1 << table.raw_bits()) + low) as i16
            };
        }
        let whole = word == words_len && escape == body.len() && states == [u64::from(LOW); LANES];
        if whole { Ok(()) } else { Err(short) }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::{boxed::Box, vec, vec::Vec};

    fn tables() -> Vec<Table> {
        let mut tables = Vec::new();
        for (spread, raw_bits) in [(1u64, 0u8), (6, 0), (20, 2), (40, 8)] {
            let mut counts = [0u64; 256];
            for (token, count) in counts.iter_mut().enumerate() {
                let distance = (token as i64 - 128).unsigned_abs();
                *count = 100_000u64 >> (distance / spread).min(63);
            }
            counts[0] = 3;
            tables.push(Table::from_counts(&counts, raw_bits).unwrap());
        }
        tables
    }

    fn decode(body: &[u8], info: Encoded, table_of: &[u8], tables: &[Table]) -> Result<Vec<i16>> {
        let mut slots = vec![[0u32; SLOTS]; tables.len()].into_boxed_slice();
        for (table, slots) in tables.iter().zip(slots.iter_mut()) {
            table.fill_slots(slots);
        }
        let mut out = vec![0i16; table_of.len()];
        let mut decoder = Decoder::new(body, info.raw_bits, info.escapes)?;
        let mut at = 0;
        while at < table_of.len() {
            let table = usize::from(table_of[at]);
            let end =
                table_of[at..].iter().position(|&t| usize::from(t) != table).map_or(out.len(), |n| at + n);
            decoder.run(&slots[table], tables[table].raw_bits(), &mut out[at..end])?;
            at = end;
        }
        decoder.finish()?;
        Ok(out)
    }

    proptest! {
        #[test]
        fn what_is_encoded_is_decoded_by_both_twins(
            values in proptest::collection::vec(prop_oneof![6 => -8i16..8, 2 => -300i16..300, 1 => any::<i16>()], 0..500),
            picks in proptest::collection::vec(0u8..4, 500),
            runs in 1usize..40,
        ) {
            let tables = tables();
            let table_of: Vec<u8> = (0..values.len()).map(|i| picks[i / runs]).collect();
            let mut out = vec![0u8; 4096];
            let info = encode(&values, &table_of, &tables, &mut out).unwrap();
            let body = &out[..info.len];
            prop_assert_eq!(&decode(body, info, &table_of, &tables).unwrap(), &values);
            let mut slow = vec![0i16; values.len()];
            naive::decode(body, info.raw_bits, info.escapes, &table_of, &tables, &mut slow).unwrap();
            prop_assert_eq!(&slow, &values);
        }

        #[test]
        fn damaged_bodies_agree_between_twins_and_never_panic(
            values in proptest::collection::vec(-40i16..40, 1..300), at: usize, bit in 0u32..8, cut: usize,
        ) {
            let tables = tables();
            let table_of = vec![1u8; values.len()];
            let mut out = vec![0u8; 4096];
            let info = encode(&values, &table_of, &tables, &mut out).unwrap();
            let mut body = out[..info.len].to_vec();
            let at = at % body.len();
            body[at] ^= 1 << bit;
            body.truncate(body.len() - cut % 3);
            let fast = decode(&body, info, &table_of, &tables);
            let mut slow = vec![0i16; values.len()];
            let slow_result = naive::decode(&body, info.raw_bits, info.escapes, &table_of, &tables, &mut slow);
            // The fast one also refuses states out of range and half words; it never accepts more.
            if let Ok(fast) = fast {
                prop_assert!(slow_result.is_ok());
                prop_assert_eq!(fast, slow);
            }
        }
    }

    #[test]
    fn one_flipped_bit_in_the_words_is_noticed() {
        let tables = tables();
        let values: Vec<i16> = (0..200).map(|i| ((i * 7) % 23) as i16 - 11).collect();
        let table_of = vec![1u8; values.len()];
        let mut out = vec![0u8; 4096];
        let info = encode(&values, &table_of, &tables, &mut out).unwrap();
        out[3] ^= 0x10;
        assert!(decode(&out[..info.len], info, &table_of, &tables).map_or(true, |d| d != values));
    }

    #[test]
    fn a_buffer_that_is_too_small_is_a_capacity_error() {
        let tables = tables();
        let mut out = [0u8; 20];
        let error = encode(&[i16::MAX; 64], &[1; 64], &tables, &mut out).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Capacity);
    }

    #[test]
    fn literal_bytes_of_a_small_body() {
        let tables = tables();
        let mut out = [0u8; 64];
        let info = encode(&[0, 1, -1, 300], &[0; 4], &tables, &mut out).unwrap();
        let decoded = decode(&out[..info.len], info, &[0; 4], &tables).unwrap();
        assert_eq!((decoded.as_slice(), info.escapes, info.len), (&[0, 1, -1, 300][..], 1, 18));
        let _: Box<[i16]> = decoded.into();
    }
}
