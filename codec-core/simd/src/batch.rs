//! Gives packets to a receiver, many at a time.

use codec_core::{
    Error, Result,
    rans::lanes::Run,
    receiver::{Accepted, Planned, Receiver},
};

use crate::{Job, Kernel, Tables, decode_many_with};

/// Packets that are decoded together: several times as many as a kernel has places, so that few of
/// them stand empty while the last ones end.
const BATCH: usize = 128;
/// Values that are decoded together; a packet of more goes to the receiver alone.
const MOST_VALUES: usize = 1 << 21;

/// Gives a [`Receiver`] packets whose values are decoded several at once; its memory is reused.
#[derive(Debug)]
pub struct BatchReceiver {
    kernel: Kernel,
    runs: Vec<Run>,
    values: Vec<i16>,
}

impl Default for BatchReceiver {
    fn default() -> Self {
        Self::with_kernel(Kernel::best())
    }
}

/// A packet of a batch.
struct Entry<'p> {
    packet: &'p [u8],
    /// What the receiver planned, and where its runs end.
    planned: Option<(Planned<'p>, usize)>,
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
            while batch.len() < BATCH && values < MOST_VALUES {
                let Some(packet) = packets.next() else { break };
                let first = self.runs.len();
                let planned = receiver.plan(packet, |run| self.runs.push(run));
                let planned = planned.filter(|planned| planned.values <= MOST_VALUES);
                values += planned.as_ref().map_or(0, |planned| planned.values);
                if planned.is_none() {
                    self.runs.truncate(first);
                }
                batch.push(Entry { packet, planned: planned.map(|planned| (planned, self.runs.len())) });
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
        for (planned, end) in batch.iter().filter_map(|entry| entry.planned.as_ref()) {
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
            answer(match &entry.planned {
                None => receiver.media(entry.packet),
                Some((planned, _)) => {
                    let job = jobs.next().filter(|job| job.result.is_ok());
                    receiver.commit(planned, job.map(|job| &*job.out))
                }
            });
        }
    }
}
