//! Utilities of all groups from one pass front to back and one back to front: an estimate.
//!
//! What taking a group away changes in a pixel is a sum over its splats, `α·T·(c - behind)`, and exact if
//! `T` is what shows through everything in front, and `behind` the colour behind *without* what the
//! group has there. Here the pixel's runs are counted one by one: `behind` leaves out the splats of the
//! same run (consecutive splats of one group), and keeps those of the group's other runs. So a pixel in
//! which a group has one run is exact, and the derivative of the picture is never taken at all: for a
//! group of opaque surfaces the derivative vanishes, while the group does not.
//!
//! The squared error then changes by `Σ (a ∓ 2·r)·a` with the picture's residual `r` and the group's
//! share `a`: the second order in the picture costs nothing more.

use super::scaffold::Shared;
use super::squares::{Planes, inside};
use super::{Engine, States, Utilities};
use crate::adjoint::trace::{Rows, SEGMENT, Trace};
use crate::parallel;
use crate::settings::Settings;
use crate::stage::blend::{Lanes, Rules};
use crate::stage::TILE;

/// No group.
const NONE: u32 = u32::MAX;

/// The run that a row of pixels is in, from the back.
#[derive(Clone, Debug)]
#[repr(align(64))]
struct Run {
    owner: [u32; TILE],
    /// Colour behind the run.
    behind: [Lanes; 3],
}

impl Run {
    const EMPTY: Self = Self { owner: [NONE; TILE], behind: [[0.0; TILE]; 3] };
}

/// What a group adds to the pixels of a tile, r g b row by row, and the rows that it touches.
#[derive(Clone, Debug)]
#[repr(align(64))]
struct Share {
    rows: Planes,
    touched: u16,
}

/// Scratch memory of a tile.
#[derive(Debug, Default)]
struct Room {
    trace: Trace,
    list: Vec<u32>,
    /// Whether each local group is present.
    present: Vec<bool>,
    behind: [Rows; 3],
    /// Runs of present groups, then of absent ones.
    runs: [Vec<Run>; 2],
    shares: Vec<Share>,
}

/// All utilities in all contexts, estimated.
pub(super) fn estimate(engine: &Engine, contexts: &States) -> Utilities {
    let (shared, groups) = (&engine.shared, engine.groups);
    let mut tiles: Vec<Vec<f64>> = vec![Vec::new(); shared.tiles()];
    parallel::for_each_with(engine.settings.parallel, &mut tiles, |room: &mut Room, tile, out| {
        for context in 0..contexts.len() {
            room.tile(engine, contexts, context, tile, out);
        }
    });
    let mut out =
        Utilities { groups, sse: vec![0.0; contexts.len()], delta: vec![0.0; contexts.len() * groups] };
    for (tile, found) in tiles.iter().enumerate() {
        let here = shared.groups(tile);
        for (context, part) in found.chunks_exact(here.len() + 1).enumerate() {
            out.sse[context] += part[0];
            for (&group, delta) in here.iter().zip(&part[1..]) {
                out.delta[context * groups + group as usize] += delta;
            }
        }
    }
    out
}

impl Room {
    /// Appends the tile's squared error and the utility of each of its groups to `out`.
    fn tile(&mut self, engine: &Engine, contexts: &States, context: usize, tile: usize, out: &mut Vec<f64>) {
        let (shared, groups) = (&engine.shared, engine.shared.groups(tile));
        self.list.clear();
        self.list.extend(shared.entries(tile).iter().map(|entry| entry.splat));
        self.present.clear();
        self.present.extend(groups.iter().map(|&group| contexts.has(context, group as usize)));
        let empty = Share { rows: [[[0.0; TILE]; 3]; TILE], touched: 0 };
        self.shares.clear();
        self.shares.resize(groups.len(), empty);
        let work = Sweep { shared, settings: &engine.settings, tile, room: self };
        pulp::Arch::new().dispatch(work);
        let (width, height) = inside(shared.corner(tile), shared.size);
        let reference = &engine.reference[tile];
        let mut residual: Planes = [[[0.0; TILE]; 3]; TILE];
        let mut sse = 0.0;
        for y in 0..height {
            for c in 0..3 {
                for x in 0..width {
                    let r = self.behind[c].0[y][x] - reference[y][c][x];
                    residual[y][c][x] = r;
                    sse += f64::from(r) * f64::from(r);
                }
            }
        }
        out.push(sse);
        for (share, &present) in self.shares.iter().zip(&self.present) {
            let sign = if present { -2.0 } else { 2.0 };
            let mut sums = [0.0f64; TILE];
            for y in (0..height).filter(|y| share.touched >> y & 1 == 1) {
                for c in 0..3 {
                    let (a, r) = (&share.rows[y][c], &residual[y][c]);
                    for x in 0..width {
                        sums[x] += f64::from(a[x]) * (f64::from(a[x]) + sign * f64::from(r[x]));
                    }
                }
            }
            let change: f64 = sums.iter().sum();
            out.push(if present { change } else { -change });
        }
    }
}

/// One tile's work, as a value, so that it can be compiled once per vector width.
struct Sweep<'a> {
    shared: &'a Shared,
    settings: &'a Settings,
    tile: usize,
    room: &'a mut Room,
}

impl pulp::NullaryFnOnce for Sweep<'_> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Self { shared, settings, tile, room } = self;
        let Room { trace, list, present, behind, runs, shares } = room;
        let (entries, corner) = (shared.entries(tile), shared.corner(tile));
        // As all fast modes: nothing is stopped early.
        let rules = Rules::new(&Settings { early_stop: false, ..settings.clone() });
        let here = |place: usize| present[entries[place].local as usize];
        let walked = trace.forward_in(&shared.projected.splats, list, corner, &rules, here);
        for (rows, background) in behind.iter_mut().zip(settings.background) {
            rows.0 = [[background; TILE]; TILE];
        }
        for runs in runs.iter_mut() {
            runs.clear();
            runs.resize(TILE, Run::EMPTY);
        }
        for k in (0..walked).rev() {
            let start = k * SEGMENT;
            let segment = &list[start..list.len().min(start + SEGMENT)];
            if k + 1 < walked {
                trace.again_in(k, &shared.projected.splats, segment, corner, &rules, here);
            }
            for i in (0..segment.len()).rev() {
                let (visits, local) = (trace.visits(i), entries[start + i].local);
                let (colour, share) = (trace.near[i].colour, &mut shares[local as usize]);
                let present = present[local as usize];
                for (visit, record) in trace.visits[visits.clone()].iter().zip(&trace.records[visits]) {
                    let y = visit.y as usize % TILE;
                    share.touched |= 1 << y;
                    let run = &mut runs[usize::from(!present)][y];
                    let [red, green, blue] = &mut *behind;
                    let behind = [&mut red.0[y], &mut green.0[y], &mut blue.0[y]];
                    let row = &mut share.rows[y];
                    take(run, behind, row, &record.alpha, &record.transmittance, colour, local, present);
                }
            }
        }
    }
}

/// Steps one row in front of a splat.
#[inline(always)]
#[expect(clippy::too_many_arguments, reason = "rows of pixels, each of its own array")]
fn take(
    run: &mut Run,
    behind: [&mut Lanes; 3],
    share: &mut [Lanes; 3],
    alpha: &Lanes,
    transmittance: &Lanes,
    colour: [f32; 3],
    local: u32,
    present: bool,
) {
    let Run { owner, behind: behind_run } = run;
    let mut fresh = [false; TILE];
    for i in 0..TILE {
        fresh[i] = (alpha[i] > 0.0) & (owner[i] != local);
        owner[i] = if alpha[i] > 0.0 { local } else { owner[i] };
    }
    // A present splat hides what the picture has behind it, an absent one what its run has.
    let (hides, inserted) = if present { (1.0, 0.0) } else { (0.0, 1.0) };
    for (c, behind) in behind.into_iter().enumerate() {
        let (own, share) = (&mut behind_run[c], &mut share[c]);
        for i in 0..TILE {
            let from = if fresh[i] { behind[i] } else { own[i] };
            let gain = alpha[i] * (colour[c] - from);
            share[i] += transmittance[i] * gain;
            own[i] = from + inserted * gain;
            behind[i] += hides * (alpha[i] * (colour[c] - behind[i]));
        }
    }
}
