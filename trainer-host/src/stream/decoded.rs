//! Turns decoded frames into scenes: what has arrived, in the domains that files hold.

use crate::scene::{Attributes, Epoch, Instant, Scene, SceneError, Track};

/// The Gaussians of a decoded frame of which anything is drawn, and how many are left out: those that have
/// not arrived, and those whose opacity is 0.
///
/// # Errors
/// Values that no scene may hold.
pub fn snapshot(instant: &Instant) -> Result<(Epoch, usize), SceneError> {
    let rest = instant.sh_degree.rest_len();
    let mut attributes = Attributes {
        positions: Track::Constant(Vec::new()),
        rotations: Track::Constant(Vec::new()),
        log_scales: Track::Constant(Vec::new()),
        opacity_logits: Track::Constant(Vec::new()),
        sh0: Track::Constant(Vec::new()),
        sh_rest: Vec::new(),
        sh_degree: instant.sh_degree,
    };
    let mut missing = 0;
    for (i, gaussian) in instant.gaussians.iter().enumerate() {
        if gaussian.is_absent() {
            missing += 1;
            continue;
        }
        push(&mut attributes.positions, gaussian.position);
        push(&mut attributes.rotations, gaussian.rotation);
        push(&mut attributes.log_scales, gaussian.scale.map(f32::ln));
        push(&mut attributes.opacity_logits, logit(gaussian.opacity));
        push(&mut attributes.sh0, gaussian.sh0);
        attributes.sh_rest.extend_from_slice(&instant.sh_rest[i * rest..(i + 1) * rest]);
    }
    Ok((Epoch::new(1, attributes)?, missing))
}

/// The logit of an opacity, 0 to 1, as far as it is finite.
pub fn logit(opacity: f32) -> f32 {
    (opacity / (1.0 - opacity).max(1e-9)).max(1e-9).ln()
}

/// Frames, each an epoch of one frame, as a scene: one epoch if all have as many Gaussians of the same
/// higher bands, else as they are. Inside of an epoch of a stream rows are the same Gaussians unless some are
/// missing.
///
/// # Errors
/// No frames, or a frame rate that is not positive and finite.
pub fn joined(frames: Vec<Epoch>, frames_per_second: f64) -> Result<Scene, SceneError> {
    let same = |pair: &[Epoch]| {
        let [a, b] = pair else { return true };
        a.count() == b.count() && a.attributes().sh_rest == b.attributes().sh_rest
    };
    if frames.len() < 2 || !frames.windows(2).all(same) {
        return Scene::new(frames, frames_per_second);
    }
    let attributes = Attributes {
        positions: track(&frames, |a| &a.positions),
        rotations: track(&frames, |a| &a.rotations),
        log_scales: track(&frames, |a| &a.log_scales),
        opacity_logits: track(&frames, |a| &a.opacity_logits),
        sh0: track(&frames, |a| &a.sh0),
        sh_rest: frames[0].attributes().sh_rest.clone(),
        sh_degree: frames[0].attributes().sh_degree,
    };
    Scene::new(vec![Epoch::new(frames.len(), attributes)?], frames_per_second)
}

/// One attribute of all `frames`.
fn track<T: Copy + PartialEq>(frames: &[Epoch], of: impl Fn(&Attributes) -> &Track<T>) -> Track<T> {
    let frame = |epoch: &Epoch| of(epoch.attributes()).frame(0, epoch.count()).to_vec();
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
        let (epoch, missing) = snapshot(&instant).unwrap();
        assert_eq!((epoch.count(), missing), (2, 1));
        let attributes = epoch.attributes();
        assert_eq!(attributes.positions.frame(0, 2), [[1.0; 3], [2.0; 3]]);
        assert_eq!(attributes.sh_rest[9], 18.0);
        assert_eq!(attributes.opacity_logits.frame(0, 2), [0.0; 2]);
    }

    #[test]
    fn frames_of_as_many_gaussians_are_one_epoch() {
        let frame = |places: &[f32]| {
            let gaussians = places.iter().map(|&x| shown(x)).collect();
            snapshot(&Instant { gaussians, ..Instant::default() }).unwrap().0
        };
        let scene = joined(vec![frame(&[1.0, 2.0]), frame(&[1.5, 2.0])], 24.0).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames()), (1, 2));
        assert_eq!(scene.instant(1).unwrap().gaussians[0].position, [1.5; 3]);
        let scene = joined(vec![frame(&[1.0, 2.0]), frame(&[1.5])], 24.0).unwrap();
        assert_eq!((scene.epochs().len(), scene.frames()), (2, 2));
    }
}
