//! Which kernels there are, which of them this machine has, and what they do.

#[cfg(target_arch = "x86_64")]
mod avx2;
#[cfg(target_arch = "x86_64")]
mod avx512;

use codec_core::rans::{lanes::LANES, table::SLOTS};

/// Most packets in lockstep.
pub(crate) const MOST_PACKETS: usize = 16;
/// Most groups of four values per call.
pub(crate) const MOST_STEPS: usize = 128;
/// Longest body that fits a packet's buffer; longer ones are left to the scalar decoder.
pub(crate) const MOST_BYTES: usize = 1408;
/// Bytes of a packet's buffer: a call takes at most 8 bytes a step, and one load looks ahead 8.
pub(crate) const BUFFER_BYTES: usize = MOST_BYTES + 8 * MOST_STEPS + 8;

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
                    && is_x86_feature_detected!("popcnt")
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
        let (packets, run): (usize, Run) = match self {
            Self::Scalar => return None,
            #[cfg(target_arch = "x86_64")]
            Self::Avx2 => (avx2::PACKETS, avx2::run),
            #[cfg(target_arch = "x86_64")]
            Self::Avx512 => (avx512::PACKETS, avx512::run),
            #[cfg(not(target_arch = "x86_64"))]
            _ => return None,
        };
        self.is_here().then_some(Vectors { packets, run })
    }
}

/// Pops the tokens of groups `from..to` of four values of every packet.
///
/// # Safety
/// `from <= to <= MOST_STEPS`, bases and offsets are in the ranges that [`Lockstep`] states, and
/// the machine has the kernel's instructions.
type Run = unsafe fn(slots: &[[u32; SLOTS]], from: usize, to: usize, lockstep: &mut Lockstep);

/// A kernel that this machine has.
#[derive(Clone, Copy)]
pub(crate) struct Vectors {
    /// Packets in lockstep, at most [`MOST_PACKETS`].
    pub packets: usize,
    run: Run,
}

impl Vectors {
    /// Pops the tokens of `steps` groups of four values of every packet: reads and moves on its
    /// states and words, and fills its tokens from group `at` on. All arguments are brought into
    /// their ranges first, so that no call reads or writes outside them.
    pub fn run(&self, slots: &[[u32; SLOTS]], at: usize, steps: usize, lockstep: &mut Lockstep) {
        let last = (slots.len() * SLOTS).saturating_sub(SLOTS) as u32;
        for base in lockstep.base.as_flattened_mut() {
            *base = (*base).min(last);
        }
        for words in &mut lockstep.words {
            *words = (*words).min(MOST_BYTES);
        }
        if slots.is_empty() || slots.len() > i32::MAX as usize / SLOTS {
            return;
        }
        // SAFETY: the arguments are in their ranges, and `Kernel::vectors` gives a kernel only to a
        // machine that has its instructions.
        #[expect(unsafe_code, reason = "functions with target features are unsafe to call")]
        unsafe {
            (self.run)(slots, at.min(MOST_STEPS), at.saturating_add(steps).min(MOST_STEPS), lockstep);
        }
    }
}

/// The packets in lockstep, lane by lane.
pub(crate) struct Lockstep {
    pub state: [[u32; LANES]; MOST_PACKETS],
    /// First slot of each lane's table, at most that of the last table.
    pub base: [[u32; LANES]; MOST_PACKETS],
    /// Offset of the next word in each packet's buffer, at most [`MOST_BYTES`] before a call.
    pub words: [usize; MOST_PACKETS],
    pub tokens: [[u8; LANES * MOST_STEPS]; MOST_PACKETS],
    pub bytes: [[u8; BUFFER_BYTES]; MOST_PACKETS],
}

/// For each set of lanes that take a word: which of the next four words goes to which lane, as a
/// byte shuffle of 32-bit lanes, the upper halves zero.
#[cfg(target_arch = "x86_64")]
static TAKE: [[u8; 16]; 16] = {
    let mut rows = [[0x80u8; 16]; 16];
    let mut set = 0;
    while set < 16 {
        let (mut lane, mut word) = (0, 0);
        while lane < 4 {
            if set >> lane & 1 == 1 {
                rows[set][4 * lane] = 2 * word;
                rows[set][4 * lane + 1] = 2 * word + 1;
                word += 1;
            }
            lane += 1;
        }
        set += 1;
    }
    rows
};
