//! Compares gradients with central differences of the f64 reference.
//!
//! Every parameter of every Gaussian is moved there and back, twice with different steps (Richardson),
//! and the reference rendered anew, so this is for small scenes. A parameter about which the picture
//! jumps or bends within the step (a change of depth order, a threshold) shows as two differences that
//! disagree: it is counted in [`ClassError::rough`] and not compared.

use codec_core::Gaussian;

use super::{AdjointError, Gradients, Loss, Workspace, render_and_gradients};
use crate::{
    Camera, Settings, Splats,
    camera::{cross, dot},
    reference,
    render::RenderError,
};

/// Step of [`check`]; an error of the difference is of the order of its fourth power.
pub const STEP: f64 = 1.0 / 256.0;
/// Differences that disagree by more than this, relative to the largest of the class, are rough.
const ROUGH: f64 = 2e-3;
/// Elements below this share of the largest of their class are compared with that share instead.
const FLOOR: f64 = 0.01;

/// How far one class of parameters is off.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct ClassError {
    /// Name of the class.
    pub class: &'static str,
    /// Largest `|gradient - difference| / max(|difference|, 1 % of the class's largest)`.
    pub worst: f64,
    /// `‖gradient - difference‖ / ‖difference‖` over the class.
    pub l2: f64,
    /// Largest |difference|.
    pub largest: f64,
    /// Parameters compared.
    pub compared: usize,
    /// Parameters left out because the picture is not smooth there.
    pub rough: usize,
}

/// One entry per class: position, log-scale, rotation, opacity, sh0, sh rest, background, pose
/// translation, pose rotation.
#[derive(Clone, Debug, PartialEq)]
pub struct Check {
    /// The classes.
    pub classes: Vec<ClassError>,
}

impl Check {
    /// Largest [`ClassError::worst`]; NaN counts as largest.
    pub fn worst(&self) -> f64 {
        let larger = |a: f64, b: f64| if b.total_cmp(&a).is_gt() { b } else { a };
        self.classes.iter().map(|c| c.worst).fold(0.0, larger)
    }
}

impl std::fmt::Display for Check {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        writeln!(
            f,
            "{:<18}{:>10}{:>10}{:>10}{:>10}{:>7}",
            "class", "worst", "l2", "largest", "compared", "rough"
        )?;
        for c in &self.classes {
            let ClassError { class, worst, l2, largest, compared, rough } = c;
            writeln!(f, "{class:<18}{worst:>10.1e}{l2:>10.1e}{largest:>10.1e}{compared:>10}{rough:>7}")?;
        }
        Ok(())
    }
}

/// Compares all gradients of a small scene with central differences of the f64 reference.
///
/// # Errors
/// As [`render_and_gradients`].
pub fn check(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    loss: &dyn Loss,
) -> Result<Check, AdjointError> {
    let got = render_and_gradients(&mut Workspace::new(), splats, camera, settings, loss)?;
    compare(splats, camera, settings, loss, &got, STEP)
}

/// As [`check`], for gradients from elsewhere and steps of another size: near a jump the step must be
/// shorter than the way to it.
///
/// # Errors
/// A setting out of range.
pub fn compare(
    splats: &Splats,
    camera: &Camera,
    settings: &Settings,
    loss: &dyn Loss,
    got: &Gradients,
    step: f64,
) -> Result<Check, AdjointError> {
    let mut classes = Vec::new();
    let mut class = |name, tally: Tally| classes.push(tally.close(name));
    let scene = Scene {
        gaussians: splats.gaussians().to_vec(),
        rest: (0..splats.len()).flat_map(|i| splats.rest(i)).copied().collect(),
        splats,
        loss,
    };
    let n = splats.len();
    let each = splats.sh_degree().rest_len();

    let of_gaussians = |parts: usize, gradient: &dyn Fn(usize, usize) -> f32, part: Part| {
        let mut tally = Tally::new(step);
        for index in 0..n {
            for k in 0..parts {
                let at = |h: f64| {
                    let mut gaussians = scene.gaussians.clone();
                    let moved = part(&mut gaussians[index], k, h);
                    scene.value(&gaussians, &scene.rest, camera, settings).map(|value| (moved, value))
                };
                tally.add(f64::from(gradient(index, k)), &at)?;
            }
        }
        Ok::<_, AdjointError>(tally)
    };
    let g = &got.splats;
    class("position", of_gaussians(3, &|i, k| g[i].position[k], |g, k, h| shift(&mut g.position[k], h))?);
    class("log-scale", of_gaussians(3, &|i, k| g[i].log_scale[k], |g, k, h| scale_by(&mut g.scale[k], h))?);
    class("rotation", of_gaussians(4, &|i, k| g[i].rotation[k], |g, k, h| shift(&mut g.rotation[k], h))?);
    class("opacity logit", of_gaussians(1, &|i, _| g[i].opacity_logit, |g, _, h| odds(&mut g.opacity, h))?);
    class("sh0", of_gaussians(3, &|i, k| g[i].sh0[k], |g, k, h| shift(&mut g.sh0[k], h))?);

    let mut tally = Tally::new(step);
    for index in 0..n * each {
        let at = |h: f64| {
            let mut rest = scene.rest.clone();
            let moved = shift(&mut rest[index], h);
            scene.value(&scene.gaussians, &rest, camera, settings).map(|value| (moved, value))
        };
        tally.add(f64::from(got.sh_rest[index]), &at)?;
    }
    class("sh rest", tally);

    let mut tally = Tally::new(step);
    for (k, &gradient) in got.background.iter().enumerate() {
        let at = |h: f64| {
            let mut settings = settings.clone();
            let moved = shift(&mut settings.background[k], h);
            scene.value(&scene.gaussians, &scene.rest, camera, &settings).map(|value| (moved, value))
        };
        tally.add(gradient, &at)?;
    }
    class("background", tally);

    let (r, t) = (camera.rotation(), camera.translation());
    let through = |r, t| {
        let moved = Camera::new(camera.intrinsics(), r, t).and_then(|c| c.with_near(camera.near()));
        let moved = moved.unwrap_or_else(|_| camera.clone());
        scene.value(&scene.gaussians, &scene.rest, &moved, settings)
    };
    let (mut moves, mut turns) = (Tally::new(step), Tally::new(step));
    for k in 0..3 {
        let axis: [f64; 3] = std::array::from_fn(|i| f64::from(u8::from(i == k)));
        moves.add(got.pose.translation[k], &|h| {
            let moved = std::array::from_fn(|i| t[i] + h * axis[i]);
            through(r, moved).map(|value| (moved[k] - t[k], value))
        })?;
        turns.add(got.pose.rotation[k], &|h| through(turn(r, axis, h), t).map(|value| (h, value)))?;
    }
    class("pose translation", moves);
    class("pose rotation", turns);
    Ok(Check { classes })
}

/// Moves part `k` of a Gaussian by about `h`; returns by how much.
type Part = fn(&mut Gaussian, usize, f64) -> f64;

struct Scene<'a> {
    gaussians: Vec<Gaussian>,
    rest: Vec<f32>,
    splats: &'a Splats<'a>,
    loss: &'a dyn Loss,
}

impl Scene<'_> {
    fn value(
        &self,
        gaussians: &[Gaussian],
        rest: &[f32],
        camera: &Camera,
        settings: &Settings,
    ) -> Result<f64, AdjointError> {
        let splats = Splats::new(gaussians, rest, self.splats.sh_degree()).unwrap_or(*self.splats);
        let picture = reference::render(&splats, camera, settings).map_err(RenderError::from)?;
        Ok(self.loss.exact(&picture.rgb))
    }
}

/// Compared elements of a class: gradient and difference.
struct Tally {
    step: f64,
    pairs: Vec<(f64, f64, f64)>,
}

impl Tally {
    fn new(step: f64) -> Self {
        Self { step, pairs: Vec::new() }
    }

    /// `at(h)` moves the parameter by about `h` and gives by how much, and the loss there.
    fn add(
        &mut self,
        gradient: f64,
        at: &dyn Fn(f64) -> Result<(f64, f64), AdjointError>,
    ) -> Result<(), AdjointError> {
        let slope = |h: f64| {
            let ((a, above), (b, below)) = (at(h)?, at(-h)?);
            Ok::<_, AdjointError>(if a == b { 0.0 } else { (above - below) / (a - b) })
        };
        let (coarse, fine) = (slope(self.step)?, slope(0.5 * self.step)?);
        self.pairs.push((gradient, (4.0 * fine - coarse) / 3.0, (fine - coarse).abs()));
        Ok(())
    }

    fn close(self, class: &'static str) -> ClassError {
        let largest = self.pairs.iter().fold(0.0f64, |a, p| a.max(p.1.abs()));
        let mut out = ClassError { class, largest, ..ClassError::default() };
        let (mut wrong, mut all) = (0.0, 0.0);
        for (gradient, difference, spread) in self.pairs {
            if spread > ROUGH * largest {
                out.rough += 1;
                continue;
            }
            out.compared += 1;
            let error = (gradient - difference).abs();
            // Differences of a loss near 1 carry rounding of about 1e-16 / step.
            let scale = difference.abs().max(FLOOR * largest).max(1e-9);
            let relative = error / scale;
            out.worst = if relative.total_cmp(&out.worst).is_gt() { relative } else { out.worst };
            wrong += error * error;
            all += difference * difference;
        }
        out.l2 = if all > 0.0 { (wrong / all).sqrt() } else { wrong.sqrt() };
        out
    }
}

fn shift(value: &mut f32, h: f64) -> f64 {
    let was = f64::from(*value);
    *value = (was + h) as f32;
    f64::from(*value) - was
}

fn scale_by(value: &mut f32, h: f64) -> f64 {
    let was = f64::from(*value);
    *value = (was * h.exp()) as f32;
    (f64::from(*value) / was).ln()
}

fn odds(value: &mut f32, h: f64) -> f64 {
    let logit = |o: f64| (o / (1.0 - o)).ln();
    let was = logit(f64::from(*value));
    *value = (1.0 / (1.0 + (-was - h).exp())) as f32;
    logit(f64::from(*value)) - was
}

/// `exp([h·axis]×) · r`, for a unit axis (Rodrigues).
fn turn(r: [[f64; 3]; 3], axis: [f64; 3], h: f64) -> [[f64; 3]; 3] {
    let (s, c) = h.sin_cos();
    let mut out = r;
    for j in 0..3 {
        let column = [r[0][j], r[1][j], r[2][j]];
        let (across, along) = (cross(axis, column), dot(axis, column));
        for i in 0..3 {
            out[i][j] = c * column[i] + s * across[i] + (1.0 - c) * along * axis[i];
        }
    }
    out
}
