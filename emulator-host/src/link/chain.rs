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
    /// What has come to a chain without boxes.
    passed: Tally,
    wake: Nanos,
}

impl std::fmt::Debug for Chain {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut shown = f.debug_struct("Chain");
        shown.field("label", &self.label).field("boxes", &self.boxes.len()).finish_non_exhaustive()
    }
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
            passed: Tally::default(),
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

    /// Moves what is due at `now`, then takes `input`; what comes out of the last box goes to `leave`.
    fn advance(&mut self, input: Option<Datagram>, now: Nanos, leave: &mut dyn FnMut(Datagram)) {
        let is_due = self.wake <= now;
        if is_due {
            for at in (0..self.boxes.len()).rev() {
                if self.boxes[at].wake <= now {
                    feed(&mut self.boxes[at..], None, now, leave);
                }
            }
        }
        if let Some(datagram) = input {
            if self.boxes.is_empty() {
                self.passed.add(datagram);
            }
            feed(&mut self.boxes, input, now, leave);
        }
        if is_due || input.is_some() {
            self.wake = self.boxes.iter().map(|slot| slot.wake).min().unwrap_or(Nanos::MAX);
        }
    }
}

/// Puts `input` into the first of `boxes` and carries on whatever comes out, down to the exit.
fn feed(boxes: &mut [Slot], input: Option<Datagram>, now: Nanos, leave: &mut dyn FnMut(Datagram)) {
    match boxes.split_first_mut() {
        None => input.into_iter().for_each(leave),
        Some((first, rest)) => {
            first.wake = first.inner.carry(input, now, &mut |out| feed(rest, Some(out), now, leave));
        }
    }
}

impl LinkBox for Chain {
    fn label(&self) -> &str {
        &self.label
    }

    fn step(&mut self, input: Option<Datagram>, now: Nanos) -> BoxOutput {
        let mut ready = std::mem::take(&mut self.ready);
        self.advance(input, now, &mut |datagram| ready.push_back(datagram));
        self.ready = ready;
        if let Some(datagram) = self.ready.pop_front() {
            return BoxOutput::Datagram(datagram);
        }
        if self.wake == Nanos::MAX { BoxOutput::Idle } else { BoxOutput::Wake(self.wake) }
    }

    fn carry(&mut self, input: Option<Datagram>, now: Nanos, leave: &mut dyn FnMut(Datagram)) -> Nanos {
        while let Some(datagram) = self.ready.pop_front() {
            leave(datagram);
        }
        self.advance(input, now, leave);
        self.wake
    }

    fn counts(&self) -> Counts {
        let counts_of = |slot: &Slot| slot.inner.counts();
        let received = self.boxes.first().map_or(self.passed, |slot| counts_of(slot).received);
        let left = self.boxes.last().map_or(self.passed, |slot| counts_of(slot).delivered);
        let mut inside = Tally::default();
        self.ready.iter().for_each(|datagram| inside.add(*datagram));
        let delivered =
            Tally { datagrams: left.datagrams - inside.datagrams, bytes: left.bytes - inside.bytes };
        let mut counts = Counts { received, delivered, inside, ..Counts::default() };
        for (_, inner) in self.box_counts() {
            for (sum, part) in [(&mut counts.dropped, inner.dropped), (&mut counts.inside, inner.inside)] {
                sum.datagrams += part.datagrams;
                sum.bytes += part.bytes;
            }
        }
        counts
    }
}
