//! Packs and unpacks the manifest body: an adaptive binary range coder over bytes.
//!
//! Manifests are small and made of fixed-width records, so there is little for a dictionary to
//! find and much for statistics: each byte is coded as eight binary decisions down a bit tree,
//! with the probabilities chosen by the class of the byte before it and by the byte's position
//! modulo 4. Integer only, no allocation, 8 KiB of probabilities on the stack.
//!
//! The stream has no end mark: the caller knows the unpacked length. There is exactly one packed
//! form of each input: unpacking refuses bytes that are short, left over, lie outside the first interval, or
//! end in another state than [`pack`] leaves.
//! (Carry-propagating range coder as in the public-domain LZMA description, sections "range
//! decoder" and "bit tree"; 11-bit probabilities, shift 4 for fast learning.)

use crate::{
    cursor::in_range,
    error::{Error, ErrorKind, Result},
};

const PROBABILITY_BITS: u32 = 11;
const LEARN_SHIFT: u32 = 4;
const TOP: u32 = 1 << 24;
const CLASSES: usize = 4;
const PHASES: usize = 4;

/// Bit-tree probabilities of zero by (class of the previous byte, position mod 4).
type Trees = [[u16; 256]; CLASSES * PHASES];

/// All probabilities at one half.
const EVEN: Trees = [[1 << (PROBABILITY_BITS - 1); 256]; CLASSES * PHASES];

/// The trees lie with the caller: moving 8 KiB about would double the stack.
struct Model<'a> {
    zero: &'a mut Trees,
    previous: u8,
    position: usize,
}

impl<'a> Model<'a> {
    const fn new(zero: &'a mut Trees) -> Self {
        Self { zero, previous: 0, position: 0 }
    }

    fn tree(&mut self) -> &mut [u16; 256] {
        let class = match self.previous {
            0 => 0,
            1..=15 => 1,
            16..=239 => 2,
            _ => 3,
        };
        let index = class * PHASES + self.position % PHASES;
        // `index` is below CLASSES * PHASES by construction.
        &mut self.zero[index % (CLASSES * PHASES)]
    }

    fn advance(&mut self, byte: u8) {
        self.previous = byte;
        self.position += 1;
    }
}

fn learn(zero: &mut u16, bit: bool) {
    if bit {
        *zero -= *zero >> LEARN_SHIFT;
    } else {
        *zero += ((1 << PROBABILITY_BITS) - *zero) >> LEARN_SHIFT;
    }
}

/// Packs `raw` into the front of `out` and returns the packed length.
///
/// # Errors
/// [`ErrorKind::Capacity`] if `out` is too small.
pub fn pack(raw: &[u8], out: &mut [u8]) -> Result<usize> {
    let mut coder = Packer { low: 0, range: u32::MAX, cache: 0, pending: 1, out, at: 0 };
    let mut trees = EVEN;
    let mut model = Model::new(&mut trees);
    for &byte in raw {
        let tree = model.tree();
        let mut node = 1usize;
        for shift in (0..8).rev() {
            let bit = byte >> shift & 1 == 1;
            let zero = &mut tree[node & 255];
            coder.bit(*zero, bit)?;
            learn(zero, bit);
            node = node << 1 | usize::from(bit);
        }
        model.advance(byte);
    }
    for _ in 0..5 {
        coder.shift_low()?;
    }
    Ok(coder.at)
}

struct Packer<'a> {
    low: u64,
    range: u32,
    cache: u8,
    /// Bytes held back until a carry is decided: the cache and a run of 0xff.
    pending: usize,
    out: &'a mut [u8],
    at: usize,
}

impl Packer<'_> {
    fn bit(&mut self, zero: u16, bit: bool) -> Result<()> {
        let bound = (self.range >> PROBABILITY_BITS) * u32::from(zero);
        if bit {
            self.low += u64::from(bound);
            self.range -= bound;
        } else {
            self.range = bound;
        }
        while self.range < TOP {
            self.range <<= 8;
            self.shift_low()?;
        }
        Ok(())
    }

    fn shift_low(&mut self) -> Result<()> {
        if self.low < 0xff00_0000 || self.low > u64::from(u32::MAX) {
            let carry = (self.low >> 32) as u8;
            let mut byte = self.cache;
            while self.pending > 0 {
                let room = self.out.len();
                let target = self.out.get_mut(self.at);
                *target.ok_or(Error::short("pack", self.at, room, room + 1).kind(ErrorKind::Capacity))? =
                    byte.wrapping_add(carry);
                self.at += 1;
                byte = 0xff;
                self.pending -= 1;
            }
            self.cache = (self.low >> 24) as u8;
        }
        self.pending += 1;
        self.low = (self.low & 0x00ff_ffff) << 8;
        Ok(())
    }
}

/// Unpacks `packed` into all of `out`.
///
/// # Errors
/// [`ErrorKind::Short`] if the input ends too early to have been written by [`pack`] for this
/// length, [`ErrorKind::Illegal`] for a first byte other than 0, a code outside the first interval, a
/// wrong end state or leftovers.
pub fn unpack(packed: &[u8], out: &mut [u8]) -> Result<()> {
    let mut rest = packed;
    let mut take = || {
        let (&byte, behind) = rest.split_first().ok_or_else(|| short(packed))?;
        rest = behind;
        Ok(byte)
    };
    in_range("pack.first", 0, take()?, 0, 0)?;
    let (mut range, mut code) = (u32::MAX, 0u32);
    for _ in 0..4 {
        code = code << 8 | u32::from(take()?);
    }
    // Below the range, as it then always is; no packer writes anything else.
    in_range("pack.code", 1, code, 0, range - 1)?;
    let mut trees = EVEN;
    let mut model = Model::new(&mut trees);
    for target in out.iter_mut() {
        let tree = model.tree();
        let mut node = 1usize;
        for _ in 0..8 {
            let zero = &mut tree[node & 255];
            let bound = (range >> PROBABILITY_BITS) * u32::from(*zero);
            let bit = code >= bound;
            if bit {
                code -= bound;
                range -= bound;
            } else {
                range = bound;
            }
            learn(zero, bit);
            node = node << 1 | usize::from(bit);
            while range < TOP {
                range <<= 8;
                code = code << 8 | u32::from(take()?);
            }
        }
        *target = node as u8;
        model.advance(*target);
    }
    // The packer writes out the low end of its last interval, so the distance from it is 0.
    in_range("pack.end", packed.len(), code, 0, 0)?;
    in_range("pack.leftover", packed.len() - rest.len(), rest.len() as u64, 0, 0)?;
    Ok(())
}

/// `packed` ends before what it unpacks to does.
#[cold]
fn short(packed: &[u8]) -> Error {
    Error::short("pack", packed.len(), packed.len(), packed.len() + 1)
}

/// A buffer length that [`pack`] never exceeds for `raw_len` bytes: a badly predicted bit costs
/// at most 7 bits under these probabilities.
pub const fn packed_bound(raw_len: usize) -> usize {
    raw_len * 8 + 16
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::{vec, vec::Vec};

    fn packed(raw: &[u8]) -> Vec<u8> {
        let mut out = vec![0u8; packed_bound(raw.len())];
        let len = pack(raw, &mut out).unwrap();
        out.truncate(len);
        out
    }

    proptest! {
        #[test]
        fn round_trip(
            raw in proptest::collection::vec(
                prop_oneof![3 => 0u8..4, 1 => any::<u8>(), 1 => Just(255u8)],
                0..if cfg!(miri) { 100 } else { 3000 },
            ),
        ) {
            let bytes = packed(&raw);
            let mut back = vec![0u8; raw.len()];
            unpack(&bytes, &mut back).unwrap();
            prop_assert_eq!(back, raw);
        }

        #[test]
        fn any_bytes_unpack_or_are_refused(
            bytes in proptest::collection::vec(any::<u8>(), 0..200),
            len in 0usize..if cfg!(miri) { 100 } else { 4000 },
        ) {
            let mut out = vec![0u8; len];
            let _ = unpack(&bytes, &mut out);
        }
    }

    #[test]
    fn repetitive_records_shrink() {
        let raw: Vec<u8> =
            (0..if cfg!(miri) { 600u32 } else { 4096 }).flat_map(|i| [(i % 3) as u8, 0, 0, 1]).collect();
        assert!(packed(&raw).len() * 5 < raw.len());
    }

    #[test]
    fn cut_input_is_short() {
        let raw: Vec<u8> = (0..if cfg!(miri) { 60u32 } else { 2000 })
            .map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8)
            .collect();
        let bytes = packed(&raw);
        let mut back = vec![0u8; raw.len()];
        for end in [0, 1, 4, bytes.len() / 2, bytes.len() - 1] {
            assert_eq!(unpack(&bytes[..end], &mut back).unwrap_err().kind, ErrorKind::Short);
        }
    }

    #[test]
    fn there_is_one_packed_form() {
        let raw: Vec<u8> = (0..300u32).map(|i| ((i * i) >> 3) as u8).collect();
        let bytes = packed(&raw);
        let mut back = vec![0u8; raw.len()];
        let refused = |bytes: &[u8], back: &mut [u8]| unpack(bytes, back).map_err(|e| e.field);
        let longer = [&bytes[..], &[0]].concat();
        assert_eq!(refused(&longer, &mut back), Err("pack.leftover"));
        let mut other = bytes.clone();
        other[0] = 1;
        assert_eq!(refused(&other, &mut back), Err("pack.first"));
        // Another five bytes of 0xff: a code at the end of the first interval comes to the same end.
        let mut five = [0u8; 5];
        let other = [0, 0xff, 0xff, 0xff, 0xff, 0xef, 0xff, 0xf0, 0];
        assert_eq!(packed(&[0xff; 5]), [0, 0xff, 0xff, 0xff, 0xfe, 0xfe, 0xff, 0xf0, 0]);
        assert_eq!(refused(&other, &mut five), Err("pack.code"));
        let mut other = bytes;
        *other.last_mut().unwrap() ^= 1;
        assert!(refused(&other, &mut back).is_err());
    }
}
