//! Orders the Gaussians of a block.
//!
//! First-level symbols of predicted classes are differences to the Gaussian before, so a block is
//! walked along a short path. Length is estimated bits: a pair costs what the differences of its
//! first-level indices cost under the statistics of the order found so far, and the path is
//! sought again under those. Integers throughout, ties by place: equal input, equal order.

use codec_core::internals::{ids::Level, quant::Class, wire::manifest::Quant};
use nalgebra::Vector3;
use rayon::prelude::*;

use super::{
    super::factorise::{fit_pose, mean_turn, quat_mul},
    indices::{Indices, indices, split},
};
use crate::scene::Epoch;

/// Classes that appear at level 0.
const STILL: usize = 5;
/// Those, and what is left of the motion of position and rotation.
const CLASSES: usize = STILL + 2;
/// Frames at which motion is compared.
const MOTION_FRAMES: usize = 3;
/// Components of the still classes.
const STILL_COMPONENTS: usize = 13;
/// Components in all: per such frame three of position and three of rotation.
const COMPONENTS: usize = STILL_COMPONENTS + 6 * MOTION_FRAMES;
/// Class of each component.
const CLASS_OF: [usize; COMPONENTS] =
    [0, 0, 0, 1, 1, 1, 2, 2, 2, 3, 4, 4, 4, 5, 5, 5, 6, 6, 6, 5, 5, 5, 6, 6, 6, 5, 5, 5, 6, 6, 6];
/// One frame's value of motion is looked at in this many canonical steps, which is about what a
/// coefficient's first symbol, gathered over a window, resolves of it.
const MOTION_STEPS: f32 = 5.4;
/// Differences from here on cost the same.
const FAR: usize = 64;
/// Costs are in bits over this.
const UNIT: f64 = 256.0;
/// Rounds of path, statistics, path. More gain under 0.1 bit per Gaussian.
const ROUNDS: usize = 3;
/// Most improving sweeps per path in the last round, which finds its optimum after about ten,
/// and in those before, which only serve statistics.
const SWEEPS: (usize, usize) = (40, 1);

/// First-level indices of one Gaussian.
type Row = [i32; COMPONENTS];

/// What a difference of 0, 1, …, [`FAR`] costs, per class.
type Costs = [[i32; FAR + 1]; CLASSES];

/// `sets` (blocks of `block_len` already next to each other) with each block in a cheap order.
/// `quant_of` gives the quantisers of a set.
pub(super) fn arrange<'q>(
    epoch: &Epoch,
    sets: Vec<Vec<u32>>,
    quant_of: impl Fn(&[u32]) -> &'q Quant + Sync,
    origin: [f32; 3],
    block_len: usize,
) -> Vec<Vec<u32>> {
    let mut clusters: Vec<(Vec<u32>, Vec<Row>)> = sets
        .into_par_iter()
        .map(|set| {
            let quant = quant_of(&set);
            let mut rows = rows(&indices(epoch, &set, quant, origin), quant, set.len());
            add_motion(&mut rows, epoch, &set, quant);
            (set, rows)
        })
        .collect();
    let mut costs = first_costs();
    for round in 0..ROUNDS {
        clusters.par_iter_mut().for_each(|(set, rows)| {
            let centre = centre(rows);
            for (set, rows) in set.chunks_mut(block_len).zip(rows.chunks_mut(block_len)) {
                let sweeps = if round + 1 < ROUNDS { SWEEPS.1 } else { SWEEPS.0 };
                let path = path(rows, &centre, &costs, sweeps);
                let (from_set, from_rows) = (set.to_vec(), rows.to_vec());
                for (k, &i) in path.iter().enumerate() {
                    set[k] = from_set[i];
                    rows[k] = from_rows[i];
                }
            }
        });
        if round + 1 < ROUNDS {
            costs = learned(&clusters, block_len, round > 0);
        }
    }
    clusters.into_iter().map(|(set, _)| set).collect()
}

fn rows(indices: &Indices, quant: &Quant, n: usize) -> Vec<Row> {
    let mut rows = vec![[0; COMPONENTS]; n];
    let mut at = 0;
    for class in Class::ALL.into_iter().take(STILL) {
        for component in &indices[class.index()] {
            for (row, &q) in rows.iter_mut().zip(component) {
                row[at] = split(&quant.canonical[class.index()], class, q)[0];
            }
            at += 1;
        }
    }
    rows
}

/// What a pose fitted to the cluster leaves of the motion, at a few frames of the epoch.
fn add_motion(rows: &mut [Row], epoch: &Epoch, set: &[u32], quant: &Quant) {
    let (n, a) = (epoch.count(), epoch.attributes());
    if a.positions.is_constant() && a.rotations.is_constant() {
        return;
    }
    let step = |class: Class| f64::from(quant.canonical[class.index()].step(Level::ALL[3]) * MOTION_STEPS);
    let (position, rotation) = (step(Class::Position), step(Class::Rotation));
    let places = |t: usize| -> Vec<[f64; 3]> {
        let frame = a.positions.frame(t, n);
        set.iter().map(|&i| frame[i as usize].map(f64::from)).collect()
    };
    let turns = |t: usize| -> Vec<[f32; 4]> {
        let frame = a.rotations.frame(t, n);
        set.iter().map(|&i| frame[i as usize]).collect()
    };
    let (p0, q0) = (places(0), turns(0));
    let mut turn = [1.0, 0.0, 0.0, 0.0];
    for look in 0..MOTION_FRAMES {
        let t = (2 * look + 1) * epoch.frames() / (2 * MOTION_FRAMES);
        let (p, q) = (places(t), turns(t));
        turn = mean_turn(&q0, &q, turn);
        let pose = fit_pose(&p0, &p, [0.0; 3], turn);
        let at = STILL_COMPONENTS + 6 * look;
        for (i, row) in rows.iter_mut().enumerate() {
            let fitted = pose.linear * Vector3::from(p0[i]) + pose.translation;
            let [w, x, y, z] = quat_mul(turn, q0[i].map(f64::from));
            let left = quat_mul(q[i].map(f64::from), [w, -x, -y, -z]);
            let w = if left[0].abs() < 0.05 { 0.05f64.copysign(left[0]) } else { left[0] };
            for d in 0..3 {
                // The cast saturates.
                row[at + d] = ((p[i][d] - fitted[d]) / position).round() as i32;
                row[at + 3 + d] = (left[d + 1] / w / rotation).round() as i32;
            }
        }
    }
}

/// What position is predicted from at the start of a block; zero for the rest.
fn centre(rows: &[Row]) -> Row {
    let mut centre = [0; COMPONENTS];
    for (d, centre) in centre.iter_mut().enumerate().take(3) {
        let sum: i64 = rows.iter().map(|r| i64::from(r[d])).sum();
        *centre = (sum as f64 / rows.len().max(1) as f64).round() as i32;
    }
    centre
}

/// Before anything is known only position counts.
fn first_costs() -> Costs {
    let mut costs = [[0; FAR + 1]; CLASSES];
    for (d, cost) in costs[0].iter_mut().enumerate() {
        *cost = (UNIT * (1.0 + 2.0 * d as f64).log2()) as i32;
    }
    costs
}

/// Costs under the order found so far. With `choose`, classes whose differences cost more than
/// their values do not count: they will not be predicted.
fn learned(clusters: &[(Vec<u32>, Vec<Row>)], block_len: usize, choose: bool) -> Costs {
    let mut differences = [[0u64; FAR + 1]; CLASSES];
    let mut values = [[0u64; 4 * FAR + 1]; CLASSES];
    for (_, rows) in clusters {
        let centre = centre(rows);
        for block in rows.chunks(block_len) {
            let mut before = centre;
            for row in block {
                for (c, &class) in CLASS_OF.iter().enumerate() {
                    differences[class][difference(row[c], before[c])] += 1;
                    values[class]
                        [(row[c].clamp(-2 * FAR as i32, 2 * FAR as i32) + 2 * FAR as i32) as usize] += 1;
                }
                before = *row;
            }
        }
    }
    let mut costs = [[0; FAR + 1]; CLASSES];
    for (class, costs) in costs.iter_mut().enumerate() {
        let total: u64 = differences[class].iter().sum();
        let bits = |d: usize| {
            // Both signs share a count; half a count each keeps what was not seen affordable.
            let signs = if d == 0 { 1.0 } else { 2.0 };
            ((total as f64 + 0.5 * FAR as f64) / ((differences[class][d] as f64 + 0.5) / signs)).log2()
        };
        let difference_bits: f64 = (0..=FAR).map(|d| differences[class][d] as f64 * bits(d)).sum();
        let value_bits: f64 = values[class]
            .iter()
            .filter(|v| **v > 0)
            .map(|&v| v as f64 * (total as f64 / v as f64).log2())
            .sum();
        if choose && class != 0 && difference_bits > value_bits {
            continue;
        }
        let mut most = 0;
        for (d, cost) in costs.iter_mut().enumerate() {
            // Farther is never cheaper, however thin the counts are.
            most = most.max((UNIT * bits(d)) as i32);
            *cost = most;
        }
    }
    costs
}

fn difference(a: i32, b: i32) -> usize {
    (a.abs_diff(b) as usize).min(FAR)
}

fn cost(a: &Row, b: &Row, costs: &Costs) -> i32 {
    (0..COMPONENTS).map(|c| costs[CLASS_OF[c]][difference(a[c], b[c])]).sum()
}

/// A cheap path through `rows` from `start`, which is not part of it: nearest neighbours, and the
/// order as it is, each improved by reversing and moving runs until neither helps.
fn path(rows: &[Row], start: &Row, costs: &Costs, sweeps: usize) -> Vec<usize> {
    let n = rows.len();
    let mut pairs = vec![0i32; n * n];
    for (a, row) in rows.iter().enumerate() {
        for (b, other) in rows.iter().enumerate().take(a) {
            let cost = cost(row, other, costs);
            pairs[a * n + b] = cost;
            pairs[b * n + a] = cost;
        }
    }
    let begin: Vec<i32> = rows.iter().map(|row| cost(row, start, costs)).collect();
    let graph = Graph { n, pairs: &pairs, begin: &begin };
    let mut path: Vec<usize> = (0..n).collect();
    graph.improve(&mut path, sweeps);
    let mut best = graph.nearest();
    graph.improve(&mut best, sweeps);
    if graph.length(&path) < graph.length(&best) { path } else { best }
}

struct Graph<'p> {
    n: usize,
    pairs: &'p [i32],
    begin: &'p [i32],
}

impl Graph<'_> {
    fn pair(&self, a: usize, b: usize) -> i32 {
        self.pairs[a * self.n + b]
    }

    /// Cost of the edge into place `i` of `path` if `node` stood there.
    fn into(&self, path: &[usize], i: usize, node: usize) -> i32 {
        if i == 0 { self.begin[node] } else { self.pair(path[i - 1], node) }
    }

    /// Cost of the edge from `node` to place `i` of `path`; nothing follows the last.
    fn onto(&self, path: &[usize], i: usize, node: usize) -> i32 {
        if i == self.n { 0 } else { self.pair(node, path[i]) }
    }

    fn length(&self, path: &[usize]) -> i64 {
        (0..self.n).map(|i| i64::from(self.into(path, i, path[i]))).sum()
    }

    fn nearest(&self) -> Vec<usize> {
        let mut left: Vec<usize> = (0..self.n).collect();
        let mut path = Vec::with_capacity(self.n);
        let next = |path: &[usize], i: usize| (self.into(path, path.len(), i), i);
        while let Some(k) = (0..left.len()).min_by_key(|&k| next(&path, left[k])) {
            path.push(left.swap_remove(k));
        }
        path
    }

    fn improve(&self, path: &mut Vec<usize>, sweeps: usize) {
        for _ in 0..sweeps {
            let reversed = self.reverse(path);
            let moved = self.shift(path);
            if !reversed && !moved {
                break;
            }
        }
    }

    /// 2-opt: reverses every run whose reversal is a gain.
    fn reverse(&self, path: &mut [usize]) -> bool {
        let mut changed = false;
        for i in 0..self.n {
            for j in i + 1..self.n {
                let (a, b) = (path[i], path[j]);
                let before = self.into(path, i, a) + self.onto(path, j + 1, b);
                let after = self.into(path, i, b) + self.onto(path, j + 1, a);
                if after < before {
                    path[i..=j].reverse();
                    changed = true;
                }
            }
        }
        changed
    }

    /// Or-opt: moves every run of up to three, turned or not, to where that is the largest gain.
    fn shift(&self, path: &mut Vec<usize>) -> bool {
        let mut changed = false;
        for len in 1..=3.min(self.n.saturating_sub(1)) {
            for i in 0..=self.n - len {
                let (a, b) = (path[i], path[i + len - 1]);
                let gap = if i + len == self.n { 0 } else { self.into(path, i, path[i + len]) };
                let gain = self.into(path, i, a) + self.onto(path, i + len, b) - gap;
                let mut best = (0, 0, false);
                // Place k of the path as it stands, outside the run.
                for k in (0..i).chain(i + len + 1..=self.n) {
                    let old = if k == self.n { 0 } else { self.into(path, k, path[k]) };
                    let straight = self.into(path, k, a) + self.onto(path, k, b) - old;
                    let turned = self.into(path, k, b) + self.onto(path, k, a) - old;
                    for (cost, turn) in [(straight, false), (turned, true)] {
                        if gain - cost > best.0 {
                            best = (gain - cost, k, turn);
                        }
                    }
                }
                let (gain, k, turn) = best;
                if gain > 0 {
                    let mut run: Vec<usize> = path.drain(i..i + len).collect();
                    if turn {
                        run.reverse();
                    }
                    let k = if k > i { k - len } else { k };
                    path.splice(k..k, run);
                    changed = true;
                }
            }
        }
        changed
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn row(i: usize) -> Row {
        let mut row = [0; COMPONENTS];
        for (c, v) in row.iter_mut().enumerate().take(3) {
            *v = ((i * 7919 * (c + 1) + c * 31) % 23) as i32;
        }
        row
    }

    #[test]
    fn a_path_is_a_permutation_and_shorter() {
        let rows: Vec<Row> = (0..64).map(row).collect();
        let costs = first_costs();
        let length = |path: &[usize]| -> i64 {
            path.windows(2).map(|w| i64::from(cost(&rows[w[0]], &rows[w[1]], &costs))).sum()
        };
        let found = path(&rows, &centre(&rows), &costs, SWEEPS.0);
        let given: Vec<usize> = (0..64).collect();
        assert!(length(&found) * 10 < length(&given) * 6, "{} {}", length(&found), length(&given));
        let mut sorted = found.clone();
        sorted.sort_unstable();
        assert_eq!(sorted, given);
    }

    #[test]
    fn short_blocks_have_their_shortest_path() {
        // All orders of five, against the search.
        let rows: Vec<Row> = (0..5).map(row).collect();
        let (costs, start) = (first_costs(), centre(&rows));
        let length = |path: &[usize]| -> i64 {
            let mut before = start;
            path.iter()
                .map(|&i| i64::from(cost(&std::mem::replace(&mut before, rows[i]), &rows[i], &costs)))
                .sum()
        };
        let mut least = i64::MAX;
        for code in 0..5usize.pow(5) {
            let order: Vec<usize> = (0..5).map(|k| code / 5usize.pow(k) % 5).collect();
            if (0..5).all(|i| order.contains(&i)) {
                least = least.min(length(&order));
            }
        }
        assert_eq!(length(&path(&rows, &start, &costs, SWEEPS.0)), least);
        for n in 0..4 {
            assert_eq!(path(&rows[..n], &start, &costs, SWEEPS.0).len(), n);
        }
    }
}
