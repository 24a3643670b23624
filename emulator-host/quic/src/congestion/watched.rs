//! Tells an observer of a controller's packets, for what `quinn` keeps to itself.

use std::{any::Any, sync::Arc, time::Instant};

use quinn_proto::{
    RttEstimator,
    congestion::{Controller, ControllerFactory},
};

pub(crate) type Factory = Arc<dyn ControllerFactory + Send + Sync>;

/// What follows the packets of one connection; clones share what they saw.
pub(crate) trait Observer: Clone + Send + Sync + 'static {
    /// Packets of `bytes` in all left together.
    fn on_sent(&self, _now: Instant, _bytes: u64) {}

    /// A packet of `bytes` that left at `sent` is acknowledged.
    fn on_ack(&self, now: Instant, sent: Instant, bytes: u64);

    /// All packets of an acknowledgement were reported; `in_flight` bytes are left.
    fn on_end_acks(&self, now: Instant, in_flight: u64);

    /// Packets of `bytes` in all are lost.
    fn on_lost(&self, bytes: u64);
}

/// Builds controllers of `inner`, each with the observer that `observer` gives.
pub(crate) struct WatchedFactory<F> {
    pub(crate) inner: Factory,
    pub(crate) observer: F,
}

impl<O: Observer, F: Fn() -> O + Send + Sync + 'static> ControllerFactory for WatchedFactory<F> {
    fn build(self: Arc<Self>, now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        let inner = self.inner.clone().build(now, current_mtu);
        Box::new(Watched { inner, observer: (self.observer)() })
    }
}

/// A controller with its observer.
pub(crate) struct Watched<O> {
    pub(crate) inner: Box<dyn Controller>,
    pub(crate) observer: O,
}

impl<O: Observer> Controller for Watched<O> {
    fn on_sent(&mut self, now: Instant, bytes: u64, last_packet_number: u64) {
        self.observer.on_sent(now, bytes);
        self.inner.on_sent(now, bytes, last_packet_number);
    }

    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, rtt: &RttEstimator) {
        self.observer.on_ack(now, sent, bytes);
        self.inner.on_ack(now, sent, bytes, app_limited, rtt);
    }

    fn on_end_acks(&mut self, now: Instant, in_flight: u64, app_limited: bool, largest: Option<u64>) {
        self.observer.on_end_acks(now, in_flight);
        self.inner.on_end_acks(now, in_flight, app_limited, largest);
    }

    fn on_congestion_event(&mut self, now: Instant, sent: Instant, is_persistent: bool, lost_bytes: u64) {
        self.observer.on_lost(lost_bytes);
        self.inner.on_congestion_event(now, sent, is_persistent, lost_bytes);
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.inner.on_mtu_update(new_mtu);
    }

    fn window(&self) -> u64 {
        self.inner.window()
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(Self { inner: self.inner.clone_box(), observer: self.observer.clone() })
    }

    fn initial_window(&self) -> u64 {
        self.inner.initial_window()
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}
