//! Keeps what a server wants to know of the path to a viewer: how much is in flight, and round trips.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use super::watched::Observer;

/// Packets with nothing but acknowledgements are shorter. They are never in flight: nobody acknowledges them.
const MIN_BYTES: u64 = 100;

/// What is known of the path of one connection.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PathState {
    /// Bytes of UDP payload in flight, of all kinds.
    pub(crate) in_flight: u64,
    /// The newest round trip, the delay of its acknowledgement included.
    pub(crate) newest_rtt: Option<Duration>,
    /// The least of them since [`PathWatch::reset_least_rtt`].
    pub(crate) least_rtt: Option<Duration>,
    /// When the last packet left, and bytes of all that left together with it.
    batch: Option<(Instant, u64)>,
    /// When the latest packet of the acknowledgement that is being read was sent.
    acked: Option<Instant>,
    /// Packets sent before this do not count for the least round trip.
    since: Option<Instant>,
}

/// Shared by a controller and whoever asks.
#[derive(Clone, Debug, Default)]
pub(crate) struct PathWatch(Arc<Mutex<PathState>>);

impl PathWatch {
    fn lock(&self) -> MutexGuard<'_, PathState> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known by now.
    pub(crate) fn state(&self) -> PathState {
        *self.lock()
    }

    /// The link has changed at `now`: the least round trip is measured anew.
    pub(crate) fn reset_least_rtt(&self, now: Instant) {
        let mut state = self.lock();
        (state.least_rtt, state.since) = (None, Some(now));
    }
}

impl Observer for PathWatch {
    fn on_sent(&self, now: Instant, bytes: u64) {
        let mut state = self.lock();
        let before = state.batch.filter(|(at, sum)| *at == now && *sum < bytes).map_or(0, |(_, sum)| sum);
        state.batch = Some((now, bytes));
        if bytes - before >= MIN_BYTES {
            state.in_flight += bytes - before;
        }
    }

    fn on_ack(&self, _now: Instant, sent: Instant, _bytes: u64) {
        let mut state = self.lock();
        state.acked = state.acked.max(Some(sent));
    }

    fn on_end_acks(&self, now: Instant, in_flight: u64) {
        let mut state = self.lock();
        state.in_flight = in_flight;
        if let Some(sent) = state.acked.take() {
            let rtt = now.saturating_duration_since(sent);
            state.newest_rtt = Some(rtt);
            if state.since.is_none_or(|since| sent >= since) {
                state.least_rtt = Some(state.least_rtt.map_or(rtt, |least| least.min(rtt)));
            }
        }
    }

    fn on_lost(&self, bytes: u64) {
        let mut state = self.lock();
        state.in_flight = state.in_flight.saturating_sub(bytes);
    }
}
