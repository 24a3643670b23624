//! Serialises datagrams at a constant rate behind a drop-tail queue.

use super::{
    Counts, Datagram, LinkBox, QueueLimit,
    light_load::{LightFirst, LightLoad},
    serialiser::{Serialiser, Service},
};
use crate::clock::{Bytes, Nanos, Rate};

/// Serialises one datagram after the other at a constant rate.
#[derive(Debug)]
pub struct ConstantRate {
    label: String,
    inner: Serialiser<LightFirst<Constant>>,
}

impl ConstantRate {
    /// At rate zero nothing ever leaves.
    pub fn new(label: impl Into<String>, rate: Rate, limit: QueueLimit) -> Self {
        Self::with_light_load(label, rate, limit, None)
    }

    /// The same, but that bursts after a pause pass as `light` says.
    pub(super) fn with_light_load(
        label: impl Into<String>,
        rate: Rate,
        limit: QueueLimit,
        light: Option<LightLoad>,
    ) -> Self {
        let service = LightFirst::new(Constant { rate, free: Nanos::ZERO }, light);
        Self { label: label.into(), inner: Serialiser::new(service, limit) }
    }
}

impl LinkBox for ConstantRate {
    fn label(&self) -> &str {
        &self.label
    }

    fn put(&mut self, datagram: Datagram, now: Nanos) {
        self.inner.put(datagram, now);
    }

    fn take(&mut self, now: Nanos) -> Option<Datagram> {
        self.inner.take(now)
    }

    fn next_at(&self) -> Nanos {
        self.inner.next_at()
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
