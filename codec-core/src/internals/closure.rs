//! What has arrived, so what can be shown: one byte per block and cell.
//!
//! Bit `l` of a block's mask says that level `l` of that block has arrived. A level is usable if
//! all levels below have arrived too, and motion is usable only for blocks whose canonical base
//! has. Levels that hold no symbols count as arrived from the start. A *state* is the list of all
//! masks: 1 byte per block, cheap to copy, to thin out at random, and to render later.

use crate::ids::Level;

/// Levels of a block, or of a cluster's group, that have arrived.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Arrived(pub u8);

impl Arrived {
    /// Whether `level` has arrived.
    pub const fn has(self, level: Level) -> bool {
        self.0 >> level.get() & 1 == 1
    }

    /// With `level` added.
    #[must_use]
    pub const fn with(self, level: Level) -> Self {
        Self(self.0 | 1 << level.get())
    }

    /// Without `level`.
    #[must_use]
    pub const fn without(self, level: Level) -> Self {
        Self(self.0 & !(1 << level.get()))
    }

    /// Number of levels usable from the base up, 0..=4; 0 is nothing, 4 is everything.
    pub const fn usable(self) -> usize {
        (self.0 & 0xf).trailing_ones() as usize
    }

    /// The highest usable level.
    pub const fn level(self) -> Option<Level> {
        match self.usable() {
            0 => None,
            n => Some(Level::ALL[n - 1]),
        }
    }
}

/// The slow, obvious closure: follows "needs the level below" one step at a time.
#[doc(hidden)]
pub fn naive_usable(arrived: impl Fn(Level) -> bool, level: Level) -> bool {
    match level.get().checked_sub(1).and_then(Level::new) {
        None => arrived(level),
        Some(below) => arrived(level) && naive_usable(arrived, below),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn usable_agrees_with_the_naive_closure_on_every_mask() {
        for mask in 0..16u8 {
            let arrived = Arrived(mask);
            let naive = Level::ALL.into_iter().filter(|&l| naive_usable(|l| arrived.has(l), l)).count();
            assert_eq!(arrived.usable(), naive, "mask {mask:04b}");
        }
    }

    #[test]
    fn a_missing_level_hides_those_above() {
        let arrived = Arrived(0b1111).without(Level::ALL[1]);
        assert_eq!(arrived.level(), Some(Level::BASE));
        assert_eq!(arrived.without(Level::BASE).level(), None);
        assert_eq!(arrived.with(Level::ALL[1]).level(), Some(Level::ALL[3]));
    }
}
