//! Promises across bytes and time: the real receiver and the naive graph receiver agree on every
//! snapshot; a session repeats bit for bit; what the report says was shown can be rendered.

#![allow(clippy::unwrap_used, clippy::panic, reason = "a test that cannot go on has failed")]

use codec_core::internals::limits::MAX_PACKET_BYTES;
use dgs::{
    args::{Cli, TransportName, Verb},
    delivery::WireEndpoint,
    pipeline::{self, Link, Quiet},
};
use emulator_host::{Endpoint, GraphReceiver, Nanos, PacketGraph, PacketIndex, PolicyKind};
use trainer_host::{Stream, encode::Protection, stream::PacketMap};

/// What the demo would use for these flags.
fn typed(flags: &[&str]) -> dgs::args::Demo {
    let all = ["dgs", "demo"].into_iter().chain(flags.iter().copied());
    match clap::Parser::try_parse_from(all).map(|c: Cli| c.verb) {
        Ok(Verb::Demo(demo)) => demo,
        other => panic!("{other:?}"),
    }
}

fn walk(flags: &[&str]) -> (Stream, PacketMap, PacketGraph, Link) {
    let args = typed(flags);
    let scene = pipeline::import("synth:births:2000:40", &args.source).unwrap().scene;
    let stream =
        pipeline::encode(&scene, &pipeline::encode_options(&args.codec, Protection::STANDARD), Quiet(true))
            .unwrap()
            .stream;
    let map = PacketMap::of(&stream).unwrap();
    let graph = pipeline::graph(&stream, &map, None).unwrap();
    let link = pipeline::link(&args.link, &graph).unwrap();
    (stream, map, graph, link)
}

/// A repeatable draw below `n` for step `i`.
fn draw(seed: u64, i: u64, n: usize) -> usize {
    let mut x = seed.wrapping_mul(0x9e37_79b9_7f4a_7c15) ^ i.wrapping_mul(0xd134_2543_de82_ef95);
    x = (x ^ (x >> 30)).wrapping_mul(0xbf58_476d_1ce4_e5b9);
    ((x ^ (x >> 31)) % n as u64) as usize
}

#[test]
fn the_real_receiver_agrees_with_the_naive_one() {
    for profile in ["dgs1", "paper"] {
        let (stream, map, graph, _) = walk(&["--profile", profile]);
        for seed in 0..4u64 {
            let packets = stream.packets().len();
            let early_bytes = packets * (MAX_PACKET_BYTES + 2);
            let mut real = WireEndpoint::new(early_bytes, &stream, &map, &graph).unwrap();
            let mut naive = GraphReceiver::new(&graph, usize::MAX);
            let control_at = draw(seed, 1 << 40, packets) as u64;
            for step in 0..packets as u64 * 2 {
                if step == control_at {
                    let (mut a, mut b) = (Vec::new(), Vec::new());
                    real.control(1, true, &mut a);
                    naive.control(1, true, &mut b);
                }
                // Random order with repeats; about one in eight never arrives.
                let packet = PacketIndex(draw(seed, step, packets) as u32);
                let (mut a, mut b) = (Vec::new(), Vec::new());
                let one = real.media(packet, Nanos(step), &mut a);
                let two = naive.media(packet, Nanos(step), &mut b);
                assert_eq!(one, two, "{profile}: packet {packet:?} at step {step}");
                a.sort_unstable();
                b.sort_unstable();
                assert_eq!(a, b, "{profile}: recovered at step {step}");
                if step % 37 == 0 || step + 1 == packets as u64 * 2 {
                    let (real, naive) = (real.snapshot(0).clone(), naive.snapshot(0));
                    assert_eq!(real.groups, naive.groups, "{profile}: groups at step {step}");
                    // A packet carries slices of several clusters. The graph follows needs packet by
                    // packet, the receiver slice by slice, so it may show a packet sooner, never later.
                    let later = real.packets.iter().zip(&naive.packets).any(|(r, n)| n & !r != 0);
                    assert!(!later, "{profile}: packets at step {step}");
                    if profile == "paper" {
                        assert_eq!(real.packets, naive.packets);
                    }
                }
            }
        }
    }
}

#[test]
fn the_comparison_above_can_fail() {
    let (stream, map, graph, _) = walk(&[]);
    let mut real = WireEndpoint::new(0, &stream, &map, &graph).unwrap();
    let mut naive = GraphReceiver::new(&graph, usize::MAX);
    real.control(1, true, &mut Vec::new());
    naive.control(1, true, &mut Vec::new());
    real.media(PacketIndex(0), Nanos(0), &mut Vec::new());
    assert_ne!(real.snapshot(0), naive.snapshot(0));
}

#[test]
fn a_session_repeats_bit_for_bit_and_every_shown_state_is_renderable() {
    let (stream, map, graph, link) = walk(&["--burst-loss", "0.05"]);
    let manifest = stream.manifest().unwrap();
    let received = stream.receive().unwrap();
    let runs = [
        (PolicyKind::Layered, TransportName::Model),
        (PolicyKind::DeadlineUtility, TransportName::Model),
        (PolicyKind::DeadlineUtility, TransportName::Quic),
    ];
    for (policy, transport) in runs {
        let run = || pipeline::deliver(&stream, &map, &graph, &link.config, policy, transport).unwrap();
        let ((one, shown), (two, _)) = (run(), run());
        assert_eq!(one.digest, two.digest);
        assert_eq!(one, two);
        let mut player = trainer_host::stream::Player::new(&manifest);
        for state in &shown {
            let content = received.content();
            let instant = player.instant(&content.with_state(&state.state), state.frame).unwrap();
            assert!(instant.gaussians.iter().all(|g| g.position.iter().all(|v| v.is_finite())));
        }
        assert_eq!(shown.len(), manifest.head().frames as usize);
    }
}
