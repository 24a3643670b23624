//! Composes the pixels of one block under many sets of groups: the kernel of all fast modes.
//!
//! A *lane* of work is a set of groups: a class of worlds, or one with a group toggled. Its picture is a
//! walk over the block's segments, each the operator of what the lane holds of it; the sixteen pixels of the
//! block go side by side. There is no division and no early stop.

mod composite;

use pulp::Simd;

use super::operator::{FLUSH_EVERY, Operator, OperatorPart, lanes, lanes_mut, parts};
use crate::stage::{TILE, blend};

/// A place of a hash table that holds nothing.
const VACANT: u32 = u32::MAX;

/// What the pixels of a block are compared with.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Wanted {
    /// r, g, b of the reference image.
    pub rgb: [blend::Lanes; 3],
    /// 1 inside the image, 0 outside.
    pub inside: blend::Lanes,
}

/// Which groups each lane holds, and what the kernel found.
#[derive(Debug, Default)]
pub(super) struct Lanes {
    /// `words` words per lane, a bit per group of the tile.
    bits: Vec<u64>,
    words: usize,
    count: usize,
    /// Squared errors so far, pixel by pixel of a block.
    sums: Vec<Row>,
    /// Squared errors of the kinds of one block.
    kinds: Vec<Row>,
    /// Room for finding kinds: a hash table of them.
    table: Vec<u32>,
    /// Room for a lane's operators.
    walk: Vec<u32>,
}

#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
struct Row(blend::Lanes);

/// Lanes that are alike in a block: those that hold the same of its groups.
#[derive(Debug, Default)]
pub(super) struct Kinds {
    /// The block's groups, a bit each.
    set: Vec<u64>,
    /// Kind of each lane.
    pub of: Vec<u32>,
    /// A lane of each kind.
    pub first: Vec<u32>,
    /// Groups that a segment may have; 0 until it is chosen.
    pub limit: usize,
}

impl Lanes {
    /// Makes `count` empty lanes over a tile of `groups` groups.
    pub(super) fn reset(&mut self, count: usize, groups: usize) {
        self.count = count;
        self.words = groups.div_ceil(64).max(1);
        self.bits.clear();
        self.bits.resize(self.words * count, 0);
        self.sums.clear();
        self.sums.resize(count, Row([0.0; TILE]));
    }

    /// Number of lanes.
    pub(super) fn count(&self) -> usize {
        self.count
    }

    /// Says for every lane whether it holds group `local`.
    #[inline(always)]
    pub(super) fn row(&mut self, local: u32, mut holds: impl FnMut(usize) -> bool) {
        let (word, bit) = (local as usize / 64, local % 64);
        for (lane, words) in self.bits.chunks_exact_mut(self.words).enumerate() {
            words[word] |= u64::from(holds(lane)) << bit;
        }
    }

    /// Whether `lane` holds group `local`.
    #[inline(always)]
    pub(super) fn has(&self, lane: usize, local: u32) -> bool {
        self.bits[lane * self.words + local as usize / 64] >> (local % 64) & 1 == 1
    }

    /// Finds the kinds of lanes in a block that meets the groups of `set`.
    pub(super) fn kinds(&mut self, set: &[u64], out: &mut Kinds) {
        let Kinds { set: own, of, first, limit } = out;
        *limit = 0;
        own.clear();
        own.extend_from_slice(set);
        of.clear();
        first.clear();
        let Self { bits, words, table, count, .. } = self;
        let (bits, words) = (&bits[..*words * *count], *words);
        let size = (2 * *count).next_power_of_two();
        table.clear();
        table.resize(size, VACANT);
        for (lane, own) in (0u32..).zip(bits.chunks_exact(words)) {
            let mut hash = 0u64;
            for (bits, set) in own.iter().zip(set) {
                hash = (hash ^ (bits & set)).wrapping_mul(0x9e37_79b9_7f4a_7c15).rotate_left(29);
            }
            let alike = |other: u32| {
                let other = &bits[other as usize * words..][..words];
                let mut apart = 0;
                for ((a, b), set) in own.iter().zip(other).zip(set) {
                    apart |= (a ^ b) & set;
                }
                apart == 0
            };
            let mut at = hash as usize % size;
            // Half of the table is empty, so every search ends.
            while table[at] != VACANT && !alike(first[table[at] as usize]) {
                at = (at + 1) % size;
            }
            if table[at] == VACANT {
                table[at] = first.len() as u32;
                first.push(lane);
            }
            of.push(table[at]);
        }
    }

    /// Where the squared errors of one kind go.
    #[inline(always)]
    pub(super) fn squares(&mut self, kind: usize) -> &mut blend::Lanes {
        if self.kinds.len() <= kind {
            self.kinds.resize(kind + 1, Row([0.0; TILE]));
        }
        &mut self.kinds[kind].0
    }

    /// Adds the squared errors of each kind to its lanes.
    #[inline(always)]
    pub(super) fn add<S: Simd>(&mut self, simd: S, kinds: &Kinds) {
        for (sum, &kind) in self.sums.iter_mut().zip(&kinds.of) {
            let squares = &self.kinds[kind as usize].0;
            for part in 0..parts::<S>() {
                let sum = lanes_mut::<S>(&mut sum.0, part);
                *sum = simd.add_f32s(*sum, lanes::<S>(squares, part));
            }
        }
    }

    /// Squared error of the tile in every lane.
    pub(super) fn errors(&self) -> Vec<f64> {
        self.sums.iter().map(|row| total(&row.0)).collect()
    }
}

/// The operators of `steps` as one.
#[inline(always)]
pub(super) fn walk<S: Simd>(simd: S, operators: &[Operator], steps: &[u32], part: usize) -> OperatorPart<S> {
    let mut now = OperatorPart::identity(simd);
    for steps in steps.chunks(FLUSH_EVERY) {
        for &step in steps {
            now = now.then(simd, OperatorPart::load(&operators[step as usize], part));
        }
        now = now.flushed(simd);
    }
    now
}

/// Channel `c` over the background, less the reference; 0 outside the image.
#[inline(always)]
pub(super) fn difference<S: Simd>(
    simd: S,
    now: &OperatorPart<S>,
    wanted: &Wanted,
    background: [f32; 3],
    c: usize,
    part: usize,
) -> S::f32s {
    let shown = simd.mul_add_e_f32s(now.t, simd.splat_f32s(background[c]), now.rgb[c]);
    let d = simd.sub_f32s(shown, lanes::<S>(&wanted.rgb[c], part));
    simd.mul_f32s(d, lanes::<S>(&wanted.inside, part))
}

/// Sum of all lanes in a fixed order.
pub(super) fn total(row: &blend::Lanes) -> f64 {
    row.iter().map(|&v| f64::from(v)).sum()
}

impl Kinds {
    /// Whether these are the kinds for `set`.
    pub(super) fn are_for(&self, set: &[u64]) -> bool {
        self.set == set
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn kinds_are_lanes_that_hold_the_same_of_a_set(
            bits in proptest::collection::vec(any::<u128>(), 0..60),
            set in any::<u128>(), some in any::<u128>(),
        ) {
            // Few groups in the set, so that lanes are alike.
            let set = set & some & (some >> 64) & 0x11;
            let mut lanes = Lanes::default();
            lanes.reset(bits.len(), 128);
            (0..128).for_each(|l| lanes.row(l, |lane| bits[lane] >> l & 1 == 1));
            let mut kinds = Kinds::default();
            lanes.kinds(&[set as u64, (set >> 64) as u64], &mut kinds);
            for (lane, &kind) in kinds.of.iter().enumerate() {
                let first = kinds.first[kind as usize] as usize;
                prop_assert_eq!(bits[lane] & set, bits[first] & set);
                prop_assert!(first <= lane);
            }
            let mut keys: Vec<_> = kinds.first.iter().map(|&lane| bits[lane as usize] & set).collect();
            keys.sort_unstable();
            keys.dedup();
            prop_assert_eq!(keys.len(), kinds.first.len(), "two kinds with one set of groups");
        }
    }
}
