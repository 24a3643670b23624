//! Every kernel of this machine against the scalar decoder: values and errors, on whole and damaged
//! packets of different lengths, tables and runs.

#![allow(
    clippy::unwrap_used,
    clippy::expect_used,
    clippy::panic,
    reason = "a test's helpers fail like tests"
)]

use codec_core::internals::rans::{
    lanes::{self, Symbols, TableRun},
    table::{SLOTS, Table},
};
use codec_simd::{Job, Kernel, Tables, decode_many_with};
use proptest::prelude::*;

fn tables() -> Vec<Table> {
    let spreads = [(1u64, 0u8), (6, 0), (20, 2), (40, 8), (3, 5), (7, 7), (2, 1), (5, 3), (9, 4), (4, 6)];
    spreads
        .into_iter()
        .map(|(spread, raw_bits)| {
            let mut counts = [0u64; 256];
            for (token, count) in counts.iter_mut().enumerate() {
                let distance = (token as i64 - 128).unsigned_abs();
                *count = 100_000u64 >> (distance / spread).min(63);
            }
            counts[0] = 3;
            Table::from_counts(&counts, raw_bits).unwrap()
        })
        .collect()
}

struct Packet {
    runs: Vec<TableRun>,
    values: Vec<i16>,
    body: Vec<u8>,
}

/// A packet from a seed: its length, runs and values are drawn from it.
fn packet(tables: &[Table], symbols: &[Symbols], seed: u64, longest: usize) -> Packet {
    let mut state = seed;
    let mut below = |n: usize| {
        state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
        ((state >> 33) as usize * n) >> 31
    };
    let n = below(longest + 1);
    let (mut runs, mut left) = (Vec::new(), n);
    let run_len = [1, 4, 40, 300, 5000][below(5)];
    while left > 0 {
        let len = (below(run_len) + usize::from(below(9) > 0)).min(left);
        runs.push(TableRun { table: below(tables.len()) as u8, len });
        left -= len;
    }
    let wide = [2, 8, 60, 65536][below(4)];
    let values: Vec<i16> = (0..n).map(|_| (below(wide) as i32 - wide as i32 / 2) as i16).collect();
    let mut body = vec![0u8; 4 * n + 64];
    let len = lanes::encode(&values, &runs, symbols, &mut body).unwrap().len;
    body.truncate(len);
    Packet { runs, values, body }
}

/// What every kernel makes of `packets`.
fn check(tables: &[Table], packets: &[Packet]) -> Vec<(Kernel, Vec<Option<Vec<i16>>>)> {
    let mut slots = vec![[0u32; SLOTS]; tables.len()];
    tables.iter().zip(&mut slots).for_each(|(table, slots)| table.fill_slots(slots));
    let raw_bits: Vec<u8> = tables.iter().map(Table::raw_bits).collect();
    let tables = Tables { slots: &slots, raw_bits: &raw_bits };
    let mut found: Vec<(Kernel, Vec<_>, Vec<_>)> = Vec::new();
    for kernel in Kernel::ALL.into_iter().filter(|k| k.is_here()) {
        let mut outs: Vec<Vec<i16>> = packets.iter().map(|p| vec![-77; p.values.len()]).collect();
        // Each body ends where its allocation ends.
        let bodies: Vec<Box<[u8]>> = packets.iter().map(|p| p.body.clone().into_boxed_slice()).collect();
        let mut jobs: Vec<Job<'_>> = packets
            .iter()
            .zip(&bodies)
            .zip(&mut outs)
            .map(|((packet, body), out)| Job::new(body, &packet.runs, out))
            .collect();
        decode_many_with(kernel, &tables, &mut jobs);
        let results: Vec<_> = jobs.into_iter().map(|job| job.result).collect();
        found.push((kernel, results, outs));
    }
    let (_, scalar_results, scalar_outs) = &found[0];
    for (kernel, results, outs) in &found {
        for (i, result) in results.iter().enumerate() {
            assert_eq!(result, &scalar_results[i], "{kernel:?}, packet {i}");
            if result.is_ok() {
                assert!(outs[i] == scalar_outs[i], "{kernel:?}, packet {i}: other values");
            }
        }
    }
    found
        .into_iter()
        .map(|(kernel, results, outs)| {
            (kernel, results.into_iter().zip(outs).map(|(r, o)| r.ok().map(|()| o)).collect())
        })
        .collect()
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(40))]

    #[test]
    fn whole_packets_come_back(
        seed: u64,
        count in 0usize..40,
        longest in prop_oneof![Just(60usize), Just(3000)],
    ) {
        let tables = tables();
        let symbols: Vec<Symbols> = tables.iter().map(Symbols::new).collect();
        let packets: Vec<Packet> =
            (0..count as u64)
                .map(|i| packet(&tables, &symbols, seed.wrapping_add(i << 7), longest))
                .collect();
        for (kernel, found) in check(&tables, &packets) {
            for (packet, found) in packets.iter().zip(found) {
                prop_assert_eq!(Some(&packet.values), found.as_ref(), "{:?}", kernel);
            }
        }
    }

    /// Packets of one length end in one group, whichever lane their tails begin on.
    #[test]
    fn packets_of_one_length_come_back(seed: u64, table in 0u8..10, len in 0usize..900) {
        let tables = tables();
        let symbols: Vec<Symbols> = tables.iter().map(Symbols::new).collect();
        let packets: Vec<Packet> = (0..40u64)
            .map(|i| {
                let mut packet = packet(&tables, &symbols, seed.wrapping_add(i << 7), 900);
                packet.values.resize(len, 1);
                packet.runs = vec![TableRun { table, len }];
                packet.body = vec![0; 4 * len + 64];
                let body = lanes::encode(&packet.values, &packet.runs, &symbols, &mut packet.body).unwrap();
                packet.body.truncate(body.len);
                packet
            })
            .collect();
        for (kernel, found) in check(&tables, &packets) {
            for (packet, found) in packets.iter().zip(found) {
                prop_assert_eq!(Some(&packet.values), found.as_ref(), "{:?}", kernel);
            }
        }
    }

    #[test]
    fn damaged_packets_get_the_same_verdict(seed: u64, count in 1usize..40, hits in 1usize..20) {
        let tables = tables();
        let symbols: Vec<Symbols> = tables.iter().map(Symbols::new).collect();
        let mut packets: Vec<Packet> =
            (0..count as u64).map(|i| packet(&tables, &symbols, seed.wrapping_add(i << 7), 900)).collect();
        let mut state = seed | 1;
        let mut below = |n: usize| {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            ((state >> 33) as usize * n) >> 31
        };
        for _ in 0..hits {
            let packet = &mut packets[below(count)];
            let at = below(packet.body.len().max(1));
            match below(5) {
                0 => packet.body.truncate(at),
                1 => packet.body.extend_from_slice(&[0xa5; 3][..below(4)]),
                2 if !packet.runs.is_empty() => {
                    let run = below(packet.runs.len());
                    packet.runs[run].table = below(12) as u8;
                }
                3 if !packet.runs.is_empty() => packet.runs[0].len += below(3),
                _ => if let Some(byte) = packet.body.get_mut(at) { *byte ^= 1 << below(8) },
            }
        }
        check(&tables, &packets);
    }
}

/// The comparison fails for a kernel that goes wrong: here, one that is given other slots.
#[test]
fn other_tables_give_other_verdicts() {
    let tables = tables();
    let symbols: Vec<Symbols> = tables.iter().map(Symbols::new).collect();
    let packets: Vec<Packet> = (0..20).map(|i| packet(&tables, &symbols, 99 + i, 3000)).collect();
    let mut slots = vec![[0u32; SLOTS]; tables.len()];
    tables.iter().zip(&mut slots).for_each(|(table, slots)| table.fill_slots(slots));
    for slots in &mut slots {
        slots.reverse();
    }
    // Any slots at all, and nothing is read or written out of bounds.
    slots[1].iter_mut().enumerate().for_each(|(i, slot)| *slot = (i as u32).wrapping_mul(2_654_435_761));
    let raw_bits: Vec<u8> = tables.iter().map(Table::raw_bits).collect();
    for kernel in Kernel::ALL.into_iter().filter(|k| k.is_here()) {
        let mut outs: Vec<Vec<i16>> = packets.iter().map(|p| vec![0; p.values.len()]).collect();
        let mut jobs: Vec<Job<'_>> =
            packets.iter().zip(&mut outs).map(|(p, out)| Job::new(&p.body, &p.runs, out)).collect();
        decode_many_with(kernel, &Tables { slots: &slots, raw_bits: &raw_bits }, &mut jobs);
        let long = packets.iter().zip(&jobs).filter(|(p, _)| p.values.len() > 100);
        assert!(
            long.clone().count() > 3 && long.filter(|(_, job)| job.result.is_ok()).count() == 0,
            "{kernel:?}"
        );
    }
}
