//! Tests utilities against stepping one cell at a time and rendering every state alone.

use codec_core::internals::{
    closure::Arrived,
    ids::{Group, WindowId},
};
use render_host::{Camera, Renderer, Splats, adjoint::loss::photograph::Photograph};

use super::*;
use crate::{
    Scene, Stream,
    encode::{self, encode},
    import::{self, synth},
    stream::Player,
    train::{PixelMask, PosedPhotograph, Training, Views},
    viewpoint::{Framing, Ring},
};

#[test]
fn the_risk_adjusted_utility_is_the_papers() {
    let options = UtilityOptions::paper();
    let mut samples = vec![4.0, 0.0, 1.0, 2.0, 3.0];
    let u = summarise(7, Level::BASE, &mut samples, &options);
    let deviation = 2f64.sqrt();
    assert_eq!((u.mean, u.tail), (2.0, 0.4));
    assert!((u.utility - (0.75 * 2.0 + 0.25 * 0.4) / (1.0 + 0.05 * deviation)).abs() < 1e-12);
}

#[test]
fn quantiles_interpolate() {
    assert_eq!(quantile(&[1.0, 2.0, 3.0], 0.5), 2.0);
    assert_eq!(quantile(&[0.0, 10.0], 0.1), 1.0);
    assert_eq!(quantile(&[], 0.1), 0.0);
}

/// A moving figure of two windows, and its stream.
fn moving() -> (Scene, Stream) {
    let options = synth::SynthOptions { gaussians: 1000, frames: 40, ..synth::SynthOptions::default() };
    let scene = synth::make(&options, &import::Limits::default()).unwrap();
    let stream =
        encode(&scene, &encode::EncodeOptions::default(), &crate::encode::no_progress).unwrap().stream;
    (scene, stream)
}

fn few() -> UtilityOptions {
    UtilityOptions { contexts: 2, ..UtilityOptions::paper() }
}

fn job(span: &SpanCells) -> Job<'_> {
    Job { span, quantity: Quantity::Utility, view: 1, views: 2 }
}

fn two_cameras(scene: &Scene) -> Vec<Camera> {
    Framing::of(scene).ring(Ring::Validation, 2, (48, 36)).unwrap()
}

#[test]
fn utilities_are_those_of_states_rendered_alone() {
    let (scene, stream) = moving();
    let (map, received) = (PacketMap::of(&stream).unwrap(), stream.receive().unwrap());
    let (content, options) = (received.content(), few());
    let cameras = two_cameras(&scene);
    let references = References::renders(&scene, &cameras, &cameras);
    let spans = spans(&map);
    assert!(spans.iter().any(|s| matches!(s.span, Span::Motion(_))), "there is motion to measure");
    let (mut compared, mut largest, mut shifted) = (0, 0.0f64, 0.0f64);
    for span in [&spans[0], &spans[spans.len() - 1]] {
        let (epoch, view) = job(span).seen(&references, &content, &options).unwrap();
        let got = deltas_in_view(&content, &map, &job(span), (epoch, &view), &options).unwrap();
        let expected = alone::deltas_in_view(&references, &content, &map, span, 1, &options, 1).unwrap();
        assert_eq!(got.len(), expected.len());
        for (got, expected) in got.iter().zip(&expected) {
            assert_eq!((got.group, got.context), (expected.group, expected.context));
            assert!((got.delta - expected.delta).abs() < 1e-12, "{} {}", got.delta, expected.delta);
            largest = largest.max(expected.delta.abs());
            compared += 1;
        }
        // A group's Δ is not its neighbour's.
        let pairs = got.iter().zip(&expected[1..]);
        shifted = pairs.map(|(a, b)| (a.delta - b.delta).abs()).fold(shifted, f64::max);
    }
    assert!(compared > 20 && largest > 1e-4 && shifted > 1e-6, "{compared} {largest} {shifted}");
}

#[test]
fn one_table_on_any_number_of_threads_and_another_for_other_contexts() {
    let (scene, stream) = moving();
    let (map, received) = (PacketMap::of(&stream).unwrap(), stream.receive().unwrap());
    let (content, options) = (received.content(), few());
    let cameras = two_cameras(&scene);
    let references = References::renders(&scene, &cameras, &cameras);
    let measure = |options: &UtilityOptions| measure(&references, &content, &map, options, &|_| {}).unwrap();
    let table = measure(&options);
    assert_eq!(table.groups.len(), map.groups().len());
    let means = measure_alone(&references, &content, &map, &options, 5).unwrap();
    assert!(means.len() > 4);
    for (group, mean) in means {
        assert!((table.groups[group].mean - mean).abs() < 1e-12, "group {group}");
    }
    assert_eq!(table.deltas as usize, map.groups().len() * (2 * 2 + 2), "two contexts and a gain, two views");
    // The gain is the mean over views in the complete state.
    let complete = UtilityOptions { complete: true, ..few() };
    for (group, mean) in measure_alone(&references, &content, &map, &complete, 5).unwrap() {
        assert!((table.groups[group].gain - mean).abs() < 1e-12, "gain of group {group}");
    }
    assert!(table.groups.iter().any(|group| (group.gain - group.mean).abs() > 1e-6), "gain is not the mean");
    assert!(measure(&complete).groups.iter().all(|group| group.gain == group.mean));
    let gains = |table: &Table| table.groups.iter().map(|group| group.gain.to_bits()).collect::<Vec<_>>();
    assert_eq!(gains(&measure(&complete)), gains(&table), "alone, and beside states");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| measure(&options)), table);
    let other = measure(&UtilityOptions { seed: 2, ..options.clone() });
    assert_ne!(other.groups, table.groups);
}

/// What bases add at once, from states that are put together block by block and rendered alone.
#[test]
fn what_bases_add_at_once_is_that_of_states_rendered_alone() {
    let (scene, stream) = moving();
    let (map, received) = (PacketMap::of(&stream).unwrap(), stream.receive().unwrap());
    let (content, options) = (received.content(), UtilityOptions { contexts: 1, ..few() });
    let cameras = two_cameras(&scene);
    let references = References::renders(&scene, &cameras, &cameras);
    let table = measure(&references, &content, &map, &options, &|_| {}).unwrap();
    let (mut player, mut renderer) = (Player::new(content.manifest), Renderer::new());
    for span in [Span::Canonical(EpochId(0)), Span::Motion(WindowId(1))] {
        let bases = || {
            let groups = map.groups().iter().enumerate().map(|(at, (group, _))| (at, *group));
            groups.filter(|(_, group)| group.span == span && group.level == Level::BASE)
        };
        let blocks = |group: Group| versions::blocks_of(&content, span, group.cluster).unwrap();
        let without = |with: &[Group]| {
            let mut state = content.blocks.to_vec();
            for (_, group) in bases() {
                state[blocks(group)].copy_from_slice(&map.initial()[blocks(group)]);
            }
            for group in with {
                state[blocks(*group)].iter_mut().for_each(|b| *b = Arrived(*b).with(Level::BASE).0);
            }
            state
        };
        let all: Vec<Group> = bases().map(|(_, group)| group).collect();
        let mut mean = |state: &[u8]| {
            let distances = (0..2).map(|index| {
                let seen = references.view(&content, span, Quantity::Gain, index, 1, &options.settings);
                let (_, view) = seen.unwrap();
                view.distance(&content, state, &options.settings, &mut player, &mut renderer).unwrap()
            });
            distances.sum::<f64>() / 2.0
        };
        let at_once = mean(&without(&[])) - mean(&without(&all));
        let measured = || bases().map(|(at, _)| &table.groups[at]);
        assert!(measured().all(|base| (base.together.unwrap() - at_once).abs() < 1e-12), "{span:?}");
        let sum: f64 = measured().map(|base| base.gain).sum();
        assert!(all.len() > 2 && (sum - at_once).abs() > 1e-4, "it is not their sum: {sum} {at_once}");
    }
    let upper = table.groups.iter().filter(|group| group.level > 0);
    assert!(upper.clone().count() > 4);
    assert!(upper.clone().all(|group| group.together.is_none()));
}

/// 8-bit photographs of `scene` at some frames, from every camera in turn, twice as large as the cameras.
fn photographs(scene: &Scene, cameras: &[Camera], frames: &[u32]) -> Views<Training> {
    let taken = frames.iter().enumerate().map(|(index, &frame)| {
        let camera = cameras[index % cameras.len()].resized(96, 72).unwrap();
        let instant = scene.instant(frame as usize).unwrap();
        let splats = Splats::new(&instant.gaussians, &instant.sh_rest, instant.sh_degree).unwrap();
        let image = Renderer::new().render(&splats, &camera, &Settings::default()).unwrap().image;
        let bytes = image.rgb().as_chunks::<3>().0.iter().flat_map(|&[r, g, b]| {
            [r, g, b, 1.0].map(|value: f32| (255.0 * value).clamp(0.0, 255.0).round() as u8)
        });
        let photograph = Photograph::new(96, 72, bytes.collect()).unwrap();
        let time = frame as f32 / (scene.frames() - 1) as f32;
        PosedPhotograph {
            name: format!("frame {frame}"),
            camera,
            time,
            photograph,
            foreground: None,
            counted: None,
        }
    });
    Views::new(taken.collect()).unwrap()
}

#[test]
fn utilities_against_photographs_are_those_against_the_renders_that_they_show() {
    let (scene, stream) = moving();
    let (map, received) = (PacketMap::of(&stream).unwrap(), stream.receive().unwrap());
    let (content, options) = (received.content(), few());
    let cameras = two_cameras(&scene);
    let frames: Vec<u32> = (0..40).step_by(5).collect();
    let taken = ReferencePhotographs::new(&photographs(&scene, &cameras, &frames), [0.0; 3], 48, 2).unwrap();
    assert_eq!(taken.photographs()[0].image.size(), (48, 36), "reduced");
    let references = References::Photographs(&taken);
    let table = measure(&references, &content, &map, &options, &|_| {}).unwrap();
    assert!(table.protocol.contains("8 photographs at 48x36, up to 2 per span"), "{}", table.protocol);
    // The twin renders every state alone.
    let alone = measure_alone(&references, &content, &map, &options, 5).unwrap();
    assert!(alone.len() > 4);
    for (group, mean) in alone {
        assert!((table.groups[group].mean - mean).abs() < 1e-12, "group {group}");
    }
    // What no window around a pixel that counts reaches may be anything.
    let masked = |clutter: u8| {
        let view = |view: &PosedPhotograph| {
            let (width, height) = (view.photograph.width(), view.photograph.height());
            let is_left = |at: usize| at as u32 % width < 40;
            let cluttered = |(at, pixel): (usize, &[u8])| {
                if at as u32 % width < 16 {
                    [clutter, 0, 0, 255]
                } else {
                    [pixel[0], pixel[1], pixel[2], pixel[3]]
                }
            };
            let rgba = view.photograph.rgba().chunks_exact(4).enumerate().flat_map(cluttered).collect();
            let values = (0..(width * height) as usize).map(|at| u8::from(!is_left(at))).collect();
            let photograph = Photograph::new(width, height, rgba).unwrap();
            PosedPhotograph { photograph, counted: PixelMask::new(width, height, values), ..view.clone() }
        };
        let views = photographs(&scene, &cameras, &frames).photographs().iter().map(view).collect();
        ReferencePhotographs::new(&Views::<Training>::new(views).unwrap(), [0.0; 3], 48, 2).unwrap()
    };
    let (dark, bright) = (masked(0), masked(255));
    let of = |photographs| measure(&References::Photographs(photographs), &content, &map, &options, &|_| {});
    let masked = of(&dark).unwrap();
    assert!(masked.protocol.contains("8 photographs at 48x36, 8 of them masked"), "{}", masked.protocol);
    assert!(masked.groups != table.groups && masked.groups == of(&bright).unwrap().groups);
    for (group, mean) in
        measure_alone(&References::Photographs(&bright), &content, &map, &options, 5).unwrap()
    {
        assert!((masked.groups[group].mean - mean).abs() < 1e-12, "group {group}");
    }
    // Frames shown are those that the photographs were taken of: a reference is its render, but for 8 bits.
    let span = Span::Motion(codec_core::internals::ids::WindowId(0));
    for index in 0..2 {
        let (_, view) =
            references.view(&content, span, Quantity::Utility, index, 1, &options.settings).unwrap();
        let source = scene.instant(view.frame as usize).unwrap();
        let splats = Splats::new(&source.gaussians, &source.sh_rest, source.sh_degree).unwrap();
        let large = view.camera.resized(96, 72).unwrap();
        let expected = Renderer::new().render(&splats, &large, &options.settings).unwrap().image;
        let expected = expected.resized_box(48, 36).unwrap();
        let worst = view.reference.rgb().iter().zip(expected.rgb()).map(|(a, b)| (a - b).abs());
        assert!(worst.fold(0.0, f32::max) < 0.003);
    }
    // Photographs of other instants are another matter.
    let shifted = photographs(&scene, &cameras, &frames);
    let shifted: Vec<PosedPhotograph> = shifted
        .photographs()
        .iter()
        .map(|view| PosedPhotograph { time: 1.0 - view.time, ..view.clone() })
        .collect();
    let shifted = Views::<Training>::new(shifted).unwrap();
    let shifted = ReferencePhotographs::new(&shifted, [0.0; 3], 48, 2).unwrap();
    let other = measure(&References::Photographs(&shifted), &content, &map, &options, &|_| {}).unwrap();
    let sum = |table: &Table| table.groups.iter().map(|group| group.mean).sum::<f64>();
    assert!(sum(&other) < sum(&table), "{} {}", sum(&other), sum(&table));
}

#[test]
fn a_window_that_no_photograph_shows_is_named() {
    let (scene, stream) = moving();
    let (map, received) = (PacketMap::of(&stream).unwrap(), stream.receive().unwrap());
    let (content, cameras) = (received.content(), two_cameras(&scene));
    let taken = ReferencePhotographs::new(&photographs(&scene, &cameras, &[0, 1]), [0.0; 3], 48, 2).unwrap();
    let refused = measure(&References::Photographs(&taken), &content, &map, &few(), &|_| {}).unwrap_err();
    let text = refused.to_string();
    assert!(text.starts_with("no photograph shows frames "), "{text}");
    let none = ReferencePhotographs::new(&Views::<Training>::new(Vec::new()).unwrap(), [0.0; 3], 48, 2);
    assert!(matches!(none, Err(UtilityError::NoCamera)));
    let none = References::renders(&scene, &[], &[]);
    assert!(matches!(measure(&none, &content, &map, &few(), &|_| {}), Err(UtilityError::NoCamera)));
}
