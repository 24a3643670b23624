//! Prices the motion that a cluster's track does not code.
//!
//! A stream moves a cluster by an affine map per frame, its track, which costs few bytes, and codes for each
//! Gaussian what that leaves (paper, section 3, equation 1), which costs most of the bytes of a moving scene.
//! Bits of a value rise with the logarithm of its size over its quantiser step, and so does this price. The
//! encoder chooses its clusters later; until then Gaussians are grouped as it groups them, by where they are
//! over the clip.

use glam::{DMat3, DVec3};
use serde::{Deserialize, Serialize};

use super::trajectory::{self, Trajectory};

/// Groups of a scene; the encoder makes about as many clusters of a scene of 15,000 Gaussians.
const GROUPS: usize = 64;
/// A quantiser step of what is left, extents: what is smaller costs next to nothing.
const STEP: f64 = 4e-4;
/// Share of the mean variance by which a flat or thin group is held to a map that keeps it as it is.
const RIDGE: f64 = 1e-3;

/// Which Gaussians move together: the group of each, none of those that stand still.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(crate) struct Groups(Vec<Option<u32>>);

impl Groups {
    /// Groups of those of the points that move, by their trajectories.
    pub(crate) fn of(points: &[Trajectory], moves: impl Fn(usize) -> bool) -> Self {
        let moving: Vec<usize> = (0..points.len()).filter(|&index| moves(index)).collect();
        let trajectories: Vec<Trajectory> = moving.iter().map(|&index| points[index]).collect();
        let chosen = trajectory::farthest(&trajectories, GROUPS);
        let centres: Vec<Trajectory> = chosen.into_iter().map(|index| trajectories[index]).collect();
        let nearest = trajectory::nearest(&trajectories, &centres, 1);
        let mut groups = vec![None; points.len()];
        for (&index, near) in moving.iter().zip(&nearest) {
            groups[index] = near.first().copied();
        }
        Self(groups)
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
            || self.0.len() == points && self.0.iter().flatten().all(|&group| (group as usize) < GROUPS)
    }

    /// Gives `each` the index of every point that moves and what the affine map of its group, of least
    /// squares, leaves of where it is: `moved` less the map of `rest`, scene units.
    pub(crate) fn each_residual(
        &self,
        rest: &[[f32; 3]],
        moved: impl Fn(usize) -> [f32; 3],
        mut each: impl FnMut(usize, DVec3),
    ) {
        let vector = |p: [f32; 3]| DVec3::from_array(p.map(f64::from));
        let points = || {
            let of_group = |(index, group): (usize, &Option<u32>)| group.map(|group| (index, group as usize));
            let at = |(index, group)| (index, group, vector(rest[index]), vector(moved(index)));
            self.0.iter().enumerate().filter_map(of_group).map(at)
        };
        let mut means = [(DVec3::ZERO, DVec3::ZERO, 0.0f64); GROUPS];
        for (_, group, p, x) in points() {
            let (of_rest, of_moved, count) = &mut means[group];
            *of_rest += p;
            *of_moved += x;
            *count += 1.0;
        }
        for (of_rest, of_moved, count) in &mut means {
            *of_rest /= count.max(1.0);
            *of_moved /= count.max(1.0);
        }
        let mut moments = [(DMat3::ZERO, DMat3::ZERO); GROUPS];
        for (_, group, p, x) in points() {
            let (p, x) = (p - means[group].0, x - means[group].1);
            moments[group].0 += outer(p, p);
            moments[group].1 += outer(x, p);
        }
        let maps = moments.map(|(of_rest, of_both)| {
            let trace = of_rest.x_axis.x + of_rest.y_axis.y + of_rest.z_axis.z;
            let ridge = DMat3::from_diagonal(DVec3::splat(RIDGE * trace / 3.0 + 1e-12));
            (of_both + ridge) * (of_rest + ridge).inverse()
        });
        for (index, group, p, x) in points() {
            each(index, x - means[group].1 - maps[group] * (p - means[group].0));
        }
    }
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

/// How what a residual costs, `ln(1 + |r|² / step²) / 2`, rises with it, per scene unit, in a scene whose
/// extent is `unit` scene units. The map of its group counts as given.
pub(crate) fn slope(residual: DVec3, unit: f64) -> DVec3 {
    residual / ((STEP * unit).powi(2) + residual.length_squared())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cloud(count: usize) -> Vec<[f32; 3]> {
        let at = |i: usize, k: f32| ((i as f32 * k).sin() * 43758.547).fract();
        (0..count).map(|i| [at(i, 12.9), at(i, 78.2), at(i, 37.7)]).collect()
    }

    fn grouped(points: &[[f32; 3]]) -> Groups {
        Groups::of(&points.iter().map(|&p| [p; _]).collect::<Vec<Trajectory>>(), |index| index != 7)
    }

    fn residuals(groups: &Groups, rest: &[[f32; 3]], moved: &[[f32; 3]]) -> Vec<(usize, DVec3)> {
        let mut out = Vec::new();
        groups.each_residual(rest, |index| moved[index], |index, residual| out.push((index, residual)));
        out
    }

    fn moved(points: &[[f32; 3]], by: impl Fn([f32; 3]) -> [f32; 3]) -> Vec<[f32; 3]> {
        points.iter().map(|&p| by(p)).collect()
    }

    #[test]
    fn affine_motion_is_free_and_other_motion_is_not() {
        let points = cloud(4000);
        let groups = grouped(&points);
        let largest = |residuals: Vec<(usize, DVec3)>| {
            assert!(residuals.len() == 3999 && residuals.iter().all(|(index, _)| *index != 7));
            residuals.iter().map(|(_, r)| r.length()).fold(0.0, f64::max)
        };
        let sheared = moved(&points, |[x, y, z]| [0.3 + x + 0.4 * y, 0.8 * y - 0.2 * z, z - 0.1 * x]);
        let of_affine = largest(residuals(&groups, &points, &sheared));
        assert!(of_affine < 2e-3, "{of_affine}");
        let bent = moved(&points, |[x, y, z]| [x, y + 0.3 * (20.0 * x).sin(), z]);
        let of_bent = largest(residuals(&groups, &points, &bent));
        assert!(of_bent > 0.1, "{of_bent}");
    }

    #[test]
    fn a_group_stays_that_of_its_point() {
        let points = cloud(500);
        let mut groups = grouped(&points);
        assert!(groups.is_sound(500) && !groups.is_sound(499));
        let bent = moved(&points, |[x, y, z]| [x * x, y, z]);
        let backwards: Vec<usize> = (0..500).rev().collect();
        let reversed = |values: &[[f32; 3]]| values.iter().rev().copied().collect::<Vec<_>>();
        let before = residuals(&groups, &points, &bent);
        groups.select(&backwards);
        let after = residuals(&groups, &reversed(&points), &reversed(&bent));
        assert!(before.len() == 499 && after.len() == 499);
        for ((a, before), (b, after)) in before.into_iter().zip(after.into_iter().rev()) {
            assert!(a + b == 499 && before.distance(after) < 1e-9);
        }
    }

    #[test]
    fn slopes_are_difference_quotients() {
        for size in [1e-5, 1e-3, 0.1] {
            let residual = size * DVec3::new(0.5, -1.0, 2.0);
            for axis in DVec3::AXES {
                let at = |change: f64| price(residual + change * size * axis, 1.3);
                let expected = (at(1e-4) - at(-1e-4)) / (2e-4 * size);
                let found = slope(residual, 1.3).dot(axis);
                assert!((found - expected).abs() < 1e-6 * expected.abs(), "{found} {expected}");
            }
        }
    }
}
