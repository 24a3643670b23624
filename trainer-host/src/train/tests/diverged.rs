//! What a training that gives up leaves.

use super::*;

/// Its checkpoint is of the state that it fell back to, and as far as that had come; going on with it is one
/// more attempt and no more.
#[test]
fn what_is_left_of_a_training_that_gives_up_is_not_complete() {
    let dataset = dataset(synth::SynthKind::Balls, 2, 6);
    let options = TrainOptions { initial_gaussians: 100, max_gaussians: 100, ..options() };
    let mut trainer = Trainer::new(&dataset, &options).unwrap();
    let mut report = None;
    for step in 0..510 {
        report = Some(trainer.step(f64::from(step) / 1000.0).unwrap());
    }
    assert_eq!(report.and_then(|report| report.rollback), None);
    let attempts = |trainer: &mut Trainer| {
        for attempt in 0.. {
            trainer.poison();
            // What is no number shows in a loss, or where parameters are looked through.
            let found = (0..100)
                .map(|_| trainer.step(0.51))
                .find(|found| found.as_ref().map_or(true, |report| report.rollback.is_some()));
            if let Err(error) = found.unwrap() {
                return (attempt, error.to_string());
            }
        }
        panic!("it never gives up")
    };
    let (fell_back, error) = attempts(&mut trainer);
    assert!(fell_back == 3 && error.contains("it fell back 3 times"), "{fell_back}: {error}");
    assert_eq!((trainer.steps(), trainer.progress()), (500, 0.5));
    let bytes = Checkpoint::of(&trainer, &dataset, trainer.progress()).to_bytes().unwrap();
    let read = Checkpoint::from_bytes(&bytes).unwrap();
    assert_eq!((read.steps(), read.progress()), (500, 0.5));
    let mut resumed = read.resume(&dataset).unwrap();
    assert_eq!(attempts(&mut resumed).0, 0);
}

/// A training that ends just where its loss becomes another, as where a device is lost, leaves a checkpoint
/// that is read.
#[test]
fn a_checkpoint_of_where_the_loss_becomes_another_is_read() {
    let dataset = dataset(synth::SynthKind::Balls, 2, 6);
    let mut trainer = Trainer::new(&dataset, &options()).unwrap();
    trainer.step(0.0).unwrap();
    trainer.begin_another_loss();
    let bytes = Checkpoint::of(&trainer, &dataset, 0.5).to_bytes().unwrap();
    let mut resumed = Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap();
    assert_eq!(resumed.step(0.5).unwrap().rollback, None);
    assert_eq!(resumed.steps(), 2);
}

/// A checkpoint of another version is refused with both versions.
#[test]
fn checkpoints_of_other_versions_are_refused_by_name() {
    let dataset = dataset(synth::SynthKind::Balls, 2, 6);
    let trainer = Trainer::new(&dataset, &options()).unwrap();
    let mut bytes = Checkpoint::of(&trainer, &dataset, 0.0).to_bytes().unwrap();
    bytes[8..10].copy_from_slice(&10u16.to_le_bytes());
    let error = Checkpoint::from_bytes(&bytes).unwrap_err().to_string();
    assert_eq!(error, "version is 10; 14 is allowed");
}

/// What a pruning takes away, pictures lose at once: the schedule says so, and it is no divergence.
#[test]
fn a_pruning_that_leaves_one_is_no_divergence() {
    let dataset = dataset(synth::SynthKind::Balls, 2, 12);
    let finish = Finish { prune: 1.0, prune_at: [0.65, 1.0], round_from: 1.0, ..Finish::default() };
    // By structure, the loss of pictures without anything in common is the most.
    let options = TrainOptions { finish, structure_weight: 0.6, ..options() };
    let mut trainer = Trainer::new(&dataset, &options).unwrap();
    let (mut lowest, mut highest) = (f64::INFINITY, 0.0f64);
    for step in 0..900 {
        let report = trainer.step(f64::from(step) / 1000.0).unwrap();
        assert_eq!(report.rollback, None);
        if trainer.prunings().is_empty() {
            lowest = lowest.min(report.mean_loss);
        } else {
            highest = highest.max(report.mean_loss);
        }
    }
    let [Pruning { before, after, .. }] = *trainer.prunings() else { panic!("one pruning") };
    assert!(after == 1 && before > 100, "{before} to {after}");
    assert!(highest > (10.0 * lowest + 0.1).min(lowest + 0.3), "as much as a divergence: {lowest} {highest}");
}
