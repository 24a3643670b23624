//! Batches against packets one by one: answers, counters, state and symbols, on the conformance
//! streams, with packets doubled, shuffled, damaged, lost, repaired, early.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use std::path::Path;

use codec_core::{
    Caps, Result,
    internals::{
        receiver::{Accepted, Counters, Receiver},
        wire::{
            checked::Checked,
            crc::crc32,
            file::{self, Record},
            manifest,
        },
    },
    player::Waiting,
};
use codec_simd::{BatchReceiver, Kernel};
use proptest::prelude::*;

const STREAMS: [&str; 8] =
    ["everything", "xor", "cauchy", "cauchy-eight", "harmonics", "blocks-of-one", "tracks", "paper-repaired"];

struct Stream {
    message: Vec<u8>,
    packets: Vec<Vec<u8>>,
}

fn stream(name: &str) -> Stream {
    let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("../tests/conformance");
    let bytes = std::fs::read(folder.join(format!("{name}.dgs"))).unwrap();
    let (message, start) = file::manifest(&bytes).unwrap();
    let packets =
        file::packets(&bytes, start, crc32)
            .filter_map(|record| {
                if let Record::Packet(_, packet) = record { Some(packet.bytes().to_vec()) } else { None }
            })
            .collect();
    Stream { message: message.to_vec(), packets }
}

/// What a receiver made of some packets.
#[derive(Debug, PartialEq)]
struct Received {
    answers: Vec<Result<Accepted>>,
    counters: Counters,
    blocks: Vec<u8>,
    /// Zero where nothing arrived: what a refused packet leaves there does not count.
    symbols: Vec<i16>,
}

/// Gives `packets` to a receiver, the manifest before packet `control`, by `take`.
fn receive(
    stream: &Stream,
    packets: &[Vec<u8>],
    control: usize,
    compact: bool,
    mut take: impl FnMut(&mut Receiver<'_>, &[Vec<u8>], &mut Vec<Result<Accepted>>),
) -> Received {
    let caps = Caps { early_bytes: 3000, ..Caps::HOST };
    let mut arena = vec![0u64; 1 << 16];
    let need = Waiting::new(&mut arena, caps).unwrap().required(&stream.message).unwrap();
    let mut arena = vec![0u64; if compact { need.least_words } else { need.words }];
    let mut answers = Vec::new();
    let mut waiting = Waiting::new(&mut arena, caps).unwrap();
    let (before, after) = packets.split_at(control.min(packets.len()));
    for packet in before {
        // Counted; there is no answer before the manifest.
        let _ = waiting.push(packet);
    }
    let mut player = waiting.manifest(&stream.message).map_err(|(_, error)| error).unwrap();
    take(player.receiver(), after, &mut answers);
    let counters = *player.counters();
    let content = player.content();
    let (manifest, symbols) = (content.manifest, content.symbols);
    let mut counted = vec![0i16; symbols.len()];
    let dgs1 = manifest.profile() == manifest::Profile::Dgs1;
    codec_core::internals::receiver::for_each_cell(manifest, |span, cluster, shape| {
        let cell = content.cell(span, cluster).unwrap();
        for block in 0..if dgs1 { shape.blocks() } else { 1 } {
            let levels = codec_core::internals::ids::Level::ALL.into_iter();
            let arrived = content.arrived(cell, block)?;
            for level in levels.filter(|&l| arrived.has(l)) {
                let (start, len) = shape.range(level, block..block + 1);
                let range = cell.symbols as usize + start..cell.symbols as usize + start + len;
                counted[range.clone()].copy_from_slice(&symbols[range]);
            }
        }
        Ok(())
    })
    .unwrap();
    Received { answers, counters, blocks: content.blocks.to_vec(), symbols: counted }
}

fn one_by_one(receiver: &mut Receiver<'_>, packets: &[Vec<u8>], answers: &mut Vec<Result<Accepted>>) {
    answers.extend(packets.iter().map(|packet| receiver.media(packet)));
}

fn in_batches(kernel: Kernel) -> impl FnMut(&mut Receiver<'_>, &[Vec<u8>], &mut Vec<Result<Accepted>>) {
    let mut batches = BatchReceiver::with_kernel(kernel);
    move |receiver, packets, answers| {
        batches.receive(receiver, packets.iter().map(Vec::as_slice), |answer| answers.push(answer));
    }
}

/// What goes wrong on the way, drawn from `seed`.
fn sent(stream: &Stream, seed: u64, trouble: usize) -> Vec<Vec<u8>> {
    let mut state = seed;
    let mut below = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as usize * n) >> 31
    };
    let mut packets = stream.packets.clone();
    for _ in 0..trouble {
        let (at, other) = (below(packets.len()), below(packets.len()));
        match below(6) {
            0 if packets.len() > 1 => drop(packets.remove(at)),
            1 => packets.insert(other, packets[at].clone()),
            2 => packets.swap(at, other),
            3 => {
                let place = below(packets[at].len().max(1));
                if let Some(byte) = packets[at].get_mut(place) {
                    *byte ^= 1 << below(8);
                }
            }
            // A body that fails, an id or a place that lies, behind a CRC that fits.
            4 if packets[at].len() > 8 => {
                let mut forged = packets[at].clone();
                let end = forged.len() - 4;
                forged[below(end)] ^= 1 << below(8);
                let crc = crc32(&forged[..end]);
                forged[end..].copy_from_slice(&crc.to_le_bytes());
                packets.insert(other, forged);
            }
            _ => {
                let len = below(packets[at].len().max(1));
                packets[at].truncate(len);
            }
        }
    }
    packets
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn batches_are_packets_one_by_one(
        which in 0..STREAMS.len(), seed: u64, trouble in 0usize..30, control in 0usize..12, compact: bool,
    ) {
        let stream = stream(STREAMS[which]);
        let packets = sent(&stream, seed, trouble);
        let wanted = receive(&stream, &packets, control, compact, one_by_one);
        for kernel in Kernel::ALL {
            let found = receive(&stream, &packets, control, compact, in_batches(kernel));
            prop_assert_eq!(&found, &wanted, "{:?}", kernel);
        }
    }
}

/// The comparison sees a packet that one way is spared, and a receiver knows what it did not plan.
#[test]
fn a_difference_is_seen() {
    let stream = stream("everything");
    let wanted = receive(&stream, &stream.packets, 0, false, one_by_one);
    assert!(wanted.counters.media > 3 && wanted.symbols.iter().any(|&s| s != 0));
    let fewer = receive(&stream, &stream.packets[1..], 0, false, in_batches(Kernel::best()));
    assert_ne!(fewer, wanted);
    // Values of another packet's length, or none: the receiver decodes by itself.
    let odd = |receiver: &mut Receiver<'_>, packets: &[Vec<u8>], answers: &mut Vec<Result<Accepted>>| {
        for (i, packet) in packets.iter().enumerate() {
            let packet = Checked::new(packet, crc32).unwrap();
            answers.push(match receiver.plan(packet, |_| ()) {
                Ok(planned) => receiver.commit(&planned, (i % 2 == 0).then_some(&[1, 2, 3])),
                Err(packet) => receiver.push(&packet),
            });
        }
    };
    assert_eq!(receive(&stream, &stream.packets, 0, false, odd), wanted);
}
