//! Compares points by where they are over the whole clip, so that what meets for an instant stays apart.
//!
//! A ball that touches a plate at the canonical instant is near it there and nowhere else: nodes and the
//! Gaussians that follow them are chosen by the distance of their trajectories (SC-GS section 4.2 samples
//! times likewise).

use glam::Vec3;
use rayon::prelude::*;

/// Instants of a trajectory, evenly spread over the clip.
pub(crate) const INSTANTS: usize = 16;
/// Change of the distance of two nodes, of the distance, that makes the join between them a quarter as stiff.
const SOFT_STRAIN: f32 = 0.2;

/// Where a point is over the clip, scene units.
pub(crate) type Trajectory = [[f32; 3]; INSTANTS];

/// Times of the instants of a trajectory, 0 to 1.
pub(crate) fn times() -> impl Iterator<Item = f32> {
    (0..INSTANTS).map(|instant| instant as f32 / (INSTANTS - 1) as f32)
}

/// Mean square of the distance of two points over the clip.
fn distance_squared(a: &Trajectory, b: &Trajectory) -> f32 {
    let sum: f32 = a.as_flattened().iter().zip(b.as_flattened()).map(|(a, b)| (a - b) * (a - b)).sum();
    sum / INSTANTS as f32
}

/// Indices of `count` of the points, each the one farthest from those before; the first is the one nearest to
/// their mean.
pub(super) fn farthest(points: &[Trajectory], count: usize) -> Vec<usize> {
    let count = count.min(points.len());
    let mut mean = Trajectory::default();
    for point in points {
        mean.as_flattened_mut().iter_mut().zip(point.as_flattened()).for_each(|(sum, v)| *sum += v);
    }
    mean.as_flattened_mut().iter_mut().for_each(|v| *v /= points.len().max(1) as f32);
    let lowest = |values: &[f32]| (0..values.len()).min_by(|&a, &b| values[a].total_cmp(&values[b]));
    let from_mean: Vec<f32> = points.iter().map(|point| distance_squared(point, &mean)).collect();
    let mut at = lowest(&from_mean);
    let mut distances = vec![f32::MAX; points.len()];
    let mut chosen = Vec::with_capacity(count);
    while let Some(index) = at.filter(|_| chosen.len() < count) {
        chosen.push(index);
        let last = &points[index];
        distances
            .par_iter_mut()
            .with_min_len(2048)
            .zip(points)
            .for_each(|(distance, point)| *distance = distance.min(distance_squared(point, last)));
        at = (0..distances.len()).max_by(|&a, &b| distances[a].total_cmp(&distances[b]));
    }
    chosen
}

/// Of each point, the indices of the `count` nearest of `others`, nearest first; of equal ones the first.
pub(super) fn nearest(points: &[Trajectory], others: &[Trajectory], count: usize) -> Vec<Vec<u32>> {
    let of_point = |point: &Trajectory| {
        let mut near: Vec<(f32, u32)> = Vec::with_capacity(count + 1);
        for (index, other) in others.iter().enumerate() {
            let distance = distance_squared(point, other);
            if near.len() < count || near.last().is_some_and(|(most, _)| distance < *most) {
                let place = near.partition_point(|(before, _)| *before <= distance);
                near.insert(place, (distance, index as u32));
                near.truncate(count);
            }
        }
        near.into_iter().map(|(_, index)| index).collect()
    };
    points.par_iter().with_min_len(64).map(of_point).collect()
}

/// How firmly two points are joined, 0 to 1, by how little their distance changes over the clip.
pub(super) fn stiffness(a: &Trajectory, b: &Trajectory) -> f32 {
    let at = |instant: usize| Vec3::from_array(a[instant]).distance(Vec3::from_array(b[instant]));
    let mean = (0..INSTANTS).map(at).sum::<f32>() / INSTANTS as f32;
    let variance = (0..INSTANTS).map(|instant| (at(instant) - mean).powi(2)).sum::<f32>() / INSTANTS as f32;
    let strain = variance / (SOFT_STRAIN * mean).powi(2).max(1e-12);
    (1.0 + strain).powi(-2)
}

#[cfg(test)]
mod tests {
    use super::*;

    fn trajectory(start: [f32; 3], speed: [f32; 3]) -> Trajectory {
        let mut trajectory = Trajectory::default();
        for (place, time) in trajectory.iter_mut().zip(times()) {
            *place = std::array::from_fn(|axis| start[axis] + time * speed[axis]);
        }
        trajectory
    }

    fn cloud(count: usize) -> Vec<Trajectory> {
        let at = |i: usize, k: f32| ((i as f32 * k).sin() * 43758.547).fract();
        (0..count)
            .map(|i| trajectory([at(i, 12.9), at(i, 78.2), at(i, 37.7)], [at(i, 3.3), 0.0, 0.1]))
            .collect()
    }

    #[test]
    fn chosen_points_lie_further_apart_than_by_chance() {
        let points = cloud(500);
        let chosen: Vec<Trajectory> = farthest(&points, 20).into_iter().map(|index| points[index]).collect();
        let closest = |trajectories: &[Trajectory]| {
            let near = nearest(trajectories, trajectories, 2);
            let pairs = near.iter().enumerate();
            pairs
                .map(|(i, near)| distance_squared(&trajectories[i], &trajectories[near[1] as usize]))
                .fold(f32::MAX, f32::min)
        };
        assert_eq!(chosen.len(), 20);
        assert!(closest(&chosen) > 4.0 * closest(&points[..20]));
        assert!(farthest(&points, 900).len() == 500 && farthest(&[], 3).is_empty());
    }

    #[test]
    fn the_nearest_are_those_of_a_sorted_list() {
        let (points, others) = (cloud(40), cloud(90));
        for (point, near) in points.iter().zip(nearest(&points, &others, 5)) {
            let mut sorted: Vec<u32> = (0..90).collect();
            sorted.sort_by(|&a, &b| {
                let to = |index: u32| distance_squared(point, &others[index as usize]);
                to(a).total_cmp(&to(b))
            });
            assert_eq!(near, sorted[..5]);
        }
    }

    #[test]
    fn what_meets_for_an_instant_is_neither_near_nor_joined() {
        let plate = trajectory([0.0; 3], [0.0; 3]);
        let far_on_the_plate = trajectory([0.4, 0.0, 0.0], [0.0; 3]);
        // Touches the plate at the start and rises.
        let ball = trajectory([0.01, 0.0, 0.0], [0.0, 0.0, 2.0]);
        let top_of_the_ball = trajectory([0.01, 0.0, 0.3], [0.0, 0.0, 2.0]);
        assert_eq!(nearest(&[plate], &[ball, far_on_the_plate], 1), [[1]]);
        assert!(stiffness(&plate, &far_on_the_plate) > 0.999 && stiffness(&ball, &top_of_the_ball) > 0.999);
        assert!(stiffness(&plate, &ball) < 0.05);
    }
}
