//! Nested quantisers: what each level knows of a value, both directions in one file.
//!
//! The finest index of a value is `q₃ = round(value / step)`. Level `l` knows
//! `q_l = round(q_{l+1} / ratio)`, so level `l + 1` adds one small symbol
//! `r = q_{l+1} − ratio · q_l`. With an odd ratio the cells of level `l + 1` tile those of level
//! `l` exactly and each is reconstructed at its centre, so the largest error shrinks by the ratio
//! with every level: monotone by construction. A ratio of 1 means that the level adds nothing,
//! and then costs nothing.

use crate::{cursor::in_range, error::Result, ids::Level};

/// Attribute classes of a Gaussian, in coding order.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
#[repr(u8)]
pub enum Class {
    /// Position (canonical) or its temporal coefficients (motion); scene units.
    Position,
    /// Natural log of the scale.
    Scale,
    /// Rotation: modified Rodrigues parameters (canonical), relative rotation (motion).
    Rotation,
    /// Linear opacity, 0..=1.
    Opacity,
    /// Band-0 colour coefficients.
    Sh0,
    /// Band 1: 3 coefficients × 3 channels.
    Sh1,
    /// Band 2: 5 × 3.
    Sh2,
    /// Band 3: 7 × 3.
    Sh3,
}

impl Class {
    /// Number of classes.
    pub const COUNT: usize = 8;
    /// Number of classes that can move: the first five.
    pub const MOVING: usize = 5;
    /// All, in coding order.
    pub const ALL: [Self; Self::COUNT] = [
        Self::Position,
        Self::Scale,
        Self::Rotation,
        Self::Opacity,
        Self::Sh0,
        Self::Sh1,
        Self::Sh2,
        Self::Sh3,
    ];

    /// As an index, 0..8.
    pub const fn index(self) -> usize {
        self as usize
    }

    /// Components per Gaussian in profile `dgs1`.
    pub const fn components(self) -> usize {
        match self {
            Self::Position | Self::Scale | Self::Rotation | Self::Sh0 => 3,
            Self::Opacity => 1,
            Self::Sh1 => 9,
            Self::Sh2 => 15,
            Self::Sh3 => 21,
        }
    }

    /// The level at which the class appears: harmonic band b waits for level b.
    pub const fn first_level(self) -> Level {
        match self {
            Self::Sh1 => Level::ALL[1],
            Self::Sh2 => Level::ALL[2],
            Self::Sh3 => Level::ALL[3],
            _ => Level::BASE,
        }
    }

    /// Whether triples of its components go together, so that they may be coded as [`decorrelate`] makes
    /// them.
    pub const fn decorrelates(self) -> bool {
        !matches!(self, Self::Position | Self::Rotation | Self::Opacity)
    }

    /// The harmonic degree a cluster needs for this class to exist.
    pub const fn sh_degree(self) -> u8 {
        match self {
            Self::Sh1 => 1,
            Self::Sh2 => 2,
            Self::Sh3 => 3,
            _ => 0,
        }
    }
}

/// A nested quantiser.
#[derive(Clone, Copy, Debug, PartialEq)]
#[cfg_attr(feature = "defmt", derive(defmt::Format))]
pub struct Quantiser {
    /// Step at level 3. Invariant: finite, in [`Quantiser::STEP_RANGE`].
    step: f32,
    /// `ratio[l]`: step of level `l` over step of level `l + 1`. Invariant: ≥ 1.
    ratio: [u8; 3],
    /// Whether the first symbol is coded as the difference to the Gaussian before it in its block.
    predicted: bool,
    /// Whether triples of components are coded as [`decorrelate`] makes them.
    decorrelated: bool,
}

impl Quantiser {
    /// Smallest and largest step.
    pub const STEP_RANGE: (f32, f32) = (1e-9, 1e9);
    /// Bytes on the wire: step f32, three ratios, flags.
    pub const BYTES: usize = 8;

    /// A quantiser of `step` at level 3.
    ///
    /// # Errors
    /// A step that is not finite or out of range, in billionths rounded down (what is not a number as 0); or
    /// a ratio of 0.
    pub fn new(step: f32, ratio: [u8; 3], predicted: bool) -> Result<Self> {
        let (low, high) = Self::STEP_RANGE;
        if !(step >= low && step <= high) {
            // Rounded down, what is too small is below 1.
            let billionths = (f64::from(step) * 1e9) as u64;
            let allowed = (1, 1_000_000_000_000_000_000);
            return Err(crate::Error::illegal("quantiser.step_billionths", 0, billionths, allowed));
        }
        for (i, r) in ratio.into_iter().enumerate() {
            in_range("quantiser.ratio", 4 + i, r, 1, u8::MAX)?;
        }
        Ok(Self { step, ratio, predicted, decorrelated: false })
    }

    /// The same quantiser for triples of components as [`decorrelate`] makes them if `decorrelated`,
    /// else for the components themselves.
    #[must_use]
    pub const fn with_decorrelated(self, decorrelated: bool) -> Self {
        Self { decorrelated, ..self }
    }

    /// Whether triples of components are coded as [`decorrelate`] makes them.
    pub const fn decorrelated(&self) -> bool {
        self.decorrelated
    }

    /// Whether symbols of the first level are differences to the previous Gaussian of the block.
    pub const fn predicted(&self) -> bool {
        self.predicted
    }

    /// The ratio by which `level` refines the level below; 1 for the base.
    pub const fn ratio(&self, level: Level) -> u8 {
        match level.get() {
            0 => 1,
            1 => self.ratio[0],
            2 => self.ratio[1],
            _ => self.ratio[2],
        }
    }

    /// Step known at `level`.
    pub fn step(&self, level: Level) -> f32 {
        let mut step = self.step;
        for &r in self.ratio.iter().skip(level.index()) {
            step *= f32::from(r);
        }
        step
    }

    /// Whether `level` carries a symbol for a class that appears at `first`.
    pub const fn has_symbol(&self, level: Level, first: Level) -> bool {
        level.get() == first.get() || (level.get() > first.get() && self.ratio(level) > 1)
    }

    /// The index of `value` at the finest level, within ±1e9.
    pub fn index(&self, value: f32) -> i32 {
        // ±1e9 leaves room for the sums below in i32; the cast takes NaN to 0.
        let scaled = (value / self.step).clamp(-1e9, 1e9);
        (scaled + if scaled < 0.0 { -0.5 } else { 0.5 }) as i32
    }

    /// Splits finest index `q` into its index at `first` and the refinement symbols above it.
    /// Entries below `first` are 0.
    pub fn split(&self, q: i32, first: Level) -> [i32; Level::COUNT] {
        let mut symbols = [0i32; Level::COUNT];
        let mut q = q;
        for level in Level::ALL.into_iter().rev() {
            if level == first {
                symbols[level.index()] = q;
                break;
            }
            let m = i32::from(self.ratio(level));
            let r = (q + m / 2).rem_euclid(m) - m / 2;
            symbols[level.index()] = r;
            q = (q - r) / m;
        }
        symbols
    }

    /// The index one level up: `q · ratio + r`, saturating on hostile input.
    pub const fn refine(&self, q: i32, r: i16, level: Level) -> i32 {
        q.saturating_mul(self.ratio(level) as i32).saturating_add(r as i32)
    }

    /// Bytes on the wire.
    pub fn to_bytes(&self) -> [u8; Self::BYTES] {
        let [a, b, c, d] = self.step.to_le_bytes();
        let [x, y, z] = self.ratio;
        [a, b, c, d, x, y, z, self.flags()]
    }

    /// The flag byte: bit 0 predicted, bit 1 decorrelated.
    pub fn flags(&self) -> u8 {
        u8::from(self.predicted) | u8::from(self.decorrelated) << 1
    }

    /// The quantiser of `bytes`, which [`Quantiser::check`] has let pass.
    pub(crate) fn from_bytes([a, b, c, d, x, y, z, flags]: [u8; Self::BYTES]) -> Self {
        Self {
            step: f32::from_le_bytes([a, b, c, d]),
            ratio: [x, y, z],
            predicted: flags & 1 == 1,
            decorrelated: flags & 2 == 2,
        }
    }

    /// Checks `bytes`, a quantiser at offset `place`, and gives it back.
    ///
    /// # Errors
    /// Flags that have no meaning, or what [`Quantiser::new`] refuses.
    pub(crate) fn check(bytes: [u8; Self::BYTES], place: usize) -> Result<Self> {
        let [.., flags] = bytes;
        in_range("quantiser.flags", place + 7, flags, 0, 3)?;
        let Self { step, ratio, predicted, decorrelated } = Self::from_bytes(bytes);
        let quantiser = Self::new(step, ratio, predicted);
        let quantiser = quantiser.map_err(|e| crate::Error { offset: place as u32 + e.offset, ..e })?;
        Ok(quantiser.with_decorrelated(decorrelated))
    }
}

/// 1/√3, 1/√2 and 1/√6.
const ROOTS: [f32; 3] = [0.577_350_3, core::f32::consts::FRAC_1_SQRT_2, 0.408_248_3];

/// Three components that go together (the channels of a colour, the axes of a scale) as their mean
/// and two differences, orthonormally: an error weighs the same on either side.
pub const fn decorrelate([a, b, c]: [f32; 3]) -> [f32; 3] {
    let [third, half, sixth] = ROOTS;
    [third * (a + b + c), half * (a - b), sixth * (a + b - 2.0 * c)]
}

/// The three components that [`decorrelate`] gives this for.
pub const fn recorrelate([mean, first, second]: [f32; 3]) -> [f32; 3] {
    let [third, half, sixth] = ROOTS;
    let level = third * mean + sixth * second;
    [level + half * first, level - half * first, third * mean - 2.0 * sixth * second]
}

#[cfg(test)]
mod tests {
    use super::*;
    use proptest::prelude::*;

    proptest! {
        #[test]
        fn levels_nest_and_the_error_bound_shrinks(
            value in -1000f32..1000.0, ratio in [0u8..4, 0..4, 0..4], first in 0u8..4,
        ) {
            let quantiser = Quantiser::new(0.01, ratio.map(|r| 2 * r + 1), false).unwrap();
            let first = Level::new(first).unwrap();
            let fine = quantiser.index(value);
            let symbols = quantiser.split(fine, first);
            let mut q = symbols[first.index()];
            for level in Level::ALL.into_iter().skip(first.index()) {
                if level > first {
                    let r = symbols[level.index()];
                    prop_assert!(r.unsigned_abs() <= u32::from(quantiser.ratio(level)) / 2);
                    q = quantiser.refine(q, r as i16, level);
                }
                let step = quantiser.step(level);
                // Half a cell, and the rounding of f32 at this magnitude.
                prop_assert!((q as f32 * step - value).abs() <= step * 0.5 + 1e-3);
            }
            prop_assert_eq!(q, fine);
        }
    }

    #[test]
    fn decorrelating_turns_without_stretching_and_back() {
        let length = |v: [f32; 3]| v.iter().map(|v| v * v).sum::<f32>();
        for v in [[1.0, 1.0, 1.0], [0.3, -2.0, 5.0], [1e18, -1e18, 1e18], [0.0; 3]] {
            let decorrelated = decorrelate(v);
            assert!((length(decorrelated) - length(v)).abs() <= 1e-6 * length(v), "{v:?}");
            for (back, v) in recorrelate(decorrelated).into_iter().zip(v) {
                assert!((back - v).abs() <= 1e-6 * (1.0 + v.abs()) && back.is_finite(), "{back} {v}");
            }
        }
        assert_eq!(decorrelate([2.0; 3])[1..], [0.0, 0.0]);
    }

    #[test]
    fn flags_come_back_and_others_are_refused() {
        for (predicted, decorrelated) in [(false, false), (true, false), (false, true), (true, true)] {
            let quantiser = Quantiser::new(0.5, [3; 3], predicted).unwrap().with_decorrelated(decorrelated);
            let mut bytes = quantiser.to_bytes();
            assert_eq!(Quantiser::check(bytes, 0), Ok(quantiser));
            bytes[7] |= 4;
            assert_eq!(Quantiser::check(bytes, 0).unwrap_err().field, "quantiser.flags");
        }
    }

    #[test]
    fn hostile_values_do_not_overflow() {
        let quantiser = Quantiser::new(1e-9, [255; 3], false).unwrap();
        for value in [f32::NAN, f32::INFINITY, -f32::INFINITY, 1e30] {
            let q = quantiser.index(value);
            let _ = quantiser.split(q, Level::BASE);
        }
        assert_eq!(quantiser.refine(i32::MAX, i16::MAX, Level::ALL[1]), i32::MAX);
        assert!(Quantiser::new(f32::NAN, [1; 3], false).is_err());
        assert!(Quantiser::new(1.0, [1, 0, 1], false).is_err());
    }
}
