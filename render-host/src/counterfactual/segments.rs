//! Composes runs of a few groups once for every subset of those groups that some world holds.
//!
//! A segment is a sequence of runs of at most a few groups. Worlds that hold the same of these groups see
//! the same operator, so it is composed once per such *subset* and a world is a walk over segments, not over
//! runs. With G groups in a segment there are at most 2^G subsets, one of which is the identity.

use pulp::Simd;

use super::{
    lanes::Lanes,
    operator::{FLUSH_EVERY, Operator, OperatorPart, parts},
    splat_runs::SplatRuns,
};

/// Groups in a segment at most.
const MOST: usize = 4;
/// Subsets of the longest segment.
pub(super) const SUBSETS: usize = 1 << MOST;
/// No group.
pub(super) const NONE: u32 = u32::MAX;

/// Up to [`MOST`] groups in order of appearance; unused places hold [`NONE`].
type GroupSlots = [u32; MOST];

/// How the lanes of a tile see a few groups.
#[derive(Debug, Default)]
struct View {
    groups: GroupSlots,
    /// Per lane, a bit per group that it holds.
    subsets: Vec<u8>,
    /// Bit `l` is set when some lane has subset `l`.
    used: u32,
}

/// Consecutive runs.
#[derive(Clone, Copy, Debug)]
pub(super) struct RunSegment {
    /// First run and the one past the last.
    pub runs: [usize; 2],
    view: usize,
    /// Operator of each subset.
    pub operators: [u32; SUBSETS],
}

/// The segments of one block.
#[derive(Debug, Default)]
pub(super) struct RunSegments {
    /// Views of the tile's lanes, made when first needed; `known` of them count.
    views: Vec<View>,
    known: usize,
    list: Vec<RunSegment>,
    /// Of each run, which of its segment's groups it is, as a bit of a subset.
    ranks: Vec<u8>,
    /// Room for the runs of one subset.
    picked: Vec<u32>,
    /// One past the last operator that was composed.
    end: usize,
}

impl RunSegments {
    /// Forgets all views: the lanes are others.
    pub(super) fn reset(&mut self) {
        self.known = 0;
    }

    pub(super) fn list(&self) -> &[RunSegment] {
        &self.list
    }

    /// The subset that `lane` has of `segment`.
    #[inline(always)]
    fn subset(&self, segment: &RunSegment, lane: usize) -> usize {
        usize::from(self.views[segment.view].subsets[lane]) % SUBSETS
    }

    /// Cuts the runs of a block into segments of at most `limit` groups and composes every subset of each.
    #[inline(always)]
    pub(super) fn fill<S: Simd>(&mut self, simd: S, runs: &mut SplatRuns, lanes: &Lanes, limit: usize) {
        self.list.clear();
        self.ranks.clear();
        let identity = runs.len() as u32;
        let mut first = 0;
        while first < runs.len() {
            let mut groups = [NONE; MOST];
            let mut past = first;
            for &local in &runs.locals[first..] {
                let Some(rank) = place(&mut groups, limit, local) else { break };
                self.ranks.push(rank as u8);
                past += 1;
            }
            let view = self.view(groups, lanes);
            self.list.push(RunSegment { runs: [first, past], view, operators: [identity; SUBSETS] });
            first = past;
        }
        if self.picked.len() <= runs.len() {
            self.picked.resize(runs.len() + 1, 0);
        }
        let mut end = runs.len() + 1;
        for at in 0..self.list.len() {
            let mut segment = self.list[at];
            let mut used = self.views[segment.view].used & !1;
            while used != 0 {
                let subset = used.trailing_zeros() as usize % SUBSETS;
                used &= used - 1;
                segment.operators[subset] = self.compose(simd, runs, segment.runs, subset, &mut end);
            }
            self.list[at] = segment;
        }
        self.end = end;
    }

    /// One past the last operator of the block.
    pub(super) fn end(&self) -> usize {
        self.end
    }

    /// Writes the operator of each segment for `lane` to the start of `path`.
    #[inline(always)]
    pub(super) fn path(&self, lane: usize, path: &mut [u32]) {
        for (step, segment) in path.iter_mut().zip(&self.list) {
            *step = segment.operators[self.subset(segment, lane)];
        }
    }

    /// The subsets of a segment whose operators were composed, where a block has `runs` runs.
    pub(super) fn composed(
        &self,
        segment: &RunSegment,
        runs: usize,
    ) -> impl Iterator<Item = (usize, usize)> + use<> {
        let operators = segment.operators;
        (0..SUBSETS).map(move |subset| (subset, operators[subset] as usize)).filter(move |&(_, at)| at > runs)
    }

    /// The runs that a subset holds.
    #[inline(always)]
    pub(super) fn picked(&mut self, runs: [usize; 2], subset: usize) -> &[u32] {
        let count = self.pick(runs, subset);
        &self.picked[..count]
    }

    /// The operator of one subset: a run if it is one, else composed behind all others, at `end`.
    #[inline(always)]
    fn compose<S: Simd>(
        &mut self,
        simd: S,
        runs: &mut SplatRuns,
        [first, past]: [usize; 2],
        subset: usize,
        end: &mut usize,
    ) -> u32 {
        let count = self.pick([first, past], subset);
        let picked = &self.picked[..count];
        if count == 1 {
            return picked[0];
        }
        if runs.operators.len() <= *end {
            runs.operators.resize(2 * *end + 2, Operator::IDENTITY);
        }
        let (sources, made) = runs.operators.split_at_mut(*end);
        for part in 0..parts::<S>() {
            let mut now = OperatorPart::identity(simd);
            for picked in picked.chunks(FLUSH_EVERY) {
                for &run in picked {
                    now = now.then(simd, OperatorPart::load(&sources[run as usize], part));
                }
                now = now.flushed(simd);
            }
            now.store(&mut made[0], part);
        }
        *end += 1;
        (*end - 1) as u32
    }

    /// Puts the runs that a subset holds at the start of `picked`. Returns how many.
    #[inline(always)]
    fn pick(&mut self, [first, past]: [usize; 2], subset: usize) -> usize {
        let mut count = 0;
        for (run, &rank) in (first as u32..).zip(&self.ranks[first..past]) {
            self.picked[count] = run;
            count += subset >> rank & 1;
        }
        count
    }

    /// The view of `groups`.
    #[inline(always)]
    fn view(&mut self, groups: GroupSlots, lanes: &Lanes) -> usize {
        let found = self.views[..self.known].iter().position(|view| view.groups == groups);
        found.unwrap_or_else(|| self.make(groups, lanes))
    }

    fn make(&mut self, groups: GroupSlots, lanes: &Lanes) -> usize {
        let at = self.known;
        if self.views.len() == at {
            self.views.push(View::default());
        }
        let view = &mut self.views[at];
        (view.groups, view.used) = (groups, 0);
        view.subsets.clear();
        view.subsets.resize(lanes.count(), 0);
        for (rank, &group) in groups.iter().enumerate().filter(|(_, group)| **group != NONE) {
            let subsets = view.subsets.iter_mut().enumerate();
            subsets.for_each(|(lane, subset)| *subset |= u8::from(lanes.has(lane, group)) << rank);
        }
        view.subsets.iter().for_each(|&subset| view.used |= 1 << subset);
        self.known += 1;
        at
    }
}

/// Place of `local` among `groups`, where it is added if it is missing and there is room.
#[inline(always)]
fn place(groups: &mut GroupSlots, limit: usize, local: u32) -> Option<usize> {
    for (rank, group) in groups[..limit].iter_mut().enumerate() {
        if *group == NONE {
            *group = local;
        }
        if *group == local {
            return Some(rank);
        }
    }
    None
}

/// The number of groups per segment for which `lanes` lanes over these runs are estimated cheapest.
///
/// A run is composed into about half of the subsets; a lane walks over every segment.
pub(super) fn limit(locals: &[u32], lanes: usize) -> usize {
    let mut best = (f32::INFINITY, 1);
    for limit in 1..=MOST {
        let (mut groups, mut length, mut count, mut cost) = ([NONE; MOST], 0, 0, 0.0);
        let subsets = (((1 << limit) - 1) as f32 * 0.6).min(lanes as f32);
        // One run is one operator already.
        let compose = |length: usize| if length > 1 { subsets * length as f32 } else { 0.0 };
        for &local in locals {
            if place(&mut groups, limit, local).is_none() {
                cost += compose(length);
                (groups, length, count) = ([NONE; MOST], 0, count + 1);
                groups[0] = local;
            }
            length += 1;
        }
        cost += compose(length) + 1.3 * ((count + 1) * lanes) as f32;
        if cost < best.0 {
            best = (cost, limit);
        }
    }
    best.1
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::stage::TILE;
    use proptest::prelude::*;

    struct TileJob<'a> {
        runs: &'a mut SplatRuns,
        lanes: &'a Lanes,
        limit: usize,
        segments: &'a mut RunSegments,
    }

    impl pulp::WithSimd for TileJob<'_> {
        type Output = ();

        fn with_simd<S: Simd>(self, simd: S) {
            self.segments.fill(simd, self.runs, self.lanes, self.limit);
        }
    }

    /// What `path` makes of the light from behind, in pixel 3.
    fn walked(runs: &SplatRuns, path: impl Iterator<Item = u32>) -> [f64; 2] {
        let step = |[t, c]: [f64; 2], at: u32| {
            let operator = &runs.operators[at as usize];
            [t * f64::from(operator.t[3]), c + t * f64::from(operator.rgb[1][3])]
        };
        path.fold([1.0, 0.0], step)
    }

    proptest! {
        #[test]
        fn a_walk_over_segments_is_a_walk_over_runs(
            locals in proptest::collection::vec(0u32..70, 0..40), few in 1u32..70,
            bits in proptest::collection::vec(any::<[u64; 2]>(), 1..9), limit in 1usize..=MOST,
        ) {
            let mut locals: Vec<u32> = locals.iter().map(|l| l % few).collect();
            locals.dedup();
            let operator = |i: usize| {
                let v = i as f32 * 0.37;
                Operator { t: [0.3 + 0.6 * v.sin().abs(); TILE], rgb: [[v.cos().abs(); TILE]; 3] }
            };
            let operators: Vec<_> = (0..locals.len()).map(operator).chain([Operator::IDENTITY]).collect();
            let mut runs = SplatRuns::default();
            (runs.locals, runs.operators) = (locals.clone(), operators);
            let mut lanes = Lanes::default();
            lanes.reset(bits.len(), 70);
            (0..70).for_each(|l| lanes.row(l, |lane| bits[lane][l as usize / 64] >> (l % 64) & 1 == 1));
            let mut segments = RunSegments::default();
            for scalar in [true, false] {
                segments.reset();
                let walk = TileJob { runs: &mut runs, lanes: &lanes, limit, segments: &mut segments };
                if scalar {
                    pulp::WithSimd::with_simd(walk, pulp::Scalar::new());
                } else {
                    pulp::Arch::new().dispatch(walk);
                }
                for lane in 0..bits.len() {
                    let mut path = vec![0; segments.list().len()];
                    segments.path(lane, &mut path);
                    let got = walked(&runs, path.into_iter());
                    let present = (0..).zip(&locals).filter(|(_, l)| lanes.has(lane, **l)).map(|(i, _)| i);
                    let expected = walked(&runs, present);
                    prop_assert!((0..2).all(|k| (got[k] - expected[k]).abs() < 2e-6 * (1.0 + expected[k])));
                }
            }
        }
    }

    #[test]
    fn segments_end_where_a_group_too_many_comes() {
        let mut groups = [NONE; MOST];
        let places: Vec<_> = [7, 3, 7, 9, 3].map(|l| place(&mut groups, 2, l)).into();
        assert_eq!(places, [Some(0), Some(1), Some(0), None, Some(1)]);
        // One lane: a segment per run costs least. Many lanes over interleaved groups: large segments.
        assert_eq!(limit(&[1, 2, 3, 4], 1), 1);
        let interleaved: Vec<u32> = (0..60).map(|i| i * 7 % 4).collect();
        assert_eq!(limit(&interleaved, 128), MOST);
    }
}
