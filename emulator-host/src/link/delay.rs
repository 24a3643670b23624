//! Delays every datagram and keeps their order.
//!
//! The delay is constant or follows a [`DelayTrace`], plus uniform jitter from the box's own stream. A
//! datagram never overtakes: it leaves no earlier than the one before it. Overtaking is the
//! [`super::Reorder`] box's work.

use std::collections::VecDeque;

use super::{Counts, Datagram, LinkBox, Tally};
use crate::{
    clock::Nanos,
    rng::{RandomStream, stream},
    trace::DelayTrace,
};

/// Holds datagrams for a base delay plus jitter.
#[derive(Debug)]
pub struct Delay {
    label: String,
    base: Nanos,
    trace: Option<DelayTrace>,
    jitter: Nanos,
    random: RandomStream,
    delayed: VecDeque<(Nanos, Datagram)>,
    last: Nanos,
    counts: Counts,
}

impl Delay {
    /// Delay of `base` plus a uniform draw from `0..=jitter`.
    pub fn new(label: impl Into<String>, base: Nanos, jitter: Nanos, seed: u64) -> Self {
        let label = label.into();
        let random = stream(seed, &label);
        Self {
            label,
            base,
            trace: None,
            jitter,
            random,
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

    fn put(&mut self, datagram: Datagram, now: Nanos) {
        self.counts.received.add(datagram);
        let mut span = self.base;
        if let Some(trace) = &self.trace {
            span += trace.at(now);
        }
        if self.jitter > Nanos::ZERO {
            span += Nanos(self.random.up_to(self.jitter.0));
        }
        self.last = self.last.max(now + span);
        self.delayed.push_back((self.last, datagram));
    }

    fn take(&mut self, now: Nanos) -> Option<Datagram> {
        let (_, datagram) = self.delayed.pop_front_if(|(at, _)| *at <= now)?;
        self.counts.delivered.add(datagram);
        Some(datagram)
    }

    fn next_at(&self) -> Nanos {
        self.delayed.front().map_or(Nanos::MAX, |(at, _)| *at)
    }

    fn counts(&self) -> Counts {
        let mut inside = Tally::default();
        self.delayed.iter().for_each(|(_, datagram)| inside.add(*datagram));
        Counts { inside, ..self.counts }
    }
}
