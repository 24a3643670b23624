//! From nested symbols to the indices of one component, many Gaussians at a time.

use crate::{
    error::{Error, Result},
    gaussian::Gaussian,
    ids::Level,
    layout::Shape,
    quant::{Class, Quantiser},
};

/// Gaussians at a time: as many as fill vector registers, and few enough for a short stack.
pub(super) const SPAN: usize = 32;

/// One value per Gaussian, component by component.
pub(super) type Values = [[f32; SPAN]; 3];

/// Calls `put` with every Gaussian and its values.
#[inline(always)]
pub(super) fn each(values: &Values, out: &mut [Gaussian], put: impl Fn(&mut Gaussian, [f32; 3])) {
    let [x, y, z] = values;
    for (((gaussian, &x), &y), &z) in out.iter_mut().zip(x).zip(y).zip(z) {
        put(gaussian, [x, y, z]);
    }
}

/// The three components of `class`, of a rotation the last three.
pub(super) const fn triple(gaussian: &mut Gaussian, class: Class) -> &mut [f32; 3] {
    match class {
        Class::Position => &mut gaussian.position,
        Class::Scale => &mut gaussian.scale,
        Class::Rotation => {
            let [_, xyz @ ..] = &mut gaussian.rotation;
            xyz
        }
        _ => &mut gaussian.sh0,
    }
}

/// Symbols of a block whose components have not been taken yet, level by level.
pub(super) struct Runs<'s> {
    rest: [&'s [i16]; Level::COUNT],
    /// Levels wanted, from the base up.
    levels: usize,
    /// Gaussians in the block.
    n: usize,
}

impl<'s> Runs<'s> {
    /// The runs of block `block` at levels up to `level`; `symbols` are those of its cell.
    ///
    /// # Errors
    /// A cell that has fewer symbols than its shape.
    #[inline(never)]
    pub(super) fn of(shape: &Shape, symbols: &'s [i16], block: usize, level: Level) -> Result<Self> {
        let mut rest = [&[][..]; Level::COUNT];
        for (rest, l) in rest.iter_mut().zip(Level::ALL).filter(|&(_, l)| l <= level) {
            let (at, len) = shape.range(l, block..block + 1);
            *rest = symbols
                .get(at..at + len)
                .ok_or_else(|| Error::too_small("memory.symbols", symbols.len(), at + len))?;
        }
        Ok(Self { rest, levels: level.index() + 1, n: shape.block_gaussians(block) })
    }

    /// The runs of the next component; none at levels that do not carry it or are not wanted.
    ///
    /// # Errors
    /// A block that has fewer components than its shape.
    #[inline(never)]
    pub(super) fn next(&mut self, carries: [bool; Level::COUNT]) -> Result<[&'s [i16]; Level::COUNT]> {
        let mut runs = [&[][..]; Level::COUNT];
        for ((run, rest), carries) in runs.iter_mut().zip(&mut self.rest).take(self.levels).zip(carries) {
            if carries {
                let halves = rest.split_at_checked(self.n);
                (*run, *rest) =
                    halves.ok_or_else(|| Error::too_small("memory.symbols", rest.len(), self.n))?;
            }
        }
        Ok(runs)
    }
}

/// Which levels of a cell carry `class`.
pub(super) fn carrying_levels(shape: &Shape, class: Class) -> [bool; Level::COUNT] {
    Level::ALL.map(|level| shape.carries(class, level))
}

/// Indices of one component of a block, in order: prediction undone, then refined upwards.
///
/// With `m_l` for the product of the ratios above level `l`, the index is the sum of `m_l` times the
/// symbol of level `l`, those of the first level summed up before where they are differences. That
/// is the same as refining level by level unless an index leaves 32 bits, where it saturates; which
/// of the two ways is taken follows from the bounds of a symbol.
pub(super) struct Column<'s> {
    /// Symbols not yet taken, by level; empty where none are coded.
    runs: [&'s [i16]; Level::COUNT],
    /// What a symbol of each level weighs at the level wanted; none if sums may saturate.
    weight: Option<[i16; Level::COUNT]>,
    quantiser: Quantiser,
    first: Level,
    level: Level,
    /// Index of the Gaussian before at the first level, where symbols are differences, or else what
    /// all are relative to; in units of the level wanted if there is a `weight`.
    before: i32,
}

impl<'s> Column<'s> {
    /// The component whose symbols are `runs`, first coded at `first`, wanted at `level`; its
    /// symbols of the first level begin at `start`.
    #[inline(never)]
    pub(super) fn new(
        runs: [&'s [i16]; Level::COUNT],
        quantiser: Quantiser,
        first: Level,
        level: Level,
        start: i16,
    ) -> Self {
        let weight = weights(&quantiser, first, level);
        let before = i32::from(start) * weight.map_or(1, |w| i32::from(w[first.index()]));
        Self { runs, weight, quantiser, first, level, before }
    }

    /// The next indices; those behind the block's end mean nothing.
    #[inline(never)]
    pub(super) fn take(&mut self) -> [i32; SPAN] {
        let mut indices = [0; SPAN];
        match self.weight {
            Some(weight) => self.sum(weight, &mut indices),
            None => self.refine(&mut indices),
        }
        for run in &mut self.runs {
            // The last indices of a block may be fewer.
            (_, *run) = run.split_at(run.len().min(SPAN));
        }
        indices
    }

    #[inline]
    fn sum(&mut self, weight: [i16; Level::COUNT], indices: &mut [i32; SPAN]) {
        let first = self.first.index();
        for (l, (run, weight)) in self.runs.iter().zip(weight).enumerate().skip(first) {
            add(indices, run, weight);
            if l != first {
                continue;
            }
            if self.quantiser.predicted() {
                self.before = sum_up(indices, self.before);
            } else {
                indices.iter_mut().for_each(|index| *index += self.before);
            }
        }
    }

    /// As [`Column::sum`], level by level: the definition.
    #[cold]
    fn refine(&mut self, indices: &mut [i32; SPAN]) {
        for (i, index) in indices.iter_mut().enumerate() {
            // None are coded at a level that does not refine, or behind the block's end.
            let symbol = |l: Level| self.runs[l.index()].get(i).copied().unwrap_or(0);
            let mut q = i32::from(symbol(self.first)).saturating_add(self.before);
            if self.quantiser.predicted() {
                self.before = q;
            }
            for l in Level::ALL.into_iter().skip(self.first.index() + 1).filter(|&l| l <= self.level) {
                q = self.quantiser.refine(q, symbol(l), l);
            }
            *index = q;
        }
    }
}

/// Adds to `indices` `weight` times each of `symbols`. A function of its own, with lengths that are
/// not known before: then it becomes a loop over vectors.
#[inline(never)]
fn add(indices: &mut [i32], symbols: &[i16], weight: i16) {
    for (index, &symbol) in indices.iter_mut().zip(symbols) {
        *index += i32::from(symbol) * i32::from(weight);
    }
}

/// Makes differences into sums that begin at `before`; returns the last.
fn sum_up(indices: &mut [i32], before: i32) -> i32 {
    indices.iter_mut().fold(before, |sum, index| {
        *index += sum;
        *index
    })
}

/// What one symbol of each level from `first` to `level` weighs, in steps of `level`; `None` if the index of
/// a Gaussian of the longest block could saturate, or a weight does not fit.
fn weights(quantiser: &Quantiser, first: Level, level: Level) -> Option<[i16; Level::COUNT]> {
    // A run of the first level may sum up the symbols of a whole block, and where they begin.
    const MOST: i64 = crate::limits::MAX_BLOCK_LEN as i64 + 1;
    let mut weights = [0i16; Level::COUNT];
    let (mut weight, mut most) = (1i64, 0i64);
    for l in Level::ALL.into_iter().rev().filter(|&l| l <= level && l >= first) {
        weights[l.index()] = i16::try_from(weight).ok()?;
        most += weight * if l == first { MOST } else { 1 };
        weight *= i64::from(quantiser.ratio(l));
    }
    (most <= i64::from(i32::MAX) >> 15).then_some(weights)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::limits::MAX_BLOCK_LEN;
    use proptest::prelude::*;
    extern crate std;
    use std::{vec, vec::Vec};

    fn all(column: &mut Column<'_>, n: usize) -> Vec<i32> {
        let mut indices: Vec<i32> = (0..n.div_ceil(SPAN)).flat_map(|_| column.take()).collect();
        indices.truncate(n);
        indices
    }

    /// Both ways of one component, if sums cannot saturate; else nothing and the slow way.
    fn both(
        symbols: &[Vec<i16>; 4],
        ratio: [u8; 3],
        predicted: bool,
        first: usize,
        level: usize,
        start: i16,
    ) -> (Option<Vec<i32>>, Vec<i32>) {
        let quantiser = Quantiser::new(1.0, ratio, predicted).unwrap();
        let (first, level) = (Level::ALL[first], Level::ALL[level]);
        let column = || {
            let runs = [0, 1, 2, 3].map(|l| symbols[l].as_slice());
            Column::new(runs, quantiser, first, level, start)
        };
        let n = symbols[first.index()].len();
        let mut slow = Column { weight: None, before: start.into(), ..column() };
        let fast = column().weight.map(|_| all(&mut column(), n));
        (fast, all(&mut slow, n))
    }

    proptest! {
        #[test]
        fn sums_are_what_refining_gives(
            n in 1usize..=MAX_BLOCK_LEN, seed: u64, shift in 0u32..16,
            ratio in [1u8..=255, 1u8..=255, 1u8..=9],
            present in [any::<bool>(), any::<bool>(), any::<bool>()],
            predicted: bool, first in 0usize..4, up in 0usize..4, start: i16,
        ) {
            let level = (first + up).min(3);
            let mut state = seed;
            let mut symbol = || {
                state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                (state >> 48) as i16 >> shift
            };
            let symbols = [0, 1, 2, 3].map(|l| {
                let some = l == first || (l > first && l <= level && present[l - 1]);
                if some { (0..n).map(|_| symbol()).collect() } else { vec![] }
            });
            let (fast, slow) = both(&symbols, ratio, predicted, first, level, start);
            if let Some(fast) = fast { prop_assert_eq!(fast, slow); }
        }
    }

    /// The bound is tight: at the largest symbols the sums just fit, and beyond it they are not tried.
    #[test]
    fn sums_are_taken_only_where_nothing_saturates() {
        let run = |symbol| vec![symbol; MAX_BLOCK_LEN];
        for symbol in [i16::MIN, i16::MAX] {
            let symbols = [run(symbol), run(symbol), run(symbol), run(symbol)];
            for (ratio, fits) in
                [([3, 3, 3], true), ([5, 5, 9], true), ([255, 1, 1], false), ([255; 3], false)]
            {
                let (fast, slow) = both(&symbols, ratio, true, 0, 3, symbol);
                assert_eq!(fast.is_some(), fits, "{ratio:?}");
                assert!(fast.is_none_or(|fast| fast == slow), "{ratio:?}");
                // The largest symbol is one smaller than the smallest is large.
                let saturated = slow.contains(&i32::MIN);
                assert_eq!(saturated, !fits && symbol == i16::MIN, "{ratio:?}");
            }
        }
    }
}
