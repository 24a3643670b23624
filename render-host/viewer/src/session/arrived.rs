//! Says whether anything has come of what a frame shows: who plays a stream that grows may be ahead of it.

use codec_core::internals::{
    closure::levels_with_symbols,
    ids::{ClusterId, Level, Span},
    layout::Shape,
    receiver::Content,
};

use super::Session;

impl Session {
    /// Whether anything has come of the window of the frame that is due, or of its epoch where it lies in
    /// none. Of a file all comes.
    pub fn has_come(&self) -> bool {
        !self.live || has_come(&self.player.content(), self.playback.frame())
    }
}

/// Whether any base that is coded has come of what `frame` shows. Blocks of which nothing is coded, because
/// they stand still, say nothing of that.
fn has_come(content: &Content, frame: u32) -> bool {
    let manifest = content.manifest;
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
