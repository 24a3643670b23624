//! Stress checks the renderer on named cases that break careless arithmetic.
//!
//! ```text
//! cases ─▶ StressCase ─▶ forward, gradients, worlds (the renderer's work, for a caller with a clock to time)
//!              └─▶ truth, world_truth          (the f64 reference)
//! StressCase::check(outcome, truth) ─▶ Verdict { errors against f64, complaints }
//! ```
//!
//! Every case must give finite values everywhere, count every Gaussian once, and stay within its bound of
//! the reference where no decision is close to a threshold. [`refusals()`] lists what is not rendered at all,
//! who refuses it and what the error must say. Nothing here asks a clock.

mod cases;
mod parts;
mod poison;
mod refusals;

pub use cases::{cases, discs};
pub use refusals::{Refusal, refusals};

use codec_core::{Gaussian, ShDegree};
use render_host::{
    Camera, Gradients, Image, ImageError, RenderError, Rendered, Renderer, Settings, SettingsError, Splats,
    SplatsError, Workspace,
    adjoint::{AdjointError, SplatGradient, loss::Distortion},
    counterfactual::{CounterfactualError, Engine, States, Utilities, Variants, brute},
    reference::{self, Difference, Reference},
    render_and_gradients,
};

/// Groups that the Gaussians of a case are dealt to, in turn.
pub const GROUPS: usize = 3;
/// Gaussians times pixels up to which the reference renders every world of a case.
const WORLD_WORK: u64 = 4_000_000;
/// Largest relative error of a sum of squares in fast mode against f64.
pub const FAST_BOUND: f64 = 2e-6;

/// A scene, a camera and settings that are hard to render, and how well they must be rendered.
#[derive(Clone, Debug)]
pub struct StressCase {
    /// What it belongs to, a row of the table.
    pub family: &'static str,
    /// What is special about it.
    pub name: String,
    /// The Gaussians.
    pub gaussians: Vec<Gaussian>,
    /// Their harmonics above band 0, laid out as in [`Splats`].
    pub rest: Vec<f32>,
    /// Degree of the harmonics.
    pub degree: ShDegree,
    /// The camera.
    pub camera: Camera,
    /// How to render.
    pub settings: Settings,
    /// Largest error allowed away from thresholds, per channel, as a share of the largest value of the
    /// reference or of 1. `None`: printed, not judged (precisions that the reference does not obey).
    pub bound: Option<f64>,
    /// Gaussians that must be left out; each other one has to be drawn or outside.
    pub skipped: Option<u64>,
}

/// A case that could not be run: a mistake in the case.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum StressError {
    /// Rendering was refused.
    #[error(transparent)]
    Render(#[from] RenderError),
    /// The reference was refused.
    #[error(transparent)]
    Settings(#[from] SettingsError),
    /// Gradients were refused.
    #[error(transparent)]
    Adjoint(#[from] AdjointError),
    /// Counterfactuals were refused.
    #[error(transparent)]
    Counterfactual(#[from] CounterfactualError),
    /// The splats do not fit together.
    #[error(transparent)]
    Splats(#[from] SplatsError),
    /// The target could not be made.
    #[error(transparent)]
    Image(#[from] ImageError),
}

/// What the counterfactual engine says about the worlds of a case.
#[derive(Clone, Debug, PartialEq)]
pub struct Worlds {
    /// Squared errors in strict mode.
    pub strict: Vec<f64>,
    /// Squared errors of the same worlds rendered alone.
    pub alone: Vec<f64>,
    /// Squared errors in fast mode.
    pub fast: Vec<f64>,
    /// What each group is worth where all are present.
    pub utilities: Utilities,
}

/// What the renderer made of a case.
#[derive(Clone, Debug)]
pub struct StressOutcome {
    /// The picture.
    pub rendered: Rendered,
    /// Gradients of the distortion from [`StressCase::target`].
    pub gradients: Gradients,
    /// Squared errors from [`StressCase::target`].
    pub worlds: Worlds,
}

/// What the f64 reference says.
#[derive(Clone, Debug)]
pub struct Truth {
    /// The picture.
    pub picture: Reference,
    /// Squared error of the first worlds, without early stop.
    pub worlds: Vec<f64>,
}

/// How far a case is off, and what is wrong.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Verdict {
    /// Differences from the reference.
    pub difference: Difference,
    /// Largest value of the reference, at least 1: what errors are compared with.
    pub largest: f64,
    /// Share of pixels where a decision was close to a threshold.
    pub close_share: f64,
    /// Largest relative error of a fast sum of squares.
    pub fast_error: f64,
    /// One sentence per broken promise; empty when all hold.
    pub complaints: Vec<String>,
}

impl StressCase {
    /// The case's Gaussians.
    ///
    /// # Errors
    /// Harmonics of the wrong length.
    pub fn splats(&self) -> Result<Splats<'_>, SplatsError> {
        Splats::new(&self.gaussians, &self.rest, self.degree)
    }

    /// A smooth picture of the case's size, for losses and errors.
    ///
    /// # Errors
    /// None for a camera that exists.
    pub fn target(&self) -> Result<Image, ImageError> {
        let (width, height) = (self.camera.width(), self.camera.height());
        let value = |i: u32| 0.5 + 0.4 * (0.37 * (i / 3 % width) as f32 + 1.3 * (i % 3) as f32).sin();
        Image::new(width, height, (0..3 * width * height).map(value).collect())
    }

    /// The picture.
    ///
    /// # Errors
    /// A mistake in the case.
    pub fn forward(&self, renderer: &mut Renderer) -> Result<Rendered, StressError> {
        Ok(renderer.render(&self.splats()?, &self.camera, &self.settings)?)
    }

    /// The picture and its gradients.
    ///
    /// # Errors
    /// A mistake in the case.
    pub fn gradients(&self, workspace: &mut Workspace) -> Result<Gradients, StressError> {
        let loss = Distortion::new(self.target()?);
        Ok(render_and_gradients(workspace, &self.splats()?, &self.camera, &self.settings, &loss)?)
    }

    /// Worlds of the case: all groups, each group missing, none.
    pub fn states(&self) -> States {
        let mut states = States::full(GROUPS);
        (0..GROUPS).for_each(|missing| states.push(|group| group != missing));
        states.push(|_| false);
        states
    }

    /// The counterfactual engine over the worlds of the case.
    ///
    /// # Errors
    /// A mistake in the case.
    pub fn worlds(&self) -> Result<Worlds, StressError> {
        let (groups, target) = (self.groups(), self.target()?);
        let variants = Variants::new(self.splats()?, &groups, GROUPS)?;
        let engine = Engine::new(&variants, &self.camera, &target, &self.settings)?;
        let states = self.states();
        Ok(Worlds {
            strict: engine.strict(&states)?,
            fast: engine.fast(&states)?,
            utilities: engine.utilities(&States::full(GROUPS))?,
            alone: brute::sse(&variants, &states, &self.camera, &target, &self.settings)?,
        })
    }

    /// Everything at once.
    ///
    /// # Errors
    /// A mistake in the case.
    pub fn outcome(&self) -> Result<StressOutcome, StressError> {
        Ok(StressOutcome {
            rendered: self.forward(&mut Renderer::new())?,
            gradients: self.gradients(&mut Workspace::new())?,
            worlds: self.worlds()?,
        })
    }

    /// What the reference says: the picture, and the worlds that it has time for.
    ///
    /// # Errors
    /// A mistake in the case.
    pub fn truth(&self) -> Result<Truth, StressError> {
        let picture = reference::render(&self.splats()?, &self.camera, &self.settings)?;
        let settings = Settings { early_stop: false, ..self.settings.clone() };
        let (groups, target, states) = (self.groups(), self.target()?, self.states());
        let variants = Variants::new(self.splats()?, &groups, GROUPS)?;
        let work =
            self.gaussians.len() as u64 * u64::from(self.camera.width()) * u64::from(self.camera.height());
        let count = if work > WORLD_WORK { 0 } else { states.len() };
        let worlds = (0..count).map(|world| {
            let (gaussians, rest) = brute::world(&variants, &states, world);
            let splats = Splats::new(&gaussians, &rest, self.degree)?;
            let got = reference::render(&splats, &self.camera, &settings)?;
            Ok(got.rgb.iter().zip(target.rgb()).map(|(a, &b)| (a - f64::from(b)).powi(2)).sum())
        });
        let worlds = worlds.collect::<Result<_, StressError>>()?;
        Ok(Truth { picture, worlds })
    }

    /// Holds `outcome` to what the case promises.
    pub fn check(&self, outcome: &StressOutcome, truth: &Truth) -> Verdict {
        let StressOutcome { rendered, gradients, worlds } = outcome;
        let mut out = Verdict {
            largest: truth.picture.rgb.iter().fold(1.0, |a, v| v.abs().max(a)),
            ..Verdict::default()
        };
        let mut complain = |wrong: bool, what: &str| {
            if wrong {
                out.complaints.push(format!("{}: {what}", self.name));
            }
        };
        complain(!finite(rendered.image.rgb()), "a pixel is not finite");
        complain(
            !rendered.transmittance.iter().all(|t| (0.0..=1.0).contains(t)),
            "a transmittance is not in 0..=1",
        );
        let counters = &rendered.counters;
        let counted = counters.drawn + counters.skipped();
        complain(counted != self.gaussians.len() as u64, "a Gaussian is not counted once");
        if let Some(skipped) = self.skipped {
            let unfit = counters.absent
                + counters.non_finite
                + counters.transparent
                + counters.degenerate
                + counters.behind_near;
            complain(
                unfit != skipped,
                &format!("{unfit} Gaussians are skipped, not {skipped}: {counters:?}"),
            );
        }
        complain(!all_finite(gradients), "a gradient is not finite");
        complain(gradients.rendered.image != rendered.image, "the picture with gradients is another");

        let all = worlds
            .strict
            .iter()
            .chain(&worlds.fast)
            .chain(&worlds.utilities.sse)
            .chain(&worlds.utilities.delta);
        complain(!all.into_iter().all(|v| v.is_finite()), "a sum of squares is not finite");
        let same = worlds.strict.iter().map(|v| v.to_bits()).eq(worlds.alone.iter().map(|v| v.to_bits()));
        complain(!same, "strict differs from worlds rendered alone");
        let errors =
            worlds.fast.iter().zip(&truth.worlds).map(|(got, exact)| (got - exact).abs() / exact.max(1e-3));
        let fast_error = errors.fold(0.0, worse);

        let difference = truth.picture.difference(rendered.image.rgb());
        complain(difference.is_none(), "the picture has another size than the reference");
        let difference = difference.unwrap_or_default();
        if let Some(bound) = self.bound {
            let (error, most) = (difference.max_clear, bound * out.largest);
            complain(
                error.is_nan() || error > most,
                &format!("error {error:.1e} against f64, {most:.1e} is allowed"),
            );
            let most = if difference.close_pixels == 0 { FAST_BOUND } else { bound };
            complain(
                fast_error.is_nan() || fast_error > most,
                &format!("fast sums are off by {fast_error:.1e}"),
            );
        }
        let pixels = rendered.transmittance.len().max(1) as f64;
        Verdict { difference, fast_error, close_share: difference.close_pixels as f64 / pixels, ..out }
    }

    fn groups(&self) -> Vec<u32> {
        (0..self.gaussians.len()).map(|i| (i % GROUPS) as u32).collect()
    }
}

/// The larger; NaN is largest.
fn worse(a: f64, b: f64) -> f64 {
    if b.total_cmp(&a).is_gt() { b } else { a }
}

fn finite(values: &[f32]) -> bool {
    values.iter().all(|v| v.is_finite())
}

fn all_finite(g: &Gradients) -> bool {
    let of_splat = |s: &SplatGradient| {
        [&s.position[..], &s.log_scale, &s.rotation, &s.sh0, &s.image_mean, &[s.opacity_logit]]
            .into_iter()
            .all(finite)
    };
    let wide = g.background.iter().chain(&g.pose.translation).chain(&g.pose.rotation);
    g.loss.is_finite()
        && g.splats.iter().all(of_splat)
        && finite(&g.sh_rest)
        && wide.into_iter().all(|v| v.is_finite())
}

#[cfg(test)]
mod tests;
