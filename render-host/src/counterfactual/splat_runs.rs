//! Composes consecutive splats of one group (a splat run) once per block.
//!
//! A run is one operator, the same for every world that holds the group and the identity for every other.
//! A block has one list of runs for its sixteen pixels: a pixel that a run does not touch has the identity
//! there.

use std::ops::Range;

use pulp::Simd;

use super::{
    culling::TileCulling,
    operator::{Operator, OperatorPart, lanes, lanes_mut, parts},
};
use crate::{
    settings::Settings,
    stage::{TILE, blend::Lanes},
};

/// What a splat did to the pixels of a block, as the backward pass reads it.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Visit {
    pub alpha: Lanes,
    /// Transmittance of the run before the splat.
    pub before: Lanes,
}

/// The runs of one block, nearest first.
#[derive(Debug, Default)]
pub(super) struct SplatRuns {
    /// Positions in the culling of the block's splats, then anything.
    list: Vec<u32>,
    /// Group of each run, as an index into the tile's groups.
    pub locals: Vec<u32>,
    /// Run `r` is `list[starts[r]..starts[r + 1]]`.
    starts: Vec<u32>,
    /// One operator per run, then the identity; behind them, room for operators made of several.
    pub operators: Vec<Operator>,
    alphas: Vec<Alphas>,
    /// One per splat of the list, when they were asked for.
    pub visits: Vec<Visit>,
}

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Alphas(Lanes);

impl SplatRuns {
    /// Takes the splats of `block`, of all its groups, and says where runs begin and end.
    #[inline(always)]
    pub(super) fn find(&mut self, culling: &TileCulling, block: usize, settings: &Settings) {
        let limits = [settings.cutoff(), settings.alpha_max];
        let reached = culling.block(block, &mut self.list);
        let Self { list, locals, starts, alphas, .. } = self;
        let splats = culling.splats();
        if alphas.len() < reached {
            alphas.resize(reached, Alphas([0.0; TILE]));
        }
        // Alphas of all splats first: their long chains of arithmetic overlap. A splat that touches no
        // pixel would only cut runs short.
        let mut touching = 0;
        for i in 0..reached {
            let at = list[i];
            let alpha = splats[at as usize].alphas(block, limits);
            list[touching] = at;
            alphas[touching] = Alphas(alpha);
            touching += usize::from(touches(&alpha));
        }
        locals.resize(touching + 1, 0);
        starts.resize(touching + 1, 0);
        let (mut runs, mut last) = (0, u32::MAX);
        for (i, &at) in (0..).zip(&list[..touching]) {
            // Without a branch: where runs end is anyone's guess.
            let local = splats[at as usize].local;
            locals[runs] = local;
            starts[runs] = i;
            runs += usize::from(local != last);
            last = local;
        }
        locals.truncate(runs);
        starts.truncate(runs);
        starts.push(touching as u32);
    }

    /// Composes the runs that were found; with what each splat did if `visits`.
    #[inline(always)]
    pub(super) fn compose<S: Simd>(&mut self, simd: S, culling: &TileCulling, visits: bool) {
        let Self { list, locals, starts, operators, alphas, visits: seen } = self;
        let (splats, runs) = (culling.splats(), locals.len());
        let touching = starts.last().map_or(0, |&end| end as usize);
        if operators.len() <= runs {
            operators.resize(2 * runs + 1, Operator::IDENTITY);
        }
        operators[runs] = Operator::IDENTITY;
        if visits && seen.len() < touching {
            seen.resize(touching, Visit { alpha: [0.0; TILE], before: [0.0; TILE] });
        }
        for part in 0..parts::<S>() {
            for (run, bounds) in starts.windows(2).enumerate() {
                let mut now = OperatorPart::identity(simd);
                for i in bounds[0] as usize..bounds[1] as usize {
                    let alpha = lanes::<S>(&alphas[i].0, part);
                    if visits {
                        *lanes_mut::<S>(&mut seen[i].alpha, part) = alpha;
                        *lanes_mut::<S>(&mut seen[i].before, part) = now.t;
                    }
                    now = now.splat(simd, alpha, splats[list[i] as usize].colour);
                }
                now.store(&mut operators[run], part);
            }
        }
    }

    /// Number of runs.
    pub(super) fn len(&self) -> usize {
        self.locals.len()
    }

    /// Alpha of splat `i` of the list, 0 below the cut-off.
    #[inline(always)]
    pub(super) fn alpha(&self, i: usize) -> &Lanes {
        &self.alphas[i].0
    }

    /// Position in the culling of splat `i` of the list.
    pub(super) fn position(&self, i: usize) -> usize {
        self.list[i] as usize
    }

    /// Positions in the list of the splats of a run.
    pub(super) fn members(&self, run: usize) -> Range<usize> {
        self.starts[run] as usize..self.starts[run + 1] as usize
    }
}

#[inline(always)]
fn touches(alpha: &Lanes) -> bool {
    let mut most = 0u32;
    for &a in alpha {
        most |= a.to_bits();
    }
    most != 0
}
