//! Prunes what need not be sent: Gaussians that are never drawn, harmonic bands that do not show.

use codec_core::internals::quant::Class;
use rayon::prelude::*;

use super::indices::Indices;
use crate::scene::{Epoch, Track};

/// Renderers draw nothing below opacity 1/255 (source: 3DGS), whose logit is −ln 254; the rest is a
/// margin for their rounding.
const MIN_LOGIT: f32 = -5.537_334 - 1e-4;

/// Squared error, in steps, that a bit is worth: at high rate one bit more quarters an error of
/// 1/12, so at the margin it buys ln 4 / 12.
const ERROR_PER_BIT: f64 = 0.115_5;

/// `sets` without the Gaussians whose opacity stays below what is drawn at every frame, and
/// without the sets that leaves empty.
pub(super) fn drawn(epoch: &Epoch, sets: Vec<Vec<u32>>) -> Vec<Vec<u32>> {
    let logits = match &epoch.attributes().opacity_logits {
        Track::Constant(values) | Track::PerFrame(values) => values.as_slice(),
    };
    let is_drawn = |i: &u32| logits.chunks(epoch.count().max(1)).any(|frame| frame[*i as usize] >= MIN_LOGIT);
    sets.into_par_iter()
        .map(|set| set.into_iter().filter(is_drawn).collect::<Vec<u32>>())
        .filter(|set| !set.is_empty())
        .collect()
}

/// The harmonic degree each cluster is sent with: bands are dropped from the top while the error
/// that makes costs less than their bits. Bits are those of the values' statistics over all
/// clusters, so a band that is zero in one cluster only is dropped there.
pub(super) fn degrees(clusters: &[Indices], degree: u8) -> Vec<u8> {
    let mut degrees = vec![degree; clusters.len()];
    for class in [Class::Sh3, Class::Sh2, Class::Sh1] {
        if class.sh_degree() > degree {
            continue;
        }
        let bits = value_bits(clusters, class);
        for (cluster, degree) in clusters.iter().zip(&mut degrees) {
            let values = || cluster[class.index()].iter().flatten();
            let error: f64 = values().map(|&q| f64::from(q).powi(2)).sum();
            let rate: f64 = values().map(|&q| bits[value(q)]).sum();
            if *degree == class.sh_degree() && error <= ERROR_PER_BIT * rate {
                *degree -= 1;
            }
        }
    }
    degrees
}

/// The least harmonic degree, at most `degree`, above which every value of a cluster is zero.
pub(super) fn degree_in_use(cluster: &Indices, degree: u8) -> u8 {
    let is_zero = |class: &Class| cluster[class.index()].iter().flatten().all(|&q| q == 0);
    let unused = [Class::Sh3, Class::Sh2, Class::Sh1].into_iter().filter(|class| class.sh_degree() <= degree);
    degree - unused.take_while(is_zero).count() as u8
}

/// Finest indices farther from 0 than this cost the same.
const FAR: i32 = 2048;

fn value(q: i32) -> usize {
    (q.clamp(-FAR, FAR) + FAR) as usize
}

/// Bits of each value of `class` over all clusters.
fn value_bits(clusters: &[Indices], class: Class) -> Vec<f64> {
    let mut counts = vec![0u64; 2 * FAR as usize + 1];
    for &q in clusters.iter().flat_map(|c| c[class.index()].iter().flatten()) {
        counts[value(q)] += 1;
    }
    let total: u64 = counts.iter().sum();
    counts.into_iter().map(|c| (total.max(1) as f64 / c.max(1) as f64).log2()).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Attributes;
    use codec_core::ShDegree;

    #[test]
    fn what_is_never_drawn_is_left_out() {
        let n = 5;
        // Below the cut-off at all frames: 1; at one frame only: 2. At it exactly: 3.
        let exact = (1.0f32 / 254.0).ln();
        let logits = vec![1.0, -7.0, -7.0, exact, 2.0, 1.0, -6.0, 3.0, -7.0, 2.0];
        let epoch = Epoch::new(
            2,
            Attributes {
                positions: Track::Constant(vec![[0.0; 3]; n]),
                rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]; n]),
                log_scales: Track::Constant(vec![[-3.0; 3]; n]),
                opacity_logits: Track::PerFrame(logits),
                sh0: Track::Constant(vec![[0.0; 3]; n]),
                sh_rest: Vec::new(),
                sh_degree: ShDegree::ZERO,
            },
        )
        .unwrap();
        assert_eq!(drawn(&epoch, vec![vec![0, 1], vec![1], vec![2, 3, 4]]), [vec![0], vec![2, 3, 4]]);
    }

    fn cluster(sh1: i32, sh2: i32) -> Indices {
        Class::ALL.map(|class| {
            let value = match class {
                Class::Sh1 => sh1,
                Class::Sh2 => sh2,
                Class::Sh3 => return Vec::new(),
                _ => 0,
            };
            // Every third value, the rest zero.
            vec![(0..30).map(|i| if i % 3 == 0 { value } else { 0 }).collect(); class.components()]
        })
    }

    #[test]
    fn only_clusters_with_view_dependent_colour_keep_bands() {
        let clusters = [cluster(0, 0), cluster(5, 0), cluster(5, 5), cluster(0, 5)];
        assert_eq!(degrees(&clusters, 2), [0, 1, 2, 2]);
        assert_eq!(clusters.each_ref().map(|cluster| degree_in_use(cluster, 2)), [0, 1, 2, 2]);
        assert_eq!(degree_in_use(&clusters[2], 1), 1);
        // Nothing to drop, nothing dropped.
        assert_eq!(degrees(&clusters, 0), [0, 0, 0, 0]);
    }
}
