//! Tests utilities against stepping one cell at a time and rendering every state alone.

use super::*;
use crate::{
    Stream,
    encode::{self, encode},
    import::{self, synth},
    viewpoint::{Framing, Ring},
};

#[test]
fn the_risk_adjusted_utility_is_the_papers() {
    let options = UtilityOptions::paper(Vec::new());
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
    let stream = encode(&scene, &encode::EncodeOptions::default(), &|_, _| {}).unwrap().stream;
    (scene, stream)
}

fn few(scene: &Scene) -> UtilityOptions {
    let cameras = Framing::of(scene).ring(Ring::Measuring, 2, (48, 36)).unwrap();
    UtilityOptions { contexts: 2, ..UtilityOptions::paper(cameras) }
}

#[test]
fn utilities_are_those_of_states_rendered_alone() {
    let (scene, stream) = moving();
    let (map, received) = (PacketMap::of(&stream).unwrap(), stream.receive().unwrap());
    let (content, options) = (received.content(), few(&scene));
    let spans = spans(&map);
    assert!(spans.iter().any(|s| matches!(s.span, Span::Motion(_))), "there is motion to measure");
    let (mut compared, mut largest, mut shifted) = (0, 0.0f64, 0.0f64);
    for span in [&spans[0], &spans[spans.len() - 1]] {
        let got = deltas_in_view(&scene, &content, &map, span, 1, &options).unwrap();
        let expected = alone::deltas_in_view(&scene, &content, &map, span, 1, &options, 1).unwrap();
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
    let (content, options) = (received.content(), few(&scene));
    let measure = |options: &UtilityOptions| measure(&scene, &content, &map, options, &|_| {}).unwrap();
    let table = measure(&options);
    assert_eq!(table.groups.len(), map.groups().len());
    let means = measure_alone(&scene, &content, &map, &options, 5).unwrap();
    assert!(means.len() > 4);
    for (group, mean) in means {
        assert!((table.groups[group].mean - mean).abs() < 1e-12, "group {group}");
    }
    assert_eq!(table.deltas as usize, map.groups().len() * 2 * 2, "two contexts, two views");
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build().unwrap();
    assert_eq!(pool.install(|| measure(&options)), table);
    let other = measure(&UtilityOptions { seed: 2, ..options.clone() });
    assert_ne!(other.groups, table.groups);
}
