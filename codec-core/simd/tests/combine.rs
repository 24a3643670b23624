//! Every way of adding up repair sums on this machine against the definition of the product: all
//! factors, all lengths of a packet, any place in memory.

use codec_core::internals::repair::{
    Combine, MAX_CODED_BYTES, Sums, Term, cauchy::column, gf256::slow, set_bytes,
};
use proptest::prelude::*;

const LONGEST: usize = 1226;

/// Bytes that repeat with no power of two.
fn noise(len: usize, seed: usize) -> Vec<u8> {
    (0..len).map(|i| ((i + 977 * seed).wrapping_mul(2_654_435_761) >> 13) as u8).collect()
}

/// What a [`Combine`] does, by the definition of the product.
fn defined(rows: &mut [u8], stride: usize, terms: &[Term<'_>]) {
    for term in terms {
        let coded = [&term.length[..], term.content].concat();
        for (row, &factor) in rows.chunks_exact_mut(stride).zip(term.factors) {
            slow::mul_add(row, &coded, factor);
        }
    }
}

/// What every combine of this machine makes of rows that start `odd` bytes into an allocation, between
/// bytes that must stay as they are.
fn check(odd: usize, count: usize, stride: usize, terms: &[Term<'_>]) {
    let before = noise(odd + count * stride + 70, 5);
    let mut wanted = before.clone();
    defined(&mut wanted[odd..odd + count * stride], stride, terms);
    for (name, combine) in codec_simd::combines() {
        let mut found = before.clone();
        combine(&mut found[odd..odd + count * stride], stride, terms);
        assert!(found == wanted, "{name}: {odd}, {count} rows of {stride}, {} terms", terms.len());
    }
}

#[test]
fn the_portable_mix_comes_first_and_the_best_is_one_of_all() {
    let all = codec_simd::combines();
    assert_eq!(all[0].0, "portable");
    let best: Combine = codec_simd::combine();
    let (mut one, mut other) = ([0u8; 90], [0u8; 90]);
    let term = Term { length: [1, 2], content: &[9; 88], factors: &[0x53] };
    best(&mut one, 90, &[term]);
    defined(&mut other, 90, &[term]);
    assert_eq!(one, other);
    // Another factor gives other bytes: the comparison can fail.
    defined(&mut other, 90, &[Term { factors: &[0x54 ^ 0x53], ..term }]);
    assert_ne!(one, other);
}

#[test]
fn all_factors_over_all_bytes() {
    let content: Vec<u8> = (0..=255).chain(0..=255).collect();
    for factor in 0..=255u8 {
        let factors = [factor, factor ^ 1, factor.wrapping_mul(7), 1, factor];
        let term = Term { length: [factor, 0xa5], content: &content, factors: &factors };
        check(0, 5, 520, &[term]);
        check(1, 1, 514, &[Term { content: &content[1..], ..term }; 4]);
    }
}

#[test]
fn all_lengths_at_all_alignments() {
    let content = noise(LONGEST + 64, 1);
    for len in 0..=LONGEST {
        let odd = len % 67;
        let content = &content[odd..odd + len];
        let term = |factors| Term { length: (len as u16).to_le_bytes(), content, factors };
        // XOR, a row longer than the packet; the code, rows as long as it; rows that cut it.
        check(odd, 1, LONGEST + 2, &[term(&[1])]);
        check(odd / 2, 4, len + 2, &[term(column(3).unwrap())]);
        check(odd / 3, 2, (len / 2).max(2), &[term(&column(63).unwrap()[..2])]);
    }
}

#[test]
fn memory_that_holds_no_row_stays_as_it_is() {
    let content = noise(100, 1);
    for (len, stride) in [(0, 80), (79, 80), (80, 0), (80, 1), (80, usize::MAX), (200, 101)] {
        let term = Term { length: [1, 2], content: &content, factors: &[3; 8] };
        for (name, combine) in codec_simd::combines() {
            let mut rows = vec![7u8; len];
            combine(&mut rows, stride, &[term; 5]);
            let passed = if stride == 101 { 101 } else { 0 };
            assert!(rows[passed..].iter().all(|&byte| byte == 7), "{name} {len} {stride}");
            combine(&mut rows, stride, &[]);
        }
    }
}

proptest! {
    #![proptest_config(ProptestConfig { cases: 200, failure_persistence: None, ..ProptestConfig::default() })]

    /// Any number of packets of different lengths and numbers of factors in one call.
    #[test]
    fn packets_together(
        lens in proptest::collection::vec((0usize..=300, 0usize..=9), 0..=18),
        odd in 0usize..64, count in 0usize..=9, stride in 2usize..=310, seed in 0usize..1000,
    ) {
        let contents: Vec<Vec<u8>> = lens.iter().enumerate().map(|(i, l)| noise(l.0, seed + i)).collect();
        let factors: Vec<Vec<u8>> = lens.iter().enumerate().map(|(i, l)| noise(l.1, seed + 99 * i)).collect();
        let terms: Vec<Term<'_>> = contents
            .iter()
            .zip(&factors)
            .map(|(content, factors)| Term { length: (content.len() as u16).to_le_bytes(), content, factors })
            .collect();
        check(odd, count, stride, &terms);
    }

    /// A set by every combine and both ways to add: sums, and what comes back of losses.
    #[test]
    fn sets_are_the_same(
        lens in proptest::collection::vec(1usize..=LONGEST, 2..=40), rows in 1usize..=8, first in 0usize..40,
    ) {
        let packets: Vec<Vec<u8>> = lens.iter().enumerate().map(|(i, &len)| noise(len, i)).collect();
        let longest = lens.iter().copied().max().unwrap_or(1);
        let lost = first % packets.len()..(first % packets.len() + rows).min(packets.len());
        let mut wanted: Option<(Vec<u8>, Vec<u8>)> = None;
        for (_, combine) in codec_simd::combines() {
            let bytes = set_bytes(rows, longest);
            let (mut whole, mut part) = (vec![0u8; bytes], vec![0u8; bytes]);
            let sums = Sums::over(&mut whole, rows, longest);
            let mut sums = sums.ok_or(TestCaseError::fail("a set's memory"))?.with_combine(combine);
            sums.add_all(0, packets.iter().map(Vec::as_slice));
            let rest = Sums::over(&mut part, rows, longest);
            let mut rest = rest.ok_or(TestCaseError::fail("a set's memory"))?.with_combine(combine);
            for (packet, position) in packets.iter().zip(0u32..) {
                if !lost.contains(&(position as usize)) {
                    rest.add(position, packet);
                }
            }
            for row in 0..rows as u32 {
                if let Some((length, content)) = sums.parity(row, longest) {
                    rest.add_parity(row, length, content);
                }
            }
            let solution = rest.solution(packets.len() as u32).ok_or(TestCaseError::fail("a solution"))?;
            let mut out = [0u8; MAX_CODED_BYTES];
            for (index, packet) in packets[lost.clone()].iter().enumerate() {
                prop_assert_eq!(rest.recover(&solution, index, &mut out), Some(&packet[..]));
            }
            let found = (whole, part);
            prop_assert!(wanted.as_ref().is_none_or(|wanted| *wanted == found));
            wanted = Some(found);
        }
    }
}
