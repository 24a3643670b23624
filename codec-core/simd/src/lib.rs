//! Several packets at once, for hosts that receive many: the four-lane rANS decoder of
//! [`codec_core::internals::rans::lanes`] over 8 packets in AVX2 or 16 in AVX-512.
//!
//! Packets need no common table, length or run list: each keeps its own place in its own runs, and
//! one that is done makes room for the next. What the vectors do is pop tokens of whole groups of
//! four values, from words and from what the states keep, and put raw bits behind them; everything
//! else (escapes, the last values of all, every check) is the scalar decoder's, which takes over
//! where they stop. A packet that is refused is decoded again by
//! the scalar decoder, so that its error is the scalar one.
//!
//! The instruction set is found at run time; without one the scalar decoder does all of it. All
//! `unsafe` of the codec is in the kernels here.

mod batch;
mod bundle;
mod crc;
mod kernel;
mod repair;

use codec_core::{
    Error, Result,
    internals::rans::{
        lanes::{Decoder, Run},
        table::SLOTS,
    },
};

pub use batch::BatchReceiver;
pub use crc::crc32;
pub use kernel::Kernel;
pub use repair::{combine, combines};

/// Decode tables of a stream.
#[derive(Clone, Copy, Debug)]
pub struct Tables<'a> {
    /// Slots of each table, as [`codec_core::internals::rans::table::Table::fill_slots`] fills them; slots of
    /// any other kind give wrong values or errors, nothing worse.
    pub slots: &'a [[u32; SLOTS]],
    /// Raw bits per value of each table.
    pub raw_bits: &'a [u8],
}

impl<'a> Tables<'a> {
    /// Slots and raw bits of table `index`.
    ///
    /// # Errors
    /// [`ErrorKind::Illegal`](codec_core::ErrorKind::Illegal) if there is no such table.
    fn table(&self, index: u8) -> Result<(&'a [u32; SLOTS], u8)> {
        let i = usize::from(index);
        let count = self.slots.len().min(self.raw_bits.len()) as u64;
        let missing = Error::illegal("table", 0, index.into(), (0, count.saturating_sub(1)));
        self.slots.get(i).zip(self.raw_bits.get(i).copied()).ok_or(missing)
    }
}

/// One packet to decode.
#[derive(Debug)]
pub struct Job<'a> {
    /// The body.
    pub body: &'a [u8],
    /// Its runs, in order; together as long as `out`.
    pub runs: &'a [Run],
    /// Where its values go; what it holds after an error does not matter.
    pub out: &'a mut [i16],
    /// What became of it; set by [`decode_many`].
    pub result: Result<()>,
}

impl<'a> Job<'a> {
    /// A packet not yet decoded.
    pub fn new(body: &'a [u8], runs: &'a [Run], out: &'a mut [i16]) -> Self {
        Self { body, runs, out, result: Ok(()) }
    }
}

/// Decodes `jobs` with the best kernel of this machine.
pub fn decode_many(tables: &Tables<'_>, jobs: &mut [Job<'_>]) {
    decode_many_with(Kernel::best(), tables, jobs);
}

/// Decodes `jobs` with `kernel`; with the scalar one if this machine lacks it.
pub fn decode_many_with(kernel: Kernel, tables: &Tables<'_>, jobs: &mut [Job<'_>]) {
    match kernel.vectors() {
        Some(vectors) => bundle::decode(vectors, tables, jobs),
        None => jobs.iter_mut().for_each(|job| job.result = decode(tables, job)),
    }
}

/// A decoder of a packet's body, once its runs are known to fit.
fn open<'a>(tables: &Tables<'_>, body: &'a [u8], runs: &[Run], len: usize) -> Result<Decoder<'a>> {
    let (mut values, mut raw_bits) = (0usize, 0usize);
    for run in runs {
        let (_, k) = tables.table(run.table)?;
        values = values.saturating_add(run.len);
        raw_bits = raw_bits.saturating_add(run.len.saturating_mul(usize::from(k)));
    }
    if values != len {
        return Err(Error::illegal("body.values", 0, values as u64, (len as u64, len as u64)));
    }
    Decoder::new(body, values, raw_bits)
}

/// Decodes one packet by the scalar decoder.
fn decode(tables: &Tables<'_>, job: &mut Job<'_>) -> Result<()> {
    let mut decoder = open(tables, job.body, job.runs, job.out.len())?;
    let mut rest = &mut *job.out;
    for run in job.runs {
        let (slots, raw_bits) = tables.table(run.table)?;
        let whole = core::mem::take(&mut rest);
        let (values, tail) = whole.split_at_mut(run.len.min(whole.len()));
        rest = tail;
        decoder.run(slots, raw_bits, values)?;
    }
    decoder.finish()
}
