//! Sixteen packets, four 512-bit vectors of four packets each.
#![expect(unsafe_code, reason = "vector loads, stores and gathers at computed places")]
#![expect(
    clippy::needless_range_loop,
    reason = "a vector's number picks its states, its packets and its words"
)]

use core::arch::x86_64::*;

use codec_core::rans::{
    lanes::LOW,
    table::{PRECISION, SCALE, SLOTS},
};

use super::Lockstep;

/// Packets in lockstep.
pub const PACKETS: usize = 16;
const VECTORS: usize = PACKETS / 4;

/// As [`super::Vectors::run`], which brings the arguments into their ranges.
///
/// # Safety
/// `from <= to <= MOST_STEPS`, bases and offsets in the ranges that [`Lockstep`] states; the machine has AVX-512 F and BW, and POPCNT.
#[target_feature(enable = "avx512f,avx512bw,popcnt")]
pub unsafe fn run(slots: &[[u32; SLOTS]], from: usize, to: usize, lockstep: &mut Lockstep) {
    let Lockstep { state, base, words, tokens, bytes } = lockstep;
    let slots = slots.as_ptr().cast::<i32>();
    let load = |rows: &[[u32; 4]; 16], v: usize| {
        // SAFETY: rows 4v ..= 4v + 3 of 16, v < 4, are 64 bytes.
        unsafe { _mm512_loadu_si512(rows.as_ptr().add(4 * v).cast()) }
    };
    let (mut x, mut first_slot) = ([_mm512_setzero_si512(); VECTORS], [_mm512_setzero_si512(); VECTORS]);
    for v in 0..VECTORS {
        (x[v], first_slot[v]) = (load(state, v), load(base, v));
    }
    let mut next = [core::ptr::null::<u8>(); PACKETS];
    for p in 0..PACKETS {
        // SAFETY: an offset is at most `MOST_BYTES`, inside its buffer.
        next[p] = unsafe { bytes[p].as_ptr().add(words[p]) };
    }
    let token = _mm512_set1_epi32(0xff);

    let mut pop = |v: usize| {
        let slot = _mm512_and_si512(x[v], _mm512_set1_epi32(SCALE as i32 - 1));
        // SAFETY: a base is at most that of the last table, and a slot below the table's length.
        let found = unsafe { _mm512_i32gather_epi32::<4>(_mm512_add_epi32(slot, first_slot[v]), slots) };
        let high = _mm512_mullo_epi32(_mm512_srli_epi32::<20>(found), _mm512_srli_epi32::<PRECISION>(x[v]));
        let bias = _mm512_and_si512(_mm512_srli_epi32::<8>(found), _mm512_set1_epi32(0xfff));
        let below = _mm512_add_epi32(high, bias);
        let refill = _mm512_cmplt_epi32_mask(below, _mm512_set1_epi32(LOW as i32));
        // SAFETY: a call of at most `MOST_STEPS` steps moves at most 8 bytes a step, and the buffer
        // is `8 · MOST_STEPS + 8` longer than the largest offset it starts at.
        let fresh = unsafe {
            let word = |p: usize| _mm_loadl_epi64(next[4 * v + p].cast());
            let low = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(word(0)), word(1));
            let high = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(word(2)), word(3));
            let fresh = _mm512_inserti64x4::<1>(_mm512_castsi256_si512(low), high);
            for p in 0..4 {
                let taken = (refill >> (4 * p) & 15).count_ones() as usize;
                next[4 * v + p] = next[4 * v + p].add(2 * taken);
            }
            fresh
        };
        // How many lanes of the packet take a word up to and including this one: 1 is the first
        // word, bytes 0 and 1; 2 the second, bytes 2 and 3. Other lanes' sums are not used.
        let one = _mm512_maskz_set1_epi32(refill, 1);
        let two = _mm512_add_epi32(one, _mm512_bslli_epi128::<4>(one));
        let rank = _mm512_add_epi32(two, _mm512_bslli_epi128::<8>(two));
        let take = _mm512_add_epi16(
            _mm512_mullo_epi16(rank, _mm512_set1_epi32(0x0202)),
            _mm512_set1_epi32(0x8080_fefe_u32 as i32),
        );
        let fresh = _mm512_shuffle_epi8(fresh, take);
        x[v] = _mm512_mask_or_epi32(below, refill, _mm512_slli_epi32::<16>(below), fresh);
        _mm512_and_si512(found, token)
    };

    let mut step = from;
    while step + 4 <= to {
        let mut pair = [_mm512_setzero_si512(); VECTORS];
        for v in 0..VECTORS {
            pair[v] = pop(v);
        }
        for v in 0..VECTORS {
            pair[v] = _mm512_packus_epi32(pair[v], pop(v));
        }
        let mut third = [_mm512_setzero_si512(); VECTORS];
        for v in 0..VECTORS {
            third[v] = pop(v);
        }
        for v in 0..VECTORS {
            let other = _mm512_packus_epi32(third[v], pop(v));
            let four = _mm512_packus_epi16(pair[v], other);
            // SAFETY: 16 bytes at `4 · step`, and `step + 4` is at most `to`.
            unsafe {
                let mut place = |p: usize| tokens.as_mut_ptr().add(p).cast::<u8>().add(4 * step).cast();
                _mm_storeu_si128(place(4 * v), _mm512_extracti32x4_epi32::<0>(four));
                _mm_storeu_si128(place(4 * v + 1), _mm512_extracti32x4_epi32::<1>(four));
                _mm_storeu_si128(place(4 * v + 2), _mm512_extracti32x4_epi32::<2>(four));
                _mm_storeu_si128(place(4 * v + 3), _mm512_extracti32x4_epi32::<3>(four));
            }
        }
        step += 4;
    }
    while step < to {
        for v in 0..VECTORS {
            let mut bytes = [0u8; 16];
            // SAFETY: 16 bytes for 16 tokens.
            unsafe { _mm_storeu_si128(bytes.as_mut_ptr().cast(), _mm512_cvtepi32_epi8(pop(v))) };
            for (p, bytes) in bytes.as_chunks::<4>().0.iter().enumerate() {
                tokens[4 * v + p][4 * step..4 * step + 4].copy_from_slice(bytes);
            }
        }
        step += 1;
    }

    for (p, next) in next.into_iter().enumerate() {
        words[p] = next.addr() - bytes[p].as_ptr().addr();
    }
    for (v, x) in x.into_iter().enumerate() {
        // SAFETY: as the loads.
        unsafe { _mm512_storeu_si512(state.as_mut_ptr().add(4 * v).cast(), x) };
    }
}
