//! A session hears what its transport tells of the path, here in the words of a script.

use std::{any::Any, future::poll_fn, pin::pin, task::Poll};

use emulator_host::Rate;
use quinn::{
    TransportConfig,
    congestion::{Controller, ControllerFactory},
};
use tokio::runtime::Builder;

use super::*;
use crate::{
    congestion::{Observer as _, PathWatch, Watched},
    socket::{
        carrier::{Opened, by_quic},
        channel::Channel,
        tests::{Loopback, graph, stream},
    },
};

/// Bytes of a datagram.
const DATAGRAM: u64 = 1200;

/// A controller that tells nobody what the connection does: all that is known of the path is in the script.
#[derive(Clone)]
struct Scripted(PathWatch);

impl ControllerFactory for Scripted {
    fn build(self: Arc<Self>, _now: Instant, _mtu: u16) -> Box<dyn Controller> {
        Box::new((*self).clone())
    }
}

impl Controller for Scripted {
    fn on_congestion_event(&mut self, _now: Instant, _sent: Instant, _is_persistent: bool, _lost: u64) {}

    fn on_mtu_update(&mut self, _mtu: u16) {}

    fn window(&self) -> u64 {
        10 * DATAGRAM
    }

    /// What whoever asks for the state of congestion control is given.
    fn clone_box(&self) -> Box<dyn Controller> {
        Box::new(Watched { inner: Box::new(self.clone()), observer: self.0.clone() })
    }

    fn initial_window(&self) -> u64 {
        self.window()
    }

    fn into_any(self: Box<Self>) -> Box<dyn Any> {
        self
    }
}

/// Runs `test` on one thread: while it does not wait, nothing else moves.
fn alone(test: impl Future<Output = ()>) {
    Builder::new_current_thread().enable_all().build().unwrap().block_on(test);
}

/// A session that has just begun over a connection to a client that says no more than the first byte.
struct Begun {
    watch: PathWatch,
    opened: Opened,
    offer: ServedStream,
    _ends: (Loopback, quinn::SendStream, quinn::RecvStream),
}

impl Begun {
    async fn new() -> Self {
        let watch = PathWatch::new();
        let mut transport = TransportConfig::default();
        transport.congestion_controller_factory(Arc::new(Scripted(watch.clone())));
        let loopback = Loopback::new(Arc::new(transport)).await;
        let (mut send, receive) = loopback.viewer.open_bi().await.unwrap();
        send.write_all(&[1]).await.unwrap();
        let opened = by_quic(Channel::accept(&loopback.served).await.unwrap());
        let offer = ServedStream::new("everything", &stream(), graph(&stream())).unwrap();
        Self { watch, opened, offer, _ends: (loopback, send, receive) }
    }

    fn viewer(&self) -> Viewer<'_> {
        let (limits, policy) = (ServerLimits::default(), PolicyKind::DeadlineUtility);
        Viewer::new(&self.opened.0, &self.offer, &limits, policy, 0).unwrap()
    }
}

/// Datagrams overtake what is in streams, and without the manifest they show nothing.
#[test]
fn before_the_first_receipt_media_waits_while_a_lost_part_of_the_manifest_is_to_leave_again() {
    alone(async {
        let begun = Begun::new().await;
        let (mut viewer, watch) = (begun.viewer(), &begun.watch);
        watch.on_sent(Instant::now(), DATAGRAM);
        assert!(viewer.may_send(), "the manifest has left");
        watch.on_sent(Instant::now(), DATAGRAM);
        watch.on_lost(DATAGRAM);
        assert!(!viewer.may_send(), "it was lost");
        viewer.tally.receipts = 1;
        assert!(viewer.may_send(), "who writes receipts has the manifest");
        viewer.tally.receipts = 0;
        assert!(!viewer.may_send());
        watch.on_sent(Instant::now(), DATAGRAM);
        assert!(viewer.may_send(), "it has left again");
    });
}

/// Before a client has the manifest it writes no receipt: only acknowledgements tell that a path is slow.
#[test]
fn before_the_first_receipt_acknowledgements_tell_the_rate_of_the_path() {
    alone(async {
        let mut begun = Begun::new().await;
        let watch = begun.watch.clone();
        let Begun { opened: (carrier, ending, send, control), offer, .. } = &mut begun;
        let (limits, policy) = (ServerLimits::default(), PolicyKind::DeadlineUtility);
        let mut viewer = Viewer::new(carrier, offer, &limits, policy, 0).unwrap();
        let assumed = viewer.round.path().rate;
        let (_stop, mut stopping) = watch::channel(false);
        {
            let mut run = pin!(viewer.run(ending, send, control, &limits, &mut stopping));
            let mut goes_on =
                async || poll_fn(|context| Poll::Ready(run.as_mut().poll(context).is_pending())).await;
            assert!(goes_on().await);
            // 120 kbit/s: a datagram takes 80 ms, and the way back 40 ms.
            let sent = Instant::now();
            (0..4).for_each(|_| watch.on_sent(sent, DATAGRAM));
            for count in 1..=4u32 {
                let now = sent + Duration::from_millis(40) + count * Duration::from_millis(80);
                watch.on_ack(now, sent, DATAGRAM);
                watch.on_end_acks(now, u64::from(4 - count) * DATAGRAM);
            }
            assert!(goes_on().await);
        }
        let heard = viewer.round.path().rate;
        assert!(heard <= Rate::from_kbps(120) && heard < assumed, "{heard:?}, assumed {assumed:?}");
    });
}
