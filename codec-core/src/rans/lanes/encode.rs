//! The encoder: reciprocals instead of divisions, words of four lanes in one store.

use core::hint::select_unpredictable;

use super::{HEAD_BYTES, LANES, LOW, LOW_BITS, TAIL_START};
use crate::{
    error::{Error, ErrorKind, Result},
    rans::table::{ESCAPE, PRECISION, SCALE, Table},
};

/// Most groups of four values that the states keep: what fits the tail byte.
const MOST_GROUPS: usize = u8::MAX as usize;

/// What one token does to a state: `x → (x / f << 11) + x mod f + start`, without dividing.
#[derive(Clone, Copy, Debug, Default)]
struct Symbol {
    /// `f << 20`: a state from here on gives up a word first.
    limit: u32,
    /// `ceil(2^(31 + s) / f)` with `2^s` the least power of two of `f` or more.
    reciprocal: u32,
    /// Added to the state: `start`, corrected for `f = 1`.
    bias: u32,
    /// `2048 − f`, times the quotient.
    complement: u16,
    /// `s − 1` in the low five bits, and whether the value travels as an escape.
    flags: u16,
}

/// Flag of a token whose value travels as an escape.
const ESCAPED: u16 = 1 << 8;

impl Symbol {
    fn of(table: &Table, token: u8) -> Self {
        let escaped = token == ESCAPE || table.frequency(token) == 0;
        let token = if escaped { ESCAPE } else { token };
        let (f, start) = (table.frequency(token), table.start(token));
        let complement = SCALE.saturating_sub(f) as u16;
        let (reciprocal, bias, shift) = match f {
            0 => (0, 0, 0),
            // 2^32 / 1 does not fit: x · (2^32 − 1) >> 32 is x − 1, and the bias makes up for it.
            1 => (u32::MAX, start + SCALE - 1, 0),
            _ => {
                let s = f.next_power_of_two().ilog2();
                ((1u64 << (s + 31)).div_ceil(u64::from(f)) as u32, start, s - 1)
            }
        };
        let flags = shift as u16 | if escaped { ESCAPED } else { 0 };
        Self { limit: f << (31 - PRECISION), reciprocal, bias, complement, flags }
    }

    const fn escaped(&self) -> bool {
        self.flags & ESCAPED != 0
    }

    #[inline(always)]
    fn push(&self, x: u32) -> u32 {
        let high = (u64::from(x) * u64::from(self.reciprocal)) >> 32;
        let quotient = (high as u32) >> (self.flags & 31);
        x.wrapping_add(self.bias).wrapping_add(quotient.wrapping_mul(u32::from(self.complement)))
    }
}

/// An encoder's form of a [`Table`], 4 KiB.
#[derive(Clone, Debug)]
pub struct Symbols {
    of: [Symbol; 256],
    raw_bits: u8,
}

impl Symbols {
    /// The encoder's form of `table`.
    pub fn new(table: &Table) -> Self {
        let of = core::array::from_fn(|token| Symbol::of(table, token as u8));
        Self { of, raw_bits: table.raw_bits() }
    }

    #[inline(always)]
    fn symbol(&self, value: i16) -> &Symbol {
        &self.of[usize::from(Table::token(value, self.raw_bits & 15))]
    }
}

/// What an encoder wrote.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Encoded {
    /// Bytes of the body.
    pub len: usize,
    /// Escaped values in it.
    pub escapes: usize,
    /// Raw bits in it.
    pub raw_bits: usize,
}

/// Values of a packet that share a table.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Run {
    /// Index of the table.
    pub table: u8,
    /// Number of values.
    pub len: usize,
}

fn full(room: usize) -> Error {
    Error::short("body", 0, room, room + 1).kind(ErrorKind::Capacity)
}

/// The values of one packet, run by run.
struct Source<'a> {
    values: &'a [i16],
    runs: &'a [Run],
    tables: &'a [Symbols],
}

impl<'a> Source<'a> {
    /// Runs from the last to the first: index of the first value, values, table.
    fn backwards(&self) -> impl Iterator<Item = (usize, &'a [i16], &'a Symbols)> {
        let Self { values, runs, tables } = *self;
        let mut end = values.len();
        runs.iter().rev().filter_map(move |run| {
            let start = end.checked_sub(run.len)?;
            let found = (start, values.get(start..end)?, tables.get(usize::from(run.table))?);
            end = start;
            Some(found)
        })
    }

    /// Runs from the first to the last.
    fn forwards(&self) -> impl Iterator<Item = (&'a [i16], &'a Symbols)> {
        let Self { values, runs, tables } = *self;
        let mut rest = values;
        runs.iter().filter_map(move |run| {
            let (values, after) = rest.split_at_checked(run.len)?;
            rest = after;
            Some((values, tables.get(usize::from(run.table))?))
        })
    }

    /// Symbols from the last value to the first.
    fn symbols(&self) -> impl Iterator<Item = &'a Symbol> {
        self.backwards().flat_map(|(_, values, table)| values.iter().rev().map(|&v| table.symbol(v)))
    }

    fn check(&self) -> Result<()> {
        let mut at = 0usize;
        for run in self.runs {
            let Some(table) = self.tables.get(usize::from(run.table)) else {
                let most = self.tables.len().saturating_sub(1) as u64;
                return Err(Error::illegal("encode.table", at, run.table.into(), (0, most)));
            };
            let end = at.saturating_add(run.len);
            let values = self.values.get(at..end).unwrap_or(&[]);
            // A table whose escape has no frequency must know every value.
            if table.of[usize::from(ESCAPE)].limit == 0
                && let Some(i) = values.iter().position(|&v| table.symbol(v).escaped())
            {
                return Err(Error::illegal("encode.escape", at + i, 0, (1, u64::from(SCALE))));
            }
            at = end;
        }
        let n = self.values.len();
        if at != n {
            return Err(Error::illegal("encode.runs", 0, at as u64, (n as u64, n as u64)));
        }
        Ok(())
    }
}

/// Where the lanes stand: how many groups of values the states keep, and the states then.
struct Tail {
    groups: usize,
    state: [u32; LANES],
}

/// Keeps as many of the last values in the states as they take without giving up a word.
fn keep(source: &Source<'_>) -> Tail {
    let n = source.values.len();
    let mut start = [TAIL_START; LANES];
    let mut most = n.div_ceil(LANES).min(MOST_GROUPS);
    loop {
        let mut state = start;
        let mut symbols = source.symbols();
        let mut groups = 0;
        'groups: while groups < most {
            let mut next = state;
            // The group of values n − 4 (groups + 1) .. n − 4 groups, the last first.
            let last = n - LANES * groups;
            for i in (last.saturating_sub(LANES)..last).rev() {
                let (Some(symbol), Some(x)) = (symbols.next(), next.get_mut(i % LANES)) else { break };
                if *x >= symbol.limit {
                    break 'groups;
                }
                *x = symbol.push(*x);
            }
            state = next;
            groups += 1;
        }
        // A lane that fell behind starts higher; the groups stay those of the first pass.
        most = groups;
        let mut settled = true;
        for (start, x) in start.iter_mut().zip(state) {
            if x < LOW {
                *start <<= 1;
                settled = false;
            }
        }
        if settled {
            return Tail { groups, state };
        }
    }
}

/// Encodes `values`, the runs one after the other with their tables, as one packet body at the
/// front of `out`.
///
/// # Errors
/// [`ErrorKind::Capacity`] if `out` is too small, [`ErrorKind::Illegal`] for a table index out of
/// range, runs that are not as long as the values, or a value that its table cannot code.
pub fn encode(values: &[i16], runs: &[Run], tables: &[Symbols], out: &mut [u8]) -> Result<Encoded> {
    let source = Source { values, runs, tables };
    source.check()?;
    let Tail { groups, mut state } = keep(&source);
    let main = values.len().saturating_sub(LANES * groups);
    let room = out.len();
    let mut at = room;
    let mut flags = 0;
    for (start, values, table) in source.backwards() {
        let (values, tail) = values.split_at(main.saturating_sub(start).min(values.len()));
        flags |= tail.iter().fold(0, |flags, &v| flags | table.symbol(v).flags);
        at = push_run(table, start, values, &mut state, &mut flags, out, at).ok_or(full(room))?;
    }
    let escaped =
        |(values, table): (&[i16], &Symbols)| values.iter().filter(|&&v| table.symbol(v).escaped()).count();
    let escapes = if flags & ESCAPED == 0 { 0 } else { source.forwards().map(escaped).sum::<usize>() };
    let words = room - at;
    if HEAD_BYTES + words > room {
        return Err(full(room));
    }
    out.copy_within(at.., HEAD_BYTES);
    finish(&source, groups, state, HEAD_BYTES + words, escapes, out)
}

/// Pushes a run whose first value has index `start`, words backwards from `at`; the new `at`.
#[inline]
fn push_run(
    table: &Symbols,
    start: usize,
    values: &[i16],
    state: &mut [u32; LANES],
    flags: &mut u16,
    out: &mut [u8],
    at: usize,
) -> Option<usize> {
    // Lanes turned so that the run's first value is on lane 0.
    let mut x = *state;
    x.rotate_left(start % LANES);
    let mut free = out.get_mut(..at)?;
    let (quads, over) = values.as_chunks::<LANES>();
    let mut group = |values: &[i16]| {
        let (mut words, mut used) = (0u64, 0usize);
        for (&value, x) in values.iter().zip(&mut x).rev() {
            let symbol = table.symbol(value);
            *flags |= symbol.flags;
            let full = *x >= symbol.limit;
            words = select_unpredictable(full, words << 16 | u64::from(*x as u16), words);
            *x = select_unpredictable(full, *x >> 16, *x);
            used += 2 * usize::from(full);
            *x = symbol.push(*x);
        }
        // The last word emitted is the first read: it lies in the low bits, at the lowest place.
        let place = free.last_chunk_mut::<8>()?;
        *place = words.wrapping_shl(64 - 8 * used as u32).to_le_bytes();
        let kept = free.len() - used;
        free = core::mem::take(&mut free).get_mut(..kept)?;
        Some(())
    };
    if !over.is_empty() {
        group(over)?;
    }
    for quad in quads.iter().rev() {
        group(quad)?;
    }
    let at = free.len();
    x.rotate_right(start % LANES);
    *state = x;
    Some(at)
}

/// Writes head, escapes and plane around the words that end at `words_end`.
fn finish(
    source: &Source<'_>,
    groups: usize,
    state: [u32; LANES],
    words_end: usize,
    escapes: usize,
    out: &mut [u8],
) -> Result<Encoded> {
    let raw_bits: usize = source.forwards().map(|(values, t)| values.len() * usize::from(t.raw_bits)).sum();
    let lengths = state.map(u32::ilog2);
    let plane_bits = raw_bits + lengths.iter().map(|&bits| bits as usize).sum::<usize>();
    let plane_start = words_end + 2 * escapes;
    let len = plane_start + plane_bits.div_ceil(8);
    let room = out.len();
    let out = out.get_mut(..len).ok_or(full(room))?;
    let packed = lengths.iter().rev().fold(0u16, |packed, &bits| packed << 4 | (bits - LOW_BITS) as u16);
    let [low, high] = packed.to_le_bytes();
    out[..HEAD_BYTES].copy_from_slice(&[groups as u8, low, high]);
    let (stream, plane) = out.split_at_mut(plane_start);
    if escapes > 0 {
        let mut places = stream.rchunks_exact_mut(2);
        for (values, table) in source.forwards() {
            for (value, place) in values.iter().filter(|&&v| table.symbol(v).escaped()).zip(&mut places) {
                place.copy_from_slice(&value.to_le_bytes());
            }
        }
    }
    let mut bits = Bits { plane, held: 0, count: 0, at: 0 };
    for (values, table) in source.forwards().filter(|(_, table)| table.raw_bits > 0) {
        let mask = (1u16 << table.raw_bits) - 1;
        for &value in values {
            // An escaped value's raw bits are zero: there is one encoding of each packet.
            let low = if escapes > 0 && table.symbol(value).escaped() { 0 } else { value as u16 & mask };
            bits.put(low.into(), table.raw_bits.into());
        }
    }
    for (x, length) in state.into_iter().zip(lengths) {
        bits.put(x & !(1 << length), length);
    }
    bits.flush();
    Ok(Encoded { len, escapes, raw_bits })
}

/// Bits into bytes, low bits first.
struct Bits<'a> {
    plane: &'a mut [u8],
    held: u64,
    count: u32,
    at: usize,
}

impl Bits<'_> {
    /// Appends `bits` ≤ 31 bits.
    #[inline(always)]
    fn put(&mut self, value: u32, bits: u32) {
        self.held |= u64::from(value) << self.count;
        self.count += bits;
        if self.count >= 32 {
            if let Some(place) = self.plane.get_mut(self.at..self.at + 4) {
                place.copy_from_slice(&(self.held as u32).to_le_bytes());
            }
            self.at += 4;
            self.held >>= 32;
            self.count -= 32;
        }
    }

    fn flush(self) {
        for (place, byte) in self.plane.iter_mut().skip(self.at).zip(self.held.to_le_bytes()) {
            *place = byte;
        }
    }
}
