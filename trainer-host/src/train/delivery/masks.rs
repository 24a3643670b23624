//! Draws the states that deliveries leave.
//!
//! A state is a byte per block of the stream, a bit per level that arrived (see codec-core's closure). States
//! are drawn over the packets, or the completion groups, of the first encoding; blocks and levels stay the
//! same while a scene is trained, so equal seeds give equal states to every variant.

use std::collections::BTreeMap;

use codec_core::internals::{closure::Arrived, digest::Digest, ids::Group};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::{
    channel::LossModel,
    config::{ChannelRanges, LossUnit, Variant},
    error::DeliveryError,
};
use crate::stream::{PacketMap, Stream};

/// States and their hash.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Masks {
    /// One state per world: a byte per block, bit `l` for level `l`.
    pub states: Vec<Vec<u8>>,
}

impl Masks {
    /// FNV-1a, 64 bits, over all states in order, each preceded by its length as little-endian u64.
    pub fn hash(&self) -> u64 {
        hash(self.states.iter())
    }

    /// Refuses states that are not of a stream of `blocks` blocks.
    pub(super) fn check(&self, blocks: usize) -> Result<(), DeliveryError> {
        let Some(state) = self.states.iter().find(|state| state.len() != blocks) else { return Ok(()) };
        let (field, found) = ("masks", format!("a state of {} blocks", state.len()));
        Err(DeliveryError::Setting { field, found, allowed: "states of the stream's blocks".to_owned() })
    }

    /// `count` states of `stream` after `loss` by packets or by groups, from `seed`. Groups, in the order in
    /// which their first symbols are sent, are lost or there as wholes, whatever packets they share; parity
    /// then repairs nothing.
    ///
    /// # Errors
    /// A stream whose manifest does not hold.
    pub fn draw(
        stream: &Stream,
        loss: LossModel,
        unit: LossUnit,
        count: usize,
        seed: u64,
    ) -> Result<Self, DeliveryError> {
        let sampler = Sampler::new(stream, unit)?;
        let groups = sampler.groups();
        let draw = |index| {
            let mut rng = random(seed, Purpose::Test, 0, index);
            match unit {
                LossUnit::Packet => {
                    let lost = loss.lost(sampler.units(), &mut rng);
                    sampler.state(&lost.iter().map(|lost| !lost).collect::<Vec<_>>())
                }
                LossUnit::Group => {
                    let lost = loss.lost(groups.len(), &mut rng);
                    let has = |group: &Group| groups.get(group).is_some_and(|&number| !lost[number]);
                    sampler.map.state_of_groups(has)
                }
            }
        };
        Ok(Self { states: (0..count).map(draw).collect() })
    }

    /// The same over links drawn from `ranges`, with their capacity, delay and display deadline: what is lost
    /// by turns on its own and in bursts, and what comes too late, is missing.
    ///
    /// # Errors
    /// As [`Masks::draw`].
    pub fn draw_links(
        stream: &Stream,
        ranges: &ChannelRanges,
        unit: LossUnit,
        count: usize,
        seed: u64,
    ) -> Result<Self, DeliveryError> {
        let sampler = Sampler::new(stream, unit)?;
        let draw = |index| {
            let mut rng = random(seed, Purpose::Test, 0, index);
            // Every third world of the combined variant is of a link with a deadline.
            let link = ranges.link(Variant::Combined, 3 * index + 2, &mut rng);
            sampler.state(&link.delivered(&sampler.bytes, &mut rng))
        };
        Ok(Self { states: (0..count).map(draw).collect() })
    }
}

/// [`Masks::hash`] of `states`, of which no two need be in memory at once.
pub(super) fn hash(states: impl Iterator<Item: AsRef<[u8]>>) -> u64 {
    let add = |digest: Digest, state: &[u8]| digest.bytes(&(state.len() as u64).to_le_bytes()).bytes(state);
    states.fold(Digest::new(), |digest, state| add(digest, state.as_ref())).get()
}

/// What random numbers are for. Each purpose has its own seed, so draws for one do not shift those of
/// another.
#[derive(Clone, Copy, Debug)]
pub(super) enum Purpose {
    Training,
    Views,
    Validation,
    Test,
}

/// Random numbers of world `index` of update `update`.
pub(super) fn random(seed: u64, purpose: Purpose, update: usize, index: usize) -> Pcg64 {
    let key = (purpose as u128) << 60 | (update as u128 & 0xfff_ffff) << 28 | (index as u128 & 0xfff_ffff);
    Pcg64::new(u128::from(seed) << 64 | key, 0x5851_f42d_4c95_7f2d_1405_7b7e_f767_814f)
}

/// Draws states of one stream.
#[derive(Clone, Debug)]
pub(super) struct Sampler {
    map: PacketMap,
    /// Bytes of each packet, or of each group's packets, in the order of sending.
    bytes: Vec<usize>,
    /// Per packet, its unit: itself, or the group it belongs to.
    unit_of: Vec<usize>,
    complete: Vec<u8>,
}

impl Sampler {
    /// # Errors
    /// A stream whose manifest does not hold.
    pub(super) fn new(stream: &Stream, unit: LossUnit) -> Result<Self, DeliveryError> {
        let map = PacketMap::of(stream)?;
        let mut groups = BTreeMap::new();
        let (mut bytes, mut unit_of) = (Vec::new(), Vec::new());
        for (id, packet) in stream.packets().iter().enumerate() {
            let group = map.placements(id).first().map(|p| (p.group.span, p.group.cluster, p.group.level));
            let index = match (unit, group) {
                (LossUnit::Group, Some(group)) => *groups.entry(group).or_insert(bytes.len()),
                _ => bytes.len(),
            };
            if index == bytes.len() {
                bytes.push(0);
            }
            bytes[index] += packet.len();
            unit_of.push(index);
        }
        let complete = map.state(|_| true);
        Ok(Self { map, bytes, unit_of, complete })
    }

    /// Packets or groups.
    pub(super) fn units(&self) -> usize {
        self.bytes.len()
    }

    /// Completion groups, each with its number in the order in which their first symbols are sent.
    fn groups(&self) -> BTreeMap<Group, usize> {
        let mut numbers = BTreeMap::new();
        for placement in (0..self.unit_of.len()).flat_map(|id| self.map.placements(id)) {
            let next = numbers.len();
            numbers.entry(placement.group).or_insert(next);
        }
        numbers
    }

    /// The state in which everything has arrived.
    pub(super) fn complete(&self) -> &[u8] {
        &self.complete
    }

    /// The state in which everything has arrived up to level `level`.
    pub(super) fn prefix(&self, level: usize) -> Vec<u8> {
        let levels = (2u8 << level.min(3)) - 1;
        let initial = self.map.initial();
        self.complete.iter().zip(initial).map(|(all, initial)| initial | all & levels).collect()
    }

    /// The state after the units for which `arrived` says so, and what parity repairs; `paper` completes a
    /// group or has none of it.
    pub(super) fn state(&self, arrived: &[bool]) -> Vec<u8> {
        let have = self.map.repaired(|id| self.unit_of.get(id).is_some_and(|&unit| arrived[unit]));
        self.map.state(|id| have[id])
    }

    /// The states of a picture's worlds, as `variant` has them: `worlds` of them, the first `clean` complete
    /// where it has clean anchors. `recorded` states take turns with the variant's own where there are any.
    /// Turns go on from picture to picture, of which there were so many `before`.
    pub(super) fn worlds(
        &self,
        variant: Variant,
        ranges: &ChannelRanges,
        (worlds, clean, before): (usize, usize, usize),
        recorded: &[Vec<u8>],
        rng: impl Fn(usize) -> Pcg64,
    ) -> Vec<Vec<u8>> {
        let world = |index: usize| {
            let mut rng = rng(index);
            if index < clean && variant == Variant::Combined || variant == Variant::Reconstruction {
                return self.complete.clone();
            }
            let mut number = before * worlds.saturating_sub(clean) + index;
            if !recorded.is_empty() && variant == Variant::Combined {
                if number.is_multiple_of(2) {
                    return recorded[rng.random_range(0..recorded.len())].clone();
                }
                number /= 2;
            }
            let link = ranges.link(variant, number, &mut rng);
            self.state(&link.delivered(&self.bytes, &mut rng))
        };
        (0..worlds).map(world).collect()
    }
}

/// Levels of `state` that arrived, of all levels in it, 0..=1.
pub(super) fn share_arrived(state: &[u8]) -> f64 {
    let levels: usize = state.iter().map(|&mask| Arrived(mask).usable()).sum();
    levels as f64 / (4 * state.len()).max(1) as f64
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        encode,
        import::{
            Limits,
            synth::{self, SynthKind},
        },
    };

    pub(in crate::train::delivery) fn stream(profile: &str) -> Stream {
        let options =
            synth::SynthOptions { gaussians: 1000, frames: 4, kind: SynthKind::Balls, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = match profile {
            "paper" => encode::EncodeOptions::paper(),
            _ => {
                encode::EncodeOptions { packet_bytes: 200, block_len: 16, pictures: 0, ..Default::default() }
            }
        };
        encode::encode(&scene, &options, &crate::encode::no_progress).unwrap().stream
    }

    #[test]
    fn equal_seeds_give_equal_states_and_the_hash_sees_one_bit() {
        let stream = stream("dgs1");
        let loss = LossModel::Iid { probability: 0.1 };
        let draw = |seed| Masks::draw(&stream, loss, LossUnit::Packet, 8, seed).unwrap();
        let (first, again, other) = (draw(1), draw(1), draw(2));
        assert_eq!(first, again);
        assert_ne!(first.hash(), other.hash());
        let mut bent = first.clone();
        bent.states[3][0] ^= 1;
        assert_ne!(first.hash(), bent.hash());
        // The hash of nothing, by the definition of FNV-1a.
        assert_eq!(Masks { states: Vec::new() }.hash(), 0xcbf2_9ce4_8422_2325);
    }

    #[test]
    fn groups_are_lost_whole_and_packets_in_part() {
        let stream = stream("dgs1");
        let map = PacketMap::of(&stream).unwrap();
        let [packets, groups] =
            [LossUnit::Packet, LossUnit::Group].map(|unit| Sampler::new(&stream, unit).unwrap());
        assert!(groups.units() <= packets.units() && packets.units() == stream.packets().len());
        let everything = vec![true; packets.units()];
        assert_eq!(packets.state(&everything), packets.complete());
        assert_eq!(packets.state(&vec![false; packets.units()]), map.initial());
        assert_eq!(packets.prefix(3), packets.complete());
        assert!(share_arrived(&packets.prefix(0)) < share_arrived(&packets.prefix(1)));
    }

    /// A group is there with all its blocks or with none, which a packet that holds parts of several is not.
    #[test]
    fn completion_groups_are_lost_as_wholes() {
        let stream = stream("dgs1");
        let map = PacketMap::of(&stream).unwrap();
        let in_parts = |unit| {
            let loss = LossModel::Iid { probability: 0.3 };
            let masks = Masks::draw(&stream, loss, unit, 4, 3).unwrap();
            let mut seen: BTreeMap<(usize, Group), [usize; 2]> = BTreeMap::new();
            for (index, state) in masks.states.iter().enumerate() {
                for placement in (0..stream.packets().len()).flat_map(|id| map.placements(id)) {
                    for &mask in &state[placement.first_block..][..placement.blocks] {
                        let has = usize::from(Arrived(mask).has(placement.group.level));
                        seen.entry((index, placement.group)).or_default()[has] += 1;
                    }
                }
            }
            assert!(seen.values().any(|&[lost, there]| lost > 0 && there == 0), "some are lost");
            assert!(seen.values().any(|&[lost, there]| lost == 0 && there > 0), "some are there");
            seen.values().filter(|[lost, there]| *lost > 0 && *there > 0).count()
        };
        assert_eq!(in_parts(LossUnit::Group), 0);
        assert!(in_parts(LossUnit::Packet) > 0, "or this test says nothing");
    }

    /// A link of half the stream until its deadline brings half, less what is lost; a fast one everything.
    #[test]
    fn links_cut_off_what_comes_after_the_deadline() {
        let stream = stream("dgs1");
        let complete = Sampler::new(&stream, LossUnit::Packet).unwrap().complete().to_vec();
        let draw = |capacity: f64, lost: f64| {
            let ranges = ChannelRanges {
                capacity: [capacity; 2],
                round_trip_s: [0.0; 2],
                deadline_s: [1.0; 2],
                iid: [lost; 2],
                burst_share: [lost; 2],
                burst_length: [3.0; 2],
            };
            Masks::draw_links(&stream, &ranges, LossUnit::Packet, 6, 1).unwrap()
        };
        assert!(draw(4.0, 0.0).states.iter().all(|state| *state == complete));
        let half = draw(0.5, 0.0);
        assert!(half.states.iter().all(|state| *state == half.states[0] && *state != complete));
        assert_eq!(draw(0.5, 0.2), draw(0.5, 0.2));
        let share = |masks: &Masks| masks.states.iter().map(|state| share_arrived(state)).sum::<f64>();
        assert!(share(&draw(0.5, 0.2)) < share(&half) && share(&draw(0.2, 0.0)) < share(&half));
    }

    #[test]
    fn variants_draw_their_own_worlds_and_combined_has_clean_anchors() {
        let sampler = Sampler::new(&stream("dgs1"), LossUnit::Packet).unwrap();
        let ranges = ChannelRanges::default();
        let worlds = |variant, seed| {
            sampler.worlds(variant, &ranges, (12, 3, 0), &[], |i| random(seed, Purpose::Training, 0, i))
        };
        let complete = |states: &[Vec<u8>]| states.iter().filter(|s| **s == sampler.complete()).count();
        assert_eq!(complete(&worlds(Variant::Reconstruction, 1)), 12);
        assert!(complete(&worlds(Variant::Combined, 1)) >= 3);
        assert!(complete(&worlds(Variant::Iid, 1)) < 6);
        assert_ne!(worlds(Variant::Iid, 1), worlds(Variant::Iid, 2));
        assert_ne!(worlds(Variant::Iid, 1), worlds(Variant::BurstCvar, 1));
        assert_eq!(worlds(Variant::Combined, 4), worlds(Variant::Combined, 4));
        // Of one world per picture, too, every second one is recorded.
        let recorded = [vec![1; sampler.complete().len()]];
        let one = |before| {
            let rng = |i| random(1, Purpose::Training, before, i);
            sampler.worlds(Variant::Combined, &ranges, (1, 0, before), &recorded, rng).remove(0)
        };
        let is_recorded: Vec<bool> = (0..6).map(|before| one(before) == recorded[0]).collect();
        assert_eq!(is_recorded, [true, false, true, false, true, false]);
    }
}
