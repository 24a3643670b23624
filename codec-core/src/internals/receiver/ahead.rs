//! Takes packets whose values somebody else decodes: a host that takes several at once.
//!
//! [`Receiver::plan`] does for a packet what comes before its values, [`Receiver::commit`] what comes
//! after. Between them any number of packets may be planned, decoded and committed in any order.
//! Whatever is out of the ordinary (a refusal, parity, a packet that came twice, one that repair gave
//! back meanwhile) is left to [`Receiver::push`] in the packet's turn, so that committing packets one
//! after the other is in every respect the same as giving them to `push`.

use super::{Receiver, answer::Accepted, payload::Survey};
use crate::{
    error::Result,
    rans::{form::Form, lanes::TableRun, table::SLOTS},
    wire::{checked::Checked, manifest::Profile, packet::Packet},
};

/// A `dgs1` packet that is in order up to its values.
#[derive(Clone, Debug, PartialEq)]
pub struct Planned<'p> {
    packet: Checked<'p>,
    /// Its body of four rANS lanes.
    pub body: &'p [u8],
    /// Values in the body.
    pub values: usize,
}

impl Receiver<'_> {
    /// Slots and raw bits of the stream's entropy tables, for a decoder of the host's. `None` in
    /// profile `paper`, and where memory is so short that tables are compact.
    pub fn tables(&self) -> Option<(&[[u32; SLOTS]], &[u8])> {
        if self.manifest.profile() != Profile::Dgs1 || self.form != Form::Slots {
            return None;
        }
        let count = usize::from(self.manifest.head().tables);
        let slots = self.memory.slots.as_chunks::<SLOTS>().0.get(..count)?;
        Some((slots, self.raw_bits.get(..count)?))
    }

    /// Checks `packet` up to its values and calls `run` with every run of them, in order; there are at
    /// most as many as [`Caps`](crate::Caps) allow values.
    ///
    /// # Errors
    /// The packet itself, after any number of runs, if its values are not for others to decode: then
    /// [`Receiver::push`] says what the packet is.
    #[expect(clippy::result_large_err, reason = "a packet that is not planned is not lost")]
    pub fn plan<'p>(
        &mut self,
        packet: Checked<'p>,
        run: impl FnMut(TableRun),
    ) -> core::result::Result<Planned<'p>, Checked<'p>> {
        let surveyed = match packet.packet() {
            Packet::Slices(slices)
                if self.manifest.profile() == Profile::Dgs1
                    && slices.id.get() < self.manifest.head().packets
                    && !self.has(slices.id) =>
            {
                // The error is that of `push`, in the packet's turn.
                self.survey(slices, run).ok()
            }
            _ => None,
        };
        match surveyed {
            Some(Survey { body, values, .. }) => Ok(Planned { packet, body, values }),
            None => Err(packet),
        }
    }

    /// Takes a packet that this receiver has planned; `values` are those of its body, or `None` if the
    /// body is not whole.
    ///
    /// # Errors
    /// As [`Receiver::push`].
    pub fn commit(&mut self, planned: &Planned<'_>, values: Option<&[i16]>) -> Result<Accepted> {
        let packet = &planned.packet;
        let id = packet.id();
        let placed = match (packet.packet(), values) {
            (Packet::Slices(slices), Some(values)) if values.len() == planned.values && !self.has(id) => {
                self.place(slices, values).is_ok()
            }
            _ => false,
        };
        if !placed {
            return self.push(packet);
        }
        Ok(Accepted { id, recovered: self.take_media(packet)? })
    }
}
