//! Decode tables: from a slot to its token and back to the state before it.

use crate::rans::table::{PRECISION, SCALE, SLOTS, Table};

/// A decode table in some form.
pub trait Lookup {
    /// Pops one token off `state`: the token, and the state before it, not yet refilled.
    fn pop(&self, state: u32) -> (u8, u32);
}

/// The slots form, 8 KiB: one load per value.
impl Lookup for [u32; SLOTS] {
    #[inline(always)]
    fn pop(&self, state: u32) -> (u8, u32) {
        let slot = self[(state & (SCALE - 1)) as usize];
        // Every slot holds a frequency of 1..=2048 and a bias below it: no state grows.
        let below = (slot >> 20).wrapping_mul(state >> PRECISION).wrapping_add((slot >> 8) & 0xfff);
        (slot as u8, below)
    }
}

/// The compact form, 3 KiB, for machines short of memory: two loads per value.
#[derive(Clone, Copy, Debug)]
pub struct Compact<'a> {
    /// Token of each slot.
    pub token: &'a [u8; SLOTS],
    /// `frequency << 16 | start` of each token.
    pub range: &'a [u32; 256],
}

impl<'a> Compact<'a> {
    /// Fills `token` and `range` from `table`.
    pub fn fill(table: &Table, token: &'a mut [u8; SLOTS], range: &'a mut [u32; 256]) -> Self {
        let mut slots = token.iter_mut();
        for (t, range) in (0..=255u8).zip(range.iter_mut()) {
            let f = table.frequency(t);
            *range = f << 16 | table.start(t);
            for slot in slots.by_ref().take(f as usize) {
                *slot = t;
            }
        }
        Self { token, range }
    }
}

impl Lookup for Compact<'_> {
    #[inline(always)]
    fn pop(&self, state: u32) -> (u8, u32) {
        let slot = state & (SCALE - 1);
        let token = self.token[slot as usize];
        let range = self.range[usize::from(token)];
        let below =
            (range >> 16).wrapping_mul(state >> PRECISION).wrapping_add(slot).wrapping_sub(range & 0xffff);
        (token, below)
    }
}
