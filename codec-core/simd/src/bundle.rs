//! Takes packets into lockstep and out of it again. Safe code.

use codec_core::{
    Error, Result,
    internals::rans::lanes::{Decoder, LANES, LOW, TableRun},
};

use crate::{
    job::{Job, Tables, decode as decode_alone, open},
    kernel::Vectors,
    lockstep::{BUFFER_BYTES, Lockstep, MAX_BYTES, MAX_PACKETS, MAX_STEPS},
};

/// A packet in lockstep.
struct Seat<'a> {
    /// Index of its job.
    job: usize,
    decoder: Decoder<'a>,
    /// Runs not yet done.
    runs: &'a [TableRun],
    /// Values of the first of them that are done.
    into: usize,
    /// Values done.
    done: usize,
    /// Runs whose tables are not all laid out yet, and values of the first that are.
    ahead: (&'a [TableRun], usize),
    /// Whole groups of four values left.
    left: usize,
    /// Groups in which every lane takes words, from the next on.
    plain: usize,
    /// First of the popped groups that have not become values yet.
    from: usize,
}

impl<'a> Seat<'a> {
    /// A seat for job `index`, its words in `bytes`; `None` if it is too long for them.
    fn take(
        index: usize,
        job: &Job<'a>,
        decoder: Decoder<'a>,
        bytes: &mut [u8; BUFFER_BYTES],
    ) -> Option<Self> {
        let lanes = decoder.lanes();
        if lanes.bytes.len() > MAX_BYTES {
            return None;
        }
        bytes.get_mut(..lanes.bytes.len())?.copy_from_slice(lanes.bytes);
        let left = (lanes.main + lanes.tail) / LANES;
        let plain = lanes.main / LANES;
        let runs = job.runs;
        Some(Self { job: index, decoder, runs, into: 0, done: 0, ahead: (runs, 0), left, plain, from: 0 })
    }

    /// Lays out the tables of its groups from group `at` to the last of a flush, or its own last.
    fn lay(&mut self, p: usize, at: usize, tables: &mut [[[u8; LANES]; MAX_PACKETS]]) {
        let (mut runs, mut into) = self.ahead;
        let mut rows = tables.iter_mut().skip(at).take(self.left).filter_map(|row| row.get_mut(p));
        while let Some((run, later)) = runs.split_first() {
            let whole = (run.len - into) / LANES;
            let laid = rows.by_ref().take(whole).fold(0, |laid, row| {
                *row = [run.table; LANES];
                laid + 1
            });
            into += LANES * laid;
            if laid < whole {
                break;
            }
            if into == run.len {
                (runs, into) = (later, 0);
                continue;
            }
            // The group that the run ends in.
            let Some(row) = rows.next() else { break };
            for table in row {
                while let Some((_, later)) = runs.split_first().filter(|(run, _)| run.len == into) {
                    (runs, into) = (later, 0);
                }
                *table = runs.first().map_or(0, |run| run.table);
                into += 1;
            }
        }
        self.ahead = (runs, into);
    }

    /// Takes over the tokens of whole groups that the vectors popped, if they lie where they should.
    fn advance(
        &mut self,
        vectors: Vectors,
        tables: &Tables<'_>,
        state: [u32; LANES],
        words: usize,
        tokens: Option<&[u8]>,
        out: &mut [i16],
    ) -> Result<()> {
        let mut tokens = tokens.ok_or(Error::short("body.values", 0, self.done, self.done + 1))?;
        self.decoder.resume(state, words, tokens.len())?;
        while let (false, Some(run)) = (tokens.is_empty(), self.runs.first()) {
            let (_, raw_bits) = tables.table(run.table)?;
            // All runs on end that have as many raw bits.
            let mut len = 0;
            while let (true, Some((run, later))) = (len < tokens.len(), self.runs.split_first()) {
                if tables.table(run.table)?.1 != raw_bits {
                    break;
                }
                let some = (run.len - self.into).min(tokens.len() - len);
                (len, self.into) = (len + some, self.into + some);
                if self.into == run.len {
                    (self.runs, self.into) = (later, 0);
                }
            }
            let (popped, rest) = tokens.split_at(len);
            let end = self.done + popped.len();
            let have = out.len();
            let place = out.get_mut(self.done..end);
            let place = place.ok_or_else(|| Error::short("body.values", 0, have, end))?;
            let wide = |plane: &[u8], bit, tokens: &[u8], out: &mut [i16]| {
                vectors.spread(raw_bits, plane, bit, tokens, out)
            };
            self.decoder.values_by(raw_bits, popped, place, wide)?;
            self.done = end;
            tokens = rest;
        }
        Ok(())
    }

    /// Decodes what is left by the scalar decoder.
    fn finish(mut self, tables: &Tables<'_>, out: &mut [i16]) -> Result<()> {
        let have = out.len();
        let too_small = || Error::short("body.values", 0, have, have + 1);
        let mut rest = out.get_mut(self.done..).ok_or_else(too_small)?;
        for run in self.runs {
            let (slots, raw_bits) = tables.table(run.table)?;
            let left = run.len - core::mem::take(&mut self.into);
            let (values, later) = rest.split_at_mut_checked(left).ok_or_else(too_small)?;
            rest = later;
            self.decoder.run(slots, raw_bits, values)?;
        }
        self.decoder.finish()
    }
}

/// Decodes `jobs`, as many at once as `vectors` take.
pub(crate) fn decode(vectors: Vectors, tables: &Tables<'_>, jobs: &mut [Job<'_>]) {
    let mut lockstep = Box::new(Lockstep {
        state: [[LOW; LANES]; MAX_PACKETS],
        tables: [[[0; LANES]; MAX_PACKETS]; MAX_STEPS],
        left: [[0; LANES]; MAX_PACKETS],
        words: [0; MAX_PACKETS],
        tokens: [[0; LANES * MAX_STEPS]; MAX_PACKETS],
        bytes: [[0; BUFFER_BYTES]; MAX_PACKETS],
    });
    let mut seats: [Option<Seat<'_>>; MAX_PACKETS] = [const { None }; MAX_PACKETS];
    let mut waiting = 0..jobs.len();
    // Groups popped since the last flush of all.
    let mut at = 0;
    loop {
        let (mut steps, mut plain) = (MAX_STEPS - at, MAX_STEPS);
        let mut seated = 0;
        for (p, seat) in seats.iter_mut().enumerate().take(vectors.packets) {
            if seat.as_ref().is_none_or(|seat| seat.left == 0) {
                renew(tables, jobs, &mut waiting, seat, &mut lockstep, p, at);
            }
            if let Some(seat) = seat {
                seated += 1;
                steps = steps.min(seat.left);
                plain = plain.min(seat.plain);
            }
        }
        // A few packets are done sooner one by one.
        if seated * 5 <= vectors.packets {
            break;
        }
        // Whole fours of groups are popped faster.
        let plain = if plain < steps { plain / 4 * 4 } else { steps };
        if plain > 0 {
            steps = plain;
        }
        vectors.run(tables.slots, at, steps, plain == 0, &mut lockstep);
        at += steps;
        let full = at == MAX_STEPS;
        for (p, place) in seats.iter_mut().enumerate().take(vectors.packets) {
            let Some(seat) = place else { continue };
            seat.left -= steps;
            seat.plain = seat.plain.saturating_sub(steps);
            for left in &mut lockstep.left[p] {
                *left = left.saturating_sub(steps as u32);
            }
            if (full || seat.left == 0)
                && let Some(job) = jobs.get_mut(seat.job)
            {
                let tokens = lockstep.tokens[p].get(LANES * seat.from..LANES * at);
                seat.from = if full { 0 } else { at };
                let result =
                    seat.advance(vectors, tables, lockstep.state[p], lockstep.words[p], tokens, job.out);
                if result.is_err() {
                    *place = None;
                    settle(tables, result, job);
                }
            }
        }
        if full {
            at = 0;
            for (p, seat) in seats.iter_mut().enumerate() {
                if let Some(seat) = seat {
                    seat.lay(p, at, &mut lockstep.tables);
                }
            }
        }
    }
    for (p, seat) in seats.into_iter().enumerate() {
        let Some(mut seat) = seat else { continue };
        let Some(job) = jobs.get_mut(seat.job) else { continue };
        let tokens = lockstep.tokens[p].get(LANES * seat.from..LANES * at);
        let result = seat.advance(vectors, tables, lockstep.state[p], lockstep.words[p], tokens, job.out);
        let result = result.and_then(|()| seat.finish(tables, job.out));
        settle(tables, result, job);
    }
}

/// Gives place `p`, whose packet has no whole group left, to the next one that waits and has some.
fn renew<'a>(
    tables: &Tables<'_>,
    jobs: &mut [Job<'a>],
    waiting: &mut core::ops::Range<usize>,
    seat: &mut Option<Seat<'a>>,
    lockstep: &mut Lockstep,
    p: usize,
    at: usize,
) {
    loop {
        if seat.as_ref().is_some_and(|seat| seat.left > 0) {
            return;
        }
        if let Some(done) = seat.take()
            && let Some(job) = jobs.get_mut(done.job)
        {
            settle(tables, done.finish(tables, job.out), job);
        }
        let Some((index, job)) = waiting.next().and_then(|i| Some((i, jobs.get_mut(i)?))) else {
            lockstep.words[p] = 0;
            return;
        };
        match open(tables, job.body, job.runs, job.out.len()) {
            Ok(decoder) => {
                *seat = Seat::take(index, job, decoder, &mut lockstep.bytes[p]);
                match seat {
                    Some(seat) => {
                        seat.from = at;
                        seat.lay(p, at, &mut lockstep.tables);
                        let lanes = decoder.lanes();
                        (lockstep.words[p], lockstep.state[p]) = (0, lanes.state);
                        // The tail may begin within a group.
                        lockstep.left[p] =
                            core::array::from_fn(|lane| ((lanes.main + 3 - lane) / LANES) as u32);
                    }
                    None => job.result = decode_alone(tables, job),
                }
            }
            Err(error) => job.result = Err(error),
        }
    }
}

/// Notes a result; a refusal is that of the scalar decoder.
fn settle(tables: &Tables<'_>, result: Result<()>, job: &mut Job<'_>) {
    job.result = if result.is_ok() { result } else { decode_alone(tables, job) };
}
