//! Serialises datagrams at a constant rate behind a drop-tail queue.

use super::{
    BoxOutput, Counts, Datagram, LinkBox, QueueLimit,
    serialiser::{Serialiser, Service},
};
use crate::clock::{Bytes, Nanos, Rate};

/// Serialises one datagram after the other at a constant rate.
#[derive(Debug)]
pub struct ConstantRate {
    label: String,
    inner: Serialiser<Constant>,
}

impl ConstantRate {
    /// At rate zero nothing ever leaves.
    pub fn new(label: impl Into<String>, rate: Rate, limit: QueueLimit) -> Self {
        Self { label: label.into(), inner: Serialiser::new(Constant { rate, free: Nanos::ZERO }, limit) }
    }
}

impl LinkBox for ConstantRate {
    fn label(&self) -> &str {
        &self.label
    }

    fn step(&mut self, input: Option<Datagram>, now: Nanos) -> BoxOutput {
        self.inner.step(input, now)
    }

    fn carry(&mut self, input: Option<Datagram>, now: Nanos, leave: &mut dyn FnMut(Datagram)) -> Nanos {
        self.inner.carry(input, now, leave)
    }

    fn counts(&self) -> Counts {
        self.inner.counts()
    }
}

#[derive(Debug)]
struct Constant {
    rate: Rate,
    free: Nanos,
}

impl Service for Constant {
    fn start(&mut self, now: Nanos) {
        self.free = now;
    }

    fn finish(&mut self, bytes: u32) -> Nanos {
        self.free += self.rate.time_for(Bytes(u64::from(bytes)));
        self.free
    }
}
