//! The receiver: bytes in, usable state out. No socket, no clock, no heap.
//!
//! All memory is the caller's ([`Memory`]); [`Requirements`] says from a manifest how much of
//! each is needed. Media that arrives before the manifest is buffered within that memory, never
//! decoded. Every packet is checked (CRC, header, lattice, entropy coder's end state) before its
//! arrival is recorded, decodes straight to its place in the symbol store, and is used at most
//! once; order does not matter. What is refused is counted by kind and costs bounded work.

mod repair;

pub use repair::Recovered;

use crate::{
    closure::Arrived,
    error::{Error, ErrorKind, Result},
    ids::{ClusterId, EpochId, Level, PacketId, Span, WindowId},
    layout::Shape,
    limits::{self, MAX_PACKET_BYTES},
    rans::{
        bytes,
        form::{Form, View},
        lanes,
    },
    wire::{
        bits::Bits,
        crc::{Crc32, checked, crc32},
        cursor::in_range,
        manifest::{self, Manifest, Menu, Profile, stream},
        packet::{Chunk, Packet, Slices, Stretch},
    },
};

/// Where a cell's data starts.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Cell {
    /// First symbol.
    pub symbols: u32,
    /// First block.
    pub blocks: u32,
}

/// How much memory a stream needs, in elements of each [`Memory`] field.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct Requirements {
    /// Elements of `cells`.
    pub cells: usize,
    /// Elements of `symbols`.
    pub symbols: usize,
    /// Elements of `blocks`.
    pub blocks: usize,
    /// Elements of `seen`.
    pub seen: usize,
    /// Elements of `slots` for the fast form of tables.
    pub slots: usize,
    /// Elements of `slots` for the compact form: fewer are refused.
    pub least_slots: usize,
    /// Elements of `progress`.
    pub progress: usize,
    /// Bytes of `parity` for full repair; less repairs fewer sets.
    pub parity: usize,
}

impl Requirements {
    /// What `manifest` needs.
    ///
    /// # Errors
    /// [`ErrorKind::Capacity`] if the symbols exceed 2^31.
    pub fn of(manifest: &Manifest<'_>) -> Result<Self> {
        let mut need = Self { cells: manifest.cells() + 1, ..Self::default() };
        for_each_cell(manifest, |_, _, shape| {
            need.symbols = need.symbols.saturating_add(shape.len());
            need.blocks = need.blocks.saturating_add(shape.blocks());
        });
        in_range("manifest.symbols", 0, need.symbols as u64, 0, 1 << 31)
            .map_err(|e| e.kind(ErrorKind::Capacity))?;
        need.seen = (manifest.head().packets as usize).div_ceil(32);
        need.parity = repair::memory_bytes(manifest);
        match manifest.profile() {
            Profile::Dgs1 => {
                let tables = usize::from(manifest.head().tables);
                need.slots = tables * Form::Slots.words();
                need.least_slots = tables * Form::Compact.words();
            }
            Profile::Paper => {
                need.slots = 2 * bytes::SLOTS / 4;
                need.least_slots = need.slots;
                need.progress = manifest.cells() * Level::COUNT;
            }
        }
        Ok(need)
    }
}

/// Calls `visit` with every cell in lattice order: canonical cells, then motion cells.
pub fn for_each_cell(manifest: &Manifest<'_>, mut visit: impl FnMut(Span, ClusterId, Shape)) {
    let mut walk = |span, clusters: u32| {
        for c in 0..clusters {
            let cluster = ClusterId(c as u16);
            if let Some(shape) = Shape::of(manifest, span, cluster) {
                visit(span, cluster, shape);
            }
        }
    };
    for (e, epoch) in manifest.epochs().enumerate() {
        walk(Span::Canonical(EpochId(e as u16)), epoch.clusters);
    }
    for (w, window) in manifest.windows().enumerate() {
        let clusters = manifest.epoch(EpochId(window.epoch)).map_or(0, |e| e.clusters);
        walk(Span::Motion(WindowId(w as u16)), clusters);
    }
}

/// The caller's memory. Contents do not matter; [`Receiver::control`] initialises what it uses.
#[derive(Debug, Default)]
pub struct Memory<'a> {
    /// The unpacked manifest ([`manifest::Sealed::raw_len`] bytes).
    pub manifest: &'a mut [u8],
    /// Where cells start.
    pub cells: &'a mut [Cell],
    /// Decoded symbols.
    pub symbols: &'a mut [i16],
    /// Arrival masks, one per block and cell.
    pub blocks: &'a mut [u8],
    /// Bitmap of packets.
    pub seen: &'a mut [u32],
    /// Entropy decode tables: [`Requirements::slots`] for the fast form, or down to
    /// [`Requirements::least_slots`] for the compact one.
    pub slots: &'a mut [u32],
    /// Symbols arrived per group (`paper`).
    pub progress: &'a mut [u32],
    /// Sums of the repair sets.
    pub parity: &'a mut [u8],
    /// Media that arrives before the manifest.
    pub early: &'a mut [u8],
}

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

/// The decoded content of a stream so far, and which of it counts.
#[derive(Clone, Copy, Debug)]
pub struct Content<'m> {
    /// The manifest.
    pub manifest: Manifest<'m>,
    /// Where cells start.
    pub cells: &'m [Cell],
    /// Symbols.
    pub symbols: &'m [i16],
    /// The state: arrival masks. Any list of this length is a valid state.
    pub blocks: &'m [u8],
}

impl<'m> Content<'m> {
    /// The same content in another state.
    #[must_use]
    pub const fn with_state(mut self, blocks: &'m [u8]) -> Self {
        self.blocks = blocks;
        self
    }

    /// The cell of `cluster` in `span`.
    pub fn cell(&self, span: Span, cluster: ClusterId) -> Option<Cell> {
        self.cells.get(self.manifest.cell(span, cluster)?.index()).copied()
    }

    /// Levels of block `block` of a cell that have arrived.
    pub fn arrived(&self, cell: Cell, block: usize) -> Arrived {
        Arrived(self.blocks.get(cell.blocks as usize + block).copied().unwrap_or(0))
    }
}

/// A sans-I/O receiver over caller-owned memory.
#[derive(Debug)]
pub struct Receiver<'a> {
    memory: Memory<'a>,
    manifest: Option<Manifest<'a>>,
    crc: Crc32,
    early_used: usize,
    counters: Counters,
    /// Raw bits per value of each entropy table.
    raw_bits: [u8; limits::MAX_TABLES],
    /// Tables that each stream's runs choose from.
    menus: [Menu; stream::COUNT],
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
            early_used: 0,
            counters,
            raw_bits: [0; limits::MAX_TABLES],
            menus: [Menu::EMPTY; stream::COUNT],
            form: Form::Slots,
        }
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
    /// memory that is too small; [`ErrorKind::Duplicate`] if there is a manifest already.
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
            let need = Requirements::of(&manifest)?;
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
        for (stream, menu) in self.menus.iter_mut().enumerate() {
            *menu = manifest.menu(stream);
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

    fn decode(&mut self, manifest: &Manifest<'_>, packet: &Packet<'_>) -> Result<()> {
        let (wanted, found) = match packet {
            Packet::Slices(_) => (Profile::Dgs1, manifest.profile()),
            Packet::Chunk(_) => (Profile::Paper, manifest.profile()),
            Packet::Parity(_) => return Err(Error::illegal("packet.kind", 0, 6, (4, 5))),
        };
        if wanted != found {
            let allowed = (found as u64, found as u64);
            return Err(
                Error::illegal("packet.profile", 0, wanted as u64, allowed).kind(ErrorKind::Contradiction)
            );
        }
        match packet {
            Packet::Slices(slices) => self.decode_slices(manifest, slices),
            Packet::Chunk(chunk) => self.decode_chunk(manifest, chunk),
            Packet::Parity(_) => Ok(()),
        }
    }

    fn decode_slices(&mut self, manifest: &Manifest<'_>, packet: &Slices<'_>) -> Result<()> {
        let Memory { cells, symbols, blocks, slots, .. } = &mut self.memory;
        let (form, slots) = (self.form, &**slots);
        let (menus, raw_bits_of) = (&self.menus, &self.raw_bits);
        let table_at = |stream: usize, selectors: &mut Bits<'_>| -> Result<(View<'_>, u8)> {
            let index = menus.get(stream).copied().unwrap_or_default().select(selectors)?;
            let found = form.table(slots, index.into()).zip(raw_bits_of.get(usize::from(index)));
            let last = u64::from(manifest.head().tables).saturating_sub(1);
            let missing = Error::illegal("slice.table", 0, index.into(), (0, last));
            found.map(|(table, &bits)| (table, bits)).ok_or(missing.kind(ErrorKind::Contradiction))
        };
        // Selectors come first, so that the size of everything behind them is known.
        let mut selectors = Bits::new(packet.body);
        let (mut values, mut raw_bits) = (0usize, 0usize);
        for (i, stretch) in packet.stretches.iter().enumerate() {
            let overlaps = |earlier: &Stretch| overlap(earlier, stretch);
            let twice = packet.stretches.iter().take(i).any(overlaps);
            for_each_slice(manifest, cells, stretch, i, |place| {
                let masks = blocks.get(place.masks.clone()).unwrap_or(&[]);
                if twice || masks.iter().any(|&m| Arrived(m).has(stretch.level)) {
                    let level = u64::from(stretch.level.get());
                    return Err(Error::illegal("slice", i, level, (level, level)).kind(ErrorKind::Duplicate));
                }
                place.shape.runs(stretch.level, place.blocks.clone(), |stream, n| {
                    values += n;
                    raw_bits += n * usize::from(table_at(stream, &mut selectors)?.1);
                    Ok(())
                })
            })?;
        }
        let mut decoder = lanes::Decoder::new(selectors.finish()?, values, raw_bits)?;
        let mut selectors = Bits::new(packet.body);
        for (i, stretch) in packet.stretches.iter().enumerate() {
            for_each_slice(manifest, cells, stretch, i, |place| {
                let mut rest = symbols.get_mut(place.symbols.clone()).unwrap_or(&mut []);
                place.shape.runs(stretch.level, place.blocks.clone(), |stream, n| {
                    let (table, bits) = table_at(stream, &mut selectors)?;
                    let whole = core::mem::take(&mut rest);
                    let n = n.min(whole.len());
                    let (run, tail) = whole.split_at_mut(n);
                    rest = tail;
                    table.run(&mut decoder, bits, run)
                })
            })?;
        }
        decoder.finish()?;
        for (i, stretch) in packet.stretches.iter().enumerate() {
            for_each_slice(manifest, cells, stretch, i, |place| {
                for mask in blocks.get_mut(place.masks).unwrap_or(&mut []) {
                    *mask = Arrived(*mask).with(stretch.level).0;
                }
                Ok(())
            })?;
        }
        Ok(())
    }

    /// Kept apart, so that its byte tables do not weigh on the stack of `dgs1`.
    #[inline(never)]
    fn decode_chunk(&mut self, manifest: &Manifest<'_>, chunk: &Chunk<'_>) -> Result<()> {
        let Memory { cells, symbols, blocks, slots, progress, .. } = &mut self.memory;
        let contradiction = |field, offset, found: u64, allowed| {
            Err(Error::illegal(field, offset, found, allowed).kind(ErrorKind::Contradiction))
        };
        let cluster = u32::from(chunk.cluster);
        let found = manifest
            .epochs()
            .enumerate()
            .find(|(_, e)| cluster.checked_sub(e.first_cluster).is_some_and(|offset| offset < e.clusters));
        let Some((e, epoch)) = found else {
            let last = u64::from(manifest.head().clusters.saturating_sub(1));
            return contradiction("chunk.cluster", 4, cluster.into(), (0, last));
        };
        let span = Span::Canonical(EpochId(e as u16));
        let local = ClusterId((cluster - epoch.first_cluster) as u16);
        let Some(shape) = Shape::of(manifest, span, local) else {
            return contradiction("chunk.cluster", 4, cluster.into(), (0, 0));
        };
        let level_len = shape.level_len(chunk.level) as u64;
        let end = u64::from(chunk.first_symbol) + u64::from(chunk.symbols);
        for (field, offset, found, wanted) in [
            ("chunk.first_frame", 6, u32::from(chunk.first_frame), epoch.first_frame & 0xffff),
            ("chunk.frames", 8, u32::from(chunk.frames), epoch.frames & 0xffff),
            ("chunk.quant", 10, u32::from(chunk.quant), u32::from(shape.cluster.quant)),
        ] {
            if found != wanted {
                return contradiction(field, offset, found.into(), (wanted.into(), wanted.into()));
            }
        }
        if end > level_len {
            return contradiction("chunk.symbols", 18, end, (1, level_len));
        }
        let group = cluster * Level::COUNT as u32 + u32::from(chunk.level.get());
        // Chunks of a group never overlap, so that together they never bring more than it has.
        let arrived = u64::from(progress.get(group as usize).copied().unwrap_or(0));
        let left = level_len.saturating_sub(arrived);
        if u64::from(chunk.symbols) > left {
            return contradiction("chunk.symbols", 18, chunk.symbols.into(), (0, left));
        }
        let needs = usize::from(chunk.level > Level::BASE);
        if chunk.dependencies.len() != needs {
            return contradiction(
                "chunk.dependencies",
                11,
                chunk.dependencies.len() as u64,
                (needs as u64, needs as u64),
            );
        }
        if let Some(&word) = chunk.dependencies.first()
            && word != group - 1
        {
            let below = u64::from(group - 1);
            return contradiction("chunk.dependency", 22, word.into(), (below, below));
        }
        let Some([low, high]) = manifest.byte_tables(cluster as usize, chunk.level) else {
            return contradiction("chunk.tables", 0, 0, (1, 1));
        };
        let slots: &mut [u8] = bytemuck::cast_slice_mut(slots);
        let Some([low_slots, high_slots]) = slots.as_chunks_mut::<{ bytes::SLOTS }>().0.get_mut(..2) else {
            return contradiction("memory.slots", 0, 0, (2, 2));
        };
        low.fill_slots(low_slots);
        high.fill_slots(high_slots);
        let cell = cells.get(cluster as usize).copied().unwrap_or_default();
        let (level_start, _) = shape.range(chunk.level, 0..1);
        let start = cell.symbols as usize + level_start + chunk.first_symbol as usize;
        let target = symbols.get_mut(start..start + usize::from(chunk.symbols)).unwrap_or(&mut []);
        bytes::decode(chunk.payload, [&low, &high], [low_slots, high_slots], target)?;
        if let Some(progress) = progress.get_mut(group as usize) {
            *progress += u32::from(chunk.symbols);
            if u64::from(*progress) >= level_len
                && let Some(mask) = blocks.get_mut(cell.blocks as usize)
            {
                *mask = Arrived(*mask).with(chunk.level).0;
            }
        }
        Ok(())
    }
}

/// Whether two stretches bring the same level of the same block.
fn overlap(a: &Stretch, b: &Stretch) -> bool {
    let (a_end, b_end) = (a.first.saturating_add(a.blocks), b.first.saturating_add(b.blocks));
    (a.span, a.level) == (b.span, b.level) && a.first < b_end && b.first < a_end
}

/// Calls `visit` with every slice of stretch `index` of a packet that carries symbols, in order.
fn for_each_slice(
    manifest: &Manifest<'_>,
    cells: &[Cell],
    stretch: &Stretch,
    index: usize,
    mut visit: impl FnMut(Place) -> Result<()>,
) -> Result<()> {
    let contradiction = |field, found: u64, allowed| {
        Err(Error::illegal(field, index, found, allowed).kind(ErrorKind::Contradiction))
    };
    let Some(first) = manifest.cell(stretch.span, ClusterId(0)) else {
        return contradiction("stretch.span", 0, (0, 0));
    };
    let clusters = manifest.clusters_of(stretch.span) as usize;
    let range = first.index()..first.index() + clusters;
    let cells = cells.get(range.start..=range.end).unwrap_or(&[]);
    let start = cells.first().map_or(0, |c| c.blocks);
    let all = cells.last().map_or(0, |c| c.blocks) - start;
    let end = u64::from(stretch.first) + u64::from(stretch.blocks);
    if end > all.into() {
        return contradiction("stretch.blocks", end, (1, all.into()));
    }
    let end = end as u32;
    // The last cluster that begins at or before the first block; clusters are never empty.
    let begin = cells.partition_point(|c| c.blocks - start <= stretch.first).saturating_sub(1);
    let mut symbols = 0;
    for (c, pair) in cells.windows(2).enumerate().skip(begin) {
        let &[cell, next] = pair else { continue };
        let (low, high) = (cell.blocks - start, next.blocks - start);
        if low >= end {
            break;
        }
        let Some(shape) = Shape::of(manifest, stretch.span, ClusterId(c as u16)) else { continue };
        if shape.level_len(stretch.level) == 0 {
            continue;
        }
        let local = |block: u32| (block.clamp(low, high) - low) as usize;
        let (blocks, all) = (local(stretch.first)..local(end), shape.blocks());
        if shape.is_whole(stretch.level) && blocks != (0..all) {
            return contradiction("slice.blocks", blocks.len() as u64, (all as u64, all as u64));
        }
        let (offset, len) = shape.range(stretch.level, blocks.clone());
        symbols += len;
        let first = cell.symbols as usize + offset;
        let mask = cell.blocks as usize;
        visit(Place {
            symbols: first..first + len,
            masks: mask + blocks.start..mask + blocks.end,
            shape,
            blocks,
        })?;
    }
    if symbols == 0 {
        return contradiction("stretch.level", stretch.level.get().into(), (0, 3));
    }
    Ok(())
}

/// Where a slice's symbols and masks lie.
struct Place {
    shape: Shape,
    blocks: core::ops::Range<usize>,
    symbols: core::ops::Range<usize>,
    masks: core::ops::Range<usize>,
}
