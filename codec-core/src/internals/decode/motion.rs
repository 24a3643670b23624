//! Motion of a cluster at a frame: the track moves it, coefficients bend it.
//!
//! Position: `c + d(t) + L(t)·(μ̄ − c) + Σ_r b_r(t)·q_r`, the paper's equation 1 with the affine
//! taken about the cluster's centre c. Tracks, and the coefficients of all classes but position,
//! are in the orthonormal cosine basis (DCT-II) of the window; position coefficients are in the
//! window's learned basis.

use glam::{Mat3, Vec3};

use super::{
    Part,
    column::{Column, Runs, SPAN, Values, carried, each, triple},
    cut, lacking, symbols_of,
};
use crate::{
    closure::bending_level,
    error::Result,
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
    window: Window,
    /// Cosine basis at this frame, one weight per frequency.
    cosine: [f32; MAX_WINDOW_FRAMES],
    /// Learned basis at this frame, one weight per vector.
    learned: [f32; MAX_WINDOW_FRAMES],
}

impl Frame {
    /// The window `frame` lies in, if motion is sent for it.
    pub(super) fn of(manifest: &Manifest<'_>, frame: u32) -> Option<Self> {
        let id = manifest.window_at(frame)?;
        let window = manifest.window(id)?;
        let t = frame - window.first_frame;
        let mut learned = [0f32; MAX_WINDOW_FRAMES];
        for (r, weight) in learned.iter_mut().take(usize::from(window.rank)).enumerate() {
            let vector = window.basis_first as usize + r * usize::from(window.frames);
            *weight = manifest.basis(vector + t as usize);
        }
        Some(Self { id, window, cosine: cosine(u32::from(window.frames), t), learned })
    }
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
pub fn pose(shape: &Shape, symbols: &[i16], cosine: &[f32; MAX_WINDOW_FRAMES]) -> Pose {
    let [translation, linear, rodrigues] = track_steps(shape);
    let track = shape.motion.class();
    let turning = track.turning();
    let count = turning * usize::from(shape.motion.track);
    let (turns, moves) = symbols.split_at(count.min(symbols.len()));
    let mut value = [0f32; 9];
    let mut shift = [0f32; 3];
    let add = |sums: &mut [f32], symbols: &[i16]| {
        if sums.is_empty() {
            return;
        }
        for (symbols, &weight) in symbols.chunks_exact(sums.len()).zip(cosine) {
            for (sum, &symbol) in sums.iter_mut().zip(symbols) {
                if symbol != 0 {
                    *sum += f32::from(symbol) * weight;
                }
            }
        }
    };
    let (turn, _) = value.split_at_mut(turning.min(9));
    add(turn, turns);
    add(&mut shift, moves);
    let (rows, rotation) = match track {
        Track::Static => return Pose::IDENTITY,
        Track::Rigid => {
            let m = [value[0], value[1], value[2]].map(|v| bounded(v * rodrigues));
            let rotation = math::normalised(math::quat_from_mrp(m));
            (math::rows_from_quat(rotation), rotation)
        }
        Track::Affine => {
            let l = value.map(|v| bounded(v * linear));
            let rows = [[1.0 + l[0], l[1], l[2]], [l[3], 1.0 + l[4], l[5]], [l[6], l[7], 1.0 + l[8]]];
            (rows, math::turn_of(rows))
        }
    };
    let [x, y, z] = rows;
    Pose {
        linear: Mat3::from_cols(
            Vec3::new(x[0], y[0], z[0]),
            Vec3::new(x[1], y[1], z[1]),
            Vec3::new(x[2], y[2], z[2]),
        ),
        translation: Vec3::from_array(shift) * translation,
        rotation,
    }
}

/// No real motion comes near the bound; it keeps hostile positions finite.
fn bounded(parameter: f32) -> f32 {
    parameter.clamp(-LINEAR_MOST, LINEAR_MOST)
}

/// Moves the cluster's Gaussians in the output.
pub(super) fn apply(part: &mut Part<'_, '_>, frame: &Frame) -> Result<()> {
    let span = Span::Motion(frame.id);
    let content = part.content;
    let found = Shape::of(&content.manifest, span, part.cluster).zip(content.cell(span, part.cluster));
    let (shape, cell) =
        found.ok_or_else(|| lacking("memory.cells", content.cells.len(), part.cluster.index()))?;
    let step = part.shape.quant.canonical[Class::Position.index()].step(Level::BASE);
    let record = part.shape.cluster;
    let centre = Vec3::new(
        part.epoch.origin_x + f32::from(record.centre_x) * step,
        part.epoch.origin_y + f32::from(record.centre_y) * step,
        part.epoch.origin_z + f32::from(record.centre_z) * step,
    );
    let current = track(part, &shape, cell, frame);
    let pose = match current {
        Some(pose) => pose,
        None => held(part, frame).unwrap_or(Pose::IDENTITY),
    };
    if pose != Pose::IDENTITY {
        for gaussian in part.out.iter_mut() {
            let offset = Vec3::from_array(gaussian.position) - centre;
            gaussian.position = (pose.linear * offset + centre + pose.translation).to_array();
            gaussian.rotation = math::quat_mul(pose.rotation, gaussian.rotation);
        }
    }
    for block in 0..shape.blocks() {
        let (motion, canonical) = (content.arrived(cell, block), content.arrived(part.cell, block));
        if let Some(level) = bending_level(motion, canonical) {
            bend(part, &shape, cell, block, level, frame)?;
        }
    }
    Ok(())
}

/// The pose in the current window, if its track is usable.
fn track(part: &Part<'_, '_>, shape: &Shape, cell: Cell, frame: &Frame) -> Option<Pose> {
    if shape.motion.class() == Track::Static {
        return Some(Pose::IDENTITY);
    }
    if !part.content.arrived(cell, 0).has(Level::BASE) {
        return None;
    }
    let start = cell.symbols as usize;
    let symbols = part.content.symbols.get(start..start + shape.level_len(Level::BASE))?;
    Some(pose(shape, symbols, &frame.cosine))
}

/// The last pose of the latest earlier window of the epoch whose track is usable.
fn held(part: &Part<'_, '_>, frame: &Frame) -> Option<Pose> {
    let content = part.content;
    let mut w = frame.id.0;
    while w > 0 {
        w -= 1;
        let id = WindowId(w);
        let window = content.manifest.window(id)?;
        if EpochId(window.epoch) != part.id {
            return None;
        }
        let span = Span::Motion(id);
        let shape = Shape::of(&content.manifest, span, part.cluster)?;
        let cell = content.cell(span, part.cluster)?;
        if shape.motion.class() != Track::Static && !part.content.arrived(cell, 0).has(Level::BASE) {
            continue;
        }
        // Only here, not for every window passed over: a basis costs more than the rest of a step.
        let frames = u32::from(window.frames);
        let cosine = cosine(frames, frames.saturating_sub(1));
        let last = Frame { id, window, cosine, learned: [0.0; MAX_WINDOW_FRAMES] };
        return track(part, &shape, cell, &last);
    }
    None
}

/// Adds the per-Gaussian coefficients of one block.
fn bend(
    part: &mut Part<'_, '_>,
    shape: &Shape,
    cell: Cell,
    block: usize,
    level: Level,
    frame: &Frame,
) -> Result<()> {
    let n = shape.block_gaussians(block);
    let first = block * shape.block_len;
    let symbols = symbols_of(part.content, cell, shape)?;
    let mut runs = Runs::of(shape, symbols, block, level)?;
    for class in Class::ALL.into_iter().take(Class::MOVING) {
        let rank = shape.motion.rank(class);
        if rank == 0 {
            continue;
        }
        let carries = carried(shape, class);
        let quantiser = shape.quant.motion[class.index()];
        let step = quantiser.step(level);
        let basis = if class == Class::Position { &frame.learned } else { &frame.cosine };
        let weights = basis.iter().take(usize::from(frame.window.frames)).take(rank);
        let mut sums = [[[0.0; SPAN]; 3]; MAX_BLOCK_LEN / SPAN];
        for &weight in weights {
            for d in 0..class.components() {
                let mut column = Column::new(runs.next(carries), quantiser, Level::ALL[1], level, 0);
                for sums in sums.iter_mut().take(n.div_ceil(SPAN)) {
                    let Some(sums) = sums.get_mut(d) else { continue };
                    for (sum, q) in sums.iter_mut().zip(column.take()) {
                        *sum += q as f32 * step * weight;
                    }
                }
            }
        }
        // No window has more coefficients than frames; what a hostile one has beyond is passed over.
        for _ in usize::from(frame.window.frames)..rank {
            for _ in 0..class.components() {
                runs.next(carries);
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
