//! Places points on a surface and says where they are in every pose of it.
//!
//! Four times as many candidates as wanted are drawn, evenly by area, and the most crowded are removed one
//! by one (source: Yuksel 2015, weighted sample elimination): what is left is close to blue noise, so that
//! discs of one size cover the surface without holes. Candidates crowd each other only where their surfaces
//! face the same way, so both sides of a thin sheet are covered. Only the nearest [`MAX_CROWDING`] count,
//! which bounds the work on surfaces that lie on top of each other.

use std::collections::BinaryHeap;

use glam::{DMat3, DQuat, DVec3};
use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};
use rayon::prelude::*;

use super::{document::FORMAT, mesh::Mesh, surface::Surface};
use crate::scene::import::{error::ImportError, nearest::Tree};

/// Candidates per wanted sample.
const OVERSAMPLING: usize = 4;
/// Most neighbours that crowd a candidate. An even surface has about fifteen within reach.
const MAX_CROWDING: usize = 64;
/// Neighbours that decide the size of a disc.
const NEIGHBOURS: usize = 6;

/// A point that stays with its triangle.
#[derive(Clone, Copy, Debug)]
struct Sample {
    triangle: u32,
    weights: [f64; 3],
    colour: [f32; 4],
    sigma: f32,
}

/// The points placed on a surface, and as much of its mesh as they lie on.
pub(super) struct Placement {
    samples: Vec<Sample>,
    /// The triangles that hold a sample, and their vertices.
    pub mesh: Mesh,
    /// Area of each sample's triangle in the pose it was placed in.
    areas: Vec<f64>,
}

/// Where the samples are in one pose.
pub(super) struct PlacedFrame {
    pub positions: Vec<[f32; 3]>,
    /// wxyz; all zero where a triangle has no direction.
    pub rotations: Vec<[f32; 4]>,
    /// Length of each sample's triangle over its length in the first frame.
    pub growth: Vec<f32>,
}

impl Placement {
    /// Places `count` samples over `surface` as posed in `vertices`.
    ///
    /// # Errors
    /// A vertex that 32-bit floats do not hold, a surface without area, or one of which nothing is drawn.
    pub fn new(surface: &Surface, vertices: &[DVec3], count: usize, seed: u64) -> Result<Self, ImportError> {
        check_range(vertices)?;
        let mut total = 0.0;
        let mesh = &surface.mesh;
        let mut cumulative = Vec::with_capacity(mesh.triangles.len());
        for triangle in 0..mesh.triangles.len() as u32 {
            total += area(mesh.corners(triangle, vertices));
            cumulative.push(total);
        }
        if !(total.is_finite() && total > 0.0) {
            return Err(FORMAT.malformed("surface area", total, "a positive area"));
        }
        let drawn = count.saturating_mul(OVERSAMPLING);
        let candidates = draw(surface, &cumulative, drawn, seed);
        if candidates.is_empty() {
            return Err(FORMAT.malformed("surface", "no texel that is drawn", "some"));
        }
        let area = total * candidates.len() as f64 / drawn as f64;
        let count = count.min(candidates.len());

        let points: Vec<[f32; 3]> =
            candidates.iter().map(|s| point(s, mesh, vertices).as_vec3().to_array()).collect();
        let facing = |s: &Sample| normal(mesh.corners(s.triangle, vertices)).unwrap_or(DVec3::ZERO);
        let normals: Vec<DVec3> = candidates.iter().map(facing).collect();
        // Twice the largest radius discs of this number can have on this area.
        let reach = 2.0 * (area / (2.0 * 3f64.sqrt() * count as f64)).sqrt();
        let chosen = least_crowded(&Tree::new(&points), &points, &normals, count, reach);

        let points: Vec<[f32; 3]> = chosen.iter().map(|&i| points[i]).collect();
        let normals: Vec<DVec3> = chosen.iter().map(|&i| normals[i]).collect();
        let mut samples: Vec<Sample> = chosen.iter().map(|&i| candidates[i]).collect();
        let spacing = (2.0 * area / (3f64.sqrt() * count as f64)).sqrt();
        for (sample, sigma) in
            samples.iter_mut().zip(disc_sizes(&Tree::new(&points), &points, &normals, spacing))
        {
            sample.sigma = sigma;
        }
        let areas = samples.iter().map(|s| self::area(mesh.corners(s.triangle, vertices))).collect();
        let (mesh, renumbered) = mesh.reduced(samples.iter().map(|s| s.triangle));
        for (sample, triangle) in samples.iter_mut().zip(renumbered) {
            sample.triangle = triangle;
        }
        Ok(Self { samples, mesh, areas })
    }

    /// Number of samples.
    pub fn len(&self) -> usize {
        self.samples.len()
    }

    /// Standard deviation of each disc along the surface, at the first frame.
    pub fn sigmas(&self) -> impl Iterator<Item = f32> + '_ {
        self.samples.iter().map(|s| s.sigma)
    }

    /// Display colour and alpha of each.
    pub fn colours(&self) -> impl Iterator<Item = [f32; 4]> + '_ {
        self.samples.iter().map(|s| s.colour)
    }

    /// The samples with [`Placement::mesh`] posed as `vertices`.
    pub fn posed(&self, vertices: &[DVec3]) -> PlacedFrame {
        let turn = |s: &Sample| {
            let corners = self.mesh.corners(s.triangle, vertices);
            frame(corners).map_or([0.0; 4], |q| [q.w, q.x, q.y, q.z].map(|v| v as f32))
        };
        let growth = |(s, &before): (&Sample, &f64)| {
            let now = area(self.mesh.corners(s.triangle, vertices));
            if before > 0.0 { (now / before).sqrt().clamp(0.1, 10.0) as f32 } else { 1.0 }
        };
        let position = |s: &Sample| point(s, &self.mesh, vertices).as_vec3().to_array();
        PlacedFrame {
            positions: self.samples.iter().map(position).collect(),
            rotations: self.samples.iter().map(turn).collect(),
            growth: self.samples.iter().zip(&self.areas).map(growth).collect(),
        }
    }
}

/// Refuses vertices that are not finite, or become so as 32-bit floats.
fn check_range(vertices: &[DVec3]) -> Result<(), ImportError> {
    let most = f64::from(f32::MAX);
    for (i, vertex) in vertices.iter().enumerate() {
        if !vertex.is_finite() {
            let (found, allowed) = ("a value that is not finite", "finite values");
            return Err(FORMAT.malformed(format!("vertex {i}"), found, allowed));
        }
        let furthest = vertex.abs().max_element();
        if furthest > most {
            let (found, allowed) = (format!("{furthest:.3e}"), format!("up to {most:.3e}"));
            return Err(FORMAT.malformed(format!("vertex {i}"), found, allowed));
        }
    }
    Ok(())
}

/// Draws `drawn` samples evenly by area, `cumulative` being the area up to each triangle; those on texels
/// that are not drawn are left out.
fn draw(surface: &Surface, cumulative: &[f64], drawn: usize, seed: u64) -> Vec<Sample> {
    let mut rng = Pcg64Mcg::seed_from_u64(seed);
    let total = cumulative.last().copied().unwrap_or(0.0);
    let mut candidates = Vec::with_capacity(drawn);
    for i in 0..drawn {
        let at = (i as f64 + rng.random::<f64>()) / drawn as f64 * total;
        let triangle = cumulative.partition_point(|&c| c < at).min(cumulative.len() - 1) as u32;
        let (u, v): (f64, f64) = (rng.random(), rng.random());
        let weights = [1.0 - u.sqrt(), u.sqrt() * (1.0 - v), u.sqrt() * v];
        if let Some(colour) = surface.colour(triangle, weights) {
            candidates.push(Sample { triangle, weights, colour, sigma: 0.0 });
        }
    }
    candidates
}

/// The `count` least crowded of the tree's `points`, in their order. A point is crowded by the nearest
/// [`MAX_CROWDING`] within `reach` whose normals face its way; the most crowded goes first.
fn least_crowded(
    tree: &Tree<'_>,
    points: &[[f32; 3]],
    normals: &[DVec3],
    count: usize,
    reach: f64,
) -> Vec<usize> {
    let near = |i: usize| {
        let same_side = |j: usize| j != i && normals[i].dot(normals[j]) >= 0.0;
        tree.nearest_within(points[i], reach, MAX_CROWDING, same_side)
    };
    let crowding = |squared: f64| (1.0 - (squared.sqrt() / reach).min(1.0)).powi(8);
    let weight = |i: usize| near(i).into_iter().fold(0.0, |sum, (squared, _)| sum + crowding(squared));
    let mut weights: Vec<f64> = (0..points.len()).into_par_iter().map(weight).collect();
    // Weights are never negative (nor -0), so their bits order as they do. Entries go stale when a
    // neighbour goes; they are put back at their true place when they come up.
    let mut heap: BinaryHeap<(u64, usize)> =
        weights.iter().enumerate().map(|(i, w)| (w.to_bits(), i)).collect();
    let mut alive = vec![true; points.len()];
    let mut left = points.len();
    while left > count {
        let Some((bits, i)) = heap.pop() else { break };
        if weights[i].to_bits() != bits {
            heap.push((weights[i].to_bits(), i));
            continue;
        }
        alive[i] = false;
        left -= 1;
        // Where more than the bound crowd each other, not everyone in this list has this point in its
        // own: weights then end at zero early, never below.
        for (squared, j) in near(i) {
            weights[j] = (weights[j] - crowding(squared)).max(0.0);
        }
    }
    (0..points.len()).filter(|&i| alive[i]).collect()
}

/// Disc sizes from the distance to the six nearest on the same side, within a factor of two of what
/// even `spacing` gives. At 0.6 of the spacing, three neighbours leave no hole between them.
fn disc_sizes(tree: &Tree<'_>, points: &[[f32; 3]], normals: &[DVec3], spacing: f64) -> Vec<f32> {
    let size = |i: usize| {
        let near = tree.nearest(points[i], NEIGHBOURS, |j| j != i && normals[i].dot(normals[j]) >= 0.0);
        let mean = near.iter().map(|n| n.0.sqrt()).sum::<f64>() / near.len().max(1) as f64;
        (0.6 * mean.clamp(0.5 * spacing, 2.0 * spacing)) as f32
    };
    (0..points.len()).into_par_iter().map(size).collect()
}

fn point(sample: &Sample, mesh: &Mesh, vertices: &[DVec3]) -> DVec3 {
    let corners = mesh.corners(sample.triangle, vertices);
    corners.iter().zip(sample.weights).map(|(&c, w)| c * w).sum()
}

fn area([a, b, c]: [DVec3; 3]) -> f64 {
    0.5 * (b - a).cross(c - a).length()
}

fn normal([a, b, c]: [DVec3; 3]) -> Option<DVec3> {
    (b - a).cross(c - a).try_normalize()
}

/// The rotation that takes x along the first edge and z along the normal.
fn frame(corners: [DVec3; 3]) -> Option<DQuat> {
    let z = normal(corners)?;
    let x = (corners[1] - corners[0]).try_normalize()?;
    Some(DQuat::from_mat3(&DMat3::from_cols(x, z.cross(x), z)))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::import::nearest::tests::grows_too_fast;

    /// `n` points and their normals.
    type Cloud = fn(usize) -> (Vec<[f32; 3]>, Vec<DVec3>);

    fn even(n: usize, scale: f32) -> Vec<[f32; 3]> {
        // Two irrational steps fill the unit square evenly.
        let place = |i: usize| [(i as f64 * 0.618_034) % 1.0, (i as f64 * 0.754_878) % 1.0];
        (0..n).map(place).map(|[x, y]| [x as f32 * scale, y as f32 * scale, 0.0]).collect()
    }

    /// Steps that choosing a quarter of a cloud takes, `reach` being that of an even cloud of `area`.
    fn steps(cloud: Cloud, n: usize, area: f64) -> u64 {
        let (points, normals) = cloud(n);
        let tree = Tree::new(&points);
        let reach = 2.0 * (area / (2.0 * 3f64.sqrt() * (n / 4) as f64)).sqrt();
        assert_eq!(least_crowded(&tree, &points, &normals, n / 4, reach).len(), n / 4);
        tree.visits()
    }

    #[test]
    fn choosing_takes_n_log_n_steps_however_the_surface_lies() {
        let clouds: [(&str, Cloud, f64); 5] = [
            ("even", |n| (even(n, 1.0), vec![DVec3::Z; n]), 1.0),
            // As with a thousand sheets in one place: the area is theirs together.
            ("a thousand sheets", |n| (even(n, 1.0), vec![DVec3::Z; n]), 1000.0),
            ("ends of the range", |n| (even(n, 3e38), vec![DVec3::Z; n]), 9e76),
            ("one place", |n| (vec![[1.0; 3]; n], vec![DVec3::Z; n]), 1.0),
            ("no directions", |n| (even(n, 1.0), vec![DVec3::NAN; n]), 1.0),
        ];
        for (name, cloud, area) in clouds {
            let (few, many) = (steps(cloud, 5000, area), steps(cloud, 20_000, area));
            assert!(!grows_too_fast(few, many), "{name}: {few} steps for 5000 points, {many} for 20000");
        }
    }

    #[test]
    fn the_bound_on_neighbours_leaves_even_surfaces_as_they_are() {
        let points = even(4000, 1.0);
        let tree = Tree::new(&points);
        let reach = 2.0 * (1.0 / (2.0 * 3f64.sqrt() * 1000.0)).sqrt();
        let most = points.iter().map(|&p| tree.nearest_within(p, reach, usize::MAX, |_| true).len()).max();
        assert!(most.unwrap() <= MAX_CROWDING, "{most:?} within reach");
    }
}
