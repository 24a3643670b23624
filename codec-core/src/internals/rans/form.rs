//! Decode tables in the caller's memory: slots, or the compact form where there is less room.
//!
//! Both give the same values. Slots take 8 KiB a table and one load per value; the compact form
//! takes 3 KiB and two loads, the second of them dependent. All tables of a receiver have one form,
//! the fastest that fits the memory it was given.

use super::{
    lanes::{Compact, Decoder},
    table::{SLOTS, Table},
};
use crate::error::Result;

/// Tokens in a word of memory.
const TOKENS: usize = 4;
/// Words of the compact form before its ranges.
const TOKEN_WORDS: usize = SLOTS / TOKENS;

/// How a decode table lies in memory.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum Form {
    /// A word per slot.
    Slots,
    /// A byte per slot, then a word per token.
    Compact,
}

impl Form {
    /// Words of one table: 2048 or 768.
    pub const fn words(self) -> usize {
        match self {
            Self::Slots => SLOTS,
            Self::Compact => TOKEN_WORDS + 256,
        }
    }

    /// The fastest form in which `tables` tables fit into `words` words, if any does.
    pub fn that_fits(tables: usize, words: usize) -> Option<Self> {
        [Self::Slots, Self::Compact].into_iter().find(|form| tables.saturating_mul(form.words()) <= words)
    }

    /// Writes `table` as number `index` to `memory`; `None` if that ends before it.
    pub fn fill(self, memory: &mut [u32], index: usize, table: &Table) -> Option<()> {
        let start = index.checked_mul(self.words())?;
        let words = memory.get_mut(start..start.checked_add(self.words())?)?;
        match self {
            Self::Slots => table.fill_slots(words.first_chunk_mut()?),
            Self::Compact => {
                let (tokens, ranges) = words.split_first_chunk_mut::<TOKEN_WORDS>()?;
                let tokens: &mut [u8] = bytemuck::cast_slice_mut(tokens.as_mut_slice());
                Compact::fill(table, tokens.first_chunk_mut()?, ranges.first_chunk_mut()?);
            }
        }
        Some(())
    }

    /// Table number `index` of `memory`, if it is there.
    pub fn table(self, memory: &[u32], index: usize) -> Option<View<'_>> {
        let start = index.checked_mul(self.words())?;
        let words = memory.get(start..start.checked_add(self.words())?)?;
        match self {
            Self::Slots => words.first_chunk().map(View::Slots),
            Self::Compact => {
                let (tokens, ranges) = words.split_first_chunk::<TOKEN_WORDS>()?;
                let tokens: &[u8] = bytemuck::cast_slice(tokens.as_slice());
                Some(View::Compact(Compact { token: tokens.first_chunk()?, range: ranges.first_chunk()? }))
            }
        }
    }
}

/// A table in its memory.
#[derive(Clone, Copy, Debug)]
pub enum View<'m> {
    /// As [`Form::Slots`].
    Slots(&'m [u32; SLOTS]),
    /// As [`Form::Compact`].
    Compact(Compact<'m>),
}

impl View<'_> {
    /// Decodes the next `out.len()` values of `decoder` with this table and its `raw_bits`.
    ///
    /// # Errors
    /// As [`Decoder::run`].
    pub fn run(&self, decoder: &mut Decoder<'_>, raw_bits: u8, out: &mut [i16]) -> Result<()> {
        match self {
            Self::Slots(slots) => decoder.run(*slots, raw_bits, out),
            Self::Compact(compact) => decoder.run(compact, raw_bits, out),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rans::lanes::Lookup;
    use proptest::prelude::*;
    extern crate std;
    use std::{vec, vec::Vec};

    proptest! {
        #[test]
        fn both_forms_pop_the_same(
            seen in proptest::collection::vec((1u8..=255, 1u64..1_000_000), 0..60),
            states in proptest::collection::vec(1u32 << 15..1 << 31, 50),
        ) {
            let mut counts = [0u64; 256];
            for &(token, count) in &seen { counts[usize::from(token)] += count; }
            let table = Table::from_counts(&counts, 0).unwrap();
            let other = Table::from_counts(&[1; 256], 0).unwrap();
            let popped = |form: Form| -> Vec<(u8, u32)> {
                let mut memory = vec![u32::MAX; 2 * form.words()];
                form.fill(&mut memory, 0, &other);
                form.fill(&mut memory, 1, &table);
                form.fill(&mut memory, 2, &other);
                let pop = |&x: &u32| match form.table(&memory, 1).unwrap() {
                    View::Slots(slots) => slots.pop(x),
                    View::Compact(compact) => compact.pop(x),
                };
                states.iter().map(pop).collect()
            };
            prop_assert_eq!(popped(Form::Slots), popped(Form::Compact));
        }
    }

    #[test]
    fn the_fastest_form_that_fits_is_taken() {
        assert_eq!(Form::that_fits(3, 3 * 2048), Some(Form::Slots));
        assert_eq!(Form::that_fits(3, 3 * 2048 - 1), Some(Form::Compact));
        assert_eq!(Form::that_fits(3, 3 * 768), Some(Form::Compact));
        assert_eq!(Form::that_fits(3, 3 * 768 - 1), None);
        assert_eq!(Form::that_fits(0, 0), Some(Form::Slots));
        assert!(Form::Slots.table(&[0; 2047], 0).is_none() && Form::Compact.table(&[0; 768], 1).is_none());
        assert!(Form::Compact.table(&[0; 768], usize::MAX).is_none());
    }
}
