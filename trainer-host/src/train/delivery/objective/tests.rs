use std::ops::Range;

use render_host::metric;

use super::*;
use crate::{
    encode,
    scene::Scene,
    train::delivery::{
        LossModel, LossUnit, Masks,
        coded::Coded,
        drawing::tests::gpu,
        masks::Sampler,
        parameters::{COLOUR, COMPONENTS, OPACITY, Parameters, SCALE, TURN},
        steps,
        view::{tests::study, views},
    },
};

/// Largest relative L2 distance between devices, for each kind of parameter and for steps: ten times that of
/// one picture's gradients, since a change from frame to frame is compared with what the device itself drew.
const DEVICE_TOLERANCE: f64 = 1e-3;

/// A scene, its encoding, a view with a change, worlds, and prefixes from the longest to the shortest so that
/// every step of them is a rise.
struct Study {
    scene: Scene,
    coded: Coded,
    view: View,
    states: Vec<Vec<u8>>,
    prefixes: [Vec<u8>; PREFIXES],
    /// Of Gaussians and proxies, unchanged.
    parameters: Parameters,
}

fn made() -> Study {
    let (scene, references) = study(3, 1);
    let options =
        encode::EncodeOptions { packet_bytes: 300, block_len: 16, pictures: 0, ..Default::default() };
    let coded = Coded::first(&scene, &options).unwrap();
    let stream = &coded.encoded.stream;
    let masks = Masks::draw(stream, LossModel::Iid { probability: 0.15 }, LossUnit::Packet, 7, 5).unwrap();
    let sampler = Sampler::new(stream, LossUnit::Packet).unwrap();
    let prefixes = [3, 2, 1, 0].map(|level| sampler.prefix(level));
    let view = views(&scene, &references, &Settings::exact()).unwrap().remove(1);
    let parameters = coded.parameters(&scene).unwrap();
    let coded = coded.with_parameters(parameters.clone());
    Study { scene, coded, view, states: masks.states, prefixes, parameters }
}

impl Study {
    fn terms(&self, parameters: &Parameters, weights: &Weights) -> (Terms, Vec<[f64; COMPONENTS]>) {
        let settings = Settings::exact();
        let (terms, gradient) = self.found(parameters, weights, &self.view, &mut Drawing::Cpu, &settings);
        (terms, gradient.parameters)
    }

    /// Terms and gradient in `view`.
    fn found(
        &self,
        parameters: &Parameters,
        weights: &Weights,
        view: &View,
        drawing: &mut Drawing,
        settings: &Settings,
    ) -> (Terms, Gradient) {
        let moving = self.coded.moving(&self.scene, parameters);
        let worlds = Worlds { states: &self.states, prefixes: &self.prefixes };
        let mut gradient = Gradient::zeros(parameters.count(), steps::rows(&self.coded.encoded.decisions));
        let terms = differentiate(&moving, &worlds, view, weights, drawing, settings, &mut gradient).unwrap();
        (terms, gradient)
    }

    /// The objective at `parameters` with the shorter prefix of each step as it was in `fixed`.
    fn stopped(&self, parameters: &Parameters, weights: &Weights, fixed: &Terms) -> f64 {
        let (terms, _) = self.terms(parameters, weights);
        let rising = (1..PREFIXES).filter(|&k| fixed.prefixes[k] > fixed.prefixes[k - 1]);
        let rises = rising.map(|k| terms.prefixes[k] - fixed.prefixes[k - 1]);
        Terms { monotone: rises.sum(), ..terms }.total(weights)
    }

    /// The slope of the objective along `direction`.
    fn slope(&self, direction: &[[f64; COMPONENTS]], weights: &Weights, fixed: &Terms) -> f64 {
        let at = |h: f64| {
            let mut moved = self.parameters.clone();
            for (values, direction) in moved.all_mut().zip(direction) {
                values.iter_mut().zip(direction).for_each(|(v, d)| *v += (h * d) as f32);
            }
            self.stopped(&moved, weights, fixed)
        };
        let h = 4e-3;
        (at(h) - at(-h)) / (2.0 * h)
    }
}

impl Study {
    /// Turns what `direction` says of centres to the right of the picture or to its left: where two Gaussians
    /// change their order of depth the picture jumps, and a jump has no gradient. What turns from this frame
    /// to the next would change its depth there, and stays.
    fn keep_depths(&self, gradient: &[[f64; COMPONENTS]], direction: &mut [[f64; COMPONENTS]]) {
        let epoch = &self.scene.epochs()[0];
        let rotations = |t: u32| epoch.attributes().rotations.frame(t as usize, epoch.count());
        let (this, next) = (rotations(self.view.frame), rotations(self.view.frame + 1));
        let right = glam::DVec3::from_array(self.view.camera.rotation()[0]);
        for (i, (direction, gradient)) in direction.iter_mut().zip(gradient).enumerate() {
            // Proxies come after the Gaussians, and move along the world's axes.
            let own = this.get(i).map_or(right, |q| {
                let [w, x, y, z] = q.map(f64::from);
                glam::DQuat::from_xyzw(x, y, z, w).conjugate() * right
            });
            let slope = own.dot(glam::DVec3::from_slice(&gradient[..3]));
            let moves = this.get(i) == next.get(i) && slope != 0.0;
            let along = if moves { own * slope.signum() } else { glam::DVec3::ZERO };
            direction[..3].copy_from_slice(&along.to_array());
        }
    }
}

fn dot(a: &[[f64; COMPONENTS]], b: &[[f64; COMPONENTS]]) -> f64 {
    a.iter().flatten().zip(b.iter().flatten()).map(|(a, b)| a * b).sum()
}

/// All terms together, along the sign of the gradient: every parameter of every Gaussian takes part. Without
/// any one of the terms the gradient is another one.
#[test]
fn the_gradient_of_a_step_is_its_central_difference_and_no_term_can_be_dropped() {
    let study = made();
    let weights = Weights { temporal: 30.0, monotone: 0.5, cvar_fraction: 0.2, ..Weights::default() };
    let (terms, gradient) = study.terms(&study.parameters, &weights);
    assert!(terms.tail > terms.expected && terms.temporal > 0.0 && terms.monotone > 0.0, "{terms:?}");
    // What is clamped has no slope, and is left where it is.
    let sign = |g: f64| if g == 0.0 { 0.0 } else { g.signum() };
    let mut direction: Vec<[f64; COMPONENTS]> = gradient.iter().map(|g| g.map(sign)).collect();
    study.keep_depths(&gradient, &mut direction);
    let expected = study.slope(&direction, &weights, &terms);
    let found = dot(&gradient, &direction);
    assert!((found / expected - 1.0).abs() < 0.02, "{found:e} {expected:e}");
    for (dropped, name) in [
        (Weights { cvar: 0.0, ..weights }, "tail"),
        (Weights { temporal: 0.0, ..weights }, "temporal"),
        (Weights { monotone: 0.0, ..weights }, "monotone"),
        (Weights { anchor: 0.0, ..weights }, "anchor"),
        (Weights { structure: 0.0, ..weights }, "structure"),
    ] {
        let (_, without) = study.terms(&study.parameters, &dropped);
        let found = dot(&without, &direction);
        assert!((found / expected - 1.0).abs() > 0.03, "without {name}: {found:e} {expected:e}");
    }
}

#[test]
fn terms_are_what_their_definitions_say() {
    let study = made();
    let weights = Weights { cvar_fraction: 0.3, ..Weights::default() };
    let (terms, _) = study.terms(&study.parameters, &weights);
    let moving = study.coded.moving(&study.scene, &study.parameters);
    let settings = Settings { parallel: false, ..Settings::exact() };
    let mut player = study.coded.player();
    let mut picture = |state: &[u8], frame: u32| {
        let shown = moving.shown(&mut player, state, frame).unwrap();
        let mut renderer = render_host::Renderer::new();
        renderer.render(&shown.splats().unwrap(), &study.view.camera, &settings).unwrap().image
    };
    let change = study.view.change.as_ref().unwrap();
    let (mut of_worlds, mut temporal) = (Vec::new(), 0.0);
    for state in &study.states {
        let (this, next) = (picture(state, study.view.frame), picture(state, study.view.frame + 1));
        of_worlds.push(metric::distortion(&this, &study.view.picture).unwrap());
        let seen = super::temporal::before(&next, &this).unwrap();
        temporal += metric::mse(&seen, change).unwrap() / study.states.len() as f64;
    }
    let expected = of_worlds.iter().sum::<f64>() / of_worlds.len() as f64;
    of_worlds.sort_by(f64::total_cmp);
    // 2.1 of 7 worlds.
    let tail = (of_worlds[6] + of_worlds[5] + 0.1 * of_worlds[4]) / 2.1;
    assert!((terms.expected - expected).abs() < 1e-7, "{} {expected}", terms.expected);
    assert!((terms.tail - tail).abs() < 1e-7, "{} {tail}", terms.tail);
    assert!((terms.temporal - temporal).abs() < 1e-7, "{} {temporal}", terms.temporal);
    let whole =
        metric::distortion(&picture(&study.prefixes[0], study.view.frame), &study.view.picture).unwrap();
    assert!((terms.prefixes[0] - whole).abs() < 1e-7);
}

/// Equal worlds are rendered once and count as often as they come.
#[test]
fn equal_worlds_count_each() {
    let mut study = made();
    let weights = Weights { anchor: 0.0, monotone: 0.0, temporal: 0.0, cvar: 0.0, ..Weights::default() };
    study.states.truncate(2);
    let (first, once) = study.terms(&study.parameters, &weights);
    study.states = [0, 0, 1, 1].map(|k| study.states[k].clone()).to_vec();
    let (second, twice) = study.terms(&study.parameters, &weights);
    assert!((first.expected - second.expected).abs() < 1e-12);
    assert!((dot(&once, &once) / dot(&once, &twice) - 1.0).abs() < 1e-6);
}

/// Relative L2 distance of the first numbers from the second; not a number where all of these are 0.
fn distance(pairs: impl Iterator<Item = (f64, f64)>) -> f64 {
    let (apart, all) = pairs.fold((0.0, 0.0), |(apart, all), (found, expected)| {
        (apart + (found - expected) * (found - expected), all + expected * expected)
    });
    f64::sqrt(apart / all)
}

/// Relative L2 distances from `expected`, by name.
fn distances(found: &Gradient, expected: &Gradient) -> Vec<(&'static str, f64)> {
    let kinds = [
        ("centre", 0..SCALE),
        ("log-scale", SCALE..TURN),
        ("turn", TURN..OPACITY),
        ("opacity", OPACITY..COLOUR),
        ("colour", COLOUR..COMPONENTS),
    ];
    let of_kind = |kind: Range<usize>| {
        let rows = found.parameters.iter().zip(&expected.parameters);
        distance(rows.flat_map(|(found, expected)| kind.clone().map(move |c| (found[c], expected[c]))))
    };
    let mut out: Vec<_> = kinds.into_iter().map(|(name, kind)| (name, of_kind(kind))).collect();
    let steps = found.steps.as_flattened().iter().zip(expected.steps.as_flattened());
    out.push(("steps", distance(steps.map(|(&found, &expected)| (found, expected)))));
    out
}

/// A graphics device finds the terms and the gradient that the processor finds, and the same bits again.
#[test]
fn another_device_finds_the_same_objective_and_gradient() {
    let Some(gpu) = gpu() else { return };
    let study = made();
    let weights = Weights { temporal: 30.0, monotone: 0.5, cvar_fraction: 0.2, ..Weights::default() };
    let other_view = View { background: [0.1; 3], ..study.view.clone() };
    let settings = Settings::default();
    let on = |drawing: &mut Drawing, view: &View| {
        study.found(&study.parameters, &weights, view, drawing, &settings)
    };
    let (expected_terms, expected) = on(&mut Drawing::Cpu, &study.view);
    let mut drawing = Drawing::on(&gpu).unwrap();
    assert!(matches!(drawing, Drawing::Gpu(_)));
    let (terms, found) = on(&mut drawing, &study.view);
    let values = |terms: &Terms| {
        let Terms { expected, tail, temporal, monotone, prefixes, .. } = *terms;
        [expected, tail, temporal, monotone].into_iter().chain(prefixes).collect::<Vec<f64>>()
    };
    for (found, expected) in values(&terms).into_iter().zip(values(&expected_terms)) {
        assert!((found / expected - 1.0).abs() < 1e-4, "{terms:?} {expected_terms:?}");
    }
    for (name, apart) in distances(&found, &expected) {
        println!("{name}: {apart:.1e}");
        assert!(apart < DEVICE_TOLERANCE, "{name}: {apart}");
    }
    // The comparison sees another background, of every kind of parameter.
    let (_, other) = on(&mut drawing, &other_view);
    for (name, apart) in distances(&other, &expected) {
        assert!(apart > 2.0 * DEVICE_TOLERANCE, "{name}: {apart}");
    }
    assert!(on(&mut drawing, &study.view) == (terms, found), "the same bits, whatever was drawn before");
}
