//! Measures the counterfactual utility of every group: what it adds to a picture (paper section 5).
//!
//! For group g and a valid partial state m without g: Δ_g(m) = D(I, R(m)) − D(I, R(m ∪ g)), with
//! D = MSE + 0.20 (1 − SSIM) against a reference I: the source's own render, or a photograph, equal to every
//! picture where its mask leaves pixels out. A context is
//! a random dependency-closed state; inside it each cell is stepped through its levels with everything else
//! held, so that L + 1 pictures measure L groups. All contexts of a span are rendered in the same views (a
//! frame and a camera each), so mean, lower tail and deviation are over states and not over views. The gain
//! of a group is its Δ where everything else is there, one state in more views. Cameras are the caller's;
//! keep them apart from those on which quality is reported.

use codec_core::internals::{
    ids::{EpochId, Level, Span},
    receiver::Content,
};
use rayon::prelude::*;
use render_host::Settings;

use self::{
    contexts::{SpanCells, spans},
    references::{Quantity, View, random},
    versions::Clusters,
};
use crate::stream::PacketMap;

mod alone;
mod audit;
mod contexts;
mod error;
mod gain;
mod references;
mod together;
mod truncation;
mod versions;

pub use alone::measure_alone;
pub use audit::LevelAudit;
pub use error::UtilityError;
pub use gain::gain_cameras;
pub use references::{ReferencePhotograph, ReferencePhotographs, References, SourceRenders};
pub use truncation::{Truncated, truncate, truncation_cameras};

/// How to measure.
#[derive(Clone, Debug)]
pub struct UtilityOptions {
    /// Random states per span, at least 1.
    pub contexts: usize,
    /// Weight α of the lower tail, 0..=1.
    pub alpha: f64,
    /// Weight β of the interaction deviation, at least 0.
    pub beta: f64,
    /// Measure with everything else arrived, instead of in random states: one context.
    pub complete: bool,
    /// Seed of the contexts and of the frames rendered.
    pub seed: u64,
    /// Render settings; the footprint is the stream's.
    pub settings: Settings,
}

impl UtilityOptions {
    /// The paper's α = 0.25, β = 0.05 and 0.10 quantile: 32 contexts.
    pub fn paper() -> Self {
        Self {
            contexts: 32,
            alpha: 0.25,
            beta: 0.05,
            complete: false,
            seed: 1,
            settings: Settings::default(),
        }
    }

    /// The same for pictures of `content`.
    fn of_content(&self, content: &Content<'_>) -> Self {
        let settings = self.settings.clone().with_footprint(content.manifest.footprint());
        Self { settings, ..self.clone() }
    }

    /// What is measured: in the complete state, gains are the means.
    fn quantities(&self) -> &'static [Quantity] {
        if self.complete { &[Quantity::Utility] } else { &[Quantity::Utility, Quantity::Gain] }
    }

    /// How `quantity` is measured.
    fn of_quantity(&self, quantity: Quantity) -> Self {
        Self { complete: self.complete || quantity == Quantity::Gain, ..self.clone() }
    }

    /// States rendered per span.
    fn states(&self) -> usize {
        if self.complete { 1 } else { self.contexts.max(1) }
    }
}

/// What one group adds to a picture.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct GroupUtility {
    /// Cell of the lattice.
    pub cell: u32,
    /// Level.
    pub level: u8,
    /// Mean of Δ over contexts; the Δ of a context is the mean over its views.
    pub mean: f64,
    /// 0.10 quantile of Δ over contexts.
    pub tail: f64,
    /// Standard deviation of Δ over contexts.
    pub deviation: f64,
    /// Risk-adjusted utility Ũ = ((1 − α) mean + α tail) / (1 + β deviation).
    pub utility: f64,
    /// Δ where everything else is there, mean over views.
    pub gain: f64,
    /// Of a group of level 0: Δ of all such groups of its span at once, where everything else is there, mean
    /// over the views of `gain`. What they gain one by one does not add up to it. Measured where there are
    /// several spans, to compare them.
    pub together: Option<f64>,
}

/// Utilities of all groups of one stream, as stored beside it.
///
/// # Examples
/// ```
/// use trainer_host::{
///     encode::{EncodeOptions, encode},
///     import::{Limits, synth},
///     stream::PacketMap,
///     utility::{References, UtilityOptions, measure},
///     viewpoint::{Framing, Ring},
/// };
///
/// let options = synth::SynthOptions { gaussians: 1000, frames: 1, ..Default::default() };
/// let scene = synth::make(&options, &Limits::default())?;
/// let options = EncodeOptions { pictures: 0, ..Default::default() };
/// let stream = encode(&scene, &options, &trainer_host::encode::no_progress)?.stream;
/// let (map, received) = (PacketMap::of(&stream)?, stream.receive()?);
/// let cameras = Framing::of(&scene).ring(Ring::Validation, 1, (48, 48))?;
/// let references = References::renders(&scene, &cameras, &cameras);
/// let how = UtilityOptions { contexts: 2, ..UtilityOptions::paper() };
/// let table = measure(&references, &received.content(), &map, &how, &|_share| {})?;
/// assert_eq!(table.groups.len(), map.groups().len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Table {
    /// How they were measured, for people.
    pub protocol: String,
    /// CRC-32 of the manifest they belong to.
    pub manifest_crc: u32,
    /// States that mean, tail and deviation of a group are over.
    pub contexts: u32,
    /// Pairs of a state and a group whose Δ was measured, in every view.
    pub deltas: u64,
    /// One per group, in the order of [`PacketMap::groups`].
    pub groups: Vec<GroupUtility>,
}

/// Most numbers that the versions of one view's clusters may hold before the engine is called: 128 MiB.
const MAX_VALUES: usize = 32 << 20;

/// Measures all groups of `content` (a complete decode of a stream whose map is `map`) against
/// `references`. `progress` is called with the share done, 0..=1.
///
/// Deterministic for equal inputs on any number of threads.
///
/// # Errors
/// No camera, a span that no photograph shows, or a stream that does not decode.
pub fn measure(
    references: &References<'_>,
    content: &Content<'_>,
    map: &PacketMap,
    options: &UtilityOptions,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Table, UtilityError> {
    let options = &options.of_content(content);
    let spans = spans(map);
    let mut jobs: Vec<Job> = Vec::new();
    for span in &spans {
        for quantity in options.quantities() {
            let views = references.views_of(content, span.span, *quantity, options.seed)?;
            jobs.extend((0..views).map(|view| Job { span, quantity: *quantity, view, views }));
        }
    }
    // Of one span nothing is compared with another's.
    let are_several = spans.len() > 1;
    let done = std::sync::atomic::AtomicUsize::new(0);
    let results: Result<Vec<(Vec<Delta>, f64)>, UtilityError> = jobs
        .par_iter()
        .map(|job| {
            let (epoch, view) = job.seen(references, content, options)?;
            let mut deltas = deltas_in_view(content, map, job, (epoch, &view), options)?;
            deltas.iter_mut().for_each(|delta| delta.delta /= job.views as f64);
            let together = if are_several && job.is_of_gains(options) {
                together::in_view(&view, content, map, job.span, &options.settings)? / job.views as f64
            } else {
                0.0
            };
            let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress(n as f64 / jobs.len() as f64);
            Ok((deltas, together))
        })
        .collect();
    // Of each group and context, the mean over views.
    let mut samples: Vec<Vec<f64>> = vec![Vec::new(); map.groups().len()];
    let mut gains = vec![0.0; map.groups().len()];
    let mut together = gains.clone();
    let mut deltas = 0;
    for (job, (found, in_view)) in jobs.iter().zip(results?) {
        deltas += found.len() as u64;
        job.span.groups(map).for_each(|(_, groups)| together[groups[0]] += in_view);
        for Delta { group, context, delta } in found {
            if job.is_of_gains(options) {
                gains[group] += delta;
            }
            if job.quantity == Quantity::Utility {
                samples[group].resize(options.states(), 0.0);
                samples[group][context] += delta;
            }
        }
    }
    let groups = map.groups().iter().zip(&mut samples).enumerate().map(|(at, ((group, _), samples))| {
        let cell = content.manifest.cell(group.span, group.cluster).map_or(0, |c| c.0);
        let together = (are_several && group.level == Level::BASE).then(|| together[at]);
        GroupUtility { gain: gains[at], together, ..summarise(cell, group.level, samples, options) }
    });
    let contexts =
        if options.complete { "complete state".to_owned() } else { format!("{} contexts", options.states()) };
    Ok(Table {
        protocol: format!(
            "D = MSE + 0.20 (1 - SSIM) against {}; {contexts}, alpha {}, beta {}, seed {}",
            references.description(),
            options.alpha,
            options.beta,
            options.seed
        ),
        manifest_crc: codec_core::internals::wire::crc::crc32(content.manifest.raw()),
        contexts: options.states() as u32,
        deltas,
        groups: groups.collect(),
    })
}

/// A view of a span.
#[derive(Clone, Copy)]
struct Job<'a> {
    span: &'a SpanCells,
    quantity: Quantity,
    view: usize,
    /// Views of the span.
    views: usize,
}

impl Job<'_> {
    /// Whether its state is the complete one.
    fn is_of_gains(&self, options: &UtilityOptions) -> bool {
        self.quantity == Quantity::Gain || options.complete
    }

    /// Its view, and the epoch that it shows.
    fn seen(
        &self,
        references: &References<'_>,
        content: &Content<'_>,
        options: &UtilityOptions,
    ) -> Result<(EpochId, View), UtilityError> {
        let UtilityOptions { seed, settings, .. } = options;
        references.view(content, self.span.span, self.quantity, self.view, *seed, settings)
    }
}

/// Mean, tail, deviation and risk-adjusted utility of a group's samples.
fn summarise(cell: u32, level: Level, samples: &mut [f64], options: &UtilityOptions) -> GroupUtility {
    samples.sort_unstable_by(f64::total_cmp);
    let n = samples.len().max(1) as f64;
    let mean = samples.iter().sum::<f64>() / n;
    let variance = samples.iter().map(|s| (s - mean).powi(2)).sum::<f64>() / n;
    let tail = quantile(samples, 0.1);
    let deviation = variance.sqrt();
    let utility = ((1.0 - options.alpha) * mean + options.alpha * tail) / (1.0 + options.beta * deviation);
    GroupUtility { cell, level: level.get(), mean, tail, deviation, utility, gain: 0.0, together: None }
}

/// Linear-interpolated quantile of sorted samples; 0 if there are none.
pub fn quantile(sorted: &[f64], q: f64) -> f64 {
    let Some(last) = sorted.len().checked_sub(1) else { return 0.0 };
    let at = q.clamp(0.0, 1.0) * last as f64;
    let (low, part) = (at.floor() as usize, at.fract());
    sorted[low] + part * (sorted[(low + 1).min(last)] - sorted[low])
}

/// Δ of a group in a context and a view.
struct Delta {
    group: usize,
    context: usize,
    delta: f64,
}

/// Δ of all groups of one span in all contexts, in one view of the span.
fn deltas_in_view(
    content: &Content<'_>,
    map: &PacketMap,
    &Job { span, quantity, .. }: &Job<'_>,
    (epoch, view): (EpochId, &View),
    options: &UtilityOptions,
) -> Result<Vec<Delta>, UtilityError> {
    let options = &options.of_quantity(quantity);
    let mut clusters = Clusters::new(content, epoch, view.frame);
    let (mut waiting, mut out) = (Vec::new(), Vec::new());
    // Contexts whose clusters show versions of their own go to the engine one at a time: together, each would
    // be shown in the versions of all.
    let mut are_shared = true;
    for context in 0..options.states() {
        let state = state_of(content, map, span.span, context, options);
        let known = clusters.values();
        let shown = clusters.shown_by(&state)?;
        let steps: Result<Vec<Vec<u32>>, UtilityError> = (0..=span.most_levels())
            .map(|levels| clusters.shown_by(&span.stepped(map, content, &state, levels)))
            .collect();
        waiting.push((context, shown, steps?));
        are_shared &= known == 0 || clusters.values() == known;
        if !are_shared || clusters.values() > MAX_VALUES || context + 1 == options.states() {
            let shown: Vec<Vec<u32>> = waiting.iter().map(|(_, shown, _)| shown.clone()).collect();
            let found = clusters.distortions(&shown, view, &options.settings)?;
            for (index, (context, _, steps)) in waiting.drain(..).enumerate() {
                for (cluster, groups) in span.groups(map) {
                    let distortion =
                        |levels: usize| found.of(index, cluster, steps[levels][cluster] as usize);
                    for (level, &group) in groups.iter().enumerate() {
                        let delta = distortion(level) - distortion(level + 1);
                        out.push(Delta { group, context, delta });
                    }
                }
            }
            clusters.clear();
        }
    }
    Ok(out)
}

/// The state that context `context` of `span` is.
fn state_of(
    content: &Content<'_>,
    map: &PacketMap,
    span: Span,
    context: usize,
    options: &UtilityOptions,
) -> Vec<u8> {
    if options.complete {
        return content.blocks.to_vec();
    }
    contexts::random_state(map, &mut random(span, context as u32, 1, options.seed), content)
}

#[cfg(test)]
mod tests;
