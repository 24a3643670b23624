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

/// Links beyond one for every viewer: of who shakes hands or has left. What goes to destinations for which
/// there is none is lost.
const SPARE_LINKS: usize = 1024;
/// A link without a session is forgotten so long after its last datagram.
const FORGOTTEN_AFTER: Nanos = Nanos::from_s(10);
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
    /// Most links.
    most: usize,
    table: Mutex<Table>,
    /// Links there are: while there are none, sending looks no further.
    count: AtomicUsize,
    changed: Notify,
}

/// The links by destination.
#[derive(Default)]
struct Table {
    links: BTreeMap<SocketAddr, Link>,
    /// Links that were made of the one that every destination has: each has the next seed.
    seeds: u64,
    /// Sessions that have begun.
    sessions: u64,
}

/// One destination's link and the bytes of what is inside.
struct Link {
    chain: Chain,
    /// When it was made: its traces begin there.
    made: Nanos,
    most_bytes: u64,
    next: u64,
    inside: BTreeMap<u64, Payload>,
    /// The session with the destination, if there is one.
    session: Option<u64>,
    /// Whether it is for that session alone.
    is_of_session: bool,
    /// When the last datagram entered.
    entered: Nanos,
}

/// The link of a session's viewer. When it is dropped the viewer has left.
pub(super) struct SessionLink {
    links: Arc<Links>,
    session: u64,
}

/// A datagram on its way.
struct Payload {
    bytes: Vec<u8>,
    ecn: Option<EcnCodepoint>,
    source: Option<std::net::IpAddr>,
}

impl ImpairedSocket {
    /// Wraps `inner` for `viewers` at once; `of_all` is the link that every destination has. Must be called
    /// inside a tokio runtime: a task sends what is due.
    ///
    /// # Errors
    /// A path that is illegal.
    pub(super) fn new(
        inner: Arc<dyn AsyncUdpSocket>,
        of_all: Option<Impairment>,
        viewers: usize,
    ) -> Result<Self, PathError> {
        if let Some(impairment) = &of_all {
            impairment.path.build(LABEL, impairment.seed)?;
        }
        let links = Arc::new(Links::new(of_all, viewers + SPARE_LINKS));
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
        let wake = links.send_due(links.now(), &*socket);
        let pause = Duration::from_nanos(wake.0.saturating_sub(links.now().0));
        // A link that is idle is looked at again when something enters it, or when the socket may be gone.
        let pause = pause.min(Duration::from_secs(1));
        let changed = links.changed.notified();
        let _ = tokio::time::timeout(pause, changed).await;
    }
}

impl Links {
    fn new(of_all: Option<Impairment>, most: usize) -> Self {
        let (table, count) = (Mutex::default(), AtomicUsize::new(0));
        Self { of_all, began: Instant::now(), most, table, count, changed: Notify::new() }
    }

    fn now(&self) -> Nanos {
        Nanos(u64::try_from(self.began.elapsed().as_nanos()).unwrap_or(u64::MAX))
    }

    fn lock(&self) -> MutexGuard<'_, Table> {
        // Whoever panicked with it left a table of links that is still in order.
        self.table.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// A session begins with a viewer at `destination`.
    pub(super) fn begin_session(self: &Arc<Self>, destination: SocketAddr) -> SessionLink {
        let mut table = self.lock();
        table.sessions += 1;
        let session = table.sessions;
        if let Some(link) = table.links.get_mut(&destination) {
            link.session = Some(session);
        }
        SessionLink { links: self.clone(), session }
    }

    /// Whether `destination` has a link, or gets one as soon as something goes there.
    fn has(&self, destination: &SocketAddr) -> bool {
        let some = self.of_all.is_some();
        some || (self.count.load(Ordering::Relaxed) > 0 && self.lock().links.contains_key(destination))
    }

    /// Takes datagrams into the link of their destination, each with its own random numbers.
    fn enter(&self, transmit: &Transmit<'_>, socket: &dyn AsyncUdpSocket) {
        let mut table = self.lock();
        let now = self.now();
        let destination = transmit.destination;
        if !table.links.contains_key(&destination) {
            let Some(impairment) = &self.of_all else { return };
            if table.links.len() >= self.most {
                table.links.retain(|_, link| link.session.is_some() || !link.inside.is_empty());
            }
            if table.links.len() >= self.most {
                return;
            }
            // It was built once before, so it is legal.
            let Ok(chain) = impairment.path.build(LABEL, impairment.seed.wrapping_add(table.seeds)) else {
                return;
            };
            table.seeds += 1;
            table.links.insert(destination, Link::new(chain, now, u64::MAX));
            self.count.store(table.links.len(), Ordering::Relaxed);
        }
        let Some(link) = table.links.get_mut(&destination) else { return };
        link.entered = now;
        let segment = transmit.segment_size.unwrap_or(transmit.contents.len()).max(1);
        for contents in transmit.contents.chunks(segment) {
            let payload = Payload { bytes: contents.to_vec(), ecn: transmit.ecn, source: transmit.src_ip };
            link.enter(payload, now, destination, socket);
        }
        drop(table);
        self.changed.notify_one();
    }

    /// Sends what is through at `now`, and forgets links that nobody uses; when to look again.
    fn send_due(&self, now: Nanos, socket: &dyn AsyncUdpSocket) -> Nanos {
        let mut wake = Nanos::MAX;
        let mut table = self.lock();
        table.links.retain(|destination, link| {
            if link.next_wake() <= now {
                link.pass(None, now, *destination, socket);
            }
            let is_used = link.session.is_some() || !link.inside.is_empty();
            let stays = is_used || now < link.entered + FORGOTTEN_AFTER;
            if stays {
                wake = wake.min(link.next_wake());
            }
            stays
        });
        self.count.store(table.links.len(), Ordering::Relaxed);
        wake
    }
}

impl SessionLink {
    /// Puts a link of the session's own before its viewer, who is at `destination`; `None` is none. What was
    /// inside the one before is lost. False if there are too many links.
    pub(super) fn set(&self, destination: SocketAddr, impairment: Option<&Impairment>) -> bool {
        // Where every viewer has a link, having none is a link, too.
        let chain = match (impairment, &self.links.of_all) {
            (Some(impairment), _) => Some(impairment.path.build(LABEL, impairment.seed)),
            (None, Some(_)) => Some(PathConfig::unimpaired().build(LABEL, 0)),
            (None, None) => None,
        };
        let mut table = self.links.lock();
        // A viewer that has moved leaves none behind.
        table.links.retain(|to, link| *to == destination || link.session != Some(self.session));
        let has_room = table.links.len() < self.links.most || table.links.contains_key(&destination);
        let is_set = match chain {
            Some(Ok(chain)) if has_room => {
                let (session, is_of_session) = (Some(self.session), true);
                let link = Link::new(chain, self.links.now(), MAX_VIEWER_BYTES);
                let link = Link { session, is_of_session, ..link };
                table.links.insert(destination, link);
                true
            }
            Some(_) => false,
            None => {
                table.links.remove(&destination);
                true
            }
        };
        self.links.count.store(table.links.len(), Ordering::Relaxed);
        is_set
    }
}

impl Drop for SessionLink {
    fn drop(&mut self) {
        let mut table = self.links.lock();
        table.links.retain(|_, link| {
            let is_ours = link.session == Some(self.session);
            if is_ours {
                // The last datagrams of the connection are still to pass.
                link.session = None;
            }
            !(is_ours && link.is_of_session)
        });
        self.links.count.store(table.links.len(), Ordering::Relaxed);
    }
}

impl Link {
    fn new(chain: Chain, made: Nanos, most_bytes: u64) -> Self {
        let (inside, session, is_of_session, entered) = (BTreeMap::new(), None, false, Nanos::ZERO);
        Self { chain, made, most_bytes, next: 0, inside, session, is_of_session, entered }
    }

    /// When something inside may be through.
    fn next_wake(&self) -> Nanos {
        self.made + self.chain.next_wake()
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
        while let BoxOutput::Datagram(datagram) = self.chain.step(input.take(), now - self.made) {
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
            .field("most", &self.most)
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

#[cfg(test)]
mod tests {
    use emulator_host::trace::{DelayTrace, Limits};

    use super::*;

    #[derive(Debug)]
    struct Nowhere;

    impl AsyncUdpSocket for Nowhere {
        fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
            panic!("nobody waits for it")
        }

        fn try_send(&self, _: &Transmit<'_>) -> io::Result<()> {
            Ok(())
        }

        fn poll_recv(
            &self,
            _: &mut Context<'_>,
            _: &mut [io::IoSliceMut<'_>],
            _: &mut [RecvMeta],
        ) -> Poll<io::Result<usize>> {
            Poll::Pending
        }

        fn local_addr(&self) -> io::Result<SocketAddr> {
            Ok(at(0))
        }
    }

    fn at(port: u16) -> SocketAddr {
        ([127, 0, 0, 1], port).into()
    }

    fn send(links: &Links, port: u16) {
        let (destination, contents) = (at(port), &[0; 100][..]);
        let transmit = Transmit { destination, ecn: None, contents, segment_size: None, src_ip: None };
        links.enter(&transmit, &Nowhere);
    }

    fn ports(links: &Links) -> Vec<u16> {
        let ports: Vec<u16> = links.lock().links.keys().map(SocketAddr::port).collect();
        assert_eq!(links.count.load(Ordering::Relaxed), ports.len());
        ports
    }

    fn of_all() -> Option<Impairment> {
        Some(Impairment { path: PathConfig::unimpaired(), seed: 7 })
    }

    #[test]
    fn a_link_is_forgotten_after_its_viewer_and_its_seed_does_not_come_again() {
        let links = Arc::new(Links::new(of_all(), 10));
        (1..=2).for_each(|port| send(&links, port));
        let session = links.begin_session(at(1));
        links.send_due(Nanos::from_s(9), &Nowhere);
        assert_eq!(ports(&links), [1, 2]);
        links.send_due(Nanos::from_s(20), &Nowhere);
        assert_eq!(ports(&links), [1]);
        drop(session);
        links.send_due(Nanos::from_s(20), &Nowhere);
        assert!(ports(&links).is_empty());
        send(&links, 3);
        assert_eq!(links.lock().seeds, 3);
    }

    /// A viewer that comes later meets the same conditions: traces begin with its first datagram.
    #[test]
    fn a_trace_begins_with_its_link() {
        let delays = DelayTrace::load(b"40\n900\n", Nanos::from_s(1), &Limits::default()).unwrap();
        let path = PathConfig { delay_trace: Some(delays), ..PathConfig::unimpaired() };
        for made in [Nanos::ZERO, Nanos::from_s(11)] {
            let mut link = Link::new(path.build(LABEL, 1).unwrap(), made, u64::MAX);
            let payload = Payload { bytes: vec![0; 100], ecn: None, source: None };
            link.enter(payload, made, at(1), &Nowhere);
            assert_eq!(link.next_wake(), made + Nanos::from_ms(40));
            link.pass(None, link.next_wake(), at(1), &Nowhere);
            assert!(link.inside.is_empty());
        }
    }

    #[test]
    fn a_new_destination_takes_no_link_of_a_viewer() {
        let links = Arc::new(Links::new(of_all(), 2));
        (1..=2).for_each(|port| send(&links, port));
        let (one, _two) = (links.begin_session(at(1)), links.begin_session(at(2)));
        send(&links, 3);
        assert_eq!(ports(&links), [1, 2]);
        drop(one);
        send(&links, 3);
        assert_eq!(ports(&links), [2, 3]);
    }

    #[test]
    fn a_session_has_one_link_of_its_own_until_it_ends() {
        let links = Arc::new(Links::new(None, 2));
        let (one, two) = (links.begin_session(at(1)), links.begin_session(at(9)));
        assert!(one.set(at(1), of_all().as_ref()) && two.set(at(9), of_all().as_ref()));
        // The viewer has moved.
        assert!(one.set(at(2), of_all().as_ref()));
        assert_eq!(ports(&links), [2, 9]);
        drop(two);
        assert!(one.set(at(2), of_all().as_ref()) && links.has(&at(2)) && !links.has(&at(9)));
        assert!(one.set(at(2), None) && ports(&links).is_empty());
        one.set(at(2), of_all().as_ref());
        drop(one);
        assert!(ports(&links).is_empty() && !links.has(&at(2)));
    }
}
