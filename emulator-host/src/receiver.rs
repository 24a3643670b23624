//! Records what has arrived, and says what of it can be shown.
//!
//! [`Endpoint`] is what a session needs of a receiver. [`GraphReceiver`] implements it over the graph alone;
//! a receiver that owns real bytes implements it too, and the two must agree on every snapshot.

use crate::{
    clock::Nanos,
    graph::{ClosureRule, GroupIndex, PacketGraph, PacketIndex},
    repair::Repair,
};

/// What became of an arriving media packet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Arrival {
    /// New, and entered.
    Fresh,
    /// Known before, arrived or recovered.
    Duplicate,
    /// New, and kept until the manifest is complete.
    Buffered,
    /// New, and thrown away: the buffer before the manifest is full.
    Refused,
}

/// What can be shown at one moment. Bit `i % 64` of word `i / 64` is index `i`; what lies past the last word
/// is not there.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Snapshot {
    /// Groups whose closure is complete.
    pub groups: Vec<u64>,
    /// Packets that are part of what can be shown.
    pub packets: Vec<u64>,
}

impl Snapshot {
    /// Nothing can be shown.
    pub fn empty(graph: &PacketGraph) -> Self {
        Self {
            groups: vec![0; graph.groups().len().div_ceil(64)],
            packets: vec![0; graph.packets().len().div_ceil(64)],
        }
    }

    /// Whether a group's closure is complete.
    pub fn has_group(&self, group: GroupIndex) -> bool {
        has(&self.groups, group.at())
    }

    /// Whether a packet is part of what can be shown.
    pub fn has_packet(&self, packet: PacketIndex) -> bool {
        has(&self.packets, packet.at())
    }

    /// Marks a group.
    pub fn insert_group(&mut self, group: GroupIndex) {
        insert(&mut self.groups, group.at());
    }

    /// Marks a packet.
    pub fn insert_packet(&mut self, packet: PacketIndex) {
        insert(&mut self.packets, packet.at());
    }
}

fn has(words: &[u64], index: usize) -> bool {
    words.get(index / 64).is_some_and(|word| word >> (index % 64) & 1 == 1)
}

fn insert(words: &mut Vec<u64>, index: usize) {
    if words.len() <= index / 64 {
        words.resize(index / 64 + 1, 0);
    }
    words[index / 64] |= 1 << (index % 64);
}

/// Enters the bits of `now` into `before`, and calls `on_fresh` with the index of each new one, ascending.
pub(crate) fn take_fresh(before: &mut [u64], now: &[u64], mut on_fresh: impl FnMut(u32)) {
    // From one frame to the next few words change, and they lie together.
    const SPAN: usize = 16;
    for (span, (before, now)) in before.chunks_mut(SPAN).zip(now.chunks(SPAN)).enumerate() {
        if before == now {
            continue;
        }
        for (word, (before, now)) in before.iter_mut().zip(now).enumerate() {
            let mut fresh = now & !*before;
            *before |= now;
            while fresh != 0 {
                on_fresh((span * SPAN + word) as u32 * 64 + fresh.trailing_zeros());
                fresh &= fresh - 1;
            }
        }
    }
}

/// A receiver, as a session sees it. Packets are indices; whoever implements this may own their bytes.
pub trait Endpoint {
    /// `bytes_received` distinct bytes of the control stream have arrived so far; `complete` once all have,
    /// so that the manifest can be read. Called with `complete` exactly once, and not again after it. Packets
    /// that become known now are pushed to `recovered`.
    fn control(&mut self, bytes_received: usize, complete: bool, recovered: &mut Vec<PacketIndex>);

    /// `packet` arrives at `now`, parity packets and duplicates included. Packets that repair makes known are
    /// pushed to `recovered`.
    fn media(&mut self, packet: PacketIndex, now: Nanos, recovered: &mut Vec<PacketIndex>) -> Arrival;

    /// What can be shown of `frame` now. What was usable once stays usable; before the manifest is complete
    /// nothing is.
    fn snapshot(&mut self, frame: u32) -> &Snapshot;
}

/// A receiver that knows the graph and no bytes. Each arrival costs the edges it completes, so a run is
/// linear in the graph.
#[derive(Debug)]
pub struct GraphReceiver<'a> {
    graph: &'a PacketGraph,
    manifest: bool,
    buffer: Vec<PacketIndex>,
    buffer_limit: usize,
    arrived: Vec<bool>,
    repair: Repair,
    /// Packets and needed groups that each group lacks.
    group_lacks: Vec<u32>,
    /// Itself and needed packets that each packet lacks ([`ClosureRule::Sliced`]).
    packet_lacks: Vec<u32>,
    snapshot: Snapshot,
    work: Vec<PacketIndex>,
    ready: Vec<PacketIndex>,
    ready_groups: Vec<GroupIndex>,
}

impl<'a> GraphReceiver<'a> {
    /// Media packets kept before the manifest is complete, by default.
    pub const BUFFER_LIMIT: usize = 4096;

    /// Nothing has arrived. At most `buffer_limit` packets are kept before the manifest is complete.
    pub fn new(graph: &'a PacketGraph, buffer_limit: usize) -> Self {
        let group_lacks = graph.groups().iter().map(|group| (group.packets.len() + group.needs.len()) as u32);
        let packet_lacks = graph.packets().iter().map(|packet| packet.needs_packets.len() as u32 + 1);
        Self {
            graph,
            manifest: false,
            buffer: Vec::new(),
            buffer_limit,
            arrived: vec![false; graph.packets().len()],
            repair: Repair::new(graph),
            group_lacks: group_lacks.collect(),
            packet_lacks: packet_lacks.collect(),
            snapshot: Snapshot::empty(graph),
            work: Vec::new(),
            ready: Vec::new(),
            ready_groups: Vec::new(),
        }
    }

    /// Whether a packet has arrived or was recovered.
    pub fn has_arrived(&self, packet: PacketIndex) -> bool {
        self.arrived[packet.at()]
    }

    /// Enters a new packet and all that repair makes of it.
    fn enter(&mut self, packet: PacketIndex, recovered: &mut Vec<PacketIndex>) {
        self.work.push(packet);
        while let Some(packet) = self.work.pop() {
            let work = &mut self.work;
            let arrived = &mut self.arrived;
            self.repair.on_packet(self.graph, packet, |found| {
                if !std::mem::replace(&mut arrived[found.at()], true) {
                    recovered.push(found);
                    work.push(found);
                }
            });
            self.packet_counts_for_groups(packet);
            if self.graph.profile() == ClosureRule::Sliced {
                self.packet_lacks_one_less(packet);
            }
        }
    }

    fn packet_lacks_one_less(&mut self, packet: PacketIndex) {
        self.ready.push(packet);
        while let Some(packet) = self.ready.pop() {
            self.packet_lacks[packet.at()] -= 1;
            if self.packet_lacks[packet.at()] > 0 {
                continue;
            }
            if !self.graph.is_parity(packet) {
                self.snapshot.insert_packet(packet);
            }
            self.ready.extend(self.graph.packet_dependents(packet));
        }
    }

    fn packet_counts_for_groups(&mut self, packet: PacketIndex) {
        let graph = self.graph;
        for group in graph.groups_of(packet) {
            self.group_lacks_one_less(group);
        }
    }

    fn group_lacks_one_less(&mut self, group: GroupIndex) {
        let graph = self.graph;
        self.group_lacks[group.at()] -= 1;
        if self.group_lacks[group.at()] > 0 {
            return;
        }
        self.ready_groups.push(group);
        while let Some(group) = self.ready_groups.pop() {
            self.snapshot.insert_group(group);
            if graph.profile() == ClosureRule::AllOrNothing {
                for packet in graph.packets_of(group) {
                    self.snapshot.insert_packet(packet);
                }
            }
            for dependent in graph.dependents(group) {
                self.group_lacks[dependent.at()] -= 1;
                if self.group_lacks[dependent.at()] == 0 {
                    self.ready_groups.push(dependent);
                }
            }
        }
    }
}

impl Endpoint for GraphReceiver<'_> {
    fn control(&mut self, _bytes_received: usize, complete: bool, recovered: &mut Vec<PacketIndex>) {
        if complete && !self.manifest {
            self.manifest = true;
            for packet in std::mem::take(&mut self.buffer) {
                self.enter(packet, recovered);
            }
        }
    }

    fn media(&mut self, packet: PacketIndex, _now: Nanos, recovered: &mut Vec<PacketIndex>) -> Arrival {
        if self.arrived[packet.at()] {
            return Arrival::Duplicate;
        }
        if !self.manifest && self.buffer.len() >= self.buffer_limit {
            return Arrival::Refused;
        }
        self.arrived[packet.at()] = true;
        if self.manifest {
            self.enter(packet, recovered);
            Arrival::Fresh
        } else {
            self.buffer.push(packet);
            Arrival::Buffered
        }
    }

    fn snapshot(&mut self, _frame: u32) -> &Snapshot {
        &self.snapshot
    }
}

/// The closure by its definition, recomputed from what has arrived: slow and obvious.
#[doc(hidden)]
pub fn naive_snapshot(graph: &PacketGraph, has_arrived: impl Fn(PacketIndex) -> bool) -> Snapshot {
    let mut snapshot = Snapshot::empty(graph);
    let everything = (0..graph.packets().len() as u32).map(PacketIndex);
    let packet_usable = |packet: PacketIndex| {
        let mut open = vec![packet];
        let mut complete = true;
        while let Some(packet) = open.pop() {
            complete &= has_arrived(packet);
            open.extend(&graph.packets()[packet.at()].needs_packets);
        }
        complete
    };
    for (at, _) in graph.groups().iter().enumerate() {
        let group = GroupIndex(at as u32);
        let mut packets =
            graph.closure(group).flat_map(|member| graph.groups()[member.at()].packets.iter().copied());
        if packets.all(&has_arrived) {
            snapshot.insert_group(group);
        }
    }
    for packet in everything {
        let facts = &graph.packets()[packet.at()];
        let shown = match graph.profile() {
            ClosureRule::AllOrNothing => facts.groups.iter().any(|group| snapshot.has_group(*group)),
            ClosureRule::Sliced => facts.parity_of.is_none() && packet_usable(packet),
        };
        if shown {
            snapshot.insert_packet(packet);
        }
    }
    snapshot
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Synthetic;
    use crate::rng::stream;

    fn shuffled(graph: &PacketGraph, seed: u64) -> Vec<PacketIndex> {
        let mut random = stream(seed, "shuffle");
        let mut packets: Vec<PacketIndex> = (0..graph.packets().len() as u32).map(PacketIndex).collect();
        for at in (1..packets.len()).rev() {
            packets.swap(at, random.up_to(at as u64) as usize);
        }
        packets
    }

    #[test]
    fn incremental_closure_equals_the_definition_in_any_order() {
        for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
            for repair in [None, Some(4)] {
                let spec = Synthetic { frames: 60, clusters: 6, profile, repair, ..Synthetic::default() };
                for seed in 0..4 {
                    let graph = spec.build(seed).unwrap();
                    let mut receiver = GraphReceiver::new(&graph, usize::MAX);
                    let mut recovered = Vec::new();
                    for (at, packet) in shuffled(&graph, seed).into_iter().enumerate() {
                        if at == 20 {
                            assert_eq!(*receiver.snapshot(0), Snapshot::empty(&graph));
                            receiver.control(8192, true, &mut recovered);
                        }
                        receiver.media(packet, Nanos::ZERO, &mut recovered);
                        if at >= 20 && at % 16 == 0 {
                            let expected = naive_snapshot(&graph, |packet| receiver.has_arrived(packet));
                            assert_eq!(*receiver.snapshot(0), expected);
                        }
                    }
                    assert_eq!(recovered.is_empty(), repair.is_none());
                    assert!(
                        (0..graph.groups().len() as u32)
                            .all(|g| receiver.snapshot(0).has_group(GroupIndex(g)))
                    );
                }
            }
        }
    }

    #[test]
    fn a_snapshot_without_words_has_nothing_and_takes_anything() {
        let mut snapshot = Snapshot::default();
        assert!(!snapshot.has_group(GroupIndex(0)) && !snapshot.has_packet(PacketIndex(700)));
        snapshot.insert_group(GroupIndex(70));
        snapshot.insert_packet(PacketIndex(3));
        assert!(snapshot.has_group(GroupIndex(70)) && !snapshot.has_group(GroupIndex(6)));
        assert!(snapshot.has_packet(PacketIndex(3)) && !snapshot.has_packet(PacketIndex(67)));
    }

    #[test]
    fn fresh_bits_are_passed_on_once_in_order_and_what_is_gone_stays() {
        let (mut before, mut now) = (vec![0u64; 40], vec![0u64; 40]);
        let mut fresh_of = |now: &[u64]| {
            let mut fresh = Vec::new();
            take_fresh(&mut before, now, |index| fresh.push(index));
            fresh
        };
        now[39] = 1 << 63;
        now[0] = 0b101;
        assert_eq!(fresh_of(&now), [0, 2, 2559]);
        assert!(fresh_of(&now).is_empty());
        now[0] = 0b110;
        assert_eq!(fresh_of(&now), [1]);
        now[0] = 0b111;
        assert!(fresh_of(&now).is_empty());
    }

    #[test]
    fn as_many_losses_per_set_as_parity_are_repaired_and_one_more_is_not() {
        for parity in 1..=3 {
            let spec = Synthetic { frames: 30, clusters: 8, repair: Some(4), parity, ..Synthetic::default() };
            let graph = spec.build(1).unwrap();
            let members = &graph.repair_sets()[0].members;
            let parity = parity as usize;
            for lost in 1..=4 {
                let mut receiver = GraphReceiver::new(&graph, 0);
                let mut recovered = Vec::new();
                receiver.control(8192, true, &mut recovered);
                assert_eq!(graph.parity(0).len(), parity);
                for packet in members[lost..].iter().chain(graph.parity(0)) {
                    assert_eq!(receiver.media(*packet, Nanos::ZERO, &mut recovered), Arrival::Fresh);
                }
                assert_eq!(recovered.len(), if lost <= parity { lost } else { 0 });
                let again = receiver.media(members[0], Nanos::ZERO, &mut recovered);
                assert_eq!(again == Arrival::Duplicate, lost <= parity);
                assert_eq!(
                    recovered.len(),
                    if lost <= parity + 1 { lost - usize::from(lost > parity) } else { 0 }
                );
            }
        }
    }

    #[test]
    fn media_before_the_manifest_is_bounded() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let mut receiver = GraphReceiver::new(&graph, 2);
        let mut arrive = |packet| receiver.media(PacketIndex(packet), Nanos::ZERO, &mut Vec::new());
        assert_eq!(
            [arrive(0), arrive(0), arrive(1), arrive(2)],
            [Arrival::Buffered, Arrival::Duplicate, Arrival::Buffered, Arrival::Refused]
        );
    }
}
