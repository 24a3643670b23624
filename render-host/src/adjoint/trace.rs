//! Walks a segment of a tile's list again front to back and writes down what each splat met.
//!
//! The forward pass keeps the transmittances before each segment, so that a list of any length needs the
//! memory of one segment.

use std::ops::Range;

use crate::stage::{
    Splat, TILE,
    blend::{LOOK_EVERY, SEGMENT, Transmittances, fetch, is_open},
    reach::{LANE, Lanes, Local, Rules, for_each_row},
};

/// What a splat did to a row of pixels.
#[derive(Clone, Debug)]
#[repr(align(64))]
pub(crate) struct Record {
    pub(crate) alpha: Lanes,
    /// Before the splat.
    pub(crate) transmittance: Lanes,
}

/// A row of pixels that a splat reaches, and `u` and `v` at its first.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Visit {
    pub(crate) u: f32,
    pub(crate) v: f32,
    pub(crate) y: u32,
}

/// A value per pixel of a tile.
#[derive(Clone, Debug, Default)]
#[repr(align(64))]
pub(crate) struct Rows(pub(crate) [Lanes; TILE]);

/// Scratch memory of a tile; what it held does not matter.
#[derive(Debug, Default)]
pub(crate) struct Trace {
    /// Transmittance now.
    now: Rows,
    /// Splats of the segment.
    pub(crate) near: Vec<Splat>,
    /// Rows visited in the segment, splat by splat.
    pub(crate) visits: Vec<Visit>,
    /// What happened in each visit; past the last one, anything.
    pub(crate) records: Vec<Record>,
    /// Number of visits before each splat of the segment.
    starts: Vec<usize>,
}

impl Trace {
    /// Places in `visits` and `records` of splat `i` of the segment.
    #[inline(always)]
    pub(crate) fn visits(&self, i: usize) -> Range<usize> {
        self.starts[i]..self.starts[i + 1]
    }

    /// Blends a segment, of at most [`SEGMENT`] splats, as the forward pass did, from the transmittances
    /// `before` it; writes down each visit.
    #[inline(always)]
    pub(crate) fn walk(
        &mut self,
        splats: &[Splat],
        segment: &[u32],
        corner: [usize; 2],
        rules: &Rules,
        before: &Transmittances,
    ) {
        self.now.0 = *before;
        self.visits.clear();
        self.starts.clear();
        let room = Record { alpha: [0.0; TILE], transmittance: [0.0; TILE] };
        self.near.resize(SEGMENT, Splat::NONE);
        fetch(splats, segment, &mut self.near);
        let mut open = u32::MAX;
        for (k, splat) in self.near[..segment.len()].iter().enumerate() {
            self.starts.push(self.visits.len());
            if k % LOOK_EVERY == 0 && rules.stop > 0.0 {
                open = open_rows(&self.now, rules.stop);
            }
            if open == 0 {
                continue;
            }
            let local = Local::new(splat, corner, rules);
            let most = self.visits.len() + TILE;
            if self.records.len() < most {
                self.records.resize(2 * most, room.clone());
            }
            let Self { now, visits, records, .. } = self;
            let reached = local.rows();
            for_each_row(reached.rows & open, |y| {
                let (u, v) = (reached.u[y], reached.v[y]);
                let record = &mut records[visits.len()];
                record_row(&mut now.0[y], record, u, local.root[0], splat.log2_alpha - v * v, rules);
                visits.push(Visit { u, v, y: y as u32 });
            });
        }
        self.starts.push(self.visits.len());
    }
}

#[inline(always)]
fn record_row(t: &mut Lanes, record: &mut Record, u: f32, xx: f32, exponent: f32, rules: &Rules) {
    for i in 0..TILE {
        let q = u + xx * LANE[i];
        let alpha = rules.alpha(exponent - q * q, t[i]);
        record.alpha[i] = alpha;
        record.transmittance[i] = t[i];
        t[i] -= alpha * t[i];
    }
}

/// Bit `y` is set while a pixel of row `y` is not finished.
#[inline(always)]
fn open_rows(now: &Rows, stop: f32) -> u32 {
    let mut open = 0;
    for (y, row) in now.0.iter().enumerate() {
        open |= u32::from(is_open(row, stop)) << y;
    }
    open
}
