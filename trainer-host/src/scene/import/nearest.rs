//! Nearest neighbours among points: a balanced k-d tree in one array.
//!
//! Points may be any finite floats, clustered or far out; building is O(n log² n), a query touches a
//! few leaves. Ties are broken by index, so answers do not depend on the order of the search.

/// A k-d tree over points it borrows.
pub struct Tree<'a> {
    points: &'a [[f32; 3]],
    /// Indices; the median of each range is its node, split along the axis of its depth's widest side.
    order: Vec<u32>,
    axes: Vec<u8>,
}

const LEAF: usize = 8;

impl<'a> Tree<'a> {
    /// Builds the tree; at most `u32::MAX` points.
    pub fn new(points: &'a [[f32; 3]]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut axes = vec![0; points.len()];
        split(points, &mut order, &mut axes);
        Self { points, order, axes }
    }

    /// Up to `k` points nearest to `query` that `accept` lets pass, as (squared distance, index),
    /// nearest first.
    pub fn nearest(&self, query: [f32; 3], k: usize, accept: impl Fn(usize) -> bool) -> Vec<(f32, usize)> {
        let mut best = Vec::with_capacity(k + 1);
        if k > 0 {
            self.search(0, self.order.len(), query, f32::INFINITY, k, &accept, &mut best);
        }
        best
    }

    /// All points within `radius` of `query`, as (squared distance, index), nearest first.
    pub fn within(&self, query: [f32; 3], radius: f32, accept: impl Fn(usize) -> bool) -> Vec<(f32, usize)> {
        let mut best = Vec::new();
        self.search(0, self.order.len(), query, radius * radius, usize::MAX, &accept, &mut best);
        best
    }

    #[allow(clippy::too_many_arguments, reason = "one recursion, called from two places above")]
    fn search(
        &self,
        start: usize,
        end: usize,
        query: [f32; 3],
        limit: f32,
        k: usize,
        accept: &impl Fn(usize) -> bool,
        best: &mut Vec<(f32, usize)>,
    ) {
        let visit = |index: u32, best: &mut Vec<(f32, usize)>| {
            let index = index as usize;
            let d: f32 = (0..3).map(|a| (self.points[index][a] - query[a]).powi(2)).sum();
            let full = best.len() >= k;
            if d > limit || (full && best.last().is_some_and(|&w| (d, index) >= w)) || !accept(index) {
                return;
            }
            let at = best.partition_point(|&b| b < (d, index));
            best.insert(at, (d, index));
            best.truncate(k);
        };
        if end - start <= LEAF {
            self.order[start..end].iter().for_each(|&i| visit(i, best));
            return;
        }
        let middle = start + (end - start) / 2;
        let node = self.order[middle];
        let axis = usize::from(self.axes[middle]);
        let offset = query[axis] - self.points[node as usize][axis];
        visit(node, best);
        let (near, far) = if offset < 0.0 {
            ((start, middle), (middle + 1, end))
        } else {
            ((middle + 1, end), (start, middle))
        };
        self.search(near.0, near.1, query, limit, k, accept, best);
        let reach = if best.len() >= k { best.last().map_or(limit, |w| w.0.min(limit)) } else { limit };
        if offset * offset <= reach {
            self.search(far.0, far.1, query, limit, k, accept, best);
        }
    }
}

fn split(points: &[[f32; 3]], order: &mut [u32], axes: &mut [u8]) {
    if order.len() <= LEAF {
        return;
    }
    let (mut low, mut high) = ([f32::INFINITY; 3], [f32::NEG_INFINITY; 3]);
    for &i in order.iter() {
        for a in 0..3 {
            low[a] = low[a].min(points[i as usize][a]);
            high[a] = high[a].max(points[i as usize][a]);
        }
    }
    let axis = (0..3).max_by(|&a, &b| (high[a] - low[a]).total_cmp(&(high[b] - low[b]))).unwrap_or(0);
    let middle = order.len() / 2;
    order.select_nth_unstable_by(middle, |&a, &b| {
        points[a as usize][axis].total_cmp(&points[b as usize][axis]).then(a.cmp(&b))
    });
    axes[middle] = axis as u8;
    let (left, right) = order.split_at_mut(middle);
    let (left_axes, right_axes) = axes.split_at_mut(middle);
    split(points, left, left_axes);
    split(points, &mut right[1..], &mut right_axes[1..]);
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::RngExt;
    use rand_pcg::rand_core::SeedableRng;

    #[test]
    fn agrees_with_trying_every_point() {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(1);
        let points: Vec<[f32; 3]> = (0..500)
            .map(|i| [rng.random::<f32>(), (i % 7) as f32, rng.random::<f32>().powi(8) * 100.0])
            .collect();
        let tree = Tree::new(&points);
        for q in (0..500).step_by(13) {
            let mut all: Vec<(f32, usize)> = (0..500)
                .filter(|&i| i != q)
                .map(|i| ((0..3).map(|a| (points[i][a] - points[q][a]).powi(2)).sum(), i))
                .collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            assert_eq!(tree.nearest(points[q], 5, |i| i != q), all[..5]);
            let near = all.iter().filter(|d| d.0 <= 1.0).count();
            assert_eq!(tree.within(points[q], 1.0, |i| i != q).len(), near);
        }
        assert!(Tree::new(&[]).nearest([0.0; 3], 3, |_| true).is_empty());
    }

    #[test]
    fn points_in_one_place_are_found() {
        let points = [[1.0; 3]; 40];
        let found = Tree::new(&points).nearest([1.0; 3], 4, |i| i != 0);
        assert_eq!(found.iter().map(|f| f.1).collect::<Vec<_>>(), [1, 2, 3, 4]);
    }
}
