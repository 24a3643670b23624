//! Weighs what a piece adds by how much of it the viewer sees: the *viewport weight*.
//!
//! Utilities are means over cameras around the scene; a viewer is one camera, and may be close to one side of
//! it. Of a group that lies in a ball of radius r, at distance d from the viewer and at angle θ from where
//! it looks, with a = arcsin(r ÷ d) half the angle that the ball covers:
//!
//! ```text
//! weight   = floor + (1 − floor) · in_view · size        floor by level
//! in_view  = clamp((reach + margin + a − θ) ÷ (margin + 2a), 0, 1)
//! size     = clamp((usual ÷ max(d, r))², 1 ÷ most, most)
//! ```
//!
//! - `in_view`: a receipt does not say how wide the viewer's picture is. `reach` is half the width of the
//!   usual picture; `margin` has its corners, and what a viewer may turn before its next receipt is here. 1
//!   wholly inside `reach`, 0 wholly beyond `reach + margin`, and 1 around the viewer (d ≤ r).
//! - `size`: the picture that a group fills goes with distance⁻²; `usual` is the distance from which the
//!   utility was measured. A viewer where those cameras stood has size 1.
//! - `floor`: viewers turn, and then the base must be there. Nothing is ever worth 0.
//!
//! A group that lies in several places while it shows has the mean of their weights; a piece that is part of
//! several groups, the mean by their utility. A group whose place is not known, and everything while
//! the viewer has not said where it is, has weight 1 exactly.

use crate::{
    graph::{Ball, PacketGraph, Place, pieces::Contribution},
    viewpoint::Viewpoint,
};

/// Settings of the viewport weight.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct ViewportConfig {
    /// Angle from the viewing direction up to which everything is in view, degrees.
    pub reach_degrees: f64,
    /// Angle beyond it over which what is in view fades, degrees.
    pub margin_degrees: f64,
    /// Weight of what is out of view, by level, 0..=1.
    pub floor: [f64; 4],
    /// Most that nearness adds to a weight, and the inverse of the most that distance takes, at least 1.
    pub most: f64,
}

impl Default for ViewportConfig {
    /// A picture of 16 : 9 that is 45° high is 73° wide; its corners lie in the margin.
    fn default() -> Self {
        Self { reach_degrees: 36.0, margin_degrees: 12.0, floor: [0.2, 0.05, 0.02, 0.01], most: 8.0 }
    }
}

impl ViewportConfig {
    /// Weight of a piece that adds `parts`.
    pub(super) fn weight(&self, viewpoint: &Viewpoint, graph: &PacketGraph, parts: &[Contribution]) -> f64 {
        let weights = parts.iter().map(|part| {
            let group = &graph.groups()[part.group.at()];
            let floor = self.floor[usize::from(group.level()).min(self.floor.len() - 1)];
            let weight = group.place.as_ref().map_or(1.0, |place| self.of_place(viewpoint, place, floor));
            (part.utility * f64::from(part.last - part.first + 1), weight)
        });
        let (mut adds, mut sum, mut plain) = (0.0, 0.0, 0.0);
        for (utility, weight) in weights {
            adds += utility;
            sum += utility * weight;
            plain += weight;
        }
        match parts.len() {
            0 => 1.0,
            _ if adds > 0.0 => sum / adds,
            count => plain / count as f64,
        }
    }

    fn of_place(&self, viewpoint: &Viewpoint, place: &Place, floor: f64) -> f64 {
        let balls = place.balls();
        let seen: f64 =
            balls.iter().map(|ball| self.in_view(viewpoint, ball) * self.size(viewpoint, ball)).sum();
        floor + (1.0 - floor) * seen / balls.len() as f64
    }

    fn in_view(&self, viewpoint: &Viewpoint, ball: &Ball) -> f64 {
        let (distance, angle) = viewpoint.distance_and_angle(ball.centre());
        if distance <= ball.radius() {
            return 1.0;
        }
        let covers = (ball.radius() / distance).asin();
        let (reach, margin) = (self.reach_degrees.to_radians(), self.margin_degrees.to_radians());
        ((reach + margin + covers - angle) / (margin + 2.0 * covers)).clamp(0.0, 1.0)
    }

    fn size(&self, viewpoint: &Viewpoint, ball: &Ball) -> f64 {
        let (distance, _) = viewpoint.distance_and_angle(ball.centre());
        let nearer = ball.usual_distance() / distance.max(ball.radius()).max(f64::MIN_POSITIVE);
        (nearer * nearer).clamp(1.0 / self.most, self.most)
    }
}

#[cfg(test)]
mod tests {
    use codec_core::internals::wire::receipt::ViewerPose;
    use proptest::prelude::*;

    use super::*;
    use crate::graph::{GraphParts, GroupIndex, Synthetic};

    fn ahead() -> Viewpoint {
        Viewpoint::of(&ViewerPose { position: [0.0; 3], rotation: [1.0, 0.0, 0.0, 0.0] }).unwrap()
    }

    /// Points of a ball, from a fixed lattice.
    fn points(ball: &Ball) -> Vec<[f64; 3]> {
        let steps = || (-8..=8).map(|step| f64::from(step) / 8.0);
        let lattice = steps().flat_map(|x| steps().flat_map(move |y| steps().map(move |z| [x, y, z])));
        let inside = lattice.filter(|p| p.iter().map(|v| v * v).sum::<f64>() <= 1.0);
        inside.map(|p| std::array::from_fn(|k| ball.centre()[k] + ball.radius() * p[k])).collect()
    }

    /// Whether `point` lies in a picture of 16 : 9 that is 45° high: the obvious test, by projection.
    fn is_in_picture(point: [f64; 3]) -> bool {
        let [x, y, z] = point;
        let high = 22.5f64.to_radians().tan();
        z > 0.0 && (y / z).abs() <= high && (x / z).abs() <= high * 16.0 / 9.0
    }

    proptest! {
        /// The fast rule never takes away what the picture shows, and always what lies far outside.
        #[test]
        fn what_the_picture_shows_is_in_view(
            centre in proptest::array::uniform3(-10f64..10.0), radius in 0.0f64..4.0,
        ) {
            let (config, ball) = (ViewportConfig::default(), Ball::new(centre, radius, 5.0).unwrap());
            let points = points(&ball);
            let shown = points.iter().filter(|point| is_in_picture(**point)).count() as f64;
            let share = shown / points.len() as f64;
            let in_view = config.in_view(&ahead(), &ball);
            prop_assert!(share < 1.0 || in_view >= 0.5, "all is shown, in view {in_view}");
            prop_assert!(share == 0.0 || in_view > 0.0, "{share} is shown, in view {in_view}");
            // The lattice misses the point nearest to the picture, so a little may be left. Of a ball around
            // the viewer, something is always ahead.
            let beyond = |point: &[f64; 3]| ahead().distance_and_angle(*point).1.to_degrees() > 60.0;
            let is_aside = ahead().distance_and_angle(ball.centre()).0 > radius && points.iter().all(beyond);
            prop_assert!(!is_aside || in_view < 0.1, "all is far aside, in view {in_view}");
        }

        #[test]
        fn weights_are_positive_and_bounded_whatever_the_pose(
            position in proptest::array::uniform3(proptest::num::f32::NORMAL),
            rotation in proptest::array::uniform4(proptest::num::f32::NORMAL),
            centre in proptest::array::uniform3(-1e12f64..1e12), radius in 0.0f64..1e9, level in 0usize..4,
        ) {
            let Some(viewpoint) = Viewpoint::of(&ViewerPose { position, rotation }) else { return Ok(()) };
            let config = ViewportConfig::default();
            let place = Place::new(&[Ball::new(centre, radius, 1.0).unwrap()]).unwrap();
            let weight = config.of_place(&viewpoint, &place, config.floor[level]);
            prop_assert!((config.floor[level]..=config.most).contains(&weight), "{weight}");
        }
    }

    fn weight_at(centre: [f64; 3], level: usize) -> f64 {
        let config = ViewportConfig::default();
        let place = Place::new(&[Ball::new(centre, 0.5, 5.0).unwrap()]).unwrap();
        config.of_place(&ahead(), &place, config.floor[level])
    }

    #[test]
    fn nearer_weighs_more_and_behind_weighs_the_floor() {
        let config = ViewportConfig::default();
        assert!((weight_at([0.0, 0.0, 5.0], 1) - 1.0).abs() < 1e-12, "as measured");
        assert!(weight_at([0.0, 0.0, 3.0], 1) > 1.5 && weight_at([0.0, 0.0, 9.0], 1) < 0.5);
        for level in 0..4 {
            assert_eq!(weight_at([0.0, 0.0, -5.0], level), config.floor[level]);
        }
        assert!(config.floor.is_sorted_by(|lower, higher| lower > higher) && config.floor[3] > 0.0);
        // Around the viewer, where angles say nothing.
        let around = Ball::new([0.0, 0.0, -0.1], 0.5, 5.0).unwrap();
        assert_eq!(config.in_view(&ahead(), &around), 1.0);
        // From the inside of the picture to the outside it only falls.
        let turning: Vec<f64> = (0..=90)
            .map(|degrees| f64::from(degrees).to_radians())
            .map(|angle| weight_at([5.0 * angle.sin(), 0.0, 5.0 * angle.cos()], 2))
            .collect();
        assert!(turning.is_sorted_by(|before, after| *before >= after - 1e-9) && turning[30] > 0.99);
        assert!(turning[90] < 0.06, "{}", turning[90]);
    }

    #[test]
    fn a_piece_has_the_mean_of_its_groups_and_unknown_places_count_as_before() {
        let parts = Synthetic { frames: 30, ..Synthetic::default() }.build(1).unwrap().parts().clone();
        let part =
            |group, utility| Contribution { group: GroupIndex(group), first: 0, last: 9, utility, base: 0.0 };
        let config = ViewportConfig::default();
        let plain = PacketGraph::new(parts.clone()).unwrap();
        assert_eq!(config.weight(&ahead(), &plain, &[part(0, 2.0), part(1, 1.0)]), 1.0);
        let mut placed = GraphParts { groups: parts.groups.clone(), ..parts };
        let behind = Place::new(&[Ball::new([0.0, 0.0, -9.0], 1.0, 5.0).unwrap()]);
        placed.groups[0].place = behind;
        let floor = config.floor[usize::from(placed.groups[0].level())];
        let graph = PacketGraph::new(placed).unwrap();
        let weight = config.weight(&ahead(), &graph, &[part(0, 2.0), part(1, 1.0)]);
        assert!((weight - (2.0 * floor + 1.0) / 3.0).abs() < 1e-12, "{weight}");
        assert_eq!(config.weight(&ahead(), &graph, &[]), 1.0);
    }
}
