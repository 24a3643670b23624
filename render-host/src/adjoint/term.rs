//! Names for the terms of the chain rule, so that a test can take one away, or turn its sign, and see the
//! check fail.

/// A term of the chain rule.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(super) enum Term {
    /// What lies behind a splat shines less through it.
    Behind,
    /// Alpha at its clamp does not move.
    AlphaClamp,
    /// Slope of `u` along a row.
    Along,
    /// Slope of `u` down the rows of a tile.
    Shear,
    /// Slope of `v` down the rows of a tile.
    Down,
    /// Centre on the image plane, from where the ellipse lies.
    Centre,
    /// The ellipse's determinant.
    Determinant,
    /// The part of the determinant that dilation adds.
    Dilation,
    /// Correlation of the ellipse's axes.
    Correlation,
    /// Dimming by `antialiased`.
    Dimming,
    /// A farther Gaussian is smaller.
    Gain,
    /// The Jacobian depends on the direction.
    Slope,
    /// A farther Gaussian is nearer to the middle.
    Perspective,
    /// The quaternion's length does not matter.
    Tangent,
    /// Position moves the view direction of the harmonics.
    Direction,
    /// A colour clamped at 0 does not move.
    ColourClamp,
    /// The camera's turn turns the ellipse.
    PoseShape,
    /// The camera's turn moves its centre, and so the view direction.
    PoseDirection,
    /// A splat's own colour.
    Colour,
    /// A splat's alpha.
    Exponent,
    /// What shows of the background.
    Background,
    /// Moving along the image plane moves the centre.
    Place,
    /// The ellipse's height, by its variance.
    Variance,
    /// The determinant, by the area of its axes.
    Area,
    /// Lengths of the axes.
    AxisLength,
    /// Directions of the axes.
    Turn,
    /// Logit of opacity.
    Logit,
    /// Band 0 of the harmonics.
    Band0,
    /// The higher bands.
    Bands,
    /// The camera's move.
    PoseMove,
    /// The camera's turn moves the centre.
    PosePlace,
}

/// True when a test has taken the term away.
#[cfg(not(test))]
#[inline(always)]
pub(super) fn dropped(_: Term) -> bool {
    false
}

/// True when a test has turned the sign of the term.
#[cfg(not(test))]
#[inline(always)]
pub(super) fn flipped(_: Term) -> bool {
    false
}

/// `value`, or what a test has made of it.
#[inline(always)]
pub(super) fn keep(term: Term, value: f64) -> f64 {
    if dropped(term) {
        0.0
    } else if flipped(term) {
        -value
    } else {
        value
    }
}

#[cfg(test)]
pub(super) use damage::{CHOICES, DAMAGED, Damage, dropped, flipped};

#[cfg(test)]
mod damage {
    use std::cell::Cell;

    use super::Term;

    /// Terms that are a choice, not a summand: only taking them away means something.
    pub(in crate::adjoint) const CHOICES: [Term; 2] = [Term::AlphaClamp, Term::ColourClamp];

    /// What a test does to a term.
    #[derive(Clone, Copy, Debug, PartialEq, Eq)]
    pub(in crate::adjoint) enum Damage {
        Drop,
        Flip,
    }

    thread_local! {
        /// The term that is damaged on this thread.
        pub(in crate::adjoint) static DAMAGED: Cell<Option<(Term, Damage)>> = const { Cell::new(None) };
    }

    /// True when a test has taken `term` away.
    pub(in crate::adjoint) fn dropped(term: Term) -> bool {
        DAMAGED.get() == Some((term, Damage::Drop))
    }

    /// True when a test has turned the sign of `term`.
    pub(in crate::adjoint) fn flipped(term: Term) -> bool {
        DAMAGED.get() == Some((term, Damage::Flip))
    }

    impl Term {
        pub(in crate::adjoint) const ALL: [Self; 31] = [
            Self::Behind,
            Self::AlphaClamp,
            Self::Along,
            Self::Shear,
            Self::Down,
            Self::Centre,
            Self::Determinant,
            Self::Dilation,
            Self::Correlation,
            Self::Dimming,
            Self::Gain,
            Self::Slope,
            Self::Perspective,
            Self::Tangent,
            Self::Direction,
            Self::ColourClamp,
            Self::PoseShape,
            Self::PoseDirection,
            Self::Colour,
            Self::Exponent,
            Self::Background,
            Self::Place,
            Self::Variance,
            Self::Area,
            Self::AxisLength,
            Self::Turn,
            Self::Logit,
            Self::Band0,
            Self::Bands,
            Self::PoseMove,
            Self::PosePlace,
        ];
    }
}
