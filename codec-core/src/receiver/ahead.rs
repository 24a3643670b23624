//! Packets whose values somebody else decodes: a host that takes several at once.
//!
//! [`Receiver::plan`] does for a packet what comes before its values, [`Receiver::commit`] what comes
//! after. Between them any number of packets may be planned, decoded and committed in any order.
//! Whatever is not plain sailing (a refusal, parity, a packet that came twice, one that repair gave
//! back meanwhile) is left to [`Receiver::media`] in the packet's turn, so that committing packets
//! one after the other is in every respect the same as giving them to `media`.

use super::{Arrival, Receiver, payload::Survey};
use crate::{
    error::Result,
    limits::MAX_PACKET_BYTES,
    rans::{form::Form, lanes::Run, table::SLOTS},
    wire::{
        crc::checked,
        manifest::Profile,
        packet::{Packet, Slices},
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
        let survey = self.survey(&manifest, &slices, |table, len| run(Run { table, len }));
        let Survey { body, values, .. } = survey.ok()?;
        Some(Planned { packet, slices, body, values })
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
                self.place(&manifest, slices, values).then_some(manifest)
            }
            _ => None,
        };
        let Some(manifest) = placed else { return self.media(packet) };
        self.counters.media += 1;
        self.mark(id);
        Ok(Arrival::Accepted { id, recovered: self.take_member(&manifest, id, packet) })
    }
}
