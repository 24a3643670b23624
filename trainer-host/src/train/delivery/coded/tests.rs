//! Tests of what states of an encoding show, and of gradients and changes of its parameters.

use super::*;
use crate::{
    import::{
        Limits,
        synth::{self, SynthKind},
    },
    train::delivery::{parameters::tests::linear, view::tests::study},
};

fn options() -> encode::EncodeOptions {
    encode::EncodeOptions { packet_bytes: 400, block_len: 16, pictures: 0, ..Default::default() }
}

#[test]
fn blocks_partition_the_gaussians_and_the_complete_state_is_near_the_source() {
    let (scene, _) = study(3, 1);
    for options in [options(), encode::EncodeOptions::paper()] {
        let coded = Coded::first(&scene, &options).unwrap();
        let parameters = no_change(&scene);
        let moving = coded.moving(&scene, &parameters);
        let mut next = 0;
        for block in moving.blocks(1) {
            assert_eq!(block.gaussians.start, next);
            next = block.gaussians.end;
        }
        assert_eq!(next, coded.encoded.order[0].len());
        let complete = coded.received.content().blocks.to_vec();
        let shown = moving.shown(&mut coded.player(), &complete, 2).unwrap();
        let source = scene.instant(2).unwrap();
        let size = |g: &Gaussian| g.scale.iter().fold(0f32, |a, &s| a.max(s));
        for (g, &i) in shown.gaussians.iter().zip(&coded.encoded.order[0]) {
            let other = source.gaussians[i as usize];
            let far = (0..3).map(|d| (g.position[d] - other.position[d]).abs()).fold(0f32, f32::max);
            assert!(far < 0.5 * size(&other), "{far} {other:?}");
        }
    }
}

/// Of a linear function of what a state shows, by all quantisation errors together: what it changes where
/// every decoded Gaussian moves along its error.
#[test]
fn slopes_by_steps_are_differences_along_quantisation_errors() {
    let (scene, _) = study(3, 1);
    let coarse =
        encode::EncodeOptions { quality: encode::QuantiserSteps::default().scaled(6.0), ..options() };
    let coded = Coded::first(&scene, &coarse).unwrap();
    let mut parameters = no_change(&scene);
    for (i, values) in parameters.all_mut().enumerate() {
        *values = std::array::from_fn(|c| 0.1 * (((i * 31 + c * 17) % 19) as f32 / 9.0 - 1.0));
    }
    let coded = Coded::rewrite(&scene, &parameters, &coded.encoded.decisions).unwrap();
    let moving = coded.moving(&scene, &parameters);
    let (complete, frame) = (coded.received.content().blocks.to_vec(), 2);
    let shown = moving.shown(&mut coded.player(), &complete, frame).unwrap();
    let by = |i: usize| SplatGradient {
        position: [0.3, -0.7, 0.2].map(|v| v + 0.01 * (i % 7) as f32),
        log_scale: [0.5, -0.1, 0.9],
        opacity_logit: 0.35,
        sh0: [0.1, -0.2, 0.3 + 0.02 * (i % 5) as f32],
        ..Default::default()
    };
    let slopes: Vec<SplatGradient> = (0..shown.gaussians.len()).map(by).collect();
    let rows = steps::rows(&coded.encoded.decisions);
    let mut gradient = Gradient::zeros(parameters.count(), rows);
    moving.pull(&shown, &slopes, (&complete, frame), &mut gradient);

    let source = parameters.applied(&scene).unwrap().instant(frame as usize).unwrap();
    let mut along = 0.0;
    moving.each(&complete, frame, |(_, decoded), parameter, follows| {
        let (g, by) = (&shown.gaussians[decoded], &slopes[decoded]);
        let Follows::Source(anchor, axes) = follows else { panic!("{follows:?}") };
        let error = anchor.error(&source.gaussians[parameter], g, axes);
        let at = |h: f32| linear(&follows.moved(g, &error.map(|e| h * e)), by);
        along += (at(0.05) - at(-0.05)) / 0.1;
    });
    let found: f64 = gradient.steps.as_flattened().iter().sum();
    assert!(along.abs() > 0.01, "{along}");
    assert!((found / along - 1.0).abs() < 0.02, "{found} {along}");
    // Missing motion is no error of quantisation.
    let mut missing = complete;
    for mask in moving.blocks(frame).iter().filter_map(|block| moving.motion_mask(block, frame)) {
        missing[mask] = 0;
    }
    let shown = moving.shown(&mut coded.player(), &missing, frame).unwrap();
    let mut gradient = Gradient::zeros(parameters.count(), rows);
    moving.pull(&shown, &slopes, (&missing, frame), &mut gradient);
    assert_eq!(gradient.steps.as_flattened().iter().sum::<f64>(), 0.0);
}

/// A change that is encoded is the change that was only moved, within the quantisers' steps.
#[test]
fn drift_is_what_the_next_encoding_shows() {
    let (scene, _) = study(3, 1);
    let first = Coded::first(&scene, &options()).unwrap();
    let mut parameters = no_change(&scene);
    for (i, values) in parameters.all_mut().enumerate() {
        *values = std::array::from_fn(|c| 0.3 * (((i * 31 + c * 17) % 19) as f32 / 9.0 - 1.0));
    }
    let rewritten = Coded::rewrite(&scene, &parameters, &first.encoded.decisions).unwrap();
    assert_eq!(rewritten.encoded.order, first.encoded.order);
    let complete = first.received.content().blocks.to_vec();
    let show = |coded: &Coded, parameters: &Parameters| {
        coded.moving(&scene, parameters).shown(&mut coded.player(), &complete, 1).unwrap()
    };
    let (encoded, drifted) = (show(&rewritten, &parameters), show(&first, &parameters));
    let still = show(&first, &no_change(&scene));
    let distance = |a: &Shown, b: &Shown| -> f64 {
        let pairs = a.gaussians.iter().zip(&b.gaussians);
        pairs
            .map(|(a, b)| {
                let colour = (0..3).map(|d| f64::from((a.sh0[d] - b.sh0[d]).powi(2))).sum::<f64>();
                colour + f64::from((a.opacity - b.opacity).powi(2))
            })
            .sum()
    };
    let (near, far) = (distance(&encoded, &drifted), distance(&encoded, &still));
    assert!(near < 0.02 * far, "{near} {far}");
}

/// Where tracks are missing a change is moved by the pose that is shown instead, as the next encoding shows.
#[test]
fn drift_follows_the_pose_that_is_shown() {
    let options =
        synth::SynthOptions { gaussians: 1000, frames: 24, kind: SynthKind::Figure, ..Default::default() };
    let scene = synth::make(&options, &Limits::default()).unwrap();
    let coding = encode::EncodeOptions { window_frames: Some(8), ..self::options() };
    let first = Coded::first(&scene, &coding).unwrap();
    let mut parameters = no_change(&scene);
    for (i, values) in parameters.all_mut().enumerate() {
        *values =
            std::array::from_fn(|c| if c < 3 { ((i * 31 + c * 17) % 19) as f32 / 9.0 - 1.0 } else { 0.0 });
    }
    let rewritten = Coded::rewrite(&scene, &parameters, &first.encoded.decisions).unwrap();
    let frame = 20;
    let mut state = first.received.content().blocks.to_vec();
    let moving = first.moving(&scene, &parameters);
    // Nothing of the last window arrives, of the one before nothing of every other cluster.
    let window = |frame| moving.blocks(frame).iter().map(move |block| (block, frame));
    let lost = window(20).chain(window(12).filter(|(block, _)| block.cluster.0 % 2 == 0));
    for mask in lost.filter_map(|(block, frame)| moving.motion_mask(block, frame)) {
        state[mask] = 0;
    }
    let show = |coded: &Coded, parameters: &Parameters| {
        coded.moving(&scene, parameters).shown(&mut coded.player(), &state, frame).unwrap()
    };
    let (encoded, drifted) = (show(&rewritten, &parameters), show(&first, &parameters));
    let still = show(&first, &no_change(&scene));
    let distance = |a: &Shown, b: &Shown| -> f64 {
        let pairs = a.gaussians.iter().zip(&b.gaussians);
        let of = |(a, b): (&Gaussian, &Gaussian)| {
            (0..3).map(|d| f64::from(a.position[d] - b.position[d]).powi(2)).sum::<f64>()
        };
        pairs.map(of).sum()
    };
    let (near, far) = (distance(&encoded, &drifted), distance(&encoded, &still));
    assert!(near < 0.05 * far, "{near} {far}");
}
