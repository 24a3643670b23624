//! Names for the terms of the chain rule, so that a test can take one away and see the check fail.

/// A term of the chain rule that is easily forgotten.
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
    /// Centre on the film, from where the ellipse lies.
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
}

#[cfg(test)]
impl Term {
    pub(super) const ALL: [Self; 18] = [
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
    ];
}

#[cfg(test)]
thread_local! {
    /// The term that is missing on this thread.
    pub(super) static DROPPED: std::cell::Cell<Option<Term>> = const { std::cell::Cell::new(None) };
}

/// True when a test has taken `term` away.
#[inline(always)]
pub(super) fn dropped(term: Term) -> bool {
    #[cfg(test)]
    return DROPPED.get() == Some(term);
    #[cfg(not(test))]
    {
        let _ = term;
        false
    }
}

/// `value`, or 0 when a test has taken `term` away.
#[inline(always)]
pub(super) fn keep(term: Term, value: f64) -> f64 {
    if dropped(term) { 0.0 } else { value }
}
