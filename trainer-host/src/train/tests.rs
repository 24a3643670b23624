//! Tests of training as a whole, on a small scene whose photographs are its own renders.

use render_host::{Backend, DeviceChoice, adjoint::loss::photograph::Photograph};

use codec_core::Footprint;

use super::{dataset::rendered, *};
use crate::{
    Instant, encode,
    import::{Limits, synth},
};

mod diverged;
mod exposed;
mod harmonics;
mod masked;
mod residual;
mod seen;
mod still;

/// How far apart two devices may train the same scene in a few steps, dB.
const TRAINED_TOLERANCE_DB: f64 = 0.1;

fn dataset(kind: synth::SynthKind, frames: usize, cameras: usize) -> Dataset {
    sized(kind, frames, cameras, 64)
}

/// Photographs of `side` pixels that average over pixels as cameras do, of balls.
fn dataset_of(side: u32) -> Dataset {
    sized(synth::SynthKind::Balls, 2, 12, side)
}

fn sized(kind: synth::SynthKind, frames: usize, cameras: usize, side: u32) -> Dataset {
    let options = synth::SynthOptions { kind, gaussians: 1000, frames, ..synth::SynthOptions::default() };
    let mut scene = synth::make(&options, &Limits::default()).unwrap();
    scene.footprint = Footprint::Pixel;
    let views = rendered::RenderedOptions { cameras, test_cameras: 2, side, ..Default::default() };
    let mut dataset = rendered::rendered(&scene, "balls", &views).unwrap();
    dataset.start = Start::VisualHull;
    dataset
}

fn options() -> TrainOptions {
    TrainOptions {
        initial_gaussians: 600,
        max_gaussians: 600,
        nodes: 16,
        sh_degree: 1,
        background: [0.0; 3],
        ..TrainOptions::default()
    }
}

fn trained<'a>(dataset: &'a Dataset, options: &TrainOptions, steps: u32) -> Trainer<'a> {
    let mut trainer = Trainer::new(dataset, options).unwrap();
    for step in 0..steps {
        trainer.step(f64::from(step) / f64::from(steps)).unwrap();
    }
    trainer
}

#[test]
fn training_finds_the_scene_and_its_motion() {
    let dataset = dataset(synth::SynthKind::Balls, 4, 24);
    let psnr = |trainer: &Trainer| evaluate(&*trainer.model(), &dataset.test, 1, [0.0; 3]).unwrap().psnr_db;
    let start = psnr(&Trainer::new(&dataset, &options()).unwrap());
    let with = |nodes: usize| psnr(&trained(&dataset, &TrainOptions { nodes, ..options() }, 900));
    let (moving, still) = (with(16), with(0));
    assert!(moving > start + 8.0, "{start} {moving}");
    // Without nodes nothing can follow the motion.
    assert!(moving > still + 2.0, "{still} {moving}");
}

/// What is fitted to one size of pixels is right at half and at twice the size only if Gaussians are drawn
/// as what a pixel averages over.
#[test]
fn a_scene_for_pixels_is_right_at_other_sizes() {
    let (small, large) = (dataset_of(48), dataset_of(96));
    let psnr = |footprint: Footprint| {
        let trained = trained(&small, &TrainOptions { footprint: Some(footprint), ..options() }, 900);
        let at = |dataset: &Dataset, reduced: u32| {
            evaluate(&*trained.model(), &dataset.test, reduced, [0.0; 3]).unwrap().psnr_db
        };
        [at(&small, 1), at(&small, 2), at(&large, 1)]
    };
    let ([dilated, half, twice], [pixel, pixel_half, pixel_twice]) =
        (psnr(Footprint::Dilated), psnr(Footprint::Pixel));
    println!("dilated {dilated:.2}, {half:.2}, {twice:.2} dB");
    println!("pixel {pixel:.2}, {pixel_half:.2}, {pixel_twice:.2} dB");
    assert!(pixel > dilated - 0.5, "{pixel} and {dilated} dB");
    assert!(pixel_half > half + 1.0, "at half the size {pixel_half} and {half} dB");
    assert!(pixel_twice > twice + 0.5, "at twice the size {pixel_twice} and {twice} dB");
}

/// Half of the time each channel is over the opposite background: an outline is found, and not only colours
/// that explain one of the two.
#[test]
fn a_scene_stands_before_a_background_that_it_was_trained_over() {
    let dataset = dataset(synth::SynthKind::Balls, 2, 12);
    let over_white = |opposite_end: f64| {
        let schedule = super::options::Schedule { opposite_end, ..Default::default() };
        let trained = trained(&dataset, &TrainOptions { schedule, ..options() }, 600);
        evaluate(&*trained.model(), &dataset.test, 1, [1.0; 3]).unwrap().psnr_db
    };
    let (both, one) = (over_white(1.0), over_white(0.0));
    assert!(both > one + 1.0, "{both} {one}");
}

/// A graphics device follows the processor's training, and takes its checkpoints.
#[test]
fn another_device_trains_to_the_same_quality() {
    if !Backend::HAS_GPU {
        let error = Backend::open(DeviceChoice::Gpu).unwrap_err().to_string();
        assert!(error.contains("--features gpu"), "{error}");
        return;
    }
    let gpu = match Backend::open(DeviceChoice::Gpu) {
        Ok(gpu) => gpu,
        Err(error) => {
            assert!(std::env::var("CI").as_deref() != Ok("true"), "{error}");
            eprintln!("SKIPPED: {error}");
            return;
        }
    };
    const STEPS: u32 = 60;
    let dataset = dataset(synth::SynthKind::Balls, 3, 8);
    let steps = |trainer: &mut Trainer, from: u32, to: u32| {
        let step = |step: u32| trainer.step(f64::from(step) / f64::from(STEPS)).unwrap().loss;
        (from..to).map(step).collect::<Vec<f64>>()
    };
    let psnr = |trainer: &Trainer| evaluate(&*trainer.model(), &dataset.test, 1, [0.0; 3]).unwrap().psnr_db;
    // So few steps are none to spare for an ending.
    let finish = Finish { prune: 0.0, round_from: 1.0, ..Finish::default() };
    let options = TrainOptions { finish, ..options() };
    let begun = |backend: &Backend| Trainer::new(&dataset, &options).unwrap().on(backend).unwrap();

    let (mut on_cpu, mut on_gpu) = (begun(&Backend::Cpu), begun(&gpu));
    let start = psnr(&on_cpu);
    let losses = [steps(&mut on_cpu, 0, STEPS), steps(&mut on_gpu, 0, STEPS)];
    assert!((losses[0][0] - losses[1][0]).abs() < 1e-5 * losses[0][0], "{losses:?}");
    let [cpu, other] = [psnr(&on_cpu), psnr(&on_gpu)];
    println!("start {start:.3} dB; cpu {cpu:.3} dB, {} {other:.3} dB", gpu.name());
    assert!(cpu > start + 0.5 && (cpu - other).abs() < TRAINED_TOLERANCE_DB, "{start} {cpu} {other}");

    // The same again is the same bit for bit; half on one device and half on the other is as good.
    let mut again = begun(&gpu);
    assert_eq!(steps(&mut again, 0, STEPS / 2), losses[1][..30]);
    let checkpoint = Checkpoint::of(&again, &dataset, 0.5).to_bytes().unwrap();
    let resumed = |backend: &Backend| {
        let checkpoint = Checkpoint::from_bytes(&checkpoint).unwrap();
        let mut trainer = checkpoint.resume(&dataset).unwrap().on(backend).unwrap();
        (steps(&mut trainer, STEPS / 2, STEPS), psnr(&trainer))
    };
    let (whole, _) = resumed(&gpu);
    assert_eq!(whole, losses[1][30..], "resumed on its own device");
    let (_, half) = resumed(&Backend::Cpu);
    assert!((cpu - half).abs() < TRAINED_TOLERANCE_DB, "{cpu} {half}");
}

#[test]
fn the_same_seed_gives_the_same_scene_on_any_number_of_threads() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let on = |threads: usize, seed: u64| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| trained(&dataset, &TrainOptions { seed, ..options() }, 150).model().into_owned())
    };
    let one = on(1, 1);
    assert_eq!(one, on(3, 1));
    assert_ne!(one, on(1, 2));
}

#[test]
fn a_training_goes_on_from_a_checkpoint_bit_for_bit() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let (half, all) = (130u32, 260u32);
    let whole = trained(&dataset, &options(), all);
    let mut first = Trainer::new(&dataset, &options()).unwrap();
    for step in 0..half {
        first.step(f64::from(step) / f64::from(all)).unwrap();
    }
    let bytes = Checkpoint::of(&first, &dataset, 0.5).to_bytes().unwrap();
    let mut second = Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap();
    for step in half..all {
        second.step(f64::from(step) / f64::from(all)).unwrap();
    }
    assert_eq!(second.model(), whole.model());
}

/// What a training falls back to is part of its checkpoint.
#[test]
fn a_resumed_training_falls_back_as_one_that_was_not_interrupted() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let mut whole = trained(&dataset, &options(), 60);
    let bytes = Checkpoint::of(&whole, &dataset, 0.5).to_bytes().unwrap();
    let mut resumed = Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap();
    for trainer in [&mut whole, &mut resumed] {
        let report = loop {
            trainer.poison();
            let report = trainer.step(0.5).unwrap();
            if report.rollback.is_some() {
                break report;
            }
        };
        assert_eq!(report.step, 0, "{report:?}");
        (0..10).for_each(|step| drop(trainer.step(f64::from(step) / 120.0).unwrap()));
    }
    assert_eq!(resumed.model(), whole.model());
}

/// Coarse steps and values at a price; on so small a scene no Gaussian is one too many.
fn finished() -> TrainOptions {
    let finish = Finish { prune: 0.1, coarseness: 6.0, motion: 2.0, ..Finish::default() };
    TrainOptions { finish, sh_degree: 2, ..options() }
}

#[test]
fn a_finished_training_goes_on_from_a_checkpoint_bit_for_bit() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    // The average has begun by then.
    let (most, all) = (190u32, 200u32);
    let whole = trained(&dataset, &finished(), all);
    let mut first = Trainer::new(&dataset, &finished()).unwrap();
    for step in 0..most {
        first.step(f64::from(step) / f64::from(all)).unwrap();
    }
    let bytes = Checkpoint::of(&first, &dataset, 0.95).to_bytes().unwrap();
    let mut second = Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap();
    assert!(second.decisions().unwrap().is_some());
    let shown = |model: &Model| {
        let mut instant = crate::Instant::default();
        model.instant_into(0.3, &mut instant);
        instant
    };
    assert!(shown(&second.shown()) == shown(&first.shown()));
    assert!(shown(&second.shown()) != shown(&second.model()));
    for step in most..all {
        second.step(f64::from(step) / f64::from(all)).unwrap();
    }
    assert!(second.model() == whole.model() && second.prunings() == whole.prunings());
}

/// What was trained as it is rounded loses less than what was rounded afterwards, at the same bytes: in the
/// mean over seeds, which differ by more than that.
#[test]
fn a_finished_scene_beats_a_plain_one_of_the_same_size() {
    let dataset = dataset(synth::SynthKind::Balls, 4, 24);
    let decoded_db = |encoded: &encode::Encoded| {
        let received = encoded.stream.receive().unwrap();
        let content = received.content();
        let mut player = crate::stream::Player::new(content.manifest);
        let instants = (0..4).map(|t| player.instant(&content, t).unwrap()).collect();
        let clip = Clip { instants, footprint: content.manifest.footprint() };
        evaluate(&clip, &dataset.test, 1, [0.0; 3]).unwrap().psnr_db
    };
    let compared = |seed: u64| {
        let finished = trained(&dataset, &TrainOptions { seed, ..finished() }, 900);
        let scene = finished.model().scene(4, 30.0).unwrap();
        let decisions = finished.decisions().unwrap().unwrap();
        let options = encode::EncodeOptions::default();
        let ours = encode::reencode(&scene, &decisions, 1.0, &options, &crate::encode::no_progress).unwrap();

        let never = Finish { prune: 0.0, round_from: 1.0, ..Finish::default() };
        let plain = trained(&dataset, &TrainOptions { finish: never, seed, ..self::finished() }, 900);
        assert!(plain.decisions().unwrap().is_none() && plain.prunings().is_empty());
        let bytes = ours.report.ledger.wire() as u64;
        let options = encode::EncodeOptions { target: Some(encode::Target::Bytes(bytes)), ..options };
        let theirs =
            encode::encode(&plain.model().scene(4, 30.0).unwrap(), &options, &crate::encode::no_progress)
                .unwrap();
        let (ours_db, theirs_db) = (decoded_db(&ours), decoded_db(&theirs));
        let shown_db = evaluate(&finished.shown(), &dataset.test, 1, [0.0; 3]).unwrap().psnr_db;
        let estimated = finished.estimated_bytes().unwrap();
        let ledger = &ours.report.ledger;
        let is_canonical = |name: &str| !name.contains("motion") && name != "track";
        let canonical = ledger.shares.iter().filter(|share| is_canonical(share.attribute));
        let coded = canonical.map(|share| share.bits / 8.0).sum::<f64>() + ledger.table_indices;
        assert!((0.85..1.15).contains(&(estimated / coded)), "{estimated} {coded}");
        // What is shown in training is what is received, but for motion.
        assert!((shown_db - ours_db).abs() < 1.0, "{shown_db} {ours_db}");
        assert_eq!(finished.prunings().len(), 2);
        assert_eq!(finished.model().gaussians(), finished.prunings()[1].after);
        assert!(finished.model().gaussians() < plain.model().gaussians());
        assert!(finished.prunings().iter().all(|pruning| pruning.error_share < 0.05));
        ours_db - theirs_db
    };
    let gains = [1, 2, 3].map(compared);
    println!("gains {gains:?} dB");
    assert!(gains.iter().sum::<f64>() > 0.0, "{gains:?}");
}

#[test]
fn foreign_and_damaged_checkpoints_are_refused() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let trainer = trained(&dataset, &options(), 3);
    let bytes = Checkpoint::of(&trainer, &dataset, 0.1).to_bytes().unwrap();
    for at in (0..bytes.len()).step_by(bytes.len() / 40) {
        let mut changed = bytes.clone();
        changed[at] ^= 0x10;
        assert!(Checkpoint::from_bytes(&changed).is_err(), "byte {at}");
        assert!(Checkpoint::from_bytes(&bytes[..at]).is_err(), "cut at {at}");
    }
    let other = self::dataset(synth::SynthKind::Cloth, 3, 6);
    let refused = Checkpoint::from_bytes(&bytes).unwrap().resume(&other).unwrap_err().to_string();
    assert!(refused.contains("other names, times, sizes, cameras or pixels"), "{refused}");
    // Other pixels under the same names.
    let mut changed = dataset.clone();
    let mut views = dataset.train.photographs().to_vec();
    let photograph = &views[0].photograph;
    let mut rgba = photograph.rgba().to_vec();
    rgba[3] ^= 1;
    views[0].photograph = Photograph::new(photograph.width(), photograph.height(), rgba).unwrap();
    changed.train = Views::new(views).unwrap();
    let refused = Checkpoint::from_bytes(&bytes).unwrap().resume(&changed).unwrap_err().to_string();
    assert!(refused.contains("cameras or pixels"), "{refused}");
    assert_eq!(Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap().steps(), 3);
}

/// Files whose checksum is right and whose numbers are not are refused, or harmless.
#[test]
fn forged_checkpoints_cannot_panic() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let small = TrainOptions { initial_gaussians: 30, max_gaussians: 40, nodes: 8, ..options() };
    let bytes = Checkpoint::of(&trained(&dataset, &small, 40), &dataset, 0.5).to_bytes().unwrap();
    let (mut refused, mut harmless) = (0, 0);
    let spread = (14..bytes.len()).step_by(bytes.len() / 40);
    for (k, at) in spread.chain(14..54).chain(bytes.len() - 30..bytes.len()).enumerate() {
        let mut forged = bytes.clone();
        forged[at] = [0, 0x7f, 0xff][k % 3];
        let checksum = crc32fast::hash(&forged[14..]).to_le_bytes();
        forged[10..14].copy_from_slice(&checksum);
        match Checkpoint::from_bytes(&forged).ok().and_then(|read| read.resume(&dataset).ok()) {
            None => refused += 1,
            Some(mut trainer) => {
                harmless += 1;
                let _ = trainer.step(0.5);
            }
        }
    }
    assert!(refused > 10 && harmless > 10, "{refused} {harmless}");
}

#[test]
fn a_training_that_diverges_falls_back_and_then_gives_up_by_name() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let mut trainer = Trainer::new(&dataset, &options()).unwrap();
    let mut poisoned_until_noticed = || {
        trainer.poison();
        let reports: Result<Vec<StepReport>, TrainError> = (0..100).map(|_| trainer.step(0.5)).collect();
        reports.map(|reports| reports.into_iter().find_map(|report| report.rollback))
    };
    for _ in 0..3 {
        let (step, what) = poisoned_until_noticed().unwrap().unwrap();
        assert!(what.contains("not a number"), "{what}");
        assert!(step > 0, "the step that diverged, not the one that is fallen back to");
    }
    let error = poisoned_until_noticed().unwrap_err().to_string();
    assert!(error.contains("diverged at step"), "{error}");
    // What it fell back to is sound.
    assert!(trainer.model().is_sound());
}

#[test]
fn options_out_of_range_and_empty_splits_are_refused_by_name() {
    let mut dataset = dataset(synth::SynthKind::Balls, 2, 6);
    let refused =
        |dataset: &Dataset, options: &TrainOptions| Trainer::new(dataset, options).unwrap_err().to_string();
    let text = refused(&dataset, &TrainOptions { sh_degree: 4, ..options() });
    assert!(text.contains("sh_degree is 4; 0 to 3"), "{text}");
    for (finish, said) in [
        (
            Finish { round_from: 0.5, ..Finish::default() },
            "finish.round_from is 0.5; 0.6 (schedule.density_end) to 1",
        ),
        (
            Finish { prune_at: [0.9, 0.7], ..Finish::default() },
            "finish.prune_at[1] is 0.7; finish.prune_at[0] to 1",
        ),
        (
            Finish { prune_at: [0.5, 0.7], ..Finish::default() },
            "schedule.density_end is 0.6; 0 to 0.5 (finish.prune_at[0])",
        ),
    ] {
        let text = TrainOptions { finish, ..options() }.validate().unwrap_err().to_string();
        assert!(text.contains(said), "{text}");
    }
    let finish = Finish { coarseness: 0.0, ..Finish::default() };
    let text = refused(&dataset, &TrainOptions { finish, ..options() });
    assert!(text.contains("finish.coarseness is 0;") && text.contains("above 0, to 64"), "{text}");
    let finish = Finish { prune_at: [0.5, 1.5], ..Finish::default() };
    assert!(refused(&dataset, &TrainOptions { finish, ..options() }).contains("finish.prune_at[1] is 1.5"));
    let text = refused(&dataset, &TrainOptions { rigidity: f32::NAN, ..options() });
    assert!(text.contains("rigidity is NaN"), "{text}");
    dataset.train = Views::new(Vec::new()).unwrap();
    assert!(refused(&dataset, &options()).contains("balls: the training split is empty"));
}

/// What could be begun with and never be finished is refused before the first step.
#[test]
fn datasets_that_no_training_finishes_with_are_refused_by_name() {
    let good = dataset(synth::SynthKind::Balls, 2, 6);
    let refused = |dataset: &Dataset| Trainer::new(dataset, &options()).unwrap_err().to_string();
    for frames in [0, usize::MAX] {
        let text = refused(&Dataset { frames, ..good.clone() });
        assert_eq!(text, format!("balls: frames is {frames}; 1 to 1048576 is allowed"));
    }
    let point = ColouredPoint { position: [0.0; 3], colour: [0.5; 3] };
    let nan = ColouredPoint { position: [0.0, f32::NAN, 0.0], ..point };
    let gaussian = codec_core::Gaussian { scale: [0.1; 3], opacity: 0.5, ..codec_core::Gaussian::ABSENT };
    let infinite = codec_core::Gaussian { position: [f32::INFINITY, 0.0, 0.0], ..gaussian };
    let degree = codec_core::ShDegree::new(1).unwrap();
    let of = |gaussians: Vec<codec_core::Gaussian>, rest: usize| {
        let instant = Instant { gaussians, sh_rest: vec![0.0; rest], sh_degree: degree };
        Start::Gaussians(instant, degree)
    };
    for (start, words) in [
        (Start::Points(Vec::new()), "start is a list of no points; at least one point"),
        (Start::Points(vec![point, nan]), "start is point 1, "),
        (of(Vec::new(), 0), "start is a list of no Gaussians; at least one Gaussian"),
        (of(vec![gaussian; 2], 17), "start's sh_rest is 17 values; 18 of 2 Gaussians of degree 1"),
        (of(vec![gaussian, infinite], 18), "start is Gaussian 1, "),
    ] {
        let text = refused(&Dataset { start, ..good.clone() });
        assert!(text.starts_with("balls: ") && text.contains(words), "{text}");
    }
    let start = of(vec![gaussian; 2], 18);
    assert_eq!(Trainer::new(&Dataset { start, ..good.clone() }, &options()).unwrap().model().gaussians(), 2);
}

#[test]
fn views_that_are_not_there_and_pictures_of_no_size_are_named() {
    let views = dataset(synth::SynthKind::Balls, 2, 6).test;
    let clip = Clip { instants: vec![Instant::default()], footprint: Footprint::Pixel };
    let said = |index, reduced| compare(&clip, &views, index, reduced, [0.0; 3]).unwrap_err().to_string();
    let count = views.photographs().len();
    assert_eq!(said(count, 1), format!("view {count} is asked for; the split has {count}"));
    assert_eq!(said(0, 0), "pictures reduced 0 times are asked for; at least 1 is allowed");
    let error = compare(&clip, &views, 0, 1000, [0.0; 3]).unwrap_err();
    assert!(matches!(error, EvaluationError::Image(_)), "a size of 0 x 0 pixels: {error}");
    let half = compare(&clip, &views, 0, 2, [0.0; 3]).unwrap();
    assert_eq!((half.rendered.width(), half.photograph.width()), (32, 32));
}

#[test]
fn a_trained_scene_has_as_many_frames_as_requested() {
    let dataset = dataset(synth::SynthKind::Balls, 3, 6);
    let trainer = trained(&dataset, &options(), 60);
    let scene = trainer.model().scene(7, 24.0).unwrap();
    assert_eq!((scene.frames(), scene.epochs().len()), (7, 1));
    let mut instant = crate::Instant::default();
    trainer.model().instant_into(0.5, &mut instant);
    assert_eq!(scene.instant(3).unwrap().gaussians[0].position, instant.gaussians[0].position);
    assert!(trainer.model().scene(0, 24.0).is_err());
}

/// Trained splats may be brighter than white; what they are rendered to is a photograph all the same.
#[test]
fn a_scene_brighter_than_white_is_rendered_to_photographs() {
    let gaussian = |x: f32| codec_core::Gaussian {
        position: [x, 0.0, 0.0],
        scale: [0.2; 3],
        rotation: [1.0, 0.0, 0.0, 0.0],
        opacity: 0.6,
        sh0: [6.0, 3.0, 0.0],
    };
    let gaussians: Vec<codec_core::Gaussian> = [-0.5, 0.0, 0.5].map(gaussian).into();
    let attributes = crate::Attributes {
        positions: crate::Track::Constant(gaussians.iter().map(|g| g.position).collect()),
        rotations: crate::Track::Constant(gaussians.iter().map(|g| g.rotation).collect()),
        log_scales: crate::Track::Constant(gaussians.iter().map(|g| g.scale.map(f32::ln)).collect()),
        opacity_logits: crate::Track::Constant(vec![0.4; 3]),
        sh0: crate::Track::Constant(gaussians.iter().map(|g| g.sh0).collect()),
        sh_rest: Vec::new(),
        sh_degree: codec_core::ShDegree::ZERO,
    };
    let scene = crate::Scene::new(vec![crate::Epoch::new(1, attributes).unwrap()], 30.0).unwrap();
    let views = rendered::RenderedOptions { cameras: 2, test_cameras: 1, side: 32, ..Default::default() };
    let dataset = rendered::rendered(&scene, "bright", &views).unwrap();
    let brightest = |view: &PosedPhotograph| view.photograph.rgba().iter().copied().max();
    assert!(dataset.train.photographs().iter().all(|view| brightest(view) > Some(100)));
}
