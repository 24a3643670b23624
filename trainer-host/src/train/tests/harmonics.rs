//! Tests of harmonics that begin band after band.

use std::ops::Range;

use codec_core::ShDegree;

use super::*;

/// Options of a small scene whose bands begin `every` share of the training.
fn banded(every: f64) -> TrainOptions {
    let schedule = Schedule { harmonics_every: every, ..Schedule::default() };
    TrainOptions { schedule, sh_degree: 2, initial_gaussians: 200, max_gaussians: 300, ..options() }
}

/// What is rendered of `trainer` at the middle of the clip.
fn shown(trainer: &Trainer) -> Instant {
    let mut instant = Instant::default();
    trainer.model().instant_into(0.5, &mut instant);
    instant
}

/// The largest size of a value of one band.
fn largest(trainer: &Trainer, band: Range<usize>) -> f32 {
    let model = trainer.model();
    let rest = &model.gaussians.sh_rest;
    let of_band = rest.values().chunks(rest.width()).flat_map(|item| &item[band.clone()]);
    of_band.fold(0.0, |largest: f32, value| largest.max(value.abs()))
}

#[test]
fn bands_begin_one_after_another_and_are_not_there_before() {
    const STEPS: u32 = 240;
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let mut trainer = Trainer::new(&dataset, &banded(0.25)).unwrap();
    let mut gaussians = Vec::new();
    for step in 0..STEPS {
        let report = trainer.step(f64::from(step) / f64::from(STEPS)).unwrap();
        assert_eq!(report.rollback, None);
        let (degree, width) = [(0, 0), (1, 9), (2, 24), (2, 24)][(4 * step / STEPS) as usize];
        let instant = shown(&trainer);
        assert_eq!(instant.sh_degree.get(), degree, "step {step}");
        assert_eq!(instant.sh_rest.len(), width * instant.gaussians.len(), "step {step}");
        gaussians.push(report.gaussians);
        // The first step of Adam is as long as its rate, whenever it is taken.
        let new = match step {
            60 => 0..9,
            120 => 9..24,
            _ => continue,
        };
        let moved = largest(&trainer, new) / banded(0.25).rates.sh_rest;
        assert!((moved - 1.0).abs() < 1e-3, "step {step}: {moved} rates");
    }
    // Density control came between the two, pruning after them.
    assert!(gaussians[60] != gaussians[119] && gaussians[121] > gaussians[239], "{gaussians:?}");
    assert!(largest(&trainer, 0..9) > 0.01 && largest(&trainer, 9..24) > 0.01);
    assert_eq!(trainer.model().scene(3, 30.0).unwrap().epochs()[0].attributes().sh_degree.get(), 2);
}

#[test]
fn a_training_goes_on_bit_for_bit_between_bands_and_falls_back_to_before_them() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let take = |trainer: &mut Trainer, steps: Range<u32>| {
        steps.for_each(|step| drop(trainer.step(f64::from(step) / 160.0).unwrap()));
    };
    let mut whole = Trainer::new(&dataset, &banded(0.25)).unwrap();
    take(&mut whole, 0..160);
    for (left, degree) in [(30, 0), (40, 0), (60, 1), (100, 2)] {
        let mut first = Trainer::new(&dataset, &banded(0.25)).unwrap();
        take(&mut first, 0..left);
        let bytes = Checkpoint::of(&first, &dataset, f64::from(left) / 160.0).to_bytes().unwrap();
        let mut resumed = Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap();
        assert_eq!(shown(&resumed).sh_degree.get(), degree, "after {left} steps");
        take(&mut resumed, left..160);
        assert!(*resumed.model() == *whole.model(), "after {left} steps");
    }
    let mut fallen = Trainer::new(&dataset, &banded(0.25)).unwrap();
    take(&mut fallen, 0..100);
    loop {
        fallen.poison();
        if fallen.step(0.62).unwrap().rollback.is_some() {
            break;
        }
    }
    assert_eq!((fallen.steps(), shown(&fallen).sh_degree), (0, ShDegree::ZERO));
    take(&mut fallen, 0..50);
    assert_eq!(shown(&fallen).sh_degree.get(), 1);
}

/// Without a share between bands all of them train from the first step: as where the scene begins with all.
#[test]
fn bands_that_a_scene_begins_with_train_from_the_first_step() {
    let plain = dataset(synth::SynthKind::Balls, 3, 6);
    let mut begun = Instant::default();
    Trainer::start(&plain, &banded(0.0)).unwrap().instant_into(0.5, &mut begun);
    let degree = begun.sh_degree;
    assert!(degree.get() == 2 && begun.sh_rest.iter().all(|&value| value == 0.0));
    let without = Instant { sh_rest: Vec::new(), sh_degree: ShDegree::ZERO, ..begun.clone() };
    let of = |start: &Instant, every: f64| {
        let start = Start::Gaussians(start.clone(), start.sh_degree);
        trained(&Dataset { start, ..plain.clone() }, &banded(every), 100).model().into_owned()
    };
    let all = of(&begun, 0.25);
    assert!(of(&without, 0.0) == all && of(&begun, 0.0) == all);
    assert!(of(&without, 0.25) != all);
}

#[test]
fn shares_between_bands_that_leave_one_out_are_refused_by_name() {
    let refused = |options: &TrainOptions| options.validate().unwrap_err().to_string();
    for every in [-0.1, f64::NAN, 0.26, 1.0, f64::INFINITY] {
        let expected = format!("schedule.harmonics_every is {every}; 0 to 0.25 is allowed");
        assert_eq!(refused(&banded(every)), expected);
    }
    let finish = Finish { round_from: 0.4, ..Finish::default() };
    let mut late = TrainOptions { finish, ..banded(0.25) };
    late.schedule.density_end = 0.3;
    let expected = "schedule.harmonics_every is 0.25; 0 to 0.2 (finish.round_from / sh_degree) is allowed";
    assert_eq!(refused(&late), expected);
    assert_eq!(TrainOptions { sh_degree: 1, ..late }.validate(), Ok(()));
    for every in [0.0, 0.25] {
        assert_eq!(TrainOptions { sh_degree: 3, ..banded(every) }.validate(), Ok(()));
    }
}
