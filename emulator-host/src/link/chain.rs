//! Chains boxes one after the other into one box.
//!
//! At one instant the box nearest to the exit moves first, so that in every box departures come before
//! arrivals.

use std::collections::VecDeque;

use super::{BoxOutput, Counts, Datagram, LinkBox, Tally};
use crate::clock::Nanos;

/// A chain of boxes. An empty chain passes everything at once.
pub struct Chain {
    label: String,
    boxes: Vec<Slot>,
    ready: VecDeque<Datagram>,
    received: Tally,
    delivered: Tally,
    wake: Nanos,
}

struct Slot {
    inner: Box<dyn LinkBox>,
    wake: Nanos,
}

impl Chain {
    /// A chain from entry to exit.
    pub fn new(label: impl Into<String>, boxes: Vec<Box<dyn LinkBox>>) -> Self {
        Self {
            label: label.into(),
            boxes: boxes.into_iter().map(|inner| Slot { inner, wake: Nanos::MAX }).collect(),
            ready: VecDeque::new(),
            received: Tally::default(),
            delivered: Tally::default(),
            wake: Nanos::MAX,
        }
    }

    /// When something may happen inside; [`Nanos::MAX`] for never, zero while a datagram waits at the exit.
    pub fn next_wake(&self) -> Nanos {
        if self.ready.is_empty() { self.wake } else { Nanos::ZERO }
    }

    /// Label and counts of every box, from entry to exit.
    pub fn box_counts(&self) -> impl Iterator<Item = (&str, Counts)> {
        self.boxes.iter().map(|slot| (slot.inner.label(), slot.inner.counts()))
    }

    /// Puts `input` into box `at` and carries on whatever comes out, down to the exit.
    fn feed(&mut self, at: usize, mut input: Option<Datagram>, now: Nanos) {
        if at == self.boxes.len() {
            self.ready.extend(input);
            return;
        }
        loop {
            match self.boxes[at].inner.step(input.take(), now) {
                BoxOutput::Datagram(datagram) => self.feed(at + 1, Some(datagram), now),
                BoxOutput::Wake(wake) => {
                    self.boxes[at].wake = wake;
                    return;
                }
                BoxOutput::Idle => {
                    self.boxes[at].wake = Nanos::MAX;
                    return;
                }
            }
        }
    }
}

impl LinkBox for Chain {
    fn label(&self) -> &str {
        &self.label
    }

    fn step(&mut self, input: Option<Datagram>, now: Nanos) -> BoxOutput {
        let is_due = self.wake <= now;
        if is_due {
            for at in (0..self.boxes.len()).rev() {
                if self.boxes[at].wake <= now {
                    self.feed(at, None, now);
                }
            }
        }
        if let Some(datagram) = input {
            self.received.add(datagram);
            self.feed(0, Some(datagram), now);
        }
        if is_due || input.is_some() {
            self.wake = self.boxes.iter().map(|slot| slot.wake).min().unwrap_or(Nanos::MAX);
        }
        if let Some(datagram) = self.ready.pop_front() {
            self.delivered.add(datagram);
            return BoxOutput::Datagram(datagram);
        }
        if self.wake == Nanos::MAX { BoxOutput::Idle } else { BoxOutput::Wake(self.wake) }
    }

    fn counts(&self) -> Counts {
        let mut counts = Counts { received: self.received, delivered: self.delivered, ..Counts::default() };
        for (_, inner) in self.box_counts() {
            for (sum, part) in [(&mut counts.dropped, inner.dropped), (&mut counts.inside, inner.inside)] {
                sum.datagrams += part.datagrams;
                sum.bytes += part.bytes;
            }
        }
        self.ready.iter().for_each(|datagram| counts.inside.add(*datagram));
        counts
    }
}
