//! Maps each packet of a stream to what it brings, worked out from headers and the manifest's lattice.

use codec_core::internals::{
    closure::{self, Arrived, levels_with_symbols},
    error,
    ids::{ClusterId, EpochId, Group, Level, Span},
    layout::Shape,
    receiver::for_each_cell,
    wire::{
        checked::Checked,
        manifest::{Manifest, Profile, Repair},
        packet::{Chunk, Packet, Slices},
    },
};

use super::Stream;

/// Where a slice lies: some blocks of one group.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct SlicePlacement {
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
    first_block: Vec<usize>,
    placements: Vec<Vec<SlicePlacement>>,
    parity: Vec<bool>,
    repairs: Vec<Repair>,
    group_symbols: Vec<(Group, usize)>,
    profile: Profile,
}

/// Where the slices of a `dgs1` packet lie.
fn slices_of(manifest: &Manifest<'_>, slices: &Slices<'_>, first_block: &[usize]) -> Vec<SlicePlacement> {
    let mut placements = Vec::new();
    for extent in &slices.extents {
        let (span, level) = (extent.span, extent.level);
        // A span that there is not brings nothing.
        let Some(slices) = manifest.slices(*extent) else { continue };
        for (cluster, blocks) in slices {
            let shape = Shape::of(manifest, span, cluster);
            let Some((cell, shape)) = manifest.cell(span, cluster).zip(shape) else { continue };
            let blocks = blocks.start as usize..blocks.end as usize;
            let (_, symbols) = shape.range(level, blocks.clone());
            if symbols > 0 {
                placements.push(SlicePlacement {
                    group: Group { span, cluster, level },
                    first_block: first_block[cell.index()] + blocks.start,
                    blocks: blocks.len(),
                    symbols,
                });
            }
        }
    }
    placements
}

/// Where a `paper` chunk lies, if there is such a cluster.
fn chunk_of(manifest: &Manifest<'_>, chunk: &Chunk<'_>, first_block: &[usize]) -> Option<SlicePlacement> {
    let cluster = u32::from(chunk.cluster);
    for (e, epoch) in manifest.epochs().enumerate() {
        let inside = cluster.checked_sub(epoch.first_cluster).filter(|&local| local < epoch.clusters);
        if let Some(local) = inside {
            let span = Span::Canonical(EpochId(e as u16));
            return Some(SlicePlacement {
                group: Group { span, cluster: ClusterId(local as u16), level: chunk.level },
                first_block: first_block[cluster as usize],
                blocks: 1,
                symbols: usize::from(chunk.symbols),
            });
        }
    }
    None
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
            initial.extend(std::iter::repeat_n(closure::initial(&shape).0, shape.blocks()));
            let with_symbols = levels_with_symbols(&shape);
            for level in Level::ALL.into_iter().filter(|&level| with_symbols.has(level)) {
                group_symbols.push((Group { span, cluster, level }, shape.level_len(level)));
            }
            Ok(())
        })?;
        let (mut placements, mut parity) = (Vec::new(), Vec::new());
        for packet in stream.packets() {
            // Packets were checked when the stream was read or made; one that is missing is empty.
            let checked = Checked::without_crc_check(packet).ok();
            let packet = checked.as_ref().map(Checked::packet);
            parity.push(matches!(packet, Some(Packet::Parity(_))));
            placements.push(match packet {
                Some(Packet::Slices(slices)) => slices_of(&manifest, slices, &first_block),
                Some(Packet::Chunk(chunk)) => chunk_of(&manifest, chunk, &first_block).into_iter().collect(),
                Some(Packet::Parity(_)) | None => Vec::new(),
            });
        }
        let (repairs, profile) = (manifest.repairs().collect(), manifest.profile());
        Ok(Self { initial, first_block, placements, parity, repairs, group_symbols, profile })
    }

    /// The state before any packet.
    pub fn initial(&self) -> &[u8] {
        &self.initial
    }

    /// Index of every cell's first block in a state, in lattice order.
    pub fn first_blocks(&self) -> &[usize] {
        &self.first_block
    }

    /// What packet `id` brings; nothing for parity.
    pub fn placements(&self, id: usize) -> &[SlicePlacement] {
        &self.placements[id]
    }

    /// Whether packet `id` is parity.
    pub fn is_parity(&self, id: usize) -> bool {
        self.parity[id]
    }

    /// All groups that hold symbols, in lattice order, and how many.
    pub fn groups(&self) -> &[(Group, usize)] {
        &self.group_symbols
    }

    /// Which packets a receiver has once it has repaired what it can, of those for which `arrived` says so:
    /// a set is whole when no more of its packets are missing than parity packets of it have arrived.
    pub fn repaired(&self, arrived: impl Fn(usize) -> bool) -> Vec<bool> {
        let mut have: Vec<bool> = (0..self.placements.len()).map(arrived).collect();
        for range in &self.repairs {
            for set in 0..range.sets() {
                let members = (0..range.members(set)).map(|position| range.member(set, position) as usize);
                let rows = (0..u32::from(range.parity)).map(|row| range.parity_id(set, row) as usize);
                let parity = rows.filter(|&id| have[id]).count();
                if members.clone().filter(|&id| !have[id]).count() <= parity {
                    members.for_each(|id| have[id] = true);
                }
            }
        }
        have
    }

    /// The state in which exactly the packets for which `have` says so are there: see
    /// [`PacketMap::repaired`].
    pub fn state(&self, have: impl Fn(usize) -> bool) -> Vec<u8> {
        let mut state = self.initial.clone();
        let mut whole = std::collections::BTreeMap::new();
        for (id, placements) in self.placements.iter().enumerate() {
            if !have(id) {
                continue;
            }
            for placement in placements {
                match self.profile {
                    Profile::Dgs1 => set(&mut state, placement),
                    Profile::Paper => {
                        whole.entry(placement.group).or_insert((*placement, 0)).1 += placement.symbols;
                    }
                }
            }
        }
        for (group, symbols) in &self.group_symbols {
            if let Some((placement, found)) = whole.get(group)
                && found >= symbols
            {
                set(&mut state, placement);
            }
        }
        state
    }
}

impl PacketMap {
    /// The state in which exactly the groups for which `have` says so are there, each with all its symbols,
    /// whatever packets they share with others.
    pub(crate) fn state_of_groups(&self, have: impl Fn(&Group) -> bool) -> Vec<u8> {
        let mut state = self.initial.clone();
        for placement in self.placements.iter().flatten().filter(|placement| have(&placement.group)) {
            set(&mut state, placement);
        }
        state
    }
}

fn set(state: &mut [u8], placement: &SlicePlacement) {
    for mask in &mut state[placement.first_block..placement.first_block + placement.blocks] {
        *mask = Arrived(*mask).with(placement.group.level).0;
    }
}

#[cfg(test)]
mod tests {
    use codec_core::{Caps, internals::ids::PacketId};
    use rand::RngExt;
    use rand_pcg::Pcg64;

    use super::*;
    use crate::{
        encode::{self, EncodeOptions, Protection},
        import::{
            Limits,
            synth::{self, SynthKind, SynthOptions},
        },
    };

    #[test]
    fn what_is_repaired_is_what_a_receiver_repairs() {
        let options =
            SynthOptions { gaussians: 1000, frames: 4, kind: SynthKind::Balls, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let repair = Protection::parse("base=5+2,tracks=2+1,2=7+1").unwrap();
        let options =
            EncodeOptions { packet_bytes: 200, block_len: 16, pictures: 0, repair, ..Default::default() };
        let stream = encode::encode(&scene, &options, &crate::encode::no_progress).unwrap().stream;
        let map = PacketMap::of(&stream).unwrap();
        let mut rng = Pcg64::new(1, 1);
        let (mut repaired, mut beyond) = (0, 0);
        for loss in [0.02, 0.1, 0.2, 0.3, 0.4, 0.6].repeat(4) {
            let arrived: Vec<bool> = stream.packets().iter().map(|_| rng.random::<f64>() >= loss).collect();
            let mut player = dgs_player::Player::new(stream.message(), &Caps::HOST).unwrap();
            for (packet, _) in stream.packets().iter().zip(&arrived).filter(|(_, arrived)| **arrived) {
                player.push(packet).unwrap();
            }
            let have = map.repaired(|id| arrived[id]);
            for id in (0..arrived.len()).filter(|&id| !map.is_parity(id)) {
                assert_eq!(
                    have[id],
                    player.has(PacketId::new(id as u32).unwrap()),
                    "packet {id} at a loss of {loss}"
                );
                repaired += usize::from(have[id] && !arrived[id]);
                beyond += usize::from(!have[id]);
            }
        }
        assert!(repaired > 20 && beyond > 20, "{repaired} were repaired, {beyond} were not");
    }
}
