//! Fine-tunes a scene: draws worlds, steps the parameters, and takes the candidate that validation prefers.

use std::ops::ControlFlow;

use rand::seq::SliceRandom;
use render_host::{Backend, Settings};

use super::{
    channel::LossModel,
    coded::Coded,
    coding::Coding,
    config::{DeliveryOptions, LearningRates, Variant, Weights},
    drawing::Drawing,
    error::DeliveryError,
    evaluate::evaluate_coded,
    gradient::Gradient,
    masks::{Masks, Purpose, Sampler, hash, random, share_arrived},
    monotone::PREFIXES,
    objective::{self, Terms, Worlds},
    parameters::{COMPONENTS, Parameters},
    rate_model::RateModel,
    record::{Preregistration, Record},
    recorded::RecordedStates,
    select::{Candidate, select},
    steps,
    tuning::{Origin, Tuning},
    view::{Reference, View, views},
};
use crate::{encode::Decisions, scene::Scene};

/// What a caller hears after each update.
#[derive(Clone, Copy, Debug)]
pub struct Update {
    /// Updates made.
    pub updates: usize,
    /// Updates in all.
    pub of: usize,
    /// The objective.
    pub objective: f64,
    /// E\[D\] over the update's worlds.
    pub expected: f64,
    /// Mean share of blocks' levels that arrived, 0..=1.
    pub arrived: f64,
}

/// A fine-tuned scene.
#[derive(Clone, Debug)]
pub struct FineTuned {
    /// The scene.
    pub scene: Scene,
    /// What the encoder chose for it: [`encode::write`](crate::encode::write) with these gives the stream
    /// that was trained for.
    pub decisions: Decisions,
    /// What the encoder chose for the scene as it was given.
    pub given: Decisions,
    /// What was fixed, measured and chosen.
    pub record: Record,
}

/// Fine-tunes `scene` towards `references` over sampled deliveries. `progress` hears every update, and ends
/// the fine-tuning where it breaks: what is then taken is the best of the candidates so far, without
/// validation the scene of that update.
///
/// Every `validation.every`-th reference, and states from seeds of their own, are for validation alone. Where
/// an update or an encoding fails, as where a block outgrows its packet or the objective is no number, the
/// best of the candidates so far is taken, and the record says why.
///
/// Pictures of states and their gradients are made by `backend`; validation runs on the processor with any,
/// so that candidates are compared by one rule. A backend gives the same result bit for bit each time. That
/// of another one differs as its roundings do: gradients of an update agree to 1e-3 (relative L2 distance),
/// except where a rounding decides on which side of a cut-off a splat falls.
///
/// # Errors
/// An option out of range, references that do not fit the scene or are too few, a file of states that does
/// not fit, a registration that cannot be written; before the first candidate, an objective that is not
/// finite, what encoder and renderer refuse, or no memory on the graphics device.
pub fn fine_tune(
    scene: &Scene,
    references: &[Reference],
    options: &DeliveryOptions,
    backend: &Backend,
    progress: &dyn Fn(&Update) -> ControlFlow<()>,
) -> Result<FineTuned, DeliveryError> {
    resume(scene, (references, &[]), options, backend, None, &|update, _| progress(update))
}

/// As [`fine_tune`], from where `begun` is; `progress` hears of every update where the fine-tuning is then.
/// References are those for training and those for validation; where there are none of these, every
/// `validation.every`-th of the former is for validation alone.
///
/// Broken off after any update and gone on with from there on the same backend, it gives what it gives
/// without, bit for bit. Between two updates it may go from one backend to another, too.
///
/// # Errors
/// As [`fine_tune`]; a fine-tuning that was begun with another scene, other references or options.
pub fn resume(
    scene: &Scene,
    references: (&[Reference], &[Reference]),
    options: &DeliveryOptions,
    backend: &Backend,
    begun: Option<Tuning>,
    progress: &dyn Fn(&Update, &Tuning) -> ControlFlow<()>,
) -> Result<FineTuned, DeliveryError> {
    options.check()?;
    let mut drawing = Drawing::on(backend)?;
    let (training, validation) = split(references, options)?;
    let settings = Settings::default().with_footprint(scene.footprint);
    let views = views(scene, &training, &settings)?;
    let coded = Coded::first(scene, &options.encode)?;
    let sampler = Sampler::new(&coded.encoded.stream, options.unit)?;
    let stream = &coded.encoded.stream;
    let recorded = options.recorded.as_deref().map(|path| RecordedStates::read(path, stream)).transpose()?;
    let validation_masks = validation_masks(&sampler, options);
    let parameters = coded.parameters(scene)?;
    let mut coded = coded.with_parameters(parameters.clone());
    let run = Training {
        scene,
        options,
        views: &views,
        prefixes: std::array::from_fn(|level| sampler.prefix(level)),
        sampler,
        recorded: recorded.unwrap_or_default(),
    };
    let registration = Preregistration::of(options, &validation_masks, run.worlds_hash(0..options.updates));
    let made_from = Origin::of(&registration, &coded.encoded.stream, [&training, &validation]);
    let coding = Coding::new(scene, &coded, options);
    let mut at = match begun {
        Some(begun) => begun.checked(&made_from, &coded, &parameters, options.updates)?,
        None => {
            // What goes on keeps what was fixed before its first update.
            if let Some(path) = &options.registration {
                registration.write(path)?;
            }
            Tuning::begun(made_from, parameters.clone(), Coding::steps(scene, &coded, options)?)
        }
    };
    if let Some(encoded) = &at.encoded {
        coded = coding.with_steps(&at.steps, encoded)?;
    }
    let of_encoded = at.encoded.as_ref().unwrap_or(&parameters);
    let mut rate_model = RateModel::of(scene, of_encoded, &coded.encoded.decisions);
    let mut stopped = None;
    for update in at.updates..=options.updates {
        if update > 0 && (update.is_multiple_of(options.encode_every) || run.is_candidate(update)) {
            if update > run.warm_up() {
                at.steps.advance();
            }
            coded = match coding.coded(&mut at.steps, &at.parameters) {
                Ok(coded) => coded,
                // What was validated before is not lost.
                Err(error) if at.has_best() => {
                    stopped = Some(error.to_string());
                    break;
                }
                Err(error) => return Err(error),
            };
            at.encoded = Some(at.parameters.clone());
            rate_model = RateModel::of(scene, &at.parameters, &coded.encoded.decisions);
        }
        if run.is_candidate(update) {
            let moving = coded.moving(scene, &at.parameters);
            let found = evaluate_coded(&moving, &validation_masks, &validation, options.weights.structure)?;
            let candidate = Candidate {
                updates: update,
                violations: found.violations,
                p10_db: found.p10_db(),
                clean_db: found.clean_db,
                wire_bytes: found.wire_bytes,
            };
            at.add(candidate, &coded.encoded.decisions, coding.allowed)?;
        }
        if update == options.updates {
            break;
        }
        let now = (&at.parameters, &rate_model);
        let (terms, gradient, heard) = match run.step(update, &coded, now, &mut drawing, &settings) {
            Ok(step) => step,
            Err(error) if at.has_best() => {
                stopped = Some(error.to_string());
                break;
            }
            Err(error) => return Err(error),
        };
        at.objective.push(heard.objective);
        at.terms.push(terms);
        let share = update as f64 / options.updates as f64;
        at.steps.observe(&gradient.steps);
        at.adam.step(
            &mut at.parameters,
            &gradient.parameters,
            &rates(&options.learning_rates, 0.1f64.powf(share)),
        );
        at.updates = update + 1;
        // After the last update nothing is left to stop but the validation of what it led to.
        if progress(&heard, &at).is_break() && at.updates < options.updates {
            break;
        }
    }
    let (parameters, decisions) = match at.best()? {
        Some(best) => best,
        None => {
            let decisions = coding.coded(&mut at.steps, &at.parameters)?.encoded.decisions;
            (at.parameters, decisions)
        }
    };
    let record = Record {
        registration,
        allowed_bytes: coding.allowed,
        stopped,
        device: backend.name(),
        objective: at.objective,
        terms: at.terms,
        taken: select(&at.candidates, coding.allowed),
        candidates: at.candidates,
    };
    let given = coding.decisions;
    Ok(FineTuned { scene: parameters.applied(scene)?, decisions, given, record })
}

/// References for training and for validation: as given, or else some of the former.
fn split(
    (references, validation): (&[Reference], &[Reference]),
    options: &DeliveryOptions,
) -> Result<(Vec<Reference>, Vec<Reference>), DeliveryError> {
    if options.validation.candidates == 0 || !validation.is_empty() {
        return match references.is_empty() {
            true => Err(DeliveryError::NoReference { found: 0, purpose: "training" }),
            false => Ok((references.to_vec(), validation.to_vec())),
        };
    }
    let every = options.validation.every;
    let (mut training, mut validation) = (Vec::new(), Vec::new());
    for (index, reference) in references.iter().enumerate() {
        let list = if index % every == every - 1 { &mut validation } else { &mut training };
        list.push(reference.clone());
    }
    for (list, purpose) in [(&training, "training"), (&validation, "validation")] {
        if list.is_empty() {
            return Err(DeliveryError::NoReference { found: 0, purpose });
        }
    }
    Ok((training, validation))
}

/// Half the states after independent losses of 5 %, half after bursts of as much; none without validation.
fn validation_masks(sampler: &Sampler, options: &DeliveryOptions) -> Masks {
    if options.validation.candidates == 0 {
        return Masks { states: Vec::new() };
    }
    let draw = |index: usize| {
        let loss = match index % 2 {
            0 => LossModel::Iid { probability: 0.05 },
            _ => LossModel::Burst { share: 0.05, length: 6.0 },
        };
        let mut rng = random(options.seed, Purpose::Validation, 0, index);
        let lost = loss.lost(sampler.units(), &mut rng);
        sampler.state(&lost.iter().map(|lost| !lost).collect::<Vec<_>>())
    };
    Masks { states: (0..options.validation.states).map(draw).collect() }
}

/// Largest steps of each parameter of Gaussians and of proxies, times `factor`.
fn rates(rates: &LearningRates, factor: f64) -> [[f64; COMPONENTS]; 2] {
    let LearningRates { position, log_scale, turn, opacity, colour, proxies } = *rates;
    let rate = |c: usize| match c {
        0..3 => position,
        3..6 => log_scale,
        6..9 => turn,
        9 => opacity,
        _ => colour,
    };
    [factor, factor * proxies].map(|factor| std::array::from_fn(|c| factor * rate(c)))
}

/// A fine-tuning under way.
struct Training<'a> {
    scene: &'a Scene,
    options: &'a DeliveryOptions,
    views: &'a [View],
    prefixes: [Vec<u8>; PREFIXES],
    sampler: Sampler,
    recorded: RecordedStates,
}

impl Training<'_> {
    fn warm_up(&self) -> usize {
        (self.options.warm_up * self.options.updates as f64).round() as usize
    }

    /// Whether the scene before update `update` is a candidate: the given one, and some after the warm-up.
    fn is_candidate(&self, update: usize) -> bool {
        let (wanted, all) = (self.options.validation.candidates, self.options.updates);
        let after = all - self.warm_up().min(all);
        let is_mark = |k: usize| update == all - after * (wanted - k) / wanted.max(1);
        wanted > 0 && (update == 0 || (1..=wanted).any(is_mark))
    }

    /// The variant and weights of update `update`: in the warm-up only the complete state counts.
    fn objective_of(&self, update: usize) -> (Variant, Weights) {
        let variant = if update < self.warm_up() { Variant::Reconstruction } else { self.options.variant };
        (variant, variant.weights(&self.options.weights))
    }

    /// States of the worlds of update `update` in its `view`-th picture.
    fn worlds(&self, update: usize, view: usize) -> Vec<Vec<u8>> {
        let (variant, _) = self.objective_of(update);
        let (options, recorded) = (self.options, self.recorded.at(self.view(update, view).frame));
        let (worlds, first) = (options.worlds, view * options.worlds);
        let rng = |index| random(options.seed, Purpose::Training, update, first + index);
        let counts = (worlds, options.clean(), update * options.views + view);
        self.sampler.worlds(variant, &options.channel, counts, recorded, rng)
    }

    /// Hash of the worlds of `updates`: those of one picture are drawn at a time, as there are too many for
    /// memory.
    fn worlds_hash(&self, updates: std::ops::Range<usize>) -> u64 {
        let views = 0..self.options.views;
        let each = updates.flat_map(|update| views.clone().map(move |view| (update, view)));
        hash(each.flat_map(|(update, view)| self.worlds(update, view)))
    }

    /// The `view`-th picture of update `update`: all pictures come once, in random order, before any comes
    /// again.
    fn view(&self, update: usize, view: usize) -> &View {
        let place = update * self.options.views + view;
        let mut order: Vec<usize> = (0..self.views.len()).collect();
        order.shuffle(&mut random(self.options.seed, Purpose::Views, place / self.views.len(), 0));
        &self.views[order[place % self.views.len()]]
    }

    /// Terms and gradient of the objective of update `update`, and what the caller hears.
    fn step(
        &self,
        update: usize,
        coded: &Coded,
        (parameters, rate_model): (&Parameters, &RateModel),
        drawing: &mut Drawing,
        settings: &Settings,
    ) -> Result<(Terms, Gradient, Update), DeliveryError> {
        let (_, weights) = self.objective_of(update);
        let moving = coded.moving(self.scene, parameters);
        // Without rows nothing is found out about steps.
        let rows = if self.options.learn_steps { steps::rows(&coded.encoded.decisions) } else { 0 };
        let (mut terms, mut gradient) = (Terms::default(), Gradient::zeros(parameters.count(), rows));
        let share = 1.0 / self.options.views as f64;
        let mut arrived = 0.0;
        for view in 0..self.options.views {
            let states = self.worlds(update, view);
            arrived += share * states.iter().map(|s| share_arrived(s)).sum::<f64>() / states.len() as f64;
            let worlds = Worlds { states: &states, prefixes: &self.prefixes };
            let view = self.view(update, view);
            let sum = &mut gradient;
            let found = objective::differentiate(&moving, &worlds, view, &weights, drawing, settings, sum)?;
            terms.add(&found, share);
        }
        gradient.scale(share);
        if weights.rate > 0.0 {
            let (weight, slopes) = (weights.rate, &mut gradient.parameters);
            terms.rate = rate_model.differentiate(self.scene, parameters, weight, slopes);
        }
        let objective = terms.total(&weights);
        if !objective.is_finite() {
            return Err(DeliveryError::Diverged { update, found: objective });
        }
        let (updates, of, expected) = (update + 1, self.options.updates, terms.expected);
        Ok((terms, gradient, Update { updates, of, objective, expected, arrived }))
    }
}

#[cfg(test)]
mod tests;
