//! Puts emulated links between an endpoint and its socket: what the server sends to a destination that has
//! one passes the boxes of `emulator-host` in real time.
//!
//! It wraps the socket, and is no proxy in front of it: the endpoint goes on seeing real addresses, so that
//! address validation, amplification limits and migration mean what they mean without it.

use std::{
    collections::BTreeMap,
    fmt, io,
    net::SocketAddr,
    pin::Pin,
    sync::{
        Arc, Mutex, MutexGuard, PoisonError, Weak,
        atomic::{AtomicUsize, Ordering},
    },
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

/// Most destinations with a link of their own. Where every viewer has one, what goes to others is lost.
const MAX_LINKS: usize = 1024;
/// Most bytes inside a link that a viewer has asked for; more are lost.
const MAX_VIEWER_BYTES: u64 = 1 << 20;

/// As the emulator calls the way to a viewer: the same seed gives the same losses.
const LABEL: &str = "forward";

/// A link before a viewer.
#[derive(Clone, Debug)]
pub struct Impairment {
    /// From the server to the viewer. What viewers send back is left alone. Without reordering.
    pub path: PathConfig,
    /// Seed of the random numbers of the first destination; the next destination has the next seed.
    pub seed: u64,
}

/// A socket with links behind it.
pub(super) struct ImpairedSocket {
    inner: Arc<dyn AsyncUdpSocket>,
    links: Arc<Links>,
}

/// All links, and the notifier of the task that drains them.
pub(super) struct Links {
    /// The link that every destination has until it gets another; without one, none has.
    of_all: Option<Impairment>,
    began: Instant,
    by_destination: Mutex<BTreeMap<SocketAddr, Link>>,
    /// Links there are: while there are none, sending looks no further.
    count: AtomicUsize,
    changed: Notify,
}

/// One destination's link and the bytes of what is inside.
struct Link {
    chain: Chain,
    most_bytes: u64,
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
    /// Wraps `inner`; `of_all` is the link that every destination has. Must be called inside a tokio runtime:
    /// a task sends what is due.
    ///
    /// # Errors
    /// A path that is illegal.
    pub(super) fn new(inner: Arc<dyn AsyncUdpSocket>, of_all: Option<Impairment>) -> Result<Self, PathError> {
        if let Some(impairment) = &of_all {
            impairment.path.build(LABEL, impairment.seed)?;
        }
        let links = Arc::new(Links {
            of_all,
            began: Instant::now(),
            by_destination: Mutex::default(),
            count: AtomicUsize::new(0),
            changed: Notify::new(),
        });
        tokio::spawn(send_what_is_due(Arc::downgrade(&links), inner.clone()));
        Ok(Self { inner, links })
    }

    /// Its links, to change them.
    pub(super) fn links(&self) -> Arc<Links> {
        self.links.clone()
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

    /// Puts a link of its own before `destination`; `None` is none. What was inside the one before is lost.
    /// False if there are too many links.
    pub(super) fn set(&self, destination: SocketAddr, impairment: Option<&Impairment>) -> bool {
        // Where every viewer has a link, having none is a link, too.
        let chain = match (impairment, &self.of_all) {
            (None, None) => {
                self.clear(destination);
                return true;
            }
            (Some(impairment), _) => impairment.path.build(LABEL, impairment.seed),
            (None, Some(_)) => PathConfig::unimpaired().build(LABEL, 0),
        };
        let mut links = self.lock();
        let has_room = links.len() < MAX_LINKS || links.contains_key(&destination);
        let Some(chain) = chain.ok().filter(|_| has_room) else { return false };
        links.insert(destination, Link::new(chain, MAX_VIEWER_BYTES));
        self.count.store(links.len(), Ordering::Relaxed);
        true
    }

    /// A viewer at `destination` has left.
    pub(super) fn clear(&self, destination: SocketAddr) {
        let mut links = self.lock();
        links.remove(&destination);
        self.count.store(links.len(), Ordering::Relaxed);
    }

    /// Whether `destination` has a link, or gets one as soon as something goes there.
    fn has(&self, destination: &SocketAddr) -> bool {
        let some = self.of_all.is_some();
        some || (self.count.load(Ordering::Relaxed) > 0 && self.lock().contains_key(destination))
    }

    /// Takes datagrams into the link of their destination, each with its own random numbers.
    fn enter(&self, transmit: &Transmit<'_>, socket: &dyn AsyncUdpSocket) {
        let mut links = self.lock();
        let now = self.now();
        let destination = transmit.destination;
        if !links.contains_key(&destination) {
            if links.len() >= MAX_LINKS {
                links.retain(|_, link| !link.inside.is_empty());
            }
            let Some(impairment) = self.of_all.as_ref().filter(|_| links.len() < MAX_LINKS) else { return };
            // It was built once before, so it is legal.
            let seed = impairment.seed.wrapping_add(links.len() as u64);
            let Ok(chain) = impairment.path.build(LABEL, seed) else { return };
            links.insert(destination, Link::new(chain, u64::MAX));
            self.count.store(links.len(), Ordering::Relaxed);
        }
        let Some(link) = links.get_mut(&destination) else { return };
        let segment = transmit.segment_size.unwrap_or(transmit.contents.len()).max(1);
        for contents in transmit.contents.chunks(segment) {
            let payload = Payload { bytes: contents.to_vec(), ecn: transmit.ecn, source: transmit.src_ip };
            link.enter(payload, now, destination, socket);
        }
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
    fn new(chain: Chain, most_bytes: u64) -> Self {
        Self { chain, most_bytes, next: 0, inside: BTreeMap::new() }
    }

    fn enter(&mut self, payload: Payload, now: Nanos, destination: SocketAddr, socket: &dyn AsyncUdpSocket) {
        let bytes = (payload.bytes.len() as u32).saturating_add(IP_UDP_BYTES);
        if self.chain.counts().inside.bytes.saturating_add(bytes.into()) > self.most_bytes {
            return;
        }
        let datagram = Datagram { tag: self.next, bytes };
        self.inside.insert(self.next, payload);
        self.next += 1;
        self.pass(Some(datagram), now, destination, socket);
    }

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

impl fmt::Debug for Links {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Links")
            .field("of_all", &self.of_all)
            .field("count", &self.count)
            .finish_non_exhaustive()
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
        if !self.links.has(&transmit.destination) {
            return self.inner.try_send(transmit);
        }
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

    fn max_transmit_segments(&self) -> usize {
        self.inner.max_transmit_segments()
    }

    fn max_receive_segments(&self) -> usize {
        self.inner.max_receive_segments()
    }

    fn may_fragment(&self) -> bool {
        self.inner.may_fragment()
    }
}
