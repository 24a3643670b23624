//! A packet to decode, and its decoding by the scalar decoder.

use codec_core::{
    Error, Result,
    internals::rans::{
        lanes::{Decoder, TableRun},
        table::SLOTS,
    },
};

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
    pub(crate) fn table(&self, index: u8) -> Result<(&'a [u32; SLOTS], u8)> {
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
    pub runs: &'a [TableRun],
    /// Where its values go; what it holds after an error does not matter.
    pub out: &'a mut [i16],
    /// What became of it; set by [`decode_many_with`](crate::decode_many_with).
    pub result: Result<()>,
}

impl<'a> Job<'a> {
    /// A packet not yet decoded.
    pub fn new(body: &'a [u8], runs: &'a [TableRun], out: &'a mut [i16]) -> Self {
        Self { body, runs, out, result: Ok(()) }
    }
}

/// A decoder of a packet's body, once its runs are known to fit.
pub(crate) fn open<'a>(
    tables: &Tables<'_>,
    body: &'a [u8],
    runs: &[TableRun],
    len: usize,
) -> Result<Decoder<'a>> {
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
pub(crate) fn decode(tables: &Tables<'_>, job: &mut Job<'_>) -> Result<()> {
    let mut decoder = open(tables, job.body, job.runs, job.out.len())?;
    let mut rest = &mut *job.out;
    for run in job.runs {
        let (slots, raw_bits) = tables.table(run.table)?;
        let (have, need) = (rest.len(), run.len);
        let halves = rest.split_at_mut_checked(need);
        let (values, tail) = halves.ok_or_else(|| Error::short("body.values", 0, have, need))?;
        rest = tail;
        decoder.run(slots, raw_bits, values)?;
    }
    decoder.finish()
}
