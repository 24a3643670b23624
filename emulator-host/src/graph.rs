//! Describes what is to be delivered, whatever the wire format: packets, groups, and what needs what.
//!
//! A [`PacketGraph`] that exists is consistent: every index is in range, packets and groups name each other,
//! nothing needs itself, and every repair set has parity. So nothing that walks it has an error path.
//!
//! Closure, in the two profiles (paper, "Selective recovery and receiver closure"):
//! - [`ClosureRule::AllOrNothing`]: a group is usable when *all* its packets have arrived and all groups it
//!   needs are usable; a packet is usable when a group that it carries is.
//! - [`ClosureRule::Sliced`]: a packet is usable when it and, recursively, its [`Packet::needs_packets`] have
//!   arrived; a group is usable (complete) when all its packets have arrived and the groups it needs are
//!   usable, and earns utility by usable bytes before. (A packet may carry slices of several groups, so it
//!   can complete one while another still lacks its base.)

pub(crate) mod csr;
mod derive;
mod division;
mod index;
pub(crate) mod pieces;
mod place;
mod selection;
mod synthetic;

use std::{
    collections::BTreeSet,
    sync::{Arc, OnceLock},
};

use codec_core::internals::ids::{Group as GroupId, PacketId, Span};

use self::{csr::Csr, pieces::Division};
use crate::clock::Nanos;

pub use index::{GroupIndex, PacketIndex};
pub use place::{Ball, Place};
pub use selection::Selection;
pub use synthetic::{Dependencies, Synthetic, Utilities};

/// Which closure rule holds. See the module's text.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum ClosureRule {
    /// The paper's rule.
    AllOrNothing,
    /// One packet is one independently usable slice.
    Sliced,
}

/// One datagram's worth of bytes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Packet {
    /// Identifier on the wire; unique.
    pub id: PacketId,
    /// Bytes on the wire without transport overhead, 1 to [`MAX_PACKET_BYTES`].
    pub wire_bytes: u16,
    /// Groups that it carries; empty for a parity packet only.
    pub groups: Vec<GroupIndex>,
    /// Packets without which this one means nothing ([`ClosureRule::Sliced`] only).
    pub needs_packets: Vec<PacketIndex>,
    /// The repair set that this packet is parity of.
    pub parity_of: Option<u32>,
}

/// A completion group: (window or epoch, cluster, level).
#[derive(Clone, Debug, PartialEq)]
pub struct Group {
    /// Which completion group this is, as the wire names it: epoch or window, cluster, level.
    pub id: GroupId,
    /// First frame at which it changes pixels.
    pub first_frame: u32,
    /// Last frame at which it changes pixels, inclusive.
    pub last_frame: u32,
    /// Groups it needs directly.
    pub needs: Vec<GroupIndex>,
    /// Its packets, at least one.
    pub packets: Vec<PacketIndex>,
    /// What it adds per frame shown, as reports count it and all schedulers but the paper's rank by; finite,
    /// may be negative.
    pub utility: f64,
    /// Ũ, the risk-adjusted counterfactual utility per frame shown (paper, "Counterfactual Render Utility"),
    /// which the paper's scheduler ranks by; finite, may be negative.
    pub risk_adjusted: f64,
    /// Where it lies in the scene; `None` where nobody has looked.
    pub place: Option<Place>,
}

impl Group {
    /// 0 = base; higher refines.
    pub const fn level(&self) -> u8 {
        self.id.level.get()
    }

    /// Whether its attributes hold for a whole epoch, rather than for one motion window.
    pub const fn is_canonical(&self) -> bool {
        matches!(self.id.span, Span::Canonical(_))
    }
}

/// Source packets protected by one or more parity packets: any losses among them, up to as many as parity
/// arrives, can be repaired.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RepairSet {
    /// The protected packets.
    pub members: Vec<PacketIndex>,
}

/// The public content of a graph, before it is checked.
#[derive(Clone, Debug, PartialEq)]
pub struct GraphParts {
    /// Packets in any order.
    pub packets: Vec<Packet>,
    /// Groups in any order.
    pub groups: Vec<Group>,
    /// Repair sets; parity packets name them by index.
    pub repair_sets: Vec<RepairSet>,
    /// Number of frames in the playout, at least 1.
    pub frames: u32,
    /// Time from one frame to the next, at least 1 µs.
    pub frame_interval: Nanos,
    /// Bytes of the reliable manifest.
    pub manifest_bytes: u32,
    /// The closure rule.
    pub profile: ClosureRule,
}

/// Most bytes of one packet on the wire.
pub const MAX_PACKET_BYTES: u16 = codec_core::internals::limits::MAX_PACKET_BYTES as u16;
/// Most (group, needed group) pairs that the transitive closures may hold together.
pub const MAX_CLOSURE_ENTRIES: usize = 1 << 24;

/// Why a graph was refused.
#[derive(Clone, Copy, Debug, PartialEq, Eq, thiserror::Error)]
pub enum GraphError {
    /// No frames, or frames closer than 1 µs.
    #[error("playout of {frames} frames every {interval_ns} ns: needs at least 1 frame and 1000 ns")]
    Playout {
        /// Number of frames found.
        frames: u32,
        /// Interval found.
        interval_ns: u64,
    },
    /// A parameter of a synthetic graph that describes none.
    #[error("{field} is {found}, allowed {low} to {high}")]
    Parameter {
        /// Which, as [`Synthetic`] names it.
        field: &'static str,
        /// What it is.
        found: u64,
        /// Least allowed.
        low: u64,
        /// Most allowed.
        high: u64,
    },
    /// An index points outside its table.
    #[error("{what} {index} of {owner} {at} is out of range: {allowed} exist")]
    OutOfRange {
        /// What is named.
        what: &'static str,
        /// The index found.
        index: u32,
        /// Kind of the record that names it.
        owner: &'static str,
        /// Index of that record.
        at: u32,
        /// Length of the table.
        allowed: u32,
    },
    /// A packet is empty or larger than a datagram may be.
    #[error("packet {packet} has {found} bytes, allowed 1 to {MAX_PACKET_BYTES}")]
    PacketBytes {
        /// The packet.
        packet: u32,
        /// Its size.
        found: u16,
    },
    /// Two packets share a wire identifier.
    #[error("packet id {id} is used twice")]
    DuplicateId {
        /// The identifier.
        id: PacketId,
    },
    /// Two groups are the same completion group.
    #[error("groups {first} and {second} are the same (span, cluster, level)")]
    DuplicateGroup {
        /// The first of them.
        first: u32,
        /// The other.
        second: u32,
    },
    /// A packet and a group disagree on whether the one carries the other.
    #[error("packet {packet} and group {group} do not name each other exactly once")]
    Mismatch {
        /// The packet.
        packet: u32,
        /// The group.
        group: u32,
    },
    /// A group has no packets.
    #[error("group {group} has no packets")]
    EmptyGroup {
        /// The group.
        group: u32,
    },
    /// A packet carries nothing and is no parity, or is parity and carries groups.
    #[error("packet {packet} must carry groups or be parity, not both and not neither")]
    Role {
        /// The packet.
        packet: u32,
    },
    /// The frame range is reversed or past the end.
    #[error("group {group} is active on frames {first}..={last}, allowed within 0..{frames}")]
    Frames {
        /// The group.
        group: u32,
        /// First frame found.
        first: u32,
        /// Last frame found.
        last: u32,
        /// Number of frames.
        frames: u32,
    },
    /// The utility is not a finite number.
    #[error("utility of group {group} is not finite")]
    Utility {
        /// The group.
        group: u32,
    },
    /// Groups need each other in a circle.
    #[error("group {group} is part of a dependency cycle")]
    GroupCycle {
        /// One group of the cycle or behind it.
        group: u32,
    },
    /// Packets need each other in a circle.
    #[error("packet {packet} is part of a dependency cycle")]
    PacketCycle {
        /// One packet of the cycle or behind it.
        packet: u32,
    },
    /// A repair set is empty, repeats a member, protects parity, or has no parity packet.
    #[error("repair set {set} must hold distinct media packets and have a parity packet")]
    RepairSet {
        /// The set.
        set: u32,
    },
    /// Chains of dependencies are too deep and wide to hold.
    #[error("transitive closures hold more than {MAX_CLOSURE_ENTRIES} entries")]
    ClosureTooLarge,
}

/// A group's id in one number, in the order of ids: a search compares it in one step.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
struct GroupKey(u64);

impl GroupKey {
    fn of(id: GroupId) -> Self {
        let (kind, span) = match id.span {
            Span::Canonical(epoch) => (0, epoch.0),
            Span::Motion(window) => (1, window.0),
        };
        let cluster = u64::from(id.cluster.0) << 8 | u64::from(id.level.get());
        Self(kind << 40 | u64::from(span) << 24 | cluster)
    }
}

/// A checked graph with what follows from it.
#[derive(Clone, Debug)]
pub struct PacketGraph {
    parts: GraphParts,
    /// What runs ask of single packets and groups lies in tables of its own: the records are large, and a run
    /// touches them in no order.
    packet_ids: Vec<PacketId>,
    packet_bytes: Vec<u16>,
    packet_groups: Csr,
    group_packets: Csr,
    closure: Csr,
    dependents: Csr,
    packet_dependents: Csr,
    sets_of_packet: Csr,
    parity_of_set: Vec<Vec<PacketIndex>>,
    /// Packets and groups in order of what the wire calls them.
    packet_by_id: Vec<(PacketId, PacketIndex)>,
    group_by_id: Vec<(GroupKey, GroupIndex)>,
    group_needed_from: Vec<u32>,
    group_useful_until: Vec<u32>,
    packet_needed_from: Vec<u32>,
    packet_useful_until: Vec<u32>,
    packet_level: Vec<u8>,
    shares_packets: Vec<bool>,
    /// Made by the first run that asks for it; nothing that it follows from changes afterwards.
    division: OnceLock<Arc<Division>>,
}

impl PacketGraph {
    /// What it was made of.
    pub fn parts(&self) -> &GraphParts {
        &self.parts
    }

    /// All packets.
    pub fn packets(&self) -> &[Packet] {
        &self.parts.packets
    }

    /// All groups.
    pub fn groups(&self) -> &[Group] {
        &self.parts.groups
    }

    /// Bytes on the wire of the packets that carry the base of frame 0, each counted once whatever groups it
    /// carries, with `overhead` bytes more per packet.
    pub fn first_base_bytes(&self, overhead: u64) -> u64 {
        let groups = self.groups().iter().filter(|group| group.level() == 0 && group.first_frame == 0);
        let packets: BTreeSet<PacketIndex> = groups.flat_map(|group| &group.packets).copied().collect();
        packets.iter().map(|&packet| u64::from(self.wire_bytes(packet)) + overhead).sum()
    }

    /// All repair sets.
    pub fn repair_sets(&self) -> &[RepairSet] {
        &self.parts.repair_sets
    }

    /// A packet's id on the wire.
    pub fn wire_id(&self, packet: PacketIndex) -> PacketId {
        self.packet_ids[packet.at()]
    }

    /// [`Packet::wire_bytes`].
    pub(crate) fn wire_bytes(&self, packet: PacketIndex) -> u16 {
        self.packet_bytes[packet.at()]
    }

    /// [`Packet::groups`].
    pub(crate) fn groups_of(&self, packet: PacketIndex) -> impl ExactSizeIterator<Item = GroupIndex> + '_ {
        self.packet_groups.row(packet.at()).iter().map(|index| GroupIndex(*index))
    }

    /// [`Group::packets`].
    pub(crate) fn packets_of(
        &self,
        group: GroupIndex,
    ) -> impl ExactSizeIterator<Item = PacketIndex> + Clone + '_ {
        self.group_packets.row(group.at()).iter().map(|index| PacketIndex(*index))
    }

    /// Whether a packet is parity: it carries no group.
    pub(crate) fn is_parity(&self, packet: PacketIndex) -> bool {
        self.packet_groups.row(packet.at()).is_empty()
    }

    /// Packets whose wire ids lie in `first..=last`; cost follows what is found, not the width of the range.
    pub fn packets_in(&self, first: PacketId, last: PacketId) -> impl Iterator<Item = PacketIndex> + '_ {
        // Ids mostly count up from 0, and then an id is its own place.
        let guess = first.get() as usize;
        let start = if self.packet_by_id.get(guess).is_some_and(|(id, _)| *id == first) {
            guess
        } else {
            self.packet_by_id.partition_point(|(id, _)| *id < first)
        };
        self.packet_by_id[start..].iter().take_while(move |(id, _)| *id <= last).map(|(_, index)| *index)
    }

    /// The group with this id, if the graph has it.
    pub fn group_of(&self, id: GroupId) -> Option<GroupIndex> {
        let key = GroupKey::of(id);
        let place = self.group_by_id.binary_search_by_key(&key, |(key, _)| *key).ok()?;
        self.group_by_id.get(place).map(|(_, index)| *index)
    }

    /// Number of frames in the playout.
    pub fn frames(&self) -> u32 {
        self.parts.frames
    }

    /// Time from one frame to the next.
    pub fn frame_interval(&self) -> Nanos {
        self.parts.frame_interval
    }

    /// Bytes of the reliable manifest.
    pub fn manifest_bytes(&self) -> u32 {
        self.parts.manifest_bytes
    }

    /// The closure rule.
    pub fn profile(&self) -> ClosureRule {
        self.parts.profile
    }

    /// `group` and all that it needs, transitively; needed groups first, `group` last.
    pub fn closure(&self, group: GroupIndex) -> impl ExactSizeIterator<Item = GroupIndex> + '_ {
        self.closure.row(group.at()).iter().map(|index| GroupIndex(*index))
    }

    /// Groups that need `group` directly.
    pub fn dependents(&self, group: GroupIndex) -> impl ExactSizeIterator<Item = GroupIndex> + '_ {
        self.dependents.row(group.at()).iter().map(|index| GroupIndex(*index))
    }

    /// Packets that need `packet` directly.
    pub fn packet_dependents(&self, packet: PacketIndex) -> impl ExactSizeIterator<Item = PacketIndex> + '_ {
        self.packet_dependents.row(packet.at()).iter().map(|index| PacketIndex(*index))
    }

    /// Repair sets that `packet` is a member or the parity of.
    pub fn sets_of(&self, packet: PacketIndex) -> &[u32] {
        self.sets_of_packet.row(packet.at())
    }

    /// The parity packets of a repair set, at least one.
    pub fn parity(&self, set: u32) -> &[PacketIndex] {
        &self.parity_of_set[set as usize]
    }

    /// First frame at which `group` or anything that needs it changes pixels: its deadline.
    pub fn group_needed_from(&self, group: GroupIndex) -> u32 {
        self.group_needed_from[group.at()]
    }

    /// Last frame at which `group` or anything that needs it changes pixels: after it, its bytes are waste.
    pub fn group_useful_until(&self, group: GroupIndex) -> u32 {
        self.group_useful_until[group.at()]
    }

    /// Earliest [`Self::group_needed_from`] of what a packet carries or, for parity, protects.
    pub fn needed_from(&self, packet: PacketIndex) -> u32 {
        self.packet_needed_from[packet.at()]
    }

    /// Latest [`Self::group_useful_until`] of what a packet carries or, for parity, protects.
    pub fn useful_until(&self, packet: PacketIndex) -> u32 {
        self.packet_useful_until[packet.at()]
    }

    /// Lowest level that a packet carries or, for parity, protects.
    pub fn level(&self, packet: PacketIndex) -> u8 {
        self.packet_level[packet.at()]
    }

    /// Whether two groups in the closure of `group` share a packet, so that adding up their bytes counts it
    /// twice.
    pub fn closure_shares_packets(&self, group: GroupIndex) -> bool {
        self.shares_packets[group.at()]
    }

    /// Bytes of all packets, parity included.
    pub fn total_bytes(&self) -> u64 {
        self.parts.packets.iter().map(|packet| u64::from(packet.wire_bytes)).sum()
    }
}
