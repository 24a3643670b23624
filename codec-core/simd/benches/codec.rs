//! Packet coder, CRC, and, of the `.dgs` file that the variable `DGS_STREAM` names, packet parse and
//! the whole receiver. `dgs bench entropy` and `dgs bench decode` measure the same beside peers.

#![allow(clippy::unwrap_used, reason = "a bench stops where it fails")]

use codec_core::{
    Caps,
    internals::{
        rans::{
            lanes::{self, Compact, Decoder, Symbols, TableRun, naive},
            table::{SLOTS, Table},
        },
        wire::{
            crc::crc32,
            file::{self, Record},
            manifest,
            packet::{Head, Packet},
        },
    },
    player::Waiting,
};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};

/// Packets in turn: one packet over and over would teach the branch predictor its content.
const PACKETS: usize = 256;
const VALUES: usize = 1500;

fn entropy(criterion: &mut Criterion) {
    let mut counts = [0u64; 256];
    for (token, count) in (1u8..=255).zip(&mut counts[1..]) {
        *count = (1e9 * (-f64::from((i16::from(token) - 128).abs()) / 3.5).exp()) as u64;
    }
    counts[0] = 1000;
    for raw_bits in [0u8, 2] {
        let table = Table::from_counts(&counts, raw_bits).unwrap();
        let mut slots = Box::new([0u32; SLOTS]);
        table.fill_slots(&mut slots);
        let (mut token, mut range) = (Box::new([0u8; SLOTS]), Box::new([0u32; 256]));
        let compact = Compact::fill(&table, &mut token, &mut range);
        let symbols = [Symbols::new(&table)];
        let run = [TableRun { table: 0, len: VALUES }];
        let mut state = 1u64;
        let packets: Vec<(Vec<i16>, Vec<u8>)> = (0..PACKETS)
            .map(|_| {
                let values: Vec<i16> = (0..VALUES)
                    .map(|_| {
                        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1);
                        let slot = slots[(state >> 53) as usize & (SLOTS - 1)] as u8;
                        ((i16::from(slot) - 128) << raw_bits) | (state >> 20) as i16 & ((1 << raw_bits) - 1)
                    })
                    .collect();
                let mut body = vec![0u8; 4 * VALUES];
                let len = lanes::encode(&values, &run, &symbols, &mut body).unwrap().len;
                body.truncate(len);
                (values, body)
            })
            .collect();
        let mut group = criterion.benchmark_group(format!("lanes, {raw_bits} raw bits"));
        group.throughput(Throughput::Elements((PACKETS * VALUES) as u64));
        let raw = VALUES * usize::from(raw_bits);
        let mut out = vec![0i16; VALUES];
        group.bench_function("decode, slots", |b| {
            b.iter(|| {
                for (_, body) in &packets {
                    let mut decoder = Decoder::new(body, VALUES, raw).unwrap();
                    decoder.run(&*slots, raw_bits, &mut out).unwrap();
                    decoder.finish().unwrap();
                }
            });
        });
        group.bench_function("decode, compact", |b| {
            b.iter(|| {
                for (_, body) in &packets {
                    let mut decoder = Decoder::new(body, VALUES, raw).unwrap();
                    decoder.run(&compact, raw_bits, &mut out).unwrap();
                    decoder.finish().unwrap();
                }
            });
        });
        let (tables, table_of) = ([table], vec![0u8; VALUES]);
        group.sample_size(10).bench_function("decode, naive", |b| {
            b.iter(|| {
                packets
                    .iter()
                    .for_each(|(_, body)| naive::decode(body, &table_of, &tables, &mut out).unwrap())
            });
        });
        let mut room = vec![0u8; 4 * VALUES];
        group.bench_function("encode", |b| {
            b.iter(|| {
                for (values, _) in &packets {
                    lanes::encode(values, &run, &symbols, &mut room).unwrap();
                }
            });
        });
        group.finish();
    }
}

fn crc(criterion: &mut Criterion) {
    let bytes: Vec<u8> = (0..1200u32).map(|i| (i.wrapping_mul(2_654_435_761) >> 13) as u8).collect();
    let mut group = criterion.benchmark_group("crc");
    for len in [30, 1200] {
        group.throughput(Throughput::Bytes(len as u64));
        group.bench_function(format!("{len} bytes"), |b| b.iter(|| crc32(&bytes[..len])));
    }
    group.finish();
}

fn receiver(criterion: &mut Criterion) {
    let Some(path) = std::env::var_os("DGS_STREAM") else { return };
    let bytes = std::fs::read(path).unwrap();
    let (message, start) = file::manifest(&bytes).unwrap();
    let packets: Vec<&[u8]> = file::packets(&bytes, start, crc32)
        .filter_map(|record| if let Record::Packet(_, packet) = record { Some(packet.bytes()) } else { None })
        .collect();
    let mut group = criterion.benchmark_group("receiver");
    group.throughput(Throughput::Elements(packets.len() as u64));
    group.bench_function("packet head", |b| {
        b.iter(|| packets.iter().filter(|p| Head::parse(&p[..p.len() - 4]).is_ok()).count());
    });
    group.bench_function("packet parse", |b| {
        b.iter(|| packets.iter().filter(|p| Packet::parse(&p[..p.len() - 4]).is_ok()).count());
    });
    let caps = Caps { early_bytes: 0, ..Caps::HOST };
    let mut scratch = vec![0u64; manifest::ManifestHead::parse(message).unwrap().raw_len.div_ceil(8)];
    let need = Waiting::new(&mut scratch, caps).unwrap().required(message).unwrap();
    let mut arena = vec![0u64; need.words];
    group.bench_function("manifest and all packets", |b| {
        b.iter(|| {
            let waiting = Waiting::new(&mut arena, caps).unwrap();
            let mut player = waiting.manifest(message).map_err(|(_, error)| error).unwrap();
            packets.iter().filter(|p| player.push(p).is_ok()).count()
        });
    });
    group.finish();
}

criterion_group!(benches, entropy, crc, receiver);
criterion_main!(benches);
