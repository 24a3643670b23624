//! Holds one instant of one file: the columns a reader fills and the epoch they become.
//!
//! Readers convert into the scene's domains here and nowhere else: log scales, opacity logits,
//! wxyz, band-0 coefficients. [`Columns::finish`] is the only way out, so what every reader returns
//! has passed [`Epoch::new`]. Nothing here knows a file format.

use codec_core::{Footprint, ShDegree};

use super::{
    Limits,
    error::{ErrorKind, Format, ImportError},
    limits::GAUSSIAN_COUNT,
};
pub(crate) use crate::scene::activation::{SH_C0, logit};
use crate::scene::{Attributes, Epoch, SceneError, Track};

/// What one file held: an epoch of a single frame, and what a person should know about it.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// The Gaussians, as one frame.
    pub epoch: Epoch,
    /// How Gaussians are drawn, if the file says.
    pub footprint: Option<Footprint>,
    /// Things worth telling a person.
    pub notes: Vec<String>,
}

impl Snapshot {
    /// That of a file which was refused since it says that it has no Gaussians.
    ///
    /// # Errors
    /// `error`, if that is another.
    pub(super) fn of_nothing(error: ImportError) -> Result<Self, ImportError> {
        if error.kind != ErrorKind::Empty || &*error.field != GAUSSIAN_COUNT {
            return Err(error);
        }
        Ok(Self { epoch: Epoch::empty(), footprint: None, notes: Vec::new() })
    }
}

/// Band-0 coefficient of a display colour in 0..=1.
pub(crate) fn sh0_of_colour(colour: f32) -> f32 {
    (colour - 0.5) / SH_C0
}

/// Linear light as a screen takes it, 0 to 1 for what it shows.
pub(super) fn screen(linear: f32) -> f32 {
    if linear <= 0.003_130_8 { 12.92 * linear } else { 1.055 * linear.powf(1.0 / 2.4) - 0.055 }
}

/// A unit quaternion from its three smaller components, `largest` naming the missing one by its
/// place in the result. The other three keep their order.
pub(super) fn smallest_three(three: [f32; 3], largest: usize) -> [f32; 4] {
    let rest = 1.0 - three.iter().map(|v| v * v).sum::<f32>();
    let mut out = [0.0; 4];
    let mut three = three.into_iter();
    for (i, v) in out.iter_mut().enumerate() {
        *v = if i == largest { rest.max(0.0).sqrt() } else { three.next().unwrap_or(0.0) };
    }
    out
}

/// Columns being filled, one entry per Gaussian in each.
pub(super) struct Columns {
    pub positions: Vec<[f32; 3]>,
    pub rotations: Vec<[f32; 4]>,
    pub log_scales: Vec<[f32; 3]>,
    pub opacity_logits: Vec<f32>,
    pub sh0: Vec<[f32; 3]>,
    pub sh_rest: Vec<f32>,
    pub sh_degree: ShDegree,
}

impl Columns {
    /// Room for `n` Gaussians; the caller has checked `n` against its limits and its bytes.
    pub fn with_capacity(n: usize, sh_degree: ShDegree) -> Self {
        Self {
            positions: Vec::with_capacity(n),
            rotations: Vec::with_capacity(n),
            log_scales: Vec::with_capacity(n),
            opacity_logits: Vec::with_capacity(n),
            sh0: Vec::with_capacity(n),
            sh_rest: Vec::with_capacity(n * sh_degree.rest_len()),
            sh_degree,
        }
    }

    /// The finished snapshot. Where `keep_readable` is set, Gaussians with a value that is not a
    /// number are left out and counted in a note; otherwise one of them is an error.
    pub fn finish(
        self,
        format: Format,
        limits: &Limits,
        mut notes: Vec<String>,
    ) -> Result<Snapshot, ImportError> {
        let count = self.positions.len();
        let attributes = Attributes {
            positions: Track::Constant(self.positions),
            rotations: Track::Constant(self.rotations),
            log_scales: Track::Constant(self.log_scales),
            opacity_logits: Track::Constant(self.opacity_logits),
            sh0: Track::Constant(self.sh0),
            sh_rest: self.sh_rest,
            sh_degree: self.sh_degree,
        };
        let epoch = finished(1, count, attributes, format, limits, &mut notes)?;
        Ok(Snapshot { epoch, footprint: None, notes })
    }
}

/// The epoch of `count` Gaussians over `frames` frames, whose arrays have these lengths. Where
/// `keep_readable` is set, Gaussians with a value that is not a number at any frame are left out and counted
/// in a note; otherwise one of them is an error.
pub(super) fn finished(
    frames: usize,
    count: usize,
    mut attributes: Attributes,
    format: Format,
    limits: &Limits,
    notes: &mut Vec<String>,
) -> Result<Epoch, ImportError> {
    let mut left = count;
    if limits.keep_readable && count > 0 {
        left -= drop_unreadable(&mut attributes, count);
        notes.extend(left_out(count - left));
    }
    if left == 0 {
        return Err(format.empty("Gaussians"));
    }
    Epoch::new(frames, attributes).map_err(|error| scene_error(format, &error))
}

/// What is said where Gaussians were left out.
pub(super) fn left_out(dropped: usize) -> Option<String> {
    (dropped > 0).then(|| format!("{dropped} Gaussians left out: a value of theirs is not finite"))
}

/// Leaves out those of `count` Gaussians of which a value is not finite, and says how many these are.
/// Infinite scales and opacity logits are readable: an epoch brings them into range.
fn drop_unreadable(a: &mut Attributes, count: usize) -> usize {
    fn mark<T>(track: &Track<T>, readable: &mut [bool], is_readable: impl Fn(&T) -> bool) {
        let (Track::Constant(values) | Track::PerFrame(values)) = track;
        for (i, value) in values.iter().enumerate() {
            readable[i % readable.len()] &= is_readable(value);
        }
    }
    fn keep_in<T>(track: &mut Track<T>, readable: &[bool]) {
        let (Track::Constant(values) | Track::PerFrame(values)) = track;
        keep(values, readable, 1);
    }
    let rest = a.sh_degree.rest_len();
    let mut readable: Vec<bool> =
        (0..count).map(|i| a.sh_rest[i * rest..(i + 1) * rest].iter().all(|v| v.is_finite())).collect();
    mark(&a.positions, &mut readable, |v| v.iter().all(|v| v.is_finite()));
    mark(&a.rotations, &mut readable, |v| v.iter().all(|v| v.is_finite()));
    mark(&a.log_scales, &mut readable, |v| v.iter().all(|v| !v.is_nan()));
    mark(&a.opacity_logits, &mut readable, |v| !v.is_nan());
    mark(&a.sh0, &mut readable, |v| v.iter().all(|v| v.is_finite()));
    let dropped = readable.iter().filter(|r| !**r).count();
    if dropped > 0 {
        keep_in(&mut a.positions, &readable);
        keep_in(&mut a.rotations, &readable);
        keep_in(&mut a.log_scales, &readable);
        keep_in(&mut a.opacity_logits, &readable);
        keep_in(&mut a.sh0, &readable);
        keep(&mut a.sh_rest, &readable, rest);
    }
    dropped
}

/// Keeps the values of readable Gaussians, `each` in a row, in every frame of `values`.
pub(super) fn keep<T>(values: &mut Vec<T>, readable: &[bool], each: usize) {
    let mut index = 0;
    values.retain(|_| {
        index += 1;
        readable[(index - 1) / each % readable.len()]
    });
}

/// A scene error in the words of a reader.
pub(super) fn scene_error(format: Format, error: &SceneError) -> ImportError {
    match error {
        SceneError::NotFinite { attribute, gaussian, frame, found } => format.malformed(
            format!("{attribute} of Gaussian {gaussian}, frame {frame}"),
            found,
            "a finite value",
        ),
        SceneError::FrameRate(rate) => {
            format.malformed("frame rate", rate, "a positive finite number of frames per second")
        }
        SceneError::Empty(what) => format.empty(*what),
        other => format.malformed("attributes", other, "columns of one length"),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn columns(n: usize) -> Columns {
        let mut c = Columns::with_capacity(n, ShDegree::new(1).unwrap());
        for i in 0..n {
            c.positions.push([i as f32, 0.0, 0.0]);
            c.rotations.push([1.0, 0.0, 0.0, 0.0]);
            c.log_scales.push([-3.0; 3]);
            c.opacity_logits.push(0.0);
            c.sh0.push([0.0; 3]);
            c.sh_rest.extend([i as f32; 9]);
        }
        c
    }

    #[test]
    fn a_value_that_is_not_a_number_is_an_error_or_leaves_its_gaussian_out() {
        let mut c = columns(4);
        c.sh_rest[9 + 3] = f32::NAN;
        let error = c.finish(Format::Ply, &Limits::default(), vec![]).unwrap_err();
        assert!(error.to_string().contains("sh_rest of Gaussian 1"), "{error}");

        let mut c = columns(4);
        c.sh_rest[9 + 3] = f32::NAN;
        let limits = Limits { keep_readable: true, ..Limits::default() };
        let snapshot = c.finish(Format::Ply, &limits, vec![]).unwrap();
        assert_eq!(snapshot.epoch.count(), 3);
        assert_eq!(snapshot.epoch.attributes().sh_rest[9], 2.0);
        assert_eq!(snapshot.notes.len(), 1);
    }

    #[test]
    fn smallest_three_restores_the_missing_component_in_place() {
        let q = [0.1f32, -0.2, 0.3];
        let w = (1.0f32 - 0.14).sqrt();
        assert_eq!(smallest_three(q, 0), [w, 0.1, -0.2, 0.3]);
        assert_eq!(smallest_three(q, 2), [0.1, -0.2, w, 0.3]);
    }
}
