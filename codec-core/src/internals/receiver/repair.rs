//! The receiver's side of repair: which set a packet belongs to, and what its arrival gives back.
//!
//! Work per packet is bounded: at most eight sums are updated, and at most eight packets come out,
//! each a sum of at most eight rows that is then checked like any packet.

use super::Receiver;
use crate::{
    cursor::in_range,
    error::{Error, ErrorKind, Result},
    ids::PacketId,
    limits::MAX_REPAIR_PARITY,
    repair::{MAX_CODED_BYTES, Sums},
    wire::{
        checked::Checked,
        manifest::{Manifest, Repair},
        packet::Parity,
    },
};

/// The packets that one arrival made known, ascending.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Recovered {
    ids: [PacketId; MAX_REPAIR_PARITY],
    count: usize,
}

impl Recovered {
    /// The packets.
    pub fn as_slice(&self) -> &[PacketId] {
        self.ids.split_at(self.count.min(self.ids.len())).0
    }

    fn push(&mut self, id: PacketId) {
        if let Some(slot) = self.ids.get_mut(self.count) {
            *slot = id;
            self.count += 1;
        }
    }
}

/// A set of a repair range, and where its sums lie in the caller's memory.
struct Set {
    repair: Repair,
    number: u32,
    start: usize,
}

/// Bytes that the sums of all sets take, one set after the other.
pub(super) fn memory_bytes(manifest: &Manifest<'_>) -> usize {
    manifest.repairs().fold(0, |sum, r| sum.saturating_add(range_bytes(&r)))
}

fn range_bytes(repair: &Repair) -> usize {
    (repair.sets() as usize).saturating_mul(repair.set_bytes())
}

/// The first range for which `place_in` knows the packet, its set, and the place in that.
fn find(manifest: &Manifest<'_>, place_in: impl Fn(&Repair) -> Option<(u32, u32)>) -> Option<(Set, u32)> {
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

impl Receiver<'_> {
    /// A parity packet that has not been seen.
    pub(super) fn take_parity(&mut self, manifest: &Manifest<'_>, parity: &Parity<'_>) -> Result<Recovered> {
        let id = parity.id.get();
        let Some((set, row)) = find(manifest, |r| r.row_of(id)) else {
            let last = u64::from(manifest.head().packets.saturating_sub(1));
            return Err(Error::illegal("parity.id", 1, id.into(), (0, last)).kind(ErrorKind::Contradiction));
        };
        let longest = u64::from(set.repair.longest);
        in_range("parity.content", 6, parity.content.len() as u64, 1, longest)
            .map_err(|e| e.kind(ErrorKind::Contradiction))?;
        self.counters.parity += 1;
        self.mark(parity.id);
        if let Some(mut sums) = self.sums(&set) {
            sums.add_parity(row, parity.length, parity.content);
        }
        Ok(self.recover(manifest, &set))
    }

    /// Media packet `id`, whole, that has been decoded.
    pub(super) fn take_member(&mut self, manifest: &Manifest<'_>, id: PacketId, packet: &[u8]) -> Recovered {
        let Some((set, position)) = find(manifest, |r| r.set_of(id.get())) else {
            return Recovered::default();
        };
        if let Some(mut sums) = self.sums(&set) {
            sums.add(position, packet);
        }
        self.recover(manifest, &set)
    }

    /// The set's sums, unless the caller's memory ends before them.
    fn sums(&mut self, set: &Set) -> Option<Sums<'_>> {
        let end = set.start.checked_add(set.repair.set_bytes())?;
        let bytes = self.memory.parity.get_mut(set.start..end)?;
        let sums = Sums::over(bytes, set.repair.parity.into(), set.repair.longest.into())?;
        Some(sums.with_combine(self.combine))
    }

    /// Decodes the missing packets of a set, if it has parity for all of them.
    fn recover(&mut self, manifest: &Manifest<'_>, set: &Set) -> Recovered {
        let mut recovered = Recovered::default();
        let members = set.repair.members(set.number);
        let Some(solution) = self.sums(set).and_then(|sums| sums.solution(members)) else {
            return recovered;
        };
        let mut coded = [0u8; MAX_CODED_BYTES];
        for (index, position) in solution.positions().enumerate() {
            let Some(expected) = PacketId::new(set.repair.member(set.number, position)) else { continue };
            // Known all the same: it is longer than its range says, so that it is in no sum.
            if self.has(expected) {
                continue;
            }
            let packet = self.sums(set).and_then(|sums| sums.recover(&solution, index, &mut coded));
            let Some(packet) = packet.filter(|packet| self.decode_as(manifest, packet, expected).is_ok())
            else {
                self.counters.repair_failed += 1;
                continue;
            };
            self.mark(expected);
            self.counters.recovered += 1;
            recovered.push(expected);
            if let Some(mut sums) = self.sums(set) {
                sums.add(position, packet);
            }
        }
        recovered
    }

    /// Checks and decodes `packet` if it is media packet `expected`.
    fn decode_as(&mut self, manifest: &Manifest<'_>, packet: &[u8], expected: PacketId) -> Result<()> {
        let checked = Checked::new(packet, self.crc)?;
        in_range("packet.id", 1, checked.id().get(), expected.get(), expected.get())?;
        self.decode(manifest, checked.packet())
    }
}
