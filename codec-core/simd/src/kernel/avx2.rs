//! Eight packets, four 256-bit vectors of two packets each.
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

use super::{Lockstep, TAKE};

/// Packets in lockstep.
pub const PACKETS: usize = 8;
const VECTORS: usize = PACKETS / 2;

/// As [`super::Vectors::run`], which brings the arguments into their ranges.
///
/// # Safety
/// `from <= to <= MOST_STEPS`, bases and offsets in the ranges that [`Lockstep`] states; the machine has AVX2 and POPCNT.
#[target_feature(enable = "avx2,popcnt")]
pub unsafe fn run(slots: &[[u32; SLOTS]], from: usize, to: usize, lockstep: &mut Lockstep) {
    let Lockstep { state, base, words, tokens, bytes } = lockstep;
    let slots = slots.as_ptr().cast::<i32>();
    let load = |rows: &[[u32; 4]; 16], v: usize| {
        // SAFETY: rows 2v and 2v + 1 of 16, v < 4, are 32 bytes.
        unsafe { _mm256_loadu_si256(rows.as_ptr().add(2 * v).cast()) }
    };
    let (mut x, mut first_slot) = ([_mm256_setzero_si256(); VECTORS], [_mm256_setzero_si256(); VECTORS]);
    for v in 0..VECTORS {
        (x[v], first_slot[v]) = (load(state, v), load(base, v));
    }
    let mut next = [core::ptr::null::<u8>(); PACKETS];
    for p in 0..PACKETS {
        // SAFETY: an offset is at most `MOST_BYTES`, inside its buffer.
        next[p] = unsafe { bytes[p].as_ptr().add(words[p]) };
    }
    let token = _mm256_set1_epi32(0xff);

    let mut pop = |v: usize| {
        let slot = _mm256_and_si256(x[v], _mm256_set1_epi32(SCALE as i32 - 1));
        // SAFETY: a base is at most that of the last table, and a slot below the table's length.
        let found = unsafe { _mm256_i32gather_epi32::<4>(slots, _mm256_add_epi32(slot, first_slot[v])) };
        let high = _mm256_mullo_epi32(
            _mm256_srli_epi32::<20>(found),
            _mm256_srli_epi32::<{ PRECISION as i32 }>(x[v]),
        );
        let bias = _mm256_and_si256(_mm256_srli_epi32::<8>(found), _mm256_set1_epi32(0xfff));
        let below = _mm256_add_epi32(high, bias);
        let refill = _mm256_cmpgt_epi32(_mm256_set1_epi32(LOW as i32), below);
        let sets = _mm256_movemask_ps(_mm256_castsi256_ps(refill)) as usize;
        let (first, second) = (sets & 15, sets >> 4);
        // SAFETY: a call of at most `MOST_STEPS` steps moves at most 8 bytes a step, and the buffer
        // is `8 · MOST_STEPS + 8` longer than the largest offset it starts at. The sets are below 16.
        let (fresh, take) = unsafe {
            let fresh = _mm256_inserti128_si256::<1>(
                _mm256_castsi128_si256(_mm_loadl_epi64(next[2 * v].cast())),
                _mm_loadl_epi64(next[2 * v + 1].cast()),
            );
            next[2 * v] = next[2 * v].add(2 * first.count_ones() as usize);
            next[2 * v + 1] = next[2 * v + 1].add(2 * second.count_ones() as usize);
            let row = |set: usize| _mm_loadu_si128(TAKE.as_ptr().add(set).cast());
            (fresh, _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(row(first)), row(second)))
        };
        let fresh = _mm256_shuffle_epi8(fresh, take);
        let shift = _mm256_and_si256(refill, _mm256_set1_epi32(16));
        x[v] = _mm256_or_si256(_mm256_sllv_epi32(below, shift), fresh);
        _mm256_and_si256(found, token)
    };

    let mut step = from;
    while step + 4 <= to {
        let mut pair = [_mm256_setzero_si256(); VECTORS];
        for v in 0..VECTORS {
            pair[v] = pop(v);
        }
        for v in 0..VECTORS {
            pair[v] = _mm256_packus_epi32(pair[v], pop(v));
        }
        let mut third = [_mm256_setzero_si256(); VECTORS];
        for v in 0..VECTORS {
            third[v] = pop(v);
        }
        for v in 0..VECTORS {
            let other = _mm256_packus_epi32(third[v], pop(v));
            let four = _mm256_packus_epi16(pair[v], other);
            // SAFETY: 16 bytes at `4 · step`, and `step + 4` is at most `to`.
            unsafe {
                let mut place = |p: usize| tokens.as_mut_ptr().add(p).cast::<u8>().add(4 * step).cast();
                _mm_storeu_si128(place(2 * v), _mm256_castsi256_si128(four));
                _mm_storeu_si128(place(2 * v + 1), _mm256_extracti128_si256::<1>(four));
            }
        }
        step += 4;
    }
    while step < to {
        for v in 0..VECTORS {
            let found = pop(v);
            let bytes = _mm256_packus_epi16(_mm256_packus_epi32(found, found), found);
            let (first, second) = (
                _mm256_extract_epi32::<0>(bytes).to_le_bytes(),
                _mm256_extract_epi32::<4>(bytes).to_le_bytes(),
            );
            tokens[2 * v][4 * step..4 * step + 4].copy_from_slice(&first);
            tokens[2 * v + 1][4 * step..4 * step + 4].copy_from_slice(&second);
        }
        step += 1;
    }

    for (p, next) in next.into_iter().enumerate() {
        words[p] = next.addr() - bytes[p].as_ptr().addr();
    }
    for (v, x) in x.into_iter().enumerate() {
        // SAFETY: as the loads.
        unsafe { _mm256_storeu_si256(state.as_mut_ptr().add(2 * v).cast(), x) };
    }
}
