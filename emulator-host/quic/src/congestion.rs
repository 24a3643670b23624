//! Builds the congestion controllers of connections: those of `quinn`, and SCReAM of `emulator-host`.

mod observed;
mod path_watch;
mod watched;

use std::{any::Any, sync::Arc, time::Instant};

use emulator_host::{
    ControllerKind, Nanos,
    congestion::{self, Acked, Controller as _, Rtt, Scream, initial_window},
};
use quinn_proto::{
    RttEstimator,
    congestion::{BbrConfig, Controller, ControllerFactory, CubicConfig, NewRenoConfig},
};

pub(crate) use observed::{Observed, Watch};
pub(crate) use path_watch::PathWatch;
#[cfg(test)]
pub(crate) use watched::Observer;
pub(crate) use watched::{Factory, Watched, WatchedFactory};

/// What governs how much of a connection may be on its way. `quinn` paces all of them alike: a window is
/// spread over four fifths of a round trip.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum CongestionControl {
    /// NewReno (RFC 9002), of `quinn`.
    NewReno,
    /// CUBIC (RFC 8312), of `quinn`.
    #[default]
    Cubic,
    /// The first BBR, of `quinn`, whose authors call it experimental.
    Bbr,
    /// SCReAMv2 (RFC 8298bis), the emulator's own. That acknowledgements are held back up to 25 ms counts as
    /// delay of the queue: the transport does not say for how long each was.
    Scream,
}

impl CongestionControl {
    /// Name in reports, and on the command line.
    pub fn name(self) -> &'static str {
        match self {
            Self::NewReno => "newreno",
            Self::Cubic => "cubic",
            Self::Bbr => "bbr",
            Self::Scream => "scream",
        }
    }

    /// The one that stands for `kind` of the emulator; the two models of the paper's BBR have none.
    pub(crate) fn of(kind: ControllerKind) -> Option<Self> {
        match kind {
            ControllerKind::NewReno => Some(Self::NewReno),
            ControllerKind::Cubic => Some(Self::Cubic),
            ControllerKind::Scream => Some(Self::Scream),
            ControllerKind::BbrModel | ControllerKind::BbrPaper => None,
        }
    }

    /// What makes it for connections whose datagrams are up to `datagram_bytes` long, with the initial window
    /// of the model.
    pub(crate) fn factory(self, datagram_bytes: u16) -> Factory {
        let window = initial_window(datagram_bytes.into());
        match self {
            Self::NewReno => {
                let mut reno = NewRenoConfig::default();
                reno.initial_window(window);
                Arc::new(reno)
            }
            Self::Cubic => {
                let mut cubic = CubicConfig::default();
                cubic.initial_window(window);
                Arc::new(cubic)
            }
            Self::Bbr => {
                let mut bbr = BbrConfig::default();
                bbr.initial_window(window);
                Arc::new(bbr)
            }
            Self::Scream => Arc::new(ScreamConfig { datagram_bytes }),
        }
    }

    /// As [`Self::factory`], each with a [`PathWatch`] of its own.
    pub(crate) fn watched(self, datagram_bytes: u16) -> Factory {
        Arc::new(WatchedFactory { inner: self.factory(datagram_bytes), observer: PathWatch::new })
    }
}

struct ScreamConfig {
    datagram_bytes: u16,
}

impl ControllerFactory for ScreamConfig {
    fn build(self: Arc<Self>, now: Instant, _current_mtu: u16) -> Box<dyn Controller> {
        let datagram_bytes = self.datagram_bytes.into();
        Box::new(ScreamController {
            inner: Scream::new(datagram_bytes),
            initial_window: initial_window(datagram_bytes),
            rtt: Rtt::new(Nanos::ZERO),
            began: now,
            newest: None,
        })
    }
}

/// SCReAM behind the interface of `quinn`.
#[derive(Clone)]
pub(crate) struct ScreamController {
    inner: Scream,
    initial_window: u64,
    rtt: Rtt,
    began: Instant,
    /// When the latest packet of this acknowledgement was sent.
    newest: Option<Instant>,
}

impl ScreamController {
    fn nanos(&self, at: Instant) -> Nanos {
        let since = at.saturating_duration_since(self.began);
        Nanos(u64::try_from(since.as_nanos()).unwrap_or(u64::MAX))
    }
}

impl Controller for ScreamController {
    fn on_ack(&mut self, now: Instant, sent: Instant, bytes: u64, app_limited: bool, _rtt: &RttEstimator) {
        let acked = Acked { bytes, sent_at: self.nanos(sent), app_limited };
        let now = self.nanos(now);
        congestion::Controller::on_ack(&mut self.inner, acked, &self.rtt, now);
        self.newest = self.newest.max(Some(sent));
    }

    fn on_end_acks(&mut self, now: Instant, in_flight: u64, _app_limited: bool, _largest: Option<u64>) {
        let at = self.nanos(now);
        if let Some(sent) = self.newest.take() {
            self.rtt.update(at - self.nanos(sent), Nanos::ZERO, at);
        }
        self.inner.on_ack_end(None, in_flight, &self.rtt, at);
    }

    fn on_congestion_event(&mut self, now: Instant, sent: Instant, is_persistent: bool, lost_bytes: u64) {
        let (sent, now) = (self.nanos(sent), self.nanos(now));
        // What is in flight says nothing to it here.
        self.inner.on_congestion(sent, lost_bytes, 0, now);
        if is_persistent {
            self.inner.on_persistent_congestion();
            self.rtt.on_persistent_congestion();
        }
    }

    fn on_mtu_update(&mut self, _new_mtu: u16) {}

    fn window(&self) -> u64 {
        congestion::Controller::window(&self.inner)
    }

    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(self.clone())
    }

    fn initial_window(&self) -> u64 {
        self.initial_window
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}

#[cfg(test)]
mod tests {
    use std::time::Duration;

    use super::*;

    #[test]
    fn what_is_on_its_way_is_what_left_and_was_neither_acknowledged_nor_lost() {
        let factory = CongestionControl::NewReno.watched(1200);
        let built = factory.build(Instant::now(), 1200);
        let mut controller = built.into_any().downcast::<Watched<PathWatch>>().unwrap();
        // After that: what was before a watch began is all one to it.
        let began = Instant::now();
        let at = |ms| began + Duration::from_millis(ms);
        let watch = controller.observer.clone();
        // Three datagrams, two at one time, and an acknowledgement.
        controller.on_sent(at(1), 1200, 0);
        controller.on_sent(at(1), 1200, 1);
        controller.on_sent(at(2), 1000, 2);
        controller.on_sent(at(3), 40, 3);
        assert_eq!(watch.state().in_flight, 3400);
        controller.on_congestion_event(at(40), at(1), false, 1200);
        assert_eq!(watch.state().in_flight, 2200);
        controller.observer.on_ack(at(41), at(2), 1000);
        controller.on_end_acks(at(41), 1000, false, Some(2));
        assert_eq!(watch.state().in_flight, 1000);
        // What was acknowledged in 40 ms is an estimate of the path.
        assert!(watch.state().rate.is_some());
        // A copy, as the transport gives it away, is of the same connection.
        let copy = controller.clone_box().into_any().downcast::<Watched<PathWatch>>().unwrap();
        copy.observer.reset_least_rtt(at(50));
        assert_eq!((watch.state().least_rtt, controller.window()), (None, 6000));
    }

    #[test]
    fn control_that_was_lost_is_owed_until_it_has_left_again() {
        let factory = CongestionControl::NewReno.watched(1200);
        let built = factory.build(Instant::now(), 1200);
        let mut controller = built.into_any().downcast::<Watched<PathWatch>>().unwrap();
        // After that: what was before a watch began is all one to it.
        let began = Instant::now();
        let at = |ms| began + Duration::from_millis(ms);
        let watch = controller.observer.clone();
        // Two datagrams of control, then one of media; another waits in the transport.
        controller.on_sent(at(1), 1200, 0);
        controller.on_sent(at(2), 1100, 1);
        watch.on_control_left(at(3));
        controller.on_sent(at(4), 1000, 2);
        watch.set_waiting(900);
        // The second and the third are lost.
        controller.observer.on_ack(at(40), at(1), 1200);
        assert!(!watch.owes_control());
        controller.on_congestion_event(at(41), at(4), false, 2100);
        assert!(watch.owes_control());
        // The media that waits leaves first; an acknowledgement alone counts for nothing.
        for (bytes, owes) in [(950, true), (50, true), (1100, false)] {
            controller.on_sent(at(42), bytes, 3);
            assert_eq!(watch.owes_control(), owes, "{bytes}");
        }
    }

    #[test]
    fn what_a_handshake_sent_is_never_taken_for_lost_control() {
        let (watch, began) = (PathWatch::new(), Instant::now());
        let at = |ms| began + Duration::from_millis(ms);
        // One datagram of two packets, each acknowledged by itself.
        watch.on_sent(at(0), 1200);
        watch.on_ack(at(40), at(0), 150);
        watch.on_ack(at(41), at(0), 1050);
        watch.on_end_acks(at(41), 0);
        watch.begin_session();
        let begun = Instant::now();
        [1200, 650].into_iter().for_each(|bytes| watch.on_sent(begun, bytes));
        watch.on_control_left(begun);
        watch.on_sent(begun + Duration::from_millis(1), 1000);
        watch.on_lost(2850);
        assert!(watch.owes_control());
        [1200, 650].into_iter().for_each(|bytes| watch.on_sent(Instant::now(), bytes));
        assert!(!watch.owes_control());
    }
}
