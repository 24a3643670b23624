//! Delays every datagram and keeps their order.
//!
//! The delay is constant or follows a [`DelayTrace`], plus uniform jitter from the box's own stream. A
//! datagram never overtakes: it leaves no earlier than the one before it. Overtaking is the
//! [`super::Reorder`] box's work.

use std::collections::VecDeque;

use super::{BoxOutput, Counts, Datagram, LinkBox, Tally};
use crate::{
    clock::Nanos,
    rng::{Stream, stream},
    trace::DelayTrace,
};

/// Holds datagrams for a base delay plus jitter.
#[derive(Debug)]
pub struct Delay {
    label: String,
    base: Nanos,
    trace: Option<DelayTrace>,
    jitter: Nanos,
    luck: Stream,
    delayed: VecDeque<(Nanos, Datagram)>,
    last: Nanos,
    counts: Counts,
}

impl Delay {
    /// Delay of `base` plus a uniform draw from `0..=jitter`.
    pub fn new(label: impl Into<String>, base: Nanos, jitter: Nanos, seed: u64) -> Self {
        let label = label.into();
        let luck = stream(seed, &label);
        Self {
            label,
            base,
            trace: None,
            jitter,
            luck,
            delayed: VecDeque::new(),
            last: Nanos::ZERO,
            counts: Counts::default(),
        }
    }

    /// The same, with the delay of `trace` at the time of arrival added to the base.
    #[must_use]
    pub fn following(mut self, trace: DelayTrace) -> Self {
        self.trace = Some(trace);
        self
    }
}

impl LinkBox for Delay {
    fn label(&self) -> &str {
        &self.label
    }

    fn step(&mut self, input: Option<Datagram>, now: Nanos) -> BoxOutput {
        if let Some(datagram) = input {
            self.counts.received.add(datagram);
            self.counts.inside.add(datagram);
            let mut span = self.base;
            if let Some(trace) = &self.trace {
                span += trace.at(now);
            }
            if self.jitter > Nanos::ZERO {
                span += Nanos(self.luck.up_to(self.jitter.0));
            }
            self.last = self.last.max(now + span);
            self.delayed.push_back((self.last, datagram));
        }
        match self.delayed.front() {
            None => BoxOutput::Idle,
            Some((at, _)) if *at > now => BoxOutput::Wake(*at),
            Some((_, datagram)) => {
                let datagram = *datagram;
                self.delayed.pop_front();
                self.counts.delivered.add(datagram);
                let inside = self.counts.inside;
                self.counts.inside = Tally {
                    datagrams: inside.datagrams - 1,
                    bytes: inside.bytes - u64::from(datagram.bytes),
                };
                BoxOutput::Datagram(datagram)
            }
        }
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}
