//! Loses datagrams by chance; the models say by which.

use std::collections::VecDeque;

use super::{Counts, Datagram, LinkBox, Tally};
use crate::{
    clock::Nanos,
    rng::{Probability, RandomStream, stream},
    trace::LossTrace,
};

/// A model of loss.
pub trait LossProcess: Send {
    /// Whether the datagram that passes at `now` is lost. Draws as often for every datagram, so
    /// the n-th meets the same draw whatever its size.
    fn loses(&mut self, random: &mut RandomStream, now: Nanos) -> bool;
}

/// Each datagram with the same chance, independently of the others.
impl LossProcess for Probability {
    fn loses(&mut self, random: &mut RandomStream, _now: Nanos) -> bool {
        random.happens(*self)
    }
}

/// Each datagram with the chance that holds when it passes.
impl LossProcess for LossTrace {
    fn loses(&mut self, random: &mut RandomStream, now: Nanos) -> bool {
        random.happens(self.at(now))
    }
}

/// Loses the datagrams that a model says.
#[derive(Debug)]
pub struct Loss<L> {
    label: String,
    model: L,
    random: RandomStream,
    /// What is not lost leaves at once.
    passing: VecDeque<Datagram>,
    counts: Counts,
}

impl<L: LossProcess> Loss<L> {
    /// Loss by `model`.
    pub fn new(label: impl Into<String>, model: L, seed: u64) -> Self {
        let label = label.into();
        let random = stream(seed, &label);
        Self { label, model, random, passing: VecDeque::new(), counts: Counts::default() }
    }
}

impl<L: LossProcess> LinkBox for Loss<L> {
    fn label(&self) -> &str {
        &self.label
    }

    fn put(&mut self, datagram: Datagram, now: Nanos) {
        self.counts.received.add(datagram);
        if self.model.loses(&mut self.random, now) {
            self.counts.dropped.add(datagram);
        } else {
            self.passing.push_back(datagram);
        }
    }

    fn take(&mut self, _now: Nanos) -> Option<Datagram> {
        let datagram = self.passing.pop_front()?;
        self.counts.delivered.add(datagram);
        Some(datagram)
    }

    fn next_at(&self) -> Nanos {
        if self.passing.is_empty() { Nanos::MAX } else { Nanos::ZERO }
    }

    fn counts(&self) -> Counts {
        let mut inside = Tally::default();
        self.passing.iter().for_each(|datagram| inside.add(*datagram));
        Counts { inside, ..self.counts }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::{
        link::BoxOutput,
        trace::{Limits, Replay},
    };

    #[test]
    fn what_passes_in_a_lossy_step_is_lost_and_nothing_else() {
        let replay = Replay::load("t", b"0 1 0 0\n1 1 0 100\n2 1 0 0\n", &Limits::default()).unwrap();
        let mut link = Loss::new("loss", replay.loss.unwrap(), 1);
        for tenth in 0..30 {
            let output = link.step(Some(Datagram { tag: tenth, bytes: 1 }), Nanos::from_ms(100 * tenth));
            assert_eq!(output == BoxOutput::Idle, (10..20).contains(&tenth));
        }
        assert!(link.counts().balanced());
        assert_eq!(link.counts().dropped.datagrams, 10);
    }
}
