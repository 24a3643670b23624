//! Serialises one datagram at a time from a drop-tail queue: what all links with a rate share.

use super::{Counts, Datagram, QueueLimit, queue::DropTail};
use crate::clock::Nanos;

/// How long the next datagram takes. The state is where the link stands after the last one.
pub(super) trait Service: Send {
    /// The link was idle and starts to serve at `now`.
    fn start(&mut self, now: Nanos);

    /// When the next datagram of this size is through; [`Nanos::MAX`] if never.
    fn finish(&mut self, bytes: u32) -> Nanos;
}

#[derive(Debug)]
pub(super) struct Serialiser<S> {
    service: S,
    queue: DropTail,
    in_service: Option<Datagram>,
    /// When what is in service is through; [`Nanos::MAX`] for never.
    through_at: Nanos,
    counts: Counts,
}

/// [`super::LinkBox`], but for the label.
impl<S: Service> Serialiser<S> {
    pub(super) fn new(service: S, limit: QueueLimit) -> Self {
        Self {
            service,
            queue: DropTail::new(limit),
            in_service: None,
            through_at: Nanos::MAX,
            counts: Counts::default(),
        }
    }

    pub(super) fn put(&mut self, datagram: Datagram, now: Nanos) {
        self.counts.received.add(datagram);
        if self.in_service.is_none() {
            self.service.start(now);
            self.serve(Some(datagram));
        } else if !self.queue.offer(datagram) {
            self.counts.dropped.add(datagram);
        }
    }

    /// Departures due at `now` come before arrivals at `now`: capacity that passed unused is lost.
    pub(super) fn take(&mut self, now: Nanos) -> Option<Datagram> {
        if self.through_at > now {
            return None;
        }
        let through = self.in_service?;
        self.counts.delivered.add(through);
        let next = self.queue.take();
        self.serve(next);
        Some(through)
    }

    fn serve(&mut self, next: Option<Datagram>) {
        self.in_service = next;
        self.through_at = next.map_or(Nanos::MAX, |datagram| self.service.finish(datagram.bytes));
    }

    pub(super) fn next_at(&self) -> Nanos {
        self.through_at
    }

    pub(super) fn counts(&self) -> Counts {
        let mut inside = self.queue.contents();
        self.in_service.into_iter().for_each(|datagram| inside.add(datagram));
        Counts { inside, ..self.counts }
    }
}
