//! Which kernels there are, which of them this machine has, and what they do.

/// `$body` for each of four vectors, `$v` a constant: in a loop their states would live in memory.
#[cfg(target_arch = "x86_64")]
macro_rules! each {
    ($v:ident $body:block) => {
        each!($v 0 $body);
        each!($v 1 $body);
        each!($v 2 $body);
        each!($v 3 $body);
    };
    ($v:ident $number:literal $body:block) => {{
        const $v: usize = $number;
        $body
    }};
}
/// `$body` for `$first` and for `$second`, as `$place`.
#[cfg(target_arch = "x86_64")]
macro_rules! both {
    ($place:ident of $first:ident, $second:ident $body:block) => {{
        {
            let $place = &mut $first;
            $body
        }
        let $place = &mut $second;
        $body
    }};
}

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;
#[cfg(target_arch = "x86_64")]
pub(crate) mod galois;
#[cfg(target_arch = "x86_64")]
mod spread;

use codec_core::internals::rans::table::SLOTS;

use crate::lockstep::{Lockstep, MAX_BYTES, MAX_STEPS};

/// A way to decode packets.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Kernel {
    /// One packet after the other, safe code.
    Scalar,
    /// Eight packets in lockstep, 256-bit vectors.
    Avx2,
    /// Sixteen packets in lockstep, 512-bit vectors.
    Avx512,
}

impl Kernel {
    /// All kernels, the slowest first.
    pub const ALL: [Self; 3] = [Self::Scalar, Self::Avx2, Self::Avx512];

    /// Name, as benches print it.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Scalar => "scalar",
            Self::Avx2 => "avx2",
            Self::Avx512 => "avx512",
        }
    }

    /// Whether this machine has it.
    pub fn is_here(self) -> bool {
        match self {
            Self::Scalar => true,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => is_x86_feature_detected!("avx2") && is_x86_feature_detected!("popcnt"),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => {
                is_x86_feature_detected!("avx512f")
                    && is_x86_feature_detected!("avx512bw")
                    && is_x86_feature_detected!("avx512dq")
                    && is_x86_feature_detected!("avx512vl")
                    && Self::Avx2.is_here()
            }
            #[cfg(not(target_arch = "x86_64"))]
            _ => false,
        }
    }

    /// The fastest that this machine has.
    pub fn best() -> Self {
        Self::ALL.into_iter().rfind(|kernel| kernel.is_here()).unwrap_or(Self::Scalar)
    }

    /// The vectors behind it, if it has any and this machine has them.
    pub(crate) fn vectors(self) -> Option<Vectors> {
        #[cfg(target_arch = "x86_64")]
        let found = match self {
            Self::Scalar => return None,
            Self::Avx2 => Vectors {
                packets: avx2::PACKETS,
                run: avx2::run::<false>,
                end: avx2::run::<true>,
                spread: spread::spread,
            },
            Self::Avx512 => Vectors {
                packets: avx512::PACKETS,
                run: avx512::run::<false>,
                end: avx512::run::<true>,
                spread: spread::spread,
            },
        };
        #[cfg(target_arch = "x86_64")]
        return self.is_here().then_some(found);
        #[cfg(not(target_arch = "x86_64"))]
        None
    }
}

/// Pops the tokens of groups `from..to` of four values of every packet.
///
/// # Safety
/// `from <= to <= MAX_STEPS`, tables and offsets are in the ranges that [`Lockstep`] states, and
/// the machine has the kernel's instructions.
type Run = unsafe fn(slots: &[[u32; SLOTS]], from: usize, to: usize, lockstep: &mut Lockstep);

/// Writes the values of the first of `tokens`, each with `raw_bits` bits of `plane`, the first of
/// them at bit `bit` < 8; returns how many it wrote.
///
/// # Safety
/// The machine has the kernel's instructions.
type Spread = unsafe fn(raw_bits: u8, plane: &[u8], bit: usize, tokens: &[u8], out: &mut [i16]) -> usize;

/// A kernel that this machine has.
#[derive(Clone, Copy)]
pub(crate) struct Vectors {
    /// Packets in lockstep, at most [`MAX_PACKETS`](crate::lockstep::MAX_PACKETS).
    pub packets: usize,
    /// Every lane takes words.
    run: Run,
    /// A lane takes words only in as many groups as [`Lockstep::left`] says.
    end: Run,
    spread: Spread,
}

impl Vectors {
    /// Pops the tokens of `steps` groups of four values of every packet: reads and moves on its
    /// states and words, and fills its tokens from group `at` on. `ending` if a lane's groups before
    /// its packet's tail end meanwhile. All arguments are brought into their ranges first, so that
    /// no call reads or writes outside them.
    pub fn run(
        &self,
        slots: &[[u32; SLOTS]],
        at: usize,
        steps: usize,
        ending: bool,
        lockstep: &mut Lockstep,
    ) {
        let run = if ending { self.end } else { self.run };
        let (from, to) = (at.min(MAX_STEPS), at.saturating_add(steps).min(MAX_STEPS));
        let last = u8::try_from(slots.len().saturating_sub(1)).unwrap_or(u8::MAX);
        for tables in lockstep.tables.get_mut(from..to).unwrap_or(&mut []) {
            for table in tables.as_flattened_mut() {
                *table = (*table).min(last);
            }
        }
        for words in &mut lockstep.words {
            *words = (*words).min(MAX_BYTES);
        }
        if slots.is_empty() || from > to {
            return;
        }
        // SAFETY: the arguments are in their ranges, and `Kernel::vectors` gives a kernel only to a
        // machine that has its instructions.
        #[expect(unsafe_code, reason = "functions with target features are unsafe to call")]
        unsafe {
            run(slots, from, to, lockstep);
        }
    }
}

impl Vectors {
    /// As [`Raw::values_by`](codec_core::internals::rans::lanes::Raw::values_by) wants it.
    pub fn spread(&self, raw_bits: u8, plane: &[u8], bit: usize, tokens: &[u8], out: &mut [i16]) -> usize {
        // SAFETY: `Kernel::vectors` gives a kernel only to a machine that has its instructions.
        #[expect(unsafe_code, reason = "functions with target features are unsafe to call")]
        unsafe {
            (self.spread)(raw_bits, plane, bit, tokens, out)
        }
    }
}
