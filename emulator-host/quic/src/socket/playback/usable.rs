//! Says how much of a frame is usable by what has arrived.

use codec_core::internals::{
    closure::levels_with_symbols,
    ids::{ClusterId, Level, Span},
    layout::Shape,
};
use dgs_player::Player;

/// Share of the blocks of a frame whose base is usable: their attributes, and their motion where the frame
/// lies in a window.
pub(super) fn base(player: &Player, frame: u32) -> f64 {
    let usable = player.usable(frame).unwrap_or_default();
    let moves = player.manifest().window_at(frame).is_some();
    let base = if moves { usable.motion[0] } else { usable.canonical[0] };
    f64::from(base) / f64::from(usable.blocks.max(1))
}

/// Whether any base that is coded has come of the window of `frame`, or of its epoch where it lies in none.
/// Blocks of which nothing is coded, because they stand still, say nothing of that.
pub(super) fn has_come(player: &Player, frame: u32) -> bool {
    let (content, manifest) = (player.content(), player.manifest());
    let window = manifest.window_at(frame).map(Span::Motion);
    let Some(span) = window.or_else(|| manifest.epoch_at(frame).map(Span::Canonical)) else { return true };
    let mut is_coded = false;
    for cluster in (0..manifest.clusters_of(span).unwrap_or(0)).map(|cluster| ClusterId(cluster as u16)) {
        let (Ok(shape), Ok(cell)) =
            (Shape::in_lattice(manifest, span, cluster), content.cell_in_lattice(span, cluster))
        else {
            continue;
        };
        if levels_with_symbols(&shape).has(Level::BASE) {
            is_coded = true;
            let has = |block| content.arrived(cell, block).is_ok_and(|arrived| arrived.has(Level::BASE));
            if (0..shape.blocks()).any(has) {
                return true;
            }
        }
    }
    !is_coded
}

/// Mean level count.
pub(super) fn levels(usable: &[u32], blocks: u32) -> f64 {
    usable.iter().map(|count| f64::from(*count)).sum::<f64>() / f64::from(blocks.max(1))
}
