//! Turns decoded frames into scenes: what has arrived, in the domains that files hold.

use codec_core::internals::wire::manifest::Manifest;

use crate::scene::{Attributes, Epoch, Instant, Scene, SceneError, Track};

/// The Gaussians of a decoded frame of which anything is drawn: not those that have not arrived, nor those
/// whose opacity is 0.
#[derive(Clone, Debug, PartialEq)]
pub struct Snapshot {
    /// They, as an epoch of one frame.
    pub epoch: Epoch,
    /// The rows of the stream's frame that they are.
    pub rows: Vec<u32>,
}

impl Snapshot {
    /// That frames, so many, lack Gaussians, the one that lacks most `left_out` of its `of`, and why, for
    /// people: nothing of them has arrived, or, where all bases have (`has_all_bases`), they are transparent.
    /// `None` where none is left out.
    pub fn left_out_in_words(
        frames: usize,
        (left_out, of): (usize, usize),
        has_all_bases: bool,
    ) -> Option<String> {
        let which = if has_all_bases {
            "Gaussians that are fully transparent at this quality are"
        } else {
            "Gaussians of which nothing has arrived are"
        };
        let plural = if frames == 1 { "" } else { "s" };
        let doubt = "rows of different frames need not be the same Gaussians";
        (left_out > 0)
            .then(|| format!("{which} left out of {frames} frame{plural}, up to {left_out} of {of}: {doubt}"))
    }
}

/// What is drawn of a decoded frame.
///
/// # Errors
/// Values that no scene may hold.
pub fn snapshot(instant: &Instant) -> Result<Snapshot, SceneError> {
    let rest = instant.sh_degree.rest_len();
    let mut attributes = Attributes::of_none(instant.sh_degree);
    let mut rows = Vec::new();
    for (i, gaussian) in instant.gaussians.iter().enumerate() {
        if gaussian.is_absent() {
            continue;
        }
        rows.push(i as u32);
        push(&mut attributes.positions, gaussian.position);
        push(&mut attributes.rotations, gaussian.rotation);
        push(&mut attributes.log_scales, gaussian.scale.map(f32::ln));
        push(&mut attributes.opacity_logits, logit(gaussian.opacity));
        push(&mut attributes.sh0, gaussian.sh0);
        attributes.sh_rest.extend_from_slice(&instant.sh_rest[i * rest..(i + 1) * rest]);
    }
    Ok(Snapshot { epoch: Epoch::new(1, attributes)?, rows })
}

/// The logit of an opacity, 0 to 1, as far as it is finite.
pub fn logit(opacity: f32) -> f32 {
    (opacity / (1.0 - opacity).max(1e-9)).max(1e-9).ln()
}

/// For each epoch of the stream of `manifest`, its first frame.
pub fn epoch_starts(manifest: &Manifest<'_>) -> Vec<u32> {
    manifest.epochs().map(|epoch| epoch.first_frame).collect()
}

/// The first frames of a stream, whose epochs begin at the frames `starts`, as a scene. Frames of one epoch
/// that follow each other are one epoch of the scene where the same rows are drawn in all of them: only then
/// these are the same Gaussians.
///
/// # Errors
/// No frames, or a frame rate that is not positive and finite.
pub fn joined(frames: Vec<Snapshot>, starts: &[u32], frames_per_second: f64) -> Result<Scene, SceneError> {
    let mut runs: Vec<Vec<Snapshot>> = Vec::new();
    for (number, frame) in (0..).zip(frames) {
        let run = runs.last_mut().filter(|run| {
            starts.binary_search(&number).is_err()
                && run.last().is_some_and(|last| last.is_followed_by(&frame))
        });
        match run {
            Some(run) => run.push(frame),
            None => runs.push(vec![frame]),
        }
    }
    let epochs: Result<Vec<Epoch>, SceneError> = runs.into_iter().map(|run| one_epoch(&run)).collect();
    Scene::new(epochs?, frames_per_second)
}

impl Snapshot {
    /// Whether the rows of `next`, of the frame after it in the same epoch of the stream, are the same
    /// Gaussians.
    pub fn is_followed_by(&self, next: &Self) -> bool {
        self.rows == next.rows && self.epoch.attributes().sh_rest == next.epoch.attributes().sh_rest
    }
}

/// Frames with the same rows as one epoch.
fn one_epoch(frames: &[Snapshot]) -> Result<Epoch, SceneError> {
    if let [frame] = frames {
        return Ok(frame.epoch.clone());
    }
    let attributes = Attributes {
        positions: track(frames, |a| &a.positions),
        rotations: track(frames, |a| &a.rotations),
        log_scales: track(frames, |a| &a.log_scales),
        opacity_logits: track(frames, |a| &a.opacity_logits),
        sh0: track(frames, |a| &a.sh0),
        sh_rest: frames[0].epoch.attributes().sh_rest.clone(),
        sh_degree: frames[0].epoch.attributes().sh_degree,
    };
    Epoch::new(frames.len(), attributes)
}

/// One attribute of all `frames`.
fn track<T: Copy + PartialEq>(frames: &[Snapshot], of: impl Fn(&Attributes) -> &Track<T>) -> Track<T> {
    let frame = |shown: &Snapshot| of(shown.epoch.attributes()).frame(0, shown.epoch.count()).to_vec();
    Track::PerFrame(frames.iter().flat_map(frame).collect())
}

fn push<T>(track: &mut Track<T>, value: T) {
    match track {
        Track::Constant(values) | Track::PerFrame(values) => values.push(value),
    }
}

#[cfg(test)]
mod tests {
    use codec_core::{Gaussian, ShDegree};

    use super::*;

    fn shown(x: f32) -> Gaussian {
        Gaussian { position: [x; 3], opacity: 0.5, ..Gaussian::ABSENT }
    }

    #[test]
    fn what_has_not_arrived_is_left_out_with_its_harmonics() {
        let moved = Gaussian { position: [7.0; 3], ..Gaussian::ABSENT };
        let instant = Instant {
            gaussians: vec![shown(1.0), moved, shown(2.0)],
            sh_rest: (0..27).map(|i| i as f32).collect(),
            sh_degree: ShDegree::new(1).unwrap(),
        };
        let Snapshot { epoch, rows } = snapshot(&instant).unwrap();
        assert_eq!((epoch.count(), rows), (2, vec![0, 2]));
        let attributes = epoch.attributes();
        assert_eq!(attributes.positions.frame(0, 2), [[1.0; 3], [2.0; 3]]);
        assert_eq!(attributes.sh_rest[9], 18.0);
        assert_eq!(attributes.opacity_logits.frame(0, 2), [0.0; 2]);
    }

    #[test]
    fn frames_of_the_same_gaussians_are_one_epoch() {
        let frame = |places: [f32; 3]| {
            let gaussian = |x: f32| if x == 0.0 { Gaussian::ABSENT } else { shown(x) };
            let gaussians = places.map(gaussian).to_vec();
            snapshot(&Instant { gaussians, ..Instant::default() }).unwrap()
        };
        let frames = || vec![frame([1.0, 2.0, 0.0]), frame([1.5, 2.0, 0.0]), frame([1.5, 0.0, 3.0])];
        let lengths = |frames: Vec<Snapshot>, starts: &[u32]| {
            let scene = joined(frames, starts, 24.0).unwrap();
            scene.epochs().iter().map(Epoch::frames).collect::<Vec<_>>()
        };
        let scene = joined(frames()[..2].to_vec(), &[0], 24.0).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames()), (1, 2));
        assert_eq!(scene.instant(1).unwrap().gaussians[0].position, [1.5; 3]);
        // As many, but others.
        assert_eq!(lengths(frames(), &[0]), [2, 1]);
        // The same rows of another epoch are other Gaussians.
        assert_eq!(lengths(frames(), &[0, 1]), [1, 1, 1]);
        assert_eq!(lengths(vec![frame([1.0; 3]); 5], &[0, 3]), [3, 2]);
        assert_eq!(lengths(vec![frame([0.0; 3]); 2], &[0]), [2]);
    }
}
