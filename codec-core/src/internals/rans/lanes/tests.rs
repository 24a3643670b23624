//! Both decoders against both encoders, over whole and damaged bodies.

extern crate std;

use std::{boxed::Box, sync::OnceLock, vec, vec::Vec};

use proptest::prelude::*;

use super::*;
use crate::{
    error::ErrorKind,
    rans::{
        family::{HEAVY, THREE},
        table::{SLOTS, Table},
    },
};

/// Most values of a generated body; an interpreter takes a second for some hundred.
const MOST: usize = if cfg!(miri) { 36 } else { 3000 };
/// Shortest run of one table: each run fills its table's slots anew.
const SHORTEST_RUN: usize = if cfg!(miri) { 12 } else { 1 };

/// Made once: to fit a wide table is most of what an interpreter would do, so it fits one only.
fn tables() -> Vec<Table> {
    static TABLES: OnceLock<Vec<Table>> = OnceLock::new();
    let fitted = |(spread, raw_bits): (u64, u8)| {
        let mut counts = [0u64; 256];
        for (token, count) in counts.iter_mut().enumerate() {
            let distance = (token as i64 - 128).unsigned_abs();
            *count = 100_000u64 >> (distance / spread).min(63);
        }
        counts[0] = 3;
        Table::from_counts(&counts, raw_bits).unwrap()
    };
    let named = |index: u8| Table::named(index).unwrap();
    let made = || match cfg!(miri) {
        false => [(1, 0), (6, 0), (20, 2), (40, 8), (3, 5), (7, 7)].map(fitted),
        true => [fitted((1, 0)), named(24), named(36), named(53), named(HEAVY + 20), named(THREE + 20)],
    };
    TABLES.get_or_init(|| made().to_vec()).clone()
}

fn runs(table_of: &[u8]) -> Vec<TableRun> {
    table_of.chunk_by(|a, b| a == b).map(|run| TableRun { table: run[0], len: run.len() }).collect()
}

fn encoded(values: &[i16], table_of: &[u8], tables: &[Table]) -> Vec<u8> {
    let symbols: Vec<Symbols> = tables.iter().map(Symbols::new).collect();
    let mut out = vec![0xeeu8; 4 * values.len() + 64];
    let info = encode(values, &runs(table_of), &symbols, &mut out).unwrap();
    out.truncate(info.len);
    out
}

/// Every way of the fast decoder: slots or compact, four words at once or one by one. All must
/// say the same.
fn decode(body: &[u8], table_of: &[u8], tables: &[Table]) -> Result<Vec<i16>> {
    let mut found: Option<Result<Vec<i16>>> = None;
    for (wide, compact) in [(true, false), (true, true), (false, false), (false, true)] {
        let result = decode_as(body, table_of, tables, wide, compact);
        if let Some(before) = &found {
            assert_eq!(*before, result, "wide {wide} compact {compact}");
        }
        found = Some(result);
    }
    found.unwrap()
}

fn decode_as(body: &[u8], table_of: &[u8], tables: &[Table], wide: bool, compact: bool) -> Result<Vec<i16>> {
    let raw_bits = table_of.iter().map(|&t| usize::from(tables[usize::from(t)].raw_bits())).sum();
    let mut out = vec![0i16; table_of.len()];
    let mut decoder = Decoder::new(body, out.len(), raw_bits)?;
    let mut slots = Box::new([0u32; SLOTS]);
    let (mut token, mut range) = (Box::new([0u8; SLOTS]), [0u32; 256]);
    let mut at = 0;
    for run in runs(table_of) {
        let table = &tables[usize::from(run.table)];
        let target = &mut out[at..at + run.len];
        at += run.len;
        if compact {
            let compact = Compact::fill(table, &mut token, &mut range);
            if wide {
                decoder.run_as::<_, true, 64>(&compact, table.raw_bits(), target)?;
            } else {
                decoder.run_as::<_, false, 64>(&compact, table.raw_bits(), target)?;
            }
        } else {
            table.fill_slots(&mut slots);
            if wide {
                decoder.run_as::<_, true, 64>(&*slots, table.raw_bits(), target)?;
            } else {
                decoder.run_as::<_, false, 64>(&*slots, table.raw_bits(), target)?;
            }
        }
    }
    decoder.finish()?;
    Ok(out)
}

fn slow(body: &[u8], table_of: &[u8], tables: &[Table]) -> Option<Vec<i16>> {
    let mut out = vec![0i16; table_of.len()];
    naive::decode(body, table_of, tables, &mut out).ok().map(|()| out)
}

fn values() -> impl Strategy<Value = Vec<i16>> {
    let value = prop_oneof![6 => -8i16..8, 2 => -300i16..300, 1 => any::<i16>()];
    prop_oneof![
        proptest::collection::vec(value, 0..MOST.min(500)),
        proptest::collection::vec(-2i16..3, 0..MOST.min(1500)),
        proptest::collection::vec(Just(0i16), 0..MOST),
    ]
}

proptest! {
    #[test]
    fn both_twins_encode_the_same_bytes_and_decode_them(
        values in values(), picks in proptest::collection::vec(0u8..6, MOST), run in SHORTEST_RUN..300,
    ) {
        let tables = tables();
        let table_of: Vec<u8> = (0..values.len()).map(|i| picks[i / run]).collect();
        let body = encoded(&values, &table_of, &tables);
        let mut bytes = Vec::new();
        naive::encode::<MOST>(&values, &table_of, &tables, |b| bytes.push(b)).unwrap();
        prop_assert_eq!(&bytes, &body);
        prop_assert_eq!(&decode(&body, &table_of, &tables).unwrap(), &values);
        prop_assert_eq!(slow(&body, &table_of, &tables), Some(values));
    }

    #[test]
    fn twins_agree_on_damaged_bodies(
        values in values(), table in 0u8..6, at: usize, bit in 0u32..8, cut in 0usize..4, head: bool,
    ) {
        let tables = tables();
        let table_of = vec![table; values.len()];
        let mut body = encoded(&values, &table_of, &tables);
        let at = at % if head { HEAD_BYTES } else { body.len() };
        body[at] ^= 1 << bit;
        body.truncate(body.len() - cut);
        prop_assert_eq!(decode(&body, &table_of, &tables).ok(), slow(&body, &table_of, &tables));
    }

    #[test]
    fn twins_agree_on_any_bytes(
        body in proptest::collection::vec(any::<u8>(), 0..90), n in 0usize..60, table in 0u8..6,
    ) {
        let tables = tables();
        let table_of = vec![table; n];
        prop_assert_eq!(decode(&body, &table_of, &tables).ok(), slow(&body, &table_of, &tables));
    }
}

/// Overwritten bytes are noticed by the coder alone, without a CRC. (A flip that turns a token into
/// one of the same frequency leaves every state as it was: no rANS check sees that.)
#[test]
fn overwritten_bytes_are_noticed() {
    let tables = tables();
    let values: Vec<i16> =
        (0..if cfg!(miri) { 40 } else { 400 }).map(|i| ((i * 7919) % 97 % 23) as i16 - 11).collect();
    let table_of = vec![1u8; values.len()];
    let body = encoded(&values, &table_of, &tables);
    let mut state = 1u64;
    let (mut tries, mut missed) = (0, 0);
    for at in (0..body.len() - 8).step_by(if cfg!(miri) { 11 } else { 1 }) {
        for _ in 0..8 {
            state = state.wrapping_mul(6_364_136_223_846_793_005).wrapping_add(1_442_695_040_888_963_407);
            let mut body = body.clone();
            body[at..at + 8].copy_from_slice(&(state ^ state >> 29).to_le_bytes());
            tries += 1;
            missed += usize::from(decode_as(&body, &table_of, &tables, true, false).is_ok());
        }
    }
    assert!(missed * 100 <= tries, "{missed} of {tries}");
}

#[test]
fn a_buffer_that_is_too_small_is_a_capacity_error() {
    let tables = tables();
    let symbols: Vec<Symbols> = tables.iter().map(Symbols::new).collect();
    let run = [TableRun { table: 1, len: 64 }];
    let values = [i16::MAX; 64];
    let mut out = vec![0u8; 1000];
    let len = encode(&values, &run, &symbols, &mut out).unwrap().len;
    for room in (0..len).step_by(if cfg!(miri) { 7 } else { 1 }) {
        let error = encode(&values, &run, &symbols, &mut out[..room]).unwrap_err();
        assert_eq!(error.kind, ErrorKind::Capacity, "{room} of {len}");
    }
    assert_eq!(encode(&values, &run, &symbols, &mut out[..len]).unwrap().len, len);
}

#[test]
fn an_encoder_names_what_it_cannot_code() {
    let mut certain = [0u16; 256];
    certain[128] = 2048;
    let symbols = [Symbols::new(&Table::new(certain, 0).unwrap())];
    let mut out = [0u8; 100];
    let mut field = |values: &[i16], table, len| {
        let run = [TableRun { table, len }];
        encode(values, &run, &symbols, &mut out).map_err(|e| (e.field, e.found, e.offset))
    };
    assert_eq!(field(&[0, 1], 0, 2), Err(("encode.escape", 0, 1)));
    assert_eq!(field(&[0, 0], 1, 2), Err(("encode.table", 1, 0)));
    assert_eq!(field(&[0, 0], 0, 3), Err(("encode.runs", 3, 0)));
    assert_eq!(field(&[0, 0], 0, 2).map(|e| e.len), Ok(11));
}

#[test]
fn literal_bytes_of_a_small_body() {
    let tables = tables();
    let body = encoded(&[0, 1, -1, 300], &[0; 4], &tables);
    // One group of four in the states, all of them 15 bits long; no words; one escape; four states
    // less their leading bits.
    assert_eq!(body, [1, 0, 0, 44, 1, 236, 66, 174, 34, 94, 16, 0, 0]);
}
