//! Tests that fewer Gaussians look like all of them, and better than what is left when most are dropped.

use codec_core::{Gaussian, ShDegree};
use nalgebra::Matrix3;
use render_host::{Settings, Splats, metric};

use super::*;
use crate::{
    import::{
        Limits,
        synth::{self, SynthKind},
    },
    scene::{Attributes, Instant, Track},
    viewpoint::{Framing, Ring},
};

/// A walking figure of 3000 Gaussians over 6 frames, with harmonics of degree 1.
fn figure() -> Scene {
    let options =
        synth::SynthOptions { gaussians: 3000, frames: 6, kind: SynthKind::Figure, ..Default::default() };
    let plain = synth::make(&options, &Limits::default()).unwrap();
    let degree = ShDegree::new(1).unwrap();
    edited(&plain, |epoch| {
        let rest = epoch.count() * degree.rest_len();
        let sh_rest = (0..rest).map(|i| 0.1 * (i as f32 * 0.01).sin()).collect();
        Epoch::new(epoch.frames(), Attributes { sh_rest, sh_degree: degree, ..epoch.attributes().clone() })
    })
    .unwrap()
}

/// Least PSNR of held-out views of `seen` against those of `whole` at frame `t`.
fn worst(seen: &Instant, whole: &Scene, t: usize) -> f64 {
    let cameras = Framing::of(whole).ring(Ring::HeldOut, 3, (128, 128)).unwrap();
    let picture = |instant: &Instant, camera: &render_host::Camera| {
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
        render_host::render(&splats, camera, &Settings::default()).unwrap().image
    };
    let whole = whole.instant(t).unwrap();
    let of = |camera| metric::psnr(&picture(seen, camera), &picture(&whole, camera)).unwrap();
    cameras.iter().map(of).fold(f64::INFINITY, f64::min)
}

/// The `left` Gaussians of most opacity times area of the two longer axes; all others are dropped.
fn dropped(instant: &Instant, left: usize) -> Instant {
    let shows = |g: &Gaussian| {
        let least = g.scale.into_iter().fold(f32::MAX, f32::min);
        g.opacity * g.scale.iter().product::<f32>() / least
    };
    let mut order: Vec<usize> = (0..instant.gaussians.len()).collect();
    order.sort_by(|&a, &b| shows(&instant.gaussians[b]).total_cmp(&shows(&instant.gaussians[a])));
    order.truncate(left);
    let bands = instant.sh_degree.rest_len();
    Instant {
        gaussians: order.iter().map(|&i| instant.gaussians[i]).collect(),
        sh_rest: order.iter().flat_map(|&i| &instant.sh_rest[i * bands..][..bands]).copied().collect(),
        sh_degree: instant.sh_degree,
    }
}

fn thinner(scene: &Scene, share: f64) -> Result<Scene, EditError> {
    decimate(scene, share, &mut |_| {})
}

#[test]
fn progress_rises_from_round_to_round() {
    let scene = figure();
    let mut heard = Vec::new();
    let few = decimate(&scene, 0.1, &mut |done| heard.push(done)).unwrap();
    assert_eq!(few.max_count(), 300);
    assert!(heard.len() > 3 && heard[0] == 0.0, "{heard:?}");
    assert!(heard.is_sorted_by(|a, b| a < b) && heard[heard.len() - 1] < 1.0, "{heard:?}");
}

#[test]
fn merging_beats_dropping_at_every_frame() {
    let scene = figure();
    for share in [0.5, 0.25, 0.1] {
        let few = thinner(&scene, share).unwrap();
        assert_eq!((few.max_count(), few.frames()), ((3000.0 * share) as usize, 6));
        for t in [0, 3, 5] {
            let merged = worst(&few.instant(t).unwrap(), &scene, t);
            let left = worst(&dropped(&scene.instant(t).unwrap(), few.max_count()), &scene, t);
            assert!(merged > left + 2.0, "{share} at frame {t}: {merged} dB, {left} dB by dropping");
        }
    }
}

#[test]
fn what_moves_keeps_what_does_not_change() {
    let scene = figure();
    let few = thinner(&scene, 0.3).unwrap();
    let (a, b) = (scene.epochs()[0].attributes(), few.epochs()[0].attributes());
    assert_eq!(a.log_scales.is_constant(), b.log_scales.is_constant());
    assert_eq!(a.opacity_logits.is_constant(), b.opacity_logits.is_constant());
    assert!(!b.positions.is_constant() && b.sh_rest.len() == 900 * 9);
}

#[test]
fn the_same_comes_of_it_on_any_number_of_threads() {
    let scene = figure();
    let on = |threads: usize| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| thinner(&scene, 0.2).unwrap().instant(2).unwrap())
    };
    assert_eq!(on(1), on(5));
    assert_eq!(thinner(&scene, 1.0).unwrap().instant(2), scene.instant(2), "all of them");
    for share in [0.0, -1.0, 1.1, f64::NAN] {
        assert!(thinner(&scene, share).is_err(), "{share}");
    }
}

/// A scene of one frame, of round Gaussians of opacity one half.
fn balls(positions: Vec<[f32; 3]>) -> Scene {
    let n = positions.len();
    let attributes = Attributes {
        positions: Track::Constant(positions),
        rotations: Track::Constant(vec![[1.0, 0.0, 0.0, 0.0]; n]),
        log_scales: Track::Constant(vec![[-1.0; 3]; n]),
        opacity_logits: Track::Constant(vec![0.0; n]),
        sh0: Track::Constant(vec![[0.3, 0.2, 0.1]; n]),
        sh_rest: Vec::new(),
        sh_degree: ShDegree::ZERO,
    };
    Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap()
}

#[test]
fn two_become_one_of_the_same_moments_and_what_lies_apart_stays() {
    let scene = balls(vec![[0.0; 3], [0.2, 0.0, 0.0], [50.0, 0.0, 0.0]]);
    let few = thinner(&scene, 0.67).unwrap().instant(0).unwrap().gaussians;
    assert_eq!(few.len(), 2);
    assert_eq!(few[1], scene.instant(0).unwrap().gaussians[2]);
    let variance = (-2f64).exp();
    let wide = (variance + 0.01).sqrt() as f32;
    assert!((few[0].position[0] - 0.1).abs() < 1e-6 && (few[0].scale[0] - wide).abs() < 1e-5, "{few:?}");
    assert!((few[0].scale[1] - variance.sqrt() as f32).abs() < 1e-5);
    // Twice the opacity, over an area that is larger, and never more than opaque.
    assert!(few[0].opacity > 0.9 && few[0].opacity <= 1.0, "{}", few[0].opacity);
}

#[test]
fn what_lies_in_one_place_is_paired_in_few_rounds() {
    let scene = balls(vec![[1.0, 2.0, 3.0]; 5000]);
    let nodes = Nodes::new(&scene.epochs()[0], vec![0]);
    let groups: Vec<u32> = (0..5000).collect();
    let pairs = chosen(&nodes, &groups, 2000);
    assert!(pairs.len() > 1000, "{}", pairs.len());
    let mut seen: Vec<u32> = pairs.iter().flat_map(|&(i, j)| [i, j]).collect();
    seen.sort_unstable();
    seen.dedup();
    assert_eq!(seen.len(), 2 * pairs.len(), "no group is in two pairs");
    assert_eq!(thinner(&scene, 1e-9).unwrap().max_count(), 1);
}

#[test]
fn extremes_end_in_a_scene() {
    let far = [[f32::MAX; 3], [-f32::MAX; 3], [0.0; 3], [f32::MIN_POSITIVE; 3]];
    for share in [0.75, 0.5, 0.25] {
        assert_eq!(thinner(&balls(far.to_vec()), share).unwrap().max_count(), (4.0 * share) as usize);
    }
}

#[test]
fn areas_are_those_of_projections_and_axes_are_those_of_the_shape() {
    let sphere = shape::of_axes([0.5; 3], [1.0, 0.0, 0.0, 0.0]);
    assert!((shape::area(&sphere) - 1f64.exp()).abs() < 1e-9);
    // A disc shows half of its area on average.
    let q = crate::scene::normalised([0.3, -0.5, 0.7, 0.2]);
    let disc = shape::of_axes([0.0, 0.0, -12.0], q);
    assert!((shape::area(&disc) - 0.5).abs() < 0.05, "{}", shape::area(&disc));
    let (logs, rotation) = shape::axes(&shape::of_axes([-2.0, 1.0, 0.2], q));
    assert!(logs.iter().zip([1.0, 0.2, -2.0]).all(|(a, b)| (a - b).abs() < 1e-5), "{logs:?}");
    let (again, turn) =
        (shape::of_axes(logs, rotation), crate::encode::factorise::rotation_matrix(q.map(f64::from)));
    let wanted =
        turn * Matrix3::from_diagonal(&[(-4f64).exp(), 2f64.exp(), 0.4f64.exp()].into()) * turn.transpose();
    assert!((again[0] - wanted[(0, 0)]).abs() < 1e-5 && (again[4] - wanted[(1, 2)]).abs() < 1e-5);
}
