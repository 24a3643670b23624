//! Packets in lockstep, lane by lane, as kernels take them.

use codec_core::internals::rans::lanes::LANES;
#[cfg(target_arch = "x86_64")]
use codec_core::internals::rans::table::SLOTS;

/// Most packets in lockstep.
pub(crate) const MAX_PACKETS: usize = 16;
/// Most groups of four values per call.
pub(crate) const MAX_STEPS: usize = 128;
/// Longest body that fits a packet's buffer; longer ones are left to the scalar decoder.
pub(crate) const MAX_BYTES: usize = 1408;
/// Bytes of a packet's buffer: a call takes at most 8 bytes a step, and one load looks ahead 16.
pub(crate) const BUFFER_BYTES: usize = MAX_BYTES + 8 * MAX_STEPS + 16;

/// The packets in lockstep, lane by lane.
pub(crate) struct Lockstep {
    pub state: [[u32; LANES]; MAX_PACKETS],
    /// Table of each lane in every group, none behind the last.
    pub tables: [[[u8; LANES]; MAX_PACKETS]; MAX_STEPS],
    /// Groups that each lane still takes words in, from the start of a call on, if any is ending.
    pub left: [[u32; LANES]; MAX_PACKETS],
    /// Offset of the next word in each packet's buffer, at most [`MAX_BYTES`] before a call.
    pub words: [usize; MAX_PACKETS],
    pub tokens: [[u8; LANES * MAX_STEPS]; MAX_PACKETS],
    pub bytes: [[u8; BUFFER_BYTES]; MAX_PACKETS],
}

/// What one word is worth in a byte shuffle that picks it: two bytes on, for both of its bytes.
#[cfg(target_arch = "x86_64")]
pub(crate) const WORD: i32 = 0x0202;
/// The shuffle of a 32-bit lane that picks the window's first word is [`WORD`] more than this; the
/// upper half becomes zero.
#[cfg(target_arch = "x86_64")]
pub(crate) const FIRST_WORD: i32 = (0x8080_0100_u32 as i32).wrapping_sub(WORD);
/// log2 of the slots of a table.
#[cfg(target_arch = "x86_64")]
pub(crate) const TABLE_BITS: u32 = SLOTS.ilog2();
