//! Measures the counterfactual utility of every group: what it adds to a picture (paper section 5).
//!
//! For group g and a valid partial state m without g: Δ_g(m) = D(I, R(m)) − D(I, R(m ∪ g)), with
//! D = MSE + 0.20 (1 − SSIM) against the source's own render I. A context is a random dependency-closed
//! state; inside it each cell is stepped through its levels with everything else held, so that L + 1
//! pictures measure L groups. All contexts of a span are rendered in the same views (a frame and a camera
//! each), so mean, lower tail and deviation are over states and not over views. Cameras are the caller's;
//! keep them apart from those on which quality is reported.

use codec_core::internals::{
    ids::{EpochId, Level, Span},
    receiver::Content,
};
use rand::RngExt;
use rand_pcg::Pcg64;
use rayon::prelude::*;
use render_host::{Camera, Image, Renderer, Settings, Splats};

use self::{
    contexts::{SpanCells, spans},
    versions::Clusters,
};
use crate::{scene::Scene, stream::PacketMap};

mod alone;
mod contexts;
mod error;
mod truncation;
mod versions;

pub use alone::measure_alone;
pub use error::UtilityError;
pub use truncation::{Truncated, group_bytes, tops, truncate};

/// How to measure.
#[derive(Clone, Debug)]
pub struct UtilityOptions {
    /// Cameras to measure on, at least one.
    pub cameras: Vec<Camera>,
    /// Random states per span, at least 1.
    pub contexts: usize,
    /// Frames of a span (a window, or an epoch for canonical groups) that each camera renders, at least 1.
    pub frames_per_span: usize,
    /// Weight α of the lower tail, 0..=1.
    pub alpha: f64,
    /// Weight β of the interaction deviation, at least 0.
    pub beta: f64,
    /// Measure with everything else arrived, instead of in random states: one context.
    pub complete: bool,
    /// Seed of the contexts and of the frames rendered.
    pub seed: u64,
    /// Render settings.
    pub settings: Settings,
}

impl UtilityOptions {
    /// The paper's α = 0.25, β = 0.05 and 0.10 quantile on `cameras`: 32 contexts, one frame per span and
    /// camera.
    pub fn paper(cameras: Vec<Camera>) -> Self {
        Self {
            cameras,
            contexts: 32,
            frames_per_span: 1,
            alpha: 0.25,
            beta: 0.05,
            complete: false,
            seed: 1,
            settings: Settings::default(),
        }
    }

    /// States rendered per span.
    fn states(&self) -> usize {
        if self.complete { 1 } else { self.contexts.max(1) }
    }

    /// Frame and camera pairs per span.
    fn views(&self) -> usize {
        self.cameras.len() * self.frames_per_span.max(1)
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
}

/// Utilities of all groups of one stream, as stored beside it.
///
/// # Examples
/// ```
/// use trainer_host::{
///     encode::{EncodeOptions, encode},
///     import::{Limits, synth},
///     stream::PacketMap,
///     utility::{UtilityOptions, measure},
///     viewpoint::{Framing, Ring},
/// };
///
/// let options = synth::SynthOptions { gaussians: 1000, frames: 1, ..Default::default() };
/// let scene = synth::make(&options, &Limits::default())?;
/// let stream = encode(&scene, &EncodeOptions { pictures: 0, ..Default::default() }, &|_, _| {})?.stream;
/// let (map, received) = (PacketMap::of(&stream)?, stream.receive()?);
/// let cameras = Framing::of(&scene).ring(Ring::Measuring, 1, (48, 48))?;
/// let how = UtilityOptions { contexts: 2, ..UtilityOptions::paper(cameras) };
/// let table = measure(&scene, &received.content(), &map, &how, &|_share| {})?;
/// assert_eq!(table.groups.len(), map.groups().len());
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Table {
    /// How they were measured, for people.
    pub protocol: String,
    /// CRC-32 of the manifest they belong to.
    pub manifest_crc: u32,
    /// Pairs of a state and a group whose Δ was measured, in every view.
    pub deltas: u64,
    /// One per group, in the order of [`PacketMap::groups`].
    pub groups: Vec<GroupUtility>,
}

/// A camera and frame in which the contexts of a span are rendered.
struct View {
    frame: u32,
    camera: usize,
    reference: Image,
}

/// Most numbers that the versions of one view's clusters may hold before the engine is called: 128 MiB.
const MOST_VALUES: usize = 32 << 20;

/// Measures all groups of `content` (a complete decode of a stream whose map is `map`) against
/// `scene`. `progress` is told the share done, 0..=1.
///
/// Deterministic for equal inputs on any number of threads.
///
/// # Errors
/// No camera, or a stream that does not decode.
pub fn measure(
    scene: &Scene,
    content: &Content<'_>,
    map: &PacketMap,
    options: &UtilityOptions,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Table, UtilityError> {
    if options.cameras.is_empty() {
        return Err(UtilityError::NoCamera);
    }
    let spans = spans(map);
    let views = options.views();
    let jobs: Vec<(usize, usize)> =
        (0..spans.len()).flat_map(|s| (0..views).map(move |view| (s, view))).collect();
    let done = std::sync::atomic::AtomicUsize::new(0);
    let results: Result<Vec<Vec<Delta>>, UtilityError> = jobs
        .par_iter()
        .map(|&(s, view)| {
            let deltas = deltas_in_view(scene, content, map, &spans[s], view, options)?;
            let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress(n as f64 / jobs.len() as f64);
            Ok(deltas)
        })
        .collect();
    // Of each group and context, the mean over views.
    let mut samples: Vec<Vec<f64>> = vec![Vec::new(); map.groups().len()];
    let mut deltas = 0;
    for Delta { group, context, delta } in results?.into_iter().flatten() {
        samples[group].resize(options.states(), 0.0);
        samples[group][context] += delta / views as f64;
        deltas += 1;
    }
    let groups = map.groups().iter().zip(&mut samples).map(|((group, _), samples)| {
        let cell = content.manifest.cell(group.span, group.cluster).map_or(0, |c| c.0);
        summarise(cell, group.level, samples, options)
    });
    let contexts =
        if options.complete { "complete state".to_owned() } else { format!("{} contexts", options.states()) };
    Ok(Table {
        protocol: format!(
            "D = MSE + 0.20 (1 - SSIM), {} cameras at {}x{}, {contexts}, {} frames per span and camera, \
             alpha {}, beta {}, seed {}",
            options.cameras.len(),
            options.cameras[0].width(),
            options.cameras[0].height(),
            options.frames_per_span,
            options.alpha,
            options.beta,
            options.seed
        ),
        manifest_crc: codec_core::internals::wire::crc::crc32(content.manifest.raw()),
        deltas,
        groups: groups.collect(),
    })
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
    GroupUtility { cell, level: level.get(), mean, tail, deviation, utility }
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

/// Δ of all groups of one span in all contexts, in view `view` of the span.
fn deltas_in_view(
    scene: &Scene,
    content: &Content<'_>,
    map: &PacketMap,
    span: &SpanCells,
    view: usize,
    options: &UtilityOptions,
) -> Result<Vec<Delta>, UtilityError> {
    let (epoch, view) = view_of(scene, content, span.span, view, options)?;
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
        if !are_shared || clusters.values() > MOST_VALUES || context + 1 == options.states() {
            let shown: Vec<Vec<u32>> = waiting.iter().map(|(_, shown, _)| shown.clone()).collect();
            let camera = &options.cameras[view.camera];
            let found = clusters.distortions(&shown, camera, &view.reference, &options.settings)?;
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

/// Numbers for one purpose, keyed by what they are for, so that no other span changes this one's luck.
fn random(span: Span, index: u32, purpose: u32, options: &UtilityOptions) -> Pcg64 {
    let label = match span {
        Span::Canonical(e) => u64::from(e.0) << 1,
        Span::Motion(w) => u64::from(w.0) << 1 | 1,
    };
    let key = u128::from(label) << 32 | u128::from(purpose) << 31 | u128::from(index);
    Pcg64::new(u128::from(options.seed) << 64 | key, 0xa02_bdbf_7bb3_c0a7)
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
    contexts::random_state(map, &mut random(span, context as u32, 1, options), content)
}

/// View `index` of `span`, with the source's own render, and the epoch that it shows.
fn view_of(
    scene: &Scene,
    content: &Content<'_>,
    span: Span,
    index: usize,
    options: &UtilityOptions,
) -> Result<(EpochId, View), UtilityError> {
    let (epoch, first, frames) = match span {
        Span::Canonical(id) => {
            let epoch = content.manifest.epoch(id).unwrap_or_default();
            (id, epoch.first_frame, epoch.frames)
        }
        Span::Motion(id) => {
            let window = content.manifest.window(id).unwrap_or_default();
            (EpochId(window.epoch), window.first_frame, u32::from(window.frames))
        }
    };
    let frame = first + random(span, index as u32, 0, options).random_range(0..frames.max(1));
    let camera = index % options.cameras.len();
    let refused = |error: &dyn std::fmt::Display| UtilityError::Render(error.to_string());
    let source = scene.instant(frame as usize).unwrap_or_default();
    let splats = Splats::new(&source.gaussians, &source.sh_rest, source.sh_degree);
    let splats = splats.map_err(|e| refused(&e))?;
    let rendered = Renderer::new().render(&splats, &options.cameras[camera], &options.settings);
    let reference = rendered.map_err(|e| refused(&e))?.image;
    Ok((epoch, View { frame, camera, reference }))
}

#[cfg(test)]
mod tests;
