//! The `dgs1` packet body: four interleaved rANS lanes.
//!
//! Value `i` of a packet is coded on lane `i mod 4`. States are 32-bit with the lower bound 2^15,
//! renormalised by 16-bit words, at most one per value. Layout:
//!
//! ```text
//! [tail: u8][lengths: 4 × 4 bits][words: u16 → …][← … escapes: i16][plane: raw bits, states]
//! ```
//!
//! Words are read forwards, escapes backwards from where the plane begins, and both must meet: no
//! count travels. The plane's size follows from the lattice (raw bits) and the lengths of the four
//! states, which are stored without their leading one, so that a lane costs what its state is
//! worth and 4 bits.
//!
//! The encoder starts each lane far below 2^15, at a small power of two, and pushes the packet's
//! last values without renormalisation: they are kept in the states instead of 15 bits that say
//! nothing. `tail` says how many values are so kept: the last `4 · tail`. The decoder takes them
//! off without refilling. A body is whole only if every lane then ends at a power of two from
//! [`TAIL_START`] to 2^15, words and escapes meet, and the padding of the plane is zero: an
//! integrity check that costs three bits a lane.
//!
//! The plane ends the body and is at least 8 bytes long, because each state has 15 bits or more.
//! So an 8-byte load at any word or raw bit stays inside the body.

mod decode;
mod encode;
mod lookup;
pub mod naive;
mod plane;

pub use decode::{Decoder, Lanes};
pub use encode::{Encoded, Symbols, TableRun, encode};
pub use lookup::{Compact, Lookup};
pub use plane::Raw;

use crate::error::{Error, Result};

/// Number of lanes.
pub const LANES: usize = 4;
/// Bytes in front of the words.
pub const HEAD_BYTES: usize = 3;
/// Fewest bytes of a plane: four states of 15 bits.
pub const MIN_PLANE_BYTES: usize = 8;
/// Least state a lane starts from: what is above 1 is the integrity check, what is below a loss.
pub const TAIL_START: u32 = 8;
/// log2 of the least state outside the tail.
pub const LOW_BITS: u32 = 15;
/// The least state outside the tail; states stay below `LOW << 16`.
pub const LOW: u32 = 1 << LOW_BITS;

/// A body taken apart, nothing decoded yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Parts<'a> {
    /// Words, escapes and plane: what a decoder reads from.
    pub body: &'a [u8],
    /// Bytes of the words and the escapes together, at the front of `body`; an even number.
    pub stream: usize,
    /// Raw bits and states, behind those: what [`Raw`] reads from.
    pub plane: &'a [u8],
    /// States of the lanes before the first value, each `LOW..LOW << 16`.
    pub state: [u32; LANES],
    /// Values before those that the states keep.
    pub main: usize,
    /// Values that the states keep.
    pub tail: usize,
    /// Raw bits at the front of the plane.
    pub raw_bits: usize,
}

impl<'a> Parts<'a> {
    /// Takes `body` apart, which holds `values` values with `raw_bits` raw bits between them.
    ///
    /// # Errors
    /// [`ErrorKind::Short`](crate::ErrorKind::Short) if the body cannot hold its fixed parts,
    /// [`ErrorKind::Illegal`](crate::ErrorKind::Illegal) for half a word, a tail longer than the
    /// packet, or padding that is not zero.
    pub fn of(body: &'a [u8], values: usize, raw_bits: usize) -> Result<Self> {
        let short = |needed| Error::short("body", 0, body.len(), needed);
        let least = HEAD_BYTES + MIN_PLANE_BYTES;
        let Some((&[tail, low, high], rest)) = body.split_first_chunk::<HEAD_BYTES>() else {
            return Err(short(least));
        };
        let groups = values.div_ceil(LANES);
        if usize::from(tail) > groups {
            return Err(Error::illegal("body.tail", 0, tail.into(), (0, groups as u64)));
        }
        let tail = values.min(LANES * usize::from(tail));
        let lengths = u16::from_le_bytes([low, high]);
        let lengths: [u32; LANES] =
            core::array::from_fn(|lane| LOW_BITS + u32::from(lengths >> (4 * lane) & 15));
        let plane_bits = lengths.iter().fold(raw_bits, |sum, &bits| sum.saturating_add(bits as usize));
        let plane_len = plane_bits.div_ceil(8);
        let halves = rest.len().checked_sub(plane_len).and_then(|stream| rest.split_at_checked(stream));
        let Some((words, plane)) = halves else {
            return Err(short(HEAD_BYTES.saturating_add(plane_len)));
        };
        let stream = words.len();
        if !stream.is_multiple_of(2) {
            return Err(Error::illegal("body.words", HEAD_BYTES, stream as u64, (0, stream as u64 - 1)));
        }
        // States and padding are the last bits of the body: fewer than 128, more than 56.
        let mut last = [0u8; 16];
        let (from, to) = (body.len().saturating_sub(last.len()), last.len().saturating_sub(body.len()));
        for (place, &byte) in last.iter_mut().skip(to).zip(body.split_at(from).1) {
            *place = byte;
        }
        let mut bits = u128::from_le_bytes(last) >> (128 - (8 * plane.len() - raw_bits));
        let mut state = [0u32; LANES];
        for (state, length) in state.iter_mut().zip(lengths) {
            *state = 1 << length | bits as u32 & ((1 << length) - 1);
            bits >>= length;
        }
        if bits != 0 {
            let found = bits as u64;
            return Err(Error::illegal("body.padding", body.len() - 1, found, (0, 0)));
        }
        Ok(Self { body: rest, stream, plane, state, main: values - tail, tail, raw_bits })
    }
}

/// `state` when its first `by` lanes, modulo [`LANES`], have gone to the end; by moves between
/// registers, where a slice's rotation takes a buffer on the stack.
const fn turned(mut state: [u32; LANES], by: usize) -> [u32; LANES] {
    if by & 1 != 0 {
        let [a, b, c, d] = state;
        state = [b, c, d, a];
    }
    if by & 2 != 0 {
        let [a, b, c, d] = state;
        state = [c, d, a, b];
    }
    state
}

#[cfg(test)]
mod tests;
