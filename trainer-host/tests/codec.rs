//! Promises of encoding and decoding that hold for any scene: the complete state is close to the
//! source, every subset of packets is a valid scene, one packet changes only its own blocks, and
//! equal input gives equal bytes.

#![allow(clippy::unwrap_used, reason = "a test that cannot go on has failed")]

use codec_core::{
    Gaussian,
    internals::{gaussian::ShDegree, wire::manifest::Profile},
};
use trainer_host::{
    Epoch, Scene, Track,
    encode::{EncodeOptions, Encoded, cluster::ClusterOptions, encode},
    import::{
        Limits,
        synth::{self, SynthKind},
    },
    stream::{PacketMap, Player, Stream},
};

fn scene(kind: SynthKind) -> Scene {
    let options = synth::SynthOptions { kind, gaussians: 3000, frames: 40, frames_per_second: 20.0, seed: 7 };
    synth::make(&options, &Limits::default()).unwrap()
}

fn options(profile: Profile) -> EncodeOptions {
    match profile {
        Profile::Dgs1 => EncodeOptions::default(),
        Profile::Paper => EncodeOptions::paper(),
    }
}

fn encoded(scene: &Scene, options: &EncodeOptions) -> Encoded {
    encode(scene, options, &trainer_host::encode::no_progress).unwrap()
}

/// R·S²·Rᵀ: what of rotation and scale can be seen. Different rotations may give the same.
fn covariance(g: &Gaussian) -> nalgebra::Matrix3<f64> {
    let r = trainer_host::factorise::rotation_matrix(g.rotation.map(f64::from));
    r * nalgebra::Matrix3::from_diagonal(&g.scale.map(|s| f64::from(s).powi(2)).into()) * r.transpose()
}

/// Root mean square of (position, display colour, opacity, covariance relative to its size).
fn errors(scene: &Scene, encoded: &Encoded, frame: usize) -> [f64; 4] {
    let stream = &encoded.stream;
    let received = stream.receive().unwrap();
    let mut player = Player::new(&stream.manifest().unwrap());
    let decoded = player.instant(&received.content(), frame as u32).unwrap();
    let (epoch, t) = scene.locate(frame).unwrap();
    let source = scene.epochs()[epoch].instant(t);
    let mut sums = [0.0f64; 4];
    for (d, &s) in decoded.gaussians.iter().zip(&encoded.order[epoch]) {
        let s = &source.gaussians[s as usize];
        for k in 0..3 {
            sums[0] += f64::from(d.position[k] - s.position[k]).powi(2) / 3.0;
            sums[1] += f64::from(0.282 * (d.sh0[k] - s.sh0[k])).powi(2) / 3.0;
        }
        sums[2] += f64::from(d.opacity - s.opacity).powi(2);
        let source = covariance(s);
        sums[3] += ((covariance(d) - source).norm() / source.norm()).powi(2);
    }
    sums.map(|s| (s / decoded.gaussians.len() as f64).sqrt())
}

#[test]
fn the_complete_state_is_close_to_the_source() {
    for kind in SynthKind::ALL {
        let scene = scene(kind);
        // With measured steps what hardly shows may be coarser.
        for (profile, pictures, shape) in
            [(Profile::Dgs1, 0, 0.12), (Profile::Dgs1, 16, 0.15), (Profile::Paper, 0, 0.12)]
        {
            let stream = encoded(&scene, &EncodeOptions { pictures, ..options(profile) });
            let ledger = &stream.report.ledger;
            println!(
                "{} {profile:?}: {:.0} bits/Gaussian, {} packets, manifest {} bytes, saturated {}",
                kind.name(),
                ledger.bits_per_gaussian(),
                ledger.packets,
                ledger.manifest,
                ledger.saturated
            );
            for s in &ledger.shares {
                println!(
                    "   {:16} L{} {:8.1} bits/G",
                    s.attribute,
                    s.level,
                    s.bits / ledger.gaussians as f64
                );
            }
            assert_eq!(ledger.saturated, 0);
            for frame in [0, 17, scene.frames() - 1] {
                let e = errors(&scene, &stream, frame);
                println!("   frame {frame}: {e:.5?}");
                assert!(e[0] < 0.01 && e[1] < 0.01 && e[2] < 0.02 && e[3] < shape, "{e:?}");
            }
        }
    }
}

/// Where no vectors of a basis are left to code motion with, tracks have all of it.
#[test]
fn clusters_of_one_gaussian_move_without_a_basis() {
    let figure = synth::SynthOptions {
        kind: SynthKind::Figure,
        gaussians: 1000,
        frames: 30,
        frames_per_second: 30.0,
        seed: 7,
    };
    let scene = synth::make(&figure, &Limits::default()).unwrap();
    let cluster = ClusterOptions { max_gaussians: 1, ..ClusterOptions::default() };
    let lone = EncodeOptions { cluster, rank: 0, pictures: 0, ..EncodeOptions::default() };
    let stream = encoded(&scene, &lone);
    for frame in [0, 10, 20, 29] {
        let e = errors(&scene, &stream, frame);
        println!("frame {frame}: {e:.5?}");
        assert!(e[0] < 0.01, "frame {frame}: {e:?}");
    }
}

#[test]
fn what_does_not_show_is_not_sent() {
    let made = scene(SynthKind::Balls);
    let mut attributes = made.epochs()[0].attributes().clone();
    let n = made.epochs()[0].count();
    let hidden = |i: usize| i % 10 == 3;
    attributes.opacity_logits = Track::Constant((0..n).map(|i| if hidden(i) { -8.0 } else { 2.0 }).collect());
    // Colour depends on the view on one side only.
    let place = attributes.positions.frame(0, n).to_vec();
    attributes.sh_degree = ShDegree::new(1).unwrap();
    attributes.sh_rest = (0..9 * n)
        .map(|k| if place[k / 9][0] > 0.0 { 0.3 * ((k * 7919 % 101) as f32 / 50.0 - 1.0) } else { 0.001 })
        .collect();
    let epoch = Epoch::new(made.frames(), attributes).unwrap();
    let scene = Scene::new(vec![epoch.clone()], made.frames_per_second()).unwrap();
    let encoding = encoded(&scene, &EncodeOptions::default());
    let stream = &encoding.stream;
    let sent = (0..n).filter(|&i| !hidden(i)).count();
    let order = &encoding.order[0];
    assert_eq!((order.len(), encoding.report.ledger.invisible), (sent, (n - sent) as u64));
    assert!(order.iter().all(|&i| !hidden(i as usize)));
    let manifest = stream.manifest().unwrap();
    let received = stream.receive().unwrap();
    let decoded = Player::new(&manifest).instant(&received.content(), 5).unwrap();
    assert_eq!(decoded.gaussians.len(), sent);
    for (found, &i) in decoded.sh_rest.chunks(9).zip(order) {
        for (a, b) in found.iter().zip(&epoch.attributes().sh_rest[9 * i as usize..]) {
            assert!((a - b).abs() < 0.015, "{a} {b}");
        }
    }
    let zero = decoded.sh_rest.chunks(9).filter(|rest| rest.iter().all(|v| *v == 0.0)).count();
    assert!(zero > sent / 5 && zero < sent, "{zero} of {sent}");
    let all = encoded(&scene, &EncodeOptions { keep_invisible: true, ..EncodeOptions::default() });
    assert_eq!((all.order[0].len(), all.report.ledger.invisible), (n, 0));
    assert!(all.report.ledger.wire() > encoding.report.ledger.wire());
}

#[test]
fn equal_input_gives_equal_bytes() {
    let scene = scene(SynthKind::Figure);
    for profile in [Profile::Dgs1, Profile::Paper] {
        let pool = |threads| rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        let one = pool(1).install(|| encoded(&scene, &options(profile)).stream.to_bytes().unwrap());
        let eight = pool(8).install(|| encoded(&scene, &options(profile)).stream.to_bytes().unwrap());
        assert!(one == eight);
        let (back, damage) = Stream::from_bytes(&one).unwrap();
        assert!(damage.is_none(), "{damage}");
        assert_eq!(back.to_bytes().unwrap(), one);
    }
}

/// A small repeatable generator for picking subsets.
fn coin(seed: u64, i: usize) -> u64 {
    let mut x = seed ^ (i as u64).wrapping_mul(0x9e37_79b9_7f4a_7c15);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    (x ^ (x >> 27)).wrapping_mul(0x94d0_49bb_1331_11eb) >> 33
}

fn is_valid(gaussians: &[Gaussian]) -> bool {
    gaussians.iter().all(|g| {
        let unit = (g.rotation.iter().map(|v| v * v).sum::<f32>() - 1.0).abs() < 1e-4;
        let finite = g.position.iter().chain(&g.scale).chain(&g.sh0).all(|v| v.is_finite());
        unit && finite && (0.0..=1.0).contains(&g.opacity) && g.scale.iter().all(|&s| s > 0.0)
    })
}

#[test]
fn every_subset_is_valid_and_its_state_needs_no_decoding() {
    for kind in [SynthKind::Figure, SynthKind::Births] {
        let scene = scene(kind);
        for profile in [Profile::Dgs1, Profile::Paper] {
            let stream = encoded(&scene, &options(profile)).stream;
            let map = PacketMap::of(&stream).unwrap();
            let received = stream.receive().unwrap();
            println!("{:?}", received.counters());
            assert_eq!(map.state(|_| true), received.content().blocks);
            for seed in 0..20u64 {
                let have = |id: usize| coin(seed, id) % 20 < seed;
                let state = map.state(have);
                let mut player = Player::new(&stream.manifest().unwrap());
                let content = received.content();
                let frame = (seed as u32 * 7) % scene.frames() as u32;
                let instant = player.instant(&content.with_state(&state), frame).unwrap();
                assert!(is_valid(&instant.gaussians));
            }
        }
    }
}

#[test]
fn one_lost_packet_changes_only_its_blocks() {
    let scene = scene(SynthKind::Figure);
    let stream = encoded(&scene, &options(Profile::Dgs1)).stream;
    let manifest = stream.manifest().unwrap();
    let map = PacketMap::of(&stream).unwrap();
    let received = stream.receive().unwrap();
    let content = received.content();
    let mut player = Player::new(&manifest);
    let frame = 23;
    let whole = player.instant(&content, frame).unwrap();
    for lost in 0..stream.packets().len() {
        let state = map.state(|id| id != lost);
        let partial = player.instant(&content.with_state(&state), frame).unwrap();
        let mut own = vec![false; whole.gaussians.len()];
        let mut first = 0;
        let epoch = codec_core::internals::ids::EpochId(0);
        for c in 0..manifest.epoch(epoch).unwrap().clusters {
            let cluster = codec_core::internals::ids::ClusterId(c as u16);
            let count = usize::from(manifest.cluster(epoch, cluster).unwrap().gaussians);
            for mark in map.placements(lost).iter().filter(|m| m.group.cluster == cluster) {
                let cell = content.cell(mark.group.span, cluster).unwrap();
                let block = mark.first_block - cell.blocks as usize;
                let block_len = manifest.block_len().get() as usize;
                let from = block * block_len;
                let to = (from + mark.blocks * block_len).min(count);
                own[first + from..first + to].fill(true);
            }
            first += count;
        }
        for (i, (a, b)) in whole.gaussians.iter().zip(&partial.gaussians).enumerate() {
            assert!(own[i] || a == b, "packet {lost} changed Gaussian {i}, which is not in its blocks");
        }
    }
}
