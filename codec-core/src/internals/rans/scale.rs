//! The numbers that all tables of the `dgs1` coder share.

/// log2 of the sum of all frequencies.
pub const PRECISION: u32 = 11;
/// The sum of all frequencies.
pub const SCALE: u32 = 1 << PRECISION;
/// Slots of a decode table.
pub const SLOTS: usize = SCALE as usize;
/// The token that announces an escaped value.
pub const ESCAPE: u8 = 0;
