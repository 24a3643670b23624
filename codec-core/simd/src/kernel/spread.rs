//! Tokens and raw bits into values, sixteen at a time.
#![expect(unsafe_code, reason = "vector loads and stores of slices whose lengths are known")]

use core::arch::x86_64::*;

/// Values at a time.
const WIDTH: usize = 16;
/// Bytes of one load of raw bits, which serves half of them.
const LOAD: usize = 16;

/// As [`super::Spread`] says.
///
/// A field of `k` bits lies in two neighbouring bytes. A byte shuffle brings those of eight values
/// into eight 16-bit lanes, a product moves each field to the top of its lane, one shift down
/// again. Sixteen values take whole bytes, so that shuffle and factors stay the same.
///
/// # Safety
/// The machine has AVX2.
#[target_feature(enable = "avx2")]
pub unsafe fn spread(raw_bits: u8, plane: &[u8], bit: usize, tokens: &[u8], out: &mut [i16]) -> usize {
    let k = usize::from(raw_bits);
    let groups = tokens.as_chunks::<WIDTH>().0.iter().zip(out.as_chunks_mut::<WIDTH>().0);
    let middle = _mm256_set1_epi16(128);
    let centred = |tokens: &[u8; WIDTH]| {
        // SAFETY: sixteen bytes.
        let tokens = unsafe { _mm_loadu_si128(tokens.as_ptr().cast()) };
        _mm256_sub_epi16(_mm256_cvtepu8_epi16(tokens), middle)
    };
    let put = |out: &mut [i16; WIDTH], values: __m256i| {
        // SAFETY: sixteen values of two bytes.
        unsafe { _mm256_storeu_si256(out.as_mut_ptr().cast(), values) };
    };
    let mut done = 0;
    if k == 0 {
        for (tokens, out) in groups {
            put(out, centred(tokens));
            done += WIDTH;
        }
        return done;
    }
    if k > 8 || bit > 7 {
        return 0;
    }
    let (mut pick, mut factor) = ([0u8; 16], [0u16; 8]);
    for (i, (pick, factor)) in pick.as_chunks_mut::<2>().0.iter_mut().zip(&mut factor).enumerate() {
        let at = bit + i * k;
        *pick = [(at / 8) as u8, (at / 8 + 1) as u8];
        *factor = (1u32 << (16 - at % 8 - k)) as u16;
    }
    // SAFETY: both are sixteen bytes.
    let (pick, factor) =
        unsafe { (_mm_loadu_si128(pick.as_ptr().cast()), _mm_loadu_si128(factor.as_ptr().cast())) };
    let (pick, factor) = (_mm256_broadcastsi128_si256(pick), _mm256_broadcastsi128_si256(factor));
    let (up, down) = (_mm_cvtsi32_si128(k as i32), _mm_cvtsi32_si128(16 - k as i32));
    for ((tokens, out), place) in groups.zip((0..).step_by(2 * k)) {
        let bytes = |from: usize| plane.get(from..).and_then(|rest| rest.first_chunk::<LOAD>());
        let (Some(first), Some(second)) = (bytes(place), bytes(place + k)) else { break };
        // SAFETY: sixteen bytes each.
        let (first, second) =
            unsafe { (_mm_loadu_si128(first.as_ptr().cast()), _mm_loadu_si128(second.as_ptr().cast())) };
        let raw = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(first), second);
        let raw = _mm256_mullo_epi16(_mm256_shuffle_epi8(raw, pick), factor);
        let high = _mm256_sll_epi16(centred(tokens), up);
        put(out, _mm256_or_si256(high, _mm256_srl_epi16(raw, down)));
        done += WIDTH;
    }
    done
}
