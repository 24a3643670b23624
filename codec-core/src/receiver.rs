//! The receiver: bytes in, usable state out. No socket, no clock, no heap.
//!
//! All memory is the caller's ([`Memory`]); [`Requirements`] says from a manifest how much of
//! each is needed. Media that arrives before the manifest is buffered within that memory, never
//! decoded. Every packet is checked (CRC, header, lattice, entropy coder's end state) before its
//! arrival is recorded, decodes straight to its place in the symbol store, and is used at most
//! once; order does not matter. What is refused is counted by kind and costs bounded work.

mod ahead;
mod memory;
mod payload;
mod repair;

pub use ahead::Planned;
pub use memory::{Cell, Content, Memory, Requirements, for_each_cell};
pub use repair::Recovered;

use crate::{
    caps::Caps,
    closure::Arrived,
    cursor::in_range,
    error::{Error, ErrorKind, Result},
    ids::{Level, PacketId},
    limits::{self, MAX_PACKET_BYTES},
    rans::form::Form,
    repair::{Combine, combine},
    wire::{
        crc::{Crc32, checked, crc32},
        manifest::{self, Manifest, TableSet, stream},
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

/// What became of a packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// Kept until the manifest is complete.
    Buffered,
    /// Decoded (or, for parity, taken into account).
    Accepted {
        /// The packet.
        id: PacketId,
        /// Packets of its repair set that this one made recoverable.
        recovered: Recovered,
    },
}

/// A sans-I/O receiver over caller-owned memory.
#[derive(Debug)]
pub struct Receiver<'a> {
    memory: Memory<'a>,
    manifest: Option<Manifest<'a>>,
    crc: Crc32,
    combine: Combine,
    early_used: usize,
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
    /// A receiver that waits for its manifest.
    pub const fn new(memory: Memory<'a>) -> Self {
        Self::with_crc(memory, crc32)
    }

    /// A receiver that uses `crc`, a faster CRC-32/ISO-HDLC of the host's.
    pub const fn with_crc(memory: Memory<'a>, crc: Crc32) -> Self {
        let counters = Counters {
            media: 0,
            parity: 0,
            early: 0,
            recovered: 0,
            repair_failed: 0,
            refused: [0; ErrorKind::COUNT],
        };
        Self {
            memory,
            manifest: None,
            crc,
            combine,
            early_used: 0,
            counters,
            caps: Caps::HOST,
            raw_bits: [0; limits::MAX_TABLES],
            table_sets: [TableSet::EMPTY; stream::COUNT],
            form: Form::Slots,
        }
    }

    /// The same receiver with `combine`, a faster way of the host's to add up repair sums.
    pub const fn with_combine(mut self, combine: Combine) -> Self {
        self.combine = combine;
        self
    }

    /// The same receiver, which takes on at most `caps` instead of [`Caps::HOST`].
    pub const fn with_caps(mut self, caps: Caps) -> Self {
        self.caps = caps;
        self
    }

    /// The manifest, once it is complete.
    pub const fn manifest(&self) -> Option<&Manifest<'a>> {
        self.manifest.as_ref()
    }

    /// What happened so far.
    pub const fn counters(&self) -> &Counters {
        &self.counters
    }

    /// What has been decoded so far; `None` before the manifest.
    pub fn content(&self) -> Option<Content<'_>> {
        Some(Content {
            manifest: self.manifest?,
            cells: self.memory.cells,
            symbols: self.memory.symbols,
            blocks: self.memory.blocks,
        })
    }

    /// Whether packet `id` has been accepted or recovered.
    pub fn has(&self, id: PacketId) -> bool {
        let word = self.memory.seen.get(id.index() / 32).copied().unwrap_or(0);
        word >> (id.get() % 32) & 1 == 1
    }

    /// Takes the whole DGSM message, then the media that was waiting for it.
    ///
    /// # Errors
    /// A message that is refused leaves the receiver as it was. [`ErrorKind::Capacity`] names the
    /// cap that is exceeded or the memory that is too small; [`ErrorKind::Duplicate`] if there is a manifest already.
    pub fn control(&mut self, message: &[u8]) -> Result<()> {
        if self.manifest.is_some() {
            return Err(Error::illegal("manifest", 0, 2, (1, 1)).kind(ErrorKind::Duplicate));
        }
        let memory = &self.memory;
        let have = Requirements {
            cells: memory.cells.len(),
            symbols: memory.symbols.len(),
            blocks: memory.blocks.len(),
            seen: memory.seen.len(),
            slots: memory.slots.len(),
            least_slots: memory.slots.len(),
            progress: memory.progress.len(),
            parity: memory.parity.len(),
        };
        let raw_len = {
            let raw = manifest::open(message, self.crc, self.memory.manifest)?;
            let manifest = Manifest::parse(raw)?;
            let need = Requirements::of(&manifest, &self.caps)?;
            for (field, have, need) in [
                ("memory.cells", have.cells, need.cells),
                ("memory.symbols", have.symbols, need.symbols),
                ("memory.blocks", have.blocks, need.blocks),
                ("memory.seen", have.seen, need.seen),
                ("memory.slots", have.least_slots, need.least_slots),
                ("memory.progress", have.progress, need.progress),
            ] {
                if have < need {
                    return Err(Error::short(field, 0, have, need).kind(ErrorKind::Capacity));
                }
            }
            raw.len()
        };
        let raw: &'a mut [u8] = core::mem::take(&mut self.memory.manifest);
        let raw: &'a [u8] = raw;
        let manifest = Manifest::parse(raw.get(..raw_len).unwrap_or(raw))?;
        self.initialise(&manifest);
        self.manifest = Some(manifest);
        self.drain_early();
        Ok(())
    }

    fn initialise(&mut self, manifest: &Manifest<'_>) {
        let Memory { cells, symbols, blocks, seen, slots, progress, parity, .. } = &mut self.memory;
        let mut next = Cell::default();
        let mut targets = cells.iter_mut();
        symbols.fill(0);
        for_each_cell(manifest, |_, _, shape| {
            if let Some(cell) = targets.next() {
                *cell = next;
            }
            let empty = Level::ALL.into_iter().filter(|&l| shape.level_len(l) == 0);
            let mask = empty.fold(Arrived::default(), Arrived::with);
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

    fn drain_early(&mut self) {
        let early = core::mem::take(&mut self.memory.early);
        let mut rest: &[u8] = early.get(..self.early_used).unwrap_or(&[]);
        while let Some((len, tail)) = rest.split_first_chunk::<2>() {
            let len = usize::from(u16::from_le_bytes(*len)).min(tail.len());
            let (packet, tail) = tail.split_at(len);
            rest = tail;
            // A refusal is counted by `media`; nobody waits for this packet's answer.
            let _ = self.media(packet);
        }
    }

    /// Takes one media or parity packet.
    ///
    /// # Errors
    /// Why the packet is refused; the receiver is as it was, but for its counters.
    pub fn media(&mut self, packet: &[u8]) -> Result<Arrival> {
        let result = self.take(packet);
        if let Err(error) = &result {
            self.counters.refused[error.kind.index()] += 1;
        }
        result
    }

    fn take(&mut self, packet: &[u8]) -> Result<Arrival> {
        in_range("packet", 0, packet.len() as u64, 1, MAX_PACKET_BYTES as u64)?;
        let content = checked("packet.crc", packet, self.crc)?;
        let Some(manifest) = self.manifest else {
            return self.buffer(packet);
        };
        let parsed = Packet::parse(content)?;
        let id = parsed.id();
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
        let recovered = if let Packet::Parity(parity) = &parsed {
            self.take_parity(&manifest, parity)?
        } else {
            self.decode(&manifest, &parsed)?;
            self.counters.media += 1;
            self.mark(id);
            self.take_member(&manifest, id, packet)
        };
        Ok(Arrival::Accepted { id, recovered })
    }

    fn buffer(&mut self, packet: &[u8]) -> Result<Arrival> {
        let room = self.memory.early.len().saturating_sub(self.early_used);
        let needed = packet.len() + 2;
        let Some(target) = self.memory.early.get_mut(self.early_used..self.early_used + needed) else {
            return Err(Error::short("memory.early", 0, room, needed).kind(ErrorKind::Capacity));
        };
        let (len, bytes) = target.split_at_mut(2);
        len.copy_from_slice(&(packet.len() as u16).to_le_bytes());
        bytes.copy_from_slice(packet);
        self.early_used += needed;
        self.counters.early += 1;
        Ok(Arrival::Buffered)
    }

    fn mark(&mut self, id: PacketId) {
        if let Some(word) = self.memory.seen.get_mut(id.index() / 32) {
            *word |= 1 << (id.get() % 32);
        }
    }
}
