//! Sorts worlds into classes that hold the same of some groups.

/// Splits `worlds` into classes that agree on every one of `columns`, each a set of worlds (a bit per world).
///
/// Every class is a non-empty set; together they are `worlds`.
pub(super) fn split(worlds: u128, columns: impl Iterator<Item = u128>, out: &mut Vec<u128>) {
    out.clear();
    if worlds != 0 {
        out.push(worlds);
    }
    for column in columns {
        for i in 0..out.len() {
            let (with, without) = (out[i] & column, out[i] & !column);
            if with != 0 && without != 0 {
                out[i] = with;
                out.push(without);
            }
        }
    }
}

/// Positions of the set bits, lowest first.
pub(super) fn members(mut set: u128) -> impl Iterator<Item = usize> {
    std::iter::from_fn(move || {
        let bit = set.trailing_zeros();
        set &= set.wrapping_sub(1);
        (bit < u128::BITS).then_some(bit as usize)
    })
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn classes_are_the_distinct_keys(
            worlds in any::<u128>(), columns in proptest::collection::vec(any::<u128>(), 0..9),
        ) {
            let mut classes = Vec::new();
            split(worlds, columns.iter().copied(), &mut classes);
            let key = |world: usize| columns.iter().map(|c| c >> world & 1).collect::<Vec<_>>();
            let mut keys = Vec::new();
            for &class in &classes {
                let first = members(class).next().unwrap();
                prop_assert!(members(class).all(|w| key(w) == key(first)));
                keys.push(key(first));
            }
            keys.sort();
            keys.dedup();
            prop_assert_eq!(keys.len(), classes.len(), "two classes with one key");
            prop_assert_eq!(classes.iter().fold(0, |a, b| a ^ b), worlds);
        }
    }

    #[test]
    fn no_worlds_no_classes() {
        let mut classes = vec![1];
        split(0, [1u128].into_iter(), &mut classes);
        assert!(classes.is_empty() && members(0).next().is_none());
        assert_eq!(members(u128::MAX).count(), 128);
    }
}
