//! A box that lets some datagrams be overtaken.

use super::{Counts, Datagram, LinkBox, Output, Tally};
use crate::{
    clock::Nanos,
    event::EventQueue,
    rng::{Chance, Stream, stream},
};

/// Holds some datagrams back for a random while; all others pass at once.
#[derive(Debug)]
pub struct Reorder {
    label: String,
    chance: Chance,
    extra: Nanos,
    luck: Stream,
    held: EventQueue<Datagram>,
    counts: Counts,
}

impl Reorder {
    /// With `chance`, a datagram is held for a uniform draw from `0..=extra`.
    pub fn new(label: impl Into<String>, chance: Chance, extra: Nanos, seed: u64) -> Self {
        let label = label.into();
        let luck = stream(seed, &label);
        Self { label, chance, extra, luck, held: EventQueue::new(), counts: Counts::default() }
    }
}

impl LinkBox for Reorder {
    fn label(&self) -> &str {
        &self.label
    }

    fn step(&mut self, input: Option<Datagram>, now: Nanos) -> Output {
        if let Some(datagram) = input {
            self.counts.received.add(datagram);
            self.counts.held.add(datagram);
            let held_back = self.luck.happens(self.chance);
            let span = self.luck.up_to(self.extra.0);
            self.held.push(if held_back { now + Nanos(span) } else { now }, datagram);
        }
        if let Some((_, datagram)) = self.held.pop_due(now) {
            self.counts.delivered.add(datagram);
            let held = self.counts.held;
            self.counts.held =
                Tally { datagrams: held.datagrams - 1, bytes: held.bytes - u64::from(datagram.bytes) };
            return Output::Datagram(datagram);
        }
        self.held.next_at().map_or(Output::Idle, Output::Wake)
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}
