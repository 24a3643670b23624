//! Loses datagrams independently of each other.

use super::{BoxOutput, Counts, Datagram, LinkBox};
use crate::{
    clock::Nanos,
    rng::{Chance, Stream, stream},
};

/// Loses each datagram with the same chance. Draws once per datagram, so the n-th datagram meets the same
/// luck whatever its size and time.
#[derive(Debug)]
pub struct IidLoss {
    label: String,
    chance: Chance,
    luck: Stream,
    counts: Counts,
}

impl IidLoss {
    /// Loss with `chance`.
    pub fn new(label: impl Into<String>, chance: Chance, seed: u64) -> Self {
        let label = label.into();
        let luck = stream(seed, &label);
        Self { label, chance, luck, counts: Counts::default() }
    }
}

impl LinkBox for IidLoss {
    fn label(&self) -> &str {
        &self.label
    }

    fn step(&mut self, input: Option<Datagram>, _now: Nanos) -> BoxOutput {
        let Some(datagram) = input else { return BoxOutput::Idle };
        self.counts.received.add(datagram);
        if self.luck.happens(self.chance) {
            self.counts.dropped.add(datagram);
            return BoxOutput::Idle;
        }
        self.counts.delivered.add(datagram);
        BoxOutput::Datagram(datagram)
    }

    fn counts(&self) -> Counts {
        self.counts
    }
}
