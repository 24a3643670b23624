//! Clusters Gaussians that lie and move together (paper section 3).
//!
//! Gaussians that stand still over the epoch are clustered apart from those that move, if both are enough for
//! a cluster: a cluster of which nothing moves sends no motion.
//!
//! Features, each family normalised to unit variance over the epoch and then weighted: canonical
//! position (3), displacement over the epoch (mean and standard deviation per axis: 6), velocity
//! (mean speed and its standard deviation: 2), visibility history (share of frames visible, mean
//! visible time: 2). A deterministic variance split bounds cluster size: a set that is too large,
//! or too spread out, is cut across its axis of largest variance where the variance within the
//! two sides is least, ties by index. Ids are the order of the leaves, a pure function of the
//! input on any number of threads.

use crate::scene::Epoch;

/// Number of features per Gaussian.
pub const FEATURES: usize = 13;

/// How to cluster.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct ClusterOptions {
    /// Most Gaussians in a cluster, 1..=32768.
    pub max_gaussians: usize,
    /// Sets of at most this many Gaussians are not cut for their spread alone.
    pub min_gaussians: usize,
    /// Largest weighted feature variance of a set that need not be cut.
    pub max_variance: f64,
    /// How much each family of features counts.
    pub weights: FeatureWeights,
}

/// Factors on the families of features, each of which has unit variance over the epoch before.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct FeatureWeights {
    /// Canonical position.
    pub position: f64,
    /// Displacement over the epoch.
    pub displacement: f64,
    /// Speed.
    pub speed: f64,
    /// Visibility over the epoch.
    pub visibility: f64,
}

impl Default for ClusterOptions {
    fn default() -> Self {
        let weights = FeatureWeights { position: 1.0, displacement: 2.0, speed: 1.0, visibility: 1.0 };
        Self { max_gaussians: 512, min_gaussians: 192, max_variance: 0.02, weights }
    }
}

/// Clusters of `epoch`: lists of Gaussian indices, each ascending; together a partition.
pub fn cluster(epoch: &Epoch, options: &ClusterOptions) -> Vec<Vec<u32>> {
    if epoch.count() == 0 {
        return Vec::new();
    }
    let (still, moving): (Vec<u32>, Vec<u32>) =
        (0..epoch.count() as u32).partition(|&i| stands_still(epoch, i as usize));
    let least = options.min_gaussians.max(1);
    let parts = if still.len().min(moving.len()) < least {
        vec![(0..epoch.count() as u32).collect()]
    } else {
        vec![still, moving]
    };
    cluster_within(epoch, parts, options)
}

/// Whether Gaussian `i` has the same place and rotation in every frame.
fn stands_still(epoch: &Epoch, i: usize) -> bool {
    let (attributes, n) = (epoch.attributes(), epoch.count());
    let (positions, rotations) = (&attributes.positions, &attributes.rotations);
    (1..epoch.frames()).all(|t| {
        positions.frame(t, n)[i] == positions.frame(0, n)[i]
            && rotations.frame(t, n)[i] == rotations.frame(0, n)[i]
    })
}

/// Clusters of `epoch` as [`cluster`] makes them, none with Gaussians of two of `parts`: disjoint lists
/// of Gaussian indices, none empty. In order of the parts.
pub fn cluster_within(epoch: &Epoch, parts: Vec<Vec<u32>>, options: &ClusterOptions) -> Vec<Vec<u32>> {
    let features = features(epoch, &options.weights);
    let mut leaves = Vec::new();
    let mut stack = parts;
    stack.reverse();
    while let Some(set) = stack.pop() {
        let (axis, variance) = widest(&features, &set);
        let spread = variance > options.max_variance && set.len() > options.min_gaussians;
        if set.len() > options.max_gaussians.max(1) || (spread && set.len() > 1) {
            let (left, right) = split(&features, set, axis);
            stack.push(right);
            stack.push(left);
        } else {
            leaves.push(set);
        }
    }
    leaves
}

/// Weighted, normalised features, [`FEATURES`] per Gaussian.
fn features(epoch: &Epoch, weights: &FeatureWeights) -> Vec<[f64; FEATURES]> {
    let (n, frames) = (epoch.count(), epoch.frames());
    let a = epoch.attributes();
    let mut out = vec![[0.0f64; FEATURES]; n];
    let start = a.positions.frame(0, n);
    for (row, p) in out.iter_mut().zip(start) {
        for d in 0..3 {
            row[d] = f64::from(p[d]);
        }
    }
    if !a.positions.is_constant() {
        for (i, row) in out.iter_mut().enumerate() {
            let (mut sum, mut squares, mut speed, mut speed2) = ([0.0; 3], [0.0; 3], 0.0, 0.0);
            let mut before = start[i];
            for t in 0..frames {
                let p = a.positions.frame(t, n)[i];
                let mut step2 = 0.0;
                for d in 0..3 {
                    let moved = f64::from(p[d]) - f64::from(start[i][d]);
                    sum[d] += moved;
                    squares[d] += moved * moved;
                    step2 += (f64::from(p[d]) - f64::from(before[d])).powi(2);
                }
                speed += step2.sqrt();
                speed2 += step2;
                before = p;
            }
            let t = frames as f64;
            for d in 0..3 {
                row[3 + d] = sum[d] / t;
                row[6 + d] = (squares[d] / t - (sum[d] / t).powi(2)).max(0.0).sqrt();
            }
            row[9] = speed / t;
            row[10] = (speed2 / t - (speed / t).powi(2)).max(0.0).sqrt();
        }
    }
    if !a.opacity_logits.is_constant() {
        // Visible: more than 5 % opaque.
        let visible = (0.05f32 / 0.95).ln();
        for (i, row) in out.iter_mut().enumerate() {
            let seen: Vec<f64> = (0..frames)
                .filter(|&t| a.opacity_logits.frame(t, n)[i] > visible)
                .map(|t| t as f64)
                .collect();
            row[11] = seen.len() as f64 / frames as f64;
            row[12] = seen.iter().sum::<f64>() / (seen.len().max(1) * frames) as f64;
        }
    }
    let families = [
        (0..3, weights.position),
        (3..9, weights.displacement),
        (9..11, weights.speed),
        (11..13, weights.visibility),
    ];
    for (range, weight) in families {
        // One scale per family, so that the shape of a family's distribution is kept.
        let total: f64 = range.clone().map(|f| variance(&out, f)).sum();
        let scale = if total > 1e-24 { weight / total.sqrt() } else { 0.0 };
        out.iter_mut().for_each(|row| row[range.clone()].iter_mut().for_each(|v| *v *= scale));
    }
    out
}

fn variance(rows: &[[f64; FEATURES]], feature: usize) -> f64 {
    let n = rows.len().max(1) as f64;
    let mean = rows.iter().map(|r| r[feature]).sum::<f64>() / n;
    rows.iter().map(|r| (r[feature] - mean).powi(2)).sum::<f64>() / n
}

/// The feature of largest variance over `set`, lowest index on ties, and that variance.
fn widest(features: &[[f64; FEATURES]], set: &[u32]) -> (usize, f64) {
    let n = set.len() as f64;
    let mut best = (0, -1.0);
    for (f, _) in [(); FEATURES].iter().enumerate() {
        let mean = set.iter().map(|&i| features[i as usize][f]).sum::<f64>() / n;
        let variance = set.iter().map(|&i| (features[i as usize][f] - mean).powi(2)).sum::<f64>() / n;
        if variance > best.1 {
            best = (f, variance);
        }
    }
    best
}

/// Cuts `set` across `axis` where the summed squared deviation of both sides is least; each side
/// keeps at least an eighth.
fn split(features: &[[f64; FEATURES]], mut set: Vec<u32>, axis: usize) -> (Vec<u32>, Vec<u32>) {
    let value = |i: u32| features[i as usize][axis];
    set.sort_by(|&a, &b| value(a).total_cmp(&value(b)).then(a.cmp(&b)));
    let n = set.len();
    let least = (n / 8).max(1);
    let total: f64 = set.iter().map(|&i| value(i)).sum();
    let (mut left, mut best) = (0.0, (n / 2, f64::NEG_INFINITY));
    for cut in 1..n {
        left += value(set[cut - 1]);
        if cut < least || n - cut < least {
            continue;
        }
        // Between-side variance: maximal where within-side variance is minimal (Otsu's criterion).
        let (a, b) = (cut as f64, (n - cut) as f64);
        let gain = left * left / a + (total - left) * (total - left) / b;
        if gain > best.1 {
            best = (cut, gain);
        }
    }
    let mut right = set.split_off(best.0);
    set.sort_unstable();
    right.sort_unstable();
    (set, right)
}

/// `indices` so that every run of `block_len` from the start is compact in space: cut in half
/// across the longest side, at whole blocks, until one block is left. Ties by index.
pub fn block_order(indices: &[u32], positions: &[[f32; 3]], block_len: usize) -> Vec<u32> {
    let mut order = indices.to_vec();
    let whole = 0..order.len();
    let mut stack = vec![whole];
    while let Some(range) = stack.pop() {
        let blocks = range.len().div_ceil(block_len.max(1));
        if blocks < 2 {
            continue;
        }
        let part = &mut order[range.clone()];
        let extent = |d: usize| {
            let values = part.iter().map(|&i| positions[i as usize][d]);
            let (low, high) =
                values.fold((f32::INFINITY, f32::NEG_INFINITY), |(l, h), v| (l.min(v), h.max(v)));
            high - low
        };
        let extents = [extent(0), extent(1), extent(2)];
        let axis = (1..3).fold(0, |best, d| if extents[d] > extents[best] { d } else { best });
        let value = |i: u32| positions[i as usize][axis];
        part.sort_unstable_by(|&a, &b| value(a).total_cmp(&value(b)).then(a.cmp(&b)));
        let middle = range.start + blocks / 2 * block_len;
        stack.push(middle..range.end);
        stack.push(range.start..middle);
    }
    order
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::{Attributes, Track};
    use codec_core::ShDegree;

    fn epoch(positions: Vec<[f32; 3]>, frames: usize) -> Epoch {
        let n = positions.len() / frames;
        Epoch::new(
            frames,
            Attributes {
                positions: Track::PerFrame(positions),
                rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]; n]),
                log_scales: Track::Constant(vec![[-4.0; 3]; n]),
                opacity_logits: Track::Constant(vec![3.0; n]),
                sh0: Track::Constant(vec![[0.0; 3]; n]),
                sh_rest: Vec::new(),
                sh_degree: ShDegree::ZERO,
            },
        )
        .unwrap()
    }

    /// A deterministic scatter, no two alike.
    fn scatter(i: usize) -> f32 {
        ((i * 7919) % 1009) as f32 / 1009.0
    }

    #[test]
    fn clusters_are_a_bounded_partition_and_repeatable() {
        let positions: Vec<_> = (0..3000).map(|i| [scatter(i), scatter(i + 17), scatter(3 * i)]).collect();
        let epoch = epoch(positions, 1);
        let options = ClusterOptions { max_gaussians: 100, ..ClusterOptions::default() };
        let clusters = cluster(&epoch, &options);
        assert_eq!(clusters, cluster(&epoch, &options));
        assert!(clusters.iter().all(|c| !c.is_empty() && c.len() <= 100));
        let mut all: Vec<u32> = clusters.concat();
        all.sort_unstable();
        assert_eq!(all, (0..3000).collect::<Vec<u32>>());
    }

    #[test]
    fn what_moves_apart_is_not_clustered_together() {
        // Two interleaved sets in the same place; the second half moves.
        let (n, frames) = (400, 10);
        let mut positions = Vec::new();
        for t in 0..frames {
            for i in 0..n {
                let moved = if i % 2 == 1 { 0.3 * t as f32 } else { 0.0 };
                positions.push([scatter(i) + moved, scatter(i + 5), scatter(2 * i)]);
            }
        }
        let options = ClusterOptions { max_gaussians: 200, ..ClusterOptions::default() };
        for members in cluster(&epoch(positions, frames), &options) {
            let moving = members.iter().filter(|&&i| i % 2 == 1).count();
            assert!(moving == 0 || moving == members.len(), "{moving} of {} move", members.len());
        }
    }

    #[test]
    fn what_stands_still_is_clustered_apart_where_it_is_enough_for_a_cluster() {
        // Moves less than clusters are split for, and only in the last frame.
        let positions = |still: usize, moving: usize| -> Vec<[f32; 3]> {
            let of = |t: usize, i: usize| if i >= still && t == 3 { 1e-3 } else { 0.0 };
            let at = |t: usize, i: usize| [scatter(i) + of(t, i), scatter(i + 5), scatter(2 * i)];
            (0..4).flat_map(|t| (0..still + moving).map(move |i| at(t, i))).collect()
        };
        let options = ClusterOptions { max_variance: 1e9, ..ClusterOptions::default() };
        let of = |still, moving| cluster(&epoch(positions(still, moving), 4), &options);
        assert_eq!(of(200, 250), [(0..200).collect::<Vec<u32>>(), (200..450).collect()]);
        assert_eq!(of(100, 250), [(0..350).collect::<Vec<u32>>()]);
        assert_eq!(of(250, 100), [(0..350).collect::<Vec<u32>>()]);
    }

    #[test]
    fn blocks_are_compact_and_a_permutation() {
        let positions: Vec<_> = (0..500).map(|i| [scatter(i), scatter(i + 31), scatter(5 * i)]).collect();
        let indices: Vec<u32> = (0..500).collect();
        let order = block_order(&indices, &positions, 64);
        let volume = |order: &[u32]| -> f32 {
            let side = |block: &[u32], d: usize| {
                let values = block.iter().map(|&i| positions[i as usize][d]);
                values.clone().fold(0.0, f32::max) - values.fold(1.0, f32::min)
            };
            order.chunks(64).map(|b| side(b, 0) * side(b, 1) * side(b, 2)).sum()
        };
        assert!(volume(&order) < 0.25 * volume(&indices), "{} {}", volume(&order), volume(&indices));
        let mut sorted = order;
        sorted.sort_unstable();
        assert_eq!(sorted, indices);
    }
}
