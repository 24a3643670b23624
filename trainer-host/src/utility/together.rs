//! Measures what the base groups of a span add at once, which is not the sum of what each adds by itself.
//!
//! A part that stands still while all others move is wrong where it is and where it should be; where all
//! stand still, the picture is only late. So motion adds less at once than group by group; and holes that
//! are absent one at a time are covered by what stands around them, so that bases add more.

use codec_core::internals::receiver::Content;
use render_host::{Renderer, Settings};

use super::{contexts::SpanCells, error::UtilityError, references::View};
use crate::stream::{PacketMap, Player};

/// D without any group of `span`, less D with those of level 0 only, everything else complete.
pub(super) fn in_view(
    view: &View,
    content: &Content<'_>,
    map: &PacketMap,
    span: &SpanCells,
    settings: &Settings,
) -> Result<f64, UtilityError> {
    let (mut player, mut renderer) = (Player::new(content.manifest), Renderer::new());
    let mut distance_at = |levels: usize| {
        let state = span.stepped(map, content, content.blocks, levels);
        view.distance(content, &state, settings, &mut player, &mut renderer)
    };
    Ok(distance_at(0)? - distance_at(1)?)
}
