//! Arithmetic of bytes in GF(2⁸) modulo x⁸ + x⁴ + x³ + x² + 1.
//!
//! No tables: a product by a fixed factor is the sum of the factor times each power of two that the
//! byte has, which runs over as many bytes at once as a register holds. [`slow`] is the definition.

/// The modulus without its top bit.
const REDUCTION: u8 = 0x1d;

/// `a` times x.
const fn double(a: u8) -> u8 {
    (a << 1) ^ (if a & 0x80 == 0 { 0 } else { REDUCTION })
}

/// `a · 2^k` for k = 0..8.
const fn doublings(a: u8) -> [u8; 8] {
    let mut powers = [a; 8];
    let mut k = 1;
    while k < 8 {
        powers[k] = double(powers[k - 1]);
        k += 1;
    }
    powers
}

/// The product.
pub const fn mul(a: u8, b: u8) -> u8 {
    let powers = doublings(a);
    let (mut sum, mut k) = (0u8, 0);
    while k < 8 {
        sum ^= powers[k] & 0u8.wrapping_sub(b >> k & 1);
        k += 1;
    }
    sum
}

/// The inverse, a²⁵⁴; 0 has none and gives 0.
pub const fn inverse(a: u8) -> u8 {
    let (mut power, mut product, mut k) = (a, 1u8, 1);
    while k < 8 {
        power = mul(power, power);
        product = mul(product, power);
        k += 1;
    }
    product
}

/// Adds `factor` times each of `bytes` to `target`, as far as both reach.
pub fn mul_add(target: &mut [u8], bytes: &[u8], factor: u8) {
    if factor == 1 {
        target.iter_mut().zip(bytes).for_each(|(t, b)| *t ^= b);
    } else if cfg!(any(target_feature = "sse2", target_feature = "neon", target_feature = "simd128")) {
        lanes(target, bytes, factor);
    } else {
        words(target, bytes, factor);
    }
}

/// One byte per lane: the compiler fills a vector register with them.
fn lanes(target: &mut [u8], bytes: &[u8], factor: u8) {
    let powers = doublings(factor);
    for (target, byte) in target.iter_mut().zip(bytes) {
        let mut sum = 0u8;
        for (k, power) in powers.iter().enumerate() {
            sum ^= power & 0u8.wrapping_sub(byte >> k & 1);
        }
        *target ^= sum;
    }
}

/// Four bytes per word, for machines without vectors: bit k of every byte times a power is a
/// product without carries between bytes.
fn words(target: &mut [u8], bytes: &[u8], factor: u8) {
    const ONES: u32 = 0x0101_0101;
    let powers = doublings(factor);
    let len = target.len().min(bytes.len());
    let (target, target_rest) = target.split_at_mut(len).0.as_chunks_mut::<4>();
    let (bytes, bytes_rest) = bytes.split_at(len).0.as_chunks::<4>();
    for (target, bytes) in target.iter_mut().zip(bytes) {
        let value = u32::from_le_bytes(*bytes);
        let mut sum = u32::from_le_bytes(*target);
        for (k, &power) in powers.iter().enumerate() {
            sum ^= (value >> k & ONES).wrapping_mul(u32::from(power));
        }
        *target = sum.to_le_bytes();
    }
    lanes(target_rest, bytes_rest, factor);
}

/// The definition: polynomials over bits, multiplied without carries, then divided by the modulus.
pub mod slow {
    /// The product.
    pub const fn mul(a: u8, b: u8) -> u8 {
        let (mut product, mut k) = (0u16, 0);
        while k < 8 {
            if b >> k & 1 == 1 {
                product ^= (a as u16) << k;
            }
            k += 1;
        }
        let mut k = 15;
        while k >= 8 {
            if product >> k & 1 == 1 {
                product ^= 0x11d << (k - 8);
            }
            k -= 1;
        }
        product as u8
    }

    /// Adds `factor` times each of `bytes` to `target`, as far as both reach.
    pub fn mul_add(target: &mut [u8], bytes: &[u8], factor: u8) {
        for (target, &byte) in target.iter_mut().zip(bytes) {
            *target ^= mul(byte, factor);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    extern crate std;
    use std::vec::Vec;

    #[test]
    fn products_are_those_of_the_definition() {
        for a in 0..=255u8 {
            for b in (0..=255u8).step_by(if cfg!(miri) { 37 } else { 1 }) {
                assert_eq!(mul(a, b), slow::mul(a, b), "{a} * {b}");
            }
        }
        // Another modulus gives other products: the comparison can fail.
        assert_ne!(slow::mul(0x80, 2), 0x1b);
    }

    #[test]
    fn every_byte_but_zero_has_its_inverse() {
        assert_eq!(inverse(0), 0);
        for a in 1..=255u8 {
            assert_eq!(slow::mul(a, inverse(a)), 1, "{a}");
        }
    }

    #[test]
    fn runs_of_bytes_of_any_length_and_factor() {
        let bytes: Vec<u8> = (0..75u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
        for factor in [0u8, 1, 2, 0x1d, 0x80, 0xa7, 0xff] {
            for len in [0usize, 1, 3, 4, 5, 16, 31, 75] {
                let mut wanted = [0x5au8; 70];
                slow::mul_add(&mut wanted, &bytes[..len], factor);
                for fast in [mul_add, lanes, words] {
                    let mut found = [0x5au8; 70];
                    fast(&mut found, &bytes[..len], factor);
                    assert_eq!(found, wanted, "{factor} over {len}");
                }
            }
        }
    }
}
