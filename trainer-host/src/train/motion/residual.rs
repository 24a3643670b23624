//! Prices the motion that a cluster's track does not code.
//!
//! A stream moves a cluster by an affine map per frame, its track, which costs few bytes, and codes for each
//! Gaussian what that leaves (paper, section 3, equation 1), which costs most of the bytes of a moving scene.
//! Bits of a value rise with the logarithm of its size over its quantiser step, and so does this price. The
//! encoder chooses its clusters later; until then neighbourhoods stand for them, which like them are found by
//! where Gaussians are over the clip.

use glam::{DMat3, DQuat, DVec3, DVec4};
use serde::{Deserialize, Serialize};

use super::trajectory::{self, Trajectory};

/// Neighbourhoods of a scene; the encoder makes about as many clusters of a scene of 15,000 Gaussians.
const MOST: usize = 64;
/// A quantiser step of what is left, extents: what is smaller costs next to nothing.
const STEP: f64 = 4e-4;
/// Share of the mean variance by which a flat or thin neighbourhood is held to the mean turn of its
/// Gaussians, as the encoder's fit of a pose is.
const RIDGE: f64 = 1e-3;

/// Where a Gaussian is and how it is turned: scene units, and a quaternion wxyz of any length.
pub(crate) type Placed = ([f32; 3], [f32; 4]);

/// Which Gaussians move together: the neighbourhood of each, none of those that stand still.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Neighbourhoods(Vec<Option<u32>>);

impl Neighbourhoods {
    /// Of those of the points that move, by their trajectories.
    pub(crate) fn of(points: &[Trajectory], moves: impl Fn(usize) -> bool) -> Self {
        let moving: Vec<usize> = (0..points.len()).filter(|&index| moves(index)).collect();
        let trajectories: Vec<Trajectory> = moving.iter().map(|&index| points[index]).collect();
        let chosen = trajectory::farthest(&trajectories, MOST);
        let centres: Vec<Trajectory> = chosen.into_iter().map(|index| trajectories[index]).collect();
        let nearest = trajectory::nearest(&trajectories, &centres, 1);
        let mut of_points = vec![None; points.len()];
        for (&index, near) in moving.iter().zip(&nearest) {
            of_points[index] = near.first().copied();
        }
        Self(of_points)
    }

    pub(crate) fn is_empty(&self) -> bool {
        self.0.is_empty()
    }

    /// Keeps the points of these indices, in this order.
    pub(crate) fn select(&mut self, indices: &[usize]) {
        if !self.is_empty() {
            self.0 = indices.iter().map(|&index| self.0[index]).collect();
        }
    }

    /// Whether what was read from a file can be used for so many points.
    pub(crate) fn is_sound(&self, points: usize) -> bool {
        self.is_empty()
            || self.0.len() == points && self.0.iter().flatten().all(|&number| (number as usize) < MOST)
    }

    /// Gives `each` the index of every Gaussian that moves, what the affine map of its neighbourhood, of
    /// least squares, leaves of where it is (`moved` less the map of `rest`, scene units), and that map's
    /// matrix.
    pub(crate) fn each_residual(
        &self,
        rest: impl Fn(usize) -> Placed,
        moved: impl Fn(usize) -> Placed,
        mut each: impl FnMut(usize, DVec3, DMat3),
    ) {
        let vector = |p: [f32; 3]| DVec3::from_array(p.map(f64::from));
        let points = || {
            let numbered =
                |(index, number): (usize, &Option<u32>)| number.map(|number| (index, number as usize));
            let at = |(index, number)| (index, number, vector(rest(index).0), vector(moved(index).0));
            self.0.iter().enumerate().filter_map(numbered).map(at)
        };
        let mut means = [(DVec3::ZERO, DVec3::ZERO, 0.0f64); MOST];
        for (_, number, p, x) in points() {
            let (of_rest, of_moved, count) = &mut means[number];
            *of_rest += p;
            *of_moved += x;
            *count += 1.0;
        }
        for (of_rest, of_moved, count) in &mut means {
            *of_rest /= count.max(1.0);
            *of_moved /= count.max(1.0);
        }
        let mut moments = [(DMat3::ZERO, DMat3::ZERO); MOST];
        for (_, number, p, x) in points() {
            let (p, x) = (p - means[number].0, x - means[number].1);
            moments[number].0 += outer(p, p);
            moments[number].1 += outer(x, p);
        }
        let mut turns = [DVec4::ZERO; MOST];
        for (index, number, ..) in points() {
            let turn = unit(moved(index).1) * unit(rest(index).1).conjugate();
            // A quaternion and its negative are one turn.
            let sign = if turns[number].dot(turn.into()) < 0.0 { -1.0 } else { 1.0 };
            turns[number] += sign * DVec4::from(turn);
        }
        let mut turns = turns.into_iter().map(|sum| DMat3::from_quat(unit_of(sum)));
        let maps = moments.map(|(of_rest, of_both)| {
            let turn = turns.next().unwrap_or(DMat3::IDENTITY);
            let trace = of_rest.x_axis.x + of_rest.y_axis.y + of_rest.z_axis.z;
            let ridge = RIDGE * trace / 3.0 + 1e-12;
            (of_both + turn * ridge) * (of_rest + DMat3::IDENTITY * ridge).inverse()
        });
        for (index, number, p, x) in points() {
            let map = maps[number];
            each(index, x - means[number].1 - map * (p - means[number].0), map);
        }
    }
}

/// The turn of a quaternion wxyz.
fn unit([w, x, y, z]: [f32; 4]) -> DQuat {
    unit_of(DVec4::from([x, y, z, w].map(f64::from)))
}

/// The turn of a quaternion xyzw, that of none of no length.
fn unit_of(xyzw: DVec4) -> DQuat {
    xyzw.try_normalize().map_or(DQuat::IDENTITY, DQuat::from_vec4)
}

/// The matrix `a bᵀ`.
fn outer(a: DVec3, b: DVec3) -> DMat3 {
    DMat3::from_cols(a * b.x, a * b.y, a * b.z)
}

/// What a residual costs, in nats, in a scene whose extent is `unit` scene units.
#[cfg(test)]
fn price(residual: DVec3, unit: f64) -> f64 {
    0.5 * (residual.length_squared() / (STEP * unit).powi(2)).ln_1p()
}

/// How what a residual costs, `ln(1 + |r|² / step²) / 2`, rises with where its point is moved to, and with
/// where it rests, per scene unit, in a scene whose extent is `unit` scene units. The map of its
/// neighbourhood, whose matrix is `map`, counts as given.
pub(crate) fn slopes(residual: DVec3, map: DMat3, unit: f64) -> [DVec3; 2] {
    let of_moved = residual / ((STEP * unit).powi(2) + residual.length_squared());
    [of_moved, -(map.transpose() * of_moved)]
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::encode::factorise::fit_pose;

    fn cloud(count: usize) -> Vec<[f32; 3]> {
        let at = |i: usize, k: f32| ((i as f32 * k).sin() * 43758.547).fract();
        (0..count).map(|i| [at(i, 12.9), at(i, 78.2), at(i, 37.7)]).collect()
    }

    fn neighbourhoods(points: &[[f32; 3]]) -> Neighbourhoods {
        Neighbourhoods::of(&points.iter().map(|&p| [p; _]).collect::<Vec<Trajectory>>(), |index| index != 7)
    }

    const NO_TURN: [f32; 4] = [1.0, 0.0, 0.0, 0.0];

    fn residuals(found: &Neighbourhoods, rest: &[[f32; 3]], moved: &[[f32; 3]]) -> Vec<(usize, DVec3)> {
        turned_residuals(found, rest, moved, NO_TURN)
    }

    /// Of Gaussians that `turn` turns.
    fn turned_residuals(
        found: &Neighbourhoods,
        rest: &[[f32; 3]],
        moved: &[[f32; 3]],
        turn: [f32; 4],
    ) -> Vec<(usize, DVec3)> {
        let mut out = Vec::new();
        found.each_residual(
            |index| (rest[index], NO_TURN),
            // A quaternion and its negative, of any length, are one turn.
            |index| (moved[index], turn.map(|v| if index % 2 == 0 { 4.0 * v } else { -v })),
            |index, residual, _| out.push((index, residual)),
        );
        out
    }

    /// The encoder sends a turn of a flat part free: what it leaves costs nothing here either.
    #[test]
    fn a_flat_part_that_turns_leaves_nothing() {
        let points: Vec<[f32; 3]> = cloud(900).into_iter().map(|[x, y, z]| [x, y, 0.03 * z]).collect();
        let found = neighbourhoods(&points);
        let (sin, cos) = 0.7f32.sin_cos();
        let turned = moved(&points, |[x, y, z]| [x, cos * y - sin * z, sin * y + cos * z]);
        let turn = [0.35f32.cos(), 0.35f32.sin(), 0.0, 0.0];
        let most = |residuals: Vec<(usize, DVec3)>| {
            residuals.into_iter().map(|(_, residual)| residual.length()).fold(0.0, f64::max)
        };
        let left = most(turned_residuals(&found, &points, &turned, turn));
        assert!(left < 1e-6, "{left}");
        let unturned = most(residuals(&found, &points, &turned));
        assert!(unturned > STEP, "towards no turn it leaves {unturned}");
    }

    fn moved(points: &[[f32; 3]], by: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<[f32; 3]> {
        points.iter().map(|&p| by(p)).collect()
    }

    #[test]
    fn affine_motion_is_free_and_other_motion_is_not() {
        let points = cloud(4000);
        let found = neighbourhoods(&points);
        let largest = |residuals: Vec<(usize, DVec3)>| {
            assert!(residuals.len() == 3999 && residuals.iter().all(|(index, _)| *index != 7));
            residuals.iter().map(|(_, r)| r.length()).fold(0.0, f64::max)
        };
        let sheared = moved(&points, |[x, y, z]| [0.3 + x + 0.4 * y, 0.8 * y - 0.2 * z, z - 0.1 * x]);
        let of_affine = largest(residuals(&found, &points, &sheared));
        assert!(of_affine < 2e-3, "{of_affine}");
        let bent = moved(&points, |[x, y, z]| [x, y + 0.3 * (20.0 * x).sin(), z]);
        let of_bent = largest(residuals(&found, &points, &bent));
        assert!(of_bent > 0.1, "{of_bent}");
    }

    #[test]
    fn a_neighbourhood_stays_that_of_its_point() {
        let points = cloud(500);
        let mut found = neighbourhoods(&points);
        assert!(found.is_sound(500) && !found.is_sound(499));
        let bent = moved(&points, |[x, y, z]| [x * x, y, z]);
        let backwards: Vec<usize> = (0..500).rev().collect();
        let reversed = |values: &[[f32; 3]]| values.iter().rev().copied().collect::<Vec<_>>();
        let before = residuals(&found, &points, &bent);
        found.select(&backwards);
        let after = residuals(&found, &reversed(&points), &reversed(&bent));
        assert!(before.len() == 499 && after.len() == 499);
        for ((a, before), (b, after)) in before.into_iter().zip(after.into_iter().rev()) {
            assert!(a + b == 499 && before.distance(after) < 1e-9);
        }
    }

    /// The encoder's own fit of an affine pose, of one neighbourhood after another.
    #[test]
    fn residuals_are_those_of_the_encoders_fit() {
        let points = cloud(900);
        let found = neighbourhoods(&points);
        let bent = moved(&points, |[x, y, z]| [x + 0.2 * y * z, y + 0.3 * (20.0 * x).sin(), z]);
        const TURN: [f32; 4] = [0.8, 0.0, 0.6, 0.0];
        let mut slow = vec![DVec3::NAN; points.len()];
        for number in 0..MOST as u32 {
            let members: Vec<usize> = (0..900).filter(|&index| found.0[index] == Some(number)).collect();
            let of = |places: &[[f32; 3]]| -> Vec<[f64; 3]> {
                members.iter().map(|&index| places[index].map(f64::from)).collect()
            };
            let (from, to) = (of(&points), of(&bent));
            let turn = unit(TURN);
            let pose = fit_pose(&from, &to, [0.0; 3], [turn.w, turn.x, turn.y, turn.z]);
            for ((&index, p), x) in members.iter().zip(from).zip(to) {
                let placed: [f64; 3] = (pose.translation + pose.linear * nalgebra::Vector3::from(p)).into();
                slow[index] = DVec3::from_array(x) - DVec3::from_array(placed);
            }
        }
        let furthest = |residuals: &[(usize, DVec3)]| {
            residuals.iter().map(|(index, residual)| residual.distance(slow[*index])).fold(0.0, f64::max)
        };
        let residuals = turned_residuals(&found, &points, &bent, TURN);
        assert!(residuals.len() == 899 && furthest(&residuals) < 1e-12, "{}", furthest(&residuals));
        // Of other neighbourhoods they are others.
        let scattered = Neighbourhoods((0..900).map(|index| Some(index % 64)).collect());
        assert!(furthest(&turned_residuals(&scattered, &points, &bent, TURN)[1..7]) > 1e-3);
    }

    #[test]
    fn slopes_are_difference_quotients() {
        for size in [1e-5, 1e-3, 0.1] {
            let residual = size * DVec3::new(0.5, -1.0, 2.0);
            for axis in DVec3::AXES {
                let at = |change: f64| price(residual + change * size * axis, 1.3);
                let expected = (at(1e-4) - at(-1e-4)) / (2e-4 * size);
                let found = slopes(residual, DMat3::IDENTITY, 1.3)[0].dot(axis);
                assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} {expected}");
            }
        }
    }

    /// Where motion is affine but for a little, a point that rests elsewhere is moved elsewhere, and costs
    /// what it did.
    #[test]
    fn a_point_that_rests_elsewhere_costs_what_its_motion_leaves() {
        let points = cloud(900);
        let found = neighbourhoods(&points);
        let sheared = |[x, y, z]: [f32; 3]| [0.3 + x + 0.4 * y, 0.8 * y - 0.2 * z, z - 0.1 * x];
        let bent = |p: [f32; 3]| {
            let [x, y, z] = sheared(p);
            [x, y + 0.01 * (3.0 * p[0]).sin(), z]
        };
        let to = moved(&points, bent);
        let (mut along, mut without) = (0.0f64, 0.0f64);
        let each = |index: usize, residual: DVec3, map: DMat3| {
            let [of_moved, of_rest] = slopes(residual, map, 1.0);
            for axis in DVec3::AXES {
                let shifted = |by: f64| {
                    let p = DVec3::from_array(points[index].map(f64::from)) + by * axis;
                    DVec3::from_array(bent(p.as_vec3().to_array()).map(f64::from))
                };
                let turned = (shifted(1e-2) - shifted(-1e-2)) / 2e-2;
                let at = |by: f64| price(residual + by * (turned - map * axis), 1.0);
                let expected = (at(1e-6) - at(-1e-6)) / 2e-6;
                let slope = of_moved.dot(turned) + of_rest.dot(axis);
                assert!((slope - expected).abs() < 1e-4 * (1.0 + expected.abs()), "{slope} {expected}");
                along += slope.abs();
                without += of_moved.dot(turned).abs();
            }
        };
        found.each_residual(|index| (points[index], NO_TURN), |index| (to[index], NO_TURN), each);
        assert!(along < 0.3 * without, "{along} {without}");
    }
}
