use super::*;
use crate::{
    import::{
        Limits,
        synth::{self, SynthKind, SynthOptions},
    },
    scene::Epoch,
    train::dataset::rendered::{RenderedOptions, rendered},
};

fn epochs(kind: SynthKind, frames: usize, seed: u64) -> Vec<Epoch> {
    let options = SynthOptions { gaussians: 1000, frames, kind, seed, ..Default::default() };
    synth::make(&options, &Limits::default()).unwrap().epochs().to_vec()
}

fn parted(epochs: Vec<Epoch>, options: SplitOptions) -> (Parts, usize) {
    let scene = Scene::new(epochs, 30.0).unwrap();
    let pictures = RenderedOptions { cameras: 4, test_cameras: 1, side: 64, ..Default::default() };
    let dataset = rendered(&scene, "clip", &pictures).unwrap();
    let train = TrainOptions { max_gaussians: 2000, nodes: 16, ..TrainOptions::default() };
    let mut trials = 0;
    let parts = part(&scene, &dataset, &train, options, &mut |_| trials += 1).unwrap();
    (parts, trials)
}

#[test]
fn a_clip_is_parted_where_it_becomes_another() {
    let options = SplitOptions { steps: 240, ..SplitOptions::default() };
    let figure = epochs(SynthKind::Figure, 5, 1);
    let other = epochs(SynthKind::Cloth, 6, 2);
    let (parts, trials) = parted([figure, other].concat(), options);
    assert_eq!(parts.frames, [0..5, 5..11], "{:?}", parts.trials);
    assert_eq!(parts.trials.len(), trials);
    assert_eq!((parts.trials[0].frames.clone(), parts.trials[0].at), (0..11, 5));
    assert!(parts.trials[0].parts_db > parts.trials[0].whole_db + options.gain_db);
}

#[test]
fn what_does_not_change_at_once_is_not_tried_and_what_does_not_gain_is_not_parted() {
    let (parts, trials) = parted(epochs(SynthKind::Figure, 8, 1), SplitOptions::default());
    assert_eq!((parts.frames, trials), (Vec::from([Range { start: 0, end: 8 }]), 0));
    let options = SplitOptions { steps: 60, gain_db: 1e3 };
    let figure = epochs(SynthKind::Figure, 5, 1);
    let (parts, trials) = parted([figure, epochs(SynthKind::Cloth, 6, 2)].concat(), options);
    assert_eq!((parts.frames, trials), (Vec::from([Range { start: 0, end: 11 }]), 1));
}

#[test]
fn parts_show_what_the_clip_shows() {
    let scene = Scene::new(epochs(SynthKind::Figure, 6, 1), 30.0).unwrap();
    let pictures = RenderedOptions { cameras: 3, test_cameras: 1, side: 32, ..Default::default() };
    let dataset = rendered(&scene, "clip", &pictures).unwrap();
    let part = rendered::part(&dataset, &scene, 2..6, 0.5);
    assert_eq!((part.frames, part.train.photographs().len(), part.test.photographs().len()), (4, 12, 4));
    let (whole, of_part) = (&dataset.train.photographs()[6..], part.train.photographs());
    assert!(whole.iter().zip(of_part).all(|(a, b)| a.name == b.name));
    let times: Vec<f32> = of_part.iter().step_by(3).map(|view| view.time).collect();
    assert_eq!(times, [0.0, 1.0 / 3.0, 2.0 / 3.0, 1.0]);
    let single = rendered::part(&dataset, &scene, 5..6, 0.5);
    assert_eq!((single.frames, single.train.photographs()[0].time), (1, 0.0));
}
