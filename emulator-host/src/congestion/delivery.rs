//! Measures how fast acknowledged bytes went through, and the windowed maximum, the paper's estimate of
//! the path.
//!
//! A sample spans from the acknowledgement that preceded the sending of a packet to the acknowledgement of
//! that packet, and no less than the time it took to send, so that acknowledgements that arrive bunched do
//! not inflate it. A sample taken while the application had too little to send can raise the estimate, not
//! lower it.

use std::collections::VecDeque;

use crate::clock::{Nanos, Rate};

/// One measurement.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct DeliverySample {
    /// Bytes acknowledged over the time it took.
    pub rate: Rate,
    /// Whether the application had too little to send.
    pub app_limited: bool,
}

/// Maximum of the samples of a sliding window of time.
#[derive(Clone, Debug, Default)]
pub struct DeliveryRate {
    /// Times rise and rates fall from front to back: the front is the maximum.
    falling: VecDeque<(Nanos, Rate)>,
}

impl DeliveryRate {
    /// No sample.
    pub fn new() -> Self {
        Self::default()
    }

    /// Takes a sample at `now` and forgets those older than `window`, except that the last one is kept for
    /// want of a better.
    pub fn take(&mut self, sample: DeliverySample, window: Nanos, now: Nanos) {
        if sample.app_limited && self.estimate().is_some_and(|estimate| sample.rate < estimate) {
            return;
        }
        while self.falling.back().is_some_and(|(_, rate)| *rate <= sample.rate) {
            self.falling.pop_back();
        }
        self.falling.push_back((now, sample.rate));
        while self.falling.len() > 1 && self.falling.front().is_some_and(|(at, _)| *at + window < now) {
            self.falling.pop_front();
        }
    }

    /// The maximum.
    pub fn estimate(&self) -> Option<Rate> {
        self.falling.front().map(|(_, rate)| *rate)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_maximum_slides_and_app_limited_samples_only_raise() {
        let mut rate = DeliveryRate::new();
        let window = Nanos::from_ms(100);
        let mut take = |mbps, app_limited, ms| {
            let sample = DeliverySample { rate: Rate::from_mbps(mbps), app_limited };
            rate.take(sample, window, Nanos::from_ms(ms));
            rate.estimate().map(|rate| rate.0 / 1_000_000)
        };
        assert_eq!(take(5, false, 0), Some(5));
        assert_eq!(take(3, false, 50), Some(5));
        assert_eq!(take(1, true, 60), Some(5));
        assert_eq!(take(2, false, 120), Some(3));
        assert_eq!(take(9, true, 130), Some(9));
    }
}
