//! Counterfactual render utility: what a group is worth, measured in images (paper section 5).
//!
//! For group g and a valid partial state m without g: Δ_g(m) = D(I, R(m)) − D(I, R(m ∪ g)), with
//! D = MSE + 0.20 (1 − SSIM) against the source's own render I. A context is a random
//! dependency-closed state; inside it each cell is stepped through its levels with everything
//! else held, so that L + 1 pictures measure L groups. The pictures of all cells are one world batch of the
//! renderer, bit for bit those of separate renders. Cameras and frames are the caller's; keep
//! them apart from those on which quality is reported.

use codec_core::internals::{
    closure::Arrived,
    ids::{Group, Level, Span},
    receiver::Content,
};
use rand::RngExt;
use rand_pcg::Pcg64;
use rayon::prelude::*;
use render_host::{Camera, Image, Renderer, Settings, Splats};

use crate::{
    scene::Scene,
    stream::{PacketMap, Player},
};

use pictures::Pictures;

mod pictures;
mod worth;

pub use worth::{Truncated, group_bytes, tops, truncate};

/// How to measure.
#[derive(Clone, Debug)]
pub struct Options {
    /// Cameras to measure on.
    pub cameras: Vec<Camera>,
    /// Contexts per cell and frame.
    pub contexts: usize,
    /// Frames per window (or per epoch, for canonical groups) to measure at.
    pub frames_per_span: usize,
    /// Weight α of the lower tail.
    pub alpha: f64,
    /// Weight β of the interaction deviation.
    pub beta: f64,
    /// Measure with everything else arrived, instead of in random states.
    pub complete: bool,
    /// Seed of the contexts.
    pub seed: u64,
    /// Render settings.
    pub settings: Settings,
}

impl Options {
    /// The paper's α = 0.25, β = 0.05 and 0.10 quantile on `cameras`, four contexts, one frame per
    /// span.
    pub fn paper(cameras: Vec<Camera>) -> Self {
        Self {
            cameras,
            contexts: 4,
            frames_per_span: 1,
            alpha: 0.25,
            beta: 0.05,
            complete: false,
            seed: 1,
            settings: Settings::default(),
        }
    }
}

/// What one group is worth.
#[derive(Clone, Copy, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct GroupUtility {
    /// Cell of the lattice.
    pub cell: u32,
    /// Level.
    pub level: u8,
    /// Mean of Δ over contexts, frames and cameras.
    pub mean: f64,
    /// 0.10 quantile of Δ.
    pub tail: f64,
    /// Standard deviation of Δ.
    pub deviation: f64,
    /// Risk-adjusted utility Ũ = ((1 − α) mean + α tail) / (1 + β deviation).
    pub utility: f64,
}

/// Utilities of all groups of one stream, as stored beside it.
#[derive(Clone, Debug, PartialEq, serde::Serialize, serde::Deserialize)]
pub struct Table {
    /// How they were measured.
    pub protocol: String,
    /// CRC-32 of the manifest they belong to.
    pub manifest_crc: u32,
    /// Renders it took.
    pub renders: u64,
    /// One per group, in the order of [`PacketMap::groups`].
    pub groups: Vec<GroupUtility>,
}

/// Why utilities cannot be measured.
#[derive(Debug, thiserror::Error)]
pub enum UtilityError {
    /// Nothing to look with.
    #[error("no camera was given; at least one is needed")]
    NoCamera,
    /// The stream does not decode.
    #[error(transparent)]
    Decode(#[from] codec_core::Error),
    /// The renderer refused its input.
    #[error("rendering failed: {0}")]
    Render(String),
}

/// One frame and camera at which a span is measured.
struct Shot {
    frame: u32,
    camera: usize,
    reference: Image,
}

/// Measures all groups of `content` (a complete decode of a stream whose map is `map`) against
/// `scene`. `progress` is told the share done.
///
/// Deterministic for equal inputs on any number of threads.
///
/// # Errors
/// No camera, or a stream that does not decode.
pub fn measure(
    scene: &Scene,
    content: &Content<'_>,
    map: &PacketMap,
    options: &Options,
    progress: &(dyn Fn(f64) + Sync),
) -> Result<Table, UtilityError> {
    if options.cameras.is_empty() {
        return Err(UtilityError::NoCamera);
    }
    let spans = spans(map);
    let done = std::sync::atomic::AtomicUsize::new(0);
    let total = spans.len() * options.contexts.max(1);
    let jobs: Vec<(usize, u64)> =
        (0..spans.len()).flat_map(|s| (0..options.contexts as u64).map(move |c| (s, c))).collect();
    let results: Result<Vec<Vec<(usize, f64)>>, UtilityError> = jobs
        .par_iter()
        .map(|&(s, context)| {
            let samples = span_samples(scene, content, map, &spans[s], context, options)?;
            let n = done.fetch_add(1, std::sync::atomic::Ordering::Relaxed) + 1;
            progress(n as f64 / total as f64);
            Ok(samples)
        })
        .collect();
    let mut samples: Vec<Vec<f64>> = vec![Vec::new(); map.groups().len()];
    for (group, delta) in results?.into_iter().flatten() {
        samples[group].push(delta);
    }
    let renders = samples.iter().map(|s| s.len() as u64).sum();
    let groups = map.groups().iter().zip(&mut samples).map(|((group, _), samples)| {
        let cell = content.manifest.cell(group.span, group.cluster).map_or(0, |c| c.0);
        summarise(cell, group.level, samples, options)
    });
    let cameras = options.cameras.len();
    Ok(Table {
        protocol: format!(
            "paired renders, D = MSE + 0.20 (1 - SSIM), {cameras} cameras at {}x{}, {} {}contexts, {} frames per span, alpha {}, beta {}, seed {}",
            options.cameras[0].width(),
            options.cameras[0].height(),
            options.contexts,
            if options.complete { "complete " } else { "" },
            options.frames_per_span,
            options.alpha,
            options.beta,
            options.seed
        ),
        manifest_crc: codec_core::internals::wire::crc::crc32(content.manifest.raw()),
        renders,
        groups: groups.collect(),
    })
}

/// Mean, tail, deviation and risk-adjusted utility of a group's samples.
fn summarise(cell: u32, level: Level, samples: &mut [f64], options: &Options) -> GroupUtility {
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

/// A span and its cells: per cell the first group index and its groups' levels.
struct SpanCells {
    span: Span,
    cells: Vec<Vec<usize>>,
}

fn spans(map: &PacketMap) -> Vec<SpanCells> {
    let mut spans: Vec<SpanCells> = Vec::new();
    let mut last: Option<Group> = None;
    for (index, (group, _)) in map.groups().iter().enumerate() {
        if last.is_none_or(|l| l.span != group.span) {
            spans.push(SpanCells { span: group.span, cells: Vec::new() });
        }
        if let Some(span) = spans.last_mut() {
            let same = last.is_some_and(|l| (l.span, l.cluster) == (group.span, group.cluster));
            match span.cells.last_mut().filter(|_| same) {
                Some(cell) => cell.push(index),
                None => span.cells.push(vec![index]),
            }
        }
        last = Some(*group);
    }
    spans
}

/// Δ samples of all groups of one span in one context.
fn span_samples(
    scene: &Scene,
    content: &Content<'_>,
    map: &PacketMap,
    span: &SpanCells,
    context: u64,
    options: &Options,
) -> Result<Vec<(usize, f64)>, UtilityError> {
    let manifest = &content.manifest;
    let (first, frames, label) = match span.span {
        Span::Canonical(e) => {
            let epoch = manifest.epoch(e).unwrap_or_default();
            (epoch.first_frame, epoch.frames, u64::from(e.0) << 1)
        }
        Span::Motion(w) => {
            let window = manifest.window(w).unwrap_or_default();
            (window.first_frame, u32::from(window.frames), u64::from(w.0) << 1 | 1)
        }
    };
    // The random stream is keyed by what it is for, so that no other span changes this one's luck.
    let mut rng = Pcg64::new(
        u128::from(options.seed) << 64 | u128::from(label) << 32 | u128::from(context),
        0xa02_bdbf_7bb3_c0a7,
    );
    let mut shots = Vec::new();
    for k in 0..options.frames_per_span.max(1) {
        let frame = first + rng.random_range(0..frames.max(1));
        let camera = (context as usize + k) % options.cameras.len();
        let source = scene.instant(frame as usize).unwrap_or_default();
        let splats = Splats::new(&source.gaussians, &source.sh_rest, source.sh_degree);
        let reference = render(splats, &options.cameras[camera], &options.settings, &mut Renderer::new())?;
        shots.push(Shot { frame, camera, reference });
    }
    let mut state =
        if options.complete { content.blocks.to_vec() } else { random_state(map, &mut rng, content) };
    let mut player = Player::new(manifest);
    let mut samples = Vec::new();
    for shot in &shots {
        let mut pictures = Pictures::new(player.instant(&content.with_state(&state), shot.frame)?);
        // Groups whose gain lies between one state and the next; none before the first of a cell.
        let mut steps = Vec::new();
        for (family, cell_groups) in (0..).zip(&span.cells) {
            let (group, _) = map.groups()[cell_groups[0]];
            let Some(cell) = content.cell(group.span, group.cluster) else { continue };
            let blocks = cell.blocks as usize..cell.blocks as usize + blocks_of(map, cell_groups, content);
            let kept: Vec<u8> = state[blocks.clone()].to_vec();
            // Motion shows only on blocks that are there.
            let canonical = match group.span {
                Span::Motion(w) => {
                    let epoch = manifest.window(w).map_or(0, |w| w.epoch);
                    content.cell(Span::Canonical(codec_core::internals::ids::EpochId(epoch)), group.cluster)
                }
                Span::Canonical(_) => None,
            };
            let canonical = canonical.map(|c| c.blocks as usize..c.blocks as usize + blocks.len());
            let kept_canonical: Vec<u8> = canonical.clone().map(|r| state[r].to_vec()).unwrap_or_default();
            if let Some(range) = canonical.clone() {
                state[range].iter_mut().for_each(|m| *m = Arrived(*m).with(Level::BASE).0);
            }
            state[blocks.clone()].copy_from_slice(&map.initial()[blocks.clone()]);
            for index in std::iter::once(None).chain(cell_groups.iter().map(|&index| Some(index))) {
                if let Some(index) = index {
                    let level = map.groups()[index].0.level;
                    state[blocks.clone()].iter_mut().for_each(|m| *m = Arrived(*m).with(level).0);
                }
                let shown = player.show(&content.with_state(&state), shot.frame)?;
                pictures.add(family, shown.gaussians, shown.sh_rest);
                steps.push(index);
            }
            state[blocks].copy_from_slice(&kept);
            if let Some(range) = canonical {
                state[range].copy_from_slice(&kept_canonical);
            }
        }
        // The threads are busy with other states: one batch is one task.
        let settings = Settings { parallel: false, ..options.settings.clone() };
        let distances = pictures.distances(&options.cameras[shot.camera], &settings, &shot.reference)?;
        let gains = steps[1.min(steps.len())..].iter().zip(distances.windows(2));
        samples.extend(gains.filter_map(|(index, pair)| index.map(|index| (index, pair[0] - pair[1]))));
    }
    Ok(samples)
}

fn blocks_of(map: &PacketMap, cell_groups: &[usize], content: &Content<'_>) -> usize {
    let (group, _) = map.groups()[cell_groups[0]];
    codec_core::internals::layout::Shape::of(&content.manifest, group.span, group.cluster)
        .map_or(0, |s| s.blocks())
}

/// A random dependency-closed state: every cell at a random number of levels, bases likelier than
/// not, as a receiver in mid-delivery has them.
fn random_state(map: &PacketMap, rng: &mut Pcg64, content: &Content<'_>) -> Vec<u8> {
    let mut state = map.initial().to_vec();
    let arriving: f64 = rng.random_range(0.4..1.0);
    let mut cell: Option<Group> = None;
    let mut open = true;
    for (group, _) in map.groups() {
        if cell.is_none_or(|c| (c.span, c.cluster) != (group.span, group.cluster)) {
            open = true;
        }
        cell = Some(*group);
        let chance = if group.level == Level::BASE { arriving.sqrt() } else { arriving };
        open &= rng.random::<f64>() < chance;
        if open
            && let Some(found) = content.cell(group.span, group.cluster)
            && let Some(shape) =
                codec_core::internals::layout::Shape::of(&content.manifest, group.span, group.cluster)
        {
            let first = found.blocks as usize;
            for mask in &mut state[first..first + shape.blocks()] {
                *mask = Arrived(*mask).with(group.level).0;
            }
        }
    }
    state
}

fn render<E: std::fmt::Display>(
    splats: Result<Splats<'_>, E>,
    camera: &Camera,
    settings: &Settings,
    renderer: &mut Renderer,
) -> Result<Image, UtilityError> {
    let splats = splats.map_err(|e| UtilityError::Render(e.to_string()))?;
    // The threads are busy with other states: one render is one task.
    let settings = Settings { parallel: false, ..settings.clone() };
    let rendered = renderer.render(&splats, camera, &settings);
    rendered.map(|r| r.image).map_err(|e| UtilityError::Render(e.to_string()))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_risk_adjusted_utility_is_the_papers() {
        let options = Options::paper(Vec::new());
        let mut samples = vec![4.0, 0.0, 1.0, 2.0, 3.0];
        let u = summarise(7, Level::BASE, &mut samples, &options);
        let deviation = 2f64.sqrt();
        assert_eq!((u.mean, u.tail), (2.0, 0.4));
        assert!((u.utility - (0.75 * 2.0 + 0.25 * 0.4) / (1.0 + 0.05 * deviation)).abs() < 1e-12);
    }

    #[test]
    fn quantiles_interpolate() {
        assert_eq!(quantile(&[1.0, 2.0, 3.0], 0.5), 2.0);
        assert_eq!(quantile(&[0.0, 10.0], 0.1), 1.0);
        assert_eq!(quantile(&[], 0.1), 0.0);
    }
}
