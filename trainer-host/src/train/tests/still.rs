//! Tests of what stands still.

use super::*;

/// Of balls over a floor the floor stands still and the balls do not: pictures of training views decide.
#[test]
fn what_does_not_move_is_stood_still() {
    let dataset = dataset(synth::SynthKind::Balls, 8, 12);
    let with =
        |stand_still_within: f32| trained(&dataset, &TrainOptions { stand_still_within, ..options() }, 1500);
    let (standing, moving) = (with(0.04), with(0.0));
    let model = standing.model();
    let still = model.standing();
    assert!(still > model.gaussians() / 10 && still < model.gaussians(), "{still} of {}", model.gaussians());
    assert_eq!(moving.model().standing(), 0);
    let psnr = |trainer: &Trainer| evaluate(&*trainer.model(), &dataset.test, 1, [0.0; 3]).unwrap().psnr_db;
    let (standing_db, moving_db) = (psnr(&standing), psnr(&moving));
    assert!(standing_db > moving_db - 0.3, "{standing_db} {moving_db}");

    let none: &dyn Fn(usize) -> Option<[[f32; 3]; 2]> = &|_| None;
    let trial = |views, exposure_of| freeze::Trial { views, exposure_of, reduced: 1, background: [0.0; 3] };
    // Nothing bears that the balls hang in the air.
    let mut model = moving.model().into_owned();
    let before = model.clone();
    assert_eq!(freeze::freeze_still(&mut model, 1e3, &trial(&dataset.train, none)).unwrap(), 0);
    assert_eq!(model, before);
    // Without a look at pictures everything would.
    assert_eq!(model.freeze_still(1e3), model.gaussians());
}
