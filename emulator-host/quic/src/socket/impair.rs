//! Puts an emulated link between an endpoint and its socket: what the server sends passes the boxes of
//! `emulator-host` in real time, a link of its own for every destination.
//!
//! It wraps the socket, and is no proxy in front of it: the endpoint goes on seeing real addresses, so that
//! address validation, amplification limits and migration mean what they mean without it.

use std::{
    collections::BTreeMap,
    fmt, io,
    net::SocketAddr,
    pin::Pin,
    sync::{Arc, Mutex, MutexGuard, PoisonError, Weak},
    task::{Context, Poll},
    time::{Duration, Instant},
};

use emulator_host::{
    Nanos,
    link::{BoxOutput, Chain, Datagram, LinkBox, PathConfig, PathError},
    session::IP_UDP_BYTES,
};
use quinn::{
    AsyncUdpSocket, UdpPoller,
    udp::{EcnCodepoint, RecvMeta, Transmit},
};
use tokio::sync::Notify;

/// Most destinations with a link of their own; what goes to others is lost.
const MAX_LINKS: usize = 1024;

/// The link that every viewer gets.
#[derive(Clone, Debug)]
pub struct Impairment {
    /// From the server to the viewer. What viewers send back is left alone. Without reordering.
    pub path: PathConfig,
    /// Seed of the luck of the first destination; the next has the next.
    pub seed: u64,
}

/// A socket with a link behind it.
pub(super) struct ImpairedSocket {
    inner: Arc<dyn AsyncUdpSocket>,
    links: Arc<Links>,
}

/// All links, and who wakes up for them.
struct Links {
    impairment: Impairment,
    began: Instant,
    by_destination: Mutex<BTreeMap<SocketAddr, Link>>,
    changed: Notify,
}

/// One destination's link and the bytes of what is inside.
struct Link {
    chain: Chain,
    next: u64,
    inside: BTreeMap<u64, Payload>,
}

/// A datagram on its way.
struct Payload {
    bytes: Vec<u8>,
    ecn: Option<EcnCodepoint>,
    source: Option<std::net::IpAddr>,
}

impl ImpairedSocket {
    /// Wraps `inner`. Must be called inside a tokio runtime: a task sends what is due.
    ///
    /// # Errors
    /// A path that is illegal.
    pub(super) fn new(inner: Arc<dyn AsyncUdpSocket>, impairment: Impairment) -> Result<Self, PathError> {
        impairment.path.build("impair", impairment.seed)?;
        let links = Arc::new(Links {
            impairment,
            began: Instant::now(),
            by_destination: Mutex::default(),
            changed: Notify::new(),
        });
        tokio::spawn(send_what_is_due(Arc::downgrade(&links), inner.clone()));
        Ok(Self { inner, links })
    }
}

/// Runs until the socket is dropped.
async fn send_what_is_due(links: Weak<Links>, socket: Arc<dyn AsyncUdpSocket>) {
    loop {
        let Some(links) = links.upgrade() else { return };
        let wake = links.send_due(&*socket);
        let pause = Duration::from_nanos(wake.0.saturating_sub(links.now().0));
        // A link that is idle is looked at again when something enters it, or when the socket may be gone.
        let pause = pause.min(Duration::from_secs(1));
        let changed = links.changed.notified();
        let _ = tokio::time::timeout(pause, changed).await;
    }
}

impl Links {
    fn now(&self) -> Nanos {
        Nanos(u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    fn lock(&self) -> MutexGuard<'_, BTreeMap<SocketAddr, Link>> {
        // Whoever panicked with it left a table of links that is still in order.
        self.by_destination.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Takes a datagram into the link of its destination.
    fn enter(&self, transmit: &Transmit<'_>, socket: &dyn AsyncUdpSocket) {
        let mut links = self.lock();
        let now = self.now();
        if links.len() >= MAX_LINKS && !links.contains_key(&transmit.destination) {
            links.retain(|_, link| !link.inside.is_empty());
            if links.len() >= MAX_LINKS {
                return;
            }
        }
        let seed = self.impairment.seed.wrapping_add(links.len() as u64);
        let link = match links.entry(transmit.destination) {
            std::collections::btree_map::Entry::Occupied(entry) => entry.into_mut(),
            std::collections::btree_map::Entry::Vacant(entry) => {
                // It was built once before, so it is legal.
                let Ok(chain) = self.impairment.path.build("impair", seed) else { return };
                entry.insert(Link { chain, next: 0, inside: BTreeMap::new() })
            }
        };
        let payload =
            Payload { bytes: transmit.contents.to_vec(), ecn: transmit.ecn, source: transmit.src_ip };
        let bytes = (payload.bytes.len() as u32).saturating_add(IP_UDP_BYTES);
        let datagram = Datagram { tag: link.next, bytes };
        link.inside.insert(link.next, payload);
        link.next += 1;
        link.pass(Some(datagram), now, transmit.destination, socket);
        drop(links);
        self.changed.notify_one();
    }

    /// Sends what is through by now; when to look again.
    fn send_due(&self, socket: &dyn AsyncUdpSocket) -> Nanos {
        let now = self.now();
        let mut wake = Nanos::MAX;
        for (destination, link) in self.lock().iter_mut() {
            if link.chain.next_wake() <= now {
                link.pass(None, now, *destination, socket);
            }
            wake = wake.min(link.chain.next_wake());
        }
        wake
    }
}

impl Link {
    fn pass(
        &mut self,
        mut input: Option<Datagram>,
        now: Nanos,
        destination: SocketAddr,
        socket: &dyn AsyncUdpSocket,
    ) {
        while let BoxOutput::Datagram(datagram) = self.chain.step(input.take(), now) {
            // Order is kept, so whatever entered before this and is still here was lost inside.
            let later = self.inside.split_off(&datagram.tag);
            self.inside = later;
            if let Some(payload) = self.inside.remove(&datagram.tag) {
                let transmit = Transmit {
                    destination,
                    ecn: payload.ecn,
                    contents: &payload.bytes,
                    segment_size: None,
                    src_ip: payload.source,
                };
                // A full socket loses the datagram, as a full queue on the way would.
                let _ = socket.try_send(&transmit);
            }
        }
        if self.chain.counts().inside.datagrams == 0 {
            self.inside.clear();
        }
    }
}

impl fmt::Debug for ImpairedSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ImpairedSocket").field("inner", &self.inner).finish_non_exhaustive()
    }
}

impl AsyncUdpSocket for ImpairedSocket {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        self.inner.clone().create_io_poller()
    }

    fn try_send(&self, transmit: &Transmit<'_>) -> io::Result<()> {
        self.links.enter(transmit, &*self.inner);
        Ok(())
    }

    fn poll_recv(
        &self,
        cx: &mut Context<'_>,
        bufs: &mut [io::IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        self.inner.poll_recv(cx, bufs, meta)
    }

    fn local_addr(&self) -> io::Result<SocketAddr> {
        self.inner.local_addr()
    }

    /// One: every datagram has its own luck.
    fn max_transmit_segments(&self) -> usize {
        1
    }

    fn max_receive_segments(&self) -> usize {
        self.inner.max_receive_segments()
    }

    fn may_fragment(&self) -> bool {
        self.inner.may_fragment()
    }
}
