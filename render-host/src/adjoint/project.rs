//! The adjoint of stage 1 takes gradients of ellipses back to Gaussians and to the camera's pose.
//!
//! In f64, through the 2×3 factor (`u`, `v`) that the forward pass also goes through, so that no
//! determinant is a difference and a scale of 0 has a finite gradient.

use rayon::prelude::*;

use super::{
    blend::Ellipse,
    gradients::{Gradients, Pose, SplatGradient},
    harmonics,
    term::{Term, dropped, keep},
};
use crate::{
    Camera, Settings, Splats,
    camera::{cross, dot},
    harmonics::count,
    parallel,
    stage::{
        Splat,
        project::{Factor, Lens, MIN_COMPENSATION, Projected, Projector, SKIPPED},
    },
};

/// Gaussians in one piece of work; part of the order of sums.
const CHUNK: usize = 2048;

/// What a piece of work adds up.
#[derive(Clone, Copy, Debug, Default)]
pub(super) struct Chunk {
    translation: [f64; 3],
    rotation: [f64; 3],
    non_finite: u64,
}

/// Takes `ellipses` back to `out.splats`, `out.sh_rest`, `out.pose` and `out.non_finite`.
pub(super) fn project(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    projected: &Projected,
    ellipses: &[Ellipse],
    chunks: &mut Vec<Chunk>,
    out: &mut Gradients,
) {
    let (n, each) = (splats.len(), splats.sh_degree().rest_len());
    let projector = Projector::new(camera, settings, settings.degree(splats.sh_degree()));
    out.splats.clear();
    out.splats.resize(n, SplatGradient::default());
    out.sh_rest.clear();
    out.sh_rest.resize(n * each, 0.0);
    chunks.clear();
    chunks.resize(n.div_ceil(CHUNK), Chunk::default());

    let work = |i: usize, chunk: &mut Chunk, gradients: &mut [SplatGradient], rest: &mut [f32]| {
        for (k, gradient) in gradients.iter_mut().enumerate() {
            let index = i * CHUNK + k;
            // Everything a splat has is 0 when no pixel pulls at it.
            if projected.keys[index] != SKIPPED && ellipses[index].iter().any(|&v| v != 0.0) {
                let rest = &mut rest[k * each..(k + 1) * each];
                projector.back(
                    splats,
                    index,
                    &projected.splats[index],
                    &ellipses[index],
                    gradient,
                    rest,
                    chunk,
                );
            }
        }
    };
    if each == 0 {
        if settings.parallel {
            let pieces = chunks.par_iter_mut().zip(out.splats.par_chunks_mut(CHUNK)).enumerate();
            pieces.for_each(|(i, (chunk, gradients))| work(i, chunk, gradients, &mut []));
        } else {
            let pieces = chunks.iter_mut().zip(out.splats.chunks_mut(CHUNK)).enumerate();
            pieces.for_each(|(i, (chunk, gradients))| work(i, chunk, gradients, &mut []));
        }
    } else {
        let pieces = chunks.iter_mut().zip(out.splats.chunks_mut(CHUNK));
        let mut pieces: Vec<_> = pieces.zip(out.sh_rest.chunks_mut(each * CHUNK)).collect();
        parallel::for_each(settings.parallel, &mut pieces, |i, ((chunk, gradients), rest)| {
            work(i, chunk, gradients, rest);
        });
    }
    let mut sum = Chunk::default();
    for chunk in chunks.iter() {
        (0..3).for_each(|k| sum.translation[k] += chunk.translation[k]);
        (0..3).for_each(|k| sum.rotation[k] += chunk.rotation[k]);
        sum.non_finite += chunk.non_finite;
    }
    out.pose = Pose { translation: sum.translation, rotation: sum.rotation };
    out.non_finite = sum.non_finite;
}

impl Projector<'_> {
    #[expect(clippy::too_many_arguments, reason = "one place per input and output of the chain rule")]
    fn back(
        &self,
        splats: &Splats,
        index: usize,
        splat: &Splat,
        ellipse: &Ellipse,
        out: &mut SplatGradient,
        rest_out: &mut [f32],
        chunk: &mut Chunk,
    ) {
        let g = &splats.gaussians()[index];
        let at = self.camera.to_camera(g.position);
        let [x, y, z] = at;
        let lens = self.lens(at);
        let Factor { axes, u, v, area, det0, det } = self.factor(g, &lens);
        let Lens { gain, slope } = lens;
        let [mean_x, mean_y, root_xx, root_xy, root_yy, log2_alpha, red, green, blue] = *ellipse;

        // root = base2 · [√c / √det, -b / (√c √det), 1 / √c] with b = u·v, c = v·v + p.
        let [xx, xy, yy] = splat.root;
        let c = dot(v, v) + self.low_pass;
        let base2 = (0.5 * std::f64::consts::LOG2_E).sqrt();
        let d_c = keep(Term::Variance, (root_xx * xx - root_xy * xy - root_yy * yy) / (2.0 * c));
        let d_b = keep(Term::Correlation, -root_xy * base2 / (c.sqrt() * det.sqrt()));
        let mut d_det = keep(Term::Determinant, -(root_xx * xx + root_xy * xy) / (2.0 * det));
        let mut d_det0 = 0.0;
        // log2_alpha = log₂ opacity + ½ log₂(det0 / det)
        if self.antialiased && (det0 / det).sqrt() > MIN_COMPENSATION {
            let dimming = keep(Term::Dimming, 0.5 * std::f64::consts::LOG2_E * log2_alpha);
            d_det0 += dimming / det0;
            d_det -= dimming / det;
        }
        // det = |u × v|² + p(u·u + v·v) + p²
        d_det0 += d_det;
        let dilation = keep(Term::Dilation, self.low_pass * d_det);
        let d_area = area.map(|a| keep(Term::Area, 2.0 * d_det0 * a));
        let (from_u, from_v) = (cross(v, d_area), cross(d_area, u));
        let d_u: [f64; 3] = std::array::from_fn(|k| from_u[k] + 2.0 * dilation * u[k] + d_b * v[k]);
        let d_v: [f64; 3] = std::array::from_fn(|k| from_v[k] + 2.0 * (d_c + dilation) * v[k] + d_b * u[k]);

        // u = gain · (axes[0] - slope · axes[2]), v likewise from axes[1].
        let d_axes: [[f64; 3]; 3] = [
            d_u.map(|d| gain[0] * d),
            d_v.map(|d| gain[1] * d),
            std::array::from_fn(|k| -gain[0] * slope[0] * d_u[k] - gain[1] * slope[1] * d_v[k]),
        ];
        let mut d_at = [keep(Term::Place, mean_x * gain[0]), keep(Term::Place, mean_y * gain[1]), 0.0];
        d_at[2] -= keep(Term::Perspective, (mean_x * gain[0] * x + mean_y * gain[1] * y) / z);
        d_at[2] -= keep(Term::Gain, (dot(d_u, u) + dot(d_v, v)) / z);
        for (axis, (d, along)) in [(d_u, x), (d_v, y)].into_iter().enumerate() {
            if slope[axis] == along / z {
                let d_slope = keep(Term::Slope, -gain[axis] * dot(d, axes[2]));
                d_at[axis] += d_slope / z;
                d_at[2] -= d_slope * slope[axis] / z;
            }
        }

        // Colour, gated where it was clamped at 0, and the direction it is seen from.
        let given = [red, green, blue];
        let shows = |c: usize| splat.colour[c] > 0.0 || dropped(Term::ColourClamp);
        let given = std::array::from_fn(|c| if shows(c) { given[c] } else { 0.0 });
        let offset = std::array::from_fn(|k| f64::from(g.position[k]) - self.centre[k]);
        let bands = 3 * count(self.degree);
        let rest = &splats.rest(index)[..bands];
        let (sh0, d_offset) = harmonics::colour(self.degree, offset, rest, given, &mut rest_out[..bands]);

        let r = &self.rotation;
        let turned_back = |d: [f64; 3]| -> [f64; 3] {
            std::array::from_fn(|j| r[0][j] * d[0] + r[1][j] * d[1] + r[2][j] * d[2])
        };
        let back = turned_back(d_at);
        let position: [f64; 3] = std::array::from_fn(|k| back[k] + d_offset[k]);
        // axes column k = W · local column k · scale k, so d ln scale = d axes · axes.
        let column = |m: &[[f64; 3]; 3], k: usize| [m[0][k], m[1][k], m[2][k]];
        let log_scale: [f64; 3] =
            std::array::from_fn(|k| keep(Term::AxisLength, dot(column(&d_axes, k), column(&axes, k))));
        let columns: [[f64; 3]; 3] =
            std::array::from_fn(|k| turned_back(column(&d_axes, k)).map(|d| d * f64::from(g.scale[k])));
        let rotation = quaternion(g.rotation.map(f64::from), columns).map(|v| keep(Term::Turn, v));
        let opacity = f64::from(g.opacity.min(1.0));
        let opacity_logit = keep(Term::Logit, log2_alpha * (1.0 - opacity) * std::f64::consts::LOG2_E);

        // Pose: at = R·p + t, axes = R·…, offset = p + Rᵀ·t.
        let t = self.camera.translation();
        let seen = std::array::from_fn(|i| keep(Term::PoseDirection, dot(r[i], d_offset)));
        let turned = std::array::from_fn(|i| at[i] - t[i]);
        let (by_place, by_view) = (cross(turned, d_at), cross(seen, t));
        let mut d_turn: [f64; 3] = std::array::from_fn(|k| keep(Term::PosePlace, by_place[k]) + by_view[k]);
        for k in 0..3 {
            let by_shape = cross(column(&axes, k), column(&d_axes, k));
            (0..3).for_each(|i| d_turn[i] += keep(Term::PoseShape, by_shape[i]));
        }
        let d_move: [f64; 3] = std::array::from_fn(|i| keep(Term::PoseMove, d_at[i]) + seen[i]);

        let found = SplatGradient {
            position: position.map(|v| v as f32),
            log_scale: log_scale.map(|v| v as f32),
            rotation: rotation.map(|v| v as f32),
            opacity_logit: opacity_logit as f32,
            sh0: sh0.map(|v| v as f32),
            image_mean: [mean_x as f32, mean_y as f32],
        };
        if !(found.is_finite()
            && rest_out.iter().all(|v| v.is_finite())
            && d_turn.iter().chain(&d_move).all(|v| v.is_finite()))
        {
            rest_out.fill(0.0);
            chunk.non_finite += 1;
            return;
        }
        *out = found;
        (0..3).for_each(|k| chunk.translation[k] += d_move[k]);
        (0..3).for_each(|k| chunk.rotation[k] += d_turn[k]);
    }
}

impl SplatGradient {
    fn is_finite(&self) -> bool {
        let Self { position, log_scale, rotation, opacity_logit, sh0, image_mean } = self;
        let fields = position.iter().chain(log_scale).chain(rotation).chain(sh0).chain(image_mean);
        opacity_logit.is_finite() && fields.into_iter().all(|v| v.is_finite())
    }
}

/// From the columns of the rotation matrix back to the raw quaternion: across it, by its length.
fn quaternion(q: [f64; 4], columns: [[f64; 3]; 3]) -> [f64; 4] {
    let length = q.iter().map(|v| v * v).sum::<f64>().sqrt();
    let [w, x, y, z] = q.map(|v| v / length);
    let d = |row: usize, column: usize| columns[column][row];
    let unit = [
        2.0 * (x * (d(2, 1) - d(1, 2)) + y * (d(0, 2) - d(2, 0)) + z * (d(1, 0) - d(0, 1))),
        2.0 * (w * (d(2, 1) - d(1, 2)) + y * (d(0, 1) + d(1, 0)) + z * (d(0, 2) + d(2, 0)))
            - 4.0 * x * (d(1, 1) + d(2, 2)),
        2.0 * (w * (d(0, 2) - d(2, 0)) + x * (d(0, 1) + d(1, 0)) + z * (d(1, 2) + d(2, 1)))
            - 4.0 * y * (d(0, 0) + d(2, 2)),
        2.0 * (w * (d(1, 0) - d(0, 1)) + x * (d(0, 2) + d(2, 0)) + y * (d(1, 2) + d(2, 1)))
            - 4.0 * z * (d(0, 0) + d(1, 1)),
    ];
    let q = [w, x, y, z];
    let along = keep(Term::Tangent, (0..4).map(|k| unit[k] * q[k]).sum());
    std::array::from_fn(|k| (unit[k] - along * q[k]) / length)
}
