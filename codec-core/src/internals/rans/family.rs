//! The built-in family of distributions: one byte names a table, so that a manifest need not list
//! frequencies.
//!
//! Integer arithmetic only, so that every target builds the same tables. Three kinds:
//!
//! - 0..=53, two-sided geometric (a quantised Laplace): mean magnitude 2^(i/3 − 6), a third of an
//!   octave apart; from 16 on, low bits are raw, so that it is 8 to 13 tokens.
//! - 64..=117, the same with heavy tails: three quarters of scale i − 64, a quarter of eight times
//!   that scale.
//! - 128..=172, three values −1, 0, 1 with probabilities in eighths: what a refinement by thirds is.

use super::scale::{ESCAPE, SCALE};

/// Number of scales of the geometric kinds.
pub const SCALES: u8 = 54;
/// First index of the heavy-tailed kind.
pub const HEAVY: u8 = 64;
/// First index of the three-valued kind.
pub const THREE: u8 = 128;
/// Number of three-valued tables: compositions of eighths into three parts.
pub const THREES: u8 = 45;
const EIGHTHS: u32 = 8;

/// Ratio of neighbouring probabilities of scale i in 1/65536; scales from 30 on repeat the last
/// three with one more raw bit every third.
pub const RATIOS: [u32; 33] = [
    512, 645, 813, 1_024, 1_290, 1_624, 2_046, 2_576, 3_243, 4_080, 5_129, 6_439, 8_068, 10_077, 12_529,
    15_471, 18_922, 22_847, 27_146, 31_654, 36_171, 40_503, 44_500, 48_068, 51_169, 53_810, 56_022, 57_854,
    59_356, 60_578, 57_835, 59_346, 60_573,
];

/// All indices that name a table, ascending.
pub fn indices() -> impl Iterator<Item = u8> {
    (0..SCALES).chain(HEAVY..HEAVY + SCALES).chain(THREE..THREE + THREES)
}

/// Frequencies of all tokens, which sum to [`SCALE`], and raw bits per value.
pub(super) struct Frequencies {
    pub of: [u16; 256],
    pub raw_bits: u8,
}

/// The frequencies of the table that `index` names.
pub(super) fn frequencies(index: u8) -> Option<Frequencies> {
    let (weights, raw_bits) = match index {
        0..SCALES => geometric(index, None)?,
        HEAVY..THREE if index - HEAVY < SCALES => {
            let scale = index - HEAVY;
            geometric(scale, Some((scale + 9).min(SCALES - 1)))?
        }
        THREE.. if index - THREE < THREES => (three(index - THREE), 0),
        _ => return None,
    };
    Some(Frequencies { of: normalised(&weights)?, raw_bits })
}

/// Raw bits and ratio of `scale`, if there is such a one.
fn scale_of(scale: u8) -> Option<(u8, u64)> {
    let (raw_bits, entry) = match scale.checked_sub(30) {
        Some(beyond) => (beyond / 3 + 1, 30 + beyond % 3),
        None => (0, scale),
    };
    Some((raw_bits, u64::from(*RATIOS.get(usize::from(entry))?)))
}

/// Weights of all tokens, 2^32 at most: geometric of `scale`, three quarters of it if there is a
/// `tail` of another scale.
fn geometric(scale: u8, tail: Option<u8>) -> Option<([u64; 256], u8)> {
    let (raw_bits, ratio) = scale_of(scale)?;
    let mut weights = [0u64; 256];
    let share = if tail.is_some() { 3 } else { 4 };
    add_geometric(&mut weights, ratio, raw_bits > 0, share)?;
    if let Some(tail) = tail {
        let (tail_bits, mut tail_ratio) = scale_of(tail)?;
        // Tokens of the narrow part hold fewer raw bits than the tail's own would.
        for _ in raw_bits..tail_bits {
            // The square root of a ratio near one is halfway to one.
            tail_ratio = (65_536 + tail_ratio) / 2;
        }
        add_geometric(&mut weights, tail_ratio, raw_bits > 0, 1)?;
    }
    Some((weights, raw_bits))
}

/// Adds a geometric of total weight `share` · 2^30. With raw bits, a token holds a whole range of
/// values and −1 mirrors 0.
#[inline(never)]
fn add_geometric(weights: &mut [u64; 256], ratio: u64, ranges: bool, share: u64) -> Option<()> {
    // Total of the two sides: 2 / (1 − ratio) with ranges, else that less the zero counted twice.
    let one = 65_536u64;
    let sides = if ranges { 2 * one } else { one + ratio };
    let mut weight = ((share << 30) * (one - ratio)).checked_div(sides)?;
    let (low, high) = weights.split_at_mut(128);
    // Outwards from the middle: 128 and 127 with ranges, else 128 alone, then 129 and 127.
    let mut left = low.iter_mut().rev();
    for (distance, right) in high.iter_mut().enumerate() {
        *right += weight;
        if (ranges || distance > 0)
            && let Some(left) = left.next()
        {
            *left += weight;
        }
        weight = weight * ratio / one;
    }
    // The escape is no value.
    low[usize::from(ESCAPE)] = 0;
    Some(())
}

/// Weights of composition `index` of [`EIGHTHS`] into parts for −1, 0 and 1, in lexical order.
fn three(index: u8) -> [u64; 256] {
    let mut weights = [0u64; 256];
    let mut left = u32::from(index);
    let mut low = 0;
    while left > EIGHTHS - low {
        left -= EIGHTHS - low + 1;
        low += 1;
    }
    let parts = [low, left, EIGHTHS - low - left];
    for (target, part) in weights.iter_mut().skip(127).zip(parts) {
        // An impossible value keeps a little, so that one exception does not cost an escape.
        *target = (u64::from(part) << 29) + (1 << 24);
    }
    weights
}

/// The frequencies nearest to `weights`: shares rounded down, at least 1 where a share is over an eighth,
/// tokens rarer than that escaped, what is left over to the likeliest token. `None` of no weights at all.
fn normalised(weights: &[u64; 256]) -> Option<[u16; 256]> {
    let total: u64 = weights.iter().sum();
    let mut frequency = [0u16; 256];
    let mut left = SCALE as u16 - 1;
    for (f, &w) in frequency.iter_mut().zip(weights) {
        let eighths = (w * 8 * u64::from(SCALE - 24)).checked_div(total)?;
        *f = if eighths >= 1 { (eighths / 8).max(1) as u16 } else { 0 };
        left = left.checked_sub(*f)?;
    }
    let tokens = (0..=255u8).zip(weights).skip(usize::from(ESCAPE) + 1);
    // Of equally likely ones that nearest to zero.
    let (likeliest, _) = tokens.max_by_key(|&(token, &weight)| (weight, 255 - token.abs_diff(128)))?;
    frequency[usize::from(likeliest)] += left;
    frequency[usize::from(ESCAPE)] = 1;
    Some(frequency)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::rans::table::Table;
    extern crate std;
    use std::vec::Vec;

    fn table(index: u8) -> Option<Table> {
        Table::named(index).ok()
    }

    /// Bits per value of a Laplace of mean magnitude `mean`, quantised, under `table`, and its entropy.
    fn cost(table: &Table, mean: f64) -> (f64, f64) {
        let ratio = ((1.0 + mean * mean).sqrt() - 1.0) / mean;
        let (mut bits, mut entropy) = (0.0, 0.0);
        // Wider than any scale here; the tails weigh nothing.
        let most = if cfg!(miri) { 300 } else { 30_000i32 };
        for value in -most..=most {
            let p = (1.0 - ratio) / (1.0 + ratio) * ratio.powi(value.abs());
            if p < 1e-15 {
                continue;
            }
            let token = table.code(value as i16);
            let escape = if token == ESCAPE { 16.0 } else { 0.0 };
            let word = (f64::from(SCALE) / f64::from(table.frequency(token))).log2();
            bits += p * (word + escape + f64::from(table.raw_bits()));
            entropy -= p * p.log2();
        }
        (bits, entropy)
    }

    #[test]
    fn every_index_is_a_table_and_no_other_byte_is() {
        let named: Vec<u8> = indices().collect();
        // Interpreted, where the kinds begin and end.
        let ends = [0, SCALES, HEAVY, HEAVY + SCALES - 1, THREE, THREE + THREES];
        let near = |index: &u8| !cfg!(miri) || ends.contains(index);
        for index in (0..=255u8).filter(near) {
            assert_eq!(table(index).is_some(), named.contains(&index), "{index}");
        }
        assert_eq!(named.len(), 2 * 54 + 45);
    }

    #[test]
    fn each_scale_codes_its_own_distribution_within_a_percent() {
        // Interpreted, two of them whose values are few.
        let scales = if cfg!(miri) { (6..13).step_by(6) } else { (3..SCALES - 6).step_by(1) };
        for scale in scales {
            let mean = ((f64::from(scale)) / 3.0 - 6.0).exp2();
            let (bits, entropy) = cost(&table(scale).unwrap(), mean);
            let loss = bits - entropy;
            assert!(loss < 0.012 * entropy + 0.02, "scale {scale}: {bits} against {entropy}");
            // Any table six scales off costs more.
            let other = table(if scale < 20 { scale + 6 } else { scale - 6 }).unwrap();
            assert!(cost(&other, mean).0 > bits, "scale {scale}");
        }
    }

    #[test]
    fn heavy_tails_pay_where_there_are_some() {
        let (light, heavy) = (table(20).unwrap(), table(HEAVY + 20).unwrap());
        let bits = |t: &Table, v: i16| (f64::from(SCALE) / f64::from(t.frequency(t.code(v)).max(1))).log2();
        assert!(bits(&heavy, 20) < bits(&light, 20) && bits(&heavy, 0) > bits(&light, 0));
        assert_eq!(light.code(100), ESCAPE);
    }

    #[test]
    fn three_values_have_their_eighths() {
        // Interpreted, only the compositions near the even one are looked at.
        let indices = if cfg!(miri) { THREE + 18..THREE + 24 } else { THREE..THREE + THREES };
        let mut tables = indices.filter_map(table);
        let flat = tables.find(|t| [127u8, 128, 129].iter().all(|&v| t.frequency(v) > 500));
        assert!(flat.is_some());
        let sure = table(THREE + THREES - 1).unwrap();
        assert!(sure.frequency(127) > 1900 && sure.frequency(129) >= 1, "{}", sure.frequency(127));
        let other = table(THREE).unwrap();
        assert!(other.frequency(129) > 1900);
    }
}
