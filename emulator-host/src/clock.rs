//! Holds time, size and rate as integers with their unit in the type.
//!
//! Arithmetic saturates: a far-away time stays far away instead of wrapping, in debug and release alike.

use std::{
    fmt,
    ops::{Add, AddAssign, Sub},
};

use serde::Serialize;

/// Nanoseconds of virtual time: an instant since the start of a run, or a span. Range 0 to about 584 years.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct Nanos(pub u64);

impl Nanos {
    /// The start of every run.
    pub const ZERO: Self = Self(0);
    /// Never.
    pub const MAX: Self = Self(u64::MAX);

    /// From microseconds.
    pub const fn from_us(us: u64) -> Self {
        Self(us.saturating_mul(1_000))
    }

    /// From milliseconds.
    pub const fn from_ms(ms: u64) -> Self {
        Self(ms.saturating_mul(1_000_000))
    }

    /// From seconds.
    pub const fn from_s(s: u64) -> Self {
        Self(s.saturating_mul(1_000_000_000))
    }

    /// Seconds, for reports only.
    pub fn as_s(self) -> f64 {
        self.0 as f64 / 1e9
    }

    /// Milliseconds, for reports only.
    pub fn as_ms(self) -> f64 {
        self.0 as f64 / 1e6
    }

    /// `self × factor`, saturating.
    #[must_use]
    pub const fn times(self, factor: u64) -> Self {
        Self(self.0.saturating_mul(factor))
    }

    /// Distance between two instants.
    #[must_use]
    pub const fn abs_diff(self, other: Self) -> Self {
        Self(self.0.abs_diff(other.0))
    }
}

impl Add for Nanos {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl AddAssign for Nanos {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Nanos {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

impl fmt::Display for Nanos {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{}.{:06} ms", self.0 / 1_000_000, self.0 % 1_000_000)
    }
}

/// A number of bytes.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct Bytes(pub u64);

impl Add for Bytes {
    type Output = Self;
    fn add(self, other: Self) -> Self {
        Self(self.0.saturating_add(other.0))
    }
}

impl AddAssign for Bytes {
    fn add_assign(&mut self, other: Self) {
        *self = *self + other;
    }
}

impl Sub for Bytes {
    type Output = Self;
    fn sub(self, other: Self) -> Self {
        Self(self.0.saturating_sub(other.0))
    }
}

/// Bits per second.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord, Hash, Serialize)]
#[serde(transparent)]
pub struct Rate(pub u64);

impl Rate {
    /// No bound.
    pub const MAX: Self = Self(u64::MAX);

    /// From kilobits (1000 bits) per second.
    pub const fn from_kbps(kbps: u64) -> Self {
        Self(kbps.saturating_mul(1_000))
    }

    /// From megabits (10⁶ bits) per second.
    pub const fn from_mbps(mbps: u64) -> Self {
        Self(mbps.saturating_mul(1_000_000))
    }

    /// The rate that moves `bytes` in `span`; [`Rate::MAX`] for an empty span.
    pub fn over(bytes: Bytes, span: Nanos) -> Self {
        if span.0 == 0 {
            return Self::MAX;
        }
        // 128-bit division is slow, and this one is on the path of every acknowledgement.
        match bytes.0.checked_mul(8_000_000_000) {
            Some(scaled) => Self(scaled / span.0),
            None => Self(saturate(u128::from(bytes.0) * 8_000_000_000 / u128::from(span.0))),
        }
    }

    /// Time to move `bytes`, rounded up; [`Nanos::MAX`] at rate zero.
    pub fn time_for(self, bytes: Bytes) -> Nanos {
        if self.0 == 0 {
            return Nanos::MAX;
        }
        match bytes.0.checked_mul(8_000_000_000) {
            Some(scaled) => Nanos(scaled.div_ceil(self.0)),
            None => Nanos(saturate((u128::from(bytes.0) * 8_000_000_000).div_ceil(u128::from(self.0)))),
        }
    }

    /// Whether [`Self::time_for`] `bytes` is at most `span`, which is some time and not never; without its
    /// division.
    pub fn moves_within(self, bytes: Bytes, span: Nanos) -> bool {
        self.0 > 0 && u128::from(bytes.0) * 8_000_000_000 <= u128::from(self.0) * u128::from(span.0)
    }

    /// Whole bytes moved in `span`, rounded down.
    pub fn bytes_in(self, span: Nanos) -> Bytes {
        match self.0.checked_mul(span.0) {
            Some(scaled) => Bytes(scaled / 8_000_000_000),
            None => Bytes(saturate(u128::from(self.0) * u128::from(span.0) / 8_000_000_000)),
        }
    }

    /// `self × numerator ÷ denominator`, saturating; a zero denominator gives [`Rate::MAX`].
    #[must_use]
    pub fn scaled(self, numerator: u64, denominator: u64) -> Self {
        if denominator == 0 {
            return Self::MAX;
        }
        match self.0.checked_mul(numerator) {
            Some(scaled) => Self(scaled / denominator),
            None => Self(saturate(u128::from(self.0) * u128::from(numerator) / u128::from(denominator))),
        }
    }
}

fn saturate(value: u128) -> u64 {
    u64::try_from(value).unwrap_or(u64::MAX)
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    #[test]
    fn serialisation_time_rounds_up_and_inverts() {
        let rate = Rate::from_mbps(12);
        assert_eq!(rate.time_for(Bytes(1500)), Nanos::from_ms(1));
        assert_eq!(rate.bytes_in(Nanos::from_ms(1)), Bytes(1500));
        assert_eq!(Rate(3).time_for(Bytes(1)), Nanos(2_666_666_667));
        assert_eq!(Rate(0).time_for(Bytes(1)), Nanos::MAX);
        assert_eq!(Rate::over(Bytes(1500), Nanos::from_ms(1)), rate);
    }

    proptest! {
        #[test]
        fn a_comparison_without_division_is_the_same(
            rate in prop_oneof![0u64..20, any::<u64>(), 1_000u64..1 << 30],
            bytes in prop_oneof![0u64..9, any::<u64>(), 0u64..1 << 24],
            span in 0..u64::MAX,
            off in -2i64..3,
        ) {
            let (rate, bytes) = (Rate(rate), Bytes(bytes));
            let near = rate.time_for(bytes).0.saturating_add_signed(off).min(u64::MAX - 1);
            for span in [Nanos(span), Nanos(near)] {
                prop_assert_eq!(rate.moves_within(bytes, span), rate.time_for(bytes) <= span);
            }
        }
    }

    #[test]
    fn arithmetic_saturates() {
        assert_eq!(Nanos::ZERO - Nanos(1), Nanos::ZERO);
        assert_eq!(Nanos::MAX + Nanos(1), Nanos::MAX);
        assert_eq!(Rate::MAX.time_for(Bytes(u64::MAX)), Nanos(8_000_000_000));
    }
}
