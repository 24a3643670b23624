//! Chooses which packets of too many stay, where a file may have so many bytes.

use std::collections::BTreeSet;

use anyhow::{Result, bail};
use codec_core::internals::{
    closure::Needs,
    ids::{Group, Level, Span},
    wire::manifest::Manifest,
};
use emulator_host::policy;
use trainer_host::{
    Stream,
    stream::{PacketMap, SlicePlacement},
    utility::Table,
};

use super::parity;
use crate::pipeline;

/// Bytes of a file that a packet takes besides its own: its length and its place in the index.
const RECORD_BYTES: u64 = 6;

/// Packets that are there by what each byte of them adds, what each needs before it; those that add nothing
/// last.
pub(super) fn order_by_utility(stream: &Stream, map: &PacketMap, table: &Table) -> Vec<usize> {
    let graph = pipeline::ranked_graph(stream, map, table);
    // Of a stream of which nothing shows, nothing is ranked.
    let mut order: Vec<usize> = graph.map_or_else(
        |_| Vec::new(),
        |graph| {
            policy::order_by_utility(&graph).iter().map(|packet| graph.wire_id(*packet).index()).collect()
        },
    );
    let mut is_ranked = vec![false; stream.packets().len()];
    order.iter().for_each(|&id| is_ranked[id] = true);
    order.extend(order_by_level(stream, map).into_iter().filter(|&id| !is_ranked[id]));
    order
}

/// Packets that are there by level, those of one level as they lie in the stream.
pub(super) fn order_by_level(stream: &Stream, map: &PacketMap) -> Vec<usize> {
    let is_media = |&id: &usize| !stream.packets()[id].is_empty() && !map.is_parity(id);
    let mut order: Vec<usize> = (0..stream.packets().len()).filter(is_media).collect();
    let lowest = |id: usize| map.placements(id).iter().map(|placement| placement.group.level).min();
    order.sort_by_key(|&id| lowest(id).map_or(u8::MAX, |level| level.get()));
    order
}

/// Leaves packets out until the file has at most `bytes`. Packets come in `order`, each that still fits and
/// whose blocks have what they are decoded upon; then parity of repair sets that are whole, as far as it
/// fits. Whether any packet had to go.
pub(super) fn within(
    stream: &Stream,
    map: &PacketMap,
    order: &[usize],
    stays: &mut [bool],
    bytes: u64,
) -> Result<bool> {
    let manifest = stream.manifest()?;
    if stream.with_packets(|id| stays[id]).to_bytes()?.len() as u64 <= bytes {
        return Ok(false);
    }
    let least = stream.with_packets(|_| false).to_bytes()?.len() as u64;
    if least > bytes {
        bail!("--bytes is {bytes}; at least {least} are needed, for the manifest alone");
    }
    let mut left = bytes - least;
    let mut take = |id: usize| {
        let cost = stream.packets()[id].len() as u64 + RECORD_BYTES;
        let fits = cost <= left;
        left -= if fits { cost } else { 0 };
        fits
    };
    let mut some = vec![false; stays.len()];
    let mut left_out = LeftOutBlocks::default();
    for &id in order.iter().filter(|&&id| stays[id]) {
        let placements = map.placements(id);
        some[id] = !left_out.leaves_undecodable(&manifest, map, placements) && take(id);
        if !some[id] {
            left_out.add(placements);
        }
    }
    let mut with_parity: Vec<bool> =
        (0..stays.len()).map(|id| some[id] || stays[id] && map.is_parity(id)).collect();
    parity::only_of_whole_sets(&manifest, stream, &mut with_parity);
    for id in (0..stays.len()).filter(|&id| map.is_parity(id)) {
        some[id] = with_parity[id] && take(id);
    }
    stays.copy_from_slice(&some);
    Ok(true)
}

/// Levels of blocks that were left out, by the block's number in the whole state.
#[derive(Default)]
struct LeftOutBlocks {
    blocks: BTreeSet<(usize, Level)>,
}

impl LeftOutBlocks {
    fn add(&mut self, placements: &[SlicePlacement]) {
        for placement in placements {
            let blocks = placement.first_block..placement.first_block + placement.blocks;
            self.blocks.extend(blocks.map(|block| (block, placement.group.level)));
        }
    }

    /// Whether anything of `placements` is decoded upon what was left out.
    fn leaves_undecodable(
        &self,
        manifest: &Manifest<'_>,
        map: &PacketMap,
        placements: &[SlicePlacement],
    ) -> bool {
        !self.blocks.is_empty()
            && placements.iter().any(|placement| self.slice_is_undecodable(manifest, map, placement))
    }

    fn slice_is_undecodable(
        &self,
        manifest: &Manifest<'_>,
        map: &PacketMap,
        placement: &SlicePlacement,
    ) -> bool {
        let Group { span, cluster, level } = placement.group;
        let mut blocks = placement.first_block..placement.first_block + placement.blocks;
        let mut lower = Level::ALL.into_iter().filter(|lower| *lower < level);
        if lower.any(|lower| blocks.clone().any(|block| self.blocks.contains(&(block, lower)))) {
            return true;
        }
        let base = Needs::in_manifest(manifest, span, cluster, level).and_then(|needs| needs.base);
        let first = |span: Span| {
            let cell = manifest.cell(span, cluster)?;
            map.first_blocks().get(cell.index()).copied()
        };
        let Some((of_motion, of_base)) =
            base.and_then(|epoch| first(span).zip(first(Span::Canonical(epoch))))
        else {
            return false;
        };
        blocks.any(|block| self.blocks.contains(&(block - of_motion + of_base, Level::BASE)))
    }
}
