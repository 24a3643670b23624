//! Serialises one datagram at a time from a drop-tail queue: what all links with a rate share.

use super::{BoxOutput, Counts, Datagram, QueueLimit, queue::DropTail};
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
    in_service: Option<(Datagram, Nanos)>,
    counts: Counts,
}

impl<S: Service> Serialiser<S> {
    pub(super) fn new(service: S, limit: QueueLimit) -> Self {
        Self { service, queue: DropTail::new(limit), in_service: None, counts: Counts::default() }
    }

    /// Departures due at `now` come before arrivals at `now`: capacity that passed unused is lost.
    pub(super) fn step(&mut self, input: Option<Datagram>, now: Nanos) -> BoxOutput {
        let leaving = self.take_due(now);
        if let Some(datagram) = input {
            self.enter(datagram, now);
        }
        match (leaving, self.next_at()) {
            (Some(datagram), _) => BoxOutput::Datagram(datagram),
            (None, Nanos::MAX) => BoxOutput::Idle,
            (None, at) => BoxOutput::Wake(at),
        }
    }

    /// [`super::LinkBox::carry`].
    pub(super) fn carry(
        &mut self,
        input: Option<Datagram>,
        now: Nanos,
        leave: &mut dyn FnMut(Datagram),
    ) -> Nanos {
        let mut leaving = self.take_due(now);
        if let Some(datagram) = input {
            self.enter(datagram, now);
        }
        while let Some(datagram) = leaving {
            leave(datagram);
            leaving = self.take_due(now);
        }
        self.next_at()
    }

    /// What is through at `now`; the next comes into service.
    fn take_due(&mut self, now: Nanos) -> Option<Datagram> {
        let (datagram, _) = self.in_service.filter(|(_, at)| *at <= now)?;
        self.counts.delivered.add(datagram);
        self.in_service = self.queue.take().map(|next| (next, self.service.finish(next.bytes)));
        Some(datagram)
    }

    fn enter(&mut self, datagram: Datagram, now: Nanos) {
        self.counts.received.add(datagram);
        if self.in_service.is_none() {
            self.service.start(now);
            self.in_service = Some((datagram, self.service.finish(datagram.bytes)));
        } else if !self.queue.offer(datagram) {
            self.counts.dropped.add(datagram);
        }
    }

    /// When what is in service is through; [`Nanos::MAX`] for never.
    fn next_at(&self) -> Nanos {
        self.in_service.map_or(Nanos::MAX, |(_, at)| at)
    }

    pub(super) fn counts(&self) -> Counts {
        let mut inside = self.queue.contents();
        if let Some((datagram, _)) = self.in_service {
            inside.add(datagram);
        }
        Counts { inside, ..self.counts }
    }
}
