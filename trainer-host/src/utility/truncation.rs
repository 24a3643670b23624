//! Leaves out the levels that gain less than their bytes cost: the last step of rate against distortion.

use codec_core::internals::{
    ids::{Level, Span},
    receiver::Content,
};
use render_host::{Camera, CameraError};

use super::{Table, UtilityOptions};
use crate::{
    encode::{self, EncodeError, Encoded, Progress, Report},
    scene::Scene,
    stream::{PacketMap, Stream},
    viewpoint::{Framing, Ring},
};

impl UtilityOptions {
    /// How to measure what levels gain once everything is there: in the complete state.
    pub fn complete() -> Self {
        Self { complete: true, ..Self::paper() }
    }
}

/// The cameras that truncation measures from: two validation rings, as far above the horizon as below.
///
/// # Errors
/// None in practice: the size is one that cameras accept.
pub fn truncation_cameras(scene: &Scene) -> Result<Vec<Camera>, CameraError> {
    let framing = Framing::of(scene);
    let mut cameras = framing.ring(Ring::Validation, 4, (160, 160))?;
    cameras.extend(framing.upside_down().ring(Ring::Validation, 4, (160, 160))?);
    Ok(cameras)
}

/// Bytes that each group of [`PacketMap::groups`] takes: of each packet in proportion to symbols.
pub(super) fn group_bytes(stream: &Stream, map: &PacketMap) -> Vec<f64> {
    let index: std::collections::BTreeMap<_, usize> =
        map.groups().iter().enumerate().map(|(i, (group, _))| (*group, i)).collect();
    let mut bytes = vec![0.0; map.groups().len()];
    for (id, packet) in stream.packets().iter().enumerate() {
        let marks = map.placements(id);
        let symbols: usize = marks.iter().map(|m| m.symbols).sum();
        for mark in marks {
            if let Some(&at) = index.get(&mark.group) {
                bytes[at] += packet.len() as f64 * mark.symbols as f64 / symbols.max(1) as f64;
            }
        }
    }
    bytes
}

/// A gain up to this is rounding: two sums of one picture, taken in different order, agree within it.
const NO_GAIN: f64 = 1e-12;

/// The highest level of each cell that pays for its bytes at `lambda`: where the sum over the levels
/// of gain − λ · bytes is largest, the lowest of equals. Gain is the mean of Δ in `table`, averaged
/// over all frames of the clip; λ is gain per byte. Base levels are always sent.
fn tops(content: &Content<'_>, map: &PacketMap, table: &Table, bytes: &[f64], lambda: f64) -> Vec<Level> {
    let manifest = content.manifest;
    let all = f64::from(manifest.head().frames.max(1));
    let mut tops = vec![Level::BASE; manifest.cells()];
    // Best sum so far and sum so far, per cell.
    let mut sums = vec![(0.0, 0.0); manifest.cells()];
    for (((group, _), utility), bytes) in map.groups().iter().zip(&table.groups).zip(bytes) {
        let Some(cell) = manifest.cell(group.span, group.cluster) else { continue };
        if group.level == Level::BASE {
            continue;
        }
        let frames = match group.span {
            Span::Canonical(e) => manifest.epoch(e).map_or(0, |e| e.frames),
            Span::Motion(w) => manifest.window(w).map_or(0, |w| u32::from(w.frames)),
        };
        let (best, sum) = &mut sums[cell.index()];
        let gain = if utility.mean.abs() > NO_GAIN { utility.mean } else { 0.0 };
        *sum += gain * f64::from(frames) / all - lambda * bytes;
        if *sum > *best {
            *best = *sum;
            tops[cell.index()] = group.level;
        }
    }
    tops
}

/// What truncation did.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize)]
pub struct Truncated {
    /// λ, gain per byte.
    pub lambda: f64,
    /// Groups of the whole stream.
    pub groups: usize,
    /// Those no longer sent.
    pub dropped: usize,
    /// Bytes on the wire of the whole stream.
    pub wire_before: f64,
    /// Bytes on the wire of what is left.
    pub wire_after: f64,
}

/// Encodes `scene` again without the levels that `table`, the utilities of `whole`, does not find to pay for
/// their bytes at `lambda` (0: those that gain nothing). Table sets have at most `table_choices` tables.
///
/// # Errors
/// A λ that is not a number of at least 0; a stream that does not decode; as [`encode::encode`].
pub fn truncate(
    scene: &Scene,
    whole: &Encoded,
    table: &Table,
    lambda: f64,
    table_choices: usize,
    progress: Progress<'_>,
) -> Result<(Encoded, Truncated), EncodeError> {
    let stream = &whole.stream;
    if !(lambda >= 0.0 && lambda.is_finite()) {
        return Err(EncodeError::Lambda { found: lambda });
    }
    let map = PacketMap::of(stream)?;
    let received = stream.receive()?;
    let tops = tops(&received.content(), &map, table, &group_bytes(stream, &map), lambda);
    let mut cut = encode::with_levels(scene, &whole.decisions, &tops, table_choices, progress)?;
    let left = PacketMap::of(&cut.stream)?.groups().len();
    let truncated = Truncated {
        lambda,
        groups: map.groups().len(),
        dropped: map.groups().len().saturating_sub(left),
        wire_before: whole.report.ledger.wire(),
        wire_after: cut.report.ledger.wire(),
    };
    let Report { reached, searched, .. } = whole.report;
    cut.report = Report { reached, searched, ..cut.report };
    Ok((cut, truncated))
}

#[cfg(test)]
mod tests {
    use codec_core::internals::{gaussian::ShDegree, quant::Class};

    use super::*;
    use crate::{
        evaluator::Evaluator,
        scene::{Attributes, Epoch, Track},
        utility::{References, measure},
    };

    /// An opaque ball of large discs around a core of `inner` small Gaussians that nobody sees.
    fn hidden(inner: usize) -> Scene {
        let shell = 1200;
        let golden = std::f32::consts::PI * (3.0 - 5f32.sqrt());
        let on_ball = |i: usize, n: usize, radius: f32| {
            let y = 1.0 - 2.0 * (i as f32 + 0.5) / n as f32;
            let (s, c) = (golden * i as f32).sin_cos();
            let flat = (1.0 - y * y).sqrt();
            [radius * flat * c, radius * y, radius * flat * s]
        };
        let positions: Vec<[f32; 3]> = (0..shell)
            .map(|i| on_ball(i, shell, 1.0))
            .chain((0..inner).map(|i| on_ball(i, inner, 0.02 + 0.03 * (i % 7) as f32 / 7.0)))
            .collect();
        let n = positions.len();
        let outside = |i: usize| i < shell;
        let attributes =
            Attributes {
                positions: Track::Constant(positions.clone()),
                rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]; n]),
                log_scales: Track::Constant(
                    (0..n)
                        .map(|i| if outside(i) { [-1.6; 3] } else { [-4.0 - 0.1 * (i % 5) as f32; 3] })
                        .collect(),
                ),
                opacity_logits: Track::Constant(vec![7.0; n]),
                // Colours of the shell change slowly, so that it does not matter which of two discs is in
                // front.
                sh0: Track::Constant(
                    (0..n)
                        .map(|i| {
                            if outside(i) {
                                positions[i].map(|x| 0.5 * x)
                            } else {
                                [0.1 * (i % 17) as f32; 3]
                            }
                        })
                        .collect(),
                ),
                sh_rest: Vec::new(),
                sh_degree: ShDegree::ZERO,
            };
        Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap()
    }

    #[test]
    fn levels_of_what_is_hidden_are_not_sent() {
        let scene = hidden(400);
        // Equal steps for all: where steps follow what shows, the base of what is hidden is so coarse that it
        // may stick out of the shell, and finer levels put it back.
        let options = encode::EncodeOptions { pictures: 0, ..encode::EncodeOptions::default() };
        let whole = encode::encode(&scene, &options, &crate::encode::no_progress).unwrap();
        let map = PacketMap::of(&whole.stream).unwrap();
        let received = whole.stream.receive().unwrap();
        let cameras = truncation_cameras(&scene).unwrap();
        let references = References::renders(&scene, &cameras, &cameras);
        let how = UtilityOptions::complete();
        let table = measure(&references, &received.content(), &map, &how, &|_| {}).unwrap();
        let (cut, truncated) =
            truncate(&scene, &whole, &table, 0.0, options.table_choices, &crate::encode::no_progress)
                .unwrap();
        assert!(truncated.dropped >= 3 && truncated.wire_after < truncated.wire_before, "{truncated:?}");
        let manifest = cut.stream.manifest().unwrap();
        // The core's clusters are the small ones.
        let (mut small, mut large) = (0.0f32, f32::INFINITY);
        codec_core::internals::receiver::for_each_cell(&manifest, |_, _, shape| {
            let step = shape.quant.canonical[Class::Position.index()].step(Level::BASE);
            let radius = f32::from(shape.cluster.radius) * step;
            match shape.top() {
                Level::BASE => small = radius.max(small),
                _ => large = radius.min(large),
            }
            Ok(())
        })
        .unwrap();
        assert!(0.0 < small && small < large && large.is_finite(), "{small} {large}");
        // What can be seen is no worse for it.
        let evaluator = Evaluator::validation(&scene, vec![0]).unwrap();
        let (before, after) =
            (evaluator.whole(&whole.stream).unwrap(), evaluator.whole(&cut.stream).unwrap());
        assert!(after > before - 0.1, "{after} dB after {before}");
        // A price that no level pays leaves base levels; one that is no price is refused.
        let (base, _) =
            truncate(&scene, &whole, &table, 1e9, options.table_choices, &crate::encode::no_progress)
                .unwrap();
        codec_core::internals::receiver::for_each_cell(&base.stream.manifest().unwrap(), |_, _, shape| {
            assert_eq!(shape.top(), Level::BASE);
            Ok(())
        })
        .unwrap();
        for lambda in [-1.0, f64::NAN] {
            let refused =
                truncate(&scene, &whole, &table, lambda, options.table_choices, &crate::encode::no_progress);
            assert!(matches!(refused, Err(EncodeError::Lambda { .. })));
        }
    }
}
