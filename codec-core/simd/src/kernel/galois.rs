//! Multiples of a packet in GF(2⁸), added to rows of sums: AVX2 looks up both halves of each byte,
//! GFNI multiplies by a matrix of bits.
#![expect(unsafe_code, reason = "vector loads and stores at computed places")]

use core::arch::x86_64::*;

use codec_core::internals::repair::{self, Combine, LENGTH_BYTES, Term, gf256::mul};

/// Products of a factor with all low and with all high halves of a byte.
static HALVES: [[[u8; 16]; 2]; 256] = {
    let mut all = [[[0; 16]; 2]; 256];
    let mut at = 0;
    while at < 256 * 16 {
        let (factor, half) = (at / 16, at % 16);
        all[factor][0][half] = mul(factor as u8, half as u8);
        all[factor][1][half] = mul(factor as u8, (half << 4) as u8);
        at += 1;
    }
    all
};

/// The matrix of the product by each factor, as GFNI takes it: byte 7 − i says which bits of a byte
/// make bit i of its product.
static MATRICES: [u64; 256] = {
    let mut all = [0; 256];
    let mut at = 0;
    while at < 256 * 64 {
        let (factor, from, to) = (at / 64, at / 8 % 8, at % 8);
        let bit = mul(factor as u8, 1 << from) >> to & 1;
        all[factor] |= (bit as u64) << (8 * (7 - to) + from);
        at += 1;
    }
    all
};

/// Where a term has nothing.
static ZEROS: [u8; LEAST] = [0; LEAST];

/// Shortest row that passes work on: the longest vector.
const LEAST: usize = 64;

/// The [`Combine`]s of this machine by the names of their instructions, the slowest first.
pub fn combines() -> impl Iterator<Item = (&'static str, Combine)> {
    let avx2 = is_x86_feature_detected!("avx2");
    let gfni = avx2 && is_x86_feature_detected!("gfni");
    let wide = gfni && is_x86_feature_detected!("avx512f");
    let all: [(bool, &str, Combine); 3] = [
        (avx2, "avx2", shuffles::combine),
        (gfni, "gfni", matrices::combine),
        (wide, "gfni-512", wide_matrices::combine),
    ];
    all.into_iter().filter(|m| m.0).map(|(_, name, combine)| (name, combine))
}

/// A kernel as a module: its instructions, the bytes of a vector, what loads, stores, adds and clears
/// one, then items: `Table` of a factor, `table` that gives it, `Parts` of a vector as `parts` gives
/// them, and `product` of a table and parts.
macro_rules! kernel {
    (
        $(#[$doc:meta])*
        $name:ident, $features:literal, $width:literal, $load:ident, $store:ident, $add:ident, $zero:ident,
        { $($item:item)* }
    ) => {
        $(#[$doc])*
        mod $name {
            use super::*;

            $($item)*

            const W: usize = $width;

            /// A [`Combine`], for machines that have the instructions.
            pub fn combine(mut rows: &mut [u8], stride: usize, terms: &[Term<'_>]) {
                if stride < LEAST {
                    return repair::combine(rows, stride, terms);
                }
                let most = terms.iter().map(|term| term.factors.len()).max().unwrap_or(0);
                let mut first = 0;
                while let count @ 1.. = (most - first).min(rows.len() / stride) {
                    // SAFETY: there are `count` rows of at least `LEAST` bytes, and `combines` gives this
                    // function only to a machine that has the instructions.
                    let done = unsafe {
                        match count {
                            1 => some::<1>(rows, stride, terms, first),
                            2 | 3 => some::<2>(rows, stride, terms, first),
                            _ => some::<4>(rows, stride, terms, first),
                        }
                    };
                    first += done;
                    rows = &mut rows[done * stride..];
                }
            }

            /// Adds `terms`, times their factors from number `first` on, to the first `R` of `rows`, and
            /// returns `R`.
            ///
            /// # Safety
            /// As [`pass`].
            #[target_feature(enable = $features)]
            unsafe fn some<const R: usize>(
                rows: &mut [u8],
                stride: usize,
                terms: &[Term<'_>],
                first: usize,
            ) -> usize {
                let (fours, ones) = terms.as_chunks();
                for terms in fours {
                    // SAFETY: as above.
                    unsafe { pass::<R, 4>(rows, stride, terms, first) };
                }
                for term in ones {
                    // SAFETY: as above.
                    unsafe { pass::<R, 1>(rows, stride, core::array::from_ref(term), first) };
                }
                R
            }

            /// [`some`] with all terms in one pass over the rows.
            ///
            /// # Safety
            /// `rows` has at least `R · stride` bytes, and `stride` is at least [`LEAST`]. The machine
            /// has the instructions.
            #[target_feature(enable = $features)]
            unsafe fn pass<const R: usize, const T: usize>(
                rows: &mut [u8],
                stride: usize,
                terms: &[Term<'_>; T],
                first: usize,
            ) {
                // The last vector of a row ends where the row does.
                let last = stride - W;
                let (mut heads, mut tails) = ([[0u8; W]; T], [[0u8; W]; T]);
                let mut tables = [[table(0); R]; T];
                let mut contents: [&[u8]; T] = [&[]; T];
                let mut from = [ZEROS.as_ptr(); T];
                let (mut shortest, mut longest) = (stride, 0);
                for t in 0..T {
                    let term = &terms[t];
                    for r in 0..R {
                        tables[t][r] = table(term.factors.get(first + r).copied().unwrap_or(0));
                    }
                    let content = &term.content[..term.content.len().min(stride - LENGTH_BYTES)];
                    let coded = LENGTH_BYTES + content.len();
                    (shortest, longest) = (shortest.min(coded), longest.max(coded));
                    let (head, tail) = (&mut heads[t], &mut tails[t]);
                    head[..LENGTH_BYTES].copy_from_slice(&term.length);
                    if let Some(bytes) = content.first_chunk::<{ W - LENGTH_BYTES }>() {
                        head[LENGTH_BYTES..].copy_from_slice(bytes);
                        let at = coded - coded % W;
                        let rest = &content[at - LENGTH_BYTES..];
                        tail[at - at.min(last)..][..rest.len()].copy_from_slice(rest);
                    } else {
                        head[LENGTH_BYTES..coded].copy_from_slice(content);
                    }
                    contents[t] = content;
                    from[t] = head.as_ptr();
                }
                let rows = rows.as_mut_ptr();
                // SAFETY: heads, tails and zeros are vectors, and so is what lies at `at` of a coded
                // packet that reaches `W` bytes further; a row has a vector at 0, at `last`, and at
                // what is less.
                unsafe {
                    add(rows, stride, 0, &from, &tables);
                    let mut at = W;
                    while at + W <= shortest {
                        for t in 0..T {
                            from[t] = contents[t].as_ptr().add(at - LENGTH_BYTES);
                        }
                        add(rows, stride, at, &from, &tables);
                        at += W;
                    }
                    while at < longest {
                        for t in 0..T {
                            let coded = LENGTH_BYTES + contents[t].len();
                            from[t] = if at + W <= coded {
                                contents[t].as_ptr().add(at - LENGTH_BYTES)
                            } else if at < coded {
                                tails[t].as_ptr()
                            } else {
                                ZEROS.as_ptr()
                            };
                        }
                        add(rows, stride, at.min(last), &from, &tables);
                        at += W;
                    }
                }
            }

            /// Adds the vectors at `from`, times their factors, to those at `at` of `R` rows.
            ///
            /// # Safety
            /// There is a vector at each of these places; the machine has the instructions.
            #[inline]
            #[target_feature(enable = $features)]
            unsafe fn add<const R: usize, const T: usize>(
                rows: *mut u8,
                stride: usize,
                at: usize,
                from: &[*const u8; T],
                tables: &[[Table; R]; T],
            ) {
                let mut sums = [$zero(); R];
                for t in 0..T {
                    // SAFETY: as above.
                    let x = parts(unsafe { $load(from[t].cast()) });
                    for r in 0..R {
                        sums[r] = $add(sums[r], product(tables[t][r], x));
                    }
                }
                for r in 0..R {
                    // SAFETY: as above.
                    unsafe {
                        let place = rows.add(r * stride + at).cast();
                        $store(place, $add($load(place), sums[r]));
                    }
                }
            }
        }
    };
}

kernel!(
    /// A shuffle looks up the products of one half of 32 bytes.
    shuffles, "avx2", 32, _mm256_loadu_si256, _mm256_storeu_si256, _mm256_xor_si256, _mm256_setzero_si256,
    {
        /// Products of low halves and of high halves, each in both lanes.
        type Table = [__m256i; 2];
        /// Low halves and high halves.
        type Parts = [__m256i; 2];

        #[inline]
        #[target_feature(enable = "avx2")]
        fn table(factor: u8) -> Table {
            let [low, high] = &HALVES[usize::from(factor)];
            // SAFETY: sixteen bytes each.
            let (low, high) =
                unsafe { (_mm_loadu_si128(low.as_ptr().cast()), _mm_loadu_si128(high.as_ptr().cast())) };
            [_mm256_broadcastsi128_si256(low), _mm256_broadcastsi128_si256(high)]
        }

        #[inline]
        #[target_feature(enable = "avx2")]
        fn parts(x: __m256i) -> Parts {
            let mask = _mm256_set1_epi8(15);
            [_mm256_and_si256(x, mask), _mm256_and_si256(_mm256_srli_epi64::<4>(x), mask)]
        }

        #[inline]
        #[target_feature(enable = "avx2")]
        fn product(table: Table, parts: Parts) -> __m256i {
            let [low, high] = parts;
            _mm256_xor_si256(_mm256_shuffle_epi8(table[0], low), _mm256_shuffle_epi8(table[1], high))
        }
    }
);

kernel!(
    /// A matrix times 32 bytes.
    matrices, "avx2,gfni", 32,
        _mm256_loadu_si256, _mm256_storeu_si256, _mm256_xor_si256, _mm256_setzero_si256,
    {
        type Table = __m256i;
        type Parts = __m256i;

        #[inline]
        #[target_feature(enable = "avx2,gfni")]
        fn table(factor: u8) -> Table {
            _mm256_set1_epi64x(MATRICES[usize::from(factor)] as i64)
        }

        #[inline]
        #[target_feature(enable = "avx2,gfni")]
        fn parts(x: __m256i) -> Parts {
            x
        }

        #[inline]
        #[target_feature(enable = "avx2,gfni")]
        fn product(table: Table, x: Parts) -> __m256i {
            _mm256_gf2p8affine_epi64_epi8::<0>(x, table)
        }
    }
);

kernel!(
    /// A matrix times 64 bytes.
    wide_matrices, "avx512f,gfni", 64,
        _mm512_loadu_si512, _mm512_storeu_si512, _mm512_xor_si512, _mm512_setzero_si512,
    {
        type Table = __m512i;
        type Parts = __m512i;

        #[inline]
        #[target_feature(enable = "avx512f,gfni")]
        fn table(factor: u8) -> Table {
            _mm512_set1_epi64(MATRICES[usize::from(factor)] as i64)
        }

        #[inline]
        #[target_feature(enable = "avx512f,gfni")]
        fn parts(x: __m512i) -> Parts {
            x
        }

        #[inline]
        #[target_feature(enable = "avx512f,gfni")]
        fn product(table: Table, x: Parts) -> __m512i {
            _mm512_gf2p8affine_epi64_epi8::<0>(x, table)
        }
    }
);
