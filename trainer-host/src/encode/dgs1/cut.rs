//! Levels that are not sent: cells cut off above a top.

use codec_core::internals::{
    ids::Level,
    layout::Shape,
    wire::manifest::{Cluster, Motion},
};

use super::{super::packetise::CellSymbols, EpochPlan};

/// Cuts the cells of `plans`, canonical ones before motion ones as in the lattice, off above `tops`;
/// cells past the end of `tops` stay whole.
pub(super) fn cut(plans: &mut [EpochPlan], tops: &[Level]) {
    let mut tops = tops.iter().copied();
    for plan in plans.iter_mut() {
        for (cell, top) in plan.canonical.iter_mut().zip(&mut tops) {
            let cluster = &cell.shape.cluster;
            let kind = Cluster::kind_of(cluster.sh_degree(), top.min(cluster.top()));
            let cluster = Cluster { kind, ..*cluster };
            reshape(cell, cluster, None, top);
        }
        plan.clusters = plan.canonical.iter().map(|c| c.shape.cluster).collect();
    }
    for window in plans.iter_mut().flat_map(|p| &mut p.windows) {
        for (cell, top) in window.cells.iter_mut().zip(&mut tops) {
            let motion = cell.shape.motion;
            let kind = Motion::kind_of(motion.class(), top.min(motion.top()));
            let mut motion = Motion { kind, ..motion };
            if motion.top() == Level::BASE {
                (motion.position, motion.scale, motion.rotation) = (0, 0, 0);
                (motion.opacity, motion.sh0) = (0, 0);
            }
            reshape(cell, cell.shape.cluster, Some(motion), top);
        }
        let used = window.cells.iter().map(|c| usize::from(c.shape.motion.position)).max().unwrap_or(0);
        window.basis.truncate(used);
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
        encode::{Options, encode},
        import::{
            Limits,
            synth::{self, Kind},
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
        let options =
            synth::Options { gaussians: 1500, frames: 40, kind: Kind::Figure, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let options = Options { keep_invisible: true, ..Options::default() };
        let whole = encode(&scene, &options, &|_, _| {}).unwrap();
        let manifest = whole.stream.manifest().unwrap();
        let tops: Vec<Level> = (0..manifest.cells()).map(|c| Level::ALL[(c * 7 / 3) % 4]).collect();
        let cut = encode(&scene, &Options { tops: tops.clone(), ..options }, &|_, _| {}).unwrap();
        assert_eq!(whole.order, cut.order);
        assert!(cut.report.ledger.wire() < 0.9 * whole.report.ledger.wire());
        let (received, received_cut) = (whole.stream.receive().unwrap(), cut.stream.receive().unwrap());
        assert_eq!(received_cut.counters().refused.iter().sum::<u32>(), 0);
        let (content, content_cut) = (received.content(), received_cut.content());
        let mut state = content.blocks.to_vec();
        let mut tops = tops.into_iter();
        for_each_cell(&manifest, |span, cluster, shape| {
            let first = content.cell(span, cluster).unwrap().blocks as usize;
            let keep = (2u8 << tops.next().unwrap().get()) - 1;
            state[first..first + shape.blocks()].iter_mut().for_each(|m| *m &= keep);
        });
        let mut players = [Player::new(&content.manifest), Player::new(&content_cut.manifest)];
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
