//! Gives packets to a receiver, many at a time.

use codec_core::{
    Error, Result,
    internals::{
        rans::lanes::TableRun,
        receiver::{Accepted, Planned, Receiver},
        wire::checked::Checked,
    },
};

use crate::{
    job::{Job, Tables},
    kernel::Kernel,
    many::decode_many_with,
};

/// Packets that are decoded together: several times as many as a kernel has places, so that few of
/// them stand empty while the last ones end.
const BATCH: usize = 128;
/// Values that are decoded together, less those of the last packet, whose number caps bound: so are the
/// lists of runs.
const MAX_VALUES: usize = 1 << 21;

/// Gives a [`Receiver`] packets whose values are decoded several at once; its memory is reused.
#[derive(Debug)]
pub struct BatchReceiver {
    kernel: Kernel,
    runs: Vec<TableRun>,
    values: Vec<i16>,
}

impl Default for BatchReceiver {
    fn default() -> Self {
        Self::with_kernel(Kernel::best())
    }
}

/// A packet of a batch.
enum Entry<'p> {
    /// Not even whole.
    Refused(Error),
    /// For the receiver alone.
    Alone(Checked<'p>),
    /// What the receiver planned, and where its runs end.
    Planned(Planned<'p>, usize),
}

impl BatchReceiver {
    /// A batch receiver that decodes by `kernel`; by the scalar one if this machine lacks it.
    pub fn with_kernel(kernel: Kernel) -> Self {
        Self { kernel, runs: Vec::new(), values: Vec::new() }
    }

    /// Gives `packets` to `receiver`: the same, in the same order, as giving each to
    /// [`Receiver::media`]. `answer` is called with each one's answer.
    pub fn receive<'p>(
        &mut self,
        receiver: &mut Receiver<'_>,
        packets: impl IntoIterator<Item = &'p [u8]>,
        mut answer: impl FnMut(Result<Accepted>),
    ) {
        let mut packets = packets.into_iter();
        if self.kernel.vectors().is_none() || receiver.tables().is_none() {
            packets.for_each(|packet| answer(receiver.media(packet)));
            return;
        }
        let mut batch = Vec::with_capacity(BATCH);
        loop {
            batch.clear();
            self.runs.clear();
            let mut values = 0;
            while batch.len() < BATCH && values < MAX_VALUES {
                let Some(packet) = packets.next() else { break };
                let first = self.runs.len();
                let packet = match Checked::new(packet, receiver.crc()) {
                    Ok(packet) => packet,
                    Err(error) => {
                        batch.push(Entry::Refused(error));
                        continue;
                    }
                };
                batch.push(match receiver.plan(packet, |run| self.runs.push(run)) {
                    Ok(planned) => {
                        values += planned.values;
                        Entry::Planned(planned, self.runs.len())
                    }
                    Err(packet) => {
                        self.runs.truncate(first);
                        Entry::Alone(packet)
                    }
                });
            }
            if batch.is_empty() {
                return;
            }
            self.take(receiver, &batch, values, &mut answer);
        }
    }

    /// Decodes a batch of `count` values, then gives it to the receiver packet by packet.
    fn take(
        &mut self,
        receiver: &mut Receiver<'_>,
        batch: &[Entry<'_>],
        count: usize,
        answer: &mut impl FnMut(Result<Accepted>),
    ) {
        if self.values.len() < count {
            self.values.resize(count, 0);
        }
        let (mut rest, mut first) = (self.values.as_mut_slice(), 0);
        let mut jobs: Vec<Job<'_>> = Vec::with_capacity(batch.len());
        for entry in batch {
            let Entry::Planned(planned, end) = entry else { continue };
            let (out, later) = core::mem::take(&mut rest).split_at_mut(planned.values);
            jobs.push(Job::new(planned.body, &self.runs[first..*end], out));
            (rest, first) = (later, *end);
        }
        match receiver.tables() {
            Some((slots, raw_bits)) => decode_many_with(self.kernel, &Tables { slots, raw_bits }, &mut jobs),
            None => jobs.iter_mut().for_each(|job| job.result = Err(Error::short("tables", 0, 0, 1))),
        }
        let mut jobs = jobs.into_iter();
        for entry in batch {
            answer(match entry {
                Entry::Refused(error) => Err(receiver.refuse(*error)),
                Entry::Alone(packet) => receiver.push(packet),
                Entry::Planned(planned, _) => {
                    let job = jobs.next().filter(|job| job.result.is_ok());
                    receiver.commit(planned, job.map(|job| &*job.out))
                }
            });
        }
    }
}
