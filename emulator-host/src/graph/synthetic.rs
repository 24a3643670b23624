//! Makes seeded graphs for tests, benches and demos.
//!
//! Shape: a canonical stack of levels per cluster over the whole clip, and a motion stack per (window,
//! cluster). A level needs the level below it and, for motion, the canonical group of its own level. Sizes
//! double with the level, as refinements cost more than they show.

use codec_core::internals::ids::{ClusterId, EpochId, Group as GroupId, Level, PacketId, Span, WindowId};

use super::{
    ClosureRule, GraphError, GraphParts, Group, GroupIndex, Packet, PacketGraph, PacketIndex, RepairSet,
};
use crate::{
    clock::{Nanos, Rate},
    rng::{RandomStream, stream},
};

/// How utilities are drawn.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Utilities {
    /// The same for all groups.
    Flat,
    /// Heavy-tailed over clusters, falling with the level; a tenth of the finest level is negative, as
    /// measured in the paper.
    Unequal,
}

/// What groups need.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Dependencies {
    /// Every level needs the level below it, and motion the canonical group of its level.
    Layered,
    /// Nothing needs anything.
    Independent,
}

/// Parameters of a synthetic graph. [`Synthetic::build`] turns them into a [`PacketGraph`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Synthetic {
    /// Frames in the clip, at least 1.
    pub frames: u32,
    /// Time between frames.
    pub frame_interval: Nanos,
    /// Frames per motion window, at least 1; of windows there may be 65,536.
    pub window_frames: u32,
    /// Clusters, 1 to 65,536.
    pub clusters: u32,
    /// Levels, 1 to 4.
    pub levels: u8,
    /// Mean media rate of the whole graph over the clip, parity excluded.
    pub rate: Rate,
    /// Part of the bytes that is canonical, in percent, 0 to 100.
    pub canonical_percent: u8,
    /// Largest packet, at least 1 byte.
    pub packet_bytes: u16,
    /// Bytes of the manifest.
    pub manifest_bytes: u32,
    /// Utilities.
    pub utilities: Utilities,
    /// Parity for every so many base packets, interleaved over clusters; `None` for no repair.
    pub repair: Option<u32>,
    /// Parity packets of each repair set, at most 255.
    pub parity: u32,
    /// Closure rule.
    pub profile: ClosureRule,
    /// What groups need.
    pub dependencies: Dependencies,
}

impl Default for Synthetic {
    /// 30 s at 30 frames/s, 1 s windows, 32 clusters of 4 levels, 5 Mbit/s, a tenth of it canonical.
    fn default() -> Self {
        Self {
            frames: 900,
            frame_interval: Nanos(33_333_333),
            window_frames: 30,
            clusters: 32,
            levels: 4,
            rate: Rate::from_mbps(5),
            canonical_percent: 10,
            packet_bytes: 1150,
            manifest_bytes: 8192,
            utilities: Utilities::Unequal,
            repair: None,
            parity: 1,
            profile: ClosureRule::AllOrNothing,
            dependencies: Dependencies::Layered,
        }
    }
}

impl Synthetic {
    /// The graph of these parameters and `seed`.
    ///
    /// # Errors
    /// [`GraphError`] if the parameters describe none, such as zero frames or an oversized packet, or one of
    /// more than 16,777,216 packets.
    pub fn build(&self, seed: u64) -> Result<PacketGraph, GraphError> {
        self.check()?;
        let clip = self.frame_interval.times(u64::from(self.frames));
        let media = self.rate.bytes_in(clip).0;
        let canonical = media * u64::from(self.canonical_percent) / 100;
        let windows = self.windows();
        let stack = u64::from(self.clusters) * ((1 << self.levels) - 1);
        let mut draft = Draft {
            spec: self,
            sizes: stream(seed, "synthetic sizes"),
            utilities: stream(seed, "synthetic utilities"),
            packets: Vec::new(),
            groups: Vec::new(),
        };
        let weights: Vec<f64> = (0..self.clusters).map(|_| draft.weight()).collect();
        for (cluster, weight) in weights.iter().enumerate() {
            let last = self.frames.saturating_sub(1);
            draft.stack(Span::Canonical(EpochId(0)), cluster, *weight, (0, last), canonical / stack);
        }
        for window in 0..windows as u32 {
            let first = window * self.window_frames;
            let last = first.saturating_add(self.window_frames - 1).min(self.frames.saturating_sub(1));
            for (cluster, weight) in weights.iter().enumerate() {
                let span = Span::Motion(WindowId(window as u16));
                let base_bytes = (media - canonical) / stack / windows;
                draft.stack(span, cluster, *weight, (first, last), base_bytes);
            }
        }
        let repair_sets = draft.protect();
        let Draft { packets, groups, .. } = draft;
        PacketGraph::new(GraphParts {
            packets,
            groups,
            repair_sets,
            frames: self.frames,
            frame_interval: self.frame_interval,
            manifest_bytes: self.manifest_bytes,
            profile: self.profile,
        })
    }

    /// Motion windows of the clip.
    fn windows(&self) -> u64 {
        u64::from(self.frames.div_ceil(self.window_frames)).max(1)
    }

    /// Refuses what is no graph, and before anything is made of it one that would surely have more packets
    /// than there are ids.
    fn check(&self) -> Result<(), GraphError> {
        let within = |field, found: u64, low: u64, high: u64| {
            if (low..=high).contains(&found) {
                return Ok(());
            }
            Err(GraphError::Parameter { field, found, low, high })
        };
        const IDS: u64 = PacketId::MAX as u64 + 1;
        within("window_frames", self.window_frames.into(), 1, u32::MAX.into())?;
        within("clusters", self.clusters.into(), 1, 1 << 16)?;
        within("levels", self.levels.into(), 1, Level::COUNT as u64)?;
        within("canonical_percent", self.canonical_percent.into(), 0, 100)?;
        within("packet_bytes", self.packet_bytes.into(), 1, u16::MAX.into())?;
        within("windows (frames / window_frames)", self.windows(), 1, 1 << 16)?;
        let groups = (self.windows() + 1) * u64::from(self.clusters) * u64::from(self.levels);
        within("groups (clusters x levels x windows)", groups, 1, IDS)?;
        let media = self.rate.bytes_in(self.frame_interval.times(self.frames.into())).0;
        let size = u64::from(self.packet_bytes);
        let packets = (media / size).max(groups * MIN_GROUP_BYTES.div_ceil(size));
        within("packets (rate x frames x frame_interval / packet_bytes)", packets, 0, IDS)?;
        within("parity", self.parity.into(), 0, 255)?;
        // Only the base is protected; each of its groups has so many packets at least.
        let bases = groups / u64::from(self.levels) * MIN_GROUP_BYTES.div_ceil(size);
        let sets = self.repair.filter(|set| *set > 0).map_or(0, |set| bases.div_ceil(u64::from(set)));
        within("parity packets", sets * u64::from(self.parity), 0, IDS)
    }
}

/// Bytes of the smallest group.
const MIN_GROUP_BYTES: u64 = 40;

/// The wire id of packet `index`. Past the largest id they repeat, which the graph refuses.
fn wire_id(index: usize) -> PacketId {
    PacketId::new((index as u32).min(PacketId::MAX)).unwrap_or_default()
}

struct Draft<'a> {
    spec: &'a Synthetic,
    sizes: RandomStream,
    utilities: RandomStream,
    packets: Vec<Packet>,
    groups: Vec<Group>,
}

impl Draft<'_> {
    /// Between 1/16 and 16, by squaring a uniform exponent-like draw.
    fn weight(&mut self) -> f64 {
        let unit = self.utilities.up_to(1_000_000) as f64 / 1e6;
        0.0625 + 15.9 * unit * unit * unit
    }

    /// All levels of one cluster in one span. `frames`: the first and last it shows in.
    fn stack(&mut self, span: Span, cluster: usize, weight: f64, frames: (u32, u32), base_bytes: u64) {
        let clusters = self.spec.clusters as usize;
        let levels = usize::from(self.spec.levels);
        for level in 0..self.spec.levels {
            let at = self.groups.len();
            let mut needs = Vec::new();
            let layered = self.spec.dependencies == Dependencies::Layered;
            if layered && level > 0 {
                needs.push(GroupIndex(at as u32 - 1));
            }
            if layered && matches!(span, Span::Motion(_)) {
                needs.push(GroupIndex((cluster % clusters * levels + usize::from(level)) as u32));
            }
            let mean = base_bytes << level;
            let bytes = (mean / 2 + self.sizes.up_to(mean)).max(MIN_GROUP_BYTES);
            let packets = self.split(bytes, GroupIndex(at as u32), &needs);
            let jitter = 0.5 + self.utilities.up_to(1_000_000) as f64 / 1e6;
            let finest = level > 0 && level + 1 == self.spec.levels;
            let sign = if finest && self.utilities.up_to(9) == 0 { -0.1 } else { 1.0 };
            let utility = match self.spec.utilities {
                Utilities::Flat => 1.0,
                Utilities::Unequal => sign * weight * jitter / f64::from(1u32 << (2 * level)),
            };
            let (first_frame, last_frame) = frames;
            self.groups.push(Group {
                id: GroupId { span, cluster: ClusterId(cluster as u16), level: Level::from_bits(level) },
                first_frame,
                last_frame,
                needs,
                packets,
                utility,
                risk_adjusted: utility,
                place: None,
            });
        }
    }

    /// Packets of one group; slice `i` needs the slice at the same relative place in every group that this
    /// one needs.
    fn split(&mut self, bytes: u64, group: GroupIndex, needs: &[GroupIndex]) -> Vec<PacketIndex> {
        let count = bytes.div_ceil(u64::from(self.spec.packet_bytes));
        let mut indices = Vec::with_capacity(count as usize);
        for slice in 0..count {
            let wire_bytes = (bytes / count + u64::from(slice < bytes % count)) as u16;
            let needs_packets = match self.spec.profile {
                ClosureRule::AllOrNothing => Vec::new(),
                ClosureRule::Sliced => needs
                    .iter()
                    .map(|need| {
                        let below = &self.groups[need.at()].packets;
                        below[(slice as usize * below.len()) / count as usize]
                    })
                    .collect(),
            };
            let index = PacketIndex(self.packets.len() as u32);
            let id = wire_id(index.at());
            self.packets.push(Packet { id, wire_bytes, groups: vec![group], needs_packets, parity_of: None });
            indices.push(index);
        }
        indices
    }

    fn protect(&mut self) -> Vec<RepairSet> {
        let Some(size) = self.spec.repair.filter(|size| *size > 0) else { return Vec::new() };
        let groups = &self.groups;
        let base: Vec<PacketIndex> = (0..self.packets.len() as u32)
            .map(PacketIndex)
            .filter(|p| self.packets[p.at()].groups.iter().all(|group| groups[group.at()].level() == 0))
            .collect();
        let mut sets = Vec::new();
        for members in base.chunks(size as usize) {
            let widest = members.iter().map(|member| self.packets[member.at()].wire_bytes).max().unwrap_or(1);
            for _ in 0..self.spec.parity.max(1) {
                self.packets.push(Packet {
                    id: wire_id(self.packets.len()),
                    wire_bytes: widest,
                    groups: Vec::new(),
                    needs_packets: Vec::new(),
                    parity_of: Some(sets.len() as u32),
                });
            }
            sets.push(RepairSet { members: members.to_vec() });
        }
        sets
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_rate_is_that_of_the_parameters_and_the_seed_decides() {
        let graph = Synthetic::default().build(3).unwrap();
        let rate = Rate::over(crate::clock::Bytes(graph.total_bytes()), Nanos::from_s(30)).0;
        assert!((4_600_000..5_400_000).contains(&rate), "{rate}");
        assert_eq!(graph.total_bytes(), Synthetic::default().build(3).unwrap().total_bytes());
        assert_ne!(graph.total_bytes(), Synthetic::default().build(4).unwrap().total_bytes());
        assert_eq!(graph.groups().len(), 31 * 32 * 4);
    }

    #[test]
    fn all_variants_pass_the_checks() {
        for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
            for repair in [None, Some(4)] {
                let graph =
                    Synthetic { frames: 90, profile, repair, ..Synthetic::default() }.build(1).unwrap();
                assert_eq!(repair.is_some(), !graph.repair_sets().is_empty());
            }
        }
        for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
            let dependencies = Dependencies::Independent;
            let graph =
                Synthetic { frames: 90, profile, dependencies, ..Synthetic::default() }.build(1).unwrap();
            assert!(graph.groups().iter().all(|group| group.needs.is_empty()));
            assert!(graph.packets().iter().all(|packet| packet.needs_packets.is_empty()));
        }
        assert!(Synthetic { frames: 0, ..Synthetic::default() }.build(1).is_err());
    }

    #[test]
    fn parameters_that_describe_no_graph_are_named() {
        let good = Synthetic::default();
        for (spec, words) in [
            (Synthetic { clusters: 0, ..good }, "clusters is 0, allowed 1 to 65536"),
            (Synthetic { clusters: u32::MAX, ..good }, "clusters is 4294967295, "),
            (Synthetic { levels: 0, ..good }, "levels is 0, allowed 1 to 4"),
            (Synthetic { levels: 255, ..good }, "levels is 255, "),
            (Synthetic { window_frames: 0, ..good }, "window_frames is 0, "),
            (Synthetic { packet_bytes: 0, ..good }, "packet_bytes is 0, "),
            (Synthetic { canonical_percent: 101, ..good }, "canonical_percent is 101, "),
            (Synthetic { frames: u32::MAX, window_frames: 1, ..good }, "windows "),
            (Synthetic { clusters: 1 << 16, frames: 60_000, window_frames: 1, ..good }, "groups "),
            (Synthetic { frame_interval: Nanos::MAX, ..good }, "packets "),
            (Synthetic { clusters: 1 << 16, window_frames: 16, packet_bytes: 1, ..good }, "packets "),
            (
                Synthetic { clusters: 1 << 16, window_frames: 16, repair: Some(1), parity: 255, ..good },
                "parity packets ",
            ),
        ] {
            let error = spec.build(1).unwrap_err().to_string();
            assert!(error.starts_with(words), "{error}");
        }
    }
}
