//! Divides a graph into its [`pieces`](super::pieces).

use std::sync::Arc;

use super::{
    ClosureRule, GroupIndex, PacketGraph, PacketIndex,
    csr::Csr,
    pieces::{Contribution, Division, FrameSums, NO_PIECE, Pieces},
};

impl PacketGraph {
    /// The pieces of the graph, shared by all runs of it.
    pub(crate) fn division(&self) -> Arc<Division> {
        Arc::clone(self.divided())
    }

    /// First frames of groups, each once, ascending: where motion windows and epochs begin.
    pub(crate) fn starts(&self) -> &[u32] {
        &self.divided().starts
    }

    fn divided(&self) -> &Arc<Division> {
        self.division.get_or_init(|| Arc::new(Division::new(self)))
    }
}

impl Division {
    fn new(graph: &PacketGraph) -> Self {
        let pieces = Pieces::new(graph);
        let needed = |place: &u32| pieces.needed_from(pieces.order()[*place as usize] as usize);
        let mut by_time: Vec<u32> =
            (0..pieces.len() as u32).filter(|place| needed(place) < graph.frames()).collect();
        by_time.sort_by_key(|place| (needed(place), *place));
        let mut starts: Vec<u32> = graph.groups().iter().map(|group| group.first_frame).collect();
        starts.sort_unstable();
        starts.dedup();
        Self { sums: FrameSums::new(graph), by_time, starts, pieces }
    }
}

impl FrameSums {
    fn new(graph: &PacketGraph) -> Self {
        let frames = graph.frames() as usize;
        let mut changes = vec![(0.0f64, 0i64); frames + 1];
        for group in graph.groups() {
            let base = i64::from(group.level() == 0);
            let (first, after) = (group.first_frame as usize, group.last_frame as usize + 1);
            changes[first].1 += base;
            changes[after].1 -= base;
            changes[first].0 += group.utility.max(0.0);
            changes[after].0 -= group.utility.max(0.0);
        }
        let largest = graph.groups().iter().map(|group| group.utility).fold(0.0, f64::max);
        let (mut utility, mut base) = (vec![0.0], vec![0.0]);
        let (mut shows, mut bases) = (0.0, 0);
        for (positive, count) in &changes[..frames] {
            shows += positive;
            bases += count;
            // What is left by rounding after the last group is no utility.
            let share = if shows > largest * 1e-9 { 1.0 / shows } else { 0.0 };
            utility.push(utility[utility.len() - 1] + share);
            base.push(base[base.len() - 1] + if bases > 0 { 1.0 / bases as f64 } else { 0.0 });
        }
        Self { utility, base }
    }
}

impl Pieces {
    fn new(graph: &PacketGraph) -> Self {
        let draft = match graph.profile() {
            ClosureRule::Sliced => sliced(graph),
            ClosureRule::AllOrNothing => whole_groups(graph),
        };
        let count = draft.parts.len();
        let rows = |pairs: &[(u32, u32)]| Csr::from_pairs(count, pairs);
        let turned =
            |pairs: &[(u32, u32)]| -> Vec<(u32, u32)> { pairs.iter().map(|(a, b)| (*b, *a)).collect() };
        let mut pieces = Self {
            packets: rows(&draft.packets),
            of_packet: vec![NO_PIECE; graph.packets().len()],
            wire_bytes: vec![0; count],
            needs: rows(&draft.needs),
            dependents: rows(&turned(&draft.needs)),
            order: Vec::with_capacity(count),
            place: vec![0; count],
            needed_from: vec![u32::MAX; count],
            useful_until: vec![0; count],
            parts: draft.parts,
            negative_contributions: draft.negative_contributions,
        };
        for (piece, packet) in &draft.packets {
            pieces.of_packet[*packet as usize] = *piece;
            pieces.wire_bytes[*piece as usize] += u32::from(graph.packets()[*packet as usize].wire_bytes);
        }
        pieces.sort();
        for at in (0..count).rev().map(|place| pieces.order[place] as usize) {
            let own = pieces.parts[at].iter();
            let (mut from, mut until) =
                own.fold((u32::MAX, 0), |(from, until), part| (from.min(part.first), until.max(part.last)));
            for dependent in pieces.dependents.row(at) {
                from = from.min(pieces.needed_from[*dependent as usize]);
                until = until.max(pieces.useful_until[*dependent as usize]);
            }
            pieces.needed_from[at] = from;
            pieces.useful_until[at] = until;
        }
        pieces
    }

    /// Kahn's order; the graph's checks leave no circle.
    fn sort(&mut self) {
        let mut open: Vec<usize> = (0..self.len()).map(|at| self.needs.row(at).len()).collect();
        self.order.extend((0..self.len() as u32).filter(|at| open[*at as usize] == 0));
        let mut done = 0;
        while let Some(at) = self.order.get(done).copied() {
            done += 1;
            for dependent in self.dependents.row(at as usize) {
                open[*dependent as usize] -= 1;
                if open[*dependent as usize] == 0 {
                    self.order.push(*dependent);
                }
            }
        }
        for (place, at) in (0u32..).zip(&self.order) {
            self.place[*at as usize] = place;
        }
    }
}

/// Pairs of (piece, packet) and (piece, needed piece), and what the pieces add.
#[derive(Default)]
struct Draft {
    packets: Vec<(u32, u32)>,
    needs: Vec<(u32, u32)>,
    parts: Vec<Vec<Contribution>>,
    negative_contributions: Vec<Vec<Contribution>>,
}

fn part(graph: &PacketGraph, group: GroupIndex, share: f64) -> Option<Contribution> {
    let facts = &graph.groups()[group.at()];
    let (utility, base) = (facts.utility.max(0.0) * share, if facts.level() == 0 { share } else { 0.0 });
    let (first, last) = (facts.first_frame, facts.last_frame);
    (utility > 0.0 || (base > 0.0 && facts.utility >= 0.0)).then_some(Contribution {
        group,
        first,
        last,
        utility,
        base,
    })
}

fn harm(graph: &PacketGraph, group: GroupIndex, share: f64) -> Option<Contribution> {
    let facts = &graph.groups()[group.at()];
    let (first, last, utility) = (facts.first_frame, facts.last_frame, facts.utility * share);
    (utility < 0.0).then_some(Contribution { group, first, last, utility, base: 0.0 })
}

fn sliced(graph: &PacketGraph) -> Draft {
    let bytes = |packet: PacketIndex| f64::from(graph.packets()[packet.at()].wire_bytes);
    let whole: Vec<f64> =
        graph.groups().iter().map(|group| group.packets.iter().map(|packet| bytes(*packet)).sum()).collect();
    let mut draft = Draft::default();
    for (at, packet) in (0u32..).zip(graph.packets()) {
        if packet.parity_of.is_none() {
            draft.packets.push((at, at));
        }
        draft.needs.extend(packet.needs_packets.iter().map(|need| (at, need.0)));
        let share = |group: &GroupIndex| f64::from(packet.wire_bytes) / whole[group.at()];
        let parts = packet.groups.iter().filter_map(|group| part(graph, *group, share(group)));
        draft.parts.push(parts.collect());
        let negative_contributions =
            packet.groups.iter().filter_map(|group| harm(graph, *group, share(group)));
        draft.negative_contributions.push(negative_contributions.collect());
    }
    draft
}

fn whole_groups(graph: &PacketGraph) -> Draft {
    let mut draft = Draft::default();
    for (at, group) in (0u32..).zip(graph.groups()) {
        draft.parts.push(part(graph, GroupIndex(at), 1.0).into_iter().collect());
        draft.negative_contributions.push(harm(graph, GroupIndex(at), 1.0).into_iter().collect());
        draft.needs.extend(group.needs.iter().map(|need| (at, need.0)));
    }
    for (at, packet) in (0u32..).zip(graph.packets()) {
        match packet.groups.as_slice() {
            [] => {}
            [group] => draft.packets.push((group.0, at)),
            shared => {
                let piece = draft.parts.len() as u32;
                draft.parts.push(Vec::new());
                draft.negative_contributions.push(Vec::new());
                draft.packets.push((piece, at));
                draft.needs.extend(shared.iter().map(|group| (group.0, piece)));
            }
        }
    }
    draft
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::graph::Synthetic;

    /// With everything there from the start, the pieces add up to 1 in every frame.
    #[test]
    fn all_pieces_together_are_the_whole_picture() {
        for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
            let graph = Synthetic { frames: 90, profile, ..Synthetic::default() }.build(3).unwrap();
            let (pieces, sums) = (Pieces::new(&graph), FrameSums::new(&graph));
            let (mut utility, mut base) = (0.0, 0.0);
            for piece in 0..pieces.len() {
                for part in pieces.parts(piece) {
                    let gain = sums.gain(part, 0);
                    utility += gain.0;
                    base += gain.1;
                }
            }
            assert!((utility - 90.0).abs() < 1e-6, "{profile:?}: {utility}");
            assert!((base - 90.0).abs() < 1e-6, "{profile:?}: {base}");
        }
    }

    #[test]
    fn every_packet_is_in_one_piece_and_needs_come_first() {
        for profile in [ClosureRule::AllOrNothing, ClosureRule::Sliced] {
            let graph =
                Synthetic { frames: 60, profile, repair: Some(4), ..Synthetic::default() }.build(3).unwrap();
            let pieces = Pieces::new(&graph);
            for (at, packet) in (0u32..).zip(graph.packets()) {
                let piece = pieces.of_packet(PacketIndex(at));
                assert_eq!(piece.is_none(), packet.parity_of.is_some());
                assert!(piece.is_none_or(|piece| pieces.packets(piece).any(|own| own == PacketIndex(at))));
            }
            let mut seen = vec![false; pieces.len()];
            for piece in pieces.order() {
                assert!(pieces.needs(*piece as usize).iter().all(|need| seen[*need as usize]));
                seen[*piece as usize] = true;
            }
            assert!(seen.iter().all(|seen| *seen));
        }
    }
}
