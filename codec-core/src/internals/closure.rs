//! Says what each level of a block needs, and so what can be shown of what has arrived.
//!
//! Bit `l` of a block's mask says that level `l` of that block has arrived. A level is usable if
//! all levels below have arrived too, and motion is usable only for blocks whose canonical base
//! has. Levels that hold no symbols count as arrived from the start. A *state* is the list of all
//! masks: 1 byte per block, cheap to copy, to thin out at random, and to render later.
//!
//! The rule is said once, in [`Needs::of`]; decoders, packet maps and schedulers ask it.

use crate::{
    ids::{ClusterId, EpochId, Level, Span},
    layout::Shape,
    wire::manifest::Manifest,
};

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

/// Levels in which a cell of `shape` holds symbols.
pub fn levels_with_symbols(shape: &Shape) -> Arrived {
    let mut levels = Arrived::default();
    for level in Level::ALL {
        if shape.level_len(level) > 0 {
            levels = levels.with(level);
        }
    }
    levels
}

/// The mask of a cell's blocks before any packet: levels without symbols have arrived.
pub fn initial(shape: &Shape) -> Arrived {
    Arrived(!levels_with_symbols(shape).0 & 0xf)
}

/// The highest level of a block of a motion cell that bends its Gaussians: none without a level above
/// the track, or without the block's canonical base.
pub const fn coefficient_level(motion: Arrived, canonical: Arrived) -> Option<Level> {
    match motion.level() {
        Some(level) if level.get() > Level::BASE.get() && canonical.usable() > 0 => Some(level),
        _ => None,
    }
}

/// What a level of a block needs directly. All of it concerns the same cluster, and the block of the
/// same number; what that needs in turn is asked in the same way.
///
/// ```
/// use codec_core::internals::{
///     closure::{Arrived, Needs},
///     ids::{EpochId, Level, Span, WindowId},
/// };
///
/// let (all, window) = (Arrived(0b1111), Span::Motion(WindowId(7)));
/// let coefficients = Needs::of(window, EpochId(2), all, Level::ALL[1]);
/// assert_eq!(coefficients.below, Some(Level::BASE));
/// assert_eq!(coefficients.base, Some(EpochId(2)));
/// // A track moves whatever there is of its cluster; only to be seen does it need a base.
/// let track = Needs::of(window, EpochId(2), all, Level::BASE);
/// assert_eq!((track.base, track.seen_with), (None, Some(EpochId(2))));
/// ```
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Needs {
    /// The next level below that holds symbols, of the same cell.
    pub below: Option<Level>,
    /// Level 0 of the canonical cell of this epoch: coefficients bend Gaussians that must be there.
    pub base: Option<EpochId>,
    /// Level 0 of the canonical cell of this epoch, without which the level is usable and changes no
    /// picture. Schedulers count it as a need, decoders do not.
    pub seen_with: Option<EpochId>,
}

impl Needs {
    /// What `level` of a block needs in a cell of `span`, which is or lies in `epoch` and holds symbols
    /// at the levels `with_symbols`.
    pub fn of(span: Span, epoch: EpochId, with_symbols: Arrived, level: Level) -> Self {
        let below = Level::ALL.into_iter().rev().filter(|&l| l < level).find(|&l| with_symbols.has(l));
        let moves = matches!(span, Span::Motion(_)).then_some(epoch);
        Self { below, base: moves.filter(|_| level > Level::BASE), seen_with: moves }
    }

    /// What `level` of `cluster` in `span` needs; `None` if there is no such cell.
    pub fn in_manifest(
        manifest: &Manifest<'_>,
        span: Span,
        cluster: ClusterId,
        level: Level,
    ) -> Option<Self> {
        let shape = Shape::of(manifest, span, cluster)?;
        Some(Self::of(span, manifest.epoch_of(span)?, levels_with_symbols(&shape), level))
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
