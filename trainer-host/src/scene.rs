//! Holds scenes: Gaussians over frames, in the domains that importers read and the encoder chooses in.
//!
//! A [`Scene`] is a list of [`Epoch`]s. Inside one epoch identity is fixed: index `i` is the same
//! Gaussian at every frame. A clip whose identity is not stored, or that is re-meshed, is several
//! epochs. Attributes that do not change over an epoch are stored once ([`Track::Constant`]), so
//! nothing downstream does work, or spends bytes, for motion that is not there.
//!
//! Domains: positions in scene units, natural-log scales, unit wxyz quaternions, opacity as a
//! logit, colour as spherical-harmonic coefficients. World: right-handed; importers convert.

pub mod activation;
mod digest;
pub mod edit;
pub mod export;
pub(crate) mod footprint_name;
pub mod import;
pub mod viewpoint;

pub use codec_core::Up;
use codec_core::{Footprint, Gaussian, ShDegree};
use render_host::Camera;

/// An attribute of N Gaussians over T frames.
#[derive(Clone, Debug, PartialEq)]
pub enum Track<T> {
    /// The same N values at every frame.
    Constant(Vec<T>),
    /// T·N values, frame-major: frame `t` is `values[t * n..(t + 1) * n]`.
    PerFrame(Vec<T>),
}

impl<T: Copy + PartialEq> Track<T> {
    /// The N values of frame `t`. `t` must be below the epoch's frame count.
    pub fn frame(&self, t: usize, n: usize) -> &[T] {
        match self {
            Track::Constant(values) => values,
            Track::PerFrame(values) => &values[t * n..(t + 1) * n],
        }
    }

    /// True when the attribute is stored once for all frames.
    pub fn is_constant(&self) -> bool {
        matches!(self, Track::Constant(_))
    }

    /// Stores the track once if every frame equals the first bit for bit.
    #[must_use]
    pub fn collapse(self, n: usize) -> Self {
        match self {
            Track::PerFrame(mut values)
                if n > 0 && values.chunks_exact(n).all(|frame| frame == &values[..n]) =>
            {
                values.truncate(n);
                Track::Constant(values)
            }
            other => other,
        }
    }

    fn len_is_valid(&self, n: usize, frames: usize) -> bool {
        match self {
            Track::Constant(values) => values.len() == n,
            Track::PerFrame(values) => values.len() == n * frames,
        }
    }
}

/// A span of frames over which identity is fixed.
///
/// Lengths agree by construction: see [`Epoch::new`].
#[derive(Clone, Debug, PartialEq)]
pub struct Epoch {
    count: usize,
    frames: usize,
    attributes: Attributes,
}

/// The attributes of an epoch's N Gaussians over its T frames.
#[derive(Clone, Debug, PartialEq)]
pub struct Attributes {
    /// Centres, scene units.
    pub positions: Track<[f32; 3]>,
    /// Unit quaternions, wxyz.
    pub rotations: Track<[f32; 4]>,
    /// Natural log of the standard deviations.
    pub log_scales: Track<[f32; 3]>,
    /// Opacity logits; opacity is `1 / (1 + exp(-logit))`.
    pub opacity_logits: Track<f32>,
    /// Band-0 coefficients; display colour is `0.5 + 0.28209479 * sh0`.
    pub sh0: Track<[f32; 3]>,
    /// Higher bands, `sh_degree.rest_len()` per Gaussian: coefficient-major, channel inner.
    pub sh_rest: Vec<f32>,
    /// Degree of `sh_rest`.
    pub sh_degree: ShDegree,
}

impl Attributes {
    /// Those of no Gaussians.
    pub(crate) fn of_none(sh_degree: ShDegree) -> Self {
        Self {
            positions: Track::Constant(Vec::new()),
            rotations: Track::Constant(Vec::new()),
            log_scales: Track::Constant(Vec::new()),
            opacity_logits: Track::Constant(Vec::new()),
            sh0: Track::Constant(Vec::new()),
            sh_rest: Vec::new(),
            sh_degree,
        }
    }

    /// Whether nothing changes over the frames.
    pub fn is_constant(&self) -> bool {
        self.positions.is_constant()
            && self.rotations.is_constant()
            && self.log_scales.is_constant()
            && self.opacity_logits.is_constant()
            && self.sh0.is_constant()
    }
}

/// A scene part whose arrays do not fit together, or hold values no renderer can draw.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum SceneError {
    /// An array has the wrong length.
    #[error("{attribute}: found {found} values, need {needed} ({count} Gaussians, {frames} frames)")]
    Length {
        /// Which attribute.
        attribute: &'static str,
        /// Values found.
        found: usize,
        /// Values needed.
        needed: usize,
        /// Gaussians in the epoch.
        count: usize,
        /// Frames in the epoch.
        frames: usize,
    },
    /// A value is NaN or infinite.
    #[error("{attribute} of Gaussian {gaussian} at frame {frame} is {found}; only finite values are allowed")]
    NotFinite {
        /// Which attribute.
        attribute: &'static str,
        /// Index of the Gaussian in its epoch.
        gaussian: usize,
        /// Frame in its epoch.
        frame: usize,
        /// The value found.
        found: f32,
    },
    /// The epoch or scene holds nothing.
    #[error("{0} is empty; at least one is needed")]
    Empty(&'static str),
    /// The frame rate is not a positive finite number.
    #[error("frame rate is {0}; a positive finite number of frames per second is allowed")]
    FrameRate(f64),
}

/// Natural-log scales are clamped to this range on entry (e^-20 .. e^10 scene units).
pub const LOG_SCALE_RANGE: (f32, f32) = (-20.0, 10.0);
/// Opacity logits are clamped to ± this on entry: opacity within 6e-6 of 0 or 1.
pub const OPACITY_LOGIT_LIMIT: f32 = 12.0;

impl Epoch {
    /// Checks that `attributes` describe N Gaussians over `frames` frames, N being the length of
    /// the first frame of positions, and brings them into range: quaternions normalised (a zero
    /// one becomes the identity), log-scales and logits clamped (infinite logits are legal input),
    /// unchanging tracks stored once.
    ///
    /// # Errors
    /// Wrong lengths, no frames, or a NaN/infinite value.
    pub fn new(frames: usize, mut attributes: Attributes) -> Result<Self, SceneError> {
        if frames == 0 {
            return Err(SceneError::Empty("the list of frames"));
        }
        let count = match &attributes.positions {
            Track::Constant(values) => values.len(),
            Track::PerFrame(values) => values.len() / frames,
        };
        let a = &mut attributes;
        let length = |attribute, track_len: usize, per_frame: bool, valid: bool| {
            if valid {
                return Ok(());
            }
            let needed = if per_frame { count * frames } else { count };
            Err(SceneError::Length { attribute, found: track_len, needed, count, frames })
        };
        macro_rules! check {
            ($name:literal, $track:expr) => {
                length($name, track_len(&$track), !$track.is_constant(), $track.len_is_valid(count, frames))?
            };
        }
        check!("position", a.positions);
        check!("rotation", a.rotations);
        check!("log-scale", a.log_scales);
        check!("opacity", a.opacity_logits);
        check!("sh0", a.sh0);
        let rest = a.sh_degree.rest_len() * count;
        if a.sh_rest.len() != rest {
            let found = a.sh_rest.len();
            return Err(SceneError::Length { attribute: "sh_rest", found, needed: rest, count, frames });
        }
        let clamp = |v: &mut f32, lo: f32, hi: f32| {
            if !v.is_nan() {
                *v = v.clamp(lo, hi);
            }
        };
        for v in values_mut(&mut a.log_scales) {
            v.iter_mut().for_each(|v| clamp(v, LOG_SCALE_RANGE.0, LOG_SCALE_RANGE.1));
        }
        for v in values_mut(&mut a.opacity_logits) {
            clamp(v, -OPACITY_LOGIT_LIMIT, OPACITY_LOGIT_LIMIT);
        }
        finite("position", count, values_mut(&mut a.positions).iter().map(|v| &v[..]))?;
        finite("rotation", count, values_mut(&mut a.rotations).iter().map(|v| &v[..]))?;
        finite("log-scale", count, values_mut(&mut a.log_scales).iter().map(|v| &v[..]))?;
        finite("opacity", count, values_mut(&mut a.opacity_logits).iter().map(std::slice::from_ref))?;
        finite("sh0", count, values_mut(&mut a.sh0).iter().map(|v| &v[..]))?;
        finite("sh_rest", count.max(1), a.sh_rest.chunks(a.sh_degree.rest_len().max(1)))?;
        for q in values_mut(&mut a.rotations) {
            *q = normalised(*q);
        }
        let Attributes { positions, rotations, log_scales, opacity_logits, sh0, sh_rest, sh_degree } =
            attributes;
        let attributes = Attributes {
            positions: positions.collapse(count),
            rotations: rotations.collapse(count),
            log_scales: log_scales.collapse(count),
            opacity_logits: opacity_logits.collapse(count),
            sh0: sh0.collapse(count),
            sh_rest,
            sh_degree,
        };
        Ok(Self { count, frames, attributes })
    }

    /// One frame without Gaussians.
    pub(crate) fn empty() -> Self {
        Self { count: 0, frames: 1, attributes: Attributes::of_none(ShDegree::ZERO) }
    }

    /// Number of Gaussians, N. May be zero.
    pub fn count(&self) -> usize {
        self.count
    }

    /// Number of frames, T ≥ 1.
    pub fn frames(&self) -> usize {
        self.frames
    }

    /// The attribute tracks.
    pub fn attributes(&self) -> &Attributes {
        &self.attributes
    }

    /// The splats of frame `t` (counted in this epoch), ready to render; past the end, of the last one.
    pub fn instant(&self, t: usize) -> Instant {
        let gaussians = (0..self.count).map(|i| self.gaussian(i, t)).collect();
        let a = &self.attributes;
        Instant { gaussians, sh_rest: a.sh_rest.clone(), sh_degree: a.sh_degree }
    }

    /// Gaussian `i`, below [`Epoch::count`], at frame `t`; past the end, at the last.
    #[inline]
    pub(crate) fn gaussian(&self, i: usize, t: usize) -> Gaussian {
        let (n, t, a) = (self.count, t.min(self.frames - 1), &self.attributes);
        Gaussian {
            position: a.positions.frame(t, n)[i],
            scale: a.log_scales.frame(t, n)[i].map(f32::exp),
            rotation: a.rotations.frame(t, n)[i],
            opacity: activation::sigmoid(a.opacity_logits.frame(t, n)[i]),
            sh0: a.sh0.frame(t, n)[i],
        }
    }
}

/// An instant's splats, ready to render: Gaussians and their higher harmonic bands.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Instant {
    /// N Gaussians.
    pub gaussians: Vec<Gaussian>,
    /// `sh_degree.rest_len()` coefficients per Gaussian (see [`ShDegree::rest_len`]).
    pub sh_rest: Vec<f32>,
    /// Degree of `sh_rest`.
    pub sh_degree: ShDegree,
}

/// A dynamic scene: epochs in order at one frame rate, with its cameras where known.
///
/// # Examples
/// ```
/// use trainer_host::import::{Limits, synth};
///
/// let options = synth::SynthOptions { gaussians: 1000, frames: 3, ..Default::default() };
/// let scene = synth::make(&options, &Limits::default())?;
/// assert_eq!((scene.epochs().len(), scene.frames(), scene.max_count()), (1, 3, 1000));
/// let last = scene.instant(2).ok_or("three frames")?;
/// assert_eq!(last.gaussians.len(), 1000);
/// # Ok::<(), Box<dyn std::error::Error>>(())
/// ```
#[derive(Clone, Debug)]
pub struct Scene {
    epochs: Vec<Epoch>,
    frames_per_second: f64,
    /// Which way is up. Files do not say: y unless the caller knows better. All cameras that are placed
    /// around the scene, by the encoder too, stand upright by it.
    pub up: Up,
    /// Which way is up in most files of the format that the scene was read from, where there is a custom.
    pub default_up: Option<Up>,
    /// How its Gaussians are drawn: as they were when the scene was fitted.
    pub footprint: Footprint,
    /// Where the scene was seen from, if the source says.
    pub cameras: Vec<Camera>,
    /// Things the importer wants a person to know (identity not stored, frame converted, …).
    pub notes: Vec<String>,
}

impl Scene {
    /// A scene of `epochs` in display order.
    ///
    /// # Errors
    /// No epoch, or a frame rate that is not positive and finite.
    pub fn new(epochs: Vec<Epoch>, frames_per_second: f64) -> Result<Self, SceneError> {
        if epochs.is_empty() {
            return Err(SceneError::Empty("the list of epochs"));
        }
        if !(frames_per_second.is_finite() && frames_per_second > 0.0) {
            return Err(SceneError::FrameRate(frames_per_second));
        }
        let (up, default_up) = (Up::default(), None);
        let (footprint, cameras, notes) = (Footprint::default(), Vec::new(), Vec::new());
        Ok(Self { epochs, frames_per_second, up, default_up, footprint, cameras, notes })
    }

    /// The epochs in display order; at least one.
    pub fn epochs(&self) -> &[Epoch] {
        &self.epochs
    }

    /// Frames per second.
    pub fn frames_per_second(&self) -> f64 {
        self.frames_per_second
    }

    /// The frame rate as a fraction: frames, seconds. Rates that are none to a millionth are rounded to it.
    pub(crate) fn frame_rate(&self) -> (u32, u32) {
        let fps = self.frames_per_second();
        for seconds in [1u32, 1001, 1000] {
            let frames = fps * f64::from(seconds);
            if frames.fract().abs() < 1e-9 && frames <= 1e9 {
                return ((frames as u32).max(1), seconds);
            }
        }
        (((fps * 1000.0).round().clamp(1.0, 1e9)) as u32, 1000)
    }

    /// Frames over all epochs.
    pub fn frames(&self) -> usize {
        self.epochs.iter().map(Epoch::frames).sum()
    }

    /// The epoch index and the frame inside it of scene frame `frame`, if there is one.
    pub fn locate(&self, frame: usize) -> Option<(usize, usize)> {
        let mut start = 0;
        for (index, epoch) in self.epochs.iter().enumerate() {
            if frame < start + epoch.frames() {
                return Some((index, frame - start));
            }
            start += epoch.frames();
        }
        None
    }

    /// The splats of scene frame `frame`, if there is one.
    pub fn instant(&self, frame: usize) -> Option<Instant> {
        self.locate(frame).map(|(epoch, t)| self.epochs[epoch].instant(t))
    }

    /// Largest Gaussian count of any epoch.
    pub fn max_count(&self) -> usize {
        self.epochs.iter().map(Epoch::count).max().unwrap_or(0)
    }
}

/// `q` at unit length; a quaternion too short to have a direction becomes the identity.
pub fn normalised(q: [f32; 4]) -> [f32; 4] {
    let largest = q.iter().fold(0.0f32, |m, v| m.max(v.abs()));
    if largest.partial_cmp(&1e-20) != Some(std::cmp::Ordering::Greater) {
        return [1.0, 0.0, 0.0, 0.0];
    }
    let scaled = q.map(|v| v / largest);
    let length = scaled.iter().map(|v| v * v).sum::<f32>().sqrt();
    scaled.map(|v| v / length)
}

fn track_len<T>(track: &Track<T>) -> usize {
    match track {
        Track::Constant(values) | Track::PerFrame(values) => values.len(),
    }
}

fn values_mut<T>(track: &mut Track<T>) -> &mut [T] {
    match track {
        Track::Constant(values) | Track::PerFrame(values) => values,
    }
}

fn finite<'a>(
    attribute: &'static str,
    count: usize,
    values: impl Iterator<Item = &'a [f32]>,
) -> Result<(), SceneError> {
    for (index, value) in values.enumerate() {
        if let Some(&found) = value.iter().find(|v| !v.is_finite()) {
            let (gaussian, frame) = (index % count, index / count);
            return Err(SceneError::NotFinite { attribute, gaussian, frame, found });
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn attributes(n: usize, frames: usize) -> Attributes {
        Attributes {
            positions: Track::PerFrame((0..n * frames).map(|i| [i as f32, 0.0, 1.0]).collect()),
            rotations: Track::Constant(vec![[2.0, 0.0, 0.0, 0.0]; n]),
            log_scales: Track::PerFrame(vec![[-3.0; 3]; n * frames]),
            opacity_logits: Track::Constant(vec![f32::INFINITY; n]),
            sh0: Track::Constant(vec![[0.1, 0.2, 0.3]; n]),
            sh_rest: Vec::new(),
            sh_degree: ShDegree::ZERO,
        }
    }

    #[test]
    fn entry_normalises_clamps_and_collapses() {
        let epoch = Epoch::new(2, attributes(3, 2)).unwrap();
        assert_eq!(epoch.count(), 3);
        assert!(epoch.attributes().log_scales.is_constant());
        assert!(!epoch.attributes().positions.is_constant());
        let instant = epoch.instant(1);
        assert_eq!(epoch.instant(usize::MAX), instant, "past the end the last frame stays");
        assert_eq!(instant.gaussians[0].rotation, [1.0, 0.0, 0.0, 0.0]);
        assert!(instant.gaussians[0].opacity > 0.9999 && instant.gaussians[0].opacity <= 1.0);
    }

    #[test]
    fn errors_name_the_attribute_and_the_place() {
        let mut a = attributes(3, 2);
        a.sh0 = Track::Constant(vec![[0.0; 3]; 2]);
        let error = Epoch::new(2, a).unwrap_err().to_string();
        assert!(error.contains("sh0") && error.contains("found 2") && error.contains("need 3"), "{error}");
        let mut a = attributes(3, 2);
        a.positions = Track::PerFrame(vec![[f32::NAN, 0.0, 0.0]; 6]);
        let error = Epoch::new(2, a).unwrap_err().to_string();
        assert!(error.contains("position of Gaussian 0 at frame 0"), "{error}");
    }

    #[test]
    fn a_zero_quaternion_becomes_the_identity() {
        assert_eq!(normalised([0.0; 4]), [1.0, 0.0, 0.0, 0.0]);
        assert_eq!(
            normalised([3e38, 0.0, 0.0, 3e38]).map(|v| (v * 1e6).round()),
            [707_107.0, 0.0, 0.0, 707_107.0]
        );
    }
}
