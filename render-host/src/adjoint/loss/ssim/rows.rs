//! Rings of rows filter a picture along and down, in packs that the compiler makes vectors of.
//!
//! A row is interleaved r g b, padded to whole packs. Nothing is fused or reordered, so every vector width
//! gives the same bits.

use crate::metric::ssim::WINDOW;

/// Values worked on at a time, and zeros on either side of a row that is filtered along.
pub(crate) const MARGIN: usize = 16;
/// Pixels from the middle of a window to its end.
pub(crate) const MIDDLE: usize = WINDOW / 2;

/// Values side by side.
pub(crate) type Pack = [f32; MARGIN];

/// Rows of a ring: slot `row mod WINDOW`, a row of each kind.
#[derive(Debug, Default)]
pub(crate) struct Ring {
    packs: Vec<Pack>,
    /// Quantities kept of each row.
    kinds: usize,
    /// Packs per row.
    width: usize,
    empty: [bool; WINDOW],
}

impl Ring {
    /// Empties the ring, for rows of `kinds` quantities, each `width` packs long.
    pub(crate) fn open(&mut self, kinds: usize, width: usize) {
        (self.kinds, self.width) = (kinds, width);
        self.packs.clear();
        self.packs.resize(WINDOW * kinds * width, [0.0; MARGIN]);
        self.empty = [true; WINDOW];
    }

    /// Rows of the slot of `row`, to be written.
    #[inline(always)]
    pub(crate) fn slot(&mut self, row: isize) -> &mut [Pack] {
        let slot = row.rem_euclid(WINDOW as isize) as usize;
        self.empty[slot] = false;
        &mut self.packs[slot * self.kinds * self.width..][..self.kinds * self.width]
    }

    /// Makes the slot of `row` zeros.
    #[inline(always)]
    pub(crate) fn clear(&mut self, row: isize) {
        let slot = row.rem_euclid(WINDOW as isize) as usize;
        if !std::mem::replace(&mut self.empty[slot], true) {
            self.packs[slot * self.kinds * self.width..][..self.kinds * self.width].fill([0.0; MARGIN]);
        }
    }

    /// The rows around `middle`, top first; of each, its kinds one after the other.
    #[inline(always)]
    pub(crate) fn around(&self, middle: isize) -> [&[Pack]; WINDOW] {
        std::array::from_fn(|k| {
            let row = middle + k as isize - MIDDLE as isize;
            let slot = row.rem_euclid(WINDOW as isize) as usize;
            &self.packs[slot * self.kinds * self.width..][..self.kinds * self.width]
        })
    }
}

/// Filters each of `flat` along, pixel by pixel of three values, to the rows of a slot.
#[inline(always)]
pub(crate) fn filter<const KINDS: usize>(
    flat: [&[f32]; KINDS],
    weights: &[f32; MIDDLE + 1],
    out: &mut [Pack],
) {
    let packs = out.len() / KINDS;
    for (flat, out) in flat.into_iter().zip(out.chunks_exact_mut(packs.max(1))) {
        for (around, out) in flat.windows(3 * MARGIN).step_by(MARGIN).zip(out) {
            let mut sum = [0.0; MARGIN];
            for i in 0..MARGIN {
                sum[i] = weights[0] * around[MARGIN + i];
            }
            for k in 1..=MIDDLE {
                for i in 0..MARGIN {
                    sum[i] += weights[k] * (around[MARGIN + i - 3 * k] + around[MARGIN + i + 3 * k]);
                }
            }
            *out = sum;
        }
    }
}

/// Pack `at` of the rows, filtered down.
#[inline(always)]
pub(crate) fn down(rows: &[&[Pack]; WINDOW], at: usize, weights: &[f32; MIDDLE + 1]) -> Pack {
    let middle = &rows[MIDDLE][at];
    let mut sum = [0.0; MARGIN];
    for i in 0..MARGIN {
        sum[i] = weights[0] * middle[i];
    }
    for k in 1..=MIDDLE {
        let (above, below) = (&rows[MIDDLE - k][at], &rows[MIDDLE + k][at]);
        for i in 0..MARGIN {
            sum[i] += weights[k] * (above[i] + below[i]);
        }
    }
    sum
}

/// Sum in a fixed tree.
#[inline(always)]
pub(crate) fn total(mut sums: [f64; MARGIN]) -> f64 {
    for half in [8, 4, 2, 1] {
        for i in 0..half {
            sums[i] += sums[i + half];
        }
    }
    sums[0]
}
