//! The slow, obvious coder that the fast one is tested against: searches the table for every
//! value, one value and one bit at a time, with wide integers and divisions.

use super::{LANES, LOW, TAIL_START};
use crate::{
    error::{Error, Result},
    rans::table::{ESCAPE, SCALE, Table},
};

/// Decodes `out.len()` values of `body`, value `i` with `tables[table_of[i]]`.
///
/// # Errors
/// [`ErrorKind::Short`](crate::ErrorKind::Short), whatever is wrong.
#[doc(hidden)]
pub fn decode(body: &[u8], table_of: &[u8], tables: &[Table], out: &mut [i16]) -> Result<()> {
    decode_all(body, table_of, tables, out).ok_or(Error::short("body", 0, body.len(), body.len() + 1))
}

fn bit(body: &[u8], from: usize, at: usize) -> Option<u64> {
    Some(u64::from(body.get(from + at / 8)? >> (at % 8) & 1))
}

fn decode_all(body: &[u8], table_of: &[u8], tables: &[Table], out: &mut [i16]) -> Option<()> {
    let n = out.len();
    let mut raw_bits = 0usize;
    for &table in table_of.iter().take(n) {
        raw_bits += usize::from(tables.get(usize::from(table))?.raw_bits());
    }
    let groups = usize::from(*body.first()?);
    if 4 * groups >= n + LANES {
        return None;
    }
    let mut lengths = [0usize; LANES];
    for (lane, length) in lengths.iter_mut().enumerate() {
        *length = 15 + usize::from(body.get(1 + lane / 2)? >> (4 * (lane % 2)) & 15);
    }
    let plane_bits = raw_bits + lengths.iter().sum::<usize>();
    let plane = body.len().checked_sub(plane_bits.div_ceil(8))?;
    let (mut word, mut escape) = (3usize, plane);
    if plane < word || (plane - word) % 2 == 1 {
        return None;
    }
    let mut at = raw_bits;
    let mut states = [0u64; LANES];
    for (state, length) in states.iter_mut().zip(lengths) {
        for i in 0..length {
            *state |= bit(body, plane, at)? << i;
            at += 1;
        }
        *state += 1 << length;
    }
    while !at.is_multiple_of(8) {
        if bit(body, plane, at)? != 0 {
            return None;
        }
        at += 1;
    }
    let mut at = 0usize;
    for (i, (value, &table)) in out.iter_mut().zip(table_of).enumerate() {
        let table = tables.get(usize::from(table))?;
        let x = &mut states[i % LANES];
        let slot = (*x % u64::from(SCALE)) as u32;
        let token =
            (0..=255u8).find(|&t| slot >= table.start(t) && slot < table.start(t) + table.frequency(t))?;
        *x = u64::from(table.frequency(token)) * (*x / u64::from(SCALE))
            + u64::from(slot - table.start(token));
        if i + 4 * groups < n && *x < u64::from(LOW) {
            let pair = body.get(word..word + 2)?;
            *x = *x << 16 | u64::from(pair[0]) | u64::from(pair[1]) << 8;
            word += 2;
        }
        let mut low = 0i32;
        for k in 0..table.raw_bits() {
            low |= (bit(body, plane, at)? as i32) << k;
            at += 1;
        }
        *value = if token == ESCAPE {
            if low != 0 {
                return None;
            }
            escape = escape.checked_sub(2)?;
            let pair = body.get(escape..escape + 2)?;
            i16::from_le_bytes([pair[0], pair[1]])
        } else {
            ((i32::from(token) - 128) * (1 << table.raw_bits()) + low) as i16
        };
    }
    let ends = |x: &u64| (TAIL_START..=LOW).any(|p| p.is_power_of_two() && *x == u64::from(p));
    (word == escape && states.iter().all(ends)).then_some(())
}

/// As [`super::encode`] with one table index per value, by divisions; the bytes are appended one
/// by one to `out` through `emit` only when they are all known.
///
/// # Errors
/// [`ErrorKind::Short`](crate::ErrorKind::Short) if a table does not know a value and has no
/// escape, or more than `N` words are due.
#[doc(hidden)]
pub fn encode<const N: usize>(
    values: &[i16],
    table_of: &[u8],
    tables: &[Table],
    mut emit: impl FnMut(u8),
) -> Result<()> {
    let refused = Error::short("body", 0, 0, 1);
    let n = values.len();
    let symbol = |i: usize| -> Result<(u64, u64, bool)> {
        let table = tables.get(usize::from(*table_of.get(i).ok_or(refused)?)).ok_or(refused)?;
        let token = table.code(*values.get(i).ok_or(refused)?);
        let f = u64::from(table.frequency(token));
        if f == 0 { Err(refused) } else { Ok((f, u64::from(table.start(token)), token == ESCAPE)) }
    };
    let push = |x: u64, (f, start, _): (u64, u64, bool)| (x / f) * 2048 + x % f + start;
    // The most groups of the packet's last values that leave every state below 2^31.
    let mut groups = 0usize;
    let mut states = [u64::from(TAIL_START); LANES];
    'grow: while groups < 255 && 4 * groups < n {
        let mut next = states;
        let last = n - 4 * groups;
        for i in (last.saturating_sub(4)..last).rev() {
            let symbol = symbol(i)?;
            if next[i % 4] >= symbol.0 << 20 {
                break 'grow;
            }
            next[i % 4] = push(next[i % 4], symbol);
        }
        states = next;
        groups += 1;
    }
    // The least start of each lane that lifts it to 2^15 over those groups.
    let main = n.saturating_sub(4 * groups);
    for (lane, state) in states.iter_mut().enumerate() {
        let mut start = u64::from(TAIL_START);
        while *state < u64::from(LOW) {
            start *= 2;
            *state = start;
            for i in (main..n).rev().filter(|i| i % 4 == lane) {
                *state = push(*state, symbol(i)?);
            }
        }
    }
    let (mut words, mut count) = ([0u16; N], 0usize);
    for i in (0..main).rev() {
        let symbol = symbol(i)?;
        let x = &mut states[i % 4];
        if *x >= symbol.0 << 20 {
            *words.get_mut(count).ok_or(refused)? = *x as u16;
            count += 1;
            *x >>= 16;
        }
        *x = push(*x, symbol);
    }
    emit(groups as u8);
    let lengths = states.map(u64::ilog2);
    for pair in lengths.chunks(2) {
        emit(((pair[0] - 15) | ((pair[1] - 15) << 4)) as u8);
    }
    for word in words.iter().take(count).rev() {
        word.to_le_bytes().into_iter().for_each(&mut emit);
    }
    for i in (0..n).rev() {
        if symbol(i)?.2 {
            values[i].to_le_bytes().into_iter().for_each(&mut emit);
        }
    }
    let (mut byte, mut filled) = (0u8, 0u32);
    let mut put = |bit: bool| {
        byte |= u8::from(bit) << filled;
        filled += 1;
        if filled == 8 {
            emit(byte);
            (byte, filled) = (0, 0);
        }
    };
    for (i, &value) in values.iter().enumerate() {
        let escaped = symbol(i)?.2;
        for k in 0..tables[usize::from(table_of[i])].raw_bits() {
            put(!escaped && value >> k & 1 == 1);
        }
    }
    for (state, length) in states.into_iter().zip(lengths) {
        (0..length).for_each(|k| put(state >> k & 1 == 1));
    }
    if filled > 0 {
        emit(byte);
    }
    Ok(())
}
