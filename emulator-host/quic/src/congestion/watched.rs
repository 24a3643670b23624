//! Watches a congestion controller at work, for what `quinn` keeps to itself: how much is on its way, and
//! each round trip.

use std::{
    any::Any,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use quinn_proto::{
    RttEstimator,
    congestion::{Controller, ControllerFactory},
};

pub(crate) type Factory = Arc<dyn ControllerFactory + Send + Sync>;

/// Packets that carry acknowledgements alone are shorter, and are not on their way: nobody acknowledges them.
const MIN_BYTES: u64 = 100;

/// What is known of the path of one connection.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Known {
    /// Bytes of UDP payload on their way, of all kinds.
    pub(crate) in_flight: u64,
    /// The newest round trip, that an acknowledgement was held back included.
    pub(crate) newest: Option<Duration>,
    /// The least of them since the path was last said to be another.
    pub(crate) least: Option<Duration>,
    /// When the last packet left, and how long the datagrams were that left at once with it.
    batch: Option<(Instant, u64)>,
    /// When the latest packet of the acknowledgement that is being read was sent.
    acked: Option<Instant>,
    /// Since when the path is this one; what was sent before says nothing of it.
    since: Option<Instant>,
}

/// Shared by a controller and whoever asks.
#[derive(Clone, Debug, Default)]
pub(crate) struct Watch(Arc<Mutex<Known>>);

impl Watch {
    fn lock(&self) -> MutexGuard<'_, Known> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known by now.
    pub(crate) fn look(&self) -> Known {
        *self.lock()
    }

    /// The path is another from here on, though nobody has moved: its least round trip may be longer.
    pub(crate) fn forget(&self, now: Instant) {
        let mut known = self.lock();
        (known.least, known.since) = (None, Some(now));
    }
}

/// Makes controllers that are watched.
pub(super) struct WatchedFactory(pub(super) Factory);

impl ControllerFactory for WatchedFactory {
    fn build(self: Arc<Self>, now: Instant, current_mtu: u16) -> Box<dyn Controller> {
        let inner = self.0.clone().build(now, current_mtu);
        Box::new(Watched { inner, watch: Watch::default() })
    }
}

/// A controller that is watched.
pub(crate) struct Watched {
    pub(crate) inner: Box<dyn Controller>,
    pub(crate) watch: Watch,
}

impl Controller for Watched {
    fn on_sent(&mut self, now: Instant, bytes: u64, last_packet_number: u64) {
        let mut known = self.watch.lock();
        // Of datagrams that leave together the transport tells the sum so far.
        let before = known.batch.filter(|(at, sum)| *at == now && *sum < bytes).map_or(0, |(_, sum)| sum);
        known.batch = Some((now, bytes));
        if bytes - before >= MIN_BYTES {
            known.in_flight += bytes - before;
        }
        drop(known);
        self.inner.on_sent(now, bytes, last_packet_number);
    }

    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, rtt: &RttEstimator) {
        let mut known = self.watch.lock();
        known.acked = known.acked.max(Some(sent));
        drop(known);
        self.inner.on_ack(now, sent, bytes, app_limited, rtt);
    }

    fn on_end_acks(&mut self, now: Instant, in_flight: u64, app_limited: bool, largest: Option<u64>) {
        let mut known = self.watch.lock();
        known.in_flight = in_flight;
        if let Some(sent) = known.acked.take() {
            let trip = now.saturating_duration_since(sent);
            known.newest = Some(trip);
            if known.since.is_none_or(|since| sent >= since) {
                known.least = Some(known.least.map_or(trip, |least| least.min(trip)));
            }
        }
        drop(known);
        self.inner.on_end_acks(now, in_flight, app_limited, largest);
    }

    fn on_congestion_event(&mut self, now: Instant, sent: Instant, is_persistent: bool, lost_bytes: u64) {
        let mut known = self.watch.lock();
        known.in_flight = known.in_flight.saturating_sub(lost_bytes);
        drop(known);
        self.inner.on_congestion_event(now, sent, is_persistent, lost_bytes);
    }

    fn on_mtu_update(&mut self, new_mtu: u16) {
        self.inner.on_mtu_update(new_mtu);
    }

    fn window(&self) -> u64 {
        self.inner.window()
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(Self { inner: self.inner.clone_box(), watch: self.watch.clone() })
    }

    fn initial_window(&self) -> u64 {
        self.inner.initial_window()
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}
