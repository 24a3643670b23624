//! Keeps what a server wants to know of the path to a viewer: how much is in flight, round trips, its rate,
//! and whether what viewers need first was lost.

use std::{
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::{Duration, Instant},
};

use emulator_host::{Nanos, Rate, congestion::RecentMinimum};
use tokio::sync::Notify;

use super::{observed::Observed, watched::Observer};
use crate::clock::Clock;

/// Packets with nothing but acknowledgements are shorter. They are never in flight: nobody acknowledges them.
const MIN_BYTES: u64 = 100;
/// For how long a peer may hold an acknowledgement back (RFC 9000, 18.2).
const MAX_ACK_DELAY: Nanos = Nanos::from_ms(25);

/// What is known of the path of one connection.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct PathState {
    /// Bytes of UDP payload in flight, of all kinds.
    pub(crate) in_flight: u64,
    /// The newest round trip, the delay of its acknowledgement included.
    pub(crate) newest_rtt: Option<Duration>,
    /// The least of late, at most since [`PathWatch::reset_least_rtt`].
    pub(crate) least_rtt: Option<Duration>,
    /// When that was measured.
    pub(crate) least_rtt_at: Option<Instant>,
    /// Mean deviation of round trips.
    pub(crate) rtt_variation: Option<Duration>,
    /// Estimated rate of the path, once something was acknowledged.
    pub(crate) rate: Option<Rate>,
}

#[derive(Debug)]
struct Known {
    observed: Observed,
    newest_rtt: Option<Duration>,
    least_rtt: RecentMinimum,
    /// What round trips are dated by; sessions do not restart it.
    clock: Clock,
    /// When the latest packet of the acknowledgement that is being read was sent.
    acked: Option<Instant>,
    /// Packets sent before this do not count for the least round trip.
    since: Option<Instant>,
    /// Bytes of media that the transport had and had not sent. They leave before what is in streams.
    waiting: u64,
    /// What left until then was control alone; nothing is known before it has all left once.
    control_until: Option<Nanos>,
    /// Bytes that leave before what was lost of control has left again.
    owed: u64,
}

/// Shared by a controller and whoever asks.
#[derive(Clone, Debug)]
pub(crate) struct PathWatch {
    known: Arc<Mutex<Known>>,
    news: Arc<Notify>,
}

impl PathWatch {
    /// Nothing seen.
    pub(crate) fn new() -> Self {
        let known = Known {
            observed: Observed::new(Clock::start(), MAX_ACK_DELAY),
            newest_rtt: None,
            least_rtt: RecentMinimum::new(),
            clock: Clock::start(),
            acked: None,
            since: None,
            waiting: 0,
            control_until: None,
            owed: 0,
        };
        Self { known: Arc::new(Mutex::new(known)), news: Arc::default() }
    }

    fn lock(&self) -> MutexGuard<'_, Known> {
        self.known.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// What is known by now.
    pub(crate) fn state(&self) -> PathState {
        let known = self.lock();
        let least_at = known.least_rtt.measured_at();
        PathState {
            in_flight: known.observed.in_flight(),
            newest_rtt: known.newest_rtt,
            least_rtt: least_at.map(|_| Duration::from_nanos(known.least_rtt.get().0)),
            least_rtt_at: least_at.map(|at| known.clock.instant(at)),
            rtt_variation: known.newest_rtt.map(|_| Duration::from_nanos(known.observed.variation().0)),
            rate: known.observed.path_rate(),
        }
    }

    /// The link has changed at `now`: the least round trip is measured anew.
    pub(crate) fn reset_least_rtt(&self, now: Instant) {
        let mut known = self.lock();
        (known.least_rtt, known.since) = (RecentMinimum::new(), Some(now));
    }

    /// A session begins after the handshake, of which only round trips say something of the path: what it
    /// sent was little, and several packets in one datagram are acknowledged one by one.
    pub(crate) fn begin_session(&self) {
        self.lock().observed.restart(Clock::start(), MAX_ACK_DELAY);
    }

    /// Ready once something was acknowledged or lost since it was ready last. Dropping the future loses
    /// nothing.
    pub(crate) async fn news(&self) {
        self.news.notified().await;
    }

    /// Whether the source has too little to send from now on.
    pub(crate) fn set_source_limited(&self, limited: bool) {
        self.lock().observed.set_source_limited(limited);
    }

    /// The transport has `bytes` of media that it has not sent.
    pub(crate) fn set_waiting(&self, bytes: u64) {
        self.lock().waiting = bytes;
    }

    /// What leaves from `now` on may be media; all before was control.
    pub(crate) fn on_control_left(&self, now: Instant) {
        let mut known = self.lock();
        known.control_until = Some(known.observed.clock().nanos(now));
    }

    /// Whether control was lost and waits to leave again.
    pub(crate) fn owes_control(&self) -> bool {
        self.lock().owed > 0
    }
}

impl Observer for PathWatch {
    fn on_sent(&self, now: Instant, bytes: u64) {
        if bytes < MIN_BYTES {
            return;
        }
        let mut known = self.lock();
        let at = known.observed.clock().nanos(now);
        known.observed.on_sent(bytes, at);
        known.waiting = known.waiting.saturating_sub(bytes);
        known.owed = known.owed.saturating_sub(bytes);
    }

    fn on_ack(&self, now: Instant, sent: Instant, bytes: u64) {
        let mut known = self.lock();
        known.acked = known.acked.max(Some(sent));
        let clock = known.observed.clock();
        known.observed.on_ack(clock.nanos(sent), bytes, clock.nanos(now));
    }

    fn on_end_acks(&self, now: Instant, in_flight: u64) {
        let mut known = self.lock();
        let at = known.observed.clock().nanos(now);
        known.observed.on_end_acks(in_flight, at);
        if let Some(sent) = known.acked.take() {
            let rtt = now.saturating_duration_since(sent);
            known.newest_rtt = Some(rtt);
            if known.since.is_none_or(|since| sent >= since) {
                let at = known.clock.nanos(now);
                known.least_rtt.take(Clock::span(rtt), at);
            }
        }
        drop(known);
        self.news.notify_one();
    }

    fn on_lost(&self, bytes: u64) {
        let mut known = self.lock();
        let until = known.control_until.unwrap_or(Nanos::ZERO);
        let lost = known.observed.on_lost(bytes, until);
        if lost > 0 {
            known.owed = known.owed.max(known.waiting) + lost;
        }
        drop(known);
        self.news.notify_one();
    }
}
