//! Edits scenes: keeps some Gaussians, frames or bands, moves all, puts scenes together.
//!
//! Every edit takes a scene and gives another, whose arrays have passed [`Epoch::new`] again. Inside an
//! epoch a Gaussian is kept for all frames or for none, so identity stays what it was.

mod decimate;
mod select;
mod transform;

pub use self::{
    decimate::decimate,
    select::{Bounds, Condition, crop, filter},
    transform::{Similarity, transform, turn_between},
};

use codec_core::{Footprint, ShDegree};

use crate::scene::{Attributes, Epoch, Scene, SceneError, Track};

/// A scene that cannot be edited so.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
pub enum EditError {
    /// Nothing would be left.
    #[error("{0}: no Gaussian is left; at least one is needed")]
    Nothing(&'static str),
    /// Frames that are not there.
    #[error("frames {first} to {last} are asked for; 0 to {allowed} are there")]
    Frames {
        /// The first asked for.
        first: usize,
        /// The last asked for.
        last: usize,
        /// The last that is there.
        allowed: usize,
    },
    /// Scenes whose clips do not fit together.
    #[error("merge: scenes of {a} and {b} frames; as many, or one, are needed")]
    Lengths {
        /// Frames of the first.
        a: usize,
        /// Frames of the other.
        b: usize,
    },
    /// Scenes whose clips have different frame rates.
    #[error("merge: scenes of {a} and {b} frames per second; the same rate is needed")]
    Rates {
        /// Frames per second of the first.
        a: f64,
        /// Of the other.
        b: f64,
    },
    /// Scenes whose Gaussians are drawn differently.
    #[error("merge: Gaussians are drawn with footprints {} and {}; the same is needed", .a.name(), .b.name())]
    Footprints {
        /// Of the first.
        a: Footprint,
        /// Of the other.
        b: Footprint,
    },
    /// A number out of range.
    #[error("{field} is {found}; {allowed} is allowed")]
    Range {
        /// Which number.
        field: &'static str,
        /// Its value.
        found: f64,
        /// What is allowed.
        allowed: &'static str,
    },
    /// What comes of it is no scene.
    #[error(transparent)]
    Scene(#[from] SceneError),
}

/// `scene` with each epoch replaced by what `edit` makes of it.
fn edited(
    scene: &Scene,
    mut edit: impl FnMut(&Epoch) -> Result<Epoch, SceneError>,
) -> Result<Scene, EditError> {
    let epochs = scene.epochs().iter().map(&mut edit).collect::<Result<_, _>>()?;
    Ok(with_epochs(scene, epochs)?)
}

/// `scene` with other epochs.
fn with_epochs(scene: &Scene, epochs: Vec<Epoch>) -> Result<Scene, SceneError> {
    let made = Scene::new(epochs, scene.frames_per_second())?;
    let (cameras, notes) = (scene.cameras.clone(), scene.notes.clone());
    let Scene { up, default_up, footprint, .. } = *scene;
    Ok(Scene { up, default_up, footprint, cameras, notes, ..made })
}

/// The frames from `first` to `last`, both included.
///
/// # Errors
/// Frames that are not there.
pub fn frames(scene: &Scene, first: usize, last: usize) -> Result<Scene, EditError> {
    let count = scene.frames();
    if first > last || last >= count {
        return Err(EditError::Frames { first, last, allowed: count - 1 });
    }
    let mut epochs = Vec::new();
    let mut start = 0;
    for epoch in scene.epochs() {
        let end = start + epoch.frames();
        let (from, to) = (first.max(start), (last + 1).min(end));
        if from < to {
            epochs.push(cut(epoch, from - start, to - start)?);
        }
        start = end;
    }
    Ok(with_epochs(scene, epochs)?)
}

/// Frames `from..to` of an epoch.
fn cut(epoch: &Epoch, from: usize, to: usize) -> Result<Epoch, SceneError> {
    fn part<T: Copy>(track: &Track<T>, n: usize, from: usize, to: usize) -> Track<T> {
        match track {
            Track::Constant(values) => Track::Constant(values.clone()),
            Track::PerFrame(values) => Track::PerFrame(values[from * n..to * n].to_vec()),
        }
    }
    let (n, a) = (epoch.count(), epoch.attributes());
    Epoch::new(
        to - from,
        Attributes {
            positions: part(&a.positions, n, from, to),
            rotations: part(&a.rotations, n, from, to),
            log_scales: part(&a.log_scales, n, from, to),
            opacity_logits: part(&a.opacity_logits, n, from, to),
            sh0: part(&a.sh0, n, from, to),
            sh_rest: a.sh_rest.clone(),
            sh_degree: a.sh_degree,
        },
    )
}

/// Harmonics up to `degree`: higher bands are left out, missing ones stay missing.
///
/// # Errors
/// None for a scene that passed [`Scene::new`].
pub fn sh_degree(scene: &Scene, degree: ShDegree) -> Result<Scene, EditError> {
    edited(scene, |epoch| {
        let had = epoch.attributes().sh_degree;
        let least = if degree.get() < had.get() { degree } else { had };
        Epoch::new(epoch.frames(), with_degree(epoch, least))
    })
}

/// The attributes of `epoch` with harmonics of exactly `degree`; bands that it lacks are 0.
fn with_degree(epoch: &Epoch, degree: ShDegree) -> Attributes {
    let a = epoch.attributes();
    let (had, has) = (a.sh_degree.rest_len(), degree.rest_len());
    let mut sh_rest = vec![0.0; epoch.count() * has];
    let both = had.min(has);
    for i in 0..if both > 0 { epoch.count() } else { 0 } {
        sh_rest[i * has..i * has + both].copy_from_slice(&a.sh_rest[i * had..i * had + both]);
    }
    Attributes { sh_rest, sh_degree: degree, ..a.clone() }
}

/// The Gaussians of both scenes; one of a single frame stays where it is while the other moves.
///
/// Cameras are those of `scene`, or of `other` where that has none; `other` must have been turned to what is
/// up in `scene`.
///
/// # Errors
/// Clips of other lengths or frame rates, or other footprints.
pub fn merged(scene: &Scene, other: &Scene) -> Result<Scene, EditError> {
    let (a, b) = (scene.frames(), other.frames());
    if a != b && a != 1 && b != 1 {
        return Err(EditError::Lengths { a, b });
    }
    let rates = (scene.frames_per_second(), other.frames_per_second());
    if a > 1 && b > 1 && rates.0 != rates.1 {
        return Err(EditError::Rates { a: rates.0, b: rates.1 });
    }
    if scene.footprint != other.footprint {
        return Err(EditError::Footprints { a: scene.footprint, b: other.footprint });
    }
    let count = a.max(b);
    // Identity is fixed where it is in both.
    let mut starts: Vec<usize> = [scene, other].into_iter().flat_map(epoch_starts).collect();
    starts.push(count);
    starts.sort_unstable();
    starts.dedup();
    let mut epochs = Vec::new();
    for span in starts.windows(2).map(|pair| pair[0]..pair[1]) {
        let part = |scene: &Scene| -> Result<Epoch, SceneError> {
            let first = if scene.frames() == 1 { 0 } else { span.start };
            let (epoch, t) = scene.locate(first).ok_or(SceneError::Empty("a merged span"))?;
            let epoch = &scene.epochs()[epoch];
            let part = cut(epoch, t, t + if scene.frames() == 1 { 1 } else { span.len() })?;
            Epoch::new(span.len(), part.attributes().clone())
        };
        epochs.push(joined(&part(scene)?, &part(other)?)?);
    }
    let mut out = with_epochs(if a >= b { scene } else { other }, epochs)?;
    out.up = scene.up;
    out.default_up = scene.default_up;
    let cameras = if scene.cameras.is_empty() { &other.cameras } else { &scene.cameras };
    out.cameras.clone_from(cameras);
    out.notes = [&scene.notes[..], &other.notes].concat();
    Ok(out)
}

/// The first frames of a scene's epochs.
fn epoch_starts(scene: &Scene) -> Vec<usize> {
    let mut start = 0;
    let each = scene.epochs().iter().map(|epoch| {
        start += epoch.frames();
        start - epoch.frames()
    });
    each.collect()
}

/// One epoch of the Gaussians of two that are as long.
fn joined(a: &Epoch, b: &Epoch) -> Result<Epoch, SceneError> {
    fn both<T: Copy + PartialEq>(a: (&Track<T>, usize), b: (&Track<T>, usize), frames: usize) -> Track<T> {
        if let (Track::Constant(a), Track::Constant(b)) = (a.0, b.0) {
            return Track::Constant([&a[..], b].concat());
        }
        let frame = |t: usize| [a.0.frame(t, a.1), b.0.frame(t, b.1)].concat();
        Track::PerFrame((0..frames).flat_map(frame).collect())
    }
    let degree = if a.attributes().sh_degree.get() > b.attributes().sh_degree.get() { a } else { b };
    let degree = degree.attributes().sh_degree;
    let (n, m, frames) = (a.count(), b.count(), a.frames());
    let (a, b) = (with_degree(a, degree), with_degree(b, degree));
    Epoch::new(
        frames,
        Attributes {
            positions: both((&a.positions, n), (&b.positions, m), frames),
            rotations: both((&a.rotations, n), (&b.rotations, m), frames),
            log_scales: both((&a.log_scales, n), (&b.log_scales, m), frames),
            opacity_logits: both((&a.opacity_logits, n), (&b.opacity_logits, m), frames),
            sh0: both((&a.sh0, n), (&b.sh0, m), frames),
            sh_rest: [a.sh_rest, b.sh_rest].concat(),
            sh_degree: degree,
        },
    )
}

#[cfg(test)]
mod tests;
