//! Where everything lies in a receiver's block: sums and roundings, no pointers.

use codec_core::{Gaussian, receiver::Cell};

use crate::types::{DGS_ALIGN, DgsSizes};

/// Byte ranges of a block's parts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Places {
    /// Of the canonical Gaussians.
    pub canonical: usize,
    /// Of the cells.
    pub cells: usize,
    /// Of the decode slots.
    pub slots: usize,
    /// Of the packet bitmap.
    pub seen: usize,
    /// Of the group counters.
    pub progress: usize,
    /// Of the symbols.
    pub symbols: usize,
    /// Of the unpacked manifest.
    pub manifest: usize,
    /// Of the arrival masks.
    pub blocks: usize,
    /// Of repair.
    pub parity: usize,
    /// Of media before the manifest.
    pub early: usize,
    /// Of the usable levels as last dequantised.
    pub known: usize,
    /// Where the block ends.
    pub end: usize,
}

impl Places {
    /// The places of parts of `sizes` after a head of `head` bytes; `None` if no address space
    /// holds them.
    pub fn of(sizes: &DgsSizes, head: usize) -> Option<Self> {
        let mut at = head;
        let mut part = |count: usize, size: usize, align: usize| -> Option<usize> {
            let start = at.checked_next_multiple_of(align)?;
            at = start.checked_add(count.checked_mul(size)?)?;
            // The largest slice there may be, and room to round up.
            (at <= isize::MAX as usize - DGS_ALIGN).then_some(start)
        };
        let mut places = Self {
            canonical: part(sizes.gaussians, size_of::<Gaussian>(), align_of::<Gaussian>())?,
            cells: part(sizes.cells, size_of::<Cell>(), align_of::<Cell>())?,
            slots: part(sizes.slots, 4, 4)?,
            seen: part(sizes.seen, 4, 4)?,
            progress: part(sizes.progress, 4, 4)?,
            symbols: part(sizes.symbols, 2, 2)?,
            manifest: part(sizes.manifest, 1, 1)?,
            blocks: part(sizes.blocks, 1, 1)?,
            parity: part(sizes.parity, 1, 1)?,
            early: part(sizes.early, 1, 1)?,
            // Blocks of an epoch are among the blocks of all cells.
            known: part(sizes.blocks, 1, 1)?,
            end: 0,
        };
        places.end = at.checked_next_multiple_of(DGS_ALIGN)?;
        Some(places)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn parts_are_aligned_and_do_not_overlap() {
        let sizes = DgsSizes {
            manifest: 3,
            cells: 2,
            symbols: 5,
            blocks: 7,
            seen: 1,
            slots: 9,
            progress: 2,
            parity: 11,
            early: 13,
            gaussians: 1,
        };
        let p = Places::of(&sizes, 100).unwrap();
        let parts = [
            (p.canonical, 56, 4),
            (p.cells, 16, 4),
            (p.slots, 36, 4),
            (p.seen, 4, 4),
            (p.progress, 8, 4),
            (p.symbols, 10, 2),
            (p.manifest, 3, 1),
            (p.blocks, 7, 1),
            (p.parity, 11, 1),
            (p.early, 13, 1),
            (p.known, 7, 1),
            (p.end, 0, DGS_ALIGN),
        ];
        let mut end = 100;
        for (start, len, align) in parts {
            assert!(start >= end && start % align == 0, "{start} {end} {align}");
            end = start + len;
        }
    }

    #[test]
    fn what_no_address_space_holds_has_no_places() {
        for sizes in [
            DgsSizes { symbols: usize::MAX, ..DgsSizes::default() },
            DgsSizes { manifest: isize::MAX as usize, ..DgsSizes::default() },
            DgsSizes { early: usize::MAX / 2, parity: usize::MAX / 2, ..DgsSizes::default() },
        ] {
            assert_eq!(Places::of(&sizes, 64), None);
        }
    }
}
