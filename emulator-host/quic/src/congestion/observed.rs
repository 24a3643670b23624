//! Watches a congestion controller at work, and derives what the sender of media wants to know of the path.

use std::{
    collections::VecDeque,
    sync::{Arc, Mutex, MutexGuard, PoisonError},
    time::Instant,
};

use emulator_host::{
    Bytes, Nanos, Rate,
    congestion::{DeliveryRate, DeliverySample, RecentMinimum, Rtt},
};

use super::watched::Observer;
use crate::clock::Clock;

/// Time for which an unacknowledged packet is remembered.
const MEMORY: Nanos = Nanos::from_s(10);
/// No measurement of the path spans less.
const SHORTEST: Nanos = Nanos::from_ms(1);

/// A packet that was sent, as the estimate of the path's rate needs it.
#[derive(Clone, Copy, Debug)]
struct Sent {
    at: Nanos,
    bytes: u64,
    delivered: u64,
    delivered_at: Nanos,
    first_sent_at: Nanos,
    source_limited: bool,
}

/// What was seen. The rate of the path is estimated as in the model.
#[derive(Debug)]
pub(crate) struct Observed {
    clock: Clock,
    sent: VecDeque<Sent>,
    in_flight: u64,
    delivered: u64,
    delivered_at: Nanos,
    first_sent_at: Nanos,
    newest: Option<Sent>,
    path: DeliveryRate,
    rtt: Rtt,
    source_limited: bool,
    news: bool,
}

impl Observed {
    pub(crate) fn new(clock: Clock, max_ack_delay: Nanos) -> Self {
        Self {
            clock,
            sent: VecDeque::new(),
            in_flight: 0,
            delivered: 0,
            delivered_at: Nanos::ZERO,
            first_sent_at: Nanos::ZERO,
            newest: None,
            path: DeliveryRate::new(),
            rtt: Rtt::new(max_ack_delay),
            source_limited: false,
            news: false,
        }
    }

    /// Time counts by `clock` from now on; what is known of the round trip stays.
    pub(crate) fn restart(&mut self, clock: Clock, max_ack_delay: Nanos) {
        let (mut rtt, in_flight) = (self.rtt.clone(), self.in_flight);
        rtt.restart_clock();
        *self = Self { rtt, in_flight, ..Self::new(clock, max_ack_delay) };
    }

    /// An ack-eliciting packet has left.
    pub(crate) fn on_sent(&mut self, bytes: u64, now: Nanos) {
        if self.in_flight == 0 {
            self.first_sent_at = now;
            self.delivered_at = now;
        }
        self.in_flight += bytes;
        self.sent.push_back(Sent {
            at: now,
            bytes,
            delivered: self.delivered,
            delivered_at: self.delivered_at,
            first_sent_at: self.first_sent_at,
            source_limited: self.source_limited,
        });
    }

    /// Whether the source has too little to send from now on.
    pub(crate) fn set_source_limited(&mut self, limited: bool) {
        self.source_limited = limited;
    }

    /// Whether something was acknowledged or lost since the last question.
    pub(crate) fn take_news(&mut self) -> bool {
        std::mem::take(&mut self.news)
    }

    /// UDP payload bytes in flight.
    pub(crate) fn in_flight(&self) -> u64 {
        self.in_flight
    }

    /// Mean deviation of the round trip.
    pub(crate) fn variation(&self) -> Nanos {
        self.rtt.variation()
    }

    /// The newest round trip; zero before the first.
    pub(crate) fn newest_round_trip(&self) -> Nanos {
        self.rtt.latest()
    }

    /// The smallest round trip of late.
    pub(crate) fn recent_round_trips(&self) -> &RecentMinimum {
        self.rtt.recent()
    }

    /// Estimated rate of the path.
    pub(crate) fn path_rate(&self) -> Option<Rate> {
        self.path.estimate()
    }

    /// The clock of the times that it takes.
    pub(crate) fn clock(&self) -> Clock {
        self.clock
    }

    pub(crate) fn on_ack(&mut self, sent_at: Nanos, bytes: u64, now: Nanos) {
        self.delivered += bytes;
        self.delivered_at = now;
        // Packets of one instant and size are alike, so any of them stands for the one that was meant.
        let first = self.sent.partition_point(|sent| sent.at < sent_at);
        let alike = self.sent.iter().skip(first).take_while(|sent| sent.at == sent_at);
        let place = alike.into_iter().position(|sent| sent.bytes == bytes);
        let found = place.and_then(|place| self.sent.remove(first + place));
        if let Some(found) = found.filter(|found| self.newest.is_none_or(|newest| newest.at <= found.at)) {
            self.newest = Some(found);
        }
    }

    pub(crate) fn on_end_acks(&mut self, in_flight: u64, now: Nanos) {
        self.in_flight = in_flight;
        self.news = true;
        while self.sent.front().is_some_and(|sent| sent.at + MEMORY < now) {
            self.sent.pop_front();
        }
        let Some(sent) = self.newest.take() else { return };
        self.rtt.update(now - sent.at, Nanos::ZERO, now);
        self.first_sent_at = sent.at;
        let span = (sent.at - sent.first_sent_at).max(now - sent.delivered_at);
        if span >= self.rtt.minimum().max(SHORTEST) {
            let rate = Rate::over(Bytes(self.delivered - sent.delivered), span);
            let sample = DeliverySample { rate, app_limited: sent.source_limited };
            self.path.take(sample, self.rtt.smoothed().times(10), now);
        }
    }

    /// Packets of `bytes` in all are lost; of those, `bytes` that left at `until` or before. Whatever left
    /// before one that is lost and is not acknowledged is lost with it (RFC 9002, 6.1).
    pub(crate) fn on_lost(&mut self, bytes: u64, until: Nanos) -> u64 {
        self.in_flight = self.in_flight.saturating_sub(bytes);
        self.news = true;
        let (mut left, mut early) = (bytes, 0);
        while let Some(sent) = self.sent.front().copied().filter(|sent| sent.bytes <= left) {
            self.sent.pop_front();
            left -= sent.bytes;
            early += if sent.at <= until { sent.bytes } else { 0 };
        }
        early
    }
}

/// What was seen, for the controller and for the sender.
#[derive(Clone, Debug)]
pub(crate) struct Watch(Arc<Mutex<Observed>>);

impl Watch {
    pub(crate) fn new(observed: Observed) -> Self {
        Self(Arc::new(Mutex::new(observed)))
    }

    pub(crate) fn look(&self) -> MutexGuard<'_, Observed> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl Observer for Watch {
    fn on_ack(&self, now: Instant, sent: Instant, bytes: u64) {
        let mut observed = self.look();
        let (sent_at, at) = (observed.clock.nanos(sent), observed.clock.nanos(now));
        observed.on_ack(sent_at, bytes, at);
    }

    fn on_end_acks(&self, now: Instant, in_flight: u64) {
        let mut observed = self.look();
        let at = observed.clock.nanos(now);
        observed.on_end_acks(in_flight, at);
    }

    fn on_lost(&self, bytes: u64) {
        self.look().on_lost(bytes, Nanos::ZERO);
    }
}
