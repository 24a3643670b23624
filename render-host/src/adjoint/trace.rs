//! Walks a tile's list again front to back and writes down what each splat met.
//!
//! The list is walked in segments of bounded length. Transmittances at the start of each are kept, so a
//! list of a million needs the memory of one segment.

use std::ops::Range;

use crate::stage::{
    Splat, TILE,
    blend::{LANE, LOOK_EVERY, Lanes, Local, Rules, fetch, is_open},
};

/// Splats between two kept transmittances. A multiple of [`LOOK_EVERY`].
pub(crate) const SEGMENT: usize = 512;

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
    pub(crate) now: Rows,
    /// Splats of the segment.
    pub(crate) near: Vec<Splat>,
    /// Rows visited in the segment, splat by splat.
    pub(crate) visits: Vec<Visit>,
    /// What happened in each visit; past the last one, anything.
    pub(crate) records: Vec<Record>,
    /// Number of visits before each splat of the segment.
    starts: Vec<usize>,
    /// Transmittance at the start of each segment.
    marks: Vec<Rows>,
}

impl Trace {
    /// Walks a whole list as the forward pass does. Returns the number of segments until every pixel was
    /// finished; what is written down is the last of them.
    #[inline(always)]
    pub(crate) fn forward(
        &mut self,
        splats: &[Splat],
        list: &[u32],
        corner: [usize; 2],
        rules: &Rules,
    ) -> usize {
        self.start();
        let mut walked = 0;
        for segment in list.chunks(SEGMENT) {
            if walked > 0 && rules.stop > 0.0 && open_rows(&self.now, rules.stop) == 0 {
                break;
            }
            self.next(splats, segment, corner, rules, |_| true);
            walked += 1;
        }
        walked
    }

    /// Starts a list.
    #[inline(always)]
    pub(crate) fn start(&mut self) {
        self.now.0 = [[1.0; TILE]; TILE];
        self.marks.clear();
    }

    /// Walks the next segment. Only splats at places of it for which `present` says so hide what is
    /// behind them.
    #[inline(always)]
    pub(crate) fn next(
        &mut self,
        splats: &[Splat],
        segment: &[u32],
        corner: [usize; 2],
        rules: &Rules,
        present: impl Fn(usize) -> bool,
    ) {
        self.marks.push(self.now.clone());
        let open = open_rows(&self.now, rules.stop);
        self.walk(splats, segment, corner, rules, open, present);
    }

    /// Walks segment `k` of the list again.
    #[inline(always)]
    pub(crate) fn again(
        &mut self,
        k: usize,
        splats: &[Splat],
        segment: &[u32],
        corner: [usize; 2],
        rules: &Rules,
        present: impl Fn(usize) -> bool,
    ) {
        self.now.clone_from(&self.marks[k]);
        self.walk(splats, segment, corner, rules, u16::MAX, present);
    }

    /// Places in `visits` and `records` of splat `i` of the segment.
    #[inline(always)]
    pub(crate) fn visits(&self, i: usize) -> Range<usize> {
        self.starts[i]..self.starts[i + 1]
    }

    /// Blends a segment as the forward pass does, writing down each visit.
    #[inline(always)]
    fn walk(
        &mut self,
        splats: &[Splat],
        list: &[u32],
        corner: [usize; 2],
        rules: &Rules,
        mut open: u16,
        present: impl Fn(usize) -> bool,
    ) {
        self.visits.clear();
        self.starts.clear();
        let room = Record { alpha: [0.0; TILE], transmittance: [0.0; TILE] };
        self.near.resize(SEGMENT, Splat::NONE);
        fetch(splats, list, &mut self.near);
        for (k, splat) in self.near[..list.len()].iter().enumerate() {
            self.starts.push(self.visits.len());
            if k % LOOK_EVERY == 0 && k > 0 && rules.stop > 0.0 {
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
            let hides = if present(k) { 1.0 } else { 0.0 };
            for y in local.first..local.past {
                if let Some((u, v)) = local.row(y)
                    && open >> y & 1 == 1
                {
                    let record = &mut self.records[self.visits.len()];
                    let exponent = splat.log2_alpha - v * v;
                    take_row(&mut self.now.0[y], record, u, local.root[0], exponent, hides, rules);
                    self.visits.push(Visit { u, v, y: y as u32 });
                }
            }
        }
        self.starts.push(self.visits.len());
    }
}

#[inline(always)]
fn take_row(t: &mut Lanes, record: &mut Record, u: f32, xx: f32, exponent: f32, hides: f32, rules: &Rules) {
    for i in 0..TILE {
        let q = u + xx * LANE[i];
        let alpha = rules.alpha(exponent - q * q, t[i]);
        record.alpha[i] = alpha;
        record.transmittance[i] = t[i];
        t[i] -= hides * (alpha * t[i]);
    }
}

/// Bit `y` is set while a pixel of row `y` is not finished.
#[inline(always)]
fn open_rows(now: &Rows, stop: f32) -> u16 {
    let mut open = 0;
    for (y, row) in now.0.iter().enumerate() {
        open |= u16::from(is_open(row, stop)) << y;
    }
    open
}
