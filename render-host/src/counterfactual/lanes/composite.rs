//! Composes the pictures of a block in every lane, by its segments.

use pulp::Simd;

use super::{Kinds, Lanes, Row, Wanted, difference, walk};
use crate::{
    counterfactual::{
        operator::{lanes_mut, parts},
        segments::RunSegments,
        splat_runs::SplatRuns,
    },
    stage::TILE,
};

impl Lanes {
    /// Adds the squared errors of a block.
    #[inline(always)]
    pub(in crate::counterfactual) fn composite<S: Simd>(
        &mut self,
        simd: S,
        runs: &SplatRuns,
        segments: &RunSegments,
        kinds: &Kinds,
        wanted: &Wanted,
        background: [f32; 3],
    ) {
        let Self { kinds: errors, walk: path, .. } = self;
        if path.len() < segments.list().len() + 1 {
            path.resize(segments.list().len() + 1, 0);
        }
        if errors.len() < kinds.first.len() {
            errors.resize(kinds.first.len(), Row([0.0; TILE]));
        }
        for (&lane, squares) in kinds.first.iter().zip(errors.iter_mut()) {
            // As long for every lane: a processor predicts the end of the walk.
            segments.path(lane as usize, path);
            for part in 0..parts::<S>() {
                let now = walk(simd, &runs.operators, &path[..segments.list().len()], part);
                let mut sum = simd.splat_f32s(0.0);
                for c in 0..3 {
                    let d = difference(simd, &now, wanted, background, c, part);
                    sum = simd.mul_add_e_f32s(d, d, sum);
                }
                *lanes_mut::<S>(&mut squares.0, part) = sum;
            }
        }
        self.add(simd, kinds);
    }
}
