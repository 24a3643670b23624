//! Entropy coders and the manifest packer: what is coded decodes; any bytes decode or are refused,
//! and the fast decoder never accepts what the slow one does not.

use std::{num::NonZero, sync::OnceLock};

use codec_core::internals::{
    cursor::Reader,
    ids::Level,
    pack as packer,
    rans::{
        bytes::{self as byte_coder, ByteTable},
        context::{self as context_coder, Place},
        lanes::{self as lane_coder, Decoder, Symbols, TableRun, naive},
        table::{SLOTS, Table},
    },
};

use crate::input::Choices;

/// Tables narrow and wide, with and without raw bits and escapes, and one certain of everything.
fn known_tables() -> &'static [Table] {
    static TABLES: OnceLock<Vec<Table>> = OnceLock::new();
    TABLES.get_or_init(|| {
        let spreads = [(1u64, 0u8), (6, 0), (20, 2), (40, 8), (3, 5)];
        let shaped = spreads.into_iter().filter_map(|(spread, raw_bits)| {
            let mut counts = [0u64; 256];
            for (token, count) in counts.iter_mut().enumerate() {
                let distance = (token as i64 - 128).unsigned_abs();
                *count = 100_000u64 >> (distance / spread).min(63);
            }
            counts[0] = 3;
            Table::from_counts(&counts, raw_bits).ok()
        });
        let mut certain = [0u16; 256];
        certain[128] = 2048;
        shaped.chain(Table::new(certain, 0)).collect()
    })
}

fn slots(table: &Table) -> Box<[u32; SLOTS]> {
    let mut slots = Box::new([0u32; SLOTS]);
    table.fill_slots(&mut slots);
    slots
}

fn fast(body: &[u8], table_of: &[u8], tables: &[Table]) -> Option<Vec<i16>> {
    static SLOTS_OF: OnceLock<Vec<Box<[u32; SLOTS]>>> = OnceLock::new();
    let known = SLOTS_OF.get_or_init(|| known_tables().iter().map(slots).collect());
    let own: Vec<Box<[u32; SLOTS]>> = tables.iter().skip(known.len()).map(slots).collect();
    let mut out = vec![0i16; table_of.len()];
    let raw_bits = table_of.iter().map(|&t| usize::from(tables[usize::from(t)].raw_bits())).sum();
    let mut decoder = Decoder::new(body, out.len(), raw_bits).ok()?;
    let mut at = 0;
    for run in table_of.chunk_by(|a, b| a == b) {
        let index = usize::from(run[0]);
        let slots = known.get(index).or_else(|| own.get(index - known.len()))?;
        decoder.run(&**slots, tables[index].raw_bits(), &mut out[at..at + run.len()]).ok()?;
        at += run.len();
    }
    decoder.finish().ok()?;
    Some(out)
}

/// Four-lane rANS: as a body to decode, and as values to encode.
pub fn lanes(data: &[u8]) {
    let mut choices = Choices::new(data);
    let (mode, runs, lie) = (choices.u8(), usize::from(choices.u8() % 32) + 1, choices.u8());
    let mut all = known_tables().to_vec();
    if mode & 2 != 0 {
        let head = choices.take(64);
        if let Ok(table) = Table::read(&mut Reader::new(head)) {
            let mut bytes = Vec::new();
            table.write(|b| bytes.extend_from_slice(b));
            assert_eq!(bytes.len(), table.wire_len());
            assert_eq!(Table::read(&mut Reader::new(&bytes)).as_ref(), Ok(&table));
            all.push(table);
        }
    }
    let count = choices.below(2000);
    let table_of: Vec<u8> =
        (0..count).map(|i| ((i / runs * 7 + usize::from(mode >> 2)) % all.len()) as u8).collect();
    let raw_bits: usize = table_of.iter().map(|&t| usize::from(all[usize::from(t)].raw_bits())).sum();
    if mode & 1 == 0 {
        let body = choices.rest();
        let mut slow = vec![0i16; count];
        let accepted = naive::decode(body, &table_of, &all, &mut slow);
        assert_eq!(fast(body, &table_of, &all), accepted.ok().map(|()| slow), "the twins disagree");
        return;
    }
    let values: Vec<i16> = (0..count).map(|_| choices.u16() as i16 >> (lie % 16)).collect();
    let symbols: Vec<Symbols> = all.iter().map(Symbols::new).collect();
    let runs: Vec<TableRun> =
        table_of.chunk_by(|a, b| a == b).map(|run| TableRun { table: run[0], len: run.len() }).collect();
    let mut out = vec![0u8; 6 * count + 64];
    let mut plain = Vec::new();
    let slowly = naive::encode::<2000>(&values, &table_of, &all, |byte| plain.push(byte));
    // Only a table without an escape refuses a value.
    let Ok(coded) = lane_coder::encode(&values, &runs, &symbols, &mut out) else {
        assert!(slowly.is_err());
        return;
    };
    assert_eq!(coded.raw_bits, raw_bits);
    let body = &mut out[..coded.len];
    assert_eq!((slowly, plain.as_slice()), (Ok(()), &*body));
    assert_eq!(fast(body, &table_of, &all).as_ref(), Some(&values));
    let mut slow = vec![0i16; count];
    assert!(naive::decode(body, &table_of, &all, &mut slow).is_ok());
    assert_eq!(slow, values);
    let bit = usize::from(lie) * 37 % (body.len() * 8);
    body[bit / 8] ^= 1 << (bit % 8);
    let accepted = naive::decode(body, &table_of, &all, &mut slow);
    assert_eq!(fast(body, &table_of, &all), accepted.ok().map(|()| slow), "the twins disagree");
}

/// Frequency tables: as bytes, and as counts to normalise.
pub fn tables(data: &[u8]) {
    let mut choices = Choices::new(data);
    let (mode, raw_bits) = (choices.u8(), choices.u8() % 12);
    if mode & 1 == 0 {
        let bytes = choices.rest();
        let mut reader = Reader::new(bytes);
        if let Ok(table) = Table::read(&mut reader) {
            let used = bytes.len() - reader.left();
            assert_table(&table, Some(&bytes[..used]));
        }
        return;
    }
    let mut counts = [0u64; 256];
    while !choices.is_empty() {
        let (token, size, count) = (choices.u8(), choices.u8(), choices.u16());
        counts[usize::from(token)] = u64::from(count) << (size % 24);
    }
    let table = match Table::from_counts(&counts, raw_bits) {
        Ok(table) => table,
        Err(error) => {
            assert_eq!((error.field, raw_bits > 8), ("table.raw_bits", true), "{error}");
            return;
        }
    };
    for (token, &count) in (0..=255u8).zip(&counts) {
        assert!(count == 0 || table.frequency(token) > 0, "token {token} was seen and cannot be coded");
    }
    assert!(table.frequency(0) > 0, "there is an escape");
    assert_table(&table, None);
}

/// Frequencies add up, every value has a code, and the bytes are the table.
fn assert_table(table: &Table, bytes: Option<&[u8]>) {
    let mut sum = 0;
    for token in 0..=255u8 {
        assert_eq!(table.start(token), sum);
        sum += table.frequency(token);
    }
    assert_eq!(sum as usize, SLOTS);
    for value in [0, 1, -1, 255, -256, i16::MAX, i16::MIN] {
        let code = table.code(value);
        assert!(code == 0 || table.frequency(code) > 0);
    }
    let mut written = Vec::new();
    table.write(|b| written.extend_from_slice(b));
    assert_eq!(written.len(), table.wire_len());
    assert_eq!(Table::read(&mut Reader::new(&written)).as_ref(), Ok(table));
    if let Some(bytes) = bytes {
        // A reader may be lenient about zeros at the ends; it never reads less than is written.
        assert!(bytes.len() >= written.len(), "{bytes:?} {written:?}");
    }
    let _ = slots(table);
}

/// Byte-wise rANS: as a body to decode, and as values to encode.
pub fn bytes(data: &[u8]) {
    let mut choices = Choices::new(data);
    let (mode, shift) = (choices.u8(), choices.u8() % 16);
    let count = choices.below(1500);
    let rest = choices.rest();
    let values: Vec<i16> = rest
        .chunks_exact(2)
        .take(count)
        .map(|pair| i16::from_le_bytes([pair[0], pair[1]]) >> shift)
        .collect();
    let mut counts = [[0u64; 256]; 2];
    for value in &values {
        for (counts, byte) in counts.iter_mut().zip(value.to_le_bytes()) {
            counts[usize::from(byte)] += 1;
        }
    }
    let tables = counts.map(|c| ByteTable::from_counts(&c));
    assert!(tables.iter().all(Result::is_ok), "any counts make a table");
    let [Ok(low), Ok(high)] = tables else { return };
    for table in [&low, &high] {
        assert_eq!(ByteTable::from_bytes(&table.to_bytes()).as_ref(), Ok(table));
    }
    let mut slots = [[0u8; byte_coder::SLOTS]; 2];
    low.fill_slots(&mut slots[0]);
    high.fill_slots(&mut slots[1]);
    let mut decoded = vec![0i16; count];
    let tables = [&low, &high];
    let _ = byte_coder::decode(rest, tables, [&slots[0], &slots[1]], &mut decoded);
    if let Some(table) = rest.first_chunk::<{ byte_coder::TABLE_BYTES }>() {
        let _ = ByteTable::from_bytes(table);
    }
    let mut out = vec![0u8; 4 * values.len() + 16];
    let coded = byte_coder::encode(&values, tables, &mut out);
    assert!(coded.is_ok(), "{coded:?}");
    let at = coded.unwrap_or(0);
    let mut back = vec![0i16; values.len()];
    assert_eq!(byte_coder::decode(&out[at..], tables, [&slots[0], &slots[1]], &mut back), Ok(()));
    assert_eq!(back, values);
    let bit = usize::from(mode) * 41 % ((out.len() - at) * 8);
    out[at + bit / 8] ^= 1 << (bit % 8);
    let damaged = byte_coder::decode(&out[at..], tables, [&slots[0], &slots[1]], &mut back);
    assert!(damaged.is_err() || back != values, "a flipped bit changes something");
    context(rest, &values, usize::from(mode));
}

/// The context coder: `body` decodes or is refused, `values` come back, a flipped bit is noticed.
fn context(body: &[u8], values: &[i16], mode: usize) {
    let level = Level::from_bits(mode as u8);
    let Some(gaussians) = NonZero::new(1 + mode % 40) else { return };
    let place = Place { level, first: mode * 7, gaussians, rank: mode % 5, frames: 9 };
    let mut back = vec![0i16; values.len()];
    let _ = context_coder::decode(body, place, &mut back);
    let mut decisions = Vec::new();
    let walked = context_coder::decisions(&mut values.to_vec(), place, |_, decision| {
        decisions.push(decision);
        true
    });
    assert_eq!(walked, Ok(()));
    let mut out = vec![0u8; 5 * values.len() + 16];
    let coded = context_coder::encode(decisions.into_iter(), &mut out);
    assert!(coded.is_ok(), "{coded:?}");
    let body = &mut out[coded.unwrap_or(0)..];
    assert_eq!(context_coder::decode(body, place, &mut back), Ok(()));
    assert_eq!(back, values);
    let bit = mode * 41 % (body.len() * 8);
    body[bit / 8] ^= 1 << (bit % 8);
    assert!(context_coder::decode(body, place, &mut back).is_err() || back != values);
}

/// The manifest packer: there is one packed form of each body.
pub fn pack(data: &[u8]) {
    let mut choices = Choices::new(data);
    let len = choices.below(6000);
    let rest = choices.rest();
    let mut unpacked = vec![0u8; len];
    let mut out = vec![0u8; packer::packed_bound(rest.len().max(len))];
    if packer::unpack(rest, &mut unpacked).is_ok() {
        assert_eq!(packer::pack(&unpacked, &mut out), Ok(rest.len()));
        assert_eq!(&out[..rest.len()], rest);
    }
    let packed = packer::pack(rest, &mut out);
    assert!(packed.is_ok(), "{packed:?}");
    let packed = &out[..packed.unwrap_or(0)];
    let mut back = vec![0u8; rest.len()];
    assert_eq!(packer::unpack(packed, &mut back), Ok(()));
    assert_eq!(back, rest);
    if let Some((_, cut)) = packed.split_last() {
        assert!(packer::unpack(cut, &mut back).is_err());
    }
    let longer = [packed, &[0]].concat();
    assert!(packer::unpack(&longer, &mut back).is_err());
}
