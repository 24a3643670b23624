//! The four-lane body of `SPEC.md` sections 8.4 and 8.5, by divisions and one bit at a time.

use crate::table::Table;

/// Bits of bytes, low bits first.
pub struct Bits<'b> {
    pub bytes: &'b [u8],
    pub at: usize,
}

impl Bits<'_> {
    /// The next `count` bits, the first the lowest.
    pub fn take(&mut self, count: u32) -> u64 {
        let mut value = 0;
        for place in 0..count {
            value |= u64::from(self.bytes[self.at / 8] >> (self.at % 8) & 1) << place;
            self.at += 1;
        }
        value
    }
}

/// Appends bits to bytes, low bits first.
#[derive(Default)]
pub struct Writer {
    pub bytes: Vec<u8>,
    filled: u32,
}

impl Writer {
    /// The low `count` bits of `value`, the lowest first.
    pub fn put(&mut self, value: u64, count: u32) {
        for place in 0..count {
            if self.filled.is_multiple_of(8) {
                self.bytes.push(0);
            }
            *self.bytes.last_mut().unwrap() |= ((value >> place & 1) as u8) << (self.filled % 8);
            self.filled += 1;
        }
    }
}

/// The values of `body`, one per table.
pub fn decode(body: &[u8], tables: &[&Table]) -> Vec<i16> {
    let n = tables.len();
    let tail = usize::from(body[0]);
    assert!(tail <= n.div_ceil(4));
    let lengths: [u32; 4] =
        std::array::from_fn(|lane| 15 + u32::from(body[1 + lane / 2] >> (4 * (lane % 2)) & 15));
    let raw: u32 = tables.iter().map(|t| t.raw_bits).sum();
    let plane = body.len() - (raw + lengths.iter().sum::<u32>()).div_ceil(8) as usize;
    assert_eq!((plane - 3) % 2, 0);
    let mut states = Bits { bytes: &body[plane..], at: raw as usize };
    let mut x = lengths.map(|b| 1 << b | states.take(b));
    while states.at < 8 * states.bytes.len() {
        assert_eq!(states.take(1), 0, "padding");
    }
    let mut raw_bits = Bits { bytes: &body[plane..], at: 0 };
    let (mut word, mut escape, mut values) = (3, plane, Vec::new());
    for (i, table) in tables.iter().enumerate() {
        let x = &mut x[i % 4];
        let slot = *x % 2048;
        let token = (0..256).rev().find(|&t| table.frequency[t] > 0 && table.below[t] <= slot).unwrap();
        *x = table.frequency[token] * (*x >> 11) + slot - table.below[token];
        if *x < 1 << 15 && i < n - n.min(4 * tail) {
            *x = *x << 16 | u64::from(body[word]) | u64::from(body[word + 1]) << 8;
            word += 2;
        }
        let low = raw_bits.take(table.raw_bits) as i32;
        values.push(if token == 0 {
            assert_eq!(low, 0);
            escape -= 2;
            i16::from_le_bytes([body[escape], body[escape + 1]])
        } else {
            ((token as i32 - 128) << table.raw_bits | low) as i16
        });
    }
    assert_eq!(word, escape, "words and escapes meet");
    assert!(x.iter().all(|x| x.is_power_of_two() && (8..=1 << 15).contains(x)));
    values
}

fn push(x: u64, table: &Table, token: usize) -> u64 {
    let f = table.frequency[token];
    (x / f) * 2048 + x % f + table.below[token]
}

fn full(x: u64, table: &Table, token: usize) -> bool {
    x >= table.frequency[token] << 20
}

/// The last groups of values that the states keep, the states then, and the groups at first.
fn tail(tokens: &[usize], tables: &[&Table]) -> (usize, [u64; 4], usize) {
    let n = tokens.len();
    let mut start = [8u64; 4];
    let mut most = n.div_ceil(4).min(255);
    let mut at_first = None;
    loop {
        let (mut x, mut groups) = (start, 0);
        'groups: while groups < most {
            let mut copy = x;
            let end = n - 4 * groups;
            for i in (end.saturating_sub(4)..end).rev() {
                if full(copy[i % 4], tables[i], tokens[i]) {
                    break 'groups;
                }
                copy[i % 4] = push(copy[i % 4], tables[i], tokens[i]);
            }
            x = copy;
            groups += 1;
        }
        most = groups;
        let at_first = *at_first.get_or_insert(groups);
        if x.iter().all(|&x| x >= 1 << 15) {
            return (groups, x, at_first);
        }
        for (start, x) in start.iter_mut().zip(x) {
            *start *= if x < 1 << 15 { 2 } else { 1 };
        }
    }
}

/// Whether a lane that started anew shortened the tail.
pub fn has_shortened_tail(values: &[i16], tables: &[&Table]) -> bool {
    let tokens: Vec<usize> = values.iter().zip(tables).map(|(&value, table)| table.token(value)).collect();
    let (groups, _, at_first) = tail(&tokens, tables);
    groups < at_first
}

/// The one body of `values`, each with its table.
pub fn encode(values: &[i16], tables: &[&Table]) -> Vec<u8> {
    let tokens: Vec<usize> = values.iter().zip(tables).map(|(&value, table)| table.token(value)).collect();
    let (groups, mut x, _) = tail(&tokens, tables);
    let mut words = Vec::new();
    for i in (0..values.len().saturating_sub(4 * groups)).rev() {
        let x = &mut x[i % 4];
        if full(*x, tables[i], tokens[i]) {
            words.push(*x as u16);
            *x >>= 16;
        }
        *x = push(*x, tables[i], tokens[i]);
    }
    let lengths = x.map(|x| x.ilog2());
    let packed = (0..4).fold(0u32, |packed, lane| packed | (lengths[lane] - 15) << (4 * lane));
    let mut body = vec![groups as u8, packed as u8, (packed >> 8) as u8];
    words.iter().rev().for_each(|word| body.extend(word.to_le_bytes()));
    let escaped = values.iter().zip(&tokens).rev().filter(|(_, token)| **token == 0);
    escaped.for_each(|(value, _)| body.extend(value.to_le_bytes()));
    let mut plane = Writer::default();
    for ((&value, &token), table) in values.iter().zip(&tokens).zip(tables) {
        plane.put(if token == 0 { 0 } else { value as u64 }, table.raw_bits);
    }
    x.iter().zip(lengths).for_each(|(&x, length)| plane.put(x, length));
    body.extend(plane.bytes);
    body
}
