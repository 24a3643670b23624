//! Writes `.4dgs` through the crate `fourdgs`: the whole clip, as Gaussians that live for a run of frames.
//!
//! The format's Gaussians move in straight lines and do not turn, grow or change colour. A Gaussian of a
//! scene becomes one for each run of frames over which that is true of it, to a tenth of its thinnest
//! axis. What turns lives for a frame, so files of clips that turn are long. Higher bands are bytes of -4
//! to 4, colours are cut to 0 to 1, both by the format; its finest steps are used for the rest.

use std::io;

use ::fourdgs::{
    GaussianSet, SceneExtras, WriteOptions,
    quantization::{Bounds, Profile, SH_QUANT_HI, SH_QUANT_LO, Steps, life_class, motion_step},
    records::Metadata,
    write_to_vec,
};

use super::{beyond_in_harmonics, clamped, display_colour, nothing_to_write, sigmoid};
use crate::scene::{Epoch, Scene, Up};

/// The format's finest steps.
const PROFILE: Profile = Profile::Fine;

/// Scales below are written as this one, scene units.
const LEAST_SCALE: f64 = 1e-30;

/// How far from a straight line a centre may be, in units of the thinnest axis.
const OFF_LINE: f32 = 0.1;

/// `scene` as a file.
///
/// # Errors
/// No Gaussian at any frame, or what the format's own writer refuses.
pub fn encode(scene: &Scene) -> io::Result<Vec<u8>> {
    let degree = scene.epochs().iter().map(|epoch| epoch.attributes().sh_degree.get()).max().unwrap_or(0);
    let coefficients = (usize::from(degree) + 1).pow(2) - 1;
    let mut set = GaussianSet { sh_degree: degree, sh_coefficients: coefficients, ..GaussianSet::default() };
    if coefficients > 0 {
        set.sh = Some(Vec::new());
    }
    let mut first = 0;
    for epoch in scene.epochs() {
        for i in 0..epoch.count() {
            let mut t = 0;
            while t < epoch.frames() {
                let end = run(epoch, i, t);
                push(&mut set, epoch, i, t, end, first, scene.frames_per_second());
                t = end;
            }
        }
        first += epoch.frames();
    }
    if set.mu_t.is_empty() {
        return Err(nothing_to_write());
    }
    snap(&mut set);
    let options =
        WriteOptions { profile: PROFILE, sh_bands: degree, library: "dgs".into(), ..Default::default() };
    let up = match scene.up {
        Up::Y => Some("y-up-right-handed"),
        Up::Z => Some("z-up-right-handed"),
        _ => None,
    };
    let entries = [("color_space", Some("srgb-rec709-display")), ("coordinate_system", up)];
    let entries = entries.into_iter().filter_map(|(key, value)| Some((key.to_owned(), value?.to_owned())));
    let metadata = vec![Metadata { name: "scene".to_owned(), entries: entries.collect() }];
    let extras = SceneExtras { metadata, ..SceneExtras::default() };
    let duration = scene.frames() as f64 / scene.frames_per_second();
    write_to_vec(&set, duration, &options, &extras).map_err(io::Error::other)
}

/// What the file of `scene` holds otherwise than it is, beyond rounding: sentences for people.
pub(super) fn notes(scene: &Scene) -> Vec<String> {
    // Half a step beyond is still the nearest.
    let half = 0.5 * Steps::of(&Bounds::for_profile(PROFILE, 1.0)).rgb;
    let colour_fits = |sh0: &f32| (-half..=1.0 + half).contains(&f64::from(display_colour(*sh0)));
    let harmonic_fits = |_: usize, value: f32| (-0.5..=255.5).contains(&in_steps(value));
    let colours = scene.epochs().iter().map(|epoch| {
        let (n, sh0) = (epoch.count(), &epoch.attributes().sh0);
        let frames = if sh0.is_constant() { 1 } else { epoch.frames() };
        let fits = |i: &usize| (0..frames).all(|t| sh0.frame(t, n)[*i].iter().all(colour_fits));
        (0..n).filter(|i| !fits(i)).count()
    });
    let harmonics = scene.epochs().iter().map(|epoch| beyond_in_harmonics(epoch, harmonic_fits));
    let said =
        [clamped("colours", colours.sum(), "0 to 1"), clamped("harmonics", harmonics.sum(), "-4 to 4")];
    said.into_iter().flatten().collect()
}

/// A harmonic above band 0 in steps of its byte.
fn in_steps(harmonic: f32) -> f64 {
    (f64::from(harmonic) - SH_QUANT_LO) / (SH_QUANT_HI - SH_QUANT_LO) * 255.0
}

/// Moves everything to where the format's steps leave it. The writer checks what is decoded against half a
/// step, and what lies in the middle of two steps the rounding of single precision carries beyond that.
fn snap(set: &mut GaussianSet) {
    let nearest = |value: f64, step: f64| (value / step).round_ties_even() * step;
    // These do not depend on the size of Gaussians, and that of centres does on scales as they are snapped.
    let Steps { scale_log, rgb, alpha, .. } = Steps::of(&Bounds::for_profile(PROFILE, 1.0));
    for scale in &mut set.scales {
        *scale = nearest(f64::from(*scale).max(LEAST_SCALE).ln(), scale_log).exp() as f32;
    }
    for (at, value) in set.colors.iter_mut().enumerate() {
        *value = nearest(f64::from(*value), if at % 4 == 3 { alpha } else { rgb }).clamp(0.0, 1.0) as f32;
    }
    // As the writer finds its step and where it counts from.
    let mut scales: Vec<f64> = set.scales.iter().map(|scale| f64::from(*scale)).collect();
    scales.sort_by(f64::total_cmp);
    let (Some(below), Some(above)) =
        (scales.get((scales.len().max(1) - 1) / 2), scales.get(scales.len() / 2))
    else {
        return;
    };
    let Steps { pos, motion, sigma_log, .. } =
        Steps::of(&Bounds::for_profile(PROFILE, 0.5 * (below + above)));
    for axis in 0..3 {
        let along = || set.positions.iter().skip(axis).step_by(3);
        let least = f64::from(along().copied().fold(f32::INFINITY, f32::min));
        for place in set.positions.iter_mut().skip(axis).step_by(3) {
            *place = (least + nearest(f64::from(*place) - least, pos)) as f32;
        }
    }
    for (speeds, (from, to)) in set.motions.chunks_exact_mut(3).zip(set.win_lo.iter().zip(&set.win_hi)) {
        // Of what never fades, the class is that of its window alone.
        let lives = f64::from(*to) - f64::from(*from);
        let step = motion_step(life_class(0, sigma_log, true, lives, 1.0), motion);
        speeds.iter_mut().for_each(|speed| *speed = nearest(f64::from(*speed), step) as f32);
    }
}

/// The frame after the run of frames from `t` on in which Gaussian `i` moves in a straight line and
/// changes in no other way.
fn run(epoch: &Epoch, i: usize, t: usize) -> usize {
    let (n, a) = (epoch.count(), epoch.attributes());
    if a.is_constant() {
        return epoch.frames();
    }
    let is_same = |frame: usize| {
        a.rotations.frame(frame, n)[i] == a.rotations.frame(t, n)[i]
            && a.log_scales.frame(frame, n)[i] == a.log_scales.frame(t, n)[i]
            && a.opacity_logits.frame(frame, n)[i] == a.opacity_logits.frame(t, n)[i]
            && a.sh0.frame(frame, n)[i] == a.sh0.frame(t, n)[i]
    };
    let allowed = allowed(epoch, i, t);
    let place = |frame: usize, axis: usize| f64::from(a.positions.frame(frame, n)[i][axis]);
    // Slopes of lines from the first centre that pass all centres so far closely enough.
    let (mut low, mut high) = ([f64::NEG_INFINITY; 3], [f64::INFINITY; 3]);
    for frame in t + 1..epoch.frames() {
        if !is_same(frame) {
            return frame;
        }
        let since = (frame - t) as f64;
        for axis in 0..3 {
            let away = place(frame, axis) - place(t, axis);
            if !(low[axis]..=high[axis]).contains(&(away / since)) {
                return frame;
            }
            low[axis] = low[axis].max((away - allowed) / since);
            high[axis] = high[axis].min((away + allowed) / since);
        }
    }
    epoch.frames()
}

/// How far from a straight line the centre of Gaussian `i` may be from frame `t` on, scene units.
fn allowed(epoch: &Epoch, i: usize, t: usize) -> f64 {
    let scales = epoch.attributes().log_scales.frame(t, epoch.count())[i];
    f64::from(OFF_LINE * scales[0].min(scales[1]).min(scales[2]).exp())
}

/// Adds Gaussian `i` from frame `t` of `epoch`, whose first is frame `first` of the clip, up to `end`.
fn push(set: &mut GaussianSet, epoch: &Epoch, i: usize, t: usize, end: usize, first: usize, fps: f64) {
    let (n, a) = (epoch.count(), epoch.attributes());
    let last = end - 1;
    let (from, to) = (a.positions.frame(t, n)[i], a.positions.frame(last, n)[i]);
    let seconds = ((last - t) as f64 / fps) as f32;
    let speed = |d: usize| if last > t { (to[d] - from[d]) / seconds } else { 0.0 };
    let [w, x, y, z] = a.rotations.frame(t, n)[i];
    let start = ((first + t) as f64 / fps) as f32;
    set.positions.extend(from);
    set.scales.extend(a.log_scales.frame(t, n)[i].map(f32::exp));
    set.rotations.extend([x, y, z, w]);
    set.colors.extend(a.sh0.frame(t, n)[i].map(|c| display_colour(c).clamp(0.0, 1.0)));
    set.colors.push(sigmoid(a.opacity_logits.frame(t, n)[i]));
    set.motions.extend([0, 1, 2].map(speed));
    set.mu_t.push(start);
    set.sigma_t.push(f32::INFINITY);
    set.win_lo.push(start);
    set.win_hi.push(((first + end) as f64 / fps) as f32);
    if let Some(sh) = &mut set.sh {
        let rest = a.sh_degree.rest_len();
        let bands = &a.sh_rest[i * rest..][..rest];
        let byte = |k: usize, channel: usize| {
            let value = bands.get(3 * k + channel).copied().unwrap_or(0.0);
            in_steps(value).round().clamp(0.0, 255.0) as u8
        };
        let coefficients = set.sh_coefficients;
        sh.extend((0..3 * coefficients).map(|at| byte(at % coefficients, at / coefficients)));
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        import::{self, Limits, synth},
        scene::{Track, export::tests::epoch},
    };

    /// Largest distance of a centre of `scene` from the nearest of `again` at `frame`, in scene units.
    fn apart(scene: &Scene, again: &Scene, frame: usize) -> f32 {
        let (a, b) = (scene.instant(frame).unwrap(), again.instant(frame).unwrap());
        let distance = |p: [f32; 3], q: [f32; 3]| (0..3).map(|d| (p[d] - q[d]).powi(2)).sum::<f32>().sqrt();
        let nearest =
            |p: [f32; 3]| b.gaussians.iter().map(|g| distance(p, g.position)).fold(f32::INFINITY, f32::min);
        a.gaussians.iter().map(|g| nearest(g.position)).fold(0.0, f32::max)
    }

    #[test]
    fn still_scenes_come_back_with_their_bands() {
        let scene = Scene::new(vec![epoch(300, 2)], 30.0).unwrap();
        let bytes = encode(&scene).unwrap();
        let again = import::fourdgs::parse(&bytes, 30.0, &Limits::default()).unwrap();
        assert_eq!((again.frames(), again.max_count()), (1, 300));
        assert_eq!(again.epochs()[0].attributes().sh_degree.get(), 2);
        assert!(apart(&scene, &again, 0) < 0.01);
        let power =
            |scene: &Scene| -> f32 { scene.epochs()[0].attributes().sh_rest.iter().map(|v| v * v).sum() };
        let ratio = power(&again) / power(&scene);
        assert!((0.97..1.03).contains(&ratio), "{ratio}");
    }

    #[test]
    fn what_is_clamped_is_said() {
        let scene = |change: fn(&mut crate::Attributes)| {
            let mut attributes = epoch(5, 1).attributes().clone();
            attributes.sh0 = Track::Constant(vec![[0.0; 3]; 5]);
            change(&mut attributes);
            Scene::new(vec![Epoch::new(2, attributes).unwrap()], 30.0).unwrap()
        };
        assert!(notes(&scene(|_| ())).is_empty());
        // At the second frame alone, of one of five; and in two rows of nine harmonics.
        let said = notes(&scene(|attributes| {
            let mut colours = vec![[0.0; 3]; 10];
            colours[7] = [0.0, 2.0, 0.0];
            attributes.sh0 = Track::PerFrame(colours);
            attributes.sh_rest[3] = 4.1;
            attributes.sh_rest[44] = -5.0;
        }));
        let ends = "were clamped to what the format holds";
        let wanted = [
            format!("colours of 1 Gaussian {ends}, 0 to 1"),
            format!("harmonics of 2 Gaussians {ends}, -4 to 4"),
        ];
        assert_eq!(said, wanted);
    }

    #[test]
    fn clips_come_back_frame_by_frame() {
        let options = synth::SynthOptions { gaussians: 1000, frames: 4, ..Default::default() };
        let scene = synth::make(&options, &Limits::default()).unwrap();
        let bytes = encode(&scene).unwrap();
        let again = import::fourdgs::parse(&bytes, 30.0, &Limits::default()).unwrap();
        assert_eq!(again.frames(), 4);
        for frame in 0..4 {
            assert_eq!(again.instant(frame).unwrap().gaussians.len(), 1000, "frame {frame}");
            assert!(apart(&scene, &again, frame) < 0.02, "frame {frame}");
        }
        // The measure tells other frames apart.
        let mut moved = scene.epochs()[0].attributes().clone();
        let shifted = |p: &[f32; 3]| [p[0], p[1] + 0.3, p[2]];
        let all = (0..4).flat_map(|t| moved.positions.frame(t, 1000).iter().map(shifted).collect::<Vec<_>>());
        moved.positions = Track::PerFrame(all.collect());
        let moved = Scene::new(vec![Epoch::new(4, moved).unwrap()], 30.0).unwrap();
        assert!(apart(&moved, &again, 0) > 0.02);
    }

    /// Many, and small beside how far away they are.
    #[test]
    fn large_scenes_pass_the_writers_own_check() {
        let mut attributes = epoch(60_000, 0).attributes().clone();
        let place = |i: usize| [0, 1, 2].map(|d| ((i * 7919 + d * 104_729) % 999_983) as f32 * 6.1e-5 - 30.0);
        attributes.positions = Track::Constant((0..60_000).map(place).collect());
        attributes.log_scales =
            Track::Constant((0..60_000).map(|i| [-6.0 - (i % 7) as f32 * 0.1; 3]).collect());
        let scene = Scene::new(vec![Epoch::new(1, attributes).unwrap()], 30.0).unwrap();
        let bytes = encode(&scene).unwrap();
        let again = import::fourdgs::parse(&bytes, 30.0, &Limits::default()).unwrap();
        assert_eq!(again.max_count(), 60_000);
    }

    /// Colours, opacities and log scales in the middle of two steps, and speeds there too.
    #[test]
    fn what_lies_between_two_steps_passes_the_writers_own_check() {
        let steps = Steps::of(&Bounds::for_profile(PROFILE, 1.0));
        let count = 250;
        let mut attributes = epoch(count, 0).attributes().clone();
        let between = |i: usize, step: f64| (i as f64 + 0.5) * step;
        let scale = |i: usize| [between(i, steps.scale_log) as f32 - 4.0; 3];
        let colour = |i: usize| [((between(i, steps.rgb) - 0.5) / 0.282_094_791_773_878_14) as f32; 3];
        attributes.log_scales = Track::Constant((0..count).map(scale).collect());
        attributes.sh0 = Track::Constant((0..count).map(colour).collect());
        let place = |t: usize| move |i: usize| [i as f32 * 0.37 + (t * i) as f32 * 0.011, 0.0, t as f32];
        attributes.positions = Track::PerFrame((0..8).flat_map(|t| (0..count).map(place(t))).collect());
        let scene = Scene::new(vec![Epoch::new(8, attributes).unwrap()], 30.0).unwrap();
        let again = import::fourdgs::parse(&encode(&scene).unwrap(), 30.0, &Limits::default()).unwrap();
        assert_eq!(again.max_count(), count);

        let kind = synth::SynthKind::Births;
        let options = synth::SynthOptions { gaussians: 6000, frames: 20, kind, ..Default::default() };
        let births = synth::make(&options, &Limits::default()).unwrap();
        let again = import::fourdgs::parse(&encode(&births).unwrap(), 30.0, &Limits::default()).unwrap();
        assert_eq!(again.frames(), 20);
    }

    /// As [`run`], each line being compared with every centre on the way.
    fn run_by_comparing(epoch: &Epoch, i: usize, t: usize) -> usize {
        let (n, allowed) = (epoch.count(), allowed(epoch, i, t));
        let place = |frame: usize| epoch.attributes().positions.frame(frame, n)[i].map(f64::from);
        let is_straight = |last: usize| {
            let (from, to) = (place(t), place(last));
            (t + 1..last).all(|frame| {
                let share = (frame - t) as f64 / (last - t) as f64;
                (0..3).all(|d| (from[d] + share * (to[d] - from[d]) - place(frame)[d]).abs() <= allowed)
            })
        };
        (t + 1..epoch.frames()).find(|&frame| !is_straight(frame)).unwrap_or(epoch.frames())
    }

    #[test]
    fn runs_are_those_that_comparing_every_centre_finds() {
        let (count, frames) = (60, 80);
        let mut attributes = epoch(count, 0).attributes().clone();
        // Wanders of growing size around lines, beside Gaussians of .0025 to .14 units.
        let noise =
            |i: usize, t: usize, d: usize| ((i * 31 + t * 17 + d * 7) * 2_654_435 % 1009) as f32 / 1009.0;
        let place = |t: usize| {
            move |i: usize| [0, 1, 2].map(|d| 0.01 * (t * (d + 1)) as f32 + 3e-4 * i as f32 * noise(i, t, d))
        };
        attributes.positions = Track::PerFrame((0..frames).flat_map(|t| (0..count).map(place(t))).collect());
        let epoch = Epoch::new(frames, attributes).unwrap();
        let mut lengths = std::collections::BTreeSet::new();
        for (i, t) in (0..count).flat_map(|i| (0..frames).map(move |t| (i, t))) {
            let end = run(&epoch, i, t);
            assert_eq!(end, run_by_comparing(&epoch, i, t), "Gaussian {i} from frame {t}");
            lengths.insert(end - t);
        }
        assert!(lengths.len() > 20, "{lengths:?}");
    }

    /// Comparing every centre with every line would take hours.
    #[test]
    fn long_lines_are_found_in_time() {
        let mut attributes = epoch(1, 0).attributes().clone();
        let frames = 1_000_000;
        attributes.positions = Track::PerFrame((0..frames).map(|t| [t as f32, 0.0, 1.0]).collect());
        assert_eq!(run(&Epoch::new(frames, attributes).unwrap(), 0, 0), frames);
    }

    #[test]
    fn a_straight_line_is_one_gaussian() {
        let mut attributes = epoch(1, 0).attributes().clone();
        let line = |t: usize| [t as f32 * 0.5, 0.0, 1.0];
        attributes.positions = Track::PerFrame((0..9).map(line).collect());
        assert_eq!(run(&Epoch::new(9, attributes.clone()).unwrap(), 0, 0), 9);
        let bent = |t: usize| [t as f32 * 0.5, if t < 5 { 0.0 } else { t as f32 }, 1.0];
        attributes.positions = Track::PerFrame((0..9).map(bent).collect());
        let bent = Epoch::new(9, attributes).unwrap();
        assert_eq!((run(&bent, 0, 0), run(&bent, 0, 5)), (5, 9));
    }
}
