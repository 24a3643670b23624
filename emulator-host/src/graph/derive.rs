//! Checks the parts of a graph, and derives what follows from them: closures, deadlines.

use std::sync::OnceLock;

use codec_core::internals::ids::PacketId;

use super::{
    GraphError, GraphParts, GroupIndex, GroupKey, MAX_CLOSURE_ENTRIES, MAX_PACKET_BYTES, PacketGraph,
    PacketIndex, csr::Csr,
};
impl PacketGraph {
    /// Checks `parts` and derives closures and deadlines. Cost is linear in the size of all closures.
    ///
    /// # Errors
    /// The first inconsistency found; see [`GraphError`].
    pub fn new(parts: GraphParts) -> Result<Self, GraphError> {
        graph(parts)
    }
}

fn graph(parts: GraphParts) -> Result<PacketGraph, GraphError> {
    check_ranges(&parts)?;
    check_carriage(&parts)?;
    let parity_of_set = check_repair(&parts)?;
    let packet_by_id = packets_by_id(&parts)?;
    let group_by_id = groups_by_id(&parts)?;

    let group_count = parts.groups.len();
    let needs: Vec<Vec<u32>> =
        parts.groups.iter().map(|group| group.needs.iter().map(|need| need.0).collect()).collect();
    let dependents = reversed(&needs);
    let order = sorted(&needs, &dependents).map_err(|group| GraphError::GroupCycle { group })?;
    let packet_needs: Vec<Vec<u32>> =
        parts.packets.iter().map(|packet| packet.needs_packets.iter().map(|need| need.0).collect()).collect();
    let packet_dependents = reversed(&packet_needs);
    sorted(&packet_needs, &packet_dependents).map_err(|packet| GraphError::PacketCycle { packet })?;

    let closure = closures(&order, &needs)?;
    let mut group_needed_from: Vec<u32> = parts.groups.iter().map(|group| group.first_frame).collect();
    let mut group_useful_until: Vec<u32> = parts.groups.iter().map(|group| group.last_frame).collect();
    for group in order.iter().rev() {
        for need in &needs[*group as usize] {
            let (need, group) = (*need as usize, *group as usize);
            group_needed_from[need] = group_needed_from[need].min(group_needed_from[group]);
            group_useful_until[need] = group_useful_until[need].max(group_useful_until[group]);
        }
    }

    let (mut packet_groups, mut group_packets) = (Csr::default(), Csr::default());
    for packet in &parts.packets {
        packet_groups.push_row(packet.groups.iter().map(|group| group.0));
    }
    for group in &parts.groups {
        group_packets.push_row(group.packets.iter().map(|packet| packet.0));
    }
    let mut set_pairs = Vec::new();
    for (set, members) in parts.repair_sets.iter().enumerate() {
        set_pairs.extend(members.members.iter().map(|member| (member.0, set as u32)));
        set_pairs.extend(parity_of_set[set].iter().map(|parity| (parity.0, set as u32)));
    }
    let sets_of_packet = Csr::from_pairs(parts.packets.len(), &set_pairs);
    let shares_packets = (0..group_count).map(|group| shares(&parts, closure.row(group))).collect();

    let (mut from, mut until, mut level) = (Vec::new(), Vec::new(), Vec::new());
    for packet in &parts.packets {
        let groups: Vec<usize> = match packet.parity_of {
            Some(set) => {
                let members = &parts.repair_sets[set as usize].members;
                members.iter().flat_map(|member| &parts.packets[member.at()].groups).map(|g| g.at()).collect()
            }
            None => packet.groups.iter().map(|group| group.at()).collect(),
        };
        from.push(groups.iter().map(|group| group_needed_from[*group]).min().unwrap_or(0));
        until.push(groups.iter().map(|group| group_useful_until[*group]).max().unwrap_or(0));
        level.push(groups.iter().map(|group| parts.groups[*group].level()).min().unwrap_or(0));
    }
    Ok(PacketGraph {
        packet_ids: parts.packets.iter().map(|packet| packet.id).collect(),
        packet_bytes: parts.packets.iter().map(|packet| packet.wire_bytes).collect(),
        packet_groups,
        group_packets,
        closure,
        dependents,
        packet_dependents,
        sets_of_packet,
        parity_of_set,
        packet_by_id,
        group_by_id,
        group_needed_from,
        group_useful_until,
        packet_needed_from: from,
        packet_useful_until: until,
        packet_level: level,
        shares_packets,
        division: OnceLock::new(),
        parts,
    })
}

fn check_ranges(parts: &GraphParts) -> Result<(), GraphError> {
    if parts.frames == 0 || parts.frame_interval.0 < 1000 {
        return Err(GraphError::Playout { frames: parts.frames, interval_ns: parts.frame_interval.0 });
    }
    let lengths = [
        ("packet", parts.packets.len() as u32),
        ("group", parts.groups.len() as u32),
        ("repair set", parts.repair_sets.len() as u32),
    ];
    let within = |which: usize, index: u32, owner: &'static str, at: usize| {
        let (what, allowed) = lengths[which];
        if index < allowed {
            return Ok(());
        }
        Err(GraphError::OutOfRange { what, index, owner, at: at as u32, allowed })
    };
    for (at, packet) in parts.packets.iter().enumerate() {
        if packet.wire_bytes == 0 || packet.wire_bytes > MAX_PACKET_BYTES {
            return Err(GraphError::PacketBytes { packet: at as u32, found: packet.wire_bytes });
        }
        packet.groups.iter().try_for_each(|group| within(1, group.0, "packet", at))?;
        packet.needs_packets.iter().try_for_each(|need| within(0, need.0, "packet", at))?;
        packet.parity_of.iter().try_for_each(|set| within(2, *set, "packet", at))?;
        if packet.groups.is_empty() != packet.parity_of.is_some() {
            return Err(GraphError::Role { packet: at as u32 });
        }
    }
    for (at, group) in parts.groups.iter().enumerate() {
        group.needs.iter().try_for_each(|need| within(1, need.0, "group", at))?;
        group.packets.iter().try_for_each(|packet| within(0, packet.0, "group", at))?;
        if group.first_frame > group.last_frame || group.last_frame >= parts.frames {
            let (first, last) = (group.first_frame, group.last_frame);
            return Err(GraphError::Frames { group: at as u32, first, last, frames: parts.frames });
        }
        if !(group.utility.is_finite() && group.risk_adjusted.is_finite()) {
            return Err(GraphError::Utility { group: at as u32 });
        }
    }
    for (at, set) in parts.repair_sets.iter().enumerate() {
        set.members.iter().try_for_each(|member| within(0, member.0, "repair set", at))?;
    }
    Ok(())
}

/// Packets in order of their wire ids, which must be unique.
fn packets_by_id(parts: &GraphParts) -> Result<Vec<(PacketId, PacketIndex)>, GraphError> {
    let mut by_id: Vec<_> = (0..).map(PacketIndex).zip(&parts.packets).map(|(at, p)| (p.id, at)).collect();
    by_id.sort_unstable();
    match by_id.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        Some(pair) => Err(GraphError::DuplicateId { id: pair[0].0 }),
        None => Ok(by_id),
    }
}

/// Groups in order of their ids, which must be unique.
fn groups_by_id(parts: &GraphParts) -> Result<Vec<(GroupKey, GroupIndex)>, GraphError> {
    let indices = (0..).map(GroupIndex).zip(&parts.groups);
    let mut by_id: Vec<_> = indices.map(|(at, group)| (GroupKey::of(group.id), at)).collect();
    by_id.sort_unstable();
    match by_id.windows(2).find(|pair| pair[0].0 == pair[1].0) {
        Some(pair) => Err(GraphError::DuplicateGroup { first: pair[0].1.0, second: pair[1].1.0 }),
        None => Ok(by_id),
    }
}

/// Packets and groups name each other exactly once.
fn check_carriage(parts: &GraphParts) -> Result<(), GraphError> {
    let mut by_packet: Vec<(u32, u32)> = Vec::new();
    for (at, packet) in parts.packets.iter().enumerate() {
        by_packet.extend(packet.groups.iter().map(|group| (at as u32, group.0)));
    }
    let mut by_group: Vec<(u32, u32)> = Vec::new();
    for (at, group) in parts.groups.iter().enumerate() {
        if group.packets.is_empty() {
            return Err(GraphError::EmptyGroup { group: at as u32 });
        }
        by_group.extend(group.packets.iter().map(|packet| (packet.0, at as u32)));
    }
    by_packet.sort_unstable();
    by_group.sort_unstable();
    for pairs in [&by_packet, &by_group] {
        if let Some(pair) = pairs.windows(2).find(|pair| pair[0] == pair[1]) {
            return Err(GraphError::Mismatch { packet: pair[0].0, group: pair[0].1 });
        }
    }
    let odd =
        by_packet.iter().zip(&by_group).find(|(one, other)| one != other).map(|(one, other)| one.min(other));
    let longer = if by_packet.len() > by_group.len() { &by_packet } else { &by_group };
    let tail = longer.get(by_packet.len().min(by_group.len()));
    match odd.or(tail) {
        Some((packet, group)) => Err(GraphError::Mismatch { packet: *packet, group: *group }),
        None => Ok(()),
    }
}

fn check_repair(parts: &GraphParts) -> Result<Vec<Vec<PacketIndex>>, GraphError> {
    let mut parity: Vec<Vec<PacketIndex>> = vec![Vec::new(); parts.repair_sets.len()];
    for (at, packet) in parts.packets.iter().enumerate() {
        if let Some(set) = packet.parity_of {
            parity[set as usize].push(PacketIndex(at as u32));
        }
    }
    for (at, (set, parity)) in parts.repair_sets.iter().zip(&parity).enumerate() {
        let mut members = set.members.clone();
        members.sort_unstable();
        members.dedup();
        let distinct = !members.is_empty() && members.len() == set.members.len();
        let media = members.iter().all(|member| parts.packets[member.at()].parity_of.is_none());
        if parity.is_empty() || !distinct || !media {
            return Err(GraphError::RepairSet { set: at as u32 });
        }
    }
    Ok(parity)
}

fn reversed(needs: &[Vec<u32>]) -> Csr {
    let mut pairs = Vec::new();
    for (at, row) in needs.iter().enumerate() {
        pairs.extend(row.iter().map(|need| (*need, at as u32)));
    }
    Csr::from_pairs(needs.len(), &pairs)
}

/// Kahn's order; an index left over when the work runs out is on or behind a cycle.
fn sorted(needs: &[Vec<u32>], dependents: &Csr) -> Result<Vec<u32>, u32> {
    let mut open: Vec<usize> = needs.iter().map(Vec::len).collect();
    let mut order: Vec<u32> = (0..needs.len() as u32).filter(|at| open[*at as usize] == 0).collect();
    let mut done = 0;
    while let Some(at) = order.get(done).copied() {
        done += 1;
        for dependent in dependents.row(at as usize) {
            open[*dependent as usize] -= 1;
            if open[*dependent as usize] == 0 {
                order.push(*dependent);
            }
        }
    }
    match open.iter().position(|left| *left > 0) {
        Some(stuck) => Err(stuck as u32),
        None => Ok(order),
    }
}

fn closures(order: &[u32], needs: &[Vec<u32>]) -> Result<Csr, GraphError> {
    let mut rank = vec![0u32; order.len()];
    for (position, group) in order.iter().enumerate() {
        rank[*group as usize] = position as u32;
    }
    let mut rows: Vec<Vec<u32>> = vec![Vec::new(); order.len()];
    let mut total = 0;
    for group in order {
        let mut row: Vec<u32> = Vec::new();
        for need in &needs[*group as usize] {
            row.extend_from_slice(&rows[*need as usize]);
        }
        row.sort_unstable_by_key(|member| rank[*member as usize]);
        row.dedup();
        row.push(*group);
        total += row.len();
        if total > MAX_CLOSURE_ENTRIES {
            return Err(GraphError::ClosureTooLarge);
        }
        rows[*group as usize] = row;
    }
    let mut closure = Csr::default();
    for row in &rows {
        closure.push_row(row.iter().copied());
    }
    debug_assert_eq!(closure.len(), total);
    Ok(closure)
}

fn shares(parts: &GraphParts, closure: &[u32]) -> bool {
    let packets = closure.iter().flat_map(|group| &parts.groups[*group as usize].packets);
    if packets.clone().all(|packet| parts.packets[packet.at()].groups.len() < 2) {
        return false;
    }
    let mut packets: Vec<PacketIndex> = packets.copied().collect();
    packets.sort_unstable();
    packets.windows(2).any(|pair| pair[0] == pair[1])
}

#[cfg(test)]
mod tests {
    use codec_core::internals::ids::{ClusterId, Group as GroupId, Level, Span, WindowId};

    use super::super::{ClosureRule, Group, Packet, RepairSet, Synthetic};
    use super::*;
    use crate::clock::Nanos;

    fn packet(id: u32, groups: &[u32]) -> Packet {
        let groups = groups.iter().map(|group| GroupIndex(*group)).collect();
        Packet {
            id: PacketId::new(id).unwrap(),
            wire_bytes: 100,
            groups,
            needs_packets: vec![],
            parity_of: None,
        }
    }

    fn group(level: u8, frames: (u32, u32), needs: &[u32], packets: &[u32]) -> Group {
        Group {
            id: GroupId {
                span: Span::Motion(WindowId(0)),
                cluster: ClusterId(0),
                level: Level::new(level).unwrap(),
            },
            first_frame: frames.0,
            last_frame: frames.1,
            needs: needs.iter().map(|need| GroupIndex(*need)).collect(),
            packets: packets.iter().map(|packet| PacketIndex(*packet)).collect(),
            utility: 1.0,
            risk_adjusted: 1.0,
            place: None,
        }
    }

    /// Three levels; listed top first, so that order is not index order. Packet 2 carries both refinements.
    fn parts() -> GraphParts {
        GraphParts {
            packets: vec![packet(10, &[2]), packet(11, &[1]), packet(12, &[0, 1])],
            groups: vec![
                group(2, (4, 9), &[1], &[2]),
                group(1, (3, 8), &[2], &[1, 2]),
                group(0, (5, 5), &[], &[0]),
            ],
            repair_sets: vec![],
            frames: 10,
            frame_interval: Nanos::from_ms(33),
            manifest_bytes: 1000,
            profile: ClosureRule::AllOrNothing,
        }
    }

    /// A packet of two groups passes once.
    #[test]
    fn the_first_base_has_each_packet_once() {
        let graph = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap();
        let bytes = graph.first_base_bytes(0);
        let mut parts = graph.parts().clone();
        let is_first_base = |at: &usize| parts.groups[*at].level() == 0 && parts.groups[*at].first_frame == 0;
        let groups: Vec<usize> = (0..parts.groups.len()).filter(is_first_base).collect();
        let packet = parts.groups[groups[0]].packets[0];
        parts.groups[groups[1]].packets.push(packet);
        parts.packets[packet.at()].groups.push(GroupIndex(groups[1] as u32));
        let shared = PacketGraph::new(parts).unwrap();
        assert!(bytes > 0 && shared.first_base_bytes(0) == bytes);
        let packets = (shared.first_base_bytes(58) - bytes) / 58;
        assert!(packets >= groups.len() as u64, "{packets}");
    }

    #[test]
    fn closure_is_transitive_and_needed_first() {
        let graph = PacketGraph::new(parts()).unwrap();
        let closure: Vec<u32> = graph.closure(GroupIndex(0)).map(|group| group.0).collect();
        assert_eq!(closure, [2, 1, 0]);
        assert!(graph.closure_shares_packets(GroupIndex(0)));
        assert!(!graph.closure_shares_packets(GroupIndex(1)));
    }

    #[test]
    fn a_base_is_needed_as_early_and_as_long_as_what_stands_on_it() {
        let graph = PacketGraph::new(parts()).unwrap();
        assert_eq!(graph.group_needed_from(GroupIndex(2)), 3);
        assert_eq!(graph.group_useful_until(GroupIndex(2)), 9);
        assert_eq!((graph.needed_from(PacketIndex(0)), graph.useful_until(PacketIndex(0))), (3, 9));
    }

    type Spoil = fn(&mut GraphParts);

    #[test]
    fn every_inconsistency_is_named() {
        let cases: &[(Spoil, GraphError)] = &[
            (|p| p.frames = 0, GraphError::Playout { frames: 0, interval_ns: 33_000_000 }),
            (|p| p.packets[1].wire_bytes = 1281, GraphError::PacketBytes { packet: 1, found: 1281 }),
            (
                |p| p.packets[1].id = p.packets[0].id,
                GraphError::DuplicateId { id: PacketId::new(10).unwrap() },
            ),
            (|p| p.groups[2].id = p.groups[0].id, GraphError::DuplicateGroup { first: 0, second: 2 }),
            (|p| p.packets[2].groups = vec![GroupIndex(0)], GraphError::Mismatch { packet: 2, group: 1 }),
            (|p| p.groups[1].packets.push(PacketIndex(0)), GraphError::Mismatch { packet: 0, group: 1 }),
            (|p| p.groups[0].packets.clear(), GraphError::EmptyGroup { group: 0 }),
            (|p| p.packets[0].groups.clear(), GraphError::Role { packet: 0 }),
            (
                |p| p.groups[0].last_frame = 10,
                GraphError::Frames { group: 0, first: 4, last: 10, frames: 10 },
            ),
            (|p| p.groups[0].utility = f64::NAN, GraphError::Utility { group: 0 }),
            (|p| p.groups[1].risk_adjusted = f64::INFINITY, GraphError::Utility { group: 1 }),
            (|p| p.groups[2].needs.push(GroupIndex(0)), GraphError::GroupCycle { group: 0 }),
            (|p| p.packets[0].needs_packets.push(PacketIndex(0)), GraphError::PacketCycle { packet: 0 }),
            (
                |p| p.groups[2].needs.push(GroupIndex(3)),
                GraphError::OutOfRange { what: "group", index: 3, owner: "group", at: 2, allowed: 3 },
            ),
            (
                |p| p.repair_sets.push(RepairSet { members: vec![PacketIndex(0)] }),
                GraphError::RepairSet { set: 0 },
            ),
        ];
        for (spoil, expected) in cases {
            let mut spoiled = parts();
            spoil(&mut spoiled);
            assert_eq!(PacketGraph::new(spoiled).unwrap_err(), *expected);
        }
    }
}
