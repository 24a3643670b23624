//! Utilities of all groups of a context from one pass front to back and one back to front.
//!
//! Taking the splats of a group out of a pixel one after the other, nearest first, changes it by a sum of
//! `α·Q·(behind - c)`, where `Q` is what shows through everything in front that is not of the group, and
//! `behind` is the picture behind the splat as it is. With `P` what the group's own splats in front let
//! through, `Q = T / P`; for a group that is added instead, `Q = T·P`. So besides the picture only one
//! number per pixel and group is kept, `P`, and the group's share `a` of the pixel needs no picture
//! without it. The squared error then changes by `Σ (a ∓ 2·r)·a` with the picture's residual `r`.
//!
//! The quotient has no cancellation: `T` is a product with `P` among its factors. It is exact but for
//! rounding until the group alone lets less than 2⁻¹⁰⁰ through; its splats behind that are left in.
//! That takes 15 splats of alpha 0.99, or 100 of 0.5, of one group in one pixel.

use super::scaffold::{Entry, Shared};
use super::squares::{Planes, inside};
use super::{Engine, States, Utilities};
use crate::adjoint::trace::{Record, Rows, SEGMENT, Trace};
use crate::parallel;
use crate::settings::Settings;
use crate::stage::TILE;
use crate::stage::blend::Rules;

/// Least share that a group may let through for what is behind to count: 2⁻¹⁰⁰.
const LEAST: f32 = f32::from_bits((127 - 100) << 23);

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
    shares: Vec<Share>,
    /// What each local group lets through so far.
    own: Vec<Rows>,
    /// That, at the start of each segment.
    marks: Vec<Vec<Rows>>,
}

/// All utilities in all contexts.
pub(super) fn utilities(engine: &Engine, contexts: &States) -> Utilities {
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
        for (y, rows) in residual[..height].iter_mut().enumerate() {
            for (c, row) in rows.iter_mut().enumerate() {
                for (x, r) in row[..width].iter_mut().enumerate() {
                    *r = self.behind[c].0[y][x] - reference[y][c][x];
                    sse += f64::from(*r) * f64::from(*r);
                }
            }
        }
        out.push(sse);
        for (share, &present) in self.shares.iter().zip(&self.present) {
            let sign = if present { -2.0 } else { 2.0 };
            let mut sums = [0.0f64; TILE];
            for y in (0..height).filter(|y| share.touched >> y & 1 == 1) {
                for (a, r) in share.rows[y].iter().zip(&residual[y]) {
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
        let Room { trace, list, present, behind, shares, own, marks } = room;
        let (entries, corner) = (shared.entries(tile), shared.corner(tile));
        // As all fast modes: nothing is stopped early.
        let rules = Rules::new(&Settings { early_stop: false, ..settings.clone() });
        let here = |place: usize| present[entries[place].local as usize];
        own.clear();
        own.resize(present.len(), Rows([[1.0; TILE]; TILE]));
        let segments = list.len().div_ceil(SEGMENT);
        marks.resize_with(segments.max(marks.len()), Vec::new);
        trace.start();
        for (k, segment) in list.chunks(SEGMENT).enumerate() {
            trace.next(&shared.projected.splats, segment, corner, &rules, |i| here(k * SEGMENT + i));
            marks[k].clone_from(own);
            through(trace, &entries[k * SEGMENT..], segment.len(), present, own);
        }
        for (rows, background) in behind.iter_mut().zip(settings.background) {
            rows.0 = [[background; TILE]; TILE];
        }
        for k in (0..segments).rev() {
            let start = k * SEGMENT;
            let segment = &list[start..list.len().min(start + SEGMENT)];
            if k + 1 < segments {
                trace.again(k, &shared.projected.splats, segment, corner, &rules, |i| here(start + i));
                own.clone_from(&marks[k]);
                through(trace, &entries[start..], segment.len(), present, own);
            }
            for i in (0..segment.len()).rev() {
                let (visits, local) = (trace.visits(i), entries[start + i].local as usize);
                let (colour, share) = (trace.near[i].colour, &mut shares[local]);
                let hides = if present[local] { 1.0 } else { 0.0 };
                for (visit, record) in trace.visits[visits.clone()].iter().zip(&trace.records[visits]) {
                    let y = visit.y as usize % TILE;
                    share.touched |= 1 << y;
                    for c in 0..3 {
                        let (behind, share) = (&mut behind[c].0[y], &mut share.rows[y][c]);
                        for x in 0..TILE {
                            let gain = record.alpha[x] * (colour[c] - behind[x]);
                            share[x] += record.transmittance[x] * gain;
                            behind[x] += hides * gain;
                        }
                    }
                }
            }
        }
    }
}

/// Makes of every transmittance of the segment what shows through the splats in front, without those of
/// the same group if it is present, and with them if it is not.
#[inline(always)]
fn through(trace: &mut Trace, entries: &[Entry], count: usize, present: &[bool], own: &mut [Rows]) {
    for (i, entry) in entries[..count].iter().enumerate() {
        let visits = trace.visits(i);
        let (local, present) = (entry.local as usize, present[entry.local as usize]);
        for (visit, record) in trace.visits[visits.clone()].iter().zip(&mut trace.records[visits]) {
            let own = &mut own[local].0[visit.y as usize % TILE];
            let Record { alpha, transmittance } = record;
            if present {
                for x in 0..TILE {
                    transmittance[x] = if own[x] >= LEAST { transmittance[x] / own[x] } else { 0.0 };
                }
            } else {
                (0..TILE).for_each(|x| transmittance[x] *= own[x]);
            }
            (0..TILE).for_each(|x| own[x] -= alpha[x] * own[x]);
        }
    }
}
