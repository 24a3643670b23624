//! Draws random states of a stream, and steps all cells of a span through their levels in one.

use codec_core::internals::{
    closure::Arrived,
    ids::{EpochId, Group, Level, Span},
    receiver::Content,
};
use rand::RngExt;
use rand_pcg::Pcg64;

use super::versions::blocks_of;
use crate::stream::PacketMap;

/// A span and its cells.
pub(super) struct SpanCells {
    pub(super) span: Span,
    /// Per cell, the indices of its groups in [`PacketMap::groups`], lowest level first.
    cells: Vec<Vec<usize>>,
}

/// The spans of a stream, in order.
pub(super) fn spans(map: &PacketMap) -> Vec<SpanCells> {
    let mut spans: Vec<SpanCells> = Vec::new();
    let mut last: Option<Group> = None;
    for (index, (group, _)) in map.groups().iter().enumerate() {
        if last.is_none_or(|l| l.span != group.span) {
            spans.push(SpanCells { span: group.span, cells: Vec::new() });
        }
        if let Some(span) = spans.last_mut() {
            let is_same = last.is_some_and(|l| (l.span, l.cluster) == (group.span, group.cluster));
            match span.cells.last_mut().filter(|_| is_same) {
                Some(cell) => cell.push(index),
                None => span.cells.push(vec![index]),
            }
        }
        last = Some(*group);
    }
    spans
}

impl SpanCells {
    /// Levels of the cell that has most.
    pub(super) fn most_levels(&self) -> usize {
        self.cells.iter().map(Vec::len).max().unwrap_or(0)
    }

    /// Cluster of each cell, and the indices of its groups.
    pub(super) fn groups<'a>(&'a self, map: &'a PacketMap) -> impl Iterator<Item = (usize, &'a [usize])> {
        self.cells.iter().map(|groups| (map.groups()[groups[0]].0.cluster.index(), groups.as_slice()))
    }

    /// `state` with every cell of the span at its first `levels` levels. Clusters do not change each other,
    /// so one state steps them all; each is read as if the others were as in `state`.
    pub(super) fn stepped(
        &self,
        map: &PacketMap,
        content: &Content<'_>,
        state: &[u8],
        levels: usize,
    ) -> Vec<u8> {
        let mut out = state.to_vec();
        for groups in &self.cells {
            let (group, _) = map.groups()[groups[0]];
            let Some(blocks) = blocks_of(content, group.span, group.cluster) else { continue };
            out[blocks.clone()].copy_from_slice(&map.initial()[blocks.clone()]);
            for &index in groups.iter().take(levels) {
                add(&mut out[blocks.clone()], map.groups()[index].0.level);
            }
            // Motion shows only on blocks that are there.
            if let Span::Motion(window) = group.span {
                let epoch = content.manifest.window(window).map_or(0, |window| window.epoch);
                let canonical = blocks_of(content, Span::Canonical(EpochId(epoch)), group.cluster);
                if let Some(blocks) = canonical {
                    add(&mut out[blocks], Level::BASE);
                }
            }
        }
        out
    }
}

/// Adds a level to blocks.
fn add(blocks: &mut [u8], level: Level) {
    blocks.iter_mut().for_each(|arrived| *arrived = Arrived(*arrived).with(level).0);
}

/// A random dependency-closed state: every cell at a random number of levels, bases likelier than
/// not, as a receiver in mid-delivery has them.
pub(super) fn random_state(map: &PacketMap, rng: &mut Pcg64, content: &Content<'_>) -> Vec<u8> {
    let mut state = map.initial().to_vec();
    let arriving: f64 = rng.random_range(0.4..1.0);
    let mut cell: Option<Group> = None;
    let mut has_below = true;
    for (group, _) in map.groups() {
        if cell.is_none_or(|c| (c.span, c.cluster) != (group.span, group.cluster)) {
            has_below = true;
        }
        cell = Some(*group);
        let chance = if group.level == Level::BASE { arriving.sqrt() } else { arriving };
        has_below &= rng.random::<f64>() < chance;
        if has_below && let Some(blocks) = blocks_of(content, group.span, group.cluster) {
            add(&mut state[blocks], group.level);
        }
    }
    state
}
