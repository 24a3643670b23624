//! The receiver's side of repair: which set a packet belongs to, and what its arrival gives back.
//!
//! Work per packet is bounded: at most eight sums are updated, and at most eight packets come out,
//! each a sum of at most eight rows that is then checked like any packet. Where the sums lie is found by
//! one walk over the repair ranges before, once the packet is accepted.

use super::{
    Receiver,
    answer::Recovered,
    sets::{Place, Set},
};
use crate::{
    cursor::in_range,
    error::{Error, ErrorKind, Result},
    ids::PacketId,
    repair::{MAX_CODED_BYTES, Sums},
    wire::{
        checked::Checked,
        manifest::Manifest,
        packet::{KIND_CHUNK, KIND_PARITY, KIND_SLICES, Packet, Parity},
    },
};

/// Parity packet `id` is of no repair range: allowed is what the last range that begins before it has. Before
/// all of them media is due.
#[cold]
fn no_set(manifest: &Manifest<'_>, id: u32) -> Error {
    let error = match manifest.repair_at(id, |repair| repair.first_parity) {
        Some((_, repair)) => {
            let first = u64::from(repair.first_parity);
            let last = (first + repair.parity_packets()).saturating_sub(1);
            Error::illegal("parity.id", 1, id.into(), (first, last))
        }
        None => {
            let media = (KIND_CHUNK.into(), KIND_SLICES.into());
            Error::illegal("packet.kind", 0, KIND_PARITY.into(), media)
        }
    };
    error.kind(ErrorKind::Contradiction)
}

impl Receiver<'_> {
    /// A parity packet that has not been seen.
    pub(super) fn take_parity(&mut self, parity: &Parity<'_>) -> Result<Recovered> {
        let id = parity.id.get();
        let place = Place::of_parity(&self.manifest, id).ok_or_else(|| no_set(&self.manifest, id))?;
        let longest = u64::from(place.repair.longest);
        in_range("parity.content", 6, parity.content.len() as u64, 1, longest)
            .map_err(|e| e.kind(ErrorKind::Contradiction))?;
        self.mark(parity.id)?;
        self.counters.parity += 1;
        let set = place.set(&self.manifest);
        if let Some(mut sums) = self.sums(&set)? {
            sums.add_parity(place.inside, parity.length, parity.content);
        }
        self.recover(&set)
    }

    /// Media packet `id`, whole, that has been decoded.
    pub(super) fn take_member(&mut self, id: PacketId, packet: &[u8]) -> Result<Recovered> {
        let Some(place) = Place::of_member(&self.manifest, id.get()) else {
            return Ok(Recovered::default());
        };
        let set = place.set(&self.manifest);
        if let Some(mut sums) = self.sums(&set)? {
            sums.add(place.inside, packet);
        }
        self.recover(&set)
    }

    /// The set's sums, unless the caller's memory ends before them.
    fn sums(&mut self, set: &Set) -> Result<Option<Sums<'_>>> {
        let range = set.start..set.start.saturating_add(set.repair.set_bytes());
        let Some(bytes) = self.memory.parity.get_mut(range) else { return Ok(None) };
        let sums = Sums::over(bytes, set.repair.parity.into(), set.repair.longest.into());
        let rows = u64::from(set.repair.parity);
        let sums = sums.ok_or_else(|| Error::illegal("repair.parity", 0, rows, (1, rows)))?;
        Ok(Some(sums.with_combine(self.combine)))
    }

    /// Decodes the missing packets of a set, if it has parity for all of them.
    fn recover(&mut self, set: &Set) -> Result<Recovered> {
        let mut recovered = Recovered::default();
        let members = set.repair.members(set.number);
        let Some(solution) = self.sums(set)?.and_then(|sums| sums.solution(members)) else {
            return Ok(recovered);
        };
        let mut coded = [0u8; MAX_CODED_BYTES];
        for ((index, position), place) in solution.positions().enumerate().zip(&mut recovered.ids) {
            let member = set.repair.member(set.number, position);
            let past = Error::illegal("repair.packets", 0, member.into(), (0, PacketId::MAX.into()));
            let expected = PacketId::new(member).ok_or(past)?;
            // Known all the same: it is longer than its range says, so that it is in no sum.
            if self.has(expected) {
                continue;
            }
            let packet = self.sums(set)?.and_then(|sums| sums.recover(&solution, index, &mut coded));
            let Some(packet) = packet.filter(|packet| self.decode_as(packet, expected).is_ok()) else {
                // Counted; why it is no packet concerns nobody.
                self.counters.repair_failed += 1;
                continue;
            };
            self.mark(expected)?;
            self.counters.recovered += 1;
            *place = Some(expected);
            if let Some(mut sums) = self.sums(set)? {
                sums.add(position, packet);
            }
        }
        Ok(recovered)
    }

    /// Checks and decodes `packet` if it is media packet `expected`.
    fn decode_as(&mut self, packet: &[u8], expected: PacketId) -> Result<()> {
        let checked = Checked::new(packet, self.crc)?;
        in_range("packet.id", 1, checked.id().get(), expected.get(), expected.get())?;
        match checked.packet() {
            Packet::Slices(slices) => self.decode_slices(slices),
            Packet::Chunk(chunk) => self.decode_chunk(chunk),
            Packet::Parity(_) => Err(Error::illegal("packet.kind", 0, 6, (4, 5))),
        }
    }
}
