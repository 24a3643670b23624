//! The code against itself (encode, lose, recover) and against sums by definition.

extern crate std;

use std::{vec, vec::Vec};

use proptest::prelude::*;

use super::{gf256::slow, *};

const LONGEST: usize = if cfg!(miri) { 24 } else { 300 };
const CASES: u32 = if cfg!(miri) { 3 } else { 200 };

/// Length and content of every row over `packets`.
fn parity(packets: &[Vec<u8>], rows: usize) -> Vec<(u16, Vec<u8>)> {
    let longest = packets.iter().map(Vec::len).max().unwrap();
    let mut bytes = vec![0u8; set_bytes(rows, longest)];
    let mut sums = Sums::over(&mut bytes, rows, longest).unwrap();
    packets.iter().zip(0u32..).for_each(|(p, i)| sums.add(i, p));
    (0..rows as u32).map(|row| sums.parity(row, longest).map(|(l, c)| (l, c.to_vec())).unwrap()).collect()
}

#[test]
fn memory_of_another_size_is_no_set() {
    let mut bytes = vec![0u8; set_bytes(2, 50)];
    assert!(Sums::over(&mut bytes, 2, 50).is_some());
    for (rows, longest) in [(2, 49), (2, 51), (1, 50), (3, 50), (0, 50), (9, 50), (2, 0), (2, 1281)] {
        assert!(Sums::over(&mut bytes, rows, longest).is_none());
    }
    assert!(Sums::over(&mut [], 1, 1).is_none());
}

#[test]
fn lies_about_lengths_give_nothing() {
    let packets = [vec![1u8; 10], vec![2u8; 20]];
    let rows = parity(&packets, 1);
    for lie in [21u16, 0xffff, 0] {
        let mut bytes = vec![0u8; set_bytes(1, 20)];
        let mut sums = Sums::over(&mut bytes, 1, 20).unwrap();
        sums.add(0, &packets[0]);
        sums.add(1, &[7; 21]);
        sums.add(64, &packets[1]);
        sums.add_parity(1, 0, &[1]);
        sums.add_parity(0, 0, &[7; 21]);
        assert!(sums.solution(2).is_none(), "none of these counts");
        sums.add_parity(0, lie ^ 10, &rows[0].1);
        let solution = sums.solution(2).unwrap();
        let mut out = [0u8; MAX_CODED_BYTES];
        assert_eq!(sums.recover(&solution, 0, &mut out), None, "{lie}");
        assert_eq!(sums.recover(&solution, 1, &mut out), None, "there is no second one missing");
    }
}

/// What the definition of the product says [`combine`] does.
fn defined(rows: &mut [u8], stride: usize, terms: &[Term<'_>]) {
    for term in terms {
        let coded = [&term.length[..], term.content].concat();
        for (row, &factor) in rows.chunks_exact_mut(stride).zip(term.factors) {
            slow::mul_add(row, &coded, factor);
        }
    }
}

#[test]
fn terms_are_added_as_far_as_rows_reach() {
    let content: Vec<u8> = (1..=40).collect();
    let factors = [1u8, 0, 7, 0xd3];
    for (rows, stride) in [(0, 9), (1, 2), (4, 3), (3, 42), (5, 41), (4, 50)] {
        for most in 0..=4 {
            let terms = [(40, most), (0, 4), (17, 1)].map(|(len, most)| Term {
                length: [len as u8, 0x80],
                content: &content[..len],
                factors: &factors[..most],
            });
            let (mut found, mut wanted) = (vec![0x33u8; rows * stride], vec![0x33u8; rows * stride]);
            combine(&mut found, stride, &terms);
            defined(&mut wanted, stride, &terms);
            assert_eq!(found, wanted, "{rows} rows of {stride}, {most} factors");
        }
    }
    let mut few = [5u8; 7];
    for stride in [0, 1, 8, usize::MAX] {
        combine(&mut few, stride, &[Term { length: [1; 2], content: &content, factors: &factors }]);
        assert_eq!(few, [5; 7], "no row of {stride}");
    }
}

#[test]
fn the_callers_mix_is_used() {
    let nothing: Combine = |_, _, _| {};
    let mut bytes = vec![0u8; set_bytes(1, 9)];
    let mut sums = Sums::over(&mut bytes, 1, 9).unwrap().with_combine(nothing);
    sums.add(0, &[1; 9]);
    assert_eq!(sums.parity(0, 9), Some((0, &[0; 9][..])));
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: CASES,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// Any loss of at most as many packets as rows is repaired, one more is not; order, repeats
    /// and which rows arrive do not matter.
    #[test]
    fn as_many_losses_as_rows_are_repaired(
        packets in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 1..LONGEST), 2..=64),
        rows in 1usize..=8, lost in any::<u64>(), order in any::<u64>(), dropped in any::<u8>(),
    ) {
        let n = packets.len();
        let parity = parity(&packets, rows);
        let longest = packets.iter().map(Vec::len).max().unwrap();
        // Row 0 is the plain XOR.
        let mut xor = vec![0u8; longest];
        packets.iter().for_each(|p| xor.iter_mut().zip(p).for_each(|(x, b)| *x ^= b));
        prop_assert_eq!(&parity[0].1, &xor);
        prop_assert_eq!(parity[0].0, packets.iter().fold(0, |sum, p| sum ^ p.len() as u16));

        let kept_rows: Vec<u32> = (0..rows as u32).filter(|r| dropped >> r & 1 == 0).collect();
        let mut missing: Vec<usize> = Vec::new();
        for k in 0..kept_rows.len() as u64 {
            let candidate = (lost.rotate_left(8 * k as u32) % n as u64) as usize;
            if !missing.contains(&candidate) { missing.push(candidate); }
        }
        missing.sort_unstable();
        let mut bytes = vec![0u8; set_bytes(rows, longest)];
        let mut sums = Sums::over(&mut bytes, rows, longest).unwrap();
        let mut waiting: Vec<usize> = (0..n + kept_rows.len()).filter(|i| !missing.contains(i)).collect();
        let mut seed = order;
        while !waiting.is_empty() {
            seed = seed.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
            let at = (seed >> 33) as usize % waiting.len();
            let i = if seed >> 32 & 7 == 0 { waiting[at] } else { waiting.swap_remove(at) };
            match i.checked_sub(n) {
                None => sums.add(i as u32, &packets[i]),
                Some(r) => {
                    let (length, content) = &parity[kept_rows[r] as usize];
                    sums.add_parity(kept_rows[r], *length, content);
                }
            }
        }
        let Some(solution) = sums.solution(n as u32) else {
            prop_assert!(missing.is_empty());
            return Ok(());
        };
        let positions: Vec<usize> = solution.positions().map(|p| p as usize).collect();
        prop_assert_eq!(&positions, &missing);
        let mut out = [0u8; MAX_CODED_BYTES];
        for (index, &position) in missing.iter().enumerate() {
            prop_assert_eq!(sums.recover(&solution, index, &mut out), Some(&packets[position][..]));
            // The rest of the solution holds while members come in.
            sums.add(position as u32, &packets[position]);
        }
        prop_assert!(sums.solution(n as u32).is_none());
    }

    /// Several members at a time give what one after the other gives, those that change nothing
    /// included.
    #[test]
    fn together_or_one_by_one(
        packets in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 0..24), 0..=70),
        first in prop_oneof![0u32..70, Just(u32::MAX - 3)], again in 0u32..70,
    ) {
        let (mut one, mut other) = (vec![0u8; set_bytes(3, 20)], vec![0u8; set_bytes(3, 20)]);
        let mut sums = Sums::over(&mut one, 3, 20).unwrap();
        for (packet, position) in packets.iter().zip(first..=u32::MAX).chain(packets.iter().zip(again..)) {
            sums.add(position, packet);
        }
        let mut sums = Sums::over(&mut other, 3, 20).unwrap();
        sums.add_all(first, packets.iter().map(Vec::as_slice));
        sums.add_all(again, packets.iter().map(Vec::as_slice));
        prop_assert_eq!(one, other);
    }

    /// Rows are what the definition says.
    #[test]
    fn rows_are_sums_by_definition(
        packets in proptest::collection::vec(proptest::collection::vec(any::<u8>(), 1..20), 2..=64),
    ) {
        for (row, (length, content)) in (0u32..).zip(parity(&packets, 8)) {
            let mut sum = [0u8; 22];
            for (position, packet) in (0u32..).zip(&packets) {
                let coded = [&(packet.len() as u16).to_le_bytes()[..], packet].concat();
                // c · y = y with c = y / (y - row): found by trial, not by inverse.
                let y = (8 + position) as u8;
                let c = (0..=255u8).find(|&c| slow::mul(c, y ^ row as u8) == y).unwrap();
                slow::mul_add(&mut sum, &coded, c);
            }
            prop_assert_eq!(&sum[..2], &length.to_le_bytes());
            prop_assert_eq!(&sum[2..2 + content.len()], &content[..]);
        }
    }

    /// One loss too many, and nothing comes out.
    #[test]
    fn one_loss_too_many_is_not_repaired(rows in 1usize..=8, n in 9u32..=64, seed in any::<u32>()) {
        let packets: Vec<Vec<u8>> = (0..n).map(|i| vec![i as u8 ^ seed as u8; 5]).collect();
        let mut bytes = vec![0u8; set_bytes(rows, 5)];
        let mut sums = Sums::over(&mut bytes, rows, 5).unwrap();
        for (row, (length, content)) in (0u32..).zip(parity(&packets, rows)) {
            sums.add_parity(row, length, &content);
        }
        let first = seed % (n - rows as u32);
        let there = (0..n).filter(|i| !(first..=first + rows as u32).contains(i));
        there.for_each(|i| sums.add(i, &packets[i as usize]));
        prop_assert!(sums.solution(n).is_none());
        sums.add(first, &packets[first as usize]);
        prop_assert!(sums.solution(n).is_some());
    }
}
