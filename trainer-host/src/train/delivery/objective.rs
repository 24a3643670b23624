//! Evaluates the objective of one update and its gradient, world by world, in memory that does not grow with
//! worlds.

use std::collections::BTreeMap;

use rayon::prelude::*;
use render_host::{
    Settings,
    adjoint::{Gradients, Workspace, loss::Distortion, loss::Mse, render_and_gradients_into},
};

use super::{
    coded::{Moving, Shown},
    config::Weights,
    error::DeliveryError,
    gradient::Gradient,
    monotone::{self, PREFIXES},
    shared_worlds::{SharedWorlds, distortion},
    tail,
    temporal::{self, WorldLoss},
    view::View,
};

/// Worlds that are differentiated at once, on any number of threads.
const AT_ONCE: usize = 4;

/// The terms of the objective of one update, before weights: what the paper's section 4 names. D is
/// `MSE + structure (1 − SSIM)`.
#[derive(Clone, Copy, Debug, Default, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Terms {
    /// E\[D\] over worlds.
    pub expected: f64,
    /// CVaR of D over worlds.
    pub tail: f64,
    /// R, kilobits per Gaussian; 0 where it has no weight.
    pub rate: f64,
    /// F, squared errors of the change to the next frame, mean over worlds; 0 where it has no weight.
    pub temporal: f64,
    /// M, what longer prefixes lack to shorter ones.
    pub monotone: f64,
    /// D of what arrives up to level 0, 1, 2, 3, the last of which is complete; 0 where none counts.
    pub prefixes: [f64; PREFIXES],
}

impl Terms {
    /// The objective.
    pub(super) fn total(&self, weights: &Weights) -> f64 {
        self.expected
            + weights.cvar * self.tail
            + weights.rate * self.rate
            + weights.temporal * self.temporal
            + weights.monotone * self.monotone
            + weights.anchor * self.prefixes[PREFIXES - 1]
    }

    /// Adds `share` of each term of `other`.
    pub(super) fn add(&mut self, other: &Self, share: f64) {
        self.expected += share * other.expected;
        self.tail += share * other.tail;
        self.rate += share * other.rate;
        self.temporal += share * other.temporal;
        self.monotone += share * other.monotone;
        self.prefixes.iter_mut().zip(other.prefixes).for_each(|(sum, d)| *sum += share * d);
    }
}

/// The states that one view's objective is about.
pub(super) struct Worlds<'a> {
    /// At least one; the same state may come more than once.
    pub states: &'a [Vec<u8>],
    /// Levels up to 0, 1, 2, 3 of everything.
    pub prefixes: &'a [Vec<u8>; PREFIXES],
}

/// States, each once: what two worlds share is rendered once.
#[derive(Default)]
struct Distinct {
    numbers: BTreeMap<Vec<u8>, usize>,
    states: Vec<Vec<u8>>,
}

impl Distinct {
    fn number(&mut self, state: &[u8]) -> usize {
        *self.numbers.entry(state.to_vec()).or_insert_with(|| {
            self.states.push(state.to_vec());
            self.states.len() - 1
        })
    }
}

/// How much the objective changes with what a state shows.
#[derive(Clone, Copy, Debug, Default)]
struct Slopes {
    distortion: f64,
    temporal: f64,
}

/// Terms of `worlds` in `view`, but for the rate, and the gradient of their sum weighted by `weights`: added
/// to `gradient`. All worlds are measured together, so that the tail is known; then each is differentiated
/// with its own weight.
///
/// # Errors
/// What the renderer refuses.
pub(super) fn differentiate(
    moving: &Moving<'_>,
    worlds: &Worlds<'_>,
    view: &View,
    weights: &Weights,
    settings: &Settings,
    gradient: &mut Gradient,
) -> Result<Terms, DeliveryError> {
    let uses_prefixes = weights.anchor > 0.0 || weights.monotone > 0.0;
    let mut distinct = Distinct::default();
    let of_world: Vec<usize> = worlds.states.iter().map(|state| distinct.number(state)).collect();
    let of_prefix: Vec<usize> = if uses_prefixes {
        worlds.prefixes.iter().map(|state| distinct.number(state)).collect()
    } else {
        Vec::new()
    };
    let states = distinct.states;
    let settings = Settings { parallel: false, background: view.background, ..settings.clone() };
    let shared = SharedWorlds::new(moving, view.frame, &states)?;
    let distortions = shared
        .measured(&view.camera, &settings, |image| distortion(image, &view.picture, weights.structure))?;
    drop(shared);

    let mut terms = Terms::default();
    let mut slopes = vec![Slopes::default(); states.len()];
    let each = 1.0 / of_world.len().max(1) as f64;
    let of_worlds: Vec<f64> = of_world.iter().map(|&s| distortions[s]).collect();
    for ((&s, &d), tail) in
        of_world.iter().zip(&of_worlds).zip(tail::weights(&of_worlds, weights.cvar_fraction))
    {
        terms.expected += each * d;
        terms.tail += tail * d;
        slopes[s].distortion += each + weights.cvar * tail;
        if view.change.is_some() {
            slopes[s].temporal += weights.temporal * each;
        }
    }
    if uses_prefixes {
        terms.prefixes = std::array::from_fn(|k| of_prefix.get(k).map_or(0.0, |&s| distortions[s]));
        let (value, rises) = monotone::hinge(&terms.prefixes);
        terms.monotone = value;
        for (&s, rise) in of_prefix.iter().zip(rises) {
            slopes[s].distortion += weights.monotone * rise;
        }
        if let Some(&complete) = of_prefix.last() {
            slopes[complete].distortion += weights.anchor;
        }
    }

    let against = Distortion::weighted(view.picture.clone(), weights.structure);
    let counted = |slopes: &Slopes| slopes.distortion > 0.0 || slopes.temporal > 0.0;
    let jobs: Vec<usize> = (0..states.len()).filter(|&s| counted(&slopes[s])).collect();
    for jobs in jobs.chunks(AT_ONCE) {
        let found: Result<Vec<_>, DeliveryError> = jobs
            .par_iter()
            .map(|&s| {
                let mut own = Gradient::empty_like(gradient);
                let world = World { moving, view, settings: &settings, state: &states[s] };
                let temporal = world.differentiate(slopes[s], &against, &mut own)?;
                Ok((temporal, own))
            })
            .collect();
        for (&s, (temporal, own)) in jobs.iter().zip(found?) {
            if weights.temporal > 0.0 {
                terms.temporal += temporal * slopes[s].temporal / weights.temporal;
            }
            gradient.add(&own);
        }
    }
    Ok(terms)
}

/// One state in one view.
struct World<'a> {
    moving: &'a Moving<'a>,
    view: &'a View,
    settings: &'a Settings,
    state: &'a [u8],
}

impl World<'_> {
    /// Adds the gradient of `slopes.distortion · D + slopes.temporal · F` to `gradient`; gives F, 0 without
    /// weight.
    fn differentiate(
        &self,
        slopes: Slopes,
        against: &Distortion,
        gradient: &mut Gradient,
    ) -> Result<f64, DeliveryError> {
        let Self { view, .. } = self;
        let mut workspace = Workspace::new();
        let mut player = self.moving.coded().player();
        let shown = self.moving.shown(&mut player, self.state, view.frame)?;
        let mut loss = WorldLoss { distortion: Some((slopes.distortion, against)), change: None };
        let mut value = 0.0;
        if slopes.temporal > 0.0
            && let Some(change) = &view.change
        {
            let picture =
                render_host::Renderer::new().render(&shown.splats()?, &view.camera, self.settings)?.image;
            let target = temporal::after(&picture, change)?;
            let next = self.moving.shown(&mut player, self.state, view.frame + 1)?;
            let of_next = WorldLoss { distortion: None, change: Some((slopes.temporal, Mse::new(target))) };
            let found = self.pull(&mut workspace, &next, view.frame + 1, &of_next, gradient)?;
            value = found.loss / slopes.temporal;
            let target = temporal::before(&found.rendered.image, change)?;
            loss.change = Some((slopes.temporal, Mse::new(target)));
        }
        self.pull(&mut workspace, &shown, view.frame, &loss, gradient)?;
        Ok(value)
    }

    fn pull(
        &self,
        workspace: &mut Workspace,
        shown: &Shown,
        frame: u32,
        loss: &WorldLoss<'_>,
        gradient: &mut Gradient,
    ) -> Result<Gradients, DeliveryError> {
        let mut found = Gradients::default();
        let splats = shown.splats()?;
        render_and_gradients_into(workspace, &splats, &self.view.camera, self.settings, loss, &mut found)?;
        self.moving.pull(shown, &found.splats, (self.state, frame), gradient);
        Ok(found)
    }
}

#[cfg(test)]
mod tests;
