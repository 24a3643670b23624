//! Sorts the packets of a stream into what travels together: those of one span and one level.

use codec_core::internals::ids::Span;
use emulator_host::{PacketGraph, PacketIndex, graph::Group};

use super::track::LEVELS;

/// Per level, the packets of one span, most useful first.
pub(super) type Levels = [Vec<PacketIndex>; LEVELS];

/// Every packet of a stream but parity, which nobody needs where groups arrive whole.
#[derive(Debug, Default, PartialEq, Eq)]
pub(super) struct Units {
    /// By epoch.
    pub(super) canonical: Vec<Levels>,
    /// By window.
    pub(super) motion: Vec<Levels>,
}

/// Where a packet belongs: the most urgent of what it carries.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord)]
struct Place {
    level: u8,
    first_frame: u32,
    moves: bool,
    span: usize,
}

impl Units {
    /// The units of `graph`, whose windows begin at the frames `windows`, ascending.
    pub(super) fn of(graph: &PacketGraph, windows: &[u32]) -> Self {
        let mut units = Self { canonical: Vec::new(), motion: vec![Levels::default(); windows.len()] };
        let place = |group: &Group| Place {
            level: group.level(),
            first_frame: group.first_frame,
            moves: !group.is_canonical(),
            span: match group.id.span {
                Span::Canonical(epoch) => epoch.index(),
                Span::Motion(_) => {
                    windows.partition_point(|first| *first <= group.first_frame).saturating_sub(1)
                }
            },
        };
        let mut by_use: Vec<(PacketIndex, f64)> = (0..graph.packets().len() as u32)
            .map(PacketIndex)
            .map(|packet| (packet, usefulness(graph, packet)))
            .collect();
        by_use.sort_by(|(_, a), (_, b)| b.total_cmp(a));
        for (packet, _) in by_use {
            let groups = &graph.packets()[packet.at()].groups;
            let places = groups.iter().map(|group| place(&graph.groups()[group.at()]));
            // Parity carries no group.
            let Some(Place { level, moves, span, .. }) = places.min() else { continue };
            let spans = if moves { &mut units.motion } else { &mut units.canonical };
            if spans.len() <= span {
                spans.resize(span + 1, Levels::default());
            }
            if let Some(packets) = spans[span].get_mut(usize::from(level)) {
                packets.push(packet);
            }
        }
        units
    }
}

/// What a byte of `packet` adds to the pictures of the time that it holds for.
fn usefulness(graph: &PacketGraph, packet: PacketIndex) -> f64 {
    let per_byte = |group: &Group| {
        let frames = f64::from(group.last_frame - group.first_frame + 1);
        let bytes: u64 =
            group.packets.iter().map(|packet| u64::from(graph.packets()[packet.at()].wire_bytes)).sum();
        group.utility * frames / (bytes.max(1) as f64)
    };
    let groups = graph.packets()[packet.at()].groups.iter();
    groups.map(|group| per_byte(&graph.groups()[group.at()])).fold(0.0, f64::max)
}

#[cfg(test)]
mod tests {
    use emulator_host::graph::Synthetic;

    use super::*;

    #[test]
    fn every_packet_but_parity_is_in_one_unit_of_its_level_and_time() {
        let graph = Synthetic { frames: 90, ..Synthetic::default() }.build(1).unwrap();
        let mut windows: Vec<u32> = graph.groups().iter().map(|group| group.first_frame).collect();
        windows.sort_unstable();
        windows.dedup();
        let units = Units::of(&graph, &windows);
        let mut seen = vec![0; graph.packets().len()];
        for (moves, spans) in [(false, &units.canonical), (true, &units.motion)] {
            for (at, levels) in spans.iter().enumerate() {
                for (level, packets) in levels.iter().enumerate() {
                    for packet in packets {
                        seen[packet.at()] += 1;
                        assert_eq!(usize::from(graph.level(*packet)), level);
                        assert!(!moves || graph.needed_from(*packet) == windows[at]);
                    }
                    let uses = packets.iter().map(|packet| usefulness(&graph, *packet));
                    assert!(uses.is_sorted_by(|a, b| a >= b), "most useful first");
                }
            }
        }
        for (packet, seen) in graph.packets().iter().zip(seen) {
            assert_eq!(seen, u32::from(packet.parity_of.is_none()));
        }
    }
}
