//! Chains boxes one after the other into one box.
//!
//! At one instant the box nearest to the exit moves first, so that in every box departures come before
//! arrivals.

use std::collections::VecDeque;

use super::{Counts, Datagram, LinkBox, Tally};
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

    /// Takes a datagram or nothing at `now` and hands all that leaves to `leave`: the same as
    /// [`LinkBox::step`] until nothing comes out, in one call.
    pub fn carry(&mut self, input: Option<Datagram>, now: Nanos, mut leave: impl FnMut(Datagram)) {
        while let Some(datagram) = self.ready.pop_front() {
            leave(datagram);
        }
        self.advance(input, now, &mut leave);
    }

    /// Moves what is due at `now`, then takes `input`; what comes out of the last box goes to `leave`.
    fn advance(&mut self, input: Option<Datagram>, now: Nanos, leave: &mut impl FnMut(Datagram)) {
        if self.wake > now && input.is_none() {
            return;
        }
        for at in (0..self.boxes.len()).rev() {
            if self.boxes[at].wake <= now {
                drain(&mut self.boxes[at..], now, leave);
            }
        }
        if let Some(datagram) = input {
            if self.boxes.is_empty() {
                self.passed.add(datagram);
            }
            put(&mut self.boxes, datagram, now, leave);
        }
        self.wake = self.boxes.iter().map(|slot| slot.wake).min().unwrap_or(Nanos::MAX);
    }
}

/// Puts `datagram` into the first of `boxes`, and carries on whatever comes out, down to the exit.
fn put(boxes: &mut [Slot], datagram: Datagram, now: Nanos, leave: &mut impl FnMut(Datagram)) {
    match boxes.first_mut() {
        None => leave(datagram),
        Some(first) => {
            first.inner.put(datagram, now);
            drain(boxes, now, leave);
        }
    }
}

/// Takes what is due out of the first of `boxes`, and carries it on, down to the exit.
fn drain(boxes: &mut [Slot], now: Nanos, leave: &mut impl FnMut(Datagram)) {
    let Some((first, rest)) = boxes.split_first_mut() else { return };
    loop {
        first.wake = first.inner.next_at();
        if first.wake > now {
            return;
        }
        let Some(datagram) = first.inner.take(now) else { return };
        put(rest, datagram, now, leave);
    }
}

impl LinkBox for Chain {
    fn label(&self) -> &str {
        &self.label
    }

    fn put(&mut self, datagram: Datagram, now: Nanos) {
        let mut ready = std::mem::take(&mut self.ready);
        self.advance(Some(datagram), now, &mut |datagram| ready.push_back(datagram));
        self.ready = ready;
    }

    fn take(&mut self, now: Nanos) -> Option<Datagram> {
        let mut ready = std::mem::take(&mut self.ready);
        self.advance(None, now, &mut |datagram| ready.push_back(datagram));
        self.ready = ready;
        self.ready.pop_front()
    }

    fn next_at(&self) -> Nanos {
        self.next_wake()
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
