//! Blends the pixels of a block in many worlds at once, with the operations of a single render.
//!
//! Worlds that hold the same of the groups met so far have blended the same splats, so they are one world
//! until a group comes that only some of them hold. Each world's splats, their order and every operation
//! are those of a render of that world alone; a walk ends where no pixel of the block is open any more.

use std::ops::Range;

use pulp::Simd;

use super::{
    culling::TileCulling,
    lanes::Lanes,
    operator::{Operator, OperatorPart, lanes, parts},
    splat_runs::SplatRuns,
};

/// Runs between two checks of whether every pixel is finished.
const CHECK_EVERY: usize = 4;

/// Scratch memory of a walk, and what it found.
#[derive(Default)]
pub(super) struct Tree {
    /// Worlds, those that part last side by side.
    order: Vec<u32>,
    /// Of each world, the groups it holds in order of appearance, nearest in the highest bit.
    keys: Vec<u64>,
    /// Whether each run is the first of its group.
    first: Vec<bool>,
    /// Worlds that wait at a run, with what they have gathered.
    waiting: Vec<(Range<usize>, usize, Operator)>,
    /// What each world has gathered behind the last run.
    pub found: Vec<Operator>,
    /// Groups in order of appearance.
    groups: Vec<u32>,
}

impl Tree {
    /// Blends a block in every world of `worlds`, each named by a lane that holds its groups.
    #[inline(always)]
    pub(super) fn walk<S: Simd>(
        &mut self,
        simd: S,
        culling: &TileCulling,
        runs: &SplatRuns,
        lanes: &Lanes,
        worlds: &[u32],
        stop: f32,
    ) {
        self.sort(runs, lanes, worlds);
        let Self { order, first, waiting, found, .. } = self;
        let holds = |world: u32, local: u32| lanes.has(worlds[world as usize] as usize, local);
        found.resize(worlds.len(), Operator::IDENTITY);
        waiting.clear();
        if !order.is_empty() {
            waiting.push((0..order.len(), 0, Operator::IDENTITY));
        }
        while let Some((mut here, from, mut now)) = waiting.pop() {
            let mut blended = 0;
            for (run, (&local, &fresh)) in runs.locals.iter().zip(first.iter()).enumerate().skip(from) {
                if fresh {
                    let with = order[here.clone()].partition_point(|&world| holds(world, local));
                    let middle = here.start + with;
                    if middle < here.end && with > 0 {
                        waiting.push((middle..here.end, run, now));
                        here.end = middle;
                    }
                }
                if holds(order[here.start], local) {
                    blend(simd, culling, runs, run, stop, &mut now);
                    blended += 1;
                    if blended % CHECK_EVERY == 0 && is_finished(&now, stop) {
                        break;
                    }
                }
            }
            order[here].iter().for_each(|&world| found[world as usize] = now);
        }
    }

    /// Orders worlds by what they hold of the groups in order of appearance.
    #[inline(always)]
    fn sort(&mut self, runs: &SplatRuns, lanes: &Lanes, worlds: &[u32]) {
        let Self { order, keys, first, groups, .. } = self;
        groups.clear();
        first.clear();
        for local in &runs.locals {
            let fresh = !groups.contains(local);
            first.push(fresh);
            if fresh {
                groups.push(*local);
            }
        }
        let words = groups.len().div_ceil(64).max(1);
        keys.clear();
        keys.resize(words * worlds.len(), 0);
        for (key, &world) in keys.chunks_exact_mut(words).zip(worlds) {
            for (place, &group) in groups.iter().enumerate() {
                key[place / 64] |= u64::from(lanes.has(world as usize, group)) << (63 - place % 64);
            }
        }
        let key = |world: u32| &keys[world as usize * words..][..words];
        order.clear();
        order.extend(0..worlds.len() as u32);
        order.sort_unstable_by(|&a, &b| key(b).cmp(key(a)));
    }
}

/// Whether no later splat changes a pixel: each is below the stop.
#[inline(always)]
fn is_finished(now: &Operator, stop: f32) -> bool {
    now.t.iter().fold(true, |all, &t| all & (t < stop))
}

/// Blends the splats of a run, with the operations of a render in its order.
#[inline(always)]
fn blend<S: Simd>(
    simd: S,
    culling: &TileCulling,
    runs: &SplatRuns,
    run: usize,
    stop: f32,
    now: &mut Operator,
) {
    let (stop, zero) = (simd.splat_f32s(stop), simd.splat_f32s(0.0));
    for part in 0..parts::<S>() {
        let mut part_now = OperatorPart::<S>::load(now, part);
        for i in runs.members(run) {
            let colour = culling.splats()[runs.position(i)].colour;
            let OperatorPart { t, rgb } = &mut part_now;
            let open = simd.greater_than_or_equal_f32s(*t, stop);
            let alpha = simd.select_f32s(open, lanes::<S>(runs.alpha(i), part), zero);
            let weight = simd.mul_f32s(alpha, *t);
            for (sum, c) in rgb.iter_mut().zip(colour) {
                *sum = simd.add_f32s(*sum, simd.mul_f32s(weight, simd.splat_f32s(c)));
            }
            *t = simd.sub_f32s(*t, weight);
        }
        part_now.store(now, part);
    }
}
