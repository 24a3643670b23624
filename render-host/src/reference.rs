//! The reference renders slowly and obviously in f64; the fast renderers are compared with it.
//!
//! f64 throughout, scalar, no tiles: every row asks every splat whether it reaches that row, every pixel
//! in reach evaluates the textbook formula (covariance `J·W·Σ·Wᵀ·Jᵀ`, its inverse, one exponential). It
//! shares with the fast renderer only the camera's transform, the depth key (f32 bits, then index: part
//! of what an image means) and the harmonic basis. It obeys the tolerances in [`Settings`] (`alpha_cutoff`,
//! `alpha_max`, `transmittance_stop`, …); skips have nothing to skip here.
//!
//! A pixel is *close to a threshold* when some alpha is within a relative 1e-5 of the cut-off, or its
//! transmittance as near to the stop as f32 may have rounded it on the way there, 1e-3 at most. There,
//! rounding decides, and renderers may rightly differ by a whole contribution: up to cut-off × colour for
//! an alpha, stop × colour for a stop. Everywhere else they differ by rounding alone. [`Reference::close`]
//! counts these, so that a comparison can hold each kind to its own bound.

use crate::{
    camera::{Camera, dot, rotation_matrix},
    harmonics, parallel,
    settings::{Settings, SettingsError},
    splats::Splats,
    stage::project::{MIN_COMPENSATION, MIN_QUATERNION_NORM2, slope_limits},
};

/// Relative distance from the alpha cut-off that counts as close.
pub const CLOSE_ALPHA: f64 = 1e-5;
/// Largest relative distance from the transmittance stop that counts as close.
pub const CLOSE_STOP: f64 = 1e-3;
/// Relative error of a product by `1 - alpha` in f32: two roundings of half an ulp, of `1 - alpha` and of the
/// product.
const PRODUCT_ROUNDING: f64 = f32::EPSILON as f64;

/// Splats between two looks at whether a row is finished.
const LOOK_EVERY: usize = 256;

/// A reference picture.
#[derive(Clone, Debug, PartialEq)]
pub struct Reference {
    /// Width, pixels.
    pub width: usize,
    /// Height, pixels.
    pub height: usize,
    /// Colour over the background: r g b per pixel, row by row.
    pub rgb: Vec<f64>,
    /// Share of the background that shows, 0..=1 per pixel, row by row.
    pub transmittance: Vec<f64>,
    /// Decisions per pixel that were close to a threshold.
    pub close: Vec<u32>,
}

/// One splat on the image plane.
struct Ellipse {
    depth_bits: u32,
    mean: [f64; 2],
    /// Inverse covariance `[xx, xy, yy]`.
    conic: [f64; 3],
    alpha: f64,
    colour: [f64; 3],
    /// Half width and height of the box outside which alpha is below the cut-off.
    half: [f64; 2],
}

/// Renders `splats` as `camera` sees them.
///
/// # Errors
/// A setting out of range.
pub fn render(splats: &Splats, camera: &Camera, settings: &Settings) -> Result<Reference, SettingsError> {
    settings.validate()?;
    let mut ellipses: Vec<Ellipse> =
        (0..splats.len()).filter_map(|index| ellipse(splats, index, camera, settings)).collect();
    // Stable: ties stay in order of index.
    ellipses.sort_by_key(|e| e.depth_bits);

    let (width, height) = (camera.width() as usize, camera.height() as usize);
    let mut pixels = vec![Pixel::EMPTY; width * height];
    // A row takes nothing more when all its pixels are finished, and those that are so closely have said it.
    let stop = f64::from(settings.stop());
    let finished = |p: &Pixel| p.transmittance < stop * if p.close > 0 { 1.0 } else { 1.0 - CLOSE_STOP };
    parallel::for_each_chunk(settings.parallel, &mut pixels, width, |y, row| {
        for (k, e) in ellipses.iter().enumerate() {
            if k % LOOK_EVERY == 0 && row.iter().all(finished) {
                break;
            }
            let dy = y as f64 + 0.5 - e.mean[1];
            if dy.abs() > e.half[1] {
                continue;
            }
            let first = (e.mean[0] - e.half[0] - 0.5).ceil().clamp(0.0, width as f64) as usize;
            let past = (e.mean[0] + e.half[0] + 0.5).ceil().clamp(0.0, width as f64) as usize;
            for (x, pixel) in row.iter_mut().enumerate().take(past).skip(first) {
                pixel.take(e, x as f64 + 0.5 - e.mean[0], dy, settings);
            }
        }
    });
    let background = settings.background.map(f64::from);
    let over =
        |p: &Pixel| std::array::from_fn::<f64, 3, _>(|c| p.colour[c] + p.transmittance * background[c]);
    Ok(Reference {
        width,
        height,
        rgb: pixels.iter().flat_map(over).collect(),
        transmittance: pixels.iter().map(|p| p.transmittance).collect(),
        close: pixels.iter().map(|p| p.close).collect(),
    })
}

#[derive(Clone)]
struct Pixel {
    colour: [f64; 3],
    transmittance: f64,
    /// Relative error that `transmittance` may have in f32, to first order.
    rounding: f64,
    close: u32,
}

impl Pixel {
    const EMPTY: Self = Self { colour: [0.0; 3], transmittance: 1.0, rounding: 0.0, close: 0 };

    fn take(&mut self, e: &Ellipse, dx: f64, dy: f64, settings: &Settings) {
        let stop = f64::from(settings.transmittance_stop);
        if settings.early_stop && stop > 0.0 {
            let close = self.rounding.min(CLOSE_STOP);
            self.close += u32::from((self.transmittance / stop - 1.0).abs() < close);
            if self.transmittance < stop {
                return;
            }
        }
        let [a, b, c] = e.conic;
        let distance2 = a * dx * dx + 2.0 * b * dx * dy + c * dy * dy;
        let alpha = (e.alpha * (-0.5 * distance2).exp()).min(f64::from(settings.alpha_max));
        let cutoff = f64::from(settings.alpha_cutoff);
        if cutoff > 0.0 {
            self.close += u32::from((alpha / cutoff - 1.0).abs() < CLOSE_ALPHA);
            if alpha < cutoff {
                return;
            }
        }
        for (sum, colour) in self.colour.iter_mut().zip(e.colour) {
            *sum += self.transmittance * alpha * colour;
        }
        self.transmittance *= 1.0 - alpha;
        self.rounding += PRODUCT_ROUNDING + CLOSE_ALPHA * alpha / (1.0 - alpha);
    }
}

/// Gaussian `index` on the image plane, or `None` where it cannot or need not be drawn.
fn ellipse(splats: &Splats, index: usize, camera: &Camera, settings: &Settings) -> Option<Ellipse> {
    let g = &splats.gaussians()[index];
    let degree = settings.degree(splats.sh_degree());
    let rest = &splats.rest(index)[..3 * harmonics::count(degree)];
    let all = g.position.iter().chain(&g.scale).chain(&g.rotation).chain(&g.sh0).chain(rest);
    if g.is_absent() || !g.opacity.is_finite() || !all.into_iter().all(|v| v.is_finite()) {
        return None;
    }
    let q = g.rotation.map(f64::from);
    let norm2 = q.iter().map(|v| v * v).sum::<f64>();
    let near_first = camera.to_camera(g.position);
    let scale = g.scale.map(f64::from);
    let drawable = norm2 >= MIN_QUATERNION_NORM2 && scale.iter().all(|&s| s >= 0.0);
    if !drawable || near_first[2] < camera.near() || g.opacity < settings.alpha_cutoff {
        return None;
    }

    // Σ in camera axes: (W·R·S)·(W·R·S)ᵀ.
    let local = rotation_matrix(q.map(|v| v / norm2.sqrt()));
    let w = camera.rotation();
    let m: [[f64; 3]; 3] = std::array::from_fn(|i| {
        std::array::from_fn(|k| (0..3).map(|j| w[i][j] * local[j][k]).sum::<f64>() * scale[k])
    });
    let sigma = |i: usize, j: usize| dot(m[i], m[j]);
    let [x, y, z] = near_first;
    let intrinsics = camera.intrinsics();
    let [limit_x, limit_y] = slope_limits(camera);
    let (sx, sy) = ((x / z).clamp(limit_x[0], limit_x[1]), (y / z).clamp(limit_y[0], limit_y[1]));
    let jacobian = [
        [intrinsics.fx / z, 0.0, -intrinsics.fx / z * sx],
        [0.0, intrinsics.fy / z, -intrinsics.fy / z * sy],
    ];
    let cov = |a: usize, b: usize| {
        let mut sum = 0.0;
        for i in 0..3 {
            for j in 0..3 {
                sum += jacobian[a][i] * sigma(i, j) * jacobian[b][j];
            }
        }
        sum
    };
    let (xx, xy, yy) = (cov(0, 0), cov(0, 1), cov(1, 1));
    // det of J·Σ·Jᵀ by Cauchy–Binet over the 2×3 factor J·M, which does not cancel.
    let factor: [[f64; 3]; 2] = std::array::from_fn(|a| {
        std::array::from_fn(|k| (0..3).map(|i| jacobian[a][i] * m[i][k]).sum::<f64>())
    });
    let minor = |i: usize, j: usize| factor[0][i] * factor[1][j] - factor[0][j] * factor[1][i];
    let det_plain = minor(0, 1).powi(2) + minor(0, 2).powi(2) + minor(1, 2).powi(2);
    let p = settings.low_pass;
    let det = det_plain + p * (xx + yy) + p * p;
    let (a, c) = (xx + p, yy + p);

    let mut alpha = f64::from(g.opacity.min(1.0));
    if settings.antialiased {
        alpha *= (det_plain / det).sqrt().max(MIN_COMPENSATION);
    }
    let floor = f64::from(settings.cutoff());
    if alpha < f64::from(settings.alpha_cutoff) {
        return None;
    }
    let reach = (2.0 * (alpha / floor).ln()).max(0.0).sqrt() * (1.0 + 1e-6);
    let conic = [c / det, -xy / det, a / det];

    let centre = camera.centre();
    let d: [f64; 3] = std::array::from_fn(|k| f64::from(g.position[k]) - centre[k]);
    let length = dot(d, d).sqrt();
    let basis = harmonics::basis(degree, d.map(|v| v / length));
    let colour = std::array::from_fn(|ch| {
        let bands = rest.chunks_exact(3).zip(basis).map(|(k, b)| b * f64::from(k[ch])).sum::<f64>();
        (0.5 + harmonics::C0 * f64::from(g.sh0[ch]) + bands).max(0.0)
    });
    let finite = conic.iter().all(|v| v.is_finite()) && colour.iter().all(|c| (*c as f32).is_finite());
    (det > 0.0 && finite).then(|| Ellipse {
        depth_bits: (z as f32).to_bits(),
        mean: [intrinsics.fx * x / z + intrinsics.cx, intrinsics.fy * y / z + intrinsics.cy],
        conic,
        alpha,
        colour,
        half: [reach * a.sqrt(), reach * c.sqrt()],
    })
}

/// How a fast picture differs from the reference, pixels close to a threshold apart.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Difference {
    /// Largest |difference| of a channel where no decision was close.
    pub max_clear: f64,
    /// Largest |difference| of a channel where one was.
    pub max_close: f64,
    /// Pixels where a decision was close.
    pub close_pixels: usize,
    /// PSNR over all pixels, dB, data range 1; infinite for equal pictures.
    pub psnr_db: f64,
}

impl Reference {
    /// Compares `rgb` (r g b per pixel, row by row) with this picture.
    ///
    /// Returns `None` when `rgb` is not of the same size.
    pub fn difference(&self, rgb: &[f32]) -> Option<Difference> {
        if rgb.len() != self.rgb.len() {
            return None;
        }
        let (mut out, mut sum) = (Difference::default(), 0.0);
        let pixels = self.rgb.chunks_exact(3).zip(rgb.chunks_exact(3)).zip(&self.close);
        for ((a, b), &close) in pixels {
            let largest = if close > 0 { &mut out.max_close } else { &mut out.max_clear };
            for (a, &b) in a.iter().zip(b) {
                let d = (a - f64::from(b)).abs();
                // In the total order NaN, made positive by abs, is above everything.
                *largest = if d.total_cmp(largest).is_gt() { d } else { *largest };
                sum += d * d;
            }
            out.close_pixels += usize::from(close > 0);
        }
        out.psnr_db = -10.0 * (sum / rgb.len() as f64).log10();
        Some(out)
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use codec_core::Gaussian;

    #[test]
    fn one_ball_is_the_closed_form() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 33, 33).unwrap();
        let dc = (0.5 / harmonics::C0) as f32;
        let ball = Gaussian { scale: [0.2; 3], opacity: 0.5, sh0: [dc, 0.0, -dc], ..Gaussian::ABSENT };
        let settings = Settings { background: [0.0, 0.0, 1.0], ..Settings::exact() };
        let out = render(&Splats::plain(&[ball]), &camera, &settings).unwrap();
        let sigma2 = (camera.intrinsics().fx * f64::from(0.2f32) / 4.0).powi(2) + 0.3;
        for (x, y) in [(16, 16), (20, 16), (16, 9), (12, 25)] {
            let d2 = (x as f64 - 16.0).powi(2) + (y as f64 - 16.0).powi(2);
            let alpha = 0.5 * (-0.5 * d2 / sigma2).exp();
            let rgb = &out.rgb[3 * (y * 33 + x)..][..3];
            for (got, expected) in rgb.iter().zip([alpha, 0.5 * alpha, 1.0 - alpha]) {
                assert!((got - expected).abs() < 1e-7, "{x} {y}: {got} {expected}");
            }
            assert!((out.transmittance[y * 33 + x] - (1.0 - alpha)).abs() < 1e-12);
        }
    }

    #[test]
    fn difference_can_fail() {
        let camera = Camera::look_at([0.0, 0.0, -4.0], [0.0; 3], [0.0, -1.0, 0.0], 0.8, 4, 2).unwrap();
        let out = render(&Splats::plain(&[]), &camera, &Settings::default()).unwrap();
        let mut rgb = vec![0.0; 24];
        assert_eq!(out.difference(&rgb).unwrap().psnr_db, f64::INFINITY);
        rgb[5] = 1e-3;
        assert!((out.difference(&rgb).unwrap().max_clear - 1e-3).abs() < 1e-9);
        rgb[5] = f32::NAN;
        assert!(out.difference(&rgb).unwrap().max_clear.is_nan());
        assert!(out.difference(&rgb[1..]).is_none());
    }
}
