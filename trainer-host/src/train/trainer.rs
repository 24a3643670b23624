//! A trainer fits a scene to photographs, one view per step.
//!
//! Every step: a view, the scene posed at its time, a render with gradients, one step of Adam. From time to
//! time: more pixels, more harmonics, more nodes, more Gaussians ([`super::schedule`] says when, as shares of
//! the training). The same views, options and shares give the same scene bit for bit, on any number of
//! threads.

mod fallback;
mod results;

use rand::RngExt;
use rand_pcg::{Pcg64Mcg, rand_core::SeedableRng};
use render_host::{
    Backend, BackendError, Differentiator, Gradients, Loss, Settings, Splats,
    adjoint::{
        AdjointError, DensityStatistics,
        loss::photograph::{Photograph, PhotographLoss},
    },
};

use super::{
    average::Average,
    density::{self, Region, ViewGradients},
    error::TrainError,
    exposure::{self, Exposed, Exposures, NUMBERS},
    finish::{Encoding, Finisher, Pictures},
    freeze::{self, Trial},
    gaussians::TrainedGaussians,
    model::Model,
    motion::{ControlNodes, Neighbourhoods, TemporalBasis, residual_slopes},
    moving_region::MovingRegion,
    options::{DensityControl, TrainOptions},
    parameter::AdamStep,
    photographs::Pyramid,
    schedule,
    start::{self, Extent},
    state::State,
    step_report::StepReport,
    view_order::ViewOrder,
    views::{Dataset, Training, Views},
};
use crate::{encode::EncodeOptions, scene::Instant};

/// Steps between two controls of density.
const DENSITY_EVERY: u32 = 100;
/// Steps before which what hardly moves may not have learnt to.
const STAND_STILL_FROM: u32 = 1000;
/// Steps between two searches for what moves together.
const NEIGHBOURHOODS_EVERY: u32 = 1000;
/// One step in this many shows the whole photograph and not only what its outline needs.
const WHOLE_EVERY: u32 = 8;

/// Fits a scene to the training split of a dataset.
#[derive(Debug)]
pub struct Trainer<'a> {
    views: &'a Views<Training>,
    /// Different times of the views.
    instants: usize,
    has_alpha: bool,
    options: TrainOptions,
    region: Region<'a>,
    /// Where something moves, if photographs tell.
    changing: Option<MovingRegion>,
    pyramid: Pyramid<'a>,
    state: State,
    /// What to fall back to.
    fallback: State,
    order: ViewOrder,
    /// Which exposure each view has.
    exposures: Vec<Option<usize>>,
    memory: Memory,
    finisher: Finisher,
}

/// Memory that steps use again.
#[derive(Debug, Default)]
struct Memory {
    differentiator: Differentiator,
    gradients: Gradients,
    /// Of the view, where density control asks for them.
    statistics: Vec<DensityStatistics>,
    /// How the loss changes with the exposure of the view.
    exposure_slopes: [f64; NUMBERS],
    instant: Instant,
}

/// What a training on `dataset` begins with, and `options` with what follows from the dataset filled in.
fn begun(dataset: &Dataset, options: &TrainOptions) -> Result<(Model, Extent, TrainOptions), TrainError> {
    options.validate()?;
    let photographs = dataset.train.photographs();
    if photographs.is_empty() {
        return Err(TrainError::Empty { dataset: dataset.name.clone() });
    }
    start::check(dataset)?;
    let mut options = options.clone();
    if dataset.train.instants() < 2 {
        options.nodes = 0;
    }
    let extent = Extent::of(&dataset.start, photographs);
    let mut rng = Pcg64Mcg::seed_from_u64(options.seed);
    let begun = start::gaussians(&dataset.start, photographs, &extent, &options, &mut rng);
    start::check_seen(dataset, &extent, &begun)?;
    options.initial_gaussians = begun.gaussians.len().max(1);
    let degree = schedule::degree(&options, 0.0).max(begun.sh_degree.min(options.degree()));
    let gaussians = TrainedGaussians::new(&begun, degree);
    let count = gaussians.len();
    let nodes = ControlNodes::none(TemporalBasis::default(), extent.half_side as f32);
    let footprint = *options.footprint.get_or_insert(dataset.footprint);
    Ok((Model { gaussians, nodes, followed: vec![None; count], footprint }, extent, options))
}

impl<'a> Trainer<'a> {
    /// Prepares to train on `dataset`.
    ///
    /// # Errors
    /// An option out of range, an empty training split, or a dataset that no training can finish with.
    pub fn new(dataset: &'a Dataset, options: &TrainOptions) -> Result<Self, TrainError> {
        let (model, extent, options) = begun(dataset, options)?;
        let photographs = dataset.train.photographs();
        let moves = options.nodes > 0 && !dataset.has_alpha;
        let exposures = exposure::of_views(dataset, options.rates.exposure);
        let state = State::begun(model, Exposures::neutral(exposure::count(&exposures)));
        let order = ViewOrder::new(photographs.len(), options.seed);
        let encoding = Encoding {
            options: EncodeOptions::default(),
            frames: dataset.frames,
            frames_per_second: 30.0,
            up: dataset.up,
        };
        Ok(Self {
            views: &dataset.train,
            instants: dataset.train.instants(),
            has_alpha: dataset.has_alpha,
            pyramid: Pyramid::new(photographs, options.max_side),
            options,
            changing: moves.then(|| MovingRegion::of(photographs)).flatten(),
            region: Region { extent, free_space: &dataset.free_space },
            fallback: state.clone(),
            finisher: Finisher::new(encoding, &state.model.gaussians),
            state,
            order,
            exposures,
            memory: Memory::default(),
        })
    }

    /// The scene that a training on `dataset` begins with, before its first step.
    ///
    /// # Errors
    /// As [`Trainer::new`].
    pub fn start(dataset: &Dataset, options: &TrainOptions) -> Result<Model, TrainError> {
        begun(dataset, options).map(|(model, ..)| model)
    }

    /// The same, with pictures and their gradients made by `backend`; without it, by the processor.
    ///
    /// A backend gives the same scene bit for bit each time; that of another one differs as its roundings do.
    /// Between two steps a training may go from one to another, with a checkpoint or without.
    ///
    /// # Errors
    /// The graphics device has no memory.
    pub fn on(mut self, backend: &Backend) -> Result<Self, TrainError> {
        self.memory.differentiator = backend.differentiator().map_err(TrainError::Device)?;
        Ok(self)
    }

    /// Goes on from the states of a checkpoint: that of its last step, and what to fall back to.
    pub(super) fn with_state(mut self, state: State, fallback: State) -> Result<Self, TrainError> {
        let refused = |what: &str| Err(TrainError::Checkpoint(what.to_owned()));
        let exposures = self.state.exposures.len();
        if [&state, &fallback].iter().any(|s| !s.is_sound() || s.exposures.len() != exposures) {
            return refused("numbers that do not fit together; the file is damaged");
        }
        if state.size.max(fallback.size) >= self.pyramid.sizes() {
            return refused("made for photographs of another size");
        }
        self.finisher.take_up(&state.finishing, state.model.gaussians())?;
        self.fallback = fallback;
        self.state = state;
        Ok(self)
    }

    /// That of the last step, and what the next one falls back to.
    pub(super) fn states(&self) -> [&State; 2] {
        [&self.state, if self.is_to_keep() { &self.state } else { &self.fallback }]
    }

    /// Makes a parameter not a number, as a division by zero would.
    #[cfg(test)]
    pub(super) fn poison(&mut self) {
        self.state.model.gaussians.sh0.values_mut().fill(f32::NAN);
    }

    /// Begins another loss, as a pruning does.
    #[cfg(test)]
    pub(super) fn begin_another_loss(&mut self) {
        self.state.begin_another_loss();
    }

    /// The same, for an encoding by `encoding`.
    pub fn encoded_by(mut self, encoding: Encoding) -> Self {
        self.finisher.set_encoding(encoding);
        self
    }

    /// Takes a step at `progress` of the training, 0 to 1, which only falls after a rollback.
    ///
    /// # Errors
    /// A view that cannot be rendered, or a training that has diverged for the fourth time.
    pub fn step(&mut self, progress: f64) -> Result<StepReport, TrainError> {
        let progress = progress.clamp(0.0, 1.0);
        self.keep(progress);
        self.enter_stages(progress);
        self.finish(progress)?;
        let mut rng = self.state.rng(self.options.seed);
        let view = self.next_view(progress);
        let loss = self.differentiate(view, progress, &mut rng)?;
        let step = self.state.step + 1;
        let mut diverged = self.state.divergence(loss);
        if diverged.is_none() {
            self.update(view, progress);
            self.control_density(progress, &mut rng);
            self.state.step += 1;
            self.freeze_still(progress)?;
            self.average(progress);
            diverged = self.find_divergence();
        }
        let rollback = diverged.map(|what| (step, what));
        if let Some((step, what)) = &rollback {
            self.rollback(*step, what)?;
        }
        let state = &self.state;
        Ok(StepReport {
            step: state.step,
            view,
            loss,
            mean_loss: state.mean_loss,
            size: self.pyramid.size(view, state.size),
            gaussians: state.model.gaussians(),
            nodes: state.model.nodes(),
            rollback,
        })
    }

    /// Goes on to more pixels, more bands of the harmonics and more nodes where the schedule says so.
    fn enter_stages(&mut self, progress: f64) {
        let state = &mut self.state;
        let size = self.pyramid.schedule().at(&self.options.schedule, progress);
        if size != state.size {
            state.size = size;
            state.pull = ViewGradients::none(state.model.gaussians());
            state.lowest_loss = f64::INFINITY;
        }
        let degree = schedule::degree(&self.options, progress);
        if state.model.gaussians.begin_bands(degree, state.step) {
            // The average so far has fewer bands.
            state.average = None;
        }
        // While views of other times are new, the loss rises with what they show.
        if schedule::time_span(&self.options.schedule, progress) < 1.0 {
            state.lowest_loss = f64::INFINITY;
        }
        let stages = schedule::node_stages(&self.options);
        while let Some(&(from, count)) = stages.get(state.node_stages)
            && progress >= from
        {
            state.model.spread_nodes(count, self.changing.as_ref());
            // Others may move now.
            state.neighbourhoods = Neighbourhoods::default();
            state.node_stages += 1;
        }
        let nodes = &mut state.model.nodes;
        let finest = schedule::finest_spline(&self.options.schedule, progress, self.instants);
        if !nodes.is_empty() && nodes.finest() < finest {
            nodes.refine_time(finest);
        }
    }

    /// Prunes, or begins to round, where the schedule says so.
    fn finish(&mut self, progress: f64) -> Result<(), TrainError> {
        let State { model, finishing, pull, neighbourhoods, average, size, .. } = &mut self.state;
        let options = &self.options;
        let pictures = Pictures {
            photographs: &self.pyramid,
            size: *size,
            background: options.background,
            varies: self.has_alpha && options.schedule.opposite_end > 0.0,
        };
        let needed = finishing.pruned(options, progress, model, pictures, &mut self.memory.differentiator)?;
        if let Some(needed) = &needed {
            model.select(needed);
            neighbourhoods.select(needed);
            *pull = ViewGradients::none(needed.len());
            *average = None;
        }
        let rounds = finishing.rounding_due(&options.finish, progress);
        if rounds {
            self.finisher.encode_first(&options.finish, model, finishing)?;
        }
        if needed.is_some() || rounds {
            self.state.begin_another_loss();
        }
        Ok(())
    }

    /// The next view; early in the training one near the canonical instant.
    fn next_view(&mut self, progress: f64) -> usize {
        let photographs = self.views.photographs();
        let away = |view: usize| (photographs[view].time - self.options.canonical_time).abs();
        let nearest = (0..photographs.len()).map(away).fold(f32::MAX, f32::min);
        let span = schedule::time_span(&self.options.schedule, progress).max(nearest);
        self.order.next(&mut self.state.drawn, |view| away(view) <= span)
    }

    /// Renders the view and leaves the gradients of its splats in memory; returns the loss.
    fn differentiate(&mut self, view: usize, progress: f64, rng: &mut Pcg64Mcg) -> Result<f64, TrainError> {
        let posed = &self.views.photographs()[view];
        let photograph: &Photograph = self.pyramid.photograph(view, self.state.size);
        let [left, top, width, height] = if self.has_alpha && !self.state.step.is_multiple_of(WHOLE_EVERY) {
            self.pyramid.outline(view, self.state.size)
        } else {
            [0, 0, photograph.width(), photograph.height()]
        };
        let camera = posed
            .camera
            .resized(photograph.width(), photograph.height())
            .and_then(|camera| camera.cropped(left, top, width, height))
            .map_err(|source| TrainError::Camera { view: posed.name.clone(), source })?;
        // Where channels are over one of two values, nothing but an outline explains the photograph, and
        // every step asks for it.
        let varies = self.has_alpha && progress <= self.options.schedule.opposite_end;
        let vary = |v: f32| if varies && rng.random::<bool>() { 1.0 - v } else { v };
        let background = self.options.background.map(vary);

        let Memory { differentiator, gradients, statistics, exposure_slopes, instant } = &mut self.memory;
        match self.finisher.rounded(&self.state.model) {
            Some(rounded) => self.state.model.instant_of(rounded, posed.time, instant),
            None => self.state.model.instant_into(posed.time, instant),
        }
        let settings = Settings::over(background).with_footprint(self.state.model.footprint);
        let failed = |source: BackendError| TrainError::View { view: posed.name.clone(), source };
        let loss = PhotographLoss::new(photograph, background, self.options.weights())
            .cropped(left, top, width, height)
            .and_then(|loss| self.pyramid.where_counted(view, self.state.size, loss))
            .map_err(|error| failed(AdjointError::from(error).into()))?;
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree)
            .map_err(|source| TrainError::Splats { view: posed.name.clone(), source })?;
        let schedule = &self.options.schedule;
        let counted = self.options.density == DensityControl::Split && progress < schedule.density_end;
        statistics.clear();
        let statistics = counted.then_some(statistics);
        let exposed = self.exposures[view].map(|index| Exposed::new(&loss, self.state.exposures.get(index)));
        let taken: &dyn Loss = exposed.as_ref().map_or(&loss, |exposed| exposed);
        differentiator
            .differentiate(&splats, &camera, &settings, taken, gradients, statistics)
            .map_err(failed)?;
        *exposure_slopes = exposed.map(Exposed::slopes).unwrap_or_default();
        Ok(gradients.loss)
    }

    /// Takes the gradients in memory back to all parameters, and a step against them.
    fn update(&mut self, view: usize, progress: f64) {
        let time = self.views.photographs()[view].time;
        if progress < self.options.schedule.density_end {
            self.state.pull.add(&self.memory.gradients.splats, &self.memory.statistics);
        }
        let of_positions = self.price_residuals(progress);
        let gradients = &self.memory.gradients;
        let state = &mut self.state;
        let Model { gaussians, nodes, followed, .. } = &mut state.model;
        let poses = nodes.poses(time);
        let mut of_nodes =
            gaussians.backward(&nodes.skin(&poses), followed, &gradients.splats, &gradients.sh_rest);
        gaussians.add_position_gradients(&of_positions);
        // Rigidity is a sum of squared lengths: measured in extents it means the same in every scene.
        let unit = self.region.extent.half_side as f32;
        let rigidity = schedule::rigidity(&self.options, progress) / (unit * unit);
        nodes.add_rigidity_gradient(rigidity, &poses, &mut of_nodes);
        nodes.add_stillness_gradient(self.options.stillness, &poses, &mut of_nodes);
        nodes.backward(time, &poses, of_nodes);
        nodes.add_smoothness_gradient(self.options.smoothness, time);
        gaussians.regularise(self.options.opacity_weight, self.options.scale_weight, unit);
        self.finisher.price(&self.options.finish, state.step, &mut state.model);
        let Model { gaussians, nodes, .. } = &mut state.model;

        let caution = 0.5f32.powi(state.rollbacks as i32);
        let rates = schedule::attribute_rates(&self.options, progress, unit).scaled(caution);
        let step = AdamStep { rate: 0.0, first_decay: 0.9, second_decay: 0.999, number: state.step + 1 };
        gaussians.step(rates, step);
        let rate = caution * schedule::node_rate(&self.options, progress);
        nodes.step(AdamStep { rate, second_decay: 0.99, ..step });
        if let Some(index) = self.exposures[view] {
            let rate = caution * schedule::exposure_rate(&self.options, progress);
            state.exposures.step(index, self.memory.exposure_slopes, rate);
        }
    }

    /// Adds to the gradients of the splats in memory those of what their residuals cost, once they do; gives
    /// those of the positions before motion, by index.
    fn price_residuals(&mut self, progress: f64) -> Vec<(usize, [f32; 3])> {
        let weight = f64::from(schedule::residual_weight(&self.options, progress));
        let State { model, neighbourhoods, step, .. } = &mut self.state;
        let mut of_positions = Vec::new();
        if weight == 0.0 || model.nodes.is_empty() {
            return of_positions;
        }
        if neighbourhoods.is_empty() || step.is_multiple_of(NEIGHBOURHOODS_EVERY) {
            let moves = |index: usize| model.followed[index].is_some();
            *neighbourhoods = Neighbourhoods::of(&model.trajectories(), moves);
        }
        let Memory { gradients, instant, .. } = &mut self.memory;
        // What was shown was moved from the rounded ones, where values are rounded.
        let rest = self.finisher.last_rounded(model.gaussians()).unwrap_or(&model.gaussians);
        let unit = self.region.extent.half_side;
        let share = weight / instant.gaussians.len().max(1) as f64;
        let moved = |index: usize| (instant.gaussians[index].position, instant.gaussians[index].rotation);
        let rest = |index: usize| (rest.positions()[index], rest.rotations()[index]);
        neighbourhoods.each_residual(rest, moved, |index, residual, map| {
            let slopes = residual_slopes(residual, map, unit);
            let [of_moved, of_rest] = slopes.map(|slope| (share * slope).as_vec3().to_array());
            gradients.splats[index].position.iter_mut().zip(of_moved).for_each(|(sum, v)| *sum += v);
            of_positions.push((index, of_rest));
        });
        of_positions
    }

    /// Adds and removes Gaussians if it is time.
    fn control_density(&mut self, progress: f64, rng: &mut Pcg64Mcg) {
        let (options, state) = (&self.options, &mut self.state);
        let unit = self.region.extent.half_side as f32;
        if options.density == DensityControl::Relocate && progress < 0.85 {
            let rate = schedule::attribute_rates(options, progress, 1.0).position;
            density::jitter(&mut state.model.gaussians, rate, unit, rng);
        }
        let due = state.step.saturating_sub(state.last_density) >= DENSITY_EVERY;
        if !due || !(0.01..options.schedule.density_end).contains(&progress) {
            return;
        }
        state.last_density = state.step;
        let target = schedule::gaussians(options, progress);
        let Model { gaussians, followed, .. } = &mut state.model;
        let from = density::control(gaussians, &state.pull, target, options.density, self.region, rng);
        *followed = from.iter().map(|&index| followed[index]).collect();
        state.neighbourhoods.select(&from);
        state.pull = ViewGradients::none(gaussians.len());
        // The average so far is one of others.
        state.average = None;
    }

    /// Stands Gaussians still that hardly move, if it is time and pictures of training views bear it.
    fn freeze_still(&mut self, progress: f64) -> Result<(), TrainError> {
        let stages = schedule::stands(&self.options);
        let due = stages.get(self.state.stands).is_some_and(|&at| progress >= at);
        // Once values are rounded, the encoder has chosen what moves.
        let is_early = self.state.step < STAND_STILL_FROM;
        if !due || is_early || self.state.finishing.has_rounded() || !self.state.model.is_sound() {
            return Ok(());
        }
        self.state.stands += 1;
        let reduced = self.pyramid.divisor(self.state.size);
        let State { model, exposures, .. } = &mut self.state;
        let exposure_of = |view: usize| self.exposures[view].map(|index| exposures.get(index));
        let (views, background) = (self.views, self.options.background);
        let trial = Trial { views, exposure_of: &exposure_of, reduced, background };
        let most = self.options.stand_still_within * self.region.extent.half_side as f32;
        freeze::freeze_still(model, most, &trial)?;
        // They hold none that stands still, and are found anew; the average is of what moved.
        self.state.neighbourhoods = Neighbourhoods::default();
        self.state.average = None;
        Ok(())
    }

    /// Averages the parameters over steps, where the schedule says so.
    fn average(&mut self, progress: f64) {
        let from = self.options.schedule.average_from;
        let State { average, model, .. } = &mut self.state;
        if from < 1.0 && progress >= from {
            Average::follow(average, model);
        } else {
            *average = None;
        }
    }
}
