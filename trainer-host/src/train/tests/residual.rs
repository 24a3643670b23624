//! Tests of the price of motion that clusters' tracks do not code.

use super::*;

/// Options of a small scene of which motion has a price of `weight` from a third of the training on.
fn priced(weight: f32) -> TrainOptions {
    let schedule = Schedule { residual_from: 0.33, ..Schedule::default() };
    TrainOptions { schedule, residual_weight: weight, ..options() }
}

/// Mean over its Gaussians and a few instants of what affine maps leave of the motion of `trainer`, scene
/// units.
fn residual(trainer: &Trainer) -> f64 {
    let model = trainer.model();
    let neighbourhoods = motion::Neighbourhoods::of(&model.trajectories(), |_| true);
    let mut instant = Instant::default();
    let at = |time: f32| {
        model.instant_into(time, &mut instant);
        let (mut sum, mut count) = (0.0, 0.0f64);
        let moved = |index: usize| (instant.gaussians[index].position, instant.gaussians[index].rotation);
        let rest = |index: usize| (model.gaussians.positions()[index], model.gaussians.rotations()[index]);
        neighbourhoods.each_residual(rest, moved, |_, residual, _| {
            sum += residual.length();
            count += 1.0;
        });
        sum / count
    };
    [0.1, 0.3, 0.7, 0.9].map(at).iter().sum::<f64>() / 4.0
}

#[test]
fn what_has_a_price_becomes_less() {
    let dataset = dataset(synth::SynthKind::Figure, 6, 6);
    let [plain, dear] = [0.0, 0.003].map(|weight| trained(&dataset, &priced(weight), 400));
    let schedule = Schedule { residual_from: 1.0, ..Schedule::default() };
    let never = trained(&dataset, &TrainOptions { schedule, ..priced(0.003) }, 400);
    assert_eq!(plain.model(), never.model());
    let (before, after) = (residual(&plain), residual(&dear));
    assert!(after < 0.8 * before, "{after} {before}");
}

#[test]
fn a_priced_training_goes_on_bit_for_bit() {
    const ALL: u32 = 260;
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let whole = trained(&dataset, &priced(0.003), ALL);
    // Between two controls of density, and after the first pruning, of which neighbourhoods know.
    for half in [120u32, 175] {
        let mut first = Trainer::new(&dataset, &priced(0.003)).unwrap();
        (0..half).for_each(|step| drop(first.step(f64::from(step) / f64::from(ALL)).unwrap()));
        let bytes = Checkpoint::of(&first, &dataset, f64::from(half) / f64::from(ALL)).to_bytes().unwrap();
        let mut second = Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap();
        (half..ALL).for_each(|step| drop(second.step(f64::from(step) / f64::from(ALL)).unwrap()));
        assert!(second.model() == whole.model(), "{half}");
    }
}
