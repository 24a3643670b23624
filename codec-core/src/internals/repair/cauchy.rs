//! Makes and inverts the code's matrix: Cauchy, scaled so that its first row is all ones.
//!
//! Every square part of a Cauchy matrix is invertible, and scaling columns keeps it so: any r rows
//! give back any r missing members. With one row the code is XOR.

use super::gf256::{inverse, mul};
use crate::limits::{MAX_REPAIR_PARITY, MAX_REPAIR_SET};

/// Rows and columns are told apart by points of the field that must all differ.
const _: () = assert!(MAX_REPAIR_PARITY + MAX_REPAIR_SET <= 256);

/// All coefficients, by position and row: half a KiB, so that nobody inverts on arrival.
static COEFFICIENTS: [[u8; MAX_REPAIR_PARITY]; MAX_REPAIR_SET] = {
    let mut all = [[0; MAX_REPAIR_PARITY]; MAX_REPAIR_SET];
    let mut at = 0;
    while at < MAX_REPAIR_PARITY * MAX_REPAIR_SET {
        let (position, row) = (at / MAX_REPAIR_PARITY, at % MAX_REPAIR_PARITY);
        let y = (MAX_REPAIR_PARITY + position) as u8;
        all[position][row] = mul(y, inverse(y ^ row as u8));
        at += 1;
    }
    all
};

/// What each parity row multiplies member `position` (below [`MAX_REPAIR_SET`]) by: y / (y − row)
/// with y = [`MAX_REPAIR_PARITY`] + position. Beyond there is none.
pub fn column(position: u32) -> Option<&'static [u8; MAX_REPAIR_PARITY]> {
    COEFFICIENTS.get(position as usize)
}

/// Entry `row` (below [`MAX_REPAIR_PARITY`]) of [`column()`] `position`. Beyond there is none.
pub fn coefficient(row: u32, position: u32) -> Option<u8> {
    column(position)?.get(row as usize).copied()
}

/// Row per parity row, column per position; inverted the other way round.
type Matrix = [[u8; MAX_REPAIR_PARITY]; MAX_REPAIR_PARITY];

const IDENTITY: Matrix = {
    let mut identity = [[0; MAX_REPAIR_PARITY]; MAX_REPAIR_PARITY];
    let mut i = 0;
    while i < MAX_REPAIR_PARITY {
        identity[i][i] = 1;
        i += 1;
    }
    identity
};

/// Turns sums of some rows over as many missing positions into those members.
#[derive(Clone, Copy, Debug)]
pub struct Solution {
    positions: [u8; MAX_REPAIR_PARITY],
    rows: [u8; MAX_REPAIR_PARITY],
    count: usize,
    /// Row per position, column per parity row.
    inverse: Matrix,
}

impl Solution {
    /// For the positions of the bits of `absent` from the first of the bits of `rows`; `None` if
    /// nothing is absent or there are too few rows.
    pub fn of(absent: u64, rows: u8) -> Option<Self> {
        let count = absent.count_ones();
        if count == 0 || count > rows.count_ones() {
            return None;
        }
        let mut this = Self {
            positions: [0; MAX_REPAIR_PARITY],
            rows: [0; MAX_REPAIR_PARITY],
            count: count as usize,
            inverse: IDENTITY,
        };
        let (mut absent, mut present) = (absent, rows);
        for (position, row) in this.positions.iter_mut().zip(&mut this.rows).take(this.count) {
            *position = absent.trailing_zeros() as u8;
            *row = present.trailing_zeros() as u8;
            absent &= absent.wrapping_sub(1);
            present &= present.wrapping_sub(1);
        }
        // Rows and columns that are not needed stand for themselves.
        let mut matrix = IDENTITY;
        for (line, &row) in matrix.iter_mut().zip(&this.rows).take(this.count) {
            for (entry, &position) in line.iter_mut().zip(&this.positions).take(this.count) {
                *entry = coefficient(row.into(), position.into())?;
            }
        }
        invert(&mut matrix, &mut this.inverse);
        Some(this)
    }

    /// The missing positions, ascending.
    pub fn positions(&self) -> impl Iterator<Item = u32> + use<> {
        self.positions.into_iter().take(self.count).map(u32::from)
    }

    /// What to multiply which row by to get missing position number `index`: (row, factor).
    pub fn terms(&self, index: usize) -> impl Iterator<Item = (u32, &u8)> + '_ {
        let factors = self.inverse.get(index).into_iter().flatten();
        self.rows.iter().zip(factors).take(self.count).map(|(&row, factor)| (u32::from(row), factor))
    }
}

/// Multiplies `matrix` and `inverted` alike until the first is the identity (Gauss and Jordan). No leading
/// part of a Cauchy matrix is singular, so no pivot is zero and no rows change places.
fn invert(matrix: &mut Matrix, inverted: &mut Matrix) {
    for i in 0..MAX_REPAIR_PARITY {
        // Of the identity nothing is to be done, and most of a matrix may be that.
        if matrix[i][i] != 1 {
            let scale = inverse(matrix[i][i]);
            for entry in matrix[i].iter_mut().chain(&mut inverted[i]) {
                *entry = mul(*entry, scale);
            }
        }
        let (pivot, pivot_inverted) = (matrix[i], inverted[i]);
        for j in 0..MAX_REPAIR_PARITY {
            let factor = matrix[j][i];
            if j == i || factor == 0 {
                continue;
            }
            let line = matrix[j].iter_mut().chain(&mut inverted[j]);
            for (entry, p) in line.zip(pivot.into_iter().chain(pivot_inverted)) {
                *entry ^= mul(p, factor);
            }
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::repair::gf256::slow;

    #[test]
    fn the_first_row_is_xor_and_no_coefficient_is_zero() {
        for position in 0..MAX_REPAIR_SET as u32 {
            assert_eq!(coefficient(0, position), Some(1));
            for row in 1..MAX_REPAIR_PARITY as u32 {
                assert!(coefficient(row, position).is_some_and(|c| c > 1), "{row} {position}");
            }
        }
    }

    /// Bits of a number below `most`, `count` of them set, from a seed.
    fn pick(count: u32, most: u32, seed: &mut u32) -> u64 {
        let mut bits = 0u64;
        while bits.count_ones() < count {
            *seed = seed.wrapping_mul(1_664_525).wrapping_add(1_013_904_223);
            bits |= 1 << ((*seed >> 16) % most);
        }
        bits
    }

    #[test]
    fn rows_times_inverse_is_one() {
        let mut seed = 1;
        let all = pick(64, 64, &mut seed);
        assert!(Solution::of(all, 0xff).is_none() && Solution::of(0, 0xff).is_none());
        for n in 1..=8u32 {
            for _ in 0..if cfg!(miri) { 2 } else { 50 } {
                let absent = pick(n, MAX_REPAIR_SET as u32, &mut seed);
                let rows = pick(n, MAX_REPAIR_PARITY as u32, &mut seed) as u8;
                assert!(Solution::of(absent, rows & rows.wrapping_sub(1)).is_none(), "one row too few");
                let solution = Solution::of(absent, rows).unwrap();
                assert_eq!(solution.positions().map(|p| 1u64 << p).sum::<u64>(), absent);
                for (i, _) in solution.positions().enumerate() {
                    for (j, position) in solution.positions().enumerate() {
                        let sum = solution.terms(i).fold(0, |sum, (row, factor)| {
                            sum ^ slow::mul(*factor, coefficient(row, position).unwrap())
                        });
                        assert_eq!(sum, u8::from(i == j), "{absent:x} {rows:x} {i} {j}");
                    }
                }
            }
        }
    }
}
