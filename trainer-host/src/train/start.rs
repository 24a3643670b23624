//! Makes the Gaussians that training starts with.

use codec_core::{Gaussian, ShDegree, internals::limits};
use glam::{DMat3, DVec3};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use rayon::prelude::*;
use render_host::{Camera, adjoint::loss::photograph::Photograph};
use serde::{Deserialize, Serialize};

use super::{
    error::TrainError,
    options::TrainOptions,
    views::{ColouredPoint, Dataset, PosedPhotograph, Start},
};
use crate::scene::{Instant, activation::SH_C0, import::nearest::Tree};

/// Cells of the visual hull along each side of its cube.
const HULL_CELLS: usize = 96;
/// Views of the visual hull are at most this far in time from the canonical instant.
pub(super) const HULL_TIME: f32 = 0.06;
/// Opacity that points start with.
const OPACITY: f32 = 0.18;

/// The cube that holds what moves.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub(super) struct Extent {
    pub(super) centre: [f64; 3],
    /// Half the side, scene units, above 0.
    pub(super) half_side: f64,
}

impl Extent {
    /// What `start` says, or else what all cameras see.
    pub(super) fn of(start: &Start, views: &[PosedPhotograph]) -> Self {
        let positions: Vec<[f32; 3]> = match start {
            Start::VisualHull => Vec::new(),
            Start::Points(points) => points.iter().map(|point| point.position).collect(),
            Start::Gaussians(instant, _) => instant.gaussians.iter().map(|g| g.position).collect(),
        };
        if positions.is_empty() { Self::of_cameras(views) } else { Self::of_positions(&positions) }
    }

    /// The median and the distance from it, along an axis, that holds 98 % of positions.
    fn of_positions(positions: &[[f32; 3]]) -> Self {
        let ranked = |mut values: Vec<f64>, share: f64| {
            values.sort_by(f64::total_cmp);
            values[((values.len() - 1) as f64 * share) as usize]
        };
        let axis = |k: usize| positions.iter().map(|p| f64::from(p[k])).collect::<Vec<_>>();
        let centre = [0, 1, 2].map(|k| ranked(axis(k), 0.5));
        let reach = [0, 1, 2].map(|k| ranked(axis(k).iter().map(|v| (v - centre[k]).abs()).collect(), 0.98));
        let half_side = reach.into_iter().fold(0.0, f64::max);
        Self { centre, half_side: if half_side > 1e-9 { half_side } else { 1.0 } }
    }

    /// The point nearest to all optical axes, and what the narrowest view shows around it.
    fn of_cameras(views: &[PosedPhotograph]) -> Self {
        let (mut matrix, mut right) = (DMat3::from_diagonal(DVec3::splat(1e-9)), DVec3::ZERO);
        for view in views {
            let axis = DVec3::from_array(view.camera.rotation()[2]);
            // Takes away what lies along the axis.
            let across = DMat3::IDENTITY - DMat3::from_cols(axis * axis.x, axis * axis.y, axis * axis.z);
            matrix += across;
            right += across * DVec3::from_array(view.camera.centre());
        }
        let centre = matrix.inverse() * right;
        let reach = views.iter().map(|view| {
            let i = view.camera.intrinsics();
            let distance = DVec3::from_array(view.camera.centre()).distance(centre);
            distance * (0.5 * f64::from(i.width) / i.fx).min(0.5 * f64::from(i.height) / i.fy)
        });
        let half_side = 0.9 * reach.fold(f64::INFINITY, f64::min);
        let fits = half_side.is_finite() && half_side > 1e-9 && centre.is_finite();
        if fits {
            Self { centre: centre.to_array(), half_side }
        } else {
            Self { centre: [0.0; 3], half_side: 1.0 }
        }
    }
}

/// Refuses what a training could begin with and never finish: a clip without frames or of more than a stream
/// holds, a start of nothing, of numbers that are none, or of bands that do not fit its Gaussians.
pub(super) fn check(dataset: &Dataset) -> Result<(), TrainError> {
    let refused = |field, found: String, allowed: String| {
        Err(TrainError::Dataset { dataset: dataset.name.clone(), field, found, allowed })
    };
    if !(1..=limits::MAX_FRAMES as usize).contains(&dataset.frames) {
        return refused("frames", dataset.frames.to_string(), format!("1 to {}", limits::MAX_FRAMES));
    }
    match &dataset.start {
        Start::VisualHull => Ok(()),
        Start::Points(points) if points.is_empty() => {
            refused("start", "a list of no points".into(), "at least one point".into())
        }
        Start::Points(points) => {
            let is_bad = |p: &ColouredPoint| !p.position.iter().chain(&p.colour).all(|v| v.is_finite());
            match points.iter().position(is_bad) {
                Some(at) => refused("start", format!("point {at}, {:?}", points[at]), FINITE.into()),
                None => Ok(()),
            }
        }
        Start::Gaussians(instant, _) => {
            let count = instant.gaussians.len();
            if count == 0 {
                return refused("start", "a list of no Gaussians".into(), "at least one Gaussian".into());
            }
            let (found, needed) = (instant.sh_rest.len(), count * instant.sh_degree.rest_len());
            if found != needed {
                let allowed = format!("{needed} of {count} Gaussians of degree {}", instant.sh_degree.get());
                return refused("start's sh_rest", format!("{found} values"), allowed);
            }
            match instant.gaussians.iter().position(|gaussian| !is_finite(gaussian)) {
                Some(at) => {
                    refused("start", format!("Gaussian {at}, {:?}", instant.gaussians[at]), FINITE.into())
                }
                None if instant.sh_rest.iter().all(|v| v.is_finite()) => Ok(()),
                None => refused("start's sh_rest", "not finite".into(), FINITE.into()),
            }
        }
    }
}

/// Refuses a start that could not be trained: one that hardly any photograph shows, or one so far from the
/// origin that the numbers of positions tell places apart too coarsely.
pub(super) fn check_seen(dataset: &Dataset, extent: &Extent, begun: &Instant) -> Result<(), TrainError> {
    let refused = |field, found: String, allowed: String| {
        Err(TrainError::Dataset { dataset: dataset.name.clone(), field, found, allowed })
    };
    let [x, y, z] = extent.centre;
    let farthest = x.abs().max(y.abs()).max(z.abs()) / extent.half_side;
    if farthest > FARTHEST {
        let found = format!(
            "({x:.4}, {y:.4}, {z:.4}), {farthest:.0} times as far from the origin as half the side of what \
             cameras see"
        );
        let allowed = format!("up to {FARTHEST:.0} times (positions have 24 bits)");
        return refused("the middle of the scene", found, allowed);
    }
    let views = dataset.train.photographs();
    let is_seen = |gaussian: &&Gaussian| {
        let shows = |view: &PosedPhotograph| pixel_at(&view.camera, &view.photograph, gaussian.position);
        views.iter().any(|view| shows(view).is_some())
    };
    let (count, seen) = (begun.gaussians.len(), begun.gaussians.par_iter().filter(is_seen).count());
    if (seen as f64) < LEAST_SEEN * count as f64 {
        let found = format!("{count} Gaussians, {seen} of them in front of a camera of the training split");
        let allowed = "one that photographs show (cameras that look at one place, or points as of COLMAP)";
        return refused("start", found, allowed.to_owned());
    }
    Ok(())
}

/// Share of a start that photographs must show.
const LEAST_SEEN: f64 = 0.02;
/// Farthest that the middle of a scene may be from the origin, in halves of its side: there, two f32
/// positions next to each other are about a thousandth of that apart.
const FARTHEST: f64 = 1e4;
/// What the numbers of a start may be.
const FINITE: &str = "a list of finite numbers";

fn is_finite(gaussian: &Gaussian) -> bool {
    let Gaussian { position, scale, rotation, opacity, sh0 } = gaussian;
    let numbers = position.iter().chain(scale).chain(rotation).chain(sh0);
    numbers.chain([opacity]).all(|v| v.is_finite())
}

/// The Gaussians to start with, in the cube.
pub(super) fn gaussians(
    start: &Start,
    views: &[PosedPhotograph],
    extent: &Extent,
    options: &TrainOptions,
    rng: &mut Pcg64Mcg,
) -> Instant {
    match start {
        Start::Gaussians(instant, _) => thinned(instant, options.max_gaussians, rng),
        Start::Points(points) => of_points(&sampled(points, options.initial_gaussians, rng), extent),
        Start::VisualHull => {
            of_points(&hull_points(views, extent, options, options.initial_gaussians, rng), extent)
        }
    }
}

/// At most `most` of the Gaussians, those that cover more the more likely.
fn thinned(instant: &Instant, most: usize, rng: &mut Pcg64Mcg) -> Instant {
    let count = instant.gaussians.len();
    if count <= most {
        return instant.clone();
    }
    // Exponential keys: the largest of `u^(1/w)` is a sample without replacement, weighted by w
    // (Efraimidis and Spirakis 2006).
    let mut keys: Vec<(f64, usize)> = Vec::with_capacity(count);
    for (index, g) in instant.gaussians.iter().enumerate() {
        let [a, b, c] = g.scale.map(f64::from);
        let area = (a * b).max(b * c).max(a * c);
        let weight = f64::from(g.opacity) * area.sqrt() + 1e-12;
        keys.push((rng.random::<f64>().max(1e-300).ln() / weight, index));
    }
    keys.sort_by(|a, b| b.0.total_cmp(&a.0).then(a.1.cmp(&b.1)));
    let mut chosen: Vec<usize> = keys[..most].iter().map(|key| key.1).collect();
    chosen.sort_unstable();
    let rest = instant.sh_degree.rest_len();
    Instant {
        gaussians: chosen.iter().map(|&i| instant.gaussians[i]).collect(),
        sh_rest: chosen.iter().flat_map(|&i| instant.sh_rest[i * rest..][..rest].iter().copied()).collect(),
        sh_degree: instant.sh_degree,
    }
}

/// `count` of the points, or all.
fn sampled(points: &[ColouredPoint], count: usize, rng: &mut Pcg64Mcg) -> Vec<ColouredPoint> {
    let mut points = points.to_vec();
    while points.len() > count {
        let index = rng.random_range(0..points.len());
        points.swap_remove(index);
    }
    points
}

/// Round Gaussians about as large as the gaps between points.
fn of_points(points: &[ColouredPoint], extent: &Extent) -> Instant {
    let positions: Vec<[f32; 3]> = points.iter().map(|point| point.position).collect();
    let tree = Tree::new(&positions);
    let unit = extent.half_side;
    let gaussians = points.par_iter().map(|point| {
        let near = tree.nearest(point.position, 4, |_| true);
        let others = &near[1.min(near.len())..];
        let mean = others.iter().map(|(squared, _)| squared.sqrt()).sum::<f64>() / others.len().max(1) as f64;
        let scale = (0.7 * mean).clamp(0.003 * unit, 0.15 * unit) as f32;
        Gaussian {
            position: point.position,
            scale: [scale; 3],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity: OPACITY,
            sh0: point.colour.map(|c| (c - 0.5) / SH_C0),
        }
    });
    Instant { gaussians: gaussians.collect(), sh_rest: Vec::new(), sh_degree: ShDegree::ZERO }
}

/// Points drawn from cells of the cube that lie inside (nearly) all outlines near the canonical instant.
fn hull_points(
    views: &[PosedPhotograph],
    extent: &Extent,
    options: &TrainOptions,
    count: usize,
    rng: &mut Pcg64Mcg,
) -> Vec<ColouredPoint> {
    let away = |view: &PosedPhotograph| (view.time - options.canonical_time).abs();
    let mut near: Vec<&PosedPhotograph> = views.iter().filter(|view| away(view) <= HULL_TIME).collect();
    if near.len() < 4 {
        near = views.iter().collect();
        near.sort_by(|a, b| away(a).total_cmp(&away(b)));
        near.truncate(12);
    }
    let cells: Vec<Cell> = (0..HULL_CELLS.pow(3))
        .into_par_iter()
        .with_min_len(4096)
        .map(|index| Cell::seen(cell_place(index, extent, [0.5; 3]), &near))
        .collect();
    let mut sums = Vec::with_capacity(cells.len());
    let mut sum = 0.0f64;
    for cell in &cells {
        let inside = if cell.inside > 0.5 { f64::from(cell.inside).powi(8) } else { 0.0 };
        // A little everywhere: what no outline holds may still be there.
        sum += inside + 1e-6;
        sums.push(sum);
    }
    let draw = |_| {
        let at = rng.random::<f64>() * sum;
        let index = sums.partition_point(|&up_to| up_to < at).min(cells.len() - 1);
        let within = [rng.random(), rng.random(), rng.random()];
        ColouredPoint { position: cell_place(index, extent, within), colour: cells[index].colour }
    };
    (0..count).map(draw).collect()
}

/// A place in a cell of the cube, `within` from 0 to 1 along each axis.
fn cell_place(index: usize, extent: &Extent, within: [f64; 3]) -> [f32; 3] {
    let cell = [index % HULL_CELLS, index / HULL_CELLS % HULL_CELLS, index / HULL_CELLS / HULL_CELLS];
    let place = |k: usize| {
        let share = (cell[k] as f64 + within[k]) / HULL_CELLS as f64;
        extent.centre[k] + extent.half_side * (2.0 * share - 1.0)
    };
    [0, 1, 2].map(|k| place(k) as f32)
}

/// What photographs say of a place.
struct Cell {
    /// Mean alpha of the views that see it.
    inside: f32,
    /// Mean colour of them, by alpha.
    colour: [f32; 3],
}

impl Cell {
    fn seen(place: [f32; 3], views: &[&PosedPhotograph]) -> Self {
        let (mut seen, mut alpha, mut colour) = (0.0f32, 0.0f32, [0.0f32; 3]);
        for view in views {
            if let Some(pixel) = pixel_at(&view.camera, &view.photograph, place) {
                seen += 1.0;
                alpha += f32::from(pixel[3]) / 255.0;
                (0..3).for_each(|c| colour[c] += f32::from(pixel[c]) / 255.0);
            }
        }
        let inside = if seen > 0.0 { alpha / seen } else { 0.0 };
        Self { inside, colour: colour.map(|sum| if alpha > 1e-3 { sum / alpha } else { 0.5 }) }
    }
}

/// The pixel in which a photograph shows a place, if it does.
fn pixel_at(camera: &Camera, photograph: &Photograph, place: [f32; 3]) -> Option<[u8; 4]> {
    let [x, y, z] = camera.to_camera(place);
    if z <= camera.near() {
        return None;
    }
    let i = camera.intrinsics();
    let (x, y) = (i.fx * x / z + i.cx, i.fy * y / z + i.cy);
    let shown = x >= 0.0 && y >= 0.0 && x < f64::from(i.width) && y < f64::from(i.height);
    if !shown {
        return None;
    }
    let at = 4 * (y as usize * photograph.width() as usize + x as usize);
    photograph.rgba().get(at..at + 4)?.try_into().ok()
}
