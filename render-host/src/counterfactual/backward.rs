//! Differentiates a weighted sum of the losses of many worlds.
//!
//! Worlds differ only in which runs they hold, so their gradients are added up before the chain to splats:
//!
//! ```text
//! forward, per kind of worlds:   T before each segment, the picture, its pixel gradient v
//! back to front, per kind:       dC += T v    dT += T q    q ← v·C + T' q      (q starts as v·background)
//! per subset of a segment:         the same recursion over its runs
//! per run:                       the same over its splats, then alpha → exponent → ellipse
//! once, for all worlds:          ellipse → Gaussian, by the adjoint of projection
//! ```
//!
//! Nothing is divided. There is no early stop.

use pulp::Simd;

use super::{
    Engine, States, Variants, WorldGradients,
    culling::{ACROSS, BLOCKS, SIDE, TileCulling},
    fast::Worlds,
    lanes::{Kinds, Lanes, Wanted, difference},
    operator::{FLUSH_EVERY, Operator, OperatorPart, flush, lanes, lanes_mut, parts},
    plan::{LanePlan, Pass, group_set},
    segments::RunSegments,
    splat_runs::SplatRuns,
    squares::{inside, wanted, within},
    states::CHUNK,
};
use crate::{
    adjoint::{self, Gradients},
    parallel,
    stage::{TILE, blend},
};

/// Sums of a splat over the pixels of a tile, by column of a block: h, h·u, h·u·x, h·u·y, h·v, h·v·y and
/// three colours, where h is the gradient of the exponent over ln 2.
type Sums = [[f32; SIDE]; adjoint::PARTS];

/// What one tile found.
#[derive(Default)]
struct Found {
    /// One per splat of the tile's list.
    partials: Vec<adjoint::Partial>,
    background: [f64; 3],
}

#[derive(Default)]
struct TileScratch {
    culling: TileCulling,
    runs: SplatRuns,
    passes: Vec<Pass>,
    seen: Vec<u64>,
    sums: Vec<Sums>,
    back: Back,
}

/// Buffers of the backward pass over one block.
#[derive(Default)]
struct Back {
    /// Gradient of each operator.
    operators: Vec<Operator>,
    /// Transmittance before each segment.
    before: Vec<Row>,
    /// Operator of each segment.
    path: Vec<u32>,
    /// Weight of each kind of lanes.
    weights: Vec<f32>,
    /// Gradient of the background, pixel by pixel.
    background: [Row; 3],
}

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Row(blend::Lanes);

impl Default for Row {
    fn default() -> Self {
        Self([0.0; TILE])
    }
}

const ZERO: Operator = Operator { t: [0.0; TILE], rgb: [[0.0; TILE]; 3] };

/// The gradients; `weights` is one per world.
pub(super) fn gradients(
    engine: &Engine,
    variants: &Variants,
    states: &States,
    weights: &[f64],
) -> WorldGradients {
    let Engine { shared, settings, camera, .. } = engine;
    let plan = Worlds::new(states);
    let (tiles, worlds) = (shared.tiles(), states.len());
    let values = 3.0 * (shared.size[0] * shared.size[1]) as f64;
    let scale = 2.0 / values;
    let mut errors = vec![0.0; tiles * worlds];
    let mut found: Vec<Found> = Vec::new();
    found.resize_with(tiles, Found::default);
    if worlds > 0 {
        let mut work: Vec<_> = found.iter_mut().zip(errors.chunks_mut(worlds)).collect();
        parallel::for_each_with(
            settings.parallel,
            &mut work,
            |scratch: &mut TileScratch, tile, (found, errors)| {
                let walk = TileJob { scratch, engine, plan: &plan, tile, weights, scale, found, errors };
                pulp::Arch::new().dispatch(walk);
            },
        );
    }
    let mut out = WorldGradients { losses: vec![0.0; worlds], ..WorldGradients::default() };
    for part in errors.chunks(worlds.max(1)) {
        out.losses.iter_mut().zip(part).for_each(|(total, part)| *total += part);
    }
    out.losses.iter_mut().for_each(|loss| *loss /= values);
    out.loss = out.losses.iter().zip(weights).map(|(loss, weight)| loss * weight).sum();
    for found in &found {
        (0..3).for_each(|c| out.background[c] += found.background[c]);
    }
    let ellipses = gather(engine, &found, variants.splats().len());
    let mut chain = Gradients::default();
    adjoint::chain(&variants.splats(), camera, settings, &shared.projected, &ellipses, &mut chain);
    (out.splats, out.sh_rest) = (chain.splats, chain.sh_rest);
    (out.pose, out.non_finite) = (chain.pose, chain.non_finite);
    out
}

/// Adds up what the tiles found for each splat, in order of tiles.
fn gather(engine: &Engine, found: &[Found], splats: usize) -> Vec<adjoint::Ellipse> {
    let mut out = vec![[0.0; adjoint::PARTS]; splats];
    let parallel = engine.settings.parallel;
    // Each piece reads every list and keeps what is its own.
    let pieces = if parallel { rayon::current_num_threads() } else { 1 };
    let size = splats.div_ceil(pieces).max(1);
    parallel::for_each_chunk(parallel, &mut out, size, |piece, own| {
        let first = piece * size;
        for (tile, found) in found.iter().enumerate() {
            for (entry, partial) in engine.shared.entries(tile).iter().zip(&found.partials) {
                if let Some(sum) = own.get_mut((entry.splat as usize).wrapping_sub(first)) {
                    (0..adjoint::PARTS).for_each(|k| sum[k] += f64::from(partial[k]));
                }
            }
        }
    });
    out
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct TileJob<'a> {
    scratch: &'a mut TileScratch,
    engine: &'a Engine,
    plan: &'a Worlds,
    tile: usize,
    weights: &'a [f64],
    scale: f64,
    found: &'a mut Found,
    errors: &'a mut [f64],
}

impl pulp::WithSimd for TileJob<'_> {
    type Output = ();

    #[inline(always)]
    fn with_simd<S: Simd>(self, simd: S) {
        let Self { scratch, engine, plan, tile, weights, scale, found, errors } = self;
        let TileScratch { culling, runs, passes, seen, sums, back } = scratch;
        let Engine { shared, settings, .. } = engine;
        let groups = shared.groups(tile);
        passes.resize_with(plan.passes(), Pass::default);
        let mut of_lanes = Vec::with_capacity(passes.len());
        for (index, pass) in passes.iter_mut().enumerate() {
            pass.start(groups);
            plan.lanes(index, &mut pass.block);
            let of_class = |&class: &u128| {
                let worlds = super::classes::members(class).map(|world| weights[index * CHUNK + world]);
                worlds.sum::<f64>() * scale
            };
            of_lanes.push(pass.block.classes.iter().map(of_class).collect::<Vec<f64>>());
        }
        culling.fill(shared, tile, settings);
        sums.clear();
        sums.resize(culling.splats().len(), [[0.0; SIDE]; adjoint::PARTS]);
        back.background = Default::default();
        let corner = shared.corner(tile);
        let size = inside(corner, shared.size);
        for index in (0..BLOCKS).filter(|&b| within(b, size)) {
            runs.find(culling, index, settings);
            runs.compose(simd, culling, true);
            let wanted = wanted(&engine.reference[tile], index, size);
            group_set(&runs.locals, groups.len(), seen);
            back.open(runs.len());
            for (pass, of_lanes) in passes.iter_mut().zip(&of_lanes) {
                let at = pass.cut(simd, runs, seen, |groups| plan.kinds(groups));
                let Pass { block, segments, kinds, .. } = pass;
                back.weigh(&kinds[at], of_lanes);
                back.lanes(simd, runs, segments, &mut block.lanes, &kinds[at], &wanted, settings.background);
                back.segments(simd, runs, segments);
            }
            back.splats(simd, runs, culling, index, settings.alpha_max, sums);
        }
        for (index, pass) in passes.iter_mut().enumerate() {
            plan.gather(index, &pass.block, &pass.block.lanes.errors(), errors);
        }
        found.background = back.background.map(|row| super::lanes::total(&row.0));
        found.partials.clear();
        let ellipses = sums.iter().zip(culling.copies());
        found.partials.extend(ellipses.map(|(sums, splat)| {
            adjoint::ellipse(sums.map(|s| s.iter().map(|&v| f64::from(v)).sum()), splat, corner)
        }));
    }
}

impl Back {
    /// Starts a block of `runs` runs.
    fn open(&mut self, runs: usize) {
        self.operators.clear();
        self.operators.resize(runs, ZERO);
    }

    /// Adds up the weights of the lanes of each kind.
    fn weigh(&mut self, kinds: &Kinds, lanes: &[f64]) {
        self.weights.clear();
        self.weights.resize(kinds.first.len(), 0.0);
        for (&kind, &weight) in kinds.of.iter().zip(lanes) {
            self.weights[kind as usize] += weight as f32;
        }
    }

    /// Every kind of worlds forth and back over the segments.
    #[inline(always)]
    #[expect(clippy::too_many_arguments, reason = "one place per part of a block")]
    fn lanes<S: Simd>(
        &mut self,
        simd: S,
        runs: &SplatRuns,
        segments: &RunSegments,
        lanes_of: &mut Lanes,
        kinds: &Kinds,
        wanted: &Wanted,
        background: [f32; 3],
    ) {
        let Self { operators, before, path, weights, background: of_background } = self;
        // What the last pass composed is of no use to this one.
        operators.truncate(runs.len());
        operators.resize(segments.end(), ZERO);
        let steps = segments.list().len();
        path.resize(steps, 0);
        if before.len() < steps {
            before.resize(steps, Row::default());
        }
        for (kind, (&lane, &weight)) in kinds.first.iter().zip(weights.iter()).enumerate() {
            segments.path(lane as usize, path);
            for part in 0..parts::<S>() {
                let mut now = OperatorPart::identity(simd);
                for (path, before) in path.chunks(FLUSH_EVERY).zip(before.chunks_mut(FLUSH_EVERY)) {
                    for (&step, before) in path.iter().zip(before) {
                        *lanes_mut::<S>(&mut before.0, part) = now.t;
                        now = now.then(simd, OperatorPart::load(&runs.operators[step as usize], part));
                    }
                    now = now.flushed(simd);
                }
                let (mut sum, mut q) = (simd.splat_f32s(0.0), simd.splat_f32s(0.0));
                let mut v = [q; 3];
                for c in 0..3 {
                    let d = difference(simd, &now, wanted, background, c, part);
                    sum = simd.mul_add_e_f32s(d, d, sum);
                    v[c] = simd.mul_f32s(d, simd.splat_f32s(weight));
                    q = simd.mul_add_e_f32s(v[c], simd.splat_f32s(background[c]), q);
                    let of_background = lanes_mut::<S>(&mut of_background[c].0, part);
                    *of_background = simd.mul_add_e_f32s(v[c], now.t, *of_background);
                }
                *lanes_mut::<S>(lanes_of.squares(kind), part) = sum;
                for (&step, before) in path.iter().zip(before.iter()).rev() {
                    let t = lanes::<S>(&before.0, part);
                    q = pass(
                        simd,
                        &runs.operators[step as usize],
                        &mut operators[step as usize],
                        t,
                        v,
                        q,
                        part,
                    );
                }
            }
        }
        lanes_of.add(simd, kinds);
    }

    /// From the subsets of each segment to its runs.
    #[inline(always)]
    fn segments<S: Simd>(&mut self, simd: S, runs: &SplatRuns, segments: &mut RunSegments) {
        let Self { operators, before, .. } = self;
        for at in 0..segments.list().len() {
            let segment = segments.list()[at];
            for (subset, operator) in segments.composed(&segment, runs.len()) {
                let picked = segments.picked(segment.runs, subset);
                if before.len() < picked.len() {
                    before.resize(picked.len(), Row::default());
                }
                for part in 0..parts::<S>() {
                    let given = OperatorPart::<S>::load(&operators[operator], part);
                    let mut t = simd.splat_f32s(1.0);
                    for (&run, before) in picked.iter().zip(before.iter_mut()) {
                        *lanes_mut::<S>(&mut before.0, part) = t;
                        t = flush(simd, simd.mul_f32s(t, lanes::<S>(&runs.operators[run as usize].t, part)));
                    }
                    let mut q = given.t;
                    for (&run, before) in picked.iter().zip(before.iter()).rev() {
                        let (run, t) = (run as usize, lanes::<S>(&before.0, part));
                        q = pass(simd, &runs.operators[run], &mut operators[run], t, given.rgb, q, part);
                    }
                }
            }
        }
    }

    /// From runs to what each splat adds to the sums.
    #[inline(always)]
    fn splats<S: Simd>(
        &mut self,
        simd: S,
        runs: &SplatRuns,
        culling: &TileCulling,
        block: usize,
        max: f32,
        sums: &mut [Sums],
    ) {
        let (left, top) = (block % ACROSS * SIDE, (block / ACROSS * SIDE) as f32);
        let max = simd.splat_f32s(max);
        let zero = simd.splat_f32s(0.0);
        for run in 0..runs.len() {
            let given = self.operators[run];
            let mut behind = Row(given.t);
            for i in runs.members(run).rev() {
                let at = runs.position(i);
                let (splat, visit) = (&culling.splats()[at], &runs.visits[i]);
                let (u, v) = splat.axes(block);
                let mut rows = [Row([0.0; TILE]); 8];
                for part in 0..parts::<S>() {
                    let g = given.rgb.each_ref().map(|row| lanes::<S>(row, part));
                    let alpha = lanes::<S>(&visit.alpha, part);
                    let q = lanes_mut::<S>(&mut behind.0, part);
                    let mut own = zero;
                    for (g, colour) in g.into_iter().zip(splat.colour) {
                        own = simd.mul_add_e_f32s(g, simd.splat_f32s(colour), own);
                    }
                    let ahead = simd.sub_f32s(own, *q);
                    let weight = simd.mul_f32s(alpha, lanes::<S>(&visit.before, part));
                    *q = simd.mul_add_e_f32s(alpha, ahead, *q);
                    let free = simd.less_than_f32s(alpha, max);
                    let h = simd.select_f32s(free, simd.mul_f32s(weight, ahead), zero);
                    let (hu, hv) =
                        (simd.mul_f32s(h, lanes::<S>(&u, part)), simd.mul_f32s(h, lanes::<S>(&v, part)));
                    let down = lanes::<S>(&super::culling::ROW, part);
                    let down = simd.add_f32s(down, simd.splat_f32s(top));
                    let values = [
                        h,
                        hu,
                        simd.mul_f32s(hu, down),
                        hv,
                        simd.mul_f32s(hv, down),
                        simd.mul_f32s(weight, g[0]),
                        simd.mul_f32s(weight, g[1]),
                        simd.mul_f32s(weight, g[2]),
                    ];
                    for (row, value) in rows.iter_mut().zip(values) {
                        *lanes_mut::<S>(&mut row.0, part) = value;
                    }
                }
                let folded = rows.map(|row| fold(&row.0));
                let [h, hu, hu_down, hv, hv_down, r, g, b] = folded;
                let along = std::array::from_fn(|i| hu[i] * (left + i) as f32);
                let values = [h, hu, along, hu_down, hv, hv_down, r, g, b];
                for (sum, value) in sums[at].iter_mut().zip(values) {
                    (0..SIDE).for_each(|i| sum[i] += value[i]);
                }
            }
        }
    }
}

/// Takes the gradient of what lies before and behind an operator to the operator: `t` before it, `v` of the
/// light that comes out in front, `q` of the transmittance behind. Returns `q` in front of it.
#[inline(always)]
fn pass<S: Simd>(
    simd: S,
    operator: &Operator,
    gradient: &mut Operator,
    t: S::f32s,
    v: [S::f32s; 3],
    q: S::f32s,
    part: usize,
) -> S::f32s {
    let of_t = lanes_mut::<S>(&mut gradient.t, part);
    *of_t = simd.mul_add_e_f32s(t, q, *of_t);
    let mut ahead = simd.mul_f32s(lanes::<S>(&operator.t, part), q);
    for ((of_c, c), v) in gradient.rgb.iter_mut().zip(&operator.rgb).zip(v) {
        let of_c = lanes_mut::<S>(of_c, part);
        *of_c = simd.mul_add_e_f32s(t, v, *of_c);
        ahead = simd.mul_add_e_f32s(v, lanes::<S>(c, part), ahead);
    }
    ahead
}

/// Sums of the columns of a block.
#[inline(always)]
fn fold(row: &blend::Lanes) -> [f32; SIDE] {
    std::array::from_fn(|i| (row[i] + row[i + SIDE]) + (row[i + 2 * SIDE] + row[i + 3 * SIDE]))
}
