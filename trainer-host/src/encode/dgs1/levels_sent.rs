//! Leaves levels out: cells are cut off above the highest level that is sent.

use codec_core::internals::{
    ids::Level,
    layout::Shape,
    wire::manifest::{Cluster, Motion},
};

use super::super::{
    decisions::{Dgs1Decisions, EpochDecisions},
    packetise::CellSymbols,
};

/// Decides that cells, canonical ones before motion ones as in the lattice, are sent up to `highest`, or up
/// to where they were already cut off; cells past the end of `highest` stay as they are.
pub(super) fn decide(decisions: &mut Dgs1Decisions, highest: &[Level]) {
    let mut highest = highest.iter().map(|level| level.get());
    for epoch in &mut decisions.epochs {
        for (cluster, highest) in epoch.clusters.iter_mut().zip(&mut highest) {
            cluster.highest_level = cluster.highest_level.min(highest);
        }
    }
    for window in decisions.epochs.iter_mut().flat_map(|epoch| &mut epoch.windows) {
        for (motion, highest) in window.motions.iter_mut().zip(&mut highest) {
            motion.highest_level = motion.highest_level.min(highest);
            if motion.highest_level == 0 {
                motion.ranks = Default::default();
            }
        }
        let used = window.motions.iter().map(|motion| usize::from(motion.ranks[0])).max().unwrap_or(0);
        window.basis.truncate(used);
    }
}

/// Cuts canonical cells of an epoch off as `decisions` say.
pub(super) fn cut_canonical(cells: &mut [CellSymbols], decisions: &EpochDecisions) {
    for (cell, decided) in cells.iter_mut().zip(&decisions.clusters) {
        let top = Level::from_bits(decided.highest_level);
        let cluster = cell.shape.cluster;
        let kind = Cluster::kind_of(cluster.sh_degree(), top);
        reshape(cell, Cluster { kind, ..cluster }, None, top);
    }
}

/// Cuts the motion cells of window `window` off as `decisions` say.
pub(super) fn cut_motion(cells: &mut [CellSymbols], decisions: &EpochDecisions, window: usize) {
    let motions = decisions.windows.iter().skip(window).take(1).flat_map(|w| &w.motions);
    for (cell, decided) in cells.iter_mut().zip(motions) {
        let top = Level::from_bits(decided.highest_level);
        let (cluster, motion) = (cell.shape.cluster, cell.shape.motion);
        let kind = Motion::kind_of(motion.class(), top);
        reshape(cell, cluster, Some(Motion { kind, ..motion }), top);
    }
}

fn reshape(cell: &mut CellSymbols, cluster: Cluster, motion: Option<Motion>, top: Level) {
    let Shape { quant, frames, block_len, .. } = cell.shape;
    cell.shape = Shape::dgs1(cluster, quant, motion, frames, block_len);
    for level in Level::ALL.into_iter().filter(|&level| level > top) {
        cell.levels[level.index()].clear();
    }
}

#[cfg(test)]
mod tests {
    use codec_core::{Gaussian, internals::receiver::for_each_cell};

    use super::*;
    use crate::{
        encode::{EncodeOptions, encode, with_levels},
        import::{
            Limits,
            synth::{self, SynthKind},
        },
        stream::Player,
    };

    fn values(g: &Gaussian) -> Vec<f32> {
        let Gaussian { position, scale, rotation, opacity, sh0 } = g;
        [&position[..], &scale[..], &rotation[..], &[*opacity], &sh0[..]].concat()
    }

    /// What a stream without some levels shows is what the whole stream shows where they are missing.
    #[test]
    fn a_level_not_sent_is_a_level_that_is_missing() {
        let options = synth::SynthOptions {
            gaussians: 1500,
            frames: 40,
            kind: SynthKind::Figure,
            ..Default::default()
        };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = EncodeOptions { keep_invisible: true, ..EncodeOptions::default() };
        let whole = encode(&scene, &options, &crate::encode::no_progress).unwrap();
        let manifest = whole.stream.manifest().unwrap();
        let highest: Vec<Level> = (0..manifest.cells()).map(|c| Level::ALL[(c * 7 / 3) % 4]).collect();
        let cut = with_levels(
            &scene,
            &whole.decisions,
            &highest,
            options.table_choices,
            &crate::encode::no_progress,
        )
        .unwrap();
        assert_eq!(whole.order, cut.order);
        assert!(cut.report.ledger.wire() < 0.9 * whole.report.ledger.wire());
        let (received, received_cut) = (whole.stream.receive().unwrap(), cut.stream.receive().unwrap());
        assert_eq!(received_cut.counters().refused.iter().sum::<u32>(), 0);
        let (content, content_cut) = (received.content(), received_cut.content());
        let mut state = content.blocks.to_vec();
        let mut highest = highest.into_iter();
        for_each_cell(&manifest, |span, cluster, shape| {
            let first = content.cell(span, cluster).unwrap().blocks as usize;
            let keep = (2u8 << highest.next().unwrap().get()) - 1;
            state[first..first + shape.blocks()].iter_mut().for_each(|m| *m &= keep);
            Ok(())
        })
        .unwrap();
        let mut players = [Player::new(content.manifest), Player::new(content_cut.manifest)];
        let apart = |a: &[Gaussian], b: &[Gaussian]| {
            let close = |(a, b): (&Gaussian, &Gaussian)| {
                values(a).iter().zip(values(b)).all(|(a, b)| (a - b).abs() <= 2e-5 * (1.0 + a.abs()))
            };
            a.len() != b.len() || !a.iter().zip(b).all(close)
        };
        for frame in [0, 13, 31, 39] {
            let missing = players[0].instant(&content.with_state(&state), frame).unwrap();
            let sent = players[1].instant(&content_cut, frame).unwrap();
            assert!(!apart(&missing.gaussians, &sent.gaussians), "frame {frame}");
            // The comparator sees levels.
            let all = players[0].instant(&content, frame).unwrap();
            assert!(apart(&all.gaussians, &sent.gaussians), "frame {frame}");
        }
    }
}
