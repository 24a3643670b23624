//! Measures utilities from states that are each decoded, rendered and compared alone: the slow twin.

use codec_core::internals::{
    ids::{ClusterId, EpochId, Span, WindowId},
    receiver::Content,
};
use rayon::prelude::*;
use render_host::Renderer;

use super::{
    Delta, References, UtilityError, UtilityOptions,
    contexts::{SpanCells, spans},
    references::Quantity,
    state_of, versions,
};
use crate::stream::{PacketMap, Player};

/// Mean Δ of the groups of every `every`-th cell, as [`super::measure`] finds it: index in
/// [`PacketMap::groups`] and mean, in order of groups.
///
/// # Errors
/// As [`super::measure`].
pub fn measure_alone(
    references: &References<'_>,
    content: &Content<'_>,
    map: &PacketMap,
    options: &UtilityOptions,
    every: usize,
) -> Result<Vec<(usize, f64)>, UtilityError> {
    let options = &options.of_content(content);
    let mut sums = std::collections::BTreeMap::new();
    for span in spans(map) {
        let views = references.views_of(content, span.span, Quantity::Utility, options.seed)?;
        let samples = (views * options.states()) as f64;
        for view in 0..views {
            let deltas = deltas_in_view(references, content, map, &span, view, options, every)?;
            for Delta { group, delta, .. } in deltas {
                *sums.entry(group).or_insert(0.0) += delta / samples;
            }
        }
    }
    Ok(sums.into_iter().collect())
}

/// Δ of the groups of every `every`-th cell of `span` in all contexts, in view `view` of the span.
pub(super) fn deltas_in_view(
    references: &References<'_>,
    content: &Content<'_>,
    map: &PacketMap,
    span: &SpanCells,
    view: usize,
    options: &UtilityOptions,
    every: usize,
) -> Result<Vec<Delta>, UtilityError> {
    let (_, view) =
        references.view(content, span.span, Quantity::Utility, view, options.seed, &options.settings)?;
    let cells: Vec<(usize, &[usize])> = span.groups(map).step_by(every.max(1)).collect();
    let mut out = Vec::new();
    for context in 0..options.states() {
        let state = state_of(content, map, span.span, context, options);
        let of_cell = |(player, renderer): &mut (Player, Renderer),
                       &(cluster, groups): &(usize, &[usize])| {
            let mut before = None;
            let mut deltas = Vec::new();
            for levels in 0..=groups.len() {
                let stepped = span.stepped(map, content, &state, levels);
                let state = with_cluster(content, &state, &stepped, ClusterId(cluster as u16));
                let distance = view.distance(content, &state, &options.settings, player, renderer)?;
                if let (Some(before), Some(below)) = (before, levels.checked_sub(1)) {
                    deltas.push(Delta { group: groups[below], context, delta: before - distance });
                }
                before = Some(distance);
            }
            Ok(deltas)
        };
        let start = || (Player::new(content.manifest), Renderer::new());
        let found: Result<Vec<Vec<Delta>>, UtilityError> =
            cells.par_iter().map_init(start, of_cell).collect();
        out.extend(found?.into_iter().flatten());
    }
    Ok(out)
}

/// `state` with all blocks of one cluster as in `other`.
fn with_cluster(content: &Content<'_>, state: &[u8], other: &[u8], cluster: ClusterId) -> Vec<u8> {
    let mut out = state.to_vec();
    let head = content.manifest.head();
    let windows = (0..head.windows).map(|w| Span::Motion(WindowId(w)));
    let epochs = (0..head.epochs).map(|e| Span::Canonical(EpochId(e)));
    for blocks in epochs.chain(windows).filter_map(|s| versions::blocks_of(content, s, cluster)) {
        out[blocks.clone()].copy_from_slice(&other[blocks]);
    }
    out
}
