//! Delays some datagrams at random, so that others overtake them.

use super::{Counts, Datagram, LinkBox, Tally};
use crate::{
    clock::Nanos,
    event::EventQueue,
    rng::{Probability, RandomStream, stream},
};

/// Holds some datagrams back for a random while; all others pass at once.
#[derive(Debug)]
pub struct Reorder {
    label: String,
    chance: Probability,
    extra: Nanos,
    random: RandomStream,
    waiting: EventQueue<Datagram>,
    counts: Counts,
}

impl Reorder {
    /// With `chance`, a datagram is held for a uniform draw from `0..=extra`.
    pub fn new(label: impl Into<String>, chance: Probability, extra: Nanos, seed: u64) -> Self {
        let label = label.into();
        let random = stream(seed, &label);
        Self { label, chance, extra, random, waiting: EventQueue::new(), counts: Counts::default() }
    }
}

impl LinkBox for Reorder {
    fn label(&self) -> &str {
        &self.label
    }

    fn put(&mut self, datagram: Datagram, now: Nanos) {
        self.counts.received.add(datagram);
        self.counts.inside.add(datagram);
        let is_late = self.random.happens(self.chance);
        let span = self.random.up_to(self.extra.0);
        self.waiting.push(if is_late { now + Nanos(span) } else { now }, datagram);
    }

    fn take(&mut self, now: Nanos) -> Option<Datagram> {
        let (_, datagram) = self.waiting.pop_due(now)?;
        self.counts.delivered.add(datagram);
        let inside = self.counts.inside;
        self.counts.inside =
            Tally { datagrams: inside.datagrams - 1, bytes: inside.bytes - u64::from(datagram.bytes) };
        Some(datagram)
    }

    fn next_at(&self) -> Nanos {
        self.waiting.next_at().unwrap_or(Nanos::MAX)
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}
