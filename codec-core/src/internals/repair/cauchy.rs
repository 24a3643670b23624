//! The code's matrix: Cauchy, scaled so that its first row is all ones.
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
/// with y = [`MAX_REPAIR_PARITY`] + position. Beyond: zeros.
pub fn column(position: u32) -> &'static [u8; MAX_REPAIR_PARITY] {
    COEFFICIENTS.get(position as usize).unwrap_or(&[0; MAX_REPAIR_PARITY])
}

/// Entry `row` (below [`MAX_REPAIR_PARITY`]) of [`column()`] `position`. Beyond: 0.
pub fn coefficient(row: u32, position: u32) -> u8 {
    column(position).get(row as usize).copied().unwrap_or(0)
}

/// Turns sums of some rows over as many missing positions into those members.
#[derive(Clone, Copy, Debug)]
pub struct Solution {
    positions: [u8; MAX_REPAIR_PARITY],
    rows: [u8; MAX_REPAIR_PARITY],
    count: usize,
    /// Row per position, column per parity row.
    inverse: [[u8; MAX_REPAIR_PARITY]; MAX_REPAIR_PARITY],
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
            inverse: [[0; MAX_REPAIR_PARITY]; MAX_REPAIR_PARITY],
        };
        let (mut absent, mut present) = (absent, rows);
        for (position, row) in this.positions.iter_mut().zip(&mut this.rows).take(this.count) {
            *position = absent.trailing_zeros() as u8;
            *row = present.trailing_zeros() as u8;
            absent &= absent.wrapping_sub(1);
            present &= present.wrapping_sub(1);
        }
        let mut matrix = [[0u8; MAX_REPAIR_PARITY]; MAX_REPAIR_PARITY];
        for (line, &row) in matrix.iter_mut().zip(&this.rows).take(this.count) {
            for (entry, &position) in line.iter_mut().zip(&this.positions).take(this.count) {
                *entry = coefficient(row.into(), position.into());
            }
        }
        invert(&mut matrix, &mut this.inverse, this.count);
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

/// Gauss and Jordan over the first `n` rows and columns. No leading part of a Cauchy matrix is
/// singular, so no pivot is zero and no rows change places.
fn invert(
    matrix: &mut [[u8; MAX_REPAIR_PARITY]; MAX_REPAIR_PARITY],
    inverted: &mut [[u8; MAX_REPAIR_PARITY]; MAX_REPAIR_PARITY],
    n: usize,
) {
    let n = n.min(MAX_REPAIR_PARITY);
    for (i, line) in inverted.iter_mut().enumerate().take(n) {
        line[i] = 1;
    }
    for i in 0..n {
        let scale = inverse(matrix[i][i]);
        for entry in matrix[i].iter_mut().take(n).chain(inverted[i].iter_mut().take(n)) {
            *entry = mul(*entry, scale);
        }
        let (pivot, pivot_inverted) = (matrix[i], inverted[i]);
        // A plain range, whose bound the compiler sees: no index here can be out of bounds.
        for j in 0..n {
            if j == i {
                continue;
            }
            let factor = matrix[j][i];
            for (entry, p) in matrix[j]
                .iter_mut()
                .zip(pivot)
                .take(n)
                .chain(inverted[j].iter_mut().zip(pivot_inverted).take(n))
            {
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
            assert_eq!(coefficient(0, position), 1);
            for row in 1..MAX_REPAIR_PARITY as u32 {
                assert!(coefficient(row, position) > 1, "{row} {position}");
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
                            sum ^ slow::mul(*factor, coefficient(row, position))
                        });
                        assert_eq!(sum, u8::from(i == j), "{absent:x} {rows:x} {i} {j}");
                    }
                }
            }
        }
    }
}
