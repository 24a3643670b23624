//! The scalar decoder: safe, no heap, the same verdict on every target.

use core::hint::select_unpredictable;

use super::{LANES, LOW, Lookup, Parts, Raw, TAIL_START, turned};
use crate::{
    cursor::in_range,
    error::{Error, Result},
    rans::table::ESCAPE,
};

/// A decoder over one packet body.
#[derive(Clone, Copy, Debug)]
pub struct Decoder<'a> {
    /// Words, escapes and plane.
    body: &'a [u8],
    /// Offset of the next word.
    words: usize,
    /// End of the escapes not yet read.
    escapes: usize,
    /// States, that of the next value first.
    state: [u32; LANES],
    /// Values left before the tail.
    main: usize,
    /// Values left in the tail.
    tail: usize,
    raw: Raw<'a>,
}

/// The lanes of a [`Decoder`] between two values.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Lanes<'a> {
    /// Words, escapes and plane.
    pub bytes: &'a [u8],
    /// Offset of the next word in `bytes`.
    pub words: usize,
    /// States, that of the next value first.
    pub state: [u32; LANES],
    /// Values left before the tail.
    pub main: usize,
    /// Values left in the tail, which takes no words.
    pub tail: usize,
}

/// What is wrong with a body, not yet in words: an [`Error`] on its way takes stack.
#[derive(Clone, Copy)]
enum Fault {
    /// Words run out.
    Words,
    /// Fewer raw bits than these are left.
    Raw(usize),
    /// Escapes run out.
    Escapes,
    /// An escaped value has these raw bits.
    Bits(i16),
}

type FaultResult<T> = core::result::Result<T, Fault>;

impl<'a> Decoder<'a> {
    /// A decoder of `body`, which holds `values` values with `raw_bits` raw bits between them.
    ///
    /// # Errors
    /// As [`Parts::of`].
    pub fn new(body: &'a [u8], values: usize, raw_bits: usize) -> Result<Self> {
        let parts = Parts::of(body, values, raw_bits)?;
        Ok(Self {
            body: parts.body,
            words: 0,
            escapes: parts.stream,
            state: parts.state,
            main: parts.main,
            tail: parts.tail,
            raw: Raw::new(parts.plane, raw_bits),
        })
    }

    /// Decodes the next `out.len()` values with `table` and its `raw_bits`.
    ///
    /// # Errors
    /// [`ErrorKind::Short`](crate::ErrorKind::Short) if values, words, raw bits or escapes run
    /// out, [`ErrorKind::Illegal`](crate::ErrorKind::Illegal) for an escape with raw bits.
    pub fn run<L: Lookup + ?Sized>(&mut self, table: &L, raw_bits: u8, out: &mut [i16]) -> Result<()> {
        // Wide registers take the words of four lanes at once; narrow ones word by word, and where
        // they are narrow the stack is short.
        if cfg!(target_pointer_width = "64") {
            self.run_as::<L, true, 256>(table, raw_bits, out)
        } else {
            self.run_as::<L, false, 32>(table, raw_bits, out)
        }
    }

    /// `PART` values between two passes: tokens first, then raw bits and escapes while they are in
    /// cache. It decides which of several faults of a body is named, never whether one is.
    pub(super) fn run_as<L: Lookup + ?Sized, const WIDE: bool, const PART: usize>(
        &mut self,
        table: &L,
        raw_bits: u8,
        out: &mut [i16],
    ) -> Result<()> {
        let left = self.main + self.tail;
        if out.len() > left {
            return Err(Error::short("body.values", 0, left, out.len()));
        }
        let mut tokens = [0u8; PART];
        for part in out.chunks_mut(PART) {
            let tokens = &mut tokens[..part.len()];
            self.part::<L, WIDE>(table, raw_bits, tokens, part).map_err(|fault| self.refuse(fault))?;
        }
        Ok(())
    }

    #[inline(always)]
    fn part<L: Lookup + ?Sized, const WIDE: bool>(
        &mut self,
        table: &L,
        raw_bits: u8,
        tokens: &mut [u8],
        out: &mut [i16],
    ) -> FaultResult<()> {
        let (main, tail) = tokens.split_at_mut(self.main.min(tokens.len()));
        self.main -= main.len();
        self.tail -= tail.len();
        let whole = if WIDE { self.wide(table, main) } else { self.narrow(table, main) };
        if whole.is_none() || self.words > self.escapes {
            return Err(Fault::Words);
        }
        self.keep(table, tail);
        self.raw.values(raw_bits, tokens, out).ok_or(Fault::Raw(out.len() * usize::from(raw_bits)))?;
        self.escape(raw_bits, tokens, out)
    }

    /// What `fault` is in words.
    #[cold]
    #[inline(never)]
    fn refuse(&self, fault: Fault) -> Error {
        match fault {
            Fault::Words => Error::short("body.words", 0, self.escapes, self.escapes + 2),
            Fault::Raw(needed) => self.raw.short(needed),
            Fault::Escapes => Error::short("body.escapes", 0, 0, 2),
            Fault::Bits(raw) => Error::illegal("body.raw", 0, raw as u64, (0, 0)),
        }
    }

    /// Tokens, the words of four lanes from one load. `None` past the end of the body.
    #[inline(always)]
    fn wide<L: Lookup + ?Sized>(&mut self, table: &L, out: &mut [u8]) -> Option<()> {
        let mut state = self.state;
        let mut rest = self.body.get(self.words..)?;
        let mut quads = out.chunks_exact_mut(LANES);
        for quad in &mut quads {
            let (words, _) = rest.first_chunk::<8>()?.as_chunks::<2>();
            let words = words.first_chunk::<LANES>()?;
            let mut used = 0;
            for (value, x) in quad.iter_mut().zip(&mut state) {
                let (token, below) = table.pop(*x);
                *value = token;
                let refill = below < LOW;
                let word = u32::from(u16::from_le_bytes(words[used % LANES]));
                *x = select_unpredictable(refill, below << 16 | word, below);
                used += usize::from(refill);
            }
            rest = rest.get(2 * used..)?;
        }
        self.state = state;
        self.words = self.body.len() - rest.len();
        self.narrow(table, quads.into_remainder())
    }

    /// Tokens, word by word. `None` past the end of the body.
    #[inline(always)]
    fn narrow<L: Lookup + ?Sized>(&mut self, table: &L, out: &mut [u8]) -> Option<()> {
        let mut state = self.state;
        let mut rest = self.body.get(self.words..)?;
        let mut refill = |below: u32| {
            if below >= LOW {
                return Some(below);
            }
            let (word, after) = rest.split_first_chunk::<2>()?;
            rest = after;
            Some(below << 16 | u32::from(u16::from_le_bytes(*word)))
        };
        let mut quads = out.chunks_exact_mut(LANES);
        for quad in &mut quads {
            for (value, x) in quad.iter_mut().zip(&mut state) {
                let (token, below) = table.pop(*x);
                *value = token;
                *x = refill(below)?;
            }
        }
        let over = quads.into_remainder();
        for (value, x) in over.iter_mut().zip(&mut state) {
            let (token, below) = table.pop(*x);
            *value = token;
            *x = refill(below)?;
        }
        let state = turned(state, over.len());
        self.words = self.body.len() - rest.len();
        self.state = state;
        Some(())
    }

    /// Tokens that the states keep: no words.
    fn keep<L: Lookup + ?Sized>(&mut self, table: &L, out: &mut [u8]) {
        for quad in out.chunks_mut(LANES) {
            for (value, x) in quad.iter_mut().zip(&mut self.state) {
                (*value, *x) = table.pop(*x);
            }
            self.state = turned(self.state, quad.len());
        }
    }

    /// Escaped values among `out`, the values of `tokens`.
    #[inline]
    fn escape(&mut self, raw_bits: u8, tokens: &[u8], out: &mut [i16]) -> FaultResult<()> {
        // Over all tokens, so that it is done many at a time.
        if has_escape(tokens) { self.some(raw_bits, tokens, out) } else { Ok(()) }
    }

    #[cold]
    fn some(&mut self, raw_bits: u8, tokens: &[u8], out: &mut [i16]) -> FaultResult<()> {
        // Few tokens are escapes: most groups of lanes hold none.
        const SOME: usize = 64;
        for (tokens, out) in tokens.chunks(SOME).zip(out.chunks_mut(SOME)) {
            if has_escape(tokens) {
                self.replace(raw_bits, out)?;
            }
        }
        Ok(())
    }

    /// Escaped values for those of `out` that the escape token gave.
    fn replace(&mut self, raw_bits: u8, out: &mut [i16]) -> FaultResult<()> {
        const TOKEN: i16 = ESCAPE as i16 - 128;
        let raw_bits = raw_bits & 15;
        for value in out.iter_mut().filter(|value| **value >> raw_bits == TOKEN) {
            *value = self.escaped(value.wrapping_sub(TOKEN << raw_bits))?;
        }
        Ok(())
    }

    /// The next escaped value, whose raw bits are `raw`.
    #[cold]
    #[inline(never)]
    fn escaped(&mut self, raw: i16) -> FaultResult<i16> {
        if raw != 0 {
            return Err(Fault::Bits(raw));
        }
        let unread = self.body.get(self.words..self.escapes).and_then(|b| b.split_last_chunk::<2>());
        let Some((_, bytes)) = unread else {
            return Err(Fault::Escapes);
        };
        self.escapes -= 2;
        Ok(i16::from_le_bytes(*bytes))
    }

    /// Where the decoder stands, for one that takes several packets at once.
    pub fn lanes(&self) -> Lanes<'a> {
        Lanes { bytes: self.body, words: self.words, state: self.state, main: self.main, tail: self.tail }
    }

    /// Takes over from a decoder of several packets that popped the tokens of `values` values,
    /// whole groups of four: `state` and `words` as it left them. Those tokens then go through
    /// [`Decoder::values_by`].
    ///
    /// # Errors
    /// [`ErrorKind::Short`](crate::ErrorKind::Short) if it took more values or words than there are.
    pub fn resume(&mut self, state: [u32; LANES], words: usize, values: usize) -> Result<()> {
        let main = self.main.min(values);
        let Some(tail) = self.tail.checked_sub(values - main) else {
            return Err(Error::short("body.values", 0, self.main + self.tail, values));
        };
        (self.state, self.words, self.main, self.tail) = (state, words, self.main - main, tail);
        if words > self.escapes {
            return Err(Error::short("body.words", 0, self.escapes, self.escapes + 2));
        }
        Ok(())
    }

    /// Values of tokens that another decoder popped, all with the same `raw_bits`; the first of
    /// them by `wide`, as [`Raw::values_by`] says.
    ///
    /// # Errors
    /// As [`Decoder::run`].
    #[inline]
    pub fn values_by(
        &mut self,
        raw_bits: u8,
        tokens: &[u8],
        out: &mut [i16],
        wide: impl FnOnce(&[u8], usize, &[u8], &mut [i16]) -> usize,
    ) -> Result<()> {
        let spread = self.raw.values_by(raw_bits, tokens, out, wide);
        let spread = spread.ok_or(Fault::Raw(tokens.len() * usize::from(raw_bits)));
        spread.and_then(|()| self.escape(raw_bits, tokens, out)).map_err(|fault| self.refuse(fault))
    }

    /// Accepts the body if it is used up and every lane ends where an encoder begins.
    ///
    /// # Errors
    /// [`ErrorKind::Illegal`](crate::ErrorKind::Illegal) naming what is left over.
    pub fn finish(self) -> Result<()> {
        let left = (self.main + self.tail) as u64;
        if left != 0 {
            return Err(Error::illegal("body.values", 0, left, (0, 0)));
        }
        for state in self.state {
            // In place of what is no power of two the one below it is allowed.
            let power = (1 << state.checked_ilog2().unwrap_or(0)).clamp(TAIL_START, LOW);
            in_range("body.state", 0, state, power, power)?;
        }
        if self.words != self.escapes {
            let left = (self.escapes - self.words) as u64;
            return Err(Error::illegal("body.words", 0, left, (0, 0)));
        }
        if !self.raw.is_used_up() {
            return Err(Error::illegal("body.raw", 0, 1, (0, 0)));
        }
        Ok(())
    }
}

fn has_escape(tokens: &[u8]) -> bool {
    tokens.iter().fold(false, |any, &token| any | (token == ESCAPE))
}
