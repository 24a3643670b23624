//! Tests edits by what pictures and rows show.

use codec_core::{Gaussian, ShDegree};
use nalgebra::{Rotation3, Vector3};
use render_host::{Camera, Settings, Splats, metric};

use super::*;
use crate::{
    import::{
        Limits,
        synth::{self, SynthKind},
    },
    scene::{Instant, Up},
};

/// A moving scene with harmonics of degree 3.
fn scene() -> Scene {
    let options =
        synth::SynthOptions { gaussians: 1000, frames: 6, kind: SynthKind::Figure, ..Default::default() };
    let plain = synth::make(&options, &Limits::default()).unwrap();
    let degree = ShDegree::new(3).unwrap();
    edited(&plain, |epoch| {
        let sh_rest = (0..epoch.count() * degree.rest_len()).map(|i| 0.15 * (i as f32 * 0.7).sin()).collect();
        Epoch::new(epoch.frames(), Attributes { sh_rest, sh_degree: degree, ..epoch.attributes().clone() })
    })
    .unwrap()
}

fn picture(instant: &Instant, eye: [f64; 3], target: [f64; 3], up: [f64; 3]) -> render_host::Image {
    let camera = Camera::look_at(eye, target, up, 0.8, 96, 96).unwrap();
    let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
    render_host::render(&splats, &camera, &Settings::default()).unwrap().image
}

/// Whether two lists hold the same Gaussians: quaternions may have been normalised again.
fn same(a: &[Gaussian], b: &[Gaussian]) -> bool {
    let close = |a: &Gaussian, b: &Gaussian| {
        let turned = a.rotation.iter().zip(&b.rotation).all(|(a, b)| (a - b).abs() < 1e-6);
        turned && Gaussian { rotation: b.rotation, ..*a } == *b
    };
    a.len() == b.len() && a.iter().zip(b).all(|(a, b)| close(a, b))
}

/// A scene and a camera that move together show the same picture.
#[test]
fn a_turned_scene_shows_the_same_to_a_turned_camera() {
    let scene = scene();
    let turns = [
        Similarity { rotation: turn_between(Up::MinusY, Up::Y), ..Similarity::default() },
        "rotate=x:33;rotate=z:-70;scale=2.5;translate=1,-2,0.5".parse().unwrap(),
    ];
    for by in turns {
        let moved = transform(&scene, &by).unwrap();
        let (eye, target, up) = ([1.0, 2.0, -5.0], [0.0, 1.0, 0.0], [0.0, 1.0, 0.0]);
        let turned_up: [f64; 3] = (by.rotation * Vector3::from(up)).into();
        let before = picture(&scene.instant(3).unwrap(), eye, target, up);
        let after = picture(&moved.instant(3).unwrap(), by.point(eye), by.point(target), turned_up);
        let same = metric::psnr(&after, &before).unwrap();
        assert!(same > 60.0, "{same} dB");
        // Harmonics that are left as they were show.
        let unturned = edited(&moved, |epoch| {
            let sh_rest = scene.epochs()[0].attributes().sh_rest.clone();
            Epoch::new(epoch.frames(), Attributes { sh_rest, ..epoch.attributes().clone() })
        });
        let wrong =
            picture(&unturned.unwrap().instant(3).unwrap(), by.point(eye), by.point(target), turned_up);
        assert!(metric::psnr(&wrong, &before).unwrap() < same - 15.0);
    }
}

#[test]
fn half_turns_are_exact_and_undone_by_themselves() {
    let scene = scene();
    let by = Similarity { rotation: turn_between(Up::MinusY, Up::Y), ..Similarity::default() };
    let flipped = Scene { up: Up::MinusY, ..scene.clone() };
    let once = transform(&flipped, &by).unwrap();
    assert_eq!(once.up, Up::Y);
    let (a, b) = (scene.epochs()[0].attributes(), once.epochs()[0].attributes());
    let (p, q) = (a.positions.frame(2, 1000)[7], b.positions.frame(2, 1000)[7]);
    assert_eq!([p[0], -p[1], -p[2]], q);
    let twice = transform(&once, &by).unwrap();
    let c = twice.epochs()[0].attributes();
    assert_eq!((&a.positions, &a.sh_rest, &a.log_scales), (&c.positions, &c.sh_rest, &c.log_scales));
}

#[test]
fn turns_take_each_axis_to_each() {
    for from in Up::ALL {
        for to in Up::ALL {
            let turned: Vector3<f64> = turn_between(from, to) * Vector3::from(from.vector());
            assert!((turned - Vector3::from(to.vector())).norm() < 1e-12, "{from} {to}");
        }
    }
    let about = "rotate=y:90".parse::<Similarity>().unwrap();
    assert!((about.rotation * Vector3::z() - Vector3::x()).norm() < 1e-12);
    for wrong in ["", "rotate=w:3", "scale=0", "scale=nan", "translate=1,2", "turn=3"] {
        assert!(wrong.parse::<Similarity>().is_err(), "{wrong}");
    }
    for (far, allowed) in [
        ("scale=1e10", "scale: a factor from 1e-9 to 1e9 is allowed"),
        ("scale=1e-10", "scale: a factor from 1e-9 to 1e9 is allowed"),
        ("scale=nan", "scale: a factor from 1e-9 to 1e9 is allowed"),
        ("rotate=x:-2e9", "rotate: -1e9 to 1e9 degrees are allowed"),
        ("scale=2;translate=0,1e10,0", "translate: -1e9 to 1e9 each is allowed"),
    ] {
        assert_eq!(far.parse::<Similarity>().unwrap_err(), allowed, "{far}");
    }
    for near in ["scale=1e9;rotate=y:-1e9", "scale=1e-9", "translate=-1e9,1e9,0"] {
        assert!(near.parse::<Similarity>().is_ok(), "{near}");
    }
    let words = "scale=two".parse::<Similarity>().unwrap_err();
    assert!(words.starts_with("scale=two: rotate=x:DEGREES"), "{words}");
    assert_eq!(Similarity::default().rotation, Rotation3::identity());
}

#[test]
fn similarities_of_numbers_are_those_of_words_and_are_checked() {
    let half = 0.5f64.sqrt();
    let of_numbers = Similarity::new([3.0 * half, 3.0 * half, 0.0, 0.0], 2.0, [1.0, 2.0, 3.0]).unwrap();
    let of_words: Similarity = "rotate=x:90;scale=2;translate=1,2,3".parse().unwrap();
    assert!((of_numbers.rotation.matrix() - of_words.rotation.matrix()).norm() < 1e-12);
    assert_eq!((of_numbers.scale, of_numbers.translation), (of_words.scale, of_words.translation));
    let unit = [1.0, 0.0, 0.0, 0.0];
    for (rotation, scale, translation, words) in [
        ([0.0; 4], 1.0, [0.0; 3], "length of the rotation is 0; "),
        ([f64::NAN; 4], 1.0, [0.0; 3], "length of the rotation is NaN; "),
        (unit, 0.0, [0.0; 3], "scale is 0; a finite factor above 0 is allowed"),
        (unit, -2.0, [0.0; 3], "scale is -2; "),
        (unit, f64::NAN, [0.0; 3], "scale is NaN; "),
        (unit, 1.0, [0.0, f64::INFINITY, 0.0], "translation is inf; "),
    ] {
        let error = Similarity::new(rotation, scale, translation).unwrap_err().to_string();
        assert!(error.starts_with(words), "{error}");
        // Its fields are public: the same is refused where it is used.
        let by = Similarity { scale, translation, ..Similarity::default() };
        if by != Similarity::default() {
            assert_eq!(transform(&scene(), &by).unwrap_err().to_string(), error);
        }
    }
}

#[test]
fn frames_are_cut_across_epochs() {
    let options =
        synth::SynthOptions { gaussians: 1000, frames: 12, kind: SynthKind::Births, ..Default::default() };
    let scene = synth::make(&options, &Limits::default()).unwrap();
    let part = frames(&scene, 2, 9).unwrap();
    assert_eq!(part.frames(), 8);
    for t in 0..8 {
        let (found, wanted) = (part.instant(t).unwrap(), scene.instant(t + 2).unwrap());
        assert!(same(&found.gaussians, &wanted.gaussians), "{t}");
    }
    assert!(matches!(frames(&scene, 3, 12), Err(EditError::Frames { allowed: 11, .. })));
}

#[test]
fn crops_and_filters_keep_whole_gaussians() {
    let scene = scene();
    let all = scene.instant(0).unwrap();
    let cropped = crop(&scene, &"-,1,-,-,-,-".parse().unwrap()).unwrap();
    let at_any_frame = |i: usize| (0..6).any(|t| scene.instant(t).unwrap().gaussians[i].position[1] >= 1.0);
    let wanted: Vec<_> = (0..1000).filter(|&i| at_any_frame(i)).map(|i| all.gaussians[i]).collect();
    assert!(!wanted.is_empty() && wanted.len() < 1000);
    assert!(same(&cropped.instant(0).unwrap().gaussians, &wanted));
    assert!(!same(&cropped.instant(0).unwrap().gaussians, &all.gaussians));

    let opaque = filter(&scene, &"opacity>=0.5".parse().unwrap()).unwrap();
    assert!(opaque.instant(0).unwrap().gaussians.iter().all(|g| g.opacity > 0.499));
    assert_eq!(filter(&scene, &"opacity>2".parse().unwrap()).unwrap_err(), EditError::Nothing("filter"));
    for wrong in ["opacity", "size>3", "opacity>x", "opacity=3"] {
        assert!(wrong.parse::<Condition>().is_err(), "{wrong}");
    }
    for wrong in ["1,2,3", "1,1,1,0,2,2", "a,-,-,-,-,-"] {
        assert!(wrong.parse::<Bounds>().is_err(), "{wrong}");
    }
}

#[test]
fn scenes_are_merged_still_with_moving() {
    let moving = scene();
    let still = sh_degree(&frames(&moving, 0, 0).unwrap(), ShDegree::ZERO).unwrap();
    for both in [merged(&moving, &still).unwrap(), merged(&still, &moving).unwrap()] {
        assert_eq!((both.max_count(), both.frames()), (2000, 6));
    }
    let both = merged(&moving, &still).unwrap().instant(5).unwrap();
    assert!(same(&both.gaussians[..1000], &moving.instant(5).unwrap().gaussians));
    assert!(same(&both.gaussians[1000..], &still.instant(0).unwrap().gaussians));
    assert_eq!(both.sh_rest[1000 * 45..], vec![0.0; 1000 * 45]);
    let short = frames(&moving, 0, 3).unwrap();
    assert_eq!(merged(&moving, &short).unwrap_err(), EditError::Lengths { a: 6, b: 4 });
}
