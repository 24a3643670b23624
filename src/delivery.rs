//! Connects streams to the emulator: a stream as a packet graph, and the real receiver as an endpoint.

mod places;

use codec_core::{
    Caps, ErrorKind,
    internals::{
        closure::{Arrived, Needs},
        ids::{EpochId, Group, Level, PacketId, Span},
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
/// It has the packets that are there, and the groups that mean something with them; of a stream that lacks
/// nothing, packet `i` of the graph is packet `i` of the stream. Without `utilities` all groups are worth the
/// same. `places` says where they lie.
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
    let parts = graph_parts(stream, manifest, map, utilities, places);
    let has = |packet: PacketIndex| !stream.packets()[packet.at()].is_empty();
    PacketGraph::new(Selection::with_packets(&parts, has).of(&parts))
}

fn graph_parts(
    stream: &Stream,
    manifest: &Manifest<'_>,
    map: &PacketMap,
    utilities: Option<&Table>,
    places: &Places,
) -> GraphParts {
    let mut index = std::collections::BTreeMap::new();
    for (i, (group, _)) in map.groups().iter().enumerate() {
        index.insert(*group, GroupIndex(i as u32));
    }
    let rule = |group: &Group| Needs::in_manifest(manifest, group.span, group.cluster, group.level);
    let needs = |group: &Group| -> Vec<GroupIndex> {
        let Some(needs) = rule(group) else { return Vec::new() };
        let below = needs.below.map(|level| Group { level, ..*group });
        let base = |epoch| Group { span: Span::Canonical(epoch), level: Level::BASE, ..*group };
        // What the level below needs in turn, it says itself.
        let needed = below.or(needs.seen_with.map(base));
        needed.and_then(|needed| index.get(&needed).copied()).into_iter().collect()
    };
    // Which packet brings which block of which cell at which level.
    let mut bringer = std::collections::BTreeMap::new();
    for id in 0..stream.packets().len() {
        for placement in map.placements(id) {
            for block in placement.first_block..placement.first_block + placement.blocks {
                bringer.insert((block, placement.group.level), PacketIndex(id as u32));
            }
        }
    }
    let cells = map.first_blocks();
    let canonical_block = |placement: &SlicePlacement, block: usize| -> Option<usize> {
        let Span::Motion(window) = placement.group.span else { return None };
        let epoch = EpochId(manifest.window(window)?.epoch);
        let own = cells[manifest.cell(placement.group.span, placement.group.cluster)?.index()];
        let base = cells[manifest.cell(Span::Canonical(epoch), placement.group.cluster)?.index()];
        Some(base + block - own)
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
                let Some(needs) = rule(&placement.group) else { continue };
                for block in placement.first_block..placement.first_block + placement.blocks {
                    needs_packets.extend(needs.below.and_then(|level| bringer.get(&(block, level))));
                    if needs.base.is_some()
                        && let Some(base) = canonical_block(placement, block)
                    {
                        needs_packets.extend(bringer.get(&(base, Level::BASE)));
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
            utility: utilities.and_then(|t| t.groups.get(i)).map_or(1.0, |u| u.utility),
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
        profile: if sliced { graph::Profile::Sliced } else { graph::Profile::AllOrNothing },
    }
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

    /// Whether each packet of the stream has arrived or was recovered.
    pub fn arrived(&self) -> Vec<bool> {
        (0..self.stream.packets().len() as u32)
            .map(|id| PacketId::new(id).is_some_and(|id| self.has(id)))
            .collect()
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
                        graph::Profile::Sliced => {
                            placements.iter().all(|m| self.is_usable(&content, m, false))
                        }
                        graph::Profile::AllOrNothing => {
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
