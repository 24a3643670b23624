//! Motion of a cluster at a frame: the track moves it, coefficients bend it.
//!
//! Position: `c + d(t) + L(t)·(μ̄ − c) + Σ_r b_r(t)·q_r`, the paper's equation 1 with the affine
//! taken about the cluster's centre c. Tracks, and the coefficients of all classes but position,
//! are in the orthonormal cosine basis (DCT-II) of the window; position coefficients are in the
//! window's learned basis.

use glam::{Mat3, Vec3};

use super::{
    cluster::{ClusterDecode, cut, symbols_of},
    column::{Column, Runs, SPAN, Values, carrying_levels, each, triple},
};
use crate::{
    closure::coefficient_level,
    error::{Error, Result},
    gaussian::Gaussian,
    ids::{EpochId, Level, Span, WindowId},
    layout::Shape,
    limits::{MAX_BLOCK_LEN, MAX_WINDOW_FRAMES},
    math,
    quant::Class,
    receiver::Cell,
    wire::manifest::{Manifest, Track, Window},
};

/// What is common to all clusters at one frame.
pub(super) struct Frame {
    id: WindowId,
    /// Cosine basis at this frame, one weight per frequency.
    cosine: [f32; MAX_WINDOW_FRAMES],
    /// Learned basis at this frame, one weight per vector.
    learned: [f32; MAX_WINDOW_FRAMES],
}

impl Frame {
    /// The window `frame` lies in, if motion is sent for it.
    ///
    /// # Errors
    /// A basis beyond the values that there are.
    pub(super) fn of(manifest: &Manifest<'_>, frame: u32) -> Result<Option<Self>> {
        let Some(id) = manifest.window_at(frame) else { return Ok(None) };
        let window = window_of(manifest, id)?;
        let t = frame - window.first_frame;
        let mut learned = [0f32; MAX_WINDOW_FRAMES];
        let rank = usize::from(window.rank);
        let vectors = learned.get_mut(..rank);
        for (r, weight) in vectors.ok_or_else(|| most_vectors(rank))?.iter_mut().enumerate() {
            let index = window.basis_first as usize + r * usize::from(window.frames) + t as usize;
            let all = manifest.head().basis_values as usize;
            *weight =
                manifest.basis(index).ok_or_else(|| Error::too_small("manifest.basis", all, index + 1))?;
        }
        Ok(Some(Self { id, cosine: cosine(u32::from(window.frames), t), learned }))
    }
}

/// Window `id`, which the stream must have.
fn window_of(manifest: &Manifest<'_>, id: WindowId) -> Result<Window> {
    let have = usize::from(manifest.head().windows);
    manifest.window(id).ok_or_else(|| Error::too_small("manifest.windows", have, id.index() + 1))
}

/// More coefficients than a window can have.
#[cold]
fn most_vectors(rank: usize) -> Error {
    Error::illegal("motion.rank", 0, rank as u64, (0, MAX_WINDOW_FRAMES as u64))
}

/// The orthonormal DCT-II basis of `frames` frames at frame `t`, one weight per frequency.
pub fn cosine(frames: u32, t: u32) -> [f32; MAX_WINDOW_FRAMES] {
    let mut weights = [0f32; MAX_WINDOW_FRAMES];
    let flat = libm::sqrtf(1.0 / frames as f32);
    let wave = libm::sqrtf(2.0 / frames as f32);
    for (k, weight) in weights.iter_mut().take(frames as usize).enumerate() {
        let scale = if k == 0 { flat } else { wave };
        *weight = scale * math::cos_pi((2 * t + 1) * k as u32, 2 * frames);
    }
    weights
}

/// Largest linear track parameter, either sign.
pub const LINEAR_MOST: f32 = 1e6;
/// Smallest and largest scale that bending leaves, scene units.
pub const SCALE_RANGE: (f32, f32) = (1e-36, 1e35);

/// A cluster's pose: linear part, translation and rotation about its centre.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pose {
    /// I + ΔL.
    pub linear: Mat3,
    /// Translation, scene units.
    pub translation: Vec3,
    /// Unit quaternion, wxyz.
    pub rotation: [f32; 4],
}

impl Pose {
    /// No motion.
    pub const IDENTITY: Self =
        Self { linear: Mat3::IDENTITY, translation: Vec3::ZERO, rotation: [1.0, 0.0, 0.0, 0.0] };
}

/// Steps of a track's parameters: translation, scene units; linear map; modified Rodrigues
/// parameters. At the cluster's radius all move a point by about the same.
pub fn track_steps(shape: &Shape) -> [f32; 3] {
    let position = shape.quant.canonical[Class::Position.index()];
    let mut step = position.step(Level::ALL[3]) * 0.25;
    for _ in 0..shape.motion.track_shift {
        step *= 2.0;
    }
    let radius = f32::from(shape.cluster.radius) * position.step(Level::BASE);
    let linear = step / radius;
    [step, linear, linear * 0.25]
}

/// The pose that a track's `symbols` give at `cosine`'s frame: parameters that turn, one list per
/// frequency, then those of translation.
///
/// # Errors
/// Fewer symbols than the track has.
pub fn pose(shape: &Shape, symbols: &[i16], cosine: &[f32; MAX_WINDOW_FRAMES]) -> Result<Pose> {
    let [translation, linear, rodrigues] = track_steps(shape);
    let track = shape.motion.class();
    let count = track.turning() * usize::from(shape.motion.track);
    let halves = symbols.split_at_checked(count);
    let (turns, moves) = halves.ok_or_else(|| Error::too_small("memory.symbols", symbols.len(), count))?;
    let (rows, rotation) = match track {
        Track::Static => return Ok(Pose::IDENTITY),
        Track::Rigid => {
            let m = sums::<3>(turns, cosine).map(|v| bounded(v * rodrigues));
            let rotation = math::normalised(math::quat_from_mrp(m));
            (math::rows_from_quat(rotation), rotation)
        }
        Track::Affine => {
            let l = sums::<9>(turns, cosine).map(|v| bounded(v * linear));
            let rows = [[1.0 + l[0], l[1], l[2]], [l[3], 1.0 + l[4], l[5]], [l[6], l[7], 1.0 + l[8]]];
            (rows, math::turn_of(rows))
        }
    };
    let [x, y, z] = rows;
    Ok(Pose {
        linear: Mat3::from_cols(
            Vec3::new(x[0], y[0], z[0]),
            Vec3::new(x[1], y[1], z[1]),
            Vec3::new(x[2], y[2], z[2]),
        ),
        translation: Vec3::from_array(sums::<3>(moves, cosine)) * translation,
        rotation,
    })
}

/// `N` parameters from their `symbols`, a list of `N` per frequency.
#[inline(never)]
fn sums<const N: usize>(symbols: &[i16], cosine: &[f32; MAX_WINDOW_FRAMES]) -> [f32; N] {
    let mut sums = [0f32; N];
    for (symbols, &weight) in symbols.as_chunks::<N>().0.iter().zip(cosine) {
        for (sum, &symbol) in sums.iter_mut().zip(symbols) {
            if symbol != 0 {
                *sum += f32::from(symbol) * weight;
            }
        }
    }
    sums
}

/// No real motion comes near the bound; it keeps hostile positions finite.
fn bounded(parameter: f32) -> f32 {
    parameter.clamp(-LINEAR_MOST, LINEAR_MOST)
}

/// Moves the cluster's Gaussians in the output.
pub(super) fn apply(part: &mut ClusterDecode<'_, '_>, frame: &Frame) -> Result<()> {
    let span = Span::Motion(frame.id);
    let content = part.content;
    let shape = Shape::in_lattice(content.manifest, span, part.cluster)?;
    let cell = content.cell_in_lattice(span, part.cluster)?;
    let step = part.shape.quant.canonical[Class::Position.index()].step(Level::BASE);
    let record = part.shape.cluster;
    let centre = Vec3::new(
        part.epoch.origin_x + f32::from(record.centre_x) * step,
        part.epoch.origin_y + f32::from(record.centre_y) * step,
        part.epoch.origin_z + f32::from(record.centre_z) * step,
    );
    let pose = match track(part, &shape, cell, &frame.cosine)? {
        Some(pose) => pose,
        // Without any the cluster stays as it is in the canonical attributes.
        None => earlier_pose(part, frame)?.unwrap_or(Pose::IDENTITY),
    };
    if pose != Pose::IDENTITY {
        for gaussian in part.out.iter_mut() {
            let offset = Vec3::from_array(gaussian.position) - centre;
            gaussian.position = (pose.linear * offset + centre + pose.translation).to_array();
            gaussian.rotation = math::quat_mul(pose.rotation, gaussian.rotation);
        }
    }
    for block in 0..shape.blocks() {
        let (motion, canonical) = (content.arrived(cell, block)?, content.arrived(part.cell, block)?);
        if let Some(level) = coefficient_level(motion, canonical) {
            apply_coefficients(part, &shape, cell, block, level, frame)?;
        }
    }
    Ok(())
}

/// The pose in the window of `cell` at `cosine`'s frame, if the track is usable.
#[inline(never)]
fn track(
    part: &ClusterDecode<'_, '_>,
    shape: &Shape,
    cell: Cell,
    cosine: &[f32; MAX_WINDOW_FRAMES],
) -> Result<Option<Pose>> {
    if shape.motion.class() == Track::Static {
        return Ok(Some(Pose::IDENTITY));
    }
    if !part.content.arrived(cell, 0)?.has(Level::BASE) {
        return Ok(None);
    }
    let (symbols, len) = (symbols_of(part.content, cell, shape)?, shape.level_len(Level::BASE));
    let symbols = symbols.get(..len).ok_or_else(|| Error::too_small("memory.symbols", symbols.len(), len))?;
    pose(shape, symbols, cosine).map(Some)
}

/// The last pose of the latest earlier window of the epoch whose track is usable.
#[inline(never)]
fn earlier_pose(part: &ClusterDecode<'_, '_>, frame: &Frame) -> Result<Option<Pose>> {
    let content = part.content;
    for w in (0..frame.id.0).rev() {
        let id = WindowId(w);
        let window = window_of(content.manifest, id)?;
        if EpochId(window.epoch) != part.id {
            break;
        }
        let span = Span::Motion(id);
        let cell = content.cell_in_lattice(span, part.cluster)?;
        let motion = content.manifest.motion(id, part.cluster);
        let is_static = motion.is_some_and(|motion| motion.class() == Track::Static);
        if !is_static && !content.arrived(cell, 0)?.has(Level::BASE) {
            continue;
        }
        // Only here, not for every window passed over: shape and basis cost more than the rest of a step.
        let shape = Shape::in_lattice(content.manifest, span, part.cluster)?;
        let frames = u32::from(window.frames);
        return track(part, &shape, cell, &cosine(frames, frames - 1));
    }
    Ok(None)
}

/// Adds the per-Gaussian coefficients of one block.
fn apply_coefficients(
    part: &mut ClusterDecode<'_, '_>,
    shape: &Shape,
    cell: Cell,
    block: usize,
    level: Level,
    frame: &Frame,
) -> Result<()> {
    let n = shape.block_gaussians(block);
    let first = shape.first_of(block);
    let symbols = symbols_of(part.content, cell, shape)?;
    let mut runs = Runs::of(shape, symbols, block, level)?;
    for class in Class::ALL.into_iter().take(Class::MOVING) {
        let rank = shape.motion.rank(class);
        if rank == 0 {
            continue;
        }
        let carries = carrying_levels(shape, class);
        let quantiser = shape.quant.motion[class.index()];
        let step = quantiser.step(level);
        let basis = if class == Class::Position { &frame.learned } else { &frame.cosine };
        let weights = basis.get(..rank).ok_or_else(|| most_vectors(rank))?;
        let mut sums = [[[0.0; SPAN]; 3]; MAX_BLOCK_LEN / SPAN];
        for &weight in weights {
            for (d, _) in (0..3).zip(0..class.components()) {
                let runs = runs.next(carries)?;
                let mut column = Column::new(runs, quantiser, Level::ALL[1], level, 0);
                for sums in sums.iter_mut().take(n.div_ceil(SPAN)) {
                    for (sum, q) in sums[d].iter_mut().zip(column.take()) {
                        *sum += q as f32 * step * weight;
                    }
                }
            }
        }
        let out = cut("decode.out", part.out, first..first + n)?;
        for (out, sums) in out.chunks_mut(SPAN).zip(&mut sums) {
            add(class, sums, out);
        }
    }
    Ok(())
}

/// Adds `sums` of `class` to what `out` has of it.
#[inline(never)]
fn add(class: Class, sums: &mut Values, out: &mut [Gaussian]) {
    match class {
        Class::Rotation => {
            let mut w = [1.0; SPAN];
            let [x, y, z] = sums;
            math::normalise([&mut w, x, y, z]);
            for ((((gaussian, w), x), y), z) in out.iter().zip(&mut w).zip(&mut *x).zip(&mut *y).zip(&mut *z)
            {
                [*w, *x, *y, *z] = math::quat_mul([*w, *x, *y, *z], gaussian.rotation);
            }
            math::normalise([&mut w, x, y, z]);
            for ((((gaussian, w), x), y), z) in out.iter_mut().zip(w).zip(&*x).zip(&*y).zip(&*z) {
                gaussian.rotation = [w, *x, *y, *z];
            }
        }
        Class::Opacity => {
            let [sums, ..] = sums;
            for (gaussian, sum) in out.iter_mut().zip(sums) {
                gaussian.opacity = (gaussian.opacity + *sum).clamp(0.0, 1.0);
            }
        }
        _ => {
            if class == Class::Scale {
                math::exp_all(sums.as_flattened_mut());
            }
            let (least, most) = SCALE_RANGE;
            each(sums, out, |gaussian, by| {
                for (value, by) in triple(gaussian, class).iter_mut().zip(by) {
                    *value =
                        if class == Class::Scale { (*value * by).clamp(least, most) } else { *value + by };
                }
            });
        }
    }
}
