//! Finds the repair set of a packet, and where the sums of a set lie in memory.
//!
//! Offsets saturate where they exceed an address space: no memory reaches there, and what has no memory is
//! not repaired.

use crate::wire::manifest::{Manifest, Repair};

/// A set of a repair range, and where its sums lie in the caller's memory.
pub(super) struct Set {
    pub repair: Repair,
    /// Counts the sets of the range.
    pub number: u32,
    /// First byte of its sums.
    pub start: usize,
}

/// Bytes that the sums of all sets take, one set after the other; saturates.
pub(super) fn memory_bytes(manifest: &Manifest<'_>) -> usize {
    manifest.repairs().fold(0, |sum, r| sum.saturating_add(range_bytes(&r)))
}

fn range_bytes(repair: &Repair) -> usize {
    (repair.sets() as usize).saturating_mul(repair.set_bytes())
}

/// Where a packet stands in the repair of its stream: found by bisection of the ranges.
pub(super) struct Place {
    pub repair: Repair,
    /// Counts the ranges of the stream.
    range: usize,
    /// Counts the sets of the range.
    set: u32,
    /// Position in the set of a protected packet, row of a parity packet.
    pub inside: u32,
}

impl Place {
    /// That of media packet `id`, if a range protects it.
    pub fn of_member(manifest: &Manifest<'_>, id: u32) -> Option<Self> {
        Self::of(manifest.repair_at(id, |repair| repair.first_packet), |repair| repair.set_of(id))
    }

    /// That of parity packet `id`, if it is of a range.
    pub fn of_parity(manifest: &Manifest<'_>, id: u32) -> Option<Self> {
        Self::of(manifest.repair_at(id, |repair| repair.first_parity), |repair| repair.row_of(id))
    }

    fn of(found: Option<(usize, Repair)>, place_in: impl Fn(&Repair) -> Option<(u32, u32)>) -> Option<Self> {
        let (range, repair) = found?;
        let (set, inside) = place_in(&repair)?;
        Some(Self { repair, range, set, inside })
    }

    /// The set: walks over the ranges before, which a packet that is refused must not cost.
    pub fn set(&self, manifest: &Manifest<'_>) -> Set {
        let before = manifest.repairs().take(self.range);
        let before = before.fold(0usize, |sum, r| sum.saturating_add(range_bytes(&r)));
        let start = before.saturating_add((self.set as usize).saturating_mul(self.repair.set_bytes()));
        Set { repair: self.repair, number: self.set, start }
    }
}
