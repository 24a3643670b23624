//! Evaluates the objective of one update and its gradient, world by world, in memory that does not grow with
//! worlds.

use std::collections::BTreeMap;

use render_host::{
    Gradients, Image, Settings,
    adjoint::loss::{Distortion, Mse},
};

use super::{
    coded::{Moving, Shown},
    config::Weights,
    drawing::{Drawing, StateRenderer},
    error::DeliveryError,
    gradient::Gradient,
    monotone::{self, PREFIXES},
    shared_worlds::{SharedWorlds, distortion},
    tail,
    temporal::{self, WorldLoss},
    view::View,
};

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
/// with its own weight. Pictures and their gradients are made by `drawing`.
///
/// # Errors
/// What the renderer refuses, or no memory on the graphics device.
pub(super) fn differentiate(
    moving: &Moving<'_>,
    worlds: &Worlds<'_>,
    view: &View,
    weights: &Weights,
    drawing: &mut Drawing,
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
    // Few states are at work on a graphics device: the loss of each is spread over threads.
    let parallel = matches!(drawing, Drawing::Gpu(_));
    let settings = Settings { parallel, background: view.background, ..settings.clone() };
    let distortions = distortions(moving, &states, view, weights.structure, drawing, &settings)?;

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
    let (count, rows) = (gradient.parameters.len(), gradient.steps.len());
    drawing.for_each(
        &jobs,
        |renderer, s| {
            let mut own = Gradient::zeros(count, rows);
            let world = World { moving, view, settings: &settings, state: &states[s] };
            let temporal = world.differentiate(renderer, slopes[s], &against, &mut own)?;
            Ok((temporal, own))
        },
        |s, (temporal, own)| {
            if weights.temporal > 0.0 {
                terms.temporal += temporal * slopes[s].temporal / weights.temporal;
            }
            gradient.add(&own);
        },
    )?;
    Ok(terms)
}

/// D of each of `states` in `view`: on the processor together, on a graphics device one by one.
fn distortions(
    moving: &Moving<'_>,
    states: &[Vec<u8>],
    view: &View,
    structure: f64,
    drawing: &mut Drawing,
    settings: &Settings,
) -> Result<Vec<f64>, DeliveryError> {
    let measure = |image: &Image| distortion(image, &view.picture, structure);
    if matches!(drawing, Drawing::Cpu) {
        let shared = SharedWorlds::new(moving, view.frame, states)?;
        return shared.measured(&view.camera, settings, measure);
    }
    let all: Vec<usize> = (0..states.len()).collect();
    let mut found = Vec::with_capacity(states.len());
    drawing.for_each(
        &all,
        |renderer, s| {
            let shown = moving.shown(&mut moving.coded().player(), &states[s], view.frame)?;
            measure(&renderer.picture(&shown.splats()?, &view.camera, settings)?)
        },
        |_, distortion| found.push(distortion),
    )?;
    Ok(found)
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
        renderer: &mut StateRenderer,
        slopes: Slopes,
        against: &Distortion,
        gradient: &mut Gradient,
    ) -> Result<f64, DeliveryError> {
        let Self { view, .. } = self;
        let mut player = self.moving.coded().player();
        let shown = self.moving.shown(&mut player, self.state, view.frame)?;
        let mut loss = WorldLoss { distortion: Some((slopes.distortion, against)), change: None };
        let mut value = 0.0;
        if slopes.temporal > 0.0
            && let Some(change) = &view.change
        {
            let picture = renderer.picture(&shown.splats()?, &view.camera, self.settings)?;
            let target = temporal::after(&picture, change)?;
            let next = self.moving.shown(&mut player, self.state, view.frame + 1)?;
            let of_next = WorldLoss { distortion: None, change: Some((slopes.temporal, Mse::new(target))) };
            let found = self.pull(renderer, &next, view.frame + 1, &of_next, gradient)?;
            value = found.loss / slopes.temporal;
            let target = temporal::before(&found.rendered.image, change)?;
            loss.change = Some((slopes.temporal, Mse::new(target)));
        }
        self.pull(renderer, &shown, view.frame, &loss, gradient)?;
        Ok(value)
    }

    fn pull(
        &self,
        renderer: &mut StateRenderer,
        shown: &Shown,
        frame: u32,
        loss: &WorldLoss<'_>,
        gradient: &mut Gradient,
    ) -> Result<Gradients, DeliveryError> {
        let found = renderer.gradients(&shown.splats()?, &self.view.camera, self.settings, loss)?;
        self.moving.pull(shown, &found.splats, (self.state, frame), gradient);
        Ok(found)
    }
}

#[cfg(test)]
mod tests;
