//! States per second of the counterfactual engine against rendering every state alone, with the errors
//! beside the speeds, in one interleaved run; medians.
//!
//! `cargo run --release -p render-host --example counterfactual -- [ROUNDS [GAUSSIANS [WORLDS]]]`
//!
//! Scene A is a uniform volume cut into 64 cells, the worst case for interleaved depths; scene B is 64
//! overlapping ellipsoid shells. Every cluster has two additive levels; a state lacks one cluster in ten
//! and has a random level of the others. Engine times include its set-up (project, sort, bin).

#![expect(clippy::unwrap_used, clippy::disallowed_methods, reason = "a bench measures time and may fail")]

#[allow(dead_code, reason = "tests use the rest")]
#[path = "../tests/support/mod.rs"]
pub mod support;

use codec_core::Gaussian;
use render_host::counterfactual::{Engine, Lattice, States, Variants, brute};
use render_host::{Camera, Image, Renderer, Settings, Splats, reference};
use std::hint::black_box;
use std::time::Instant;
use support::{Numbers, camera};

const LATTICE: Lattice = Lattice { clusters: 64, levels: 2 };
/// Worlds that brute force renders per round; its time is scaled to all.
const BRUTE_WORLDS: usize = 16;

/// Roughly normal, variance 1.
fn normal(r: &mut Numbers) -> f32 {
    (0..12).map(|_| r.unit()).sum::<f32>() - 6.0
}

pub fn scene(kind: char, n: usize) -> (Vec<Gaussian>, Vec<u32>) {
    let mut r = Numbers(7);
    let shells: Vec<[[f32; 3]; 3]> = (0..LATTICE.clusters)
        .map(|_| [[-0.9, 0.9], [0.08, 0.3], [0.0, 1.0]].map(|[a, b]| [0; 3].map(|_| r.between(a, b))))
        .collect();
    let mut one = |i: usize| {
        let grow = |size: f32, r: &mut Numbers| size * (0.4 * normal(r)).exp();
        let (position, scale, colour, cluster, bias) = if kind == 'A' {
            let position = [0; 3].map(|_| r.between(-1.0, 1.0));
            let cell = |p: f32| (((p + 1.0) * 2.0) as usize).min(3);
            let cluster = cell(position[0]) + 4 * cell(position[1]) + 16 * cell(position[2]);
            (position, [0; 3].map(|_| grow(0.012, &mut r)), [0; 3].map(|_| r.unit()), cluster, 0.0)
        } else {
            let [centre, radii, base] = shells[i % LATTICE.clusters];
            let d = [0; 3].map(|_| normal(&mut r));
            let length = d.iter().map(|v| v * v).sum::<f32>().sqrt();
            let position = std::array::from_fn(|k| centre[k] + radii[k] * d[k] / length);
            let scale = [grow(0.013, &mut r), grow(0.013, &mut r), 0.25 * 0.013];
            let colour = base.map(|c| (c + 0.2 * normal(&mut r)).clamp(0.0, 1.0));
            (position, scale, colour, i % LATTICE.clusters, 1.0)
        };
        let q = [0; 4].map(|_| normal(&mut r));
        let length = q.iter().map(|v| v * v).sum::<f32>().sqrt();
        let opacity = 1.0 / (1.0 + (-(bias + 1.5 * normal(&mut r))).exp());
        let sh0 = colour.map(|c| (c - 0.5) / 0.282_094_8);
        let level = usize::from(r.unit() < 0.5);
        let gaussian = Gaussian { position, scale, rotation: q.map(|v| v / length), opacity, sh0 };
        (gaussian, LATTICE.group(cluster, level) as u32)
    };
    (0..n).map(&mut one).unzip()
}

pub fn deliveries(worlds: usize) -> States {
    let mut r = Numbers(99);
    let mut states = States::new(LATTICE.groups());
    for _ in 0..worlds {
        let depth: Vec<usize> = (0..LATTICE.clusters)
            .map(|_| if r.unit() < 0.1 { 0 } else { 1 + usize::from(r.unit() < 0.5) })
            .collect();
        LATTICE.push_additive(&mut states, |cluster, level| level < depth[cluster]);
    }
    states
}

/// Sum of squared errors by the f64 reference renderer without early stop.
fn truth(variants: &Variants, states: &States, world: usize, camera: &Camera, against: &Image) -> f64 {
    let settings = Settings { early_stop: false, ..Settings::default() };
    let (gaussians, _) = brute::world(variants, states, world);
    let got = reference::render(&Splats::plain(&gaussians), camera, &settings).unwrap();
    got.rgb.iter().zip(against.rgb()).map(|(a, &b)| (a - f64::from(b)).powi(2)).sum()
}

fn ms(times: &mut Vec<f64>, work: impl FnOnce()) {
    let start = Instant::now();
    work();
    times.push(start.elapsed().as_secs_f64() * 1e3);
}

fn median(mut times: Vec<f64>) -> f64 {
    times.sort_by(f64::total_cmp);
    times[times.len() / 2]
}

fn relative(got: f64, expected: f64) -> f64 {
    (got / expected - 1.0).abs()
}

fn main() {
    let arguments: Vec<usize> = std::env::args().skip(1).filter_map(|a| a.parse().ok()).collect();
    let argument = |i: usize, default: usize| arguments.get(i).copied().unwrap_or(default);
    let (rounds, n, worlds) = (argument(0, 7), argument(1, 84_000), argument(2, 128));
    let settings = Settings::default();
    println!("{n} Gaussians, {} groups, W = {worlds}, {rounds} rounds", LATTICE.groups());
    for (kind, side) in [('A', 400), ('B', 400), ('A', 800), ('B', 800)] {
        let (gaussians, groups) = scene(kind, n);
        let camera = camera(side, side);
        let splats = Splats::plain(&gaussians);
        let variants = Variants::new(splats, &groups, LATTICE.groups()).unwrap();
        let full = States::full(LATTICE.groups());
        let picture = brute::image(&variants, &full, 0, &camera, &settings).unwrap();
        let noisy = |(i, v): (usize, &f32)| v * 0.97 + 0.01 * ((i * 7919 % 101) as f32 / 101.0);
        let rgb = picture.rgb().iter().enumerate().map(noisy).collect();
        let against = Image::new(side, side, rgb).unwrap();
        let states = deliveries(worlds);
        let mut few = States::new(LATTICE.groups());
        let step = worlds.div_ceil(BRUTE_WORLDS);
        (0..worlds).step_by(step).for_each(|w| few.push(|g| states.has(w, g)));

        let engine = || Engine::new(&variants, &camera, &against, &settings).unwrap();
        let [mut single, mut alone, mut setup, mut fast, mut strict, mut loo] = [(); 6].map(|()| vec![]);
        let [mut pairs, mut prefixes] = [(); 2].map(|()| vec![]);
        let some: Vec<u32> = (0..LATTICE.groups() as u32).step_by(4).collect();
        let order: Vec<u32> = (0..LATTICE.groups() as u32).map(|i| i * 37 % 128).collect();
        let empty = States::empty(LATTICE.groups());
        let mut renderer = Renderer::new();
        let (mut brute_sse, mut fast_sse, mut strict_sse, mut utilities) = (vec![], vec![], vec![], None);
        for _ in 0..rounds {
            ms(&mut single, || drop(black_box(renderer.render(&splats, &camera, &settings))));
            ms(&mut fast, || fast_sse = engine().fast(&states).unwrap());
            ms(&mut loo, || utilities = engine().utilities(&full).ok());
            ms(&mut alone, || {
                brute_sse = brute::sse(&variants, &few, &camera, &against, &settings).unwrap();
            });
            ms(&mut setup, || drop(black_box(engine())));
            ms(&mut strict, || strict_sse = engine().strict(&states).unwrap());
            ms(&mut pairs, || drop(black_box(engine().pairs(&full, 0, &some))));
            ms(&mut prefixes, || drop(black_box(engine().prefixes(&empty, 0, &order))));
        }
        let utilities = utilities.unwrap();
        let engine = engine();
        let (mut greedy, mut tiles) = (vec![], 0);
        let costs = vec![1.0; LATTICE.groups()];
        ms(&mut greedy, || tiles = engine.greedy(&empty, 0, &costs).unwrap().tiles);

        let per_world = median(alone) / few.len() as f64;
        let [single, setup, fast, strict, loo] = [single, setup, fast, strict, loo].map(median);
        let [pairs, prefixes] = [pairs, prefixes].map(median);
        let rate = |time: f64| worlds as f64 / time * 1e3;
        let ratio = |time: f64| per_world * worlds as f64 / time;
        println!("scene {kind}, {side} x {side}: single render {single:.1} ms, engine set-up {setup:.1} ms");
        println!("  brute   {:7.1} states/s", 1e3 / per_world);
        println!("  fast    {:7.1} states/s = {:5.1}x brute ({fast:.1} ms)", rate(fast), ratio(fast));
        println!("  strict  {:7.1} states/s = {:5.1}x brute ({strict:.1} ms)", rate(strict), ratio(strict));
        println!("  leave-one-out of all groups {loo:.1} ms = {:.2} single renders", loo / single);
        println!(
            "  {} pairs {pairs:.1} ms, {} prefixes {prefixes:.1} ms",
            some.len() * (some.len() - 1) / 2,
            order.len()
        );
        println!(
            "  greedy order of all groups {:.0} ms, {:.1} looks per tile",
            greedy[0],
            tiles as f64 / f64::from(side.div_ceil(16).pow(2))
        );

        let same = (0..few.len()).filter(|&w| brute_sse[w].to_bits() == strict_sse[w * step].to_bits());
        println!("  error: strict equals brute in every bit for {} of {} worlds", same.count(), few.len());
        let (mut of_fast, mut of_brute) = (0.0f64, 0.0f64);
        for world in [0, few.len() - 1] {
            let exact = truth(&variants, &few, world, &camera, &against);
            of_fast = of_fast.max(relative(fast_sse[world * step], exact));
            of_brute = of_brute.max(relative(brute_sse[world], exact));
        }
        println!(
            "  error of SSE against f64 without early stop: fast {of_fast:.1e}, brute {of_brute:.1e} relative"
        );
        let nostop = Settings { early_stop: false, ..settings.clone() };
        let (mut without, mut worst) = (States::full(LATTICE.groups()), 0.0f64);
        let largest = utilities.delta.iter().fold(0.0f64, |m, d| m.max(d.abs()));
        (0..8).for_each(|k| without.push(|g| g != k * 16));
        let alone = brute::sse(&variants, &without, &camera, &against, &nostop).unwrap();
        (0..8).for_each(|k| worst = worst.max((alone[k + 1] - alone[0] - utilities.of(0, k * 16)).abs()));
        println!(
            "  error of leave-one-out against brute force without early stop: {:.1e} of the largest",
            worst / largest
        );
    }
}
