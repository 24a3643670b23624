//! Connects streams to the emulator: a stream as a packet graph, and the real receiver as an endpoint.

mod places;

use std::collections::BTreeMap;

use codec_core::{
    Caps, ErrorKind,
    internals::{
        closure::{Arrived, Needs},
        ids::{Group, Level, PacketId, Span},
        layout::Shape,
        receiver::Content,
        wire::manifest::{Manifest, Profile},
    },
};
use dgs_player::{Player, Waiting};
use emulator_host::{
    Endpoint, GroupIndex, Nanos, PacketGraph, PacketIndex, Snapshot,
    graph::{self, GraphError, GraphParts, RepairSet, Selection},
    receiver::Arrival,
};
use trainer_host::{
    Stream,
    stream::{PacketMap, SlicePlacement},
    utility::Table,
};

pub use self::places::Places;

/// A stream's packets and groups as the emulator sees them.
///
/// It has the packets that are there and show anything, and the groups that mean something with them; of a
/// stream that lacks nothing, packet `i` of the graph is packet `i` of the stream. With `utilities` a group's
/// utility is its expected gain; without, all groups are worth the same. `places` says where they lie.
///
/// # Errors
/// None in practice.
pub fn graph(
    stream: &Stream,
    manifest: &Manifest<'_>,
    map: &PacketMap,
    utilities: Option<&Table>,
    places: &Places,
) -> Result<PacketGraph, GraphError> {
    let brought = Brought::of(stream, manifest, map);
    let parts = graph_parts(stream, manifest, map, utilities, places, &brought);
    let has = |packet: PacketIndex| {
        !stream.packets()[packet.at()].is_empty()
            && (map.is_parity(packet.at()) || brought.shows[packet.at()])
    };
    PacketGraph::new(Selection::with_packets(&parts, has).of(&parts))
}

fn graph_parts(
    stream: &Stream,
    manifest: &Manifest<'_>,
    map: &PacketMap,
    utilities: Option<&Table>,
    places: &Places,
    brought: &Brought,
) -> GraphParts {
    let mut index = BTreeMap::new();
    for (i, (group, _)) in map.groups().iter().enumerate() {
        index.insert(*group, GroupIndex(i as u32));
    }
    let gains = utilities.map(|table| table.expected_gains(stream, map)).unwrap_or_default();
    let rule = |group: &Group| Needs::in_manifest(manifest, group.span, group.cluster, group.level);
    let needs = |group: &Group| -> Vec<GroupIndex> {
        let Some(needs) = rule(group) else { return Vec::new() };
        let below = needs.below.map(|level| Group { level, ..*group });
        let base = |epoch| Group { span: Span::Canonical(epoch), level: Level::BASE, ..*group };
        // What the level below needs in turn, it says itself.
        let needed = below.or(needs.seen_with.map(base));
        needed.and_then(|needed| index.get(&needed).copied()).into_iter().collect()
    };
    let sliced = manifest.profile() == Profile::Dgs1;
    let mut packets = Vec::new();
    for (id, bytes) in stream.packets().iter().enumerate() {
        let mut groups: Vec<GroupIndex> =
            map.placements(id).iter().filter_map(|m| index.get(&m.group).copied()).collect();
        groups.dedup();
        let mut needs_packets = Vec::new();
        if sliced {
            for placement in map.placements(id) {
                for block in placement.first_block..placement.first_block + placement.blocks {
                    if brought.by.contains_key(&(block, placement.group.level)) {
                        let needed = needed_blocks(manifest, map, placement, block);
                        needs_packets.extend(needed.iter().filter_map(|needed| brought.by.get(needed)));
                    }
                }
            }
            needs_packets.sort_unstable();
            needs_packets.dedup();
        }
        packets.push(graph::Packet {
            id: PacketId::new(id as u32).unwrap_or_default(),
            wire_bytes: bytes.len() as u16,
            groups,
            needs_packets,
            parity_of: None,
        });
    }
    let mut repair_sets = Vec::new();
    for repair in manifest.repairs() {
        for set in 0..repair.sets() {
            for row in 0..u32::from(repair.parity) {
                let parity = repair.parity_id(set, row) as usize;
                packets[parity].parity_of = Some(repair_sets.len() as u32);
            }
            let members = (0..repair.members(set)).map(|at| PacketIndex(repair.member(set, at))).collect();
            repair_sets.push(RepairSet { members });
        }
    }
    let mut group_packets: Vec<Vec<PacketIndex>> = vec![Vec::new(); map.groups().len()];
    for (id, packet) in packets.iter().enumerate() {
        for group in &packet.groups {
            group_packets[group.at()].push(PacketIndex(id as u32));
        }
    }
    let groups = map.groups().iter().zip(group_packets).enumerate().map(|(i, ((group, _), packets))| {
        let (first_frame, frames) = coverage(manifest, group.span);
        graph::Group {
            id: *group,
            first_frame,
            last_frame: first_frame + frames.max(1) - 1,
            needs: needs(group),
            packets,
            utility: gains.get(i).copied().unwrap_or(1.0),
            risk_adjusted: utilities.and_then(|t| t.groups.get(i)).map_or(1.0, |u| u.utility),
            place: places.get(group),
        }
    });
    GraphParts {
        groups: groups.collect(),
        packets,
        repair_sets,
        frames: manifest.head().frames,
        frame_interval: Nanos((1e9 / manifest.frames_per_second()).round() as u64),
        manifest_bytes: stream.message().len() as u32,
        profile: if sliced { graph::ClosureRule::Sliced } else { graph::ClosureRule::AllOrNothing },
    }
}

/// A block of Gaussians of one cell, numbered through the stream, at one level.
type BlockLevel = (usize, Level);

/// Which packet carries each level of a block, of the levels that can be usable with what the stream has.
struct Brought {
    by: BTreeMap<BlockLevel, PacketIndex>,
    /// Per packet, whether it brings anything that shows.
    shows: Vec<bool>,
}

impl Brought {
    /// Nothing says what a packet that is not there would have brought: what stands on it is found here by
    /// what it needs.
    fn of(stream: &Stream, manifest: &Manifest<'_>, map: &PacketMap) -> Self {
        let count = stream.packets().len();
        if manifest.profile() != Profile::Dgs1 {
            return Self { by: BTreeMap::new(), shows: vec![true; count] };
        }
        let mut slices: Vec<(usize, &SlicePlacement)> = (0..count)
            .flat_map(|id| map.placements(id).iter().map(move |placement| (id, placement)))
            .collect();
        // What is needed comes before what needs it.
        slices.sort_by_key(|(_, placement)| {
            (matches!(placement.group.span, Span::Motion(_)), placement.group.level)
        });
        let (mut by, mut shows) = (BTreeMap::new(), vec![false; count]);
        for (id, placement) in slices {
            for block in placement.first_block..placement.first_block + placement.blocks {
                let needed = needed_blocks(manifest, map, placement, block);
                if needed.iter().all(|needed| by.contains_key(needed)) {
                    by.insert((block, placement.group.level), PacketIndex(id as u32));
                    shows[id] = true;
                }
            }
        }
        Self { by, shows }
    }
}

/// What `block` of `placement` needs besides itself, to be decoded.
fn needed_blocks(
    manifest: &Manifest<'_>,
    map: &PacketMap,
    placement: &SlicePlacement,
    block: usize,
) -> Vec<BlockLevel> {
    let Group { span, cluster, level } = placement.group;
    let Some(needs) = Needs::in_manifest(manifest, span, cluster, level) else { return Vec::new() };
    let first_block = |span| Some(map.first_blocks()[manifest.cell(span, cluster)?.index()]);
    let base = needs.base.and_then(|epoch| {
        let own = first_block(span)?;
        Some((first_block(Span::Canonical(epoch))? + block - own, Level::BASE))
    });
    needs.below.map(|level| (block, level)).into_iter().chain(base).collect()
}

/// First frame and frames of a span.
pub(crate) fn coverage(manifest: &Manifest<'_>, span: Span) -> (u32, u32) {
    match span {
        Span::Canonical(id) => {
            let epoch = manifest.epoch(id).unwrap_or_default();
            (epoch.first_frame, epoch.frames)
        }
        Span::Motion(id) => {
            let window = manifest.window(id).unwrap_or_default();
            (window.first_frame, u32::from(window.frames))
        }
    }
}

/// What was usable when one frame was shown.
#[derive(Clone, Debug)]
pub struct ShownState {
    /// The frame.
    pub frame: u32,
    /// Arrival masks, as [`Content::with_state`] takes them.
    pub state: Vec<u8>,
}

/// The real no_std receiver behind the emulator's endpoint: every packet's bytes are parsed,
/// checked and decoded.
pub struct WireEndpoint<'e> {
    /// Until the manifest is complete.
    waiting: Option<Waiting>,
    /// From then on.
    player: Option<Player>,
    stream: &'e Stream,
    map: &'e PacketMap,
    graph: &'e PacketGraph,
    snapshot: Snapshot,
    first_blocks: &'e [usize],
    buffered: Vec<PacketIndex>,
    /// The state at each shown frame, in playout order.
    pub shown: Vec<ShownState>,
}

impl<'e> WireEndpoint<'e> {
    /// An endpoint that keeps up to `early_bytes` of media until the manifest is complete.
    ///
    /// # Errors
    /// If there is no memory of that size.
    pub fn new(
        early_bytes: usize,
        stream: &'e Stream,
        map: &'e PacketMap,
        graph: &'e PacketGraph,
    ) -> codec_core::Result<Self> {
        let early_bytes = u32::try_from(early_bytes).unwrap_or(u32::MAX);
        Ok(Self {
            waiting: Some(Waiting::new(Caps { early_bytes, ..Caps::HOST })?),
            player: None,
            stream,
            map,
            graph,
            snapshot: Snapshot::empty(graph),
            first_blocks: map.first_blocks(),
            buffered: Vec::new(),
            shown: Vec::new(),
        })
    }

    /// Whether each packet of the stream has arrived or was recovered; `None` before the manifest is
    /// complete.
    pub fn arrived(&self) -> Option<Vec<bool>> {
        let player = self.player.as_ref()?;
        let ids = (0..self.stream.packets().len() as u32).map(PacketId::new);
        Some(ids.map(|id| id.is_some_and(|id| player.has(id))).collect())
    }

    fn has(&self, id: PacketId) -> bool {
        self.player.as_ref().is_some_and(|player| player.has(id))
    }

    /// The packets of the graph, and how the wire names them.
    fn packets(&self) -> impl Iterator<Item = (PacketIndex, PacketId)> + use<'e> {
        let graph = self.graph;
        (0..graph.packets().len() as u32).map(PacketIndex).map(move |packet| (packet, graph.wire_id(packet)))
    }

    /// Whether all blocks of `placement` are usable up to its level, and for motion coefficients the
    /// blocks they bend are there.
    fn is_usable(&self, content: &Content<'_>, placement: &SlicePlacement, whole_cell: bool) -> bool {
        let manifest = content.manifest;
        let Some(cell) = manifest.cell(placement.group.span, placement.group.cluster) else { return false };
        let own = self.first_blocks[cell.index()];
        let blocks = if whole_cell {
            let shape = Shape::of(manifest, placement.group.span, placement.group.cluster);
            own..own + shape.map_or(0, |s| s.blocks())
        } else {
            placement.first_block..placement.first_block + placement.blocks
        };
        let usable = |block: usize| Arrived(content.blocks.get(block).copied().unwrap_or(0)).usable();
        if !blocks.clone().all(|b| usable(b) > placement.group.level.index()) {
            return false;
        }
        let group = &placement.group;
        let needs = Needs::in_manifest(manifest, group.span, group.cluster, group.level).unwrap_or_default();
        // A track alone needs nothing to be decoded; to complete its group the base must be there.
        let Some(epoch) = (if whole_cell { needs.seen_with } else { needs.base }) else { return true };
        let base = manifest.cell(Span::Canonical(epoch), placement.group.cluster);
        base.is_some_and(|base| {
            let base = self.first_blocks[base.index()];
            blocks.clone().all(|b| usable(base + b - own) > 0)
        })
    }
}

impl Endpoint for WireEndpoint<'_> {
    fn control(&mut self, _bytes: usize, complete: bool, recovered: &mut Vec<PacketIndex>) {
        let Some(waiting) = self.waiting.take_if(|_| complete) else { return };
        match waiting.manifest(self.stream.message()) {
            Err((waiting, _)) => self.waiting = Some(waiting),
            Ok(player) => {
                self.player = Some(player);
                let early = std::mem::take(&mut self.buffered);
                // Everything known now that had not arrived by itself was recovered from parity.
                let came = self.packets().filter(|(packet, id)| self.has(*id) && !early.contains(packet));
                recovered.extend(came.map(|(packet, _)| packet));
            }
        }
    }

    fn media(&mut self, packet: PacketIndex, _now: Nanos, recovered: &mut Vec<PacketIndex>) -> Arrival {
        let bytes = &self.stream.packets()[self.graph.wire_id(packet).index()];
        if let Some(player) = &mut self.player {
            return match player.push(bytes) {
                Ok(accepted) => {
                    let graph = self.graph;
                    let here = |id: PacketId| graph.packets_in(id, id);
                    recovered.extend(accepted.recovered.iter().flat_map(here));
                    Arrival::Fresh
                }
                Err(error) if error.kind == ErrorKind::Duplicate => Arrival::Duplicate,
                Err(_) => Arrival::Refused,
            };
        }
        match self.waiting.as_mut().map(|waiting| waiting.push(bytes)) {
            Some(Ok(())) if self.buffered.contains(&packet) => Arrival::Duplicate,
            Some(Ok(())) => {
                self.buffered.push(packet);
                Arrival::Buffered
            }
            Some(Err(_)) | None => Arrival::Refused,
        }
    }

    fn snapshot(&mut self, frame: u32) -> &Snapshot {
        let mut snapshot = Snapshot::empty(self.graph);
        if let Some(content) = self.player.as_ref().map(Player::content) {
            for (group, symbols) in self.map.groups() {
                let Some(index) = self.graph.group_of(*group) else { continue };
                let placement =
                    SlicePlacement { group: *group, first_block: 0, blocks: 0, symbols: *symbols };
                let needs = &self.graph.groups()[index.at()].needs;
                if needs.iter().all(|&n| snapshot.has_group(n)) && self.is_usable(&content, &placement, true)
                {
                    snapshot.insert_group(index);
                }
            }
            for (packet, id) in self.packets() {
                let placements = self.map.placements(id.index());
                if !placements.is_empty() && self.has(id) {
                    let usable = match self.graph.profile() {
                        graph::ClosureRule::Sliced => {
                            placements.iter().all(|m| self.is_usable(&content, m, false))
                        }
                        graph::ClosureRule::AllOrNothing => {
                            self.graph.packets()[packet.at()].groups.iter().any(|&g| snapshot.has_group(g))
                        }
                    };
                    if usable {
                        snapshot.insert_packet(packet);
                    }
                }
            }
            // Frame 0 is requested again and again until playout starts; the last answer is what is shown.
            if self.shown.last().is_some_and(|s| s.frame == frame) {
                self.shown.pop();
            }
            self.shown.push(ShownState { frame, state: content.blocks.to_vec() });
        }
        self.snapshot = snapshot;
        &self.snapshot
    }
}

#[cfg(test)]
mod tests {
    use std::collections::BTreeSet;

    use trainer_host::{
        encode::{self, EncodeOptions},
        import::{
            Limits,
            synth::{self, SynthKind, SynthOptions},
        },
    };

    use super::*;

    /// Packets of which the receiver, which has all that `stream` has, shows anything.
    fn shown_by_a_receiver(stream: &Stream, map: &PacketMap) -> BTreeSet<usize> {
        let received = stream.receive().unwrap();
        let content = received.content();
        let usable = |block: usize| Arrived(content.blocks[block]).usable();
        let shows = |placement: &SlicePlacement| {
            let Group { span, cluster, level } = placement.group;
            let base = Needs::in_manifest(content.manifest, span, cluster, level).unwrap().base;
            let first = |span| map.first_blocks()[content.manifest.cell(span, cluster).unwrap().index()];
            (placement.first_block..placement.first_block + placement.blocks).any(|block| {
                let bends = base.map(|epoch| first(Span::Canonical(epoch)) + block - first(span));
                usable(block) > level.index() && bends.is_none_or(|base| usable(base) > 0)
            })
        };
        let shown = (0..stream.packets().len()).filter(|&id| map.placements(id).iter().any(shows));
        shown.collect()
    }

    #[test]
    fn a_graph_has_what_a_receiver_would_show() {
        let kind = SynthKind::from_name("figure").unwrap();
        let options = SynthOptions { kind, gaussians: 3000, frames: 20, ..SynthOptions::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let coding = EncodeOptions { window_frames: Some(10), pictures: 0, ..EncodeOptions::default() };
        let whole = encode::encode(&scene, &coding, &encode::no_progress).unwrap().stream;
        let map = PacketMap::of(&whole).unwrap();
        let mut useless = 0;
        for missing in 0..whole.packets().len() {
            let stream = whole.with_packets(|id| id != missing);
            let map = PacketMap::of(&stream).unwrap();
            let graph = graph(&stream, &stream.manifest().unwrap(), &map, None, &Places::default()).unwrap();
            let found: BTreeSet<usize> =
                (0..graph.packets().len() as u32).map(|at| graph.wire_id(PacketIndex(at)).index()).collect();
            assert_eq!(found, shown_by_a_receiver(&stream, &map), "without packet {missing}");
            useless += whole.packets().len() - 1 - found.len();
        }
        assert!(useless > 0, "some packets stand on one other alone: {} packets", map.first_blocks().len());
    }
}
