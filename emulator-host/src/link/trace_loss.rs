//! Loses datagrams with a chance that follows a [`LossTrace`].

use super::{BoxOutput, Counts, Datagram, LinkBox};
use crate::{
    clock::Nanos,
    rng::{Stream, stream},
    trace::LossTrace,
};

/// Loses each datagram with the chance that holds when it passes. Draws once per datagram.
#[derive(Debug)]
pub(super) struct TraceLoss {
    label: String,
    trace: LossTrace,
    luck: Stream,
    counts: Counts,
}

impl TraceLoss {
    /// Loss as `trace` has it.
    pub(super) fn new(label: impl Into<String>, trace: LossTrace, seed: u64) -> Self {
        let label = label.into();
        let luck = stream(seed, &label);
        Self { label, trace, luck, counts: Counts::default() }
    }
}

impl LinkBox for TraceLoss {
    fn label(&self) -> &str {
        &self.label
    }

    fn step(&mut self, input: Option<Datagram>, now: Nanos) -> BoxOutput {
        let Some(datagram) = input else { return BoxOutput::Idle };
        self.counts.received.add(datagram);
        if self.luck.happens(self.trace.at(now)) {
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

#[cfg(test)]
mod tests {
    use super::*;
    use crate::trace::{Limits, Replay};

    #[test]
    fn what_passes_in_a_lossy_step_is_lost_and_nothing_else() {
        let replay = Replay::load("t", b"0 1 0 0\n1 1 0 100\n2 1 0 0\n", &Limits::default()).unwrap();
        let mut link = TraceLoss::new("loss", replay.loss.unwrap(), 1);
        for tenth in 0..30 {
            let output = link.step(Some(Datagram { tag: tenth, bytes: 1 }), Nanos::from_ms(100 * tenth));
            assert_eq!(output == BoxOutput::Idle, (10..20).contains(&tenth));
        }
        assert!(link.counts().balanced());
        assert_eq!(link.counts().dropped.datagrams, 10);
    }
}
