//! The encoder: reciprocals instead of divisions, words of four lanes in one store.

use core::hint::select_unpredictable;

use super::{HEAD_BYTES, LANES, LOW, LOW_BITS, TAIL_START, turned};
use crate::{
    error::{Error, ErrorKind, Result},
    rans::table::{ESCAPE, PRECISION, SCALE, Table},
};

/// Most groups of four values that the states keep: what fits the tail byte.
const MAX_GROUPS: usize = u8::MAX as usize;

/// What one token does to a state: `x → (x / f << 11) + x mod f + start`, without dividing.
#[derive(Clone, Copy, Debug, Default)]
struct Symbol {
    /// `f << 20`: a state from here on gives up a word first.
    limit: u32,
    /// `ceil(2^(31 + s) / f)` with `2^s` the least power of two of `f` or more.
    reciprocal: u32,
    /// Added to the state: `start`, corrected for `f = 1`.
    bias: u16,
    /// `2048 − f`, times the quotient.
    complement: u16,
    /// `31 + s` in the low six bits, and whether the value travels as an escape.
    shift: u32,
}

/// Flag of a token whose value travels as an escape, beside its shift.
const ESCAPED: u32 = 1 << 8;

impl Symbol {
    fn of(table: &Table, token: u8) -> Self {
        let escaped = token == ESCAPE || table.frequency(token) == 0;
        let token = if escaped { ESCAPE } else { token };
        let (f, start) = (table.frequency(token), table.start(token));
        let complement = SCALE.saturating_sub(f) as u16;
        let (reciprocal, bias, shift) = match f {
            0 => (0, 0, 32),
            // 2^32 / 1 does not fit: x · (2^32 − 1) >> 32 is x − 1, and the bias makes up for it.
            1 => (u32::MAX, start + SCALE - 1, 32),
            _ => {
                let s = f.next_power_of_two().ilog2();
                ((1u64 << (s + 31)).div_ceil(u64::from(f)) as u32, start, s + 31)
            }
        };
        let shift = shift | if escaped { ESCAPED } else { 0 };
        Self { limit: f << (31 - PRECISION), reciprocal, bias: bias as u16, complement, shift }
    }

    const fn escaped(&self) -> bool {
        self.shift & ESCAPED != 0
    }

    #[inline(always)]
    fn push(&self, x: u32) -> u32 {
        // A shift takes its count modulo 64, as machines do.
        let quotient = (u64::from(x) * u64::from(self.reciprocal)).wrapping_shr(self.shift) as u32;
        x.wrapping_add(u32::from(self.bias)).wrapping_add(quotient.wrapping_mul(u32::from(self.complement)))
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
pub struct TableRun {
    /// Index of the table.
    pub table: u8,
    /// Number of values.
    pub len: usize,
}

fn full(room: usize) -> Error {
    Error::short("body", 0, room, room + 1).kind(ErrorKind::Capacity)
}

/// The values of one packet, run by run. Invariant: runs are together as long as the values, and there is
/// a table for each.
struct Source<'a> {
    values: &'a [i16],
    runs: &'a [TableRun],
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

    /// The source of these, if there is a table for every run and a code for every value.
    fn new(values: &'a [i16], runs: &'a [TableRun], tables: &'a [Symbols]) -> Result<Self> {
        let (mut at, mut rest) = (0usize, values);
        for run in runs {
            let Some(table) = tables.get(usize::from(run.table)) else {
                let most = tables.len().saturating_sub(1) as u64;
                return Err(Error::illegal("encode.table", at, run.table.into(), (0, most)));
            };
            let Some((own, after)) = rest.split_at_checked(run.len) else {
                let (found, all) = (at as u64 + run.len as u64, values.len() as u64);
                return Err(Error::illegal("encode.runs", 0, found, (all, all)));
            };
            // A table whose escape has no frequency must know every value.
            if table.of[usize::from(ESCAPE)].limit == 0
                && let Some(i) = own.iter().position(|&v| table.symbol(v).escaped())
            {
                return Err(Error::illegal("encode.escape", at + i, 0, (1, u64::from(SCALE))));
            }
            (at, rest) = (at + run.len, after);
        }
        if !rest.is_empty() {
            let (found, all) = (at as u64, values.len() as u64);
            return Err(Error::illegal("encode.runs", 0, found, (all, all)));
        }
        Ok(Self { values, runs, tables })
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
    let mut most = n.div_ceil(LANES).min(MAX_GROUPS);
    loop {
        let mut state = start;
        let mut symbols = source.symbols();
        let mut groups = 0;
        'groups: while groups < most {
            let mut next = state;
            // The group of values n − 4 (groups + 1) .. n − 4 groups, the last first.
            let last = n - LANES * groups;
            for (i, symbol) in (last.saturating_sub(LANES)..last).rev().zip(&mut symbols) {
                let x = &mut next[i % LANES];
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
pub fn encode(values: &[i16], runs: &[TableRun], tables: &[Symbols], out: &mut [u8]) -> Result<Encoded> {
    let source = Source::new(values, runs, tables)?;
    let Tail { groups, mut state } = keep(&source);
    let main = values.len().saturating_sub(LANES * groups);
    let room = out.len();
    let mut free = out.get_mut(HEAD_BYTES..).ok_or(full(room))?;
    let mut escapes = 0;
    for (start, values, table) in source.backwards() {
        let (values, tail) = values.split_at(main.saturating_sub(start).min(values.len()));
        for &value in tail.iter().rev().filter(|&&v| table.symbol(v).escaped()) {
            free = escape(free, value, &mut escapes).ok_or(full(room))?;
        }
        free = push_run(table, start, values, &mut state, free, &mut escapes).ok_or(full(room))?;
    }
    let words = room - HEAD_BYTES - 2 * escapes - free.len();
    let stream = out.get_mut(HEAD_BYTES..).ok_or(full(room))?;
    stream.copy_within(room - HEAD_BYTES - words.., 2 * escapes);
    if escapes > 0 {
        stream[..words + 2 * escapes].rotate_left(2 * escapes);
    }
    finish(&source, groups, state, HEAD_BYTES + words, escapes, out)
}

/// Notes an escaped value at the front of `free`, behind those noted before; what is free then.
#[cold]
fn escape<'o>(free: &'o mut [u8], value: i16, escapes: &mut usize) -> Option<&'o mut [u8]> {
    let (place, free) = free.split_first_chunk_mut()?;
    *place = value.to_le_bytes();
    *escapes += 1;
    Some(free)
}

/// Quads of values whose tokens are looked up at once.
const QUADS: usize = 64;

/// Pushes a run whose first value has index `start`: words from the end of `free` backwards,
/// escaped values from its front on; what is free then.
#[inline]
fn push_run<'o>(
    table: &Symbols,
    start: usize,
    values: &[i16],
    state: &mut [u32; LANES],
    mut free: &'o mut [u8],
    escapes: &mut usize,
) -> Option<&'o mut [u8]> {
    // Lanes turned so that the run's first value is on lane 0.
    let mut x = turned(*state, start);
    let (quads, over) = values.as_chunks::<LANES>();
    for (&value, x) in over.iter().zip(&mut x).rev() {
        let symbol = table.symbol(value);
        if symbol.escaped() {
            free = escape(free, value, escapes)?;
        }
        if *x >= symbol.limit {
            let (rest, place) = free.split_last_chunk_mut()?;
            *place = (*x as u16).to_le_bytes();
            *x >>= 16;
            free = rest;
        }
        *x = symbol.push(*x);
    }
    let mut tokens = [[0u8; LANES]; QUADS];
    for quads in quads.rchunks(QUADS) {
        let tokens = tokens.get_mut(..quads.len())?;
        for (token, &value) in tokens.as_flattened_mut().iter_mut().zip(quads.as_flattened()) {
            *token = Table::token(value, table.raw_bits & 15);
        }
        for (tokens, values) in tokens.iter().zip(quads).rev() {
            // The last word given up is the first read: it lies lowest. A place is written before
            // it is known to be needed, and again if it was not.
            let (places, _) = free.last_chunk_mut::<8>()?.as_chunks_mut::<2>();
            let places = places.first_chunk_mut::<LANES>()?;
            let (mut last, mut shifts) = (LANES - 1, 0);
            for (&token, x) in tokens.iter().zip(&mut x).rev() {
                let symbol = &table.of[usize::from(token)];
                places[last % LANES] = (*x as u16).to_le_bytes();
                let full = *x >= symbol.limit;
                last = last.wrapping_sub(usize::from(full));
                *x = symbol.push(select_unpredictable(full, *x >> 16, *x));
                shifts |= symbol.shift;
            }
            let words = (LANES - 1).wrapping_sub(last);
            free = free.split_at_mut_checked(free.len().wrapping_sub(2 * words))?.0;
            if shifts & ESCAPED != 0 {
                for &value in values.iter().rev().filter(|&&v| table.symbol(v).escaped()) {
                    free = escape(free, value, escapes)?;
                }
            }
        }
    }
    *state = turned(x, LANES - start % LANES);
    Some(free)
}

/// Writes head and plane around the words, which end at `words_end`, and the escapes behind them.
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
    let plane = out.get_mut(plane_start..).ok_or(full(room))?;
    let mut bits = Bits { plane, pending: 0, count: 0 };
    for (values, table) in source.forwards().filter(|(_, table)| table.raw_bits > 0) {
        let (k, mask) = (u32::from(table.raw_bits), (1u16 << table.raw_bits) - 1);
        // An escaped value's raw bits are zero: there is one encoding of each packet.
        let low =
            |v: i16| if escapes > 0 && table.symbol(v).escaped() { 0 } else { u32::from(v as u16 & mask) };
        let (quads, rest) = values.as_chunks::<LANES>();
        for &[a, b, c, d] in quads {
            bits.put(low(a) | low(b) << k | low(c) << (2 * k) | low(d) << (3 * k), 4 * k)
                .ok_or(full(room))?;
        }
        for &value in rest {
            bits.put(low(value), k).ok_or(full(room))?;
        }
    }
    for (x, length) in state.into_iter().zip(lengths) {
        bits.put(x & !(1 << length), length).ok_or(full(room))?;
    }
    bits.flush().ok_or(full(room))?;
    Ok(Encoded { len, escapes, raw_bits })
}

/// Bits into bytes, low bits first.
struct Bits<'a> {
    /// Bytes not yet written.
    plane: &'a mut [u8],
    /// Bits not yet written.
    pending: u64,
    count: u32,
}

impl Bits<'_> {
    /// Appends `bits` ≤ 32 bits; `None` past the end of the plane.
    #[inline(always)]
    fn put(&mut self, value: u32, bits: u32) -> Option<()> {
        self.pending |= u64::from(value) << self.count;
        self.count += bits;
        if self.count >= 32 {
            let (place, rest) = core::mem::take(&mut self.plane).split_first_chunk_mut()?;
            *place = (self.pending as u32).to_le_bytes();
            self.plane = rest;
            self.pending >>= 32;
            self.count -= 32;
        }
        Some(())
    }

    /// Writes the last bits; `None` past the end of the plane.
    fn flush(self) -> Option<()> {
        let used = self.plane.get_mut(..self.count.div_ceil(8) as usize)?;
        for (place, byte) in used.iter_mut().zip(self.pending.to_le_bytes()) {
            *place = byte;
        }
        Some(())
    }
}
