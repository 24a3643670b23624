//! Tests of exposures: cameras that see the same scene brighter and darker.

use super::*;

/// How bright odd and even cameras see a scene that is itself less bright, so that none reaches white.
const FACTORS: [f32; 2] = [0.7, 1.0 / 0.7];
const BRIGHTNESS: f32 = 0.6;

/// `views` with colours times what `factor` says of each.
fn coloured<S>(views: &Views<S>, factor: impl Fn(usize) -> f32) -> Views<S> {
    let view = |(index, view): (usize, &PosedPhotograph)| {
        let (pixels, _) = view.photograph.rgba().as_chunks::<4>();
        let scaled = |v: u8| (factor(index) * f32::from(v)).round() as u8;
        let rgba = pixels.iter().flat_map(|&[r, g, b, a]| [scaled(r), scaled(g), scaled(b), a]);
        PosedPhotograph { photograph: Photograph::new(64, 64, rgba.collect()).unwrap(), ..view.clone() }
    };
    Views::new(views.photographs().iter().enumerate().map(view).collect()).unwrap()
}

/// The scene as cameras of different exposure see it; tests are of the scene itself.
fn unlike_cameras() -> Dataset {
    let clean = dataset(synth::SynthKind::Balls, 2, 12);
    Dataset {
        train: coloured(&clean.train, |index| BRIGHTNESS * FACTORS[index % 2]),
        test: coloured(&clean.test, |_| BRIGHTNESS),
        has_alpha: false,
        ..clean
    }
}

#[test]
fn cameras_of_different_exposure_do_not_spoil_the_scene() {
    let dataset = unlike_cameras();
    let psnr = |exposure: f32| {
        let rates = Rates { exposure, ..Rates::default() };
        let trained = trained(&dataset, &TrainOptions { rates, ..options() }, 900);
        let found: Vec<[[f32; 3]; 2]> = trained.exposures().collect();
        (evaluate(&*trained.model(), &dataset.test, 1, [0.0; 3]).unwrap().psnr_db, found)
    };
    let ((with, exposures), (without, none)) = (psnr(0.02), psnr(0.0));
    assert!(with > without + 2.0, "{with} {without}");
    assert!(none.is_empty() && exposures.len() == 12);
    let brightness = |index: usize| exposures[index][0].iter().sum::<f32>() / 3.0;
    assert!((0..12).step_by(2).all(|dark| brightness(dark) < 0.9), "{exposures:?}");
    assert!((1..12).step_by(2).all(|bright| brightness(bright) > 1.05), "{exposures:?}");
}

#[test]
fn a_training_with_exposures_goes_on_bit_for_bit_and_others_have_none() {
    let dataset = unlike_cameras();
    let at = |step: u32| f64::from(step) / 40.0;
    let mut whole = Trainer::new(&dataset, &options()).unwrap();
    (0..20).for_each(|step| drop(whole.step(at(step)).unwrap()));
    let bytes = Checkpoint::of(&whole, &dataset, at(20)).to_bytes().unwrap();
    let mut resumed = Checkpoint::from_bytes(&bytes).unwrap().resume(&dataset).unwrap();
    for trainer in [&mut whole, &mut resumed] {
        (20..40).for_each(|step| drop(trainer.step(at(step)).unwrap()));
    }
    assert!(whole.exposures().eq(resumed.exposures()) && whole.exposures().any(|[[r, ..], _]| r != 1.0));
    assert_eq!(*whole.model(), *resumed.model());
    let drawn = Dataset { has_alpha: true, ..dataset.clone() };
    let single =
        Dataset { train: Views::new(dataset.train.photographs()[..12].to_vec()).unwrap(), ..dataset };
    for dataset in [drawn, single] {
        assert_eq!(Trainer::new(&dataset, &options()).unwrap().exposures().count(), 0);
    }
}

/// What one photograph shows is not taken for its exposure, and the other cameras keep theirs.
#[test]
fn a_photograph_alone_at_its_place_has_no_exposure() {
    let whole = unlike_cameras();
    let photographs = whole.train.photographs();
    let train = Views::new(photographs[..photographs.len() - 1].to_vec()).unwrap();
    let lacking = Dataset { train, ..whole };
    let trained = trained(&lacking, &options(), 5);
    assert_eq!(trained.exposures().count(), 11);
    let has = |view: usize| trained.exposure_of(view).is_some();
    assert_eq!((0..24).filter(|&view| !has(view)).collect::<Vec<_>>(), [11, 23]);
}
