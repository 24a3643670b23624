//! Packets whose values somebody else decodes: a host that takes several at once.
//!
//! [`Receiver::plan`] does for a packet what comes before its values, [`Receiver::commit`] what comes
//! after. Between them any number of packets may be planned, decoded and committed in any order.
//! Whatever is not plain sailing (a refusal, parity, a packet that came twice, one that repair gave
//! back meanwhile) is left to [`Receiver::media`] in the packet's turn, so that committing packets
//! one after the other is in every respect the same as giving them to `media`.

use super::{
    Arrival, Memory, Receiver,
    payload::{Place, for_each_slice, overlap},
};
use crate::{
    closure::Arrived,
    error::{Error, ErrorKind, Result},
    limits::MAX_PACKET_BYTES,
    rans::{form::Form, lanes::Run, table::SLOTS},
    wire::{
        bits::Bits,
        crc::checked,
        manifest::{Manifest, Profile},
        packet::{Extent, Packet, Slices},
    },
};

/// A `dgs1` packet that is in order up to its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned<'p> {
    packet: &'p [u8],
    slices: Slices<'p>,
    /// Its body of four rANS lanes.
    pub body: &'p [u8],
    /// Values in the body.
    pub values: usize,
}

impl Receiver<'_> {
    /// Slots and raw bits of the stream's entropy tables, for a decoder of the host's. `None` before
    /// the manifest, in profile `paper`, and where memory is so short that tables are compact.
    pub fn tables(&self) -> Option<(&[[u32; SLOTS]], &[u8])> {
        let manifest = self.manifest.filter(|m| m.profile() == Profile::Dgs1)?;
        let count = usize::from(manifest.head().tables);
        let slots = self.memory.slots.as_chunks::<SLOTS>().0.get(..count)?;
        (self.form == Form::Slots).then_some((slots, self.raw_bits.get(..count)?))
    }

    /// Checks `packet` up to its values and calls `run` with every run of them, in order. `None`, after
    /// any number of runs, if its values are not for others to decode: then [`Receiver::media`] says
    /// what the packet is.
    pub fn plan<'p>(&self, packet: &'p [u8], mut run: impl FnMut(Run)) -> Option<Planned<'p>> {
        let manifest = self.manifest.filter(|m| m.profile() == Profile::Dgs1)?;
        let content = checked("packet.crc", packet, self.crc).ok()?;
        let Ok(Packet::Slices(slices)) = Packet::parse(content) else { return None };
        if packet.len() > MAX_PACKET_BYTES
            || slices.id.get() >= manifest.head().packets
            || self.has(slices.id)
        {
            return None;
        }
        let (body, values) = self.survey(&manifest, &slices, &mut run).ok()?;
        Some(Planned { packet, slices, body, values })
    }

    /// The body of `packet` and its number of values, if all of them have a place that is free.
    ///
    /// Apart from the scalar decoder's first pass, which says the same: what a host needs beyond it
    /// would weigh on the stack of a microcontroller.
    fn survey<'p>(
        &self,
        manifest: &Manifest<'_>,
        packet: &Slices<'p>,
        run: &mut impl FnMut(Run),
    ) -> Result<(&'p [u8], usize)> {
        let Memory { cells, blocks, .. } = &self.memory;
        let (mut table_indices, mut values) = (Bits::new(packet.body), 0);
        for (i, extent) in packet.extents.iter().enumerate() {
            let twice = packet.extents.iter().take(i).any(|earlier| overlap(earlier, extent));
            for_each_slice(manifest, cells, extent, i, |place| {
                if twice || is_taken(blocks, &place, extent) {
                    return Err(taken(i));
                }
                place.shape.runs(extent.level, place.blocks, |stream, len| {
                    let table_set = self.table_sets.get(stream).copied().unwrap_or_default();
                    run(Run { table: table_set.select(&mut table_indices)?, len });
                    values += len;
                    Ok(())
                })
            })?;
        }
        Ok((table_indices.finish()?, values))
    }

    /// Copies the decoded `values` of `packet` to their places and records its arrival, the scalar
    /// decoder's own way to which is apart for the reason that [`Self::survey`] gives.
    ///
    /// # Errors
    /// If a place is taken, or there are more or fewer values than places; then nothing is recorded.
    fn place(&mut self, manifest: &Manifest<'_>, packet: &Slices<'_>, values: &[i16]) -> Result<()> {
        let Memory { cells, symbols, blocks, .. } = &mut self.memory;
        let mut rest = values;
        for (i, extent) in packet.extents.iter().enumerate() {
            for_each_slice(manifest, cells, extent, i, |place| {
                let target = symbols.get_mut(place.symbols.clone()).ok_or(taken(i))?;
                let (run, tail) = rest.split_at_checked(target.len()).ok_or(taken(i))?;
                if is_taken(blocks, &place, extent) {
                    return Err(taken(i));
                }
                target.copy_from_slice(run);
                rest = tail;
                Ok(())
            })?;
        }
        if !rest.is_empty() {
            return Err(taken(packet.extents.len()));
        }
        for (i, extent) in packet.extents.iter().enumerate() {
            for_each_slice(manifest, cells, extent, i, |place| {
                for mask in blocks.get_mut(place.masks).unwrap_or(&mut []) {
                    *mask = Arrived(*mask).with(extent.level).0;
                }
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Takes a packet that this receiver has planned; `values` are those of its body, or `None` if the
    /// body is not whole.
    ///
    /// # Errors
    /// As [`Receiver::media`].
    pub fn commit(&mut self, planned: &Planned<'_>, values: Option<&[i16]>) -> Result<Arrival> {
        let Planned { packet, slices, .. } = planned;
        let id = slices.id;
        let placed = match (self.manifest, values) {
            (Some(manifest), Some(values)) if values.len() == planned.values && !self.has(id) => {
                self.place(&manifest, slices, values).ok().map(|()| manifest)
            }
            _ => None,
        };
        let Some(manifest) = placed else { return self.media(packet) };
        self.counters.media += 1;
        self.mark(id);
        Ok(Arrival::Accepted { id, recovered: self.take_member(&manifest, id, packet) })
    }
}

/// Whether one of the blocks of `place` has its level already.
fn is_taken(blocks: &[u8], place: &Place, extent: &Extent) -> bool {
    let masks = blocks.get(place.masks.clone()).unwrap_or(&[]);
    masks.iter().any(|&mask| Arrived(mask).has(extent.level))
}

/// Seen by nobody: `media` finds out anew what is wrong.
fn taken(extent: usize) -> Error {
    Error::illegal("slice", extent, 0, (0, 0)).kind(ErrorKind::Duplicate)
}
