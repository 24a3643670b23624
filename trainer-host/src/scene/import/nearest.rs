//! Finds nearest neighbours among points, with a balanced k-d tree in one array.
//!
//! Points may be any finite floats: coincident, clustered or at the ends of the range. Squared distances
//! are f64, which hold those of any two f32 points without overflow. Building takes O(n log n) steps. A
//! query visits `MAX_VISITS` points at most, whatever the points and the filter are, so that a file
//! made to be slow is not: answers are exact unless that bound is reached.

#[cfg(test)]
use std::sync::atomic::{AtomicU64, Ordering};

/// Points in a range that is searched one by one.
const LEAF: usize = 8;
/// Most points that a query visits. Ordinary surfaces and clouds need a few hundred.
const MAX_VISITS: usize = 4096;

/// A k-d tree over points it borrows.
pub struct Tree<'a> {
    points: &'a [[f32; 3]],
    /// Indices of points; the median of each range is its node.
    order: Vec<u32>,
    /// Axis that the node at this place splits its range along: the widest of the range.
    axes: Vec<u8>,
    /// Points that queries have looked at.
    #[cfg(test)]
    visits: AtomicU64,
}

impl<'a> Tree<'a> {
    /// Builds the tree over at most `u32::MAX` finite points.
    pub fn new(points: &'a [[f32; 3]]) -> Self {
        let mut order: Vec<u32> = (0..points.len() as u32).collect();
        let mut axes = vec![0; points.len()];
        split(points, &mut order, &mut axes);
        Self {
            points,
            order,
            axes,
            #[cfg(test)]
            visits: AtomicU64::new(0),
        }
    }

    /// Up to `most` points nearest to `query` that `accept` lets pass, as (squared distance, index),
    /// nearest first and equally near ones in order of index. Where several are equally near and only
    /// some fit, the tree decides which: the same ones for the same points.
    pub fn nearest(&self, query: [f32; 3], most: usize, accept: impl Fn(usize) -> bool) -> Vec<(f64, usize)> {
        self.nearest_within(query, f64::INFINITY, most, accept)
    }

    /// As [`Tree::nearest`], of points at most `radius` away.
    pub fn nearest_within(
        &self,
        query: [f32; 3],
        radius: f64,
        most: usize,
        accept: impl Fn(usize) -> bool,
    ) -> Vec<(f64, usize)> {
        let limit = radius * radius;
        let query = query.map(f64::from);
        let mut search =
            Search { tree: self, query, limit, most, accept, best: Vec::new(), left: MAX_VISITS };
        if most > 0 {
            search.range(0, self.order.len());
        }
        #[cfg(test)]
        self.visits.fetch_add((MAX_VISITS - search.left) as u64, Ordering::Relaxed);
        search.best
    }

    /// Points that queries have looked at so far.
    #[cfg(test)]
    pub fn visits(&self) -> u64 {
        self.visits.load(Ordering::Relaxed)
    }
}

/// One query on its way through a tree.
struct Search<'t, A> {
    tree: &'t Tree<'t>,
    query: [f64; 3],
    /// Largest squared distance that counts.
    limit: f64,
    most: usize,
    accept: A,
    /// What was found, nearest first.
    best: Vec<(f64, usize)>,
    /// Points that may still be looked at.
    left: usize,
}

impl<A: Fn(usize) -> bool> Search<'_, A> {
    /// Searches the points at `start..end` of the tree's order.
    fn range(&mut self, start: usize, end: usize) {
        if end - start <= LEAF {
            for place in start..end {
                self.visit(place);
            }
            return;
        }
        let middle = start + (end - start) / 2;
        self.visit(middle);
        let axis = usize::from(self.tree.axes[middle]);
        let node = self.tree.points[self.tree.order[middle] as usize];
        let offset = self.query[axis] - f64::from(node[axis]);
        let (below, above) = ((start, middle), (middle + 1, end));
        let (near, far) = if offset < 0.0 { (below, above) } else { (above, below) };
        self.range(near.0, near.1);
        if self.left > 0 && self.counts(offset * offset) {
            self.range(far.0, far.1);
        }
    }

    /// Looks at the point at `place` of the tree's order.
    fn visit(&mut self, place: usize) {
        if self.left == 0 {
            return;
        }
        self.left -= 1;
        let index = self.tree.order[place] as usize;
        let point = self.tree.points[index];
        let mut squared = 0.0;
        for (query, point) in self.query.iter().zip(point) {
            let difference = query - f64::from(point);
            squared += difference * difference;
        }
        if !self.counts(squared) || !(self.accept)(index) {
            return;
        }
        let found = (squared, index);
        let at = self.best.partition_point(|&other| other < found);
        self.best.insert(at, found);
        self.best.truncate(self.most);
    }

    /// Whether a point at this squared distance would be among the answers. Once they are full it has to
    /// be nearer than the last of them: among coincident points the search then ends at once.
    fn counts(&self, squared: f64) -> bool {
        match self.best.last() {
            Some(last) if self.best.len() >= self.most => squared < last.0,
            _ => squared <= self.limit,
        }
    }
}

/// Puts `order` in the order of a balanced tree.
fn split(points: &[[f32; 3]], order: &mut [u32], axes: &mut [u8]) {
    if order.len() <= LEAF {
        return;
    }
    let (mut low, mut high) = ([f64::INFINITY; 3], [f64::NEG_INFINITY; 3]);
    for &index in order.iter() {
        for axis in 0..3 {
            let value = f64::from(points[index as usize][axis]);
            low[axis] = low[axis].min(value);
            high[axis] = high[axis].max(value);
        }
    }
    let width = |axis: usize| high[axis] - low[axis];
    let axis = (0..3).max_by(|&a, &b| width(a).total_cmp(&width(b))).unwrap_or(0);
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
pub(crate) mod tests {
    use rand::RngExt;
    use rand_pcg::rand_core::SeedableRng;

    use super::*;

    /// Whether steps counted at n and at 4n speak for more than n log n: four times as many, with half as
    /// many again for the logarithm and for unlucky orders.
    pub fn grows_too_fast(at_n: u64, at_4n: u64) -> bool {
        at_4n > at_n * 6
    }

    fn squared(a: [f32; 3], b: [f32; 3]) -> f64 {
        (0..3).map(|axis| (f64::from(b[axis]) - f64::from(a[axis])).powi(2)).sum()
    }

    #[test]
    fn agrees_with_trying_every_point() {
        let mut rng = rand_pcg::Pcg32::seed_from_u64(1);
        let points: Vec<[f32; 3]> = (0..500)
            .map(|i| [rng.random::<f32>(), (i % 7) as f32, rng.random::<f32>().powi(8) * 100.0])
            .collect();
        let tree = Tree::new(&points);
        for q in (0..500).step_by(13) {
            let mut all: Vec<(f64, usize)> =
                (0..500).filter(|&i| i != q).map(|i| (squared(points[i], points[q]), i)).collect();
            all.sort_by(|a, b| a.0.total_cmp(&b.0).then(a.1.cmp(&b.1)));
            assert_eq!(tree.nearest(points[q], 5, |i| i != q), all[..5]);
            assert_ne!(tree.nearest(points[q], 5, |_| true), all[..5], "the filter counts");
            let near = all.iter().filter(|d| d.0 <= 1.0).count();
            assert_eq!(tree.nearest_within(points[q], 1.0, usize::MAX, |i| i != q).len(), near);
            assert_eq!(tree.nearest_within(points[q], 1.0, 2, |i| i != q), all[..near.min(2)]);
        }
        assert!(Tree::new(&[]).nearest([0.0; 3], 3, |_| true).is_empty());
    }

    #[test]
    fn points_in_one_place_are_found() {
        let points = [[1.0; 3]; 40];
        let found = Tree::new(&points).nearest([1.0; 3], 4, |i| i != 0);
        assert!(found.windows(2).all(|w| w[0].0 == 0.0 && w[0].1 < w[1].1), "{found:?}");
        assert!(found.len() == 4 && found.iter().all(|f| f.1 != 0), "{found:?}");
    }

    #[test]
    fn distances_between_the_ends_of_the_range_do_not_overflow() {
        let points = [[f32::MAX; 3], [-f32::MAX; 3], [f32::MAX, f32::MAX, 0.0], [f32::MIN_POSITIVE; 3]];
        let found = Tree::new(&points).nearest(points[0], 3, |i| i != 0);
        assert_eq!(found.iter().map(|f| f.1).collect::<Vec<_>>(), [2, 3, 1]);
        assert!(found.iter().all(|f| f.0.is_finite()), "{found:?}");
    }

    /// Points that queries look at when each of `points` asks for its three nearest.
    fn visits(points: &[[f32; 3]]) -> u64 {
        let tree = Tree::new(points);
        for (i, &point) in points.iter().enumerate() {
            assert_eq!(tree.nearest(point, 3, |j| j != i).len(), 3);
        }
        tree.visits()
    }

    #[test]
    fn searching_takes_n_log_n_steps_however_the_points_lie() {
        type Shape = fn(usize) -> [f32; 3];
        let shapes: [(&str, Shape); 5] = [
            ("one place", |_| [1.0, 2.0, 3.0]),
            ("two places", |i| [if i % 2 == 0 { -3e38 } else { 3e38 }; 3]),
            ("a line", |i| [i as f32, 0.0, 0.0]),
            ("stacks of ten", |i| [(i / 10) as f32, (i / 10 % 13) as f32, 0.0]),
            ("ever further out", |i| [2f32.powi(i as i32 % 250 - 125), (i / 250) as f32, 0.0]),
        ];
        for (name, shape) in shapes {
            let points = |n: usize| (0..n).map(shape).collect::<Vec<_>>();
            let (few, many) = (visits(&points(1000)), visits(&points(4000)));
            assert!(!grows_too_fast(few, many), "{name}: {few} steps for 1000 points, {many} for 4000");
            assert!(many < 4000 * 400, "{name}: {many} steps");
        }
        assert!(grows_too_fast(1000 * 1000, 4000 * 4000), "trying every point is found out");
    }

    #[test]
    fn a_filter_that_lets_nothing_pass_ends_the_search() {
        let points: Vec<[f32; 3]> = (0..20_000).map(|i| [(i % 100) as f32, (i / 100) as f32, 0.0]).collect();
        let tree = Tree::new(&points);
        assert!(tree.nearest([50.0; 3], 3, |_| false).is_empty());
        assert_eq!(tree.visits(), MAX_VISITS as u64);
    }
}
