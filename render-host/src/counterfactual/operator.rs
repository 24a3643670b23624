//! Composes what splats do to the light from behind them: `x → C + T·x` on each of sixteen pixels.
//!
//! Such operators form a monoid: two in a row are one, and an absent splat is the identity.

use pulp::Simd;

use crate::{
    settings::NOTHING,
    stage::{TILE, blend::Lanes},
};

/// One operator on each pixel of a block.
#[derive(Clone, Copy, Debug)]
#[repr(C, align(64))]
pub(super) struct Operator {
    /// Share of the light from behind that comes through.
    pub t: Lanes,
    /// r, g, b that are added.
    pub rgb: [Lanes; 3],
}

impl Operator {
    pub(super) const IDENTITY: Self = Self { t: [1.0; TILE], rgb: [[0.0; TILE]; 3] };
}

/// Vectors that make up sixteen lanes.
#[inline(always)]
pub(super) const fn parts<S: Simd>() -> usize {
    TILE / S::F32_LANES
}

#[inline(always)]
pub(super) fn lanes<S: Simd>(row: &Lanes, part: usize) -> S::f32s {
    S::as_simd_f32s(row).0[part]
}

#[inline(always)]
pub(super) fn lanes_mut<S: Simd>(row: &mut Lanes, part: usize) -> &mut S::f32s {
    &mut S::as_mut_simd_f32s(row).0[part]
}

/// Some lanes of an operator, in registers.
#[derive(Clone, Copy)]
pub(super) struct OperatorPart<S: Simd> {
    pub t: S::f32s,
    pub rgb: [S::f32s; 3],
}

impl<S: Simd> OperatorPart<S> {
    #[inline(always)]
    pub(super) fn identity(simd: S) -> Self {
        Self { t: simd.splat_f32s(1.0), rgb: [simd.splat_f32s(0.0); 3] }
    }

    #[inline(always)]
    pub(super) fn load(from: &Operator, part: usize) -> Self {
        let [r, g, b] = &from.rgb;
        Self {
            t: lanes::<S>(&from.t, part),
            rgb: [lanes::<S>(r, part), lanes::<S>(g, part), lanes::<S>(b, part)],
        }
    }

    #[inline(always)]
    pub(super) fn store(self, to: &mut Operator, part: usize) {
        *lanes_mut::<S>(&mut to.t, part) = self.t;
        for (row, value) in to.rgb.iter_mut().zip(self.rgb) {
            *lanes_mut::<S>(row, part) = value;
        }
    }

    /// `self` in front of `behind`.
    #[inline(always)]
    pub(super) fn then(self, simd: S, behind: Self) -> Self {
        let [r, g, b] = self.rgb;
        Self {
            t: simd.mul_f32s(self.t, behind.t),
            rgb: [
                simd.mul_add_e_f32s(self.t, behind.rgb[0], r),
                simd.mul_add_e_f32s(self.t, behind.rgb[1], g),
                simd.mul_add_e_f32s(self.t, behind.rgb[2], b),
            ],
        }
    }

    /// `self` in front of a splat of `alpha` and `colour`.
    #[inline(always)]
    pub(super) fn splat(self, simd: S, alpha: S::f32s, colour: [f32; 3]) -> Self {
        let weight = simd.mul_f32s(alpha, self.t);
        let add = |c: usize| simd.mul_add_e_f32s(weight, simd.splat_f32s(colour[c]), self.rgb[c]);
        Self { t: simd.sub_f32s(self.t, weight), rgb: [add(0), add(1), add(2)] }.flushed(simd)
    }

    /// With 0 for what lets through less than [`NOTHING`].
    #[inline(always)]
    pub(super) fn flushed(self, simd: S) -> Self {
        Self { t: flush(simd, self.t), ..self }
    }
}

/// Operators that are composed between two flushes of what lets through next to nothing.
pub(super) const FLUSH_EVERY: usize = 8;

/// 0 for what is less than [`NOTHING`], so that products do not decay into subnormal numbers.
#[inline(always)]
pub(super) fn flush<S: Simd>(simd: S, t: S::f32s) -> S::f32s {
    let shows = simd.greater_than_or_equal_f32s(t, simd.splat_f32s(NOTHING));
    simd.select_f32s(shows, t, simd.splat_f32s(0.0))
}
