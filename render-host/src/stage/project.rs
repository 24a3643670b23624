//! Stage 1 projects Gaussians to ellipses on the image plane (EWA), with colour and a depth key.
//!
//! Geometry is f64: it is a small share of the time, and it makes needles, specks and far coordinates
//! ordinary. With `u`, `v` the two rows of the 2×3 factor `J·W·R·S` of the covariance and `p` the low
//! pass, `det = |u × v|² + p(|u|² + |v|²) + p²`: a sum of terms that are not negative, where
//! `a·c - b²` cancels.
//!
//! The Jacobian is taken at the centre clamped to the frustum widened by 30 % of its half angle's
//! tangent, so that splats beside the camera do not smear over the image.

use codec_core::Gaussian;
use rayon::prelude::*;

use super::{REACH_MARGIN, Splat, half};
use crate::{
    Camera, Counters, Settings, Splats,
    camera::{cross, dot, rotation_matrix},
    harmonics,
};

/// Depth key of a Gaussian that was skipped; above every key of one that is drawn.
pub const SKIPPED: u32 = u32::MAX;
/// Squared length below which a quaternion has no direction.
pub(crate) const MIN_QUATERNION_NORM2: f64 = 1e-12;
/// Least factor by which `antialiased` dims a splat. Source: Mip-Splatting.
pub(crate) const MIN_COMPENSATION: f64 = 0.005;
/// Gaussians in one piece of work.
const CHUNK: usize = 2048;

/// What the stage yields: a slot per Gaussian.
#[derive(Clone, Debug, Default)]
pub struct Projected {
    /// Splats; a slot whose key is [`SKIPPED`] holds nothing of use.
    pub splats: Vec<Splat>,
    /// The first `depth_bits` bits of the camera-space depth as f32 (positive, so bits sort as depths do),
    /// or [`SKIPPED`].
    pub keys: Vec<u32>,
    pub(super) counts: Vec<Counters>,
}

/// Why a Gaussian is not drawn; counted in the field of [`Counters`] of the same name.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Skip {
    Absent,
    NonFinite,
    Transparent,
    Degenerate,
    BehindNear,
    /// Outside, by the cheap bound.
    Culled,
    Outside,
    SubPixel,
}

/// Projects every Gaussian into `out` and returns the counts of those drawn and skipped.
pub fn project(splats: &Splats, camera: &Camera, settings: &Settings, out: &mut Projected) -> Counters {
    project_some(splats, |_| true, camera, settings, out)
}

/// As [`project`], of the Gaussians at whose index `has` is true; the others count as absent.
pub(crate) fn project_some(
    splats: &Splats,
    has: impl Fn(usize) -> bool + Sync,
    camera: &Camera,
    settings: &Settings,
    out: &mut Projected,
) -> Counters {
    let n = splats.len();
    let projector = Projector::new(camera, settings, settings.degree(splats.sh_degree()));
    out.splats.resize(n, Splat::NONE);
    out.keys.resize(n, SKIPPED);
    out.counts.clear();
    out.counts.resize(n.div_ceil(CHUNK), Counters::default());
    let Projected { splats: slots, keys, counts } = out;
    let fill = |i: usize, slots: &mut [Splat], keys: &mut [u32], counts: &mut Counters| {
        projector.fill(splats, &has, i * CHUNK, slots, keys, counts);
    };
    if settings.parallel {
        let chunks = slots.par_chunks_mut(CHUNK).zip(keys.par_chunks_mut(CHUNK)).zip(counts).enumerate();
        chunks.for_each(|(i, ((slots, keys), counts))| fill(i, slots, keys, counts));
    } else {
        let chunks = slots.chunks_mut(CHUNK).zip(keys.chunks_mut(CHUNK)).zip(counts).enumerate();
        chunks.for_each(|(i, ((slots, keys), counts))| fill(i, slots, keys, counts));
    }
    let mut total = Counters { gaussians: n as u64, ..Counters::default() };
    out.counts.iter().for_each(|counts| total.add(counts));
    total
}

impl Counters {
    /// Counts a Gaussian that is not drawn, for `reason`.
    pub(crate) fn skip(&mut self, reason: Skip) {
        self.culled += u64::from(reason == Skip::Culled);
        *match reason {
            Skip::Absent => &mut self.absent,
            Skip::NonFinite => &mut self.non_finite,
            Skip::Transparent => &mut self.transparent,
            Skip::Degenerate => &mut self.degenerate,
            Skip::BehindNear => &mut self.behind_near,
            Skip::Outside | Skip::Culled => &mut self.outside,
            Skip::SubPixel => &mut self.sub_pixel,
        } += 1;
    }

    /// Counts a Gaussian that is drawn, its bands weighed up to `weighed` of `degree`.
    pub(crate) fn draw(&mut self, degree: u8, weighed: u8) {
        let all = harmonics::count(degree);
        self.drawn += 1;
        self.sh_coefficients += all as u64;
        self.sh_skipped += (all - harmonics::count(weighed.min(degree))) as u64;
    }
}

/// What is the same for every Gaussian of a frame.
pub(crate) struct Projector<'a> {
    pub(crate) camera: &'a Camera,
    pub(crate) rotation: [[f64; 3]; 3],
    pub(crate) centre: [f64; 3],
    pub(crate) focal: [f64; 2],
    principal: [f64; 2],
    size: [f64; 2],
    slope: [[f64; 2]; 2],
    pub(crate) low_pass: f64,
    pub(crate) antialiased: bool,
    cull_frustum: bool,
    cull_sub_pixel: bool,
    opacity_bounds: bool,
    sh_by_need: bool,
    alpha_cutoff: f32,
    log2_cutoff: f64,
    pub(crate) degree: u8,
    /// Low bits that the depth key loses.
    depth_shift: u32,
    half_attributes: bool,
}

/// The Jacobian of the projection at one point: pixels per unit, and `x / z`, `y / z` within their limits.
pub(crate) struct Lens {
    pub(crate) gain: [f64; 2],
    pub(crate) slope: [f64; 2],
}

/// The factor of a covariance on the image plane, and what follows from it.
pub(crate) struct Factor {
    /// `W·R·S`: column `k` is local axis `k`, scaled, in camera axes.
    pub(crate) axes: [[f64; 3]; 3],
    /// Rows of `J·W·R·S`, pixels.
    pub(crate) u: [f64; 3],
    pub(crate) v: [f64; 3],
    /// `u × v`.
    pub(crate) area: [f64; 3],
    /// `|u × v|²`, the determinant before dilation.
    pub(crate) det0: f64,
    /// The determinant after it.
    pub(crate) det: f64,
}

/// Lowest and highest `x / z` and `y / z` at which the Jacobian is taken, `[x, y][low, high]`.
pub(crate) fn slope_limits(camera: &Camera) -> [[f64; 2]; 2] {
    let i = camera.intrinsics();
    let limits = |side: u32, f: f64, c: f64| {
        let (side, widen) = (f64::from(side), 0.3 * 0.5 * f64::from(side) / f);
        [-c / f - widen, (side - c) / f + widen]
    };
    [limits(i.width, i.fx, i.cx), limits(i.height, i.fy, i.cy)]
}

impl<'a> Projector<'a> {
    pub(crate) fn new(camera: &'a Camera, settings: &Settings, degree: u8) -> Self {
        let i = camera.intrinsics();
        Self {
            camera,
            rotation: camera.rotation(),
            centre: camera.centre(),
            focal: [i.fx, i.fy],
            principal: [i.cx, i.cy],
            size: [f64::from(i.width), f64::from(i.height)],
            slope: slope_limits(camera),
            low_pass: settings.low_pass,
            antialiased: settings.antialiased,
            cull_sub_pixel: settings.cull_sub_pixel,
            opacity_bounds: settings.opacity_bounds,
            sh_by_need: settings.sh_by_need,
            // The cheap bound is that of the shape before it is rounded.
            cull_frustum: settings.cull_frustum && !settings.half_attributes,
            alpha_cutoff: settings.alpha_cutoff,
            log2_cutoff: settings.log2_cutoff(),
            degree,
            depth_shift: 32 - u32::from(settings.depth_bits.min(32)),
            half_attributes: settings.half_attributes,
        }
    }

    /// Projects the Gaussians from index `first` on, those that it `has`, into equally many slots and keys.
    fn fill(
        &self,
        splats: &Splats,
        has: &impl Fn(usize) -> bool,
        first: usize,
        slots: &mut [Splat],
        keys: &mut [u32],
        counts: &mut Counters,
    ) {
        for (i, (slot, key)) in slots.iter_mut().zip(keys).enumerate() {
            if !has(first + i) {
                *key = SKIPPED;
                counts.skip(Skip::Absent);
                continue;
            }
            let degree = self.weighed(splats.band(first + i));
            match self.splat(splats, first + i, degree) {
                Ok((splat, depth)) => {
                    (*slot, *key) = (splat, depth);
                    counts.draw(self.degree, degree);
                }
                Err(reason) => {
                    *key = SKIPPED;
                    counts.skip(reason);
                }
            }
        }
    }

    /// The degree up to which bands of a Gaussian that holds `used` are weighed.
    pub(crate) fn weighed(&self, used: u8) -> u8 {
        if self.sh_by_need { self.degree.min(used) } else { self.degree }
    }

    /// Gaussian `index` on the image plane, its bands weighed up to `degree`, and its depth key.
    pub(crate) fn splat(&self, splats: &Splats, index: usize, degree: u8) -> Result<(Splat, u32), Skip> {
        let g = &splats.gaussians()[index];
        if g.is_absent() {
            return Err(Skip::Absent);
        }
        let geometry = g.position.iter().chain(&g.scale).chain(&g.rotation).chain(&g.sh0);
        let rest = &splats.rest(index)[..3 * harmonics::count(degree)];
        if !(g.opacity.is_finite() && geometry.chain(rest).all(|v| v.is_finite())) {
            return Err(Skip::NonFinite);
        }
        let mut alpha = f64::from(g.opacity.min(1.0));
        if g.opacity < self.alpha_cutoff {
            return Err(Skip::Transparent);
        }
        let norm2 = g.rotation.iter().map(|&v| f64::from(v) * f64::from(v)).sum::<f64>();
        if norm2 < MIN_QUATERNION_NORM2 || g.scale.iter().any(|&s| s < 0.0) {
            return Err(Skip::Degenerate);
        }
        let [x, y, z] = self.camera.to_camera(g.position);
        if z < self.camera.near() {
            return Err(Skip::BehindNear);
        }
        let mean = [self.focal[0] * x / z + self.principal[0], self.focal[1] * y / z + self.principal[1]];
        let lens = self.lens([x, y, z]);
        let Lens { gain, slope } = lens;
        let scale = g.scale.map(f64::from);
        if self.cull_frustum {
            // |u| is at most gain · √(1 + slope²) times the largest scale, and dimming only shrinks.
            let largest = scale[0].max(scale[1]).max(scale[2]);
            let reach = self.reach(alpha);
            for axis in 0..2 {
                let side = gain[axis] * largest;
                let variance = side * side * (1.0 + slope[axis] * slope[axis]) + self.low_pass;
                let half = half_extent(reach, variance) * (1.0 + 1e-9);
                if mean[axis] + half < 0.0 || mean[axis] - half > self.size[axis] {
                    return Err(Skip::Culled);
                }
            }
        }

        let Factor { u, v, det0, det, .. } = self.factor(g, &lens);
        let (uu, uv, vv) = (dot(u, u), dot(u, v), dot(v, v));
        if det <= 0.0 || !det.is_finite() {
            return Err(Skip::Degenerate);
        }
        if self.antialiased {
            alpha *= (det0 / det).sqrt().max(MIN_COMPENSATION);
            if alpha < f64::from(self.alpha_cutoff) {
                return Err(Skip::Transparent);
            }
        }
        let mut variance = [uu + self.low_pass, vv + self.low_pass];
        let base2 = (0.5 * std::f64::consts::LOG2_E).sqrt();
        let (root_c, root_det) = (variance[1].sqrt(), det.sqrt());
        let mut root = [base2 * root_c / root_det, -base2 * uv / (root_c * root_det), base2 / root_c];
        if !root.iter().all(|v| v.is_finite()) || root[0] <= 0.0 || root[2] <= 0.0 {
            return Err(Skip::Degenerate);
        }
        if self.half_attributes {
            root = half::root(root);
            variance = half::variance(root);
        }

        let reach = self.reach(alpha);
        let mut pixels = [0; 4];
        for axis in 0..2 {
            let half = half_extent(reach, variance[axis]);
            let mut first = (mean[axis] - half - 0.5).ceil();
            let mut past = (mean[axis] + half - 0.5).floor() + 1.0;
            if first >= past {
                if self.cull_sub_pixel {
                    return Err(Skip::SubPixel);
                }
                // The two centres it lies between.
                (first, past) = (past - 1.0, first + 1.0);
            }
            let (first, past) = (first.max(0.0), past.min(self.size[axis]));
            if first >= past {
                return Err(Skip::Outside);
            }
            pixels[2 * axis] = first as u16;
            pixels[2 * axis + 1] = past as u16;
        }
        let mut colour = self.colour(g.position, g.sh0, degree, rest);
        if !colour.iter().all(|c| c.is_finite()) {
            return Err(Skip::NonFinite);
        }
        if self.half_attributes {
            colour = half::colour(colour);
        }
        let log2_alpha = alpha.log2() as f32;
        Ok((Splat { mean, root, colour, log2_alpha, pixels }, (z as f32).to_bits() >> self.depth_shift))
    }

    /// The Jacobian at a point in camera axes.
    pub(crate) fn lens(&self, [x, y, z]: [f64; 3]) -> Lens {
        let slope = [
            (x / z).clamp(self.slope[0][0], self.slope[0][1]),
            (y / z).clamp(self.slope[1][0], self.slope[1][1]),
        ];
        Lens { gain: [self.focal[0] / z, self.focal[1] / z], slope }
    }

    /// The covariance's factor. The quaternion is not zero.
    pub(crate) fn factor(&self, g: &Gaussian, lens: &Lens) -> Factor {
        let Lens { gain, slope } = lens;
        let q = g.rotation.map(f64::from);
        let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
        let local = rotation_matrix(q.map(|v| v / length));
        let axes: [[f64; 3]; 3] = std::array::from_fn(|row| {
            let r = &self.rotation[row];
            std::array::from_fn(|k| {
                (r[0] * local[0][k] + r[1] * local[1][k] + r[2] * local[2][k]) * f64::from(g.scale[k])
            })
        });
        let u: [f64; 3] = std::array::from_fn(|k| gain[0] * (axes[0][k] - slope[0] * axes[2][k]));
        let v: [f64; 3] = std::array::from_fn(|k| gain[1] * (axes[1][k] - slope[1] * axes[2][k]));
        let area = cross(u, v);
        let det0 = dot(area, area);
        let det = det0 + self.low_pass * (dot(u, u) + dot(v, v)) + self.low_pass * self.low_pass;
        Factor { axes, u, v, area, det0, det }
    }

    /// Largest `u² + v²` at which a splat of peak `alpha` still adds something, with the margin.
    fn reach(&self, alpha: f64) -> f64 {
        let alpha = if self.opacity_bounds { alpha } else { 1.0 };
        (alpha.log2() - self.log2_cutoff).max(0.0) + f64::from(REACH_MARGIN)
    }

    fn colour(&self, position: [f32; 3], sh0: [f32; 3], degree: u8, rest: &[f32]) -> [f32; 3] {
        let mut colour = sh0.map(|dc| 0.5 + harmonics::C0 as f32 * dc);
        if !rest.is_empty() {
            let d: [f64; 3] = std::array::from_fn(|k| f64::from(position[k]) - self.centre[k]);
            let length = dot(d, d).sqrt();
            let basis = harmonics::basis(degree, d.map(|v| v / length));
            for (triple, weight) in rest.chunks_exact(3).zip(basis) {
                (0..3).for_each(|c| colour[c] += weight as f32 * triple[c]);
            }
        }
        colour.map(|c| c.max(0.0))
    }
}

/// Half the width, in pixels, of the box around the ellipse `u² + v² ≤ reach`.
fn half_extent(reach: f64, variance: f64) -> f64 {
    (2.0 * std::f64::consts::LN_2 * reach * variance).sqrt()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn camera() -> Camera {
        Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 64, 48).unwrap()
    }

    fn ball() -> Gaussian {
        Gaussian { scale: [0.1; 3], opacity: 0.5, ..Gaussian::ABSENT }
    }

    fn one(g: Gaussian, settings: &Settings) -> (Counters, Splat) {
        let mut out = Projected::default();
        let counters = project(&Splats::plain(&[g]), &camera(), settings, &mut out);
        assert_eq!(counters.skipped() + counters.drawn, 1);
        (counters, out.splats[0])
    }

    #[test]
    fn a_ball_on_the_axis_is_a_disc_in_the_middle() {
        let (counters, s) = one(ball(), &Settings::default());
        assert_eq!(counters.drawn, 1);
        assert!((s.mean[0] - 32.0).abs() < 1e-9 && (s.mean[1] - 24.0).abs() < 1e-9);
        let sigma2 = (camera().intrinsics().fx * f64::from(0.1f32) / 4.0).powi(2) + 0.3;
        let expected = (0.5 * std::f64::consts::LOG2_E / sigma2).sqrt();
        assert!((s.root[0] - expected).abs() < 1e-12 && s.root[1].abs() < 1e-12);
        assert!((s.root[2] - expected).abs() < 1e-12 && (s.log2_alpha + 1.0).abs() < 1e-6);
    }

    #[test]
    fn each_reason_is_counted_under_its_name() {
        let plain = Settings::default();
        type Field = fn(&Counters) -> u64;
        let cases: [(Gaussian, Field); 10] = [
            (Gaussian::ABSENT, |c| c.absent),
            (Gaussian { opacity: f32::NAN, ..ball() }, |c| c.non_finite),
            (Gaussian { position: [0.0, f32::INFINITY, 0.0], ..ball() }, |c| c.non_finite),
            (Gaussian { sh0: [f32::NAN, 0.0, 0.0], ..ball() }, |c| c.non_finite),
            (Gaussian { opacity: 0.003, ..ball() }, |c| c.transparent),
            (Gaussian { rotation: [0.0; 4], ..ball() }, |c| c.degenerate),
            (Gaussian { scale: [0.1, -0.1, 0.1], ..ball() }, |c| c.degenerate),
            (Gaussian { position: [0.0, 0.0, -5.0], ..ball() }, |c| c.behind_near),
            (Gaussian { position: [50.0, 0.0, 0.0], ..ball() }, |c| c.outside),
            (Gaussian { opacity: 0.0040, scale: [1e-6; 3], ..ball() }, |c| c.sub_pixel),
        ];
        for (i, (gaussian, field)) in cases.into_iter().enumerate() {
            let counters = one(gaussian, &plain).0;
            assert_eq!(field(&counters), 1, "case {i}: {counters:?}");
        }
    }

    #[test]
    fn a_needle_keeps_its_determinant() {
        // 1e5 by 1e-5 units, turned 45 degrees: in f32, a·c - b² of its covariance is noise.
        let (s, c) = (std::f32::consts::PI / 8.0).sin_cos();
        let needle = Gaussian { scale: [1e5, 1e-5, 1e-5], rotation: [c, 0.0, 0.0, s], ..ball() };
        let (_, splat) = one(needle, &Settings::default());
        let f = camera().intrinsics().fx / 4.0;
        let long = 1e5 * f;
        let det = 0.3 * long * long + 0.09;
        let got = (0.5 * std::f64::consts::LOG2_E / (splat.root[0] * splat.root[2])).powi(2);
        assert!((got / det - 1.0).abs() < 1e-6, "{got} {det}");
    }

    #[test]
    fn antialiasing_dims_a_speck_to_the_floor_and_leaves_a_ball() {
        let settings = Settings { antialiased: true, alpha_cutoff: 0.0, ..Settings::default() };
        let speck = one(Gaussian { scale: [1e-9; 3], ..ball() }, &settings).1;
        assert!((speck.log2_alpha.exp2() - 0.5 * 0.005).abs() < 1e-6);
        let big = one(Gaussian { scale: [1.0; 3], ..ball() }, &settings).1;
        assert!((big.log2_alpha.exp2() - 0.5).abs() < 1e-3);
    }
}
