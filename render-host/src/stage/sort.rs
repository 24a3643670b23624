//! Stage 2 puts the splats of the whole image in one stable order of depth.
//!
//! An entry is a depth key (high 32 bits) above a Gaussian's index (low 32 bits), so entries are all
//! different and order is total: nearest first, ties by index, on any machine and any number of threads.

use rayon::prelude::*;

use super::project::SKIPPED;

const DIGIT_BITS: u32 = 11;
const DIGITS: usize = 1 << DIGIT_BITS;
/// From this many entries on, a parallel comparison sort beats the serial radix sort.
const PARALLEL_FROM: usize = 1 << 18;

/// The order, and room to make the next one.
#[derive(Debug, Default)]
pub struct Order {
    entries: Vec<u64>,
    scratch: Vec<u64>,
}

impl Order {
    /// Indices of drawn Gaussians, nearest first.
    pub fn indices(&self) -> impl Iterator<Item = u32> + '_ {
        self.entries.iter().map(|&entry| entry as u32)
    }

    /// As `all`, without the indices for which `has` is false.
    pub(crate) fn take(&mut self, all: &Self, has: impl Fn(u32) -> bool) {
        self.entries.clear();
        self.entries.extend(all.entries.iter().filter(|&&entry| has(entry as u32)));
    }

    /// Raw entries, nearest first; the low 32 bits are the index.
    pub fn entries(&self) -> &[u64] {
        &self.entries
    }
}

/// Orders all indices whose key is not [`SKIPPED`] by (key, index).
pub fn sort(keys: &[u32], parallel: bool, out: &mut Order) {
    let Order { entries, scratch } = out;
    entries.clear();
    entries.extend(
        (0u64..)
            .zip(keys)
            .filter(|&(_, &key)| key != SKIPPED)
            .map(|(index, &key)| u64::from(key) << 32 | index),
    );
    if parallel && entries.len() >= PARALLEL_FROM {
        entries.par_sort_unstable();
    } else {
        radix(entries, scratch);
    }
}

/// Least significant digit first over the high 32 bits; entries come in order of index, passes are stable.
fn radix(entries: &mut Vec<u64>, scratch: &mut Vec<u64>) {
    scratch.clear();
    scratch.resize(entries.len(), 0);
    for shift in [32, 32 + DIGIT_BITS, 32 + 2 * DIGIT_BITS] {
        let digit = |entry: u64| (entry >> shift) as usize & (DIGITS - 1);
        let mut starts = [0usize; DIGITS];
        entries.iter().for_each(|&entry| starts[digit(entry)] += 1);
        if starts.contains(&entries.len()) {
            continue; // one digit for all: the pass would copy
        }
        let mut sum = 0;
        for start in &mut starts {
            sum += std::mem::replace(start, sum);
        }
        for &entry in entries.iter() {
            let slot = &mut starts[digit(entry)];
            scratch[*slot] = entry;
            *slot += 1;
        }
        std::mem::swap(entries, scratch);
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    fn indices(keys: &[u32], parallel: bool) -> Vec<u32> {
        let mut order = Order::default();
        sort(keys, parallel, &mut order);
        order.indices().collect()
    }

    #[test]
    fn ties_go_by_index_and_skipped_ones_are_left_out() {
        assert_eq!(indices(&[7, SKIPPED, 7, 3, 7], false), [3, 0, 2, 4]);
        assert!(indices(&[], false).is_empty() && indices(&[SKIPPED], true).is_empty());
    }

    #[test]
    fn the_parallel_path_gives_the_same_order() {
        let keys: Vec<u32> =
            (0..PARALLEL_FROM as u32 + 9).map(|i| i.wrapping_mul(2_654_435_761) >> 9).collect();
        assert_eq!(indices(&keys, true), indices(&keys, false));
    }

    proptest! {
        #[test]
        fn radix_equals_a_stable_sort(
            keys in proptest::collection::vec(0u32..=u32::MAX, 0..300), bits in 1u32..32,
        ) {
            let keys: Vec<u32> = keys.iter().map(|k| k >> bits).collect();
            let mut expected: Vec<u32> = (0..keys.len() as u32).collect();
            expected.sort_by_key(|&i| keys[i as usize]);
            prop_assert_eq!(indices(&keys, false), expected);
        }
    }
}
