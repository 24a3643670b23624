use std::{
    ops::ControlFlow::{Break, Continue},
    sync::Mutex,
};

use super::*;
use crate::{
    encode,
    train::delivery::{LossUnit, Recording, drawing::tests::gpu, evaluate, record::hex, view::tests::study},
};

/// How far apart two devices may be in the objective of any of a few updates, relative: as in gradients.
const OBJECTIVE_TOLERANCE: f64 = 1e-3;
/// The same of what validation sees, dB.
const TUNED_TOLERANCE_DB: f64 = 0.1;

fn options(variant: Variant) -> DeliveryOptions {
    DeliveryOptions {
        worlds: 6,
        updates: 12,
        encode_every: 3,
        validation: crate::train::delivery::Validation { every: 3, states: 6, candidates: 2 },
        encode: encode::EncodeOptions { packet_bytes: 400, block_len: 16, pictures: 0, ..Default::default() },
        ..DeliveryOptions::of(variant)
    }
}

#[test]
fn one_seed_gives_one_scene_on_any_number_of_threads() {
    let (scene, references) = study(3, 2);
    let train = |threads: usize, seed| {
        let options = DeliveryOptions { seed, updates: 6, ..options(Variant::Combined) };
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| fine_tune(&scene, &references, &options, &Backend::Cpu, &|_| Continue(())).unwrap())
    };
    let (one, three, other) = (train(1, 1), train(3, 1), train(1, 2));
    assert_eq!(one.record, three.record);
    assert!(one.scene.epochs() == three.scene.epochs());
    assert_ne!(one.record.registration.worlds, other.record.registration.worlds);
    assert_ne!(one.record.objective, other.record.objective);
}

#[test]
fn reconstruction_brings_the_complete_state_nearer_to_its_pictures() {
    let (scene, references) = study(3, 2);
    let options = DeliveryOptions { updates: 40, ..options(Variant::Reconstruction) };
    let tuned = fine_tune(&scene, &references, &options, &Backend::Cpu, &|_| Continue(())).unwrap();
    let [first, .., last] = tuned.record.candidates[..] else { panic!("{:?}", tuned.record.candidates) };
    assert_eq!((first.updates, last.updates), (0, 40));
    assert!(last.clean_db > first.clean_db + 0.3, "{first:?} {last:?}");
    let masks = Masks { states: Vec::new() };
    let found = evaluate(&tuned.scene, &tuned.decisions, &masks, &references).unwrap();
    let before = evaluate(&scene, &tuned.decisions, &masks, &references).unwrap();
    assert!(found.clean_db > before.clean_db + 0.3, "what is returned is what was trained");
}

#[test]
fn the_registration_is_there_before_the_first_update_and_all_variants_are_validated_alike() {
    let (scene, references) = study(3, 1);
    let folder = tempfile::tempdir().unwrap();
    let mut validation = Vec::new();
    for variant in Variant::ALL {
        let path = folder.path().join(format!("{}.json", variant.name()));
        let options = DeliveryOptions { updates: 3, registration: Some(path.clone()), ..options(variant) };
        let seen = Mutex::new(Vec::new());
        let tuned = fine_tune(&scene, &references, &options, &Backend::Cpu, &|update| {
            seen.lock().unwrap().push((update.updates, path.exists()));
            Continue(())
        })
        .unwrap();
        assert_eq!(*seen.lock().unwrap(), [(1, true), (2, true), (3, true)]);
        let written: Preregistration = serde_json::from_slice(&std::fs::read(&path).unwrap()).unwrap();
        assert_eq!(written.config_hash, hex(options.hash()));
        assert_eq!(written.weights, variant.weights(&options.weights));
        assert_eq!(written.validation_masks, tuned.record.registration.validation_masks);
        validation.push(written.validation_masks);
    }
    assert!(validation.windows(2).all(|pair| pair[0] == pair[1]), "{validation:?}");

    let options = DeliveryOptions {
        registration: Some(folder.path().join("no/such/folder.json")),
        ..options(Variant::Iid)
    };
    let error = fine_tune(&scene, &references, &options, &Backend::Cpu, &|_| panic!("nothing is trained"))
        .unwrap_err();
    assert!(error.to_string().contains("folder.json"), "{error}");
}

/// What breaks off takes the best candidate so far; without candidates, the scene as it is then.
#[test]
fn a_fine_tuning_that_is_broken_off_returns_what_exists() {
    let (scene, references) = study(3, 1);
    let until_third = |options: &DeliveryOptions| {
        let progress = |update: &Update| if update.updates == 3 { Break(()) } else { Continue(()) };
        fine_tune(&scene, &references, options, &Backend::Cpu, &progress).unwrap()
    };
    let mut options = options(Variant::Iid);
    let tuned = until_third(&options);
    assert_eq!(tuned.record.objective.len(), 3);
    let updates: Vec<usize> = tuned.record.candidates.iter().map(|candidate| candidate.updates).collect();
    assert_eq!((updates, tuned.record.taken), (vec![0], Some(0)));
    options.validation.candidates = 0;
    let tuned = until_third(&options);
    assert_eq!((tuned.record.objective.len(), tuned.record.taken), (3, None));
    assert!(tuned.scene.epochs() != scene.epochs(), "three updates show");
    // After its last update nothing is broken off: what that led to is a candidate.
    let third = DeliveryOptions { updates: 3, ..self::options(Variant::Iid) };
    let whole = fine_tune(&scene, &references, &third, &Backend::Cpu, &|_| Continue(())).unwrap();
    assert_eq!(until_third(&third).record, whole.record);
    assert_eq!(whole.record.candidates.last().map(|candidate| candidate.updates), Some(3));
}

/// Where a size is wanted, steps that are learnt come nearer to it than others, and what is larger is not
/// taken. Values of this scene lie on a grid of their own, which costs little until they move.
#[test]
fn a_size_that_was_wanted_is_not_exceeded() {
    let (scene, references) = study(3, 1);
    let with = |target: Option<u64>, learn_steps: bool| {
        let mut options =
            DeliveryOptions { updates: 20, warm_up: 0.0, learn_steps, ..options(Variant::Combined) };
        options.encode.target = target.map(encode::Target::Bytes);
        fine_tune(&scene, &references, &options, &Backend::Cpu, &|_| Continue(())).unwrap().record
    };
    let first = with(None, true).candidates[0].wire_bytes;
    let allowed = 9 * first / 10;
    let last = [true, false].map(|learn_steps| {
        let record = with(Some(allowed), learn_steps);
        assert_eq!(record.candidates.len(), 3);
        let (_, taken) = record.before_and_taken().unwrap();
        assert!(taken.wire_bytes <= allowed, "{allowed}: {:?}", record.candidates);
        record.candidates[2].wire_bytes
    });
    assert!(last[1] > allowed, "{allowed}: {last:?}");
    assert!(20 * last[0] < 19 * last[1], "learnt steps are lengthened: {last:?}");
}

/// What was validated before is taken where a fine-tuning cannot go on, and the record says why it ended.
#[test]
fn what_was_validated_is_not_lost_where_a_block_outgrows_its_packet() {
    let (scene, references) = study(3, 1);
    let mut options = DeliveryOptions { updates: 20, warm_up: 0.0, ..options(Variant::Reconstruction) };
    (options.encode.packet_bytes, options.encode.block_len, options.learn_steps) = (200, 64, false);
    // Values that go far take many bits.
    let LearningRates { position, log_scale, turn, opacity, colour, proxies } = &mut options.learning_rates;
    [position, log_scale, turn, opacity, colour, proxies].into_iter().for_each(|rate| *rate = 1000.0);
    let tune =
        |options: &DeliveryOptions| fine_tune(&scene, &references, options, &Backend::Cpu, &|_| Continue(()));
    let tuned = tune(&options).unwrap();
    let why = tuned.record.stopped.clone().unwrap();
    assert!(!why.is_empty() && tuned.record.objective.len() < 20, "{why}");
    assert_eq!(tuned.record.taken, Some(0));
    options.validation.candidates = 0;
    assert!(tune(&options).is_err(), "there is nothing to take");
}

/// Pictures for validation alone take none of the others.
#[test]
fn candidates_are_compared_on_pictures_for_validation_alone() {
    let (scene, references) = study(3, 2);
    let options = DeliveryOptions { updates: 2, ..options(Variant::Iid) };
    let (training, validation) = references.split_at(4);
    let tuned = |training: &[Reference], validation: &[Reference]| {
        resume(&scene, (training, validation), &options, &Backend::Cpu, None, &|_, _| Continue(())).unwrap()
    };
    let apart = tuned(training, validation);
    let masks = Masks { states: Vec::new() };
    let expected = evaluate(&scene, &apart.given, &masks, validation).unwrap();
    assert!((apart.record.candidates[0].clean_db - expected.clean_db).abs() < 1e-6);
    let same = tuned(training, &references[5..]);
    assert_eq!(same.record.objective, apart.record.objective, "trained on the same");
    assert_ne!(same.record.candidates[0].clean_db, apart.record.candidates[0].clean_db);
}

#[test]
fn too_few_references_and_bad_options_are_named() {
    let (scene, references) = study(3, 1);
    let refused = |references: &[Reference], options: &DeliveryOptions| {
        fine_tune(&scene, references, options, &Backend::Cpu, &|_| Continue(())).unwrap_err().to_string()
    };
    let options = options(Variant::Iid);
    assert!(refused(&[], &options).contains("0 reference pictures for training"));
    assert!(refused(&references[..2], &options).contains("for validation"));
    let none = DeliveryOptions { worlds: 0, ..options };
    assert!(refused(&references, &none).contains("worlds is 0"));
}

#[test]
fn rate_in_the_objective_makes_the_stream_smaller() {
    let (scene, references) = study(2, 2);
    let bytes = |rate| {
        let mut options = DeliveryOptions { updates: 30, ..options(Variant::Combined) };
        options.weights.rate = rate;
        options.validation.candidates = 1;
        let tuned = fine_tune(&scene, &references, &options, &Backend::Cpu, &|_| Continue(())).unwrap();
        tuned.record.candidates[1].wire_bytes
    };
    let (without, with) = (bytes(0.0), bytes(3.0));
    assert!(with < without, "{with} {without}");
}

#[test]
fn recorded_states_are_trained_on_and_must_fit() {
    let (scene, references) = study(2, 2);
    let folder = tempfile::tempdir().unwrap();
    let path = folder.path().join("states.json");
    let mut options = DeliveryOptions { updates: 2, warm_up: 0.0, ..options(Variant::Combined) };
    let encoded = encode::encode(&scene, &options.encode, &crate::encode::no_progress).unwrap();
    let loss = LossModel::Iid { probability: 0.5 };
    let masks = Masks::draw(&encoded.stream, loss, LossUnit::Packet, 2, 9).unwrap();
    let recording = Recording::of(&encoded.stream, (0..).zip(masks.states)).unwrap();
    let worlds = |options: &DeliveryOptions| {
        fine_tune(&scene, &references, options, &Backend::Cpu, &|_| Continue(()))
            .map(|tuned| tuned.record.registration.worlds)
    };
    let without = worlds(&options).unwrap();
    options.recorded = Some(path.clone());
    std::fs::write(&path, recording.to_json()).unwrap();
    assert_ne!(worlds(&options).unwrap(), without);
    options.encode.block_len = 32;
    let error = worlds(&options).unwrap_err().to_string();
    assert!(error.contains("states.json: stream is"), "of another stream: {error}");
}

/// Broken off after any update, stored and gone on with, a fine-tuning gives what it gives without.
#[test]
fn a_fine_tuning_goes_on_bit_for_bit() {
    let (scene, references) = study(3, 1);
    let mut options = DeliveryOptions { updates: 7, ..options(Variant::Combined) };
    let whole = fine_tune(&scene, &references, &options, &Backend::Cpu, &|_| Continue(())).unwrap();
    let bytes_after = |updates: usize| {
        let bytes = Mutex::new(Vec::new());
        let progress = |update: &Update, at: &Tuning| {
            if update.updates < updates {
                return Continue(());
            }
            *bytes.lock().unwrap() = at.to_bytes().unwrap();
            Break(())
        };
        resume(&scene, (&references, &[]), &options, &Backend::Cpu, None, &progress).unwrap();
        bytes.into_inner().unwrap()
    };
    // Before the second encoding, at one, between two, after the last update.
    for updates in [1, 3, 5, 7] {
        let at = Tuning::from_bytes(&bytes_after(updates)).unwrap();
        let gone_on =
            resume(&scene, (&references, &[]), &options, &Backend::Cpu, Some(at), &|_, _| Continue(()))
                .unwrap();
        assert_eq!(gone_on.record, whole.record, "after {updates}");
        assert!(gone_on.scene.epochs() == whole.scene.epochs() && gone_on.decisions == whole.decisions);
    }

    // What it was not made from is refused by name, and so is damage.
    let bytes = bytes_after(3);
    let refused = |scene: &Scene, references: &[Reference], options: &DeliveryOptions| {
        let at = Tuning::from_bytes(&bytes).unwrap();
        let error = resume(scene, (references, &[]), options, &Backend::Cpu, Some(at), &|_, _| {
            panic!("nothing is trained")
        });
        error.unwrap_err().to_string()
    };
    let (other, _) = study(3, 2);
    let fewer = &references[..references.len() - 1];
    assert!(refused(&other, fewer, &options).contains("pictures"), "the same scene");
    let faster = Scene::new(scene.epochs().to_vec(), 2.0 * scene.frames_per_second()).unwrap();
    assert!(refused(&faster, &references, &options).contains("the scene is not as in the checkpoint"));
    options.seed += 1;
    assert!(refused(&scene, &references, &options).contains("the configuration"));
    let mut damaged = bytes.clone();
    damaged[100] ^= 1;
    assert!(Tuning::from_bytes(&damaged).unwrap_err().to_string().contains("checksum"));
    assert!(Tuning::from_bytes(b"DGSTRAIN").unwrap_err().to_string().contains("DGSTUNED"));
}

/// Largest relative difference of the objective of an update.
fn apart(found: &FineTuned, expected: &FineTuned) -> f64 {
    let (found, expected) = (&found.record.objective, &expected.record.objective);
    assert_eq!(found.len(), expected.len());
    found.iter().zip(expected).map(|(found, expected)| (found / expected - 1.0).abs()).fold(0.0, f64::max)
}

/// A graphics device follows the processor's fine-tuning and gives the same bits on any number of threads;
/// each goes on from the other's checkpoint.
#[test]
fn another_device_fine_tunes_to_the_same_objective() {
    let Some(gpu) = gpu() else { return };
    let (scene, references) = study(3, 2);
    let options = DeliveryOptions { updates: 4, warm_up: 0.0, ..options(Variant::Combined) };
    let tuned = |references: &[Reference], backend: &Backend, begun: Option<Tuning>| {
        resume(&scene, (references, &[]), &options, backend, begun, &|_, _| Continue(())).unwrap()
    };
    let (cpu, other) = (tuned(&references, &Backend::Cpu, None), tuned(&references, &gpu, None));
    let (expected, found) = (&cpu.record, &other.record);
    println!("{}: {:.1e}; {:?} {:?}", gpu.name(), apart(&other, &cpu), found.objective, expected.objective);
    assert!(apart(&other, &cpu) < OBJECTIVE_TOLERANCE, "{:?} {:?}", found.objective, expected.objective);
    assert_eq!(found.candidates.len(), 3);
    for (found, expected) in found.candidates.iter().zip(&expected.candidates) {
        let off = [found.clean_db - expected.clean_db, found.p10_db - expected.p10_db];
        assert!(off.iter().all(|db| db.abs() < TUNED_TOLERANCE_DB), "{found:?} {expected:?}");
    }
    assert_eq!((expected.device.as_str(), found.device.as_str()), ("cpu", gpu.name().as_str()));
    assert!(found.registration == expected.registration);
    // The comparison sees what is drawn over another background.
    let over_grey = |reference: &Reference| Reference { background: [0.1; 3], ..reference.clone() };
    let over_grey: Vec<Reference> = references.iter().map(over_grey).collect();
    assert!(apart(&tuned(&over_grey, &gpu, None), &cpu) > 2.0 * OBJECTIVE_TOLERANCE);

    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    let again = pool.install(|| tuned(&references, &gpu, None));
    assert_eq!(again.record, *found);
    assert!(again.scene.epochs() == other.scene.epochs());

    let half = Mutex::new(Vec::new());
    let until_second = |update: &Update, at: &Tuning| {
        if update.updates < 2 {
            return Continue(());
        }
        *half.lock().unwrap() = at.to_bytes().unwrap();
        Break(())
    };
    resume(&scene, (&references, &[]), &options, &gpu, None, &until_second).unwrap();
    let half = half.into_inner().unwrap();
    let gone_on = |backend: &Backend| {
        let begun = Tuning::from_bytes(&half).unwrap();
        tuned(&references, backend, Some(begun))
    };
    assert_eq!(gone_on(&gpu).record, *found, "on its own device");
    let elsewhere = gone_on(&Backend::Cpu);
    assert_eq!(elsewhere.record.objective[..2], found.objective[..2]);
    assert!(apart(&elsewhere, &cpu) < OBJECTIVE_TOLERANCE, "{:?}", elsewhere.record.objective);
    assert_eq!(elsewhere.record.device, "cpu");
}
