//! Eight packets, four 256-bit vectors of two packets each.
#![expect(unsafe_code, reason = "vector loads and stores, and table look-ups, at computed places")]

use core::arch::x86_64::*;

use codec_core::internals::rans::{
    lanes::LOW,
    table::{PRECISION, SCALE, SLOTS},
};

use crate::lockstep::{FIRST_WORD, Lockstep, TABLE_BITS, WORD};

/// Packets in lockstep.
pub const PACKETS: usize = 8;
const VECTORS: usize = PACKETS / 2;

/// The slots `at` of `slots`, by eight plain loads: a gather is no faster where it is microcode, and
/// lets nothing run beside it.
///
/// # Safety
/// Every lane of `at` is below the number of slots.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
pub(super) unsafe fn look_up(slots: *const i32, at: __m256i) -> __m256i {
    let four = |at: __m128i| {
        let (a, b) = (_mm_cvtsi128_si64(at) as u64, _mm_extract_epi64::<1>(at) as u64);
        // SAFETY: as above.
        let slot = |i: u64| unsafe { *slots.add(i as usize) };
        let found = _mm_cvtsi32_si128(slot(a & 0xffff_ffff));
        let found = _mm_insert_epi32::<1>(found, slot(a >> 32));
        let found = _mm_insert_epi32::<2>(found, slot(b & 0xffff_ffff));
        _mm_insert_epi32::<3>(found, slot(b >> 32))
    };
    let (low, high) = (four(_mm256_castsi256_si128(at)), four(_mm256_extracti128_si256::<1>(at)));
    _mm256_inserti128_si256::<1>(_mm256_castsi128_si256(low), high)
}

/// What popping leaves of one vector.
struct Popped {
    /// Slots found, the token in the low byte of each.
    found: __m256i,
    /// Lanes that took a word, a bit each.
    taken: u32,
}

/// Pops a token off every lane of `x`; a lane that is then below `low` takes the next word of its
/// packet's `window`.
///
/// # Safety
/// `base` holds first slots of tables that are there.
#[inline]
#[target_feature(enable = "avx2,popcnt")]
unsafe fn pop(slots: *const i32, base: __m256i, low: __m256i, window: __m256i, x: &mut __m256i) -> Popped {
    let slot = _mm256_and_si256(*x, _mm256_set1_epi32(SCALE as i32 - 1));
    // SAFETY: a base is at most that of the last table, and a slot below the table's length.
    let found = unsafe { look_up(slots, _mm256_add_epi32(slot, base)) };
    let quotient = _mm256_srli_epi32::<{ PRECISION as i32 }>(*x);
    let bias = _mm256_and_si256(_mm256_srli_epi32::<8>(found), _mm256_set1_epi32(0xfff));
    let below = _mm256_add_epi32(_mm256_mullo_epi32(_mm256_srli_epi32::<20>(found), quotient), bias);
    let refill = _mm256_cmpgt_epi32(low, below);
    // `WORD` times the words that this and lower lanes of the packet take.
    let one = _mm256_and_si256(refill, _mm256_set1_epi32(WORD));
    let two = _mm256_add_epi32(one, _mm256_bslli_epi128::<4>(one));
    let rank = _mm256_add_epi32(two, _mm256_bslli_epi128::<8>(two));
    let fresh = _mm256_shuffle_epi8(window, _mm256_add_epi32(rank, _mm256_set1_epi32(FIRST_WORD)));
    let refilled = _mm256_or_si256(_mm256_slli_epi32::<16>(below), fresh);
    *x = _mm256_blendv_epi8(below, refilled, refill);
    Popped { found, taken: _mm256_movemask_ps(_mm256_castsi256_ps(refill)) as u32 }
}

/// As [`super::Vectors::run`], which brings the arguments into their ranges.
///
/// # Safety
/// `from <= to <= MAX_STEPS`, tables and offsets in the ranges that [`Lockstep`] states; the machine
/// has AVX2 and POPCNT.
#[target_feature(enable = "avx2,popcnt")]
pub unsafe fn run<const ENDING: bool>(
    slots: &[[u32; SLOTS]],
    from: usize,
    to: usize,
    lockstep: &mut Lockstep,
) {
    let Lockstep { state, tables, left, words, tokens, bytes } = lockstep;
    let slots = slots.as_ptr().cast::<i32>();
    let load = |rows: &[[u32; 4]; 16], v: usize| {
        // SAFETY: rows 2v and 2v + 1 of 16, v < 4, are 32 bytes.
        unsafe { _mm256_loadu_si256(rows.as_ptr().add(2 * v).cast()) }
    };
    let zeros = [_mm256_setzero_si256(); VECTORS];
    let (mut x, mut groups) = (zeros, zeros);
    each!(V {
        (x[V], groups[V]) = (load(state, V), load(left, V));
    });
    let tables = tables.as_ptr();
    // The first slots of both packets' tables.
    let first_slot = |step: usize, v: usize| {
        // SAFETY: a step below `MAX_STEPS`; rows 2v and 2v + 1 of 16, v < 4, are 8 bytes.
        let tables = unsafe { _mm_loadl_epi64(tables.add(step).cast::<u64>().add(v).cast()) };
        _mm256_slli_epi32::<{ TABLE_BITS as i32 }>(_mm256_cvtepu8_epi32(tables))
    };
    let mut next = [core::ptr::null::<u8>(); PACKETS];
    for p in 0..PACKETS {
        // SAFETY: an offset is at most `MAX_BYTES`, inside its buffer.
        next[p] = unsafe { bytes[p].as_ptr().add(words[p]) };
    }
    let low = _mm256_set1_epi32(LOW as i32);
    // The next words of both packets, more than a step takes.
    let window = |next: &[*const u8; PACKETS], v: usize| {
        // SAFETY: a call of at most `MAX_STEPS` steps moves at most 8 bytes a step, and the buffer
        // is `8 · MAX_STEPS + 16` longer than the largest offset it starts at.
        unsafe {
            let first = _mm256_castsi128_si256(_mm_loadu_si128(next[2 * v].cast()));
            _mm256_inserti128_si256::<1>(first, _mm_loadu_si128(next[2 * v + 1].cast()))
        }
    };
    let advance = |next: &mut [*const u8; PACKETS], v: usize, taken: u32| {
        let first = 2 * (taken & 15).count_ones() as usize;
        let second = 2 * (taken >> 4).count_ones() as usize;
        // SAFETY: as above.
        unsafe {
            next[2 * v] = next[2 * v].add(first);
            next[2 * v + 1] = next[2 * v + 1].add(second);
        }
    };

    // What a lane falls below before it takes a word: nothing once its groups are used up.
    let least = |groups: &mut __m256i| {
        if !ENDING {
            return low;
        }
        let least = _mm256_and_si256(_mm256_cmpgt_epi32(*groups, _mm256_setzero_si256()), low);
        *groups = _mm256_sub_epi32(*groups, _mm256_set1_epi32(1));
        least
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
                pair[V] = _mm256_and_si256(popped.found, _mm256_set1_epi32(0xff));
            });
            each!(V {
                let base = first_slot(step + 1, V);
                // SAFETY: tables are in their range.
                let popped = unsafe { pop(slots, base, least(&mut groups[V]), window(&next, V), &mut x[V]) };
                advance(&mut next, V, popped.taken);
                let token = _mm256_and_si256(popped.found, _mm256_set1_epi32(0xff));
                pair[V] = _mm256_packus_epi32(pair[V], token);
            });
            step += 2;
        });
        each!(V {
            let four = _mm256_packus_epi16(first[V], second[V]);
            // SAFETY: 16 bytes at `4 · (step - 4)`, and `step` is at most `to`.
            unsafe {
                let mut place = |p: usize| tokens.as_mut_ptr().add(p).cast::<u8>().add(4 * (step - 4)).cast();
                _mm_storeu_si128(place(2 * V), _mm256_castsi256_si128(four));
                _mm_storeu_si128(place(2 * V + 1), _mm256_extracti128_si256::<1>(four));
            }
        });
    }
    while step < to {
        each!(V {
            let base = first_slot(step, V);
            // SAFETY: tables are in their range.
            let popped = unsafe { pop(slots, base, least(&mut groups[V]), window(&next, V), &mut x[V]) };
            advance(&mut next, V, popped.taken);
            let found = _mm256_and_si256(popped.found, _mm256_set1_epi32(0xff));
            let bytes = _mm256_packus_epi16(_mm256_packus_epi32(found, found), found);
            let (first, second) = (
                _mm256_extract_epi32::<0>(bytes).to_le_bytes(),
                _mm256_extract_epi32::<4>(bytes).to_le_bytes(),
            );
            tokens[2 * V][4 * step..4 * step + 4].copy_from_slice(&first);
            tokens[2 * V + 1][4 * step..4 * step + 4].copy_from_slice(&second);
        });
        step += 1;
    }

    for (p, next) in next.into_iter().enumerate() {
        words[p] = next.addr() - bytes[p].as_ptr().addr();
    }
    each!(V {
        // SAFETY: as the loads.
        unsafe { _mm256_storeu_si256(state.as_mut_ptr().add(2 * V).cast(), x[V]) };
    });
}
