//! Sixteen packets, four 512-bit vectors of four packets each.
#![expect(unsafe_code, reason = "vector loads and stores at computed places")]

use core::arch::x86_64::*;

use codec_core::internals::rans::{
    lanes::LOW,
    table::{PRECISION, SCALE, SLOTS},
};

use super::avx2::look_up;
use crate::lockstep::{FIRST_WORD, Lockstep, TABLE_BITS, WORD};

/// Packets in lockstep.
pub const PACKETS: usize = 16;
const VECTORS: usize = PACKETS / 4;

/// What popping leaves of one vector.
struct Popped {
    /// Slots found, the token in the low byte of each.
    found: __m512i,
    /// Lanes that took a word, a bit each.
    taken: u16,
}

/// Pops a token off every lane of `x`; a lane that is then below `low` takes the next word of its
/// packet's `window`.
///
/// # Safety
/// `base` holds first slots of tables that are there.
#[inline]
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
unsafe fn pop(slots: *const i32, base: __m512i, low: __m512i, window: __m512i, x: &mut __m512i) -> Popped {
    let slot = _mm512_and_si512(*x, _mm512_set1_epi32(SCALE as i32 - 1));
    let at = _mm512_add_epi32(slot, base);
    // SAFETY: a base is at most that of the last table, and a slot below the table's length.
    let found = unsafe {
        // Sixteen plain loads, as for narrower vectors.
        let low = look_up(slots, _mm512_castsi512_si256(at));
        let high = look_up(slots, _mm512_extracti64x4_epi64::<1>(at));
        _mm512_inserti64x4::<1>(_mm512_castsi256_si512(low), high)
    };
    let quotient = _mm512_srli_epi32::<PRECISION>(*x);
    let bias = _mm512_and_si512(_mm512_srli_epi32::<8>(found), _mm512_set1_epi32(0xfff));
    let below = _mm512_add_epi32(_mm512_mullo_epi32(_mm512_srli_epi32::<20>(found), quotient), bias);
    let refill = _mm512_cmplt_epi32_mask(below, low);
    // `WORD` times the words that this and lower lanes of the packet take.
    let one = _mm512_maskz_mov_epi32(refill, _mm512_set1_epi32(WORD));
    let two = _mm512_add_epi32(one, _mm512_bslli_epi128::<4>(one));
    let rank = _mm512_add_epi32(two, _mm512_bslli_epi128::<8>(two));
    let fresh = _mm512_shuffle_epi8(window, _mm512_add_epi32(rank, _mm512_set1_epi32(FIRST_WORD)));
    *x = _mm512_mask_or_epi32(below, refill, _mm512_slli_epi32::<16>(below), fresh);
    Popped { found, taken: refill }
}

/// As [`super::Vectors::run`], which brings the arguments into their ranges.
///
/// # Safety
/// `from <= to <= MAX_STEPS`, tables and offsets in the ranges that [`Lockstep`] states; the machine
/// has AVX2, POPCNT and AVX-512 F,
/// BW, DQ and VL.
#[target_feature(enable = "avx2,popcnt,avx512f,avx512bw,avx512dq,avx512vl")]
pub unsafe fn run<const ENDING: bool>(
    slots: &[[u32; SLOTS]],
    from: usize,
    to: usize,
    lockstep: &mut Lockstep,
) {
    let Lockstep { state, tables, left, words, tokens, bytes } = lockstep;
    let slots = slots.as_ptr().cast::<i32>();
    let load = |rows: &[[u32; 4]; 16], v: usize| {
        // SAFETY: rows 4v ..= 4v + 3 of 16, v < 4, are 64 bytes.
        unsafe { _mm512_loadu_si512(rows.as_ptr().add(4 * v).cast()) }
    };
    let zeros = [_mm512_setzero_si512(); VECTORS];
    let (mut x, mut groups) = (zeros, zeros);
    each!(V {
        (x[V], groups[V]) = (load(state, V), load(left, V));
    });
    let tables = tables.as_ptr();
    // The first slots of four packets' tables.
    let first_slot = |step: usize, v: usize| {
        // SAFETY: a step below `MAX_STEPS`; rows 4v ..= 4v + 3 of 16, v < 4, are 16 bytes.
        let tables = unsafe { _mm_loadu_si128(tables.add(step).cast::<__m128i>().add(v)) };
        _mm512_slli_epi32::<TABLE_BITS>(_mm512_cvtepu8_epi32(tables))
    };
    let mut next = [core::ptr::null::<u8>(); PACKETS];
    for p in 0..PACKETS {
        // SAFETY: an offset is at most `MAX_BYTES`, inside its buffer.
        next[p] = unsafe { bytes[p].as_ptr().add(words[p]) };
    }
    let low = _mm512_set1_epi32(LOW as i32);
    // The next words of the four packets, more than a step takes.
    let window = |next: &[*const u8; PACKETS], v: usize| {
        // SAFETY: a call of at most `MAX_STEPS` steps moves at most 8 bytes a step, and the buffer
        // is `8 · MAX_STEPS + 16` longer than the largest offset it starts at.
        let of = |p: usize| unsafe { _mm_loadu_si128(next[4 * v + p].cast()) };
        let low = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(of(0)), of(1));
        let high = _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(of(2)), of(3));
        _mm512_inserti64x4::<1>(_mm512_castsi256_si512(low), high)
    };
    let advance = |next: &mut [*const u8; PACKETS], v: usize, taken: u16| {
        for p in 0..4 {
            let words = (taken >> (4 * p) & 15).count_ones() as usize;
            // SAFETY: as above.
            next[4 * v + p] = unsafe { next[4 * v + p].add(2 * words) };
        }
    };

    // What a lane falls below before it takes a word: nothing once its groups are used up.
    let least = |groups: &mut __m512i| {
        if !ENDING {
            return low;
        }
        let some = _mm512_cmpgt_epi32_mask(*groups, _mm512_setzero_si512());
        *groups = _mm512_sub_epi32(*groups, _mm512_set1_epi32(1));
        _mm512_maskz_mov_epi32(some, low)
    };

    let mut step = from;
    while step + 4 <= to {
        let (mut first, mut second) = (zeros, zeros);
        both!(pair of first, second {
            each!(V {
                let base = first_slot(step, V);
                // SAFETY: tables are in their range.
                let popped = unsafe { pop(slots, base, least(&mut groups[V]), window(&next, V), &mut x[V]) };
                advance(&mut next, V, popped.taken);
                pair[V] = _mm512_and_si512(popped.found, _mm512_set1_epi32(0xff));
            });
            each!(V {
                let base = first_slot(step + 1, V);
                // SAFETY: tables are in their range.
                let popped = unsafe { pop(slots, base, least(&mut groups[V]), window(&next, V), &mut x[V]) };
                advance(&mut next, V, popped.taken);
                let token = _mm512_and_si512(popped.found, _mm512_set1_epi32(0xff));
                pair[V] = _mm512_packus_epi32(pair[V], token);
            });
            step += 2;
        });
        each!(V {
            let four = _mm512_packus_epi16(first[V], second[V]);
            // SAFETY: 16 bytes at `4 · (step - 4)`, and `step` is at most `to`.
            unsafe {
                let mut place = |p: usize| tokens.as_mut_ptr().add(p).cast::<u8>().add(4 * (step - 4)).cast();
                _mm_storeu_si128(place(4 * V), _mm512_extracti32x4_epi32::<0>(four));
                _mm_storeu_si128(place(4 * V + 1), _mm512_extracti32x4_epi32::<1>(four));
                _mm_storeu_si128(place(4 * V + 2), _mm512_extracti32x4_epi32::<2>(four));
                _mm_storeu_si128(place(4 * V + 3), _mm512_extracti32x4_epi32::<3>(four));
            }
        });
    }
    while step < to {
        each!(V {
            let base = first_slot(step, V);
            // SAFETY: tables are in their range.
            let popped = unsafe { pop(slots, base, least(&mut groups[V]), window(&next, V), &mut x[V]) };
            advance(&mut next, V, popped.taken);
            let mut bytes = [0u8; 16];
            // SAFETY: 16 bytes for 16 tokens.
            unsafe { _mm_storeu_si128(bytes.as_mut_ptr().cast(), _mm512_cvtepi32_epi8(popped.found)) };
            for (p, bytes) in bytes.as_chunks::<4>().0.iter().enumerate() {
                tokens[4 * V + p][4 * step..4 * step + 4].copy_from_slice(bytes);
            }
        });
        step += 1;
    }

    for (p, next) in next.into_iter().enumerate() {
        words[p] = next.addr() - bytes[p].as_ptr().addr();
    }
    each!(V {
        // SAFETY: as the loads.
        unsafe { _mm512_storeu_si512(state.as_mut_ptr().add(4 * V).cast(), x[V]) };
    });
}
