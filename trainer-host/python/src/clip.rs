//! Makes scenes of arrays: each attribute once for all frames, [N, …], or at every frame, [T, N, …].

use pyo3::prelude::*;
use trainer_host::{Attributes, Epoch, Scene, Track};

use crate::{
    activation::Activation,
    array::Numbers,
    error::refused,
    gaussians::{degree_of, higher_bands, needed, opacities},
};

/// The scene of the arrays of `source`.
pub fn scene(source: &Bound<'_, PyAny>, frames_per_second: f64, activation: Activation) -> PyResult<Scene> {
    let read = |name| Numbers::<f32>::read(name, &needed(source, name)?);
    let means = read("means")?;
    let n = match means.shape[..] {
        [n, 3] | [_, n, 3] => n,
        _ => return Err(means.misshapen("[N, 3] or [T, N, 3]")),
    };
    let (mut scales, quats, mut sh0) = (read("scales")?, read("quats")?, read("sh0")?);
    let mut opacities = opacities(source, activation)?;
    if activation == Activation::Linear {
        scales.check("scales of at least 0", |v| v >= 0.0)?;
        opacities.check("opacities of 0 to 1", |v| (0.0..=1.0).contains(&v))?;
    }
    scales.values.iter_mut().for_each(|scale| *scale = activation.to_log_scale(*scale));
    opacities.values.iter_mut().for_each(|opacity| *opacity = activation.to_logit(*opacity));
    without_single_band(&mut sh0, n);
    let bands = higher_bands(source, n)?;

    let mut frames = None;
    let means_per_frame = is_per_frame(&means, n, &[3], &mut frames)?;
    let scales_per_frame = is_per_frame(&scales, n, &[3], &mut frames)?;
    let quats_per_frame = is_per_frame(&quats, n, &[4], &mut frames)?;
    let opacities_per_frame = is_per_frame(&opacities, n, &[], &mut frames)?;
    let sh0_per_frame = is_per_frame(&sh0, n, &[3], &mut frames)?;
    let attributes = Attributes {
        positions: track(means_per_frame, means.rows::<3>()),
        rotations: track(quats_per_frame, quats.rows::<4>()),
        log_scales: track(scales_per_frame, scales.rows::<3>()),
        opacity_logits: track(opacities_per_frame, opacities.values),
        sh0: track(sh0_per_frame, sh0.rows::<3>()),
        sh_degree: degree_of(bands.shape[1]).unwrap_or_default(),
        sh_rest: bands.values,
    };
    let epoch = Epoch::new(frames.map_or(1, |(_, frames)| frames), attributes).map_err(refused)?;
    Scene::new(vec![epoch], frames_per_second).map_err(refused)
}

/// Takes the length of 1 out of the shape of band 0 as gsplat has it: [N, 1, 3] or [T, N, 1, 3].
fn without_single_band(sh0: &mut Numbers<f32>, n: usize) {
    match sh0.shape[..] {
        [rows, 1, 3] if rows == n => sh0.shape = vec![n, 3],
        [frames, rows, 1, 3] if rows == n => sh0.shape = vec![frames, n, 3],
        _ => (),
    }
}

/// Whether `numbers` are [T, n, tail…] rather than [n, tail…]. `frames` is T and the first array that has it.
fn is_per_frame(
    numbers: &Numbers<f32>,
    n: usize,
    tail: &[usize],
    frames: &mut Option<(&'static str, usize)>,
) -> PyResult<bool> {
    let still: Vec<usize> = [n].iter().chain(tail).copied().collect();
    if numbers.shape == still {
        return Ok(false);
    }
    let tail: String = still.iter().map(|length| format!(", {length}")).collect();
    let found = numbers.shape.split_first().filter(|(_, rest)| **rest == still).map(|(&frames, _)| frames);
    let Some(found) = found else {
        return Err(numbers.misshapen(format!("{still:?} or [T{tail}]")));
    };
    match *frames {
        Some((other, wanted)) if wanted != found => {
            Err(numbers.misshapen(format!("[{wanted}{tail}], with the frames of {other},")))
        }
        _ => {
            *frames = Some((numbers.field, found));
            Ok(true)
        }
    }
}

fn track<T>(is_per_frame: bool, values: Vec<T>) -> Track<T> {
    if is_per_frame { Track::PerFrame(values) } else { Track::Constant(values) }
}
