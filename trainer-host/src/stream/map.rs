//! What each packet of a stream brings, worked out from headers and the manifest's lattice.

use codec_core::internals::{
    closure::Arrived,
    error,
    ids::{ClusterId, EpochId, Group, Level, Span},
    layout::Shape,
    receiver::for_each_cell,
    wire::{
        crc::{checked, crc32},
        manifest::Profile,
        packet::Packet,
    },
};

use super::Stream;

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
                    for extent in &slices.extents {
                        let (span, level) = (extent.span, extent.level);
                        for (cluster, blocks) in manifest.slices(*extent) {
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
