//! Decodes a packet's payload into the symbol store: what is checked before a symbol is decoded, and
//! what is recorded once the coder ended as it should.

use super::{
    Memory, Receiver,
    walk::{Places, Sink, Slice},
};
use crate::{
    closure::Arrived,
    error::{Error, ErrorKind, Result},
    rans::{
        form::Form,
        lanes::{self, TableRun},
    },
    wire::{
        bits::Bits,
        manifest::{Manifest, Profile, stream},
        packet::Slices,
    },
};

/// What a packet's body holds, known before a value is decoded.
pub(super) struct Survey<'p> {
    /// The four lanes, behind the table indices.
    pub body: &'p [u8],
    pub values: usize,
    pub raw_bits: usize,
}

impl Receiver<'_> {
    /// Refuses a packet that is not of `wanted`, the profile of its kind.
    pub(super) fn check_profile(&self, wanted: Profile) -> Result<()> {
        let found = self.manifest.profile();
        if wanted == found {
            return Ok(());
        }
        let allowed = (found as u64, found as u64);
        Err(Error::illegal("packet.profile", 0, wanted as u64, allowed).kind(ErrorKind::Contradiction))
    }

    /// Decodes `packet` to its place and records its arrival.
    ///
    /// # Errors
    /// Why it is refused; then no arrival is recorded.
    pub(super) fn decode_slices(&mut self, packet: &Slices<'_>) -> Result<()> {
        self.check_profile(Profile::Dgs1)?;
        let survey = self.survey(packet, |_| ())?;
        let decoder = lanes::Decoder::new(survey.body, survey.values, survey.raw_bits)?;
        let (manifest, raw_bits, form) = (&self.manifest, &self.raw_bits, self.form);
        let Memory { cells, symbols, blocks, slots, .. } = &mut self.memory;
        let mut places = Places { manifest: &self.manifest, cells, symbols, blocks, caps: &self.caps };
        let indices = Bits::new(packet.body);
        let mut decode = DecodeInPlace { indices, manifest, raw_bits, form, slots, decoder };
        places.walk(packet, &mut decode)?;
        decode.decoder.finish()?;
        places.walk(packet, &mut RecordArrival)
    }

    /// What `packet` holds, if all of it has a place that is free. Table indices come first in a body,
    /// so that the size of everything behind them is known. `run` is called with every run of
    /// symbols, in order.
    ///
    /// # Errors
    /// Why the packet is refused, after any number of runs.
    pub(super) fn survey<'p>(
        &mut self,
        packet: &Slices<'p>,
        run: impl FnMut(TableRun),
    ) -> Result<Survey<'p>> {
        let Memory { cells, symbols, blocks, .. } = &mut self.memory;
        let mut places = Places { manifest: &self.manifest, cells, symbols, blocks, caps: &self.caps };
        let mut ahead = LookAhead {
            indices: Bits::new(packet.body),
            manifest: &self.manifest,
            raw_bits_of: &self.raw_bits,
            values: 0,
            raw_bits: 0,
            run,
        };
        places.walk(packet, &mut ahead)?;
        let LookAhead { indices, values, raw_bits, .. } = ahead;
        Ok(Survey { body: indices.finish()?, values, raw_bits })
    }

    /// Copies `values` to the places of `packet` and records its arrival.
    ///
    /// # Errors
    /// If a place is taken, or there are more or fewer values than places; then nothing is recorded.
    pub(super) fn place(&mut self, packet: &Slices<'_>, values: &[i16]) -> Result<()> {
        let Memory { cells, symbols, blocks, .. } = &mut self.memory;
        let mut places = Places { manifest: &self.manifest, cells, symbols, blocks, caps: &self.caps };
        let mut copy = CopyValues { rest: values };
        places.walk(packet, &mut copy)?;
        if !copy.rest.is_empty() {
            return Err(Error::illegal("body.values", 0, copy.rest.len() as u64, (0, 0)));
        }
        places.walk(packet, &mut RecordArrival)
    }
}

/// The table that the next index of `stream` names.
fn next_table(manifest: &Manifest<'_>, stream: usize, indices: &mut Bits<'_>) -> Result<u8> {
    let missing = Error::illegal("slice.table", 0, stream as u64, (0, stream::COUNT as u64 - 1));
    manifest.table_set(stream).ok_or(missing.kind(ErrorKind::Contradiction))?.select(indices)
}

fn no_table(index: u8) -> Error {
    Error::illegal("slice.table", 0, index.into(), (0, 0)).kind(ErrorKind::Contradiction)
}

/// Counts values and raw bits, and refuses what has arrived.
struct LookAhead<'r, 'p, F> {
    indices: Bits<'p>,
    manifest: &'r Manifest<'r>,
    raw_bits_of: &'r [u8],
    values: usize,
    raw_bits: usize,
    run: F,
}

impl<F: FnMut(TableRun)> Sink for LookAhead<'_, '_, F> {
    fn take(&mut self, slice: Slice<'_>) -> Result<()> {
        slice.check_free()?;
        slice.shape.runs(slice.level, slice.blocks, |stream, len| {
            let table = next_table(self.manifest, stream, &mut self.indices)?;
            let bits = *self.raw_bits_of.get(usize::from(table)).ok_or(no_table(table))?;
            self.values += len;
            self.raw_bits += len * usize::from(bits);
            (self.run)(TableRun { table, len });
            Ok(())
        })
    }
}

/// Decodes values straight to their places.
struct DecodeInPlace<'r, 'p> {
    indices: Bits<'p>,
    manifest: &'r Manifest<'r>,
    raw_bits: &'r [u8],
    form: Form,
    slots: &'r [u32],
    decoder: lanes::Decoder<'p>,
}

impl Sink for DecodeInPlace<'_, '_> {
    fn take(&mut self, slice: Slice<'_>) -> Result<()> {
        let mut rest = slice.symbols;
        slice.shape.runs(slice.level, slice.blocks, |stream, len| {
            let index = next_table(self.manifest, stream, &mut self.indices)?;
            let table = self.form.table(self.slots, index.into());
            let raw_bits = self.raw_bits.get(usize::from(index));
            let (table, &raw_bits) = table.zip(raw_bits).ok_or(no_table(index))?;
            let room = rest.len();
            let halves = core::mem::take(&mut rest).split_at_mut_checked(len);
            let too_small = Error::short("memory.symbols", 0, room, len).kind(ErrorKind::Capacity);
            let (run, tail) = halves.ok_or(too_small)?;
            rest = tail;
            table.run(&mut self.decoder, raw_bits, run)
        })
    }
}

/// Copies values that somebody else decoded.
struct CopyValues<'v> {
    rest: &'v [i16],
}

impl Sink for CopyValues<'_> {
    fn take(&mut self, slice: Slice<'_>) -> Result<()> {
        slice.check_free()?;
        let wanted = slice.symbols.len();
        let too_small = Error::short("body.values", 0, self.rest.len(), wanted);
        let (values, tail) = self.rest.split_at_checked(wanted).ok_or(too_small)?;
        slice.symbols.copy_from_slice(values);
        self.rest = tail;
        Ok(())
    }
}

/// Marks the level of each block as arrived.
struct RecordArrival;

impl Sink for RecordArrival {
    fn take(&mut self, slice: Slice<'_>) -> Result<()> {
        for mask in slice.masks {
            *mask = Arrived(*mask).with(slice.level).0;
        }
        Ok(())
    }
}
