//! Receives the packets of one stream: bytes in, usable state out. No socket, no clock, no heap.
//!
//! All memory is the caller's ([`Memory`]), cut from one arena by [`Plan`](crate::arena::Plan);
//! [`Requirements`] says from a manifest how much of each is needed. Every packet is checked (CRC, header,
//! lattice, entropy coder's end state) before its arrival is recorded, decodes straight to its place in the
//! symbol store, and is used at most once; order does not matter. What is refused is counted by kind and
//! costs bounded work.

mod ahead;
mod answer;
mod chunk;
mod memory;
mod payload;
mod repair;
mod sets;
mod walk;

pub use ahead::Planned;
pub use answer::{Accepted, Counters, Recovered};
pub use memory::{Cell, Content, Memory, Requirements, for_each_cell};

use crate::{
    caps::Caps,
    closure,
    error::{Error, ErrorKind, Result},
    ids::PacketId,
    limits,
    rans::form::Form,
    repair::{Combine, combine},
    wire::{
        checked::Checked,
        crc::{Crc32, crc32},
        manifest::Manifest,
        packet::Packet,
    },
};

/// A sans-I/O receiver over caller-owned memory.
#[derive(Debug)]
pub struct Receiver<'a> {
    memory: Memory<'a>,
    manifest: Manifest<'a>,
    crc: Crc32,
    combine: Combine,
    counters: Counters,
    caps: Caps,
    /// Raw bits per value of each entropy table.
    raw_bits: [u8; limits::MAX_TABLES],
    /// How entropy tables lie in memory.
    form: Form,
}

impl<'a> Receiver<'a> {
    /// A receiver of the stream of `manifest`, which stays within `caps`; `memory` is as large as
    /// [`Requirements::of`] both says.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] naming the memory that is smaller.
    pub fn new(memory: Memory<'a>, manifest: Manifest<'a>, caps: Caps) -> Result<Self> {
        let mut receiver = Self {
            memory,
            manifest,
            crc: crc32,
            combine,
            counters: Counters::default(),
            caps,
            raw_bits: [0; limits::MAX_TABLES],
            form: Form::Slots,
        };
        receiver.initialise()?;
        Ok(receiver)
    }

    /// Takes faster arithmetic of the host's: CRC-32/ISO-HDLC and sums of repair.
    pub const fn set_arithmetic(&mut self, crc: Crc32, combine: Combine) {
        (self.crc, self.combine) = (crc, combine);
    }

    /// Goes on counting from `counters`.
    pub(crate) const fn count_from(&mut self, counters: Counters) {
        self.counters = counters;
    }

    /// The manifest.
    pub const fn manifest(&self) -> &Manifest<'a> {
        &self.manifest
    }

    /// What happened so far.
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// What has been decoded so far.
    pub const fn content(&self) -> Content<'_> {
        Content {
            manifest: &self.manifest,
            cells: self.memory.cells,
            symbols: self.memory.symbols,
            blocks: self.memory.blocks,
        }
    }

    /// Whether packet `id` has been accepted or recovered.
    pub fn has(&self, id: PacketId) -> bool {
        // What is past the stream's last packet has not come.
        self.memory.seen.get(id.index() / 32).is_some_and(|word| word >> (id.get() % 32) & 1 == 1)
    }

    fn initialise(&mut self) -> Result<()> {
        let manifest = &self.manifest;
        let Memory { cells, symbols, blocks, seen, slots, progress, parity } = &mut self.memory;
        symbols.fill(0);
        seen.fill(0);
        progress.fill(0);
        parity.iter_mut().take(sets::memory_bytes(manifest)).for_each(|byte| *byte = 0);
        let (have, need) = (cells.len(), manifest.cells() + 1);
        let (block_room, mut next, mut targets) = (blocks.len(), Cell::default(), cells.iter_mut());
        let mut begin = |cell| {
            let target = targets.next().ok_or_else(|| Error::too_small("memory.cells", have, need))?;
            *target = cell;
            Ok(())
        };
        for_each_cell(manifest, |_, _, shape| {
            begin(next)?;
            let first = next.blocks as usize;
            next.symbols += shape.len() as u32;
            next.blocks += shape.blocks() as u32;
            let masks = blocks.get_mut(first..next.blocks as usize);
            masks
                .ok_or_else(|| Error::too_small("memory.blocks", block_room, next.blocks as usize))?
                .fill(closure::initial(&shape).0);
            Ok(())
        })?;
        begin(next)?;
        for (field, have, need) in [
            ("memory.symbols", symbols.len(), next.symbols as usize),
            ("memory.seen", seen.len(), (manifest.head().packets as usize).div_ceil(32)),
        ] {
            if have < need {
                return Err(Error::too_small(field, have, need));
            }
        }
        let (tables, room) = (usize::from(manifest.head().tables), slots.len());
        let no_room = || Error::too_small("memory.slots", room, tables * Form::Compact.words());
        self.form = Form::that_fits(tables, room).ok_or_else(no_room)?;
        for ((index, table), raw_bits) in manifest.tables().enumerate().zip(&mut self.raw_bits) {
            let table = table?;
            self.form.fill(slots, index, &table).ok_or_else(no_room)?;
            *raw_bits = table.raw_bits();
        }
        Ok(())
    }

    /// Takes one media or parity packet as bytes.
    ///
    /// # Errors
    /// Why the packet is refused; the receiver is as it was, but for its counters.
    pub fn media(&mut self, packet: &[u8]) -> Result<Accepted> {
        match Checked::new(packet, self.crc) {
            Ok(packet) => self.push(&packet),
            Err(error) => Err(self.refuse(error)),
        }
    }

    /// Takes one media or parity packet that has been checked.
    ///
    /// # Errors
    /// Why the packet is refused; the receiver is as it was, but for its counters.
    pub fn push(&mut self, packet: &Checked<'_>) -> Result<Accepted> {
        self.take(packet).map_err(|error| self.refuse(error))
    }

    /// Counts a packet that was refused for `error`, here or where it was checked, and gives the error
    /// back.
    pub fn refuse(&mut self, error: Error) -> Error {
        self.counters.refuse(&error);
        error
    }

    /// The CRC that this receiver checks by.
    pub const fn crc(&self) -> Crc32 {
        self.crc
    }

    fn take(&mut self, packet: &Checked<'_>) -> Result<Accepted> {
        let (id, packets) = (packet.id(), self.manifest.head().packets);
        if id.get() >= packets {
            let last = u64::from(packets).saturating_sub(1);
            return Err(
                Error::illegal("packet.id", 1, id.get().into(), (0, last)).kind(ErrorKind::Contradiction)
            );
        }
        if self.has(id) {
            let seen = u64::from(id.get());
            return Err(Error::illegal("packet.id", 1, seen, (seen, seen)).kind(ErrorKind::Duplicate));
        }
        let recovered = match packet.packet() {
            Packet::Parity(parity) => self.take_parity(parity)?,
            Packet::Slices(slices) => {
                self.decode_slices(slices)?;
                self.take_media(packet)?
            }
            Packet::Chunk(chunk) => {
                self.decode_chunk(chunk)?;
                self.take_media(packet)?
            }
        };
        Ok(Accepted { id, recovered })
    }

    /// Counts a media packet that has been decoded; what its arrival gives back.
    fn take_media(&mut self, packet: &Checked<'_>) -> Result<Recovered> {
        self.mark(packet.id())?;
        self.counters.media += 1;
        self.take_member(packet.id(), packet.bytes())
    }

    /// Notes packet `id` as accepted or recovered.
    fn mark(&mut self, id: PacketId) -> Result<()> {
        let (have, index) = (self.memory.seen.len(), id.index() / 32);
        let word = self.memory.seen.get_mut(index);
        *word.ok_or_else(|| Error::too_small("memory.seen", have, index + 1))? |= 1 << (id.get() % 32);
        Ok(())
    }
}
