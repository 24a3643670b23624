//! Receives the packets of one stream: bytes in, usable state out. No socket, no clock, no heap.
//!
//! All memory is the caller's ([`Memory`]), cut from one arena by [`Plan`](crate::arena::Plan);
//! [`Requirements`] says from a manifest how much of each is needed. Every packet is checked (CRC, header,
//! lattice, entropy coder's end state) before its arrival is recorded, decodes straight to its place in the
//! symbol store, and is used at most once; order does not matter. What is refused is counted by kind and
//! costs bounded work.

mod ahead;
mod chunk;
mod memory;
mod payload;
mod repair;
mod walk;

pub use ahead::Planned;
pub use memory::{Cell, Content, Memory, Requirements, for_each_cell};
pub use repair::Recovered;

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
        manifest::{Manifest, TableSet, stream},
        packet::Packet,
    },
};

/// What happened to packets, by kind.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Counters {
    /// Media packets accepted and decoded.
    pub media: u32,
    /// Parity packets accepted.
    pub parity: u32,
    /// Packets buffered before the manifest.
    pub early: u32,
    /// Packets recovered by repair.
    pub recovered: u32,
    /// Repaired packets that failed their own checks.
    pub repair_failed: u32,
    /// Packets refused, by [`ErrorKind::index`].
    pub refused: [u32; ErrorKind::COUNT],
}

impl Counters {
    /// Counts a refusal.
    pub(crate) fn refuse(&mut self, error: &Error) {
        if let Some(count) = self.refused.get_mut(error.kind.index()) {
            *count = count.saturating_add(1);
        }
    }
}

/// A packet that was decoded or, for parity, taken into account.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Accepted {
    /// The packet.
    pub id: PacketId,
    /// Packets of its repair set that this one made recoverable.
    pub recovered: Recovered,
}

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
    /// Tables that each stream's runs choose from.
    table_sets: [TableSet; stream::COUNT],
    /// How entropy tables lie in memory.
    form: Form,
}

impl<'a> Receiver<'a> {
    /// A receiver of the stream of `manifest`, which stays within `caps`; `memory` is as large as
    /// [`Requirements::of`] both says.
    pub fn new(memory: Memory<'a>, manifest: Manifest<'a>, caps: Caps) -> Self {
        let mut receiver = Self {
            memory,
            manifest,
            crc: crc32,
            combine,
            counters: Counters::default(),
            caps,
            raw_bits: [0; limits::MAX_TABLES],
            table_sets: [TableSet::EMPTY; stream::COUNT],
            form: Form::Slots,
        };
        receiver.initialise();
        receiver
    }

    /// The same receiver with faster arithmetic of the host's: CRC-32/ISO-HDLC and sums of repair.
    #[must_use]
    pub const fn with_arithmetic(mut self, crc: Crc32, combine: Combine) -> Self {
        (self.crc, self.combine) = (crc, combine);
        self
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
            manifest: self.manifest,
            cells: self.memory.cells,
            symbols: self.memory.symbols,
            blocks: self.memory.blocks,
        }
    }

    /// Whether packet `id` has been accepted or recovered.
    pub fn has(&self, id: PacketId) -> bool {
        self.memory.seen.get(id.index() / 32).is_some_and(|word| word >> (id.get() % 32) & 1 == 1)
    }

    fn initialise(&mut self) {
        let manifest = &self.manifest;
        let Memory { cells, symbols, blocks, seen, slots, progress, parity, .. } = &mut self.memory;
        let mut next = Cell::default();
        let mut targets = cells.iter_mut();
        symbols.fill(0);
        for_each_cell(manifest, |_, _, shape| {
            if let Some(cell) = targets.next() {
                *cell = next;
            }
            let mask = closure::initial(&shape);
            let first = next.blocks as usize;
            next.symbols += shape.len() as u32;
            next.blocks += shape.blocks() as u32;
            if let Some(blocks) = blocks.get_mut(first..next.blocks as usize) {
                blocks.fill(mask.0);
            }
        });
        if let Some(end) = targets.next() {
            *end = next;
        }
        seen.fill(0);
        progress.fill(0);
        parity.iter_mut().take(repair::memory_bytes(manifest)).for_each(|byte| *byte = 0);
        self.form = Form::that_fits(manifest.head().tables.into(), slots.len()).unwrap_or(Form::Compact);
        for (index, (table, raw_bits)) in manifest.tables().zip(&mut self.raw_bits).enumerate() {
            self.form.fill(slots, index, &table);
            *raw_bits = table.raw_bits();
        }
        for (stream, table_set) in self.table_sets.iter_mut().enumerate() {
            *table_set = manifest.table_set(stream);
        }
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
        let manifest = self.manifest;
        let id = packet.id();
        let last = u64::from(manifest.head().packets.saturating_sub(1));
        if id.get() >= manifest.head().packets {
            return Err(
                Error::illegal("packet.id", 1, id.get().into(), (0, last)).kind(ErrorKind::Contradiction)
            );
        }
        if self.has(id) {
            let seen = u64::from(id.get());
            return Err(Error::illegal("packet.id", 1, seen, (seen, seen)).kind(ErrorKind::Duplicate));
        }
        let recovered = if let Packet::Parity(parity) = packet.packet() {
            self.take_parity(&manifest, parity)?
        } else {
            self.decode(&manifest, packet.packet())?;
            self.counters.media += 1;
            self.mark(id);
            self.take_member(&manifest, id, packet.bytes())
        };
        Ok(Accepted { id, recovered })
    }

    fn mark(&mut self, id: PacketId) {
        if let Some(word) = self.memory.seen.get_mut(id.index() / 32) {
            *word |= 1 << (id.get() % 32);
        }
    }
}
