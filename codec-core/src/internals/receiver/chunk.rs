//! Decodes a `paper` chunk: a range of symbols of one group, which arrives when all its ranges have.

use core::ops::Range;

use super::{Memory, Receiver};
use crate::{
    closure::Arrived,
    error::{Error, ErrorKind, Result},
    ids::{ClusterId, EpochId, Level, Span},
    layout::Shape,
    rans::bytes,
    wire::{
        manifest::{Epoch, Manifest, Profile},
        packet::Chunk,
    },
};

/// A field of a chunk that is at odds with the manifest.
fn contradiction(field: &'static str, offset: usize, found: u64, allowed: (u64, u64)) -> Error {
    Error::illegal(field, offset, found, allowed).kind(ErrorKind::Contradiction)
}

/// The group that a chunk says it is of, once it is known to say nothing else that is wrong.
struct ChunkGroup {
    shape: Shape,
    /// `4 · cluster + level`.
    number: usize,
    /// Symbols of the group.
    len: u64,
    #[cfg_attr(not(feature = "paper-context"), allow(dead_code, reason = "only that coder asks for it"))]
    epoch: Epoch,
}

impl ChunkGroup {
    /// Finds the group of `chunk` and compares the chunk's header with it.
    fn of(manifest: &Manifest<'_>, chunk: &Chunk<'_>) -> Result<Self> {
        let cluster = u32::from(chunk.cluster);
        let last = u64::from(manifest.head().clusters.saturating_sub(1));
        let unknown = contradiction("chunk.cluster", 4, cluster.into(), (0, last));
        let (span, local, epoch) = locate(manifest, cluster).ok_or(unknown)?;
        let shape = Shape::in_lattice(manifest, span, local)?;
        for (field, offset, found, wanted) in [
            ("chunk.first_frame", 6, u32::from(chunk.first_frame), epoch.first_frame & 0xffff),
            ("chunk.frames", 8, u32::from(chunk.frames), epoch.frames & 0xffff),
            ("chunk.quant", 10, u32::from(chunk.quant), u32::from(shape.cluster.quant)),
        ] {
            if found != wanted {
                return Err(contradiction(field, offset, found.into(), (wanted.into(), wanted.into())));
            }
        }
        let len = shape.level_len(chunk.level) as u64;
        let first = u64::from(chunk.first_symbol);
        if first >= len {
            return Err(contradiction("chunk.first_symbol", 14, first, (0, len.saturating_sub(1))));
        }
        let symbols = u64::from(chunk.symbols);
        if symbols > len - first {
            return Err(contradiction("chunk.symbols", 18, symbols, (1, len - first)));
        }
        let number = cluster * Level::COUNT as u32 + u32::from(chunk.level.get());
        // A level needs the one below, and says so; the base needs nothing.
        let needs = u64::from(chunk.level > Level::BASE);
        let words = chunk.dependencies.len() as u64;
        if words != needs {
            return Err(contradiction("chunk.dependencies", 11, words, (needs, needs)));
        }
        let below = number.saturating_sub(1);
        if let Some(&word) = chunk.dependencies.first().filter(|&&word| word != below) {
            return Err(contradiction("chunk.dependency", 22, word.into(), (below.into(), below.into())));
        }
        Ok(Self { shape, number: number as usize, len, epoch })
    }

    /// Which symbols of the group `chunk` holds, as its coder has to know.
    #[cfg(feature = "paper-context")]
    fn place(&self, chunk: &Chunk<'_>) -> Result<crate::rans::context::Place> {
        let none = contradiction("cluster.gaussians", 4, 0, (1, u64::from(u16::MAX)));
        Ok(crate::rans::context::Place {
            level: chunk.level,
            first: chunk.first_symbol as usize,
            gaussians: core::num::NonZero::new(self.shape.gaussians()).ok_or(none)?,
            rank: self.epoch.rank.into(),
            frames: self.epoch.frames as usize,
        })
    }
}

/// The span, the epoch's own number and the epoch of cluster `cluster`, counted over all epochs.
fn locate(manifest: &Manifest<'_>, cluster: u32) -> Option<(Span, ClusterId, Epoch)> {
    for (e, epoch) in manifest.epochs().enumerate() {
        let inside = cluster.checked_sub(epoch.first_cluster).filter(|&local| local < epoch.clusters);
        if let Some(local) = inside {
            return Some((Span::Canonical(EpochId(e as u16)), ClusterId(local as u16), epoch));
        }
    }
    None
}

impl Receiver<'_> {
    /// Decodes `chunk` to its place; its group has arrived when no symbol of it is missing.
    ///
    /// Kept apart, so that its byte tables do not weigh on the stack of `dgs1`.
    ///
    /// # Errors
    /// Why it is refused; then none of its symbols counts as arrived.
    #[inline(never)]
    pub(super) fn decode_chunk(&mut self, chunk: &Chunk<'_>) -> Result<()> {
        self.check_profile(Profile::Paper)?;
        let manifest = &self.manifest;
        let group = ChunkGroup::of(manifest, chunk)?;
        let Memory { cells, symbols, blocks, slots, progress, .. } = &mut self.memory;
        let too_small = |field| Error::illegal(field, 0, 0, (1, 1)).kind(ErrorKind::Capacity);
        let cell = *cells.get(usize::from(chunk.cluster)).ok_or(too_small("memory.cells"))?;
        let (level_start, _) = group.shape.range(chunk.level, 0..1);
        let group_start = cell.symbols as usize + level_start;
        let start = group_start + chunk.first_symbol as usize;
        let range = start..start + usize::from(chunk.symbols);
        let groups = manifest.cells() * Level::COUNT;
        let (counters, marks) = progress.split_at_mut_checked(groups).ok_or(too_small("memory.progress"))?;
        let counter = counters.get_mut(group.number).ok_or(too_small("memory.progress"))?;
        let words = range.start / 32..range.end.div_ceil(32);
        let first_word = words.start;
        let marks = marks.get_mut(words).ok_or(too_small("memory.progress"))?;
        if let Some(symbol) = first_mark(marks, first_word, &range) {
            let found = (symbol - group_start) as u64;
            let twice = Error::illegal("chunk.first_symbol", 14, found, (found, found));
            return Err(twice.kind(ErrorKind::Duplicate));
        }
        let target = symbols.get_mut(range.clone()).ok_or(too_small("memory.symbols"))?;
        match manifest.chunk_coder() {
            #[cfg(feature = "paper-context")]
            Some(crate::wire::manifest::ChunkCoder::Context) => {
                crate::rans::context::decode(chunk.payload, group.place(chunk)?, target)?;
            }
            _ => {
                let [low, high] = manifest.byte_tables(chunk.cluster.into(), chunk.level)?;
                let slots: &mut [u8] = bytemuck::cast_slice_mut(slots);
                let slots = slots.as_chunks_mut::<{ bytes::SLOTS }>().0.first_chunk_mut();
                let [low_slots, high_slots] = slots.ok_or(too_small("memory.slots"))?;
                low.fill_slots(low_slots);
                high.fill_slots(high_slots);
                bytes::decode(chunk.payload, [&low, &high], [low_slots, high_slots], target)?;
            }
        }
        let mask = blocks.get_mut(cell.blocks as usize).ok_or(too_small("memory.blocks"))?;
        mark(marks, first_word, &range);
        *counter += u32::from(chunk.symbols);
        if u64::from(*counter) == group.len {
            *mask = Arrived(*mask).with(chunk.level).0;
        }
        Ok(())
    }
}

/// Bits of word `word` that lie in `range` of a bitmap.
fn bits_of(word: usize, range: &Range<usize>) -> u32 {
    let from = range.start.saturating_sub(32 * word).min(32) as u32;
    let to = range.end.saturating_sub(32 * word).min(32) as u32;
    let below = |end: u32| ((1u64 << end) - 1) as u32;
    below(to) & !below(from)
}

/// The first bit of `range` that is set in bitmap `marks`, whose first word is word `first_word`.
fn first_mark(marks: &[u32], first_word: usize, range: &Range<usize>) -> Option<usize> {
    for (word, marks) in (first_word..).zip(marks) {
        let found = marks & bits_of(word, range);
        if found != 0 {
            return Some(32 * word + found.trailing_zeros() as usize);
        }
    }
    None
}

/// Sets the bits of `range` in bitmap `marks`, whose first word is word `first_word`.
fn mark(marks: &mut [u32], first_word: usize, range: &Range<usize>) {
    for (word, marks) in (first_word..).zip(marks) {
        *marks |= bits_of(word, range);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;
    extern crate std;
    use std::{vec, vec::Vec};

    proptest! {
        #[test]
        fn marks_are_a_set_of_symbols(
            ranges in proptest::collection::vec((0usize..300, 0usize..90), 1..20),
        ) {
            let mut marks = [0u32; 13];
            let mut naive = vec![false; 400];
            for (start, len) in ranges {
                let range = start..start + len;
                let words = range.start / 32..range.end.div_ceil(32);
                let part = &mut marks[words.clone()];
                prop_assert_eq!(first_mark(part, words.start, &range), range.clone().find(|&i| naive[i]));
                mark(part, words.start, &range);
                naive[range].fill(true);
                let found: Vec<bool> = (0..400).map(|i| marks[i / 32] >> (i % 32) & 1 == 1).collect();
                prop_assert_eq!(&found, &naive);
            }
        }
    }
}
