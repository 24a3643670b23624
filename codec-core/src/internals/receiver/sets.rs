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

/// The first range for which `place_in` knows the packet, its set, and the place in that.
pub(super) fn find(
    manifest: &Manifest<'_>,
    place_in: impl Fn(&Repair) -> Option<(u32, u32)>,
) -> Option<(Set, u32)> {
    let mut before = 0usize;
    for repair in manifest.repairs() {
        if let Some((number, place)) = place_in(&repair) {
            let start = before.saturating_add((number as usize).saturating_mul(repair.set_bytes()));
            return Some((Set { repair, number, start }, place));
        }
        before = before.saturating_add(range_bytes(&repair));
    }
    None
}
