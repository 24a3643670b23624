//! Says where in the scene a group lies, so that a scheduler can tell what a viewer sees of it.

use std::sync::Arc;

/// A ball that holds what a group shows at some time, and from how far the group's utility was measured.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Ball {
    centre: [f64; 3],
    radius: f64,
    usual_distance: f64,
}

impl Ball {
    /// The ball of `radius` around `centre`, scene units. `usual_distance` is that of the cameras that the
    /// group's utility was measured with: (mean of distance⁻²)^(−½). `None` unless all is finite, the radius
    /// not negative and the distance positive.
    pub fn new(centre: [f64; 3], radius: f64, usual_distance: f64) -> Option<Self> {
        let is_finite = centre.iter().chain([&radius, &usual_distance]).all(|v| v.is_finite());
        (is_finite && radius >= 0.0 && usual_distance > 0.0).then_some(Self {
            centre,
            radius,
            usual_distance,
        })
    }

    /// Its middle.
    pub fn centre(&self) -> [f64; 3] {
        self.centre
    }

    /// Its radius.
    pub fn radius(&self) -> f64 {
        self.radius
    }

    /// Distance of the cameras that the utility was measured with.
    pub fn usual_distance(&self) -> f64 {
        self.usual_distance
    }
}

/// Where a group lies while it shows: one ball, or several at times spread evenly over its frames. Cheap to
/// clone: the levels of a cluster share theirs.
#[derive(Clone, Debug, PartialEq)]
pub struct Place(Arc<[Ball]>);

impl Place {
    /// The place of `balls`; `None` without any.
    pub fn new(balls: &[Ball]) -> Option<Self> {
        (!balls.is_empty()).then(|| Self(balls.into()))
    }

    /// At least one.
    pub fn balls(&self) -> &[Ball] {
        &self.0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn balls_are_finite_and_places_hold_some() {
        let ball = Ball::new([1.0, 2.0, 3.0], 0.0, 5.0).unwrap();
        assert_eq!((ball.centre(), ball.radius(), ball.usual_distance()), ([1.0, 2.0, 3.0], 0.0, 5.0));
        for (centre, radius, distance) in [
            ([f64::NAN, 0.0, 0.0], 1.0, 1.0),
            ([0.0; 3], -1.0, 1.0),
            ([0.0; 3], f64::INFINITY, 1.0),
            ([0.0; 3], 1.0, 0.0),
        ] {
            assert_eq!(Ball::new(centre, radius, distance), None);
        }
        assert_eq!(Place::new(&[]), None);
        assert_eq!(Place::new(&[ball]).unwrap().balls(), [ball]);
    }
}
