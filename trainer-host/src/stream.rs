//! An encoded scene: the manifest, the packets, and what a host needs to take them apart again.

use codec_core::{
    Gaussian,
    closure::Arrived,
    decode, error,
    gaussian::ShDegree,
    ids::{ClusterId, EpochId, Group, Level, Span},
    layout::Shape,
    receiver::{Cell, Content, Counters, Memory, Receiver, Requirements, for_each_cell},
    wire::{
        crc::{checked, crc32},
        file,
        manifest::{self, Manifest, Profile},
        packet::Packet,
    },
};

use crate::{
    encode::{Ledger, Part, Quality, Reached, Searched},
    scene::Instant,
};

/// A manifest and its packets.
#[derive(Clone, Debug)]
pub struct Stream {
    message: Vec<u8>,
    raw: Vec<u8>,
    packets: Vec<Vec<u8>>,
    order: Vec<Vec<u32>>,
    ledger: Ledger,
}

/// What a damaged `.dgs` file had that could not be used.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Damage {
    /// Runs of bytes that are no packet: offset, length.
    pub runs: Vec<(usize, usize)>,
    /// Packets that the manifest expects and the file does not hold.
    pub missing_packets: usize,
    /// Why the index could not be used, if it could not.
    pub index: Option<error::Error>,
    /// Whether the packets end where the index begins.
    pub truncated: bool,
}

impl Damage {
    /// True when the file was whole.
    pub fn is_none(&self) -> bool {
        *self == Self::default()
    }
}

impl std::fmt::Display for Damage {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut parts = Vec::new();
        if let Some((at, len)) = self.runs.first() {
            let total: usize = self.runs.iter().map(|r| r.1).sum();
            parts.push(format!(
                "{} damaged stretches ({total} bytes in all, the first at byte {at}, {len} bytes)",
                self.runs.len()
            ));
        }
        if self.truncated {
            parts.push("the file is cut off".into());
        }
        if let Some(error) = self.index.filter(|_| !self.truncated) {
            parts.push(format!("the index is unusable ({error})"));
        }
        if self.missing_packets > 0 {
            parts.push(format!("{} packets are missing", self.missing_packets));
        }
        f.write_str(&parts.join("; "))
    }
}

impl Stream {
    /// Seals `raw` (an unpacked manifest body of `sections`) and joins it with its packets. `order`
    /// gives, per epoch, the source index of each decoded Gaussian.
    ///
    /// # Errors
    /// If the manifest cannot be sealed.
    pub(crate) fn seal(
        raw: Vec<u8>,
        sections: &[Section],
        packets: Vec<Vec<u8>>,
        order: Vec<Vec<u32>>,
        mut ledger: Ledger,
    ) -> error::Result<Self> {
        let message = sealed(&raw)?;
        ledger.manifest = message.len() as f64;
        ledger.manifest_parts = manifest_parts(&raw, sections, message.len())?;
        Ok(Self { message, raw, packets, order, ledger })
    }

    /// The same with what its ledger says of the target.
    pub(crate) fn with_reached(mut self, reached: Option<Reached>) -> Self {
        self.ledger.reached = reached;
        self
    }

    /// The same with what its ledger says of the search of its steps.
    pub(crate) fn with_searched(mut self, searched: Searched) -> Self {
        self.ledger.searched = Some(searched);
        self
    }

    /// The same with the steps it was encoded at.
    pub(crate) fn with_quality(mut self, quality: Quality) -> Self {
        self.ledger.quality = quality;
        self
    }

    /// The DGSM message.
    pub fn message(&self) -> &[u8] {
        &self.message
    }

    /// The packets, by id.
    pub fn packets(&self) -> &[Vec<u8>] {
        &self.packets
    }

    /// Where every byte went. A stream read from a file knows sizes only.
    pub fn ledger(&self) -> &Ledger {
        &self.ledger
    }

    /// Per epoch, the source index of each decoded Gaussian; empty for a stream read from a file.
    pub fn order(&self) -> &[Vec<u32>] {
        &self.order
    }

    /// The manifest.
    ///
    /// # Errors
    /// None in practice: the body was checked when the stream was made.
    pub fn manifest(&self) -> error::Result<Manifest<'_>> {
        Manifest::parse(&self.raw)
    }

    /// The bytes of a `.dgs` file.
    ///
    /// # Errors
    /// A packet of impossible length; not for streams of this crate's making.
    pub fn to_bytes(&self) -> error::Result<Vec<u8>> {
        let mut out = Vec::new();
        let mut index = file::Index::begin(&self.message, |b| out.extend_from_slice(b));
        let mut entries = Vec::with_capacity(self.packets.len());
        for packet in self.packets.iter().filter(|p| !p.is_empty()) {
            entries.push(index.packet(packet, |b| out.extend_from_slice(b))?);
        }
        index.end(&entries, |b| out.extend_from_slice(b));
        Ok(out)
    }

    /// Reads a `.dgs` file and keeps what is readable. A packet that is not there is empty in
    /// [`Stream::packets`].
    ///
    /// # Errors
    /// If the manifest itself is unreadable: without it nothing else means anything.
    pub fn from_bytes(bytes: &[u8]) -> error::Result<(Self, Damage)> {
        let (message, start) = file::manifest(bytes)?;
        let sealed = manifest::Sealed::parse(message)?;
        let mut raw = vec![0u8; sealed.raw_len.min(codec_core::limits::MAX_MANIFEST_BYTES)];
        manifest::open(message, crc32, &mut raw)?;
        let parsed = Manifest::parse(&raw)?;
        let count = parsed.head().packets as usize;
        let mut packets = vec![Vec::new(); count];
        let mut damage = Damage { truncated: true, ..Damage::default() };
        for record in file::packets(bytes, start, crc32) {
            match record {
                file::Record::Packet(at, packet) => {
                    let parsed = checked("packet.crc", packet, crc32).and_then(Packet::parse);
                    match parsed.ok().and_then(|p| packets.get_mut(p.id().index())) {
                        Some(slot) => *slot = packet.to_vec(),
                        None => damage.runs.push((at, packet.len())),
                    }
                }
                file::Record::Damaged(at, len) => damage.runs.push((at, len)),
                file::Record::End => damage.truncated = false,
            }
        }
        damage.missing_packets = packets.iter().filter(|p| p.is_empty()).count();
        damage.index = file::index(bytes, crc32).err();
        let media: usize = packets.iter().map(Vec::len).sum();
        let ledger = Ledger {
            gaussians: parsed.epochs().map(|e| u64::from(e.gaussians)).sum(),
            frames: u64::from(parsed.head().frames),
            payload: media as f64,
            manifest: message.len() as f64,
            packets: packets.iter().filter(|p| !p.is_empty()).count() as u64,
            ..Ledger::default()
        };
        Ok((Self { message: message.to_vec(), raw, packets, order: Vec::new(), ledger }, damage))
    }

    /// Feeds the manifest and every packet to a receiver.
    ///
    /// # Errors
    /// If the manifest is refused; refused packets are counted, not errors.
    pub fn receive(&self) -> error::Result<Received<'_>> {
        let manifest = self.manifest()?;
        let mut memory = HostMemory::new(&manifest, 0)?;
        let counters = {
            let mut receiver = Receiver::new(memory.memory());
            receiver.control(&self.message)?;
            for packet in self.packets.iter().filter(|p| !p.is_empty()) {
                // Counted by kind in the receiver's counters.
                let _ = receiver.media(packet);
            }
            *receiver.counters()
        };
        Ok(Received { manifest, memory, counters })
    }
}

/// Name and first byte of a section of a manifest body.
pub(crate) type Section = (&'static str, usize);

fn sealed(raw: &[u8]) -> error::Result<Vec<u8>> {
    let mut message = vec![0u8; codec_core::pack::packed_bound(raw.len()).min(raw.len() * 2 + 4096)];
    let len = manifest::seal(raw, &mut message)?;
    message.truncate(len);
    Ok(message)
}

/// What each section takes of a manifest of `len` bytes: header and CRC apart, the packed body is
/// shared out in proportion to what the message shrinks by when it is packed without the section.
fn manifest_parts(raw: &[u8], sections: &[Section], len: usize) -> error::Result<Vec<Part>> {
    let mut shrinks = Vec::new();
    for (i, &(name, start)) in sections.iter().enumerate() {
        let end = sections.get(i + 1).map_or(raw.len(), |next| next.1);
        let without = [&raw[..start], &raw[end..]].concat();
        let shrinks_by = if start == end { 0 } else { len.saturating_sub(sealed(&without)?.len()) };
        shrinks.push((name, shrinks_by));
    }
    let total: usize = shrinks.iter().map(|s| s.1).sum();
    let frame = (manifest::HEADER_BYTES + 4) as f64;
    let mut parts = vec![Part { name: "manifest header and CRC".into(), bits: 8.0 * frame }];
    parts.extend(shrinks.into_iter().filter(|s| s.1 > 0).map(|(name, by)| {
        let share = by as f64 / total as f64;
        Part { name: format!("manifest {name}"), bits: 8.0 * share * (len as f64 - frame) }
    }));
    let named: f64 = parts.iter().map(|p| p.bits).sum();
    if total == 0 {
        parts.push(Part { name: "manifest body".into(), bits: 8.0 * len as f64 - named });
    }
    Ok(parts)
}

/// Everything a receiver decoded, on the host's heap.
#[derive(Clone, Debug)]
pub struct Received<'s> {
    manifest: Manifest<'s>,
    memory: HostMemory,
    counters: Counters,
}

impl Received<'_> {
    /// What was decoded, in the state that arrived.
    pub fn content(&self) -> Content<'_> {
        self.memory.content(&self.manifest)
    }

    /// What happened to the packets.
    pub fn counters(&self) -> &Counters {
        &self.counters
    }
}

/// Receiver memory on the heap, sized for one manifest.
#[derive(Clone, Debug)]
pub struct HostMemory {
    manifest: Vec<u8>,
    cells: Vec<Cell>,
    symbols: Vec<i16>,
    blocks: Vec<u8>,
    seen: Vec<u32>,
    slots: Vec<u32>,
    progress: Vec<u32>,
    parity: Vec<u8>,
    early: Vec<u8>,
}

/// Most bytes of symbols that [`HostMemory`] takes on: a few lying bytes in a manifest must not
/// exhaust a host.
pub const MAX_SYMBOL_BYTES: usize = 2 << 30;

/// Most bytes of repair sums that [`HostMemory`] takes on; sets beyond them are not repaired.
pub const MAX_PARITY_BYTES: usize = 256 << 20;

impl HostMemory {
    /// Memory for `manifest`, with `early` bytes for media that comes before it.
    ///
    /// # Errors
    /// If the stream is larger than the format or [`MAX_SYMBOL_BYTES`] allows.
    pub fn new(manifest: &Manifest<'_>, early: usize) -> error::Result<Self> {
        let need = Requirements::of(manifest)?;
        if need.symbols > MAX_SYMBOL_BYTES / 2 {
            let most = MAX_SYMBOL_BYTES as u64 / 2;
            let error = error::Error::illegal("manifest.symbols", 0, need.symbols as u64, (0, most));
            return Err(error.kind(error::ErrorKind::Capacity));
        }
        Ok(Self {
            manifest: vec![0; manifest.raw().len()],
            cells: vec![Cell::default(); need.cells],
            symbols: vec![0; need.symbols],
            blocks: vec![0; need.blocks],
            seen: vec![0; need.seen],
            slots: vec![0; need.slots],
            progress: vec![0; need.progress],
            parity: vec![0; need.parity.min(MAX_PARITY_BYTES)],
            early: vec![0; early],
        })
    }

    /// The memory as a receiver takes it.
    pub fn memory(&mut self) -> Memory<'_> {
        Memory {
            manifest: &mut self.manifest,
            cells: &mut self.cells,
            symbols: &mut self.symbols,
            blocks: &mut self.blocks,
            seen: &mut self.seen,
            slots: &mut self.slots,
            progress: &mut self.progress,
            parity: &mut self.parity,
            early: &mut self.early,
        }
    }

    /// What a receiver left in this memory.
    pub fn content<'m>(&'m self, manifest: &Manifest<'m>) -> Content<'m> {
        Content { manifest: *manifest, cells: &self.cells, symbols: &self.symbols, blocks: &self.blocks }
    }

    /// Bytes held.
    pub fn bytes(&self) -> usize {
        self.manifest.len()
            + std::mem::size_of_val(self.cells.as_slice())
            + std::mem::size_of_val(self.symbols.as_slice())
            + self.blocks.len()
            + std::mem::size_of_val(self.seen.as_slice())
            + std::mem::size_of_val(self.slots.as_slice())
            + std::mem::size_of_val(self.progress.as_slice())
            + self.parity.len()
            + self.early.len()
    }
}

/// A decoder with its own memory.
#[derive(Clone, Debug)]
pub struct Player {
    canonical: Vec<Gaussian>,
    known: Vec<u8>,
    out: Vec<Gaussian>,
    sh_rest: Vec<f32>,
    degree: ShDegree,
    epoch: Option<EpochId>,
}

impl Player {
    /// A player for streams like `manifest`.
    pub fn new(manifest: &Manifest<'_>) -> Self {
        let most = manifest.epochs().map(|e| e.gaussians as usize).max().unwrap_or(0);
        let mut blocks = vec![0usize; usize::from(manifest.head().epochs)];
        for_each_cell(manifest, |span, _, shape| {
            if let Span::Canonical(EpochId(e)) = span {
                blocks[usize::from(e)] += shape.blocks();
            }
        });
        let degree = manifest.sh_degree();
        Self {
            canonical: vec![Gaussian::ABSENT; most],
            known: vec![0; blocks.into_iter().max().unwrap_or(0)],
            out: vec![Gaussian::ABSENT; most],
            sh_rest: vec![0.0; most * degree.rest_len()],
            degree,
            epoch: None,
        }
    }

    /// Decodes one frame of `content` in its state; all calls must be for the same stream.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn show(&mut self, content: &Content<'_>, frame: u32) -> error::Result<Shown<'_>> {
        let memory = decode::Memory { canonical: &mut self.canonical, known: &mut self.known };
        let mut decoder = decode::Decoder::resume(memory, self.epoch);
        let decoded = decoder.frame(content, frame, &mut self.out, &mut self.sh_rest)?;
        self.epoch = decoder.epoch();
        Ok(Shown {
            gaussians: &self.out[..decoded.gaussians],
            sh_rest: &self.sh_rest[..decoded.gaussians * self.degree.rest_len()],
            sh_degree: self.degree,
            decoded,
        })
    }

    /// As [`Player::show`], copied out.
    ///
    /// # Errors
    /// A frame past the end.
    pub fn instant(&mut self, content: &Content<'_>, frame: u32) -> error::Result<Instant> {
        let shown = self.show(content, frame)?;
        Ok(Instant {
            gaussians: shown.gaussians.to_vec(),
            sh_rest: shown.sh_rest.to_vec(),
            sh_degree: shown.sh_degree,
        })
    }
}

/// A decoded frame in a [`Player`]'s memory.
#[derive(Clone, Copy, Debug)]
pub struct Shown<'p> {
    /// The Gaussians; absent ones have opacity 0.
    pub gaussians: &'p [Gaussian],
    /// Their higher bands.
    pub sh_rest: &'p [f32],
    /// Degree of `sh_rest`.
    pub sh_degree: ShDegree,
    /// What decoding did.
    pub decoded: decode::Decoded,
}

/// One part of what a packet brings: some blocks of one group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Mark {
    /// The group.
    pub group: Group,
    /// First block, counted over the whole state.
    pub first_block: usize,
    /// Number of blocks.
    pub blocks: usize,
    /// Symbols brought (`paper` completes a group when all its symbols have come).
    pub symbols: usize,
}

/// What each packet of a stream brings, so that states can be computed without decoding.
#[derive(Clone, Debug)]
pub struct PacketMap {
    initial: Vec<u8>,
    marks: Vec<Vec<Mark>>,
    parity: Vec<bool>,
    group_symbols: Vec<(Group, usize)>,
    profile: Profile,
}

impl PacketMap {
    /// The map of `stream`.
    ///
    /// # Errors
    /// If the stream's manifest does not hold.
    pub fn of(stream: &Stream) -> error::Result<Self> {
        let manifest = stream.manifest()?;
        let mut first_block = Vec::new();
        let mut initial = Vec::new();
        let mut group_symbols = Vec::new();
        for_each_cell(&manifest, |span, cluster, shape| {
            first_block.push(initial.len());
            let empty = Level::ALL.into_iter().filter(|&l| shape.level_len(l) == 0);
            let mask = empty.fold(Arrived::default(), Arrived::with);
            initial.extend(std::iter::repeat_n(mask.0, shape.blocks()));
            for level in Level::ALL.into_iter().filter(|&l| shape.level_len(l) > 0) {
                group_symbols.push((Group { span, cluster, level }, shape.level_len(level)));
            }
        });
        let mut map = Self {
            initial,
            marks: Vec::new(),
            parity: Vec::new(),
            group_symbols,
            profile: manifest.profile(),
        };
        for packet in stream.packets() {
            let parsed = checked("packet.crc", packet, crc32).and_then(Packet::parse);
            let mut marks = Vec::new();
            let mut parity = false;
            match parsed {
                Ok(Packet::Slices(slices)) => {
                    for stretch in &slices.stretches {
                        let (span, level) = (stretch.span, stretch.level);
                        for (cluster, blocks) in manifest.slices(*stretch) {
                            let group = Group { span, cluster, level };
                            let found = manifest.cell(span, cluster);
                            let Some((cell, shape)) = found.zip(Shape::of(&manifest, span, cluster)) else {
                                continue;
                            };
                            let blocks = blocks.start as usize..blocks.end as usize;
                            let (_, symbols) = shape.range(level, blocks.clone());
                            if symbols > 0 {
                                let first_block = first_block[cell.index()] + blocks.start;
                                marks.push(Mark { group, first_block, blocks: blocks.len(), symbols });
                            }
                        }
                    }
                }
                Ok(Packet::Chunk(chunk)) => {
                    let cluster = u32::from(chunk.cluster);
                    let found = manifest
                        .epochs()
                        .enumerate()
                        .find(|(_, e)| cluster.checked_sub(e.first_cluster).is_some_and(|c| c < e.clusters));
                    if let Some((e, epoch)) = found {
                        let span = Span::Canonical(EpochId(e as u16));
                        let local = ClusterId((cluster - epoch.first_cluster) as u16);
                        let group = Group { span, cluster: local, level: chunk.level };
                        let first_block = first_block[cluster as usize];
                        let symbols = usize::from(chunk.symbols);
                        marks.push(Mark { group, first_block, blocks: 1, symbols });
                    }
                }
                Ok(Packet::Parity(_)) => parity = true,
                Err(_) => {}
            }
            map.marks.push(marks);
            map.parity.push(parity);
        }
        Ok(map)
    }

    /// The state before any packet.
    pub fn initial(&self) -> &[u8] {
        &self.initial
    }

    /// What packet `id` brings; nothing for parity.
    pub fn marks(&self, id: usize) -> &[Mark] {
        &self.marks[id]
    }

    /// Whether packet `id` is parity.
    pub fn is_parity(&self, id: usize) -> bool {
        self.parity[id]
    }

    /// All groups that hold symbols, in lattice order, and how many.
    pub fn groups(&self) -> &[(Group, usize)] {
        &self.group_symbols
    }

    /// The state in which exactly the packets for which `have` says so have arrived, without
    /// repair.
    pub fn state(&self, have: impl Fn(usize) -> bool) -> Vec<u8> {
        let mut state = self.initial.clone();
        let mut whole = std::collections::BTreeMap::new();
        for (id, marks) in self.marks.iter().enumerate() {
            if !have(id) {
                continue;
            }
            for mark in marks {
                match self.profile {
                    Profile::Dgs1 => set(&mut state, mark),
                    Profile::Paper => {
                        whole.entry(mark.group).or_insert((*mark, 0)).1 += mark.symbols;
                    }
                }
            }
        }
        for (group, symbols) in &self.group_symbols {
            if let Some((mark, found)) = whole.get(group)
                && found >= symbols
            {
                set(&mut state, mark);
            }
        }
        state
    }
}

fn set(state: &mut [u8], mark: &Mark) {
    for mask in &mut state[mark.first_block..mark.first_block + mark.blocks] {
        *mask = Arrived(*mask).with(mark.group.level).0;
    }
}
