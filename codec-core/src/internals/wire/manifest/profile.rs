//! A profile names a set of format choices; that of `paper` has two coders.

/// The named sets of format choices.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Profile {
    /// The paper's format: all-or-nothing groups, per-frame residuals, byte-wise rANS.
    Paper = 0,
    /// This project's format: slices that decode alone, transformed motion, four-lane rANS.
    Dgs1 = 1,
}

/// `head.profile` of profile `paper` with [`ChunkCoder::Context`].
pub const PAPER_CONTEXT: u8 = 2;

/// How the symbols of a `paper` chunk are coded.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub enum ChunkCoder {
    /// By two byte tables per group, which the manifest holds.
    Tables,
    /// By probabilities that follow the symbols of the chunk; no tables travel.
    Context,
}

impl ChunkCoder {
    /// The `head.profile` of a `paper` stream that is coded so.
    pub const fn profile_number(self) -> u8 {
        match self {
            Self::Tables => Profile::Paper as u8,
            Self::Context => PAPER_CONTEXT,
        }
    }
}
