//! Density control adds Gaussians where the pictures ask for more and removes those that do nothing.

use glam::{Mat3, Vec3};
use rand::RngExt;
use rand_pcg::Pcg64Mcg;
use render_host::adjoint::{DensityStatistics, SplatGradient};
use serde::{Deserialize, Serialize};

use super::{
    gaussians::TrainedGaussians,
    options::DensityControl,
    rotation::{dot, matrix},
    start::Extent,
    views::FreeSpace,
};
use crate::scene::activation::{logit, sigmoid};

/// Gaussians fainter than this logit (1.5 %) are removed.
const FAINT: f32 = -4.2;
/// Longest standard deviation that remains, extents.
const LONGEST: f32 = 0.3;
/// Farthest place that remains, extents from the centre.
const FARTHEST: f64 = 1.9;
/// A split pair stands apart by this many standard deviations each way.
const APART: f32 = 0.55;
/// What a split takes from the logarithm of the scale along its axis.
const NARROWER: f32 = 0.5;
/// Strength of the jitter of relocated Gaussians: the figures of `relocate` are measured with it. The method
/// has 5e5.
const JITTER: f32 = 50.0;

/// View-space gradients of each Gaussian's centre, since Gaussians were last added.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
pub(super) struct ViewGradients {
    /// Sum of the lengths of gradients on the image plane.
    sum: Vec<f32>,
    /// Views that showed the Gaussian.
    views: Vec<f32>,
}

impl ViewGradients {
    pub(super) fn none(count: usize) -> Self {
        Self { sum: vec![0.0; count], views: vec![0.0; count] }
    }

    /// Whether what was read from a file is about `count` Gaussians.
    pub(super) fn is_sound(&self, count: usize) -> bool {
        [&self.sum, &self.views]
            .iter()
            .all(|part| part.len() == count && part.iter().all(|v| v.is_finite() && *v >= 0.0))
    }

    /// Adds one view: by `statistics` where there are some, else by the gradients of `splats`.
    pub(super) fn add(&mut self, splats: &[SplatGradient], statistics: &[DensityStatistics]) {
        let by_sum = |splat: &SplatGradient| splat.image_mean[0].hypot(splat.image_mean[1]);
        for (index, (sum, views)) in self.sum.iter_mut().zip(&mut self.views).enumerate() {
            let pull =
                statistics.get(index).map_or_else(|| splats.get(index).map_or(0.0, by_sum), |s| s.gradient);
            if pull > 0.0 {
                *sum += pull;
                *views += 1.0;
            }
        }
    }

    /// How likely a Gaussian is to be split. One that few views show is not trusted.
    fn weight(&self, index: usize) -> f64 {
        let (sum, views) = (self.sum[index], self.views[index]);
        f64::from(sum / views.max(5.0) * views.min(30.0))
    }
}

/// Where Gaussians may be.
#[derive(Clone, Copy, Debug)]
pub(super) struct Region<'a> {
    /// Near it.
    pub(super) extent: Extent,
    /// Not in it.
    pub(super) free_space: &'a FreeSpace,
}

/// Removes what does nothing and adds up to `target` Gaussians, at most a quarter more than there are.
/// Returns for each Gaussian now there the index it had, or its parent had, before.
pub(super) fn control(
    gaussians: &mut TrainedGaussians,
    pull: &ViewGradients,
    target: usize,
    kind: DensityControl,
    region: Region,
    rng: &mut Pcg64Mcg,
) -> Vec<usize> {
    let mut indices: Vec<usize> =
        (0..gaussians.len()).filter(|&i| !is_useless(gaussians, i, region)).collect();
    let remaining = indices.len();
    let room = target.saturating_sub(remaining).min(remaining / 4);
    let weight = |&index: &usize| match kind {
        DensityControl::Split | DensityControl::SplitBySum => pull.weight(index),
        DensityControl::Relocate => f64::from(gaussians.opacity(index)),
    };
    let weights: Vec<f64> = indices.iter().map(weight).collect();
    let parents = drawn(&weights, room, rng);
    indices.extend(parents.iter().map(|&place| indices[place]).collect::<Vec<_>>());
    gaussians.select(&indices, remaining);
    for (child, &parent) in parents.iter().enumerate() {
        match kind {
            DensityControl::Split | DensityControl::SplitBySum => split(gaussians, parent, remaining + child),
            DensityControl::Relocate => share(gaussians, parent, remaining + child),
        }
    }
    indices
}

fn is_useless(gaussians: &TrainedGaussians, index: usize, region: Region) -> bool {
    let Region { extent, free_space } = region;
    let unit = extent.half_side as f32;
    let faint = gaussians.opacity.item(index)[0] < FAINT;
    let long = gaussians.log_scale.item(index).iter().any(|&s| s > (LONGEST * unit).ln());
    let place = gaussians.positions()[index];
    let near = |(&p, c): (&f32, f64)| (f64::from(p) - c).abs() <= FARTHEST * extent.half_side;
    let far = !place.iter().zip(extent.centre).all(near);
    faint || long || far || free_space.contains(place)
}

/// Up to `count` different places of `weights`, heavier ones the more likely.
fn drawn(weights: &[f64], count: usize, rng: &mut Pcg64Mcg) -> Vec<usize> {
    let mut total = 0.0;
    let sums: Vec<f64> = weights
        .iter()
        .map(|weight| {
            total += weight;
            total
        })
        .collect();
    let mut taken = vec![false; weights.len()];
    let mut out = Vec::with_capacity(count);
    if total > 0.0 && total.is_finite() {
        for _ in 0..4 * count {
            let at = rng.random::<f64>() * total;
            let place = sums.partition_point(|&sum| sum <= at).min(weights.len() - 1);
            if out.len() < count && !std::mem::replace(&mut taken[place], true) {
                out.push(place);
            }
        }
    }
    out
}

/// Two Gaussians side by side along the longest axis of one.
fn split(gaussians: &mut TrainedGaussians, parent: usize, child: usize) {
    let scales = gaussians.log_scale.item(parent);
    let longest = (0..3).max_by(|&a, &b| scales[a].total_cmp(&scales[b])).unwrap_or(0);
    let step = axis(gaussians, parent, longest) * (APART * scales[longest].exp());
    let logit = gaussians.opacity.item(parent)[0];
    for (index, sign) in [(parent, 1.0), (child, -1.0)] {
        let moved = Vec3::from_slice(gaussians.position.item(index)) + sign * step;
        gaussians.position.item_mut(index).copy_from_slice(&moved.to_array());
        gaussians.log_scale.item_mut(index)[longest] -= NARROWER;
        if sigmoid(logit) > 0.3 {
            gaussians.opacity.item_mut(index)[0] = (logit - 0.4).max(-2.0);
        }
    }
}

/// Two Gaussians in one place that together hide as much as one did: at its centre, and over a line through
/// it (Kheradmand et al. 2024, equation 9, for two).
fn share(gaussians: &mut TrainedGaussians, parent: usize, child: usize) {
    let opacity = gaussians.opacity(parent);
    let each = (1.0 - (1.0 - opacity).max(1e-4).sqrt()).clamp(1e-3, 0.999);
    let logit = logit(each);
    gaussians.opacity.item_mut(parent)[0] = logit;
    gaussians.opacity.item_mut(child)[0] = logit;
    // Two of one shape fall off more slowly than one.
    let narrower = (opacity / (2.0 * each - each * each / std::f32::consts::SQRT_2)).ln().min(0.0);
    for index in [parent, child] {
        gaussians.log_scale.item_mut(index).iter_mut().for_each(|scale| *scale += narrower);
    }
}

/// Moves Gaussians at random along their own shape, the fainter the more: how relocated ones part
/// (Kheradmand et al. 2024, equation 9). `rate` is the learning rate of positions, extents; `unit` is the
/// extent, scene units.
pub(super) fn jitter(gaussians: &mut TrainedGaussians, rate: f32, unit: f32, rng: &mut Pcg64Mcg) {
    for index in 0..gaussians.len() {
        let faintness = 1.0 / (1.0 + (100.0 * (gaussians.opacity(index) - 0.005)).exp());
        let strength = JITTER * rate * faintness;
        let noise = Vec3::new(normal(rng), normal(rng), normal(rng));
        if strength > 1e-7 {
            let turn = unit_matrix(gaussians, index);
            let scales = gaussians.log_scale.item(index);
            let variances = Vec3::new(scales[0], scales[1], scales[2]).map(|s| (2.0 * s).exp());
            // In extents the step is strength times variance / unit²: in scene units, unit times as much.
            let step = turn * (variances * (turn.transpose() * noise)) * (strength / unit);
            let moved = Vec3::from_slice(gaussians.position.item(index)) + step;
            gaussians.position.item_mut(index).copy_from_slice(&moved.to_array());
        }
    }
}

/// A number of the standard normal distribution (Box and Muller 1958).
fn normal(rng: &mut Pcg64Mcg) -> f32 {
    let (a, b): (f32, f32) = (rng.random(), rng.random());
    (-2.0 * a.max(1e-7).ln()).sqrt() * (std::f32::consts::TAU * b).cos()
}

fn unit_matrix(gaussians: &TrainedGaussians, index: usize) -> Mat3 {
    let q = gaussians.rotation.item(index);
    let q = [q[0], q[1], q[2], q[3]];
    let length = dot(q, q).sqrt().max(1e-12);
    matrix(q.map(|v| v / length))
}

fn axis(gaussians: &TrainedGaussians, index: usize, which: usize) -> Vec3 {
    unit_matrix(gaussians, index).col(which)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::scene::Instant;
    use codec_core::{Gaussian, ShDegree};
    use rand_pcg::rand_core::SeedableRng;

    const EXTENT: Extent = Extent { centre: [0.0; 3], half_side: 1.0 };

    fn row(opacities: &[f32]) -> TrainedGaussians {
        let at = |(i, &opacity): (usize, &f32)| Gaussian {
            position: [0.1 * i as f32, 0.0, 0.0],
            scale: [0.01, 0.05, 0.02],
            rotation: [1.0, 0.0, 0.0, 0.0],
            opacity,
            sh0: [0.0; 3],
        };
        let gaussians = opacities.iter().enumerate().map(at).collect();
        TrainedGaussians::new(
            &Instant { gaussians, sh_rest: Vec::new(), sh_degree: ShDegree::ZERO },
            ShDegree::ZERO,
        )
    }

    /// Everything near the extent.
    fn anywhere(free_space: &FreeSpace) -> Region<'_> {
        Region { extent: EXTENT, free_space }
    }

    #[test]
    fn what_stands_in_free_space_goes() {
        let camera =
            render_host::Camera::look_at([0.2, 0.0, -1.0], [0.2, 0.0, 1.0], [0.0, 1.0, 0.0], 0.5, 8, 8);
        let free_space = FreeSpace::before(vec![camera.unwrap()], 1.01, 0.95);
        let mut gaussians = row(&[0.5; 4]);
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let pull = ViewGradients::none(4);
        let from = control(&mut gaussians, &pull, 4, DensityControl::Split, anywhere(&free_space), &mut rng);
        assert_eq!(from, [0]);
    }

    #[test]
    fn the_pulled_one_is_split_along_its_longest_axis_and_the_faint_one_goes() {
        let mut gaussians = row(&[0.5, 0.001, 0.5, 0.5, 0.5, 0.5]);
        let mut pull = ViewGradients::none(6);
        let splat = |x: f32| SplatGradient { image_mean: [x, 0.0], ..SplatGradient::default() };
        pull.add(&[splat(0.0), splat(9.0), splat(0.0), splat(1.0), splat(0.0), splat(0.0)], &[]);
        let mut rng = Pcg64Mcg::seed_from_u64(1);
        let from = control(
            &mut gaussians,
            &pull,
            100,
            DensityControl::Split,
            anywhere(&FreeSpace::default()),
            &mut rng,
        );
        assert_eq!(from, [0, 2, 3, 4, 5, 3]);
        let (a, b) = (gaussians.positions()[2], gaussians.positions()[5]);
        assert!((a[1] - b[1] - 2.0 * APART * 0.05).abs() < 1e-6 && a[0] == b[0], "{a:?} {b:?}");
    }

    #[test]
    fn two_that_share_a_place_hide_what_one_did() {
        let mut gaussians = row(&[0.7, 0.5]);
        share(&mut gaussians, 0, 1);
        let through = (1.0 - gaussians.opacity(0)) * (1.0 - gaussians.opacity(1));
        assert!((through - 0.3).abs() < 1e-5, "{through}");
    }

    /// What a line through the middle meets, of one and of the two that it becomes.
    #[test]
    fn two_that_share_a_place_hide_as_much_of_a_line_as_one_did() {
        for opacity in [0.05f32, 0.5, 0.9] {
            let mut gaussians = row(&[opacity, 0.5]);
            let hidden = |gaussians: &TrainedGaussians, count: i32| {
                let (opacity, width) = (gaussians.opacity(0), gaussians.log_scale.item(0)[1].exp());
                let at = |step: i32| {
                    let x = 0.001 * step as f32 / width;
                    1.0 - (1.0 - opacity * (-0.5 * x * x).exp()).powi(count)
                };
                (-1000..1000).map(at).sum::<f32>()
            };
            let before = hidden(&gaussians, 1);
            share(&mut gaussians, 0, 1);
            let after = hidden(&gaussians, 2);
            assert!((after / before - 1.0).abs() < 1e-3, "{opacity}: {after} for {before}");
        }
    }

    #[test]
    fn jitter_moves_the_faint_and_leaves_the_opaque() {
        let mut gaussians = row(&[0.002, 0.99]);
        let before = gaussians.positions().to_vec();
        jitter(&mut gaussians, 0.01, 1.0, &mut Pcg64Mcg::seed_from_u64(1));
        assert!(gaussians.positions()[0] != before[0] && gaussians.positions()[1] == before[1]);
    }

    /// A scene of another size is jittered by as much of its extent.
    #[test]
    fn jitter_is_of_a_scenes_own_size() {
        let moved = |unit: f32| {
            let mut gaussians = row(&[0.005; 2000]);
            gaussians.position.values_mut().fill(0.0);
            gaussians.log_scale.values_mut().iter_mut().for_each(|scale| *scale += unit.ln());
            jitter(&mut gaussians, 0.01, unit, &mut Pcg64Mcg::seed_from_u64(1));
            [0, 1, 2].map(|axis| {
                let squares = gaussians.positions().iter().map(|place| (place[axis] / unit).powi(2));
                (squares.sum::<f32>() / 2000.0).sqrt()
            })
        };
        let (one, large) = (moved(1.0), moved(40.0));
        // At this opacity half of the strength is left, and noise of the scale squared.
        for ((one, large), scale) in one.into_iter().zip(large).zip([0.01f32, 0.05, 0.02]) {
            let expected = 0.5 * JITTER * 0.01 * scale.powi(2);
            assert!((one / expected - 1.0).abs() < 0.05, "{one} {expected}");
            assert!((large / one - 1.0).abs() < 1e-3, "{large} {one}");
        }
    }
}
