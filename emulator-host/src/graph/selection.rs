//! Leaves parts of a graph out: those that are over, and those that need what has not come.

use super::{ClosureRule, GraphParts, Group, GroupIndex, Packet, PacketIndex, RepairSet};

/// Which parts of a graph stay, by index.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Selection {
    /// Packets.
    pub packets: Vec<bool>,
    /// Groups.
    pub groups: Vec<bool>,
    /// Repair sets.
    pub repair_sets: Vec<bool>,
}

impl Selection {
    /// What of `parts` means something with those packets alone of which `has` is true. A repair set stays
    /// with all its members and some of its parity.
    pub fn with_packets(parts: &GraphParts, has: impl Fn(PacketIndex) -> bool) -> Self {
        let packets = (0..parts.packets.len()).map(|at| has(PacketIndex(at as u32))).collect();
        let mut stays = Self { packets, groups: vec![true; parts.groups.len()], repair_sets: Vec::new() };
        while stays.drop_what_lacks_something(parts) {}
        let mut with_parity = vec![false; parts.repair_sets.len()];
        for (packet, stays) in parts.packets.iter().zip(&stays.packets) {
            if let Some(set) = packet.parity_of.filter(|_| *stays) {
                with_parity[set as usize] = true;
            }
        }
        let whole = |set: &RepairSet| set.members.iter().all(|member| stays.packets[member.at()]);
        stays.repair_sets =
            parts.repair_sets.iter().zip(with_parity).map(|(set, parity)| parity && whole(set)).collect();
        for (packet, stays_here) in parts.packets.iter().zip(&mut stays.packets) {
            *stays_here &= packet.parity_of.is_none_or(|set| stays.repair_sets[set as usize]);
        }
        stays
    }

    /// One pass; whether something was left out.
    fn drop_what_lacks_something(&mut self, parts: &GraphParts) -> bool {
        let mut dropped = false;
        for (at, group) in
            parts.groups.iter().enumerate().filter(|(at, _)| self.groups[*at]).collect::<Vec<_>>()
        {
            let mut packets = group.packets.iter().map(|packet| self.packets[packet.at()]);
            let has_packets = match parts.profile {
                ClosureRule::AllOrNothing => packets.all(|stays| stays),
                ClosureRule::Sliced => packets.any(|stays| stays),
            };
            if group.packets.is_empty()
                || !has_packets
                || !group.needs.iter().all(|need| self.groups[need.at()])
            {
                (self.groups[at], dropped) = (false, true);
            }
        }
        for (at, packet) in parts.packets.iter().enumerate() {
            let carries = packet.parity_of.is_some() || packet.groups.iter().any(|g| self.groups[g.at()]);
            let stands = packet.needs_packets.iter().all(|need| self.packets[need.at()]);
            if self.packets[at] && !(carries && stands) {
                (self.packets[at], dropped) = (false, true);
            }
        }
        dropped
    }

    /// The parts that stay, numbered anew.
    pub fn of(&self, parts: &GraphParts) -> GraphParts {
        let (packets, groups) = (places(&self.packets), places(&self.groups));
        let sets = places(&self.repair_sets);
        let moved = |list: &[PacketIndex]| -> Vec<PacketIndex> {
            let stays = list.iter().filter(|packet| self.packets[packet.at()]);
            stays.map(|packet| PacketIndex(packets[packet.at()])).collect()
        };
        let moved_groups = |list: &[GroupIndex]| -> Vec<GroupIndex> {
            let stays = list.iter().filter(|group| self.groups[group.at()]);
            stays.map(|group| GroupIndex(groups[group.at()])).collect()
        };
        GraphParts {
            packets: chosen(&parts.packets, &self.packets, |packet| Packet {
                groups: moved_groups(&packet.groups),
                needs_packets: moved(&packet.needs_packets),
                parity_of: packet.parity_of.map(|set| sets[set as usize]),
                ..packet.clone()
            }),
            groups: chosen(&parts.groups, &self.groups, |group| Group {
                needs: moved_groups(&group.needs),
                packets: moved(&group.packets),
                ..group.clone()
            }),
            repair_sets: chosen(&parts.repair_sets, &self.repair_sets, |set| RepairSet {
                members: moved(&set.members),
            }),
            ..*parts
        }
    }
}

/// Where each of those that stay comes to lie.
fn places(stays: &[bool]) -> Vec<u32> {
    let place = |next: &mut u32, stays: &bool| {
        let place = *next;
        *next += u32::from(*stays);
        Some(place)
    };
    stays.iter().scan(0, place).collect()
}

/// Those of `all` that stay, changed.
fn chosen<T>(all: &[T], stays: &[bool], change: impl Fn(&T) -> T) -> Vec<T> {
    all.iter().zip(stays).filter(|(_, stays)| **stays).map(|(one, _)| change(one)).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::{PacketGraph, Synthetic};

    #[test]
    fn what_stays_is_a_graph_and_lacks_nothing() {
        let whole = Synthetic { frames: 90, ..Synthetic::default() }.build(1).unwrap();
        let parts = whole.parts();
        let all = Selection::with_packets(parts, |_| true);
        assert_eq!(&all.of(parts), parts);
        for skipped in 0..7 {
            let has = |packet: PacketIndex| packet.0 % 7 != skipped;
            let stays = Selection::with_packets(parts, has);
            let part = PacketGraph::new(stays.of(parts)).unwrap();
            assert!(!part.packets().is_empty() && part.packets().len() < whole.packets().len());
            for packet in part.packets() {
                assert!(has(PacketIndex(packet.id.index() as u32)));
            }
        }
        let none = Selection::with_packets(parts, |_| false).of(parts);
        assert!(none.packets.is_empty() && none.groups.is_empty() && none.repair_sets.is_empty());
    }
}
