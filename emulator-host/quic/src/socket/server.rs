//! Offers streams on a UDP port: accepts, greets, limits and counts viewers.

use std::{
    collections::BTreeMap,
    io,
    net::{SocketAddr, UdpSocket},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use emulator_host::{PolicyKind, link::PathError};
use quinn::{AsyncUdpSocket, Endpoint, EndpointConfig, Incoming, Runtime as _, TokioRuntime, VarInt};
use quinn_proto::HashedConnectionIdGenerator;
use ring::hmac;
use serde::Serialize;
use tokio::{
    sync::{OwnedSemaphorePermit, Semaphore, mpsc, watch},
    task::JoinSet,
    time::timeout,
};

use super::{
    carrier::{Opened, by_quic, by_socket},
    channel::{Channel, Closed, close},
    greeting::{Greeting, NoSession, greeting},
    identity::{Identity, IdentityError, Pin},
    impair::{ImpairedSocket, Impairment, Links},
    limits::ServerLimits,
    message::{Refusal, RefusalCode, StreamChoice},
    per_address::{PerAddress, Place},
    served_stream::{ServedStream, ServedStreamError},
    strays::{CountingSocket, Strays, VERSION},
    viewer::{End, Session, ViewerReport, end_session},
    web_socket_acceptor::{AcceptedWebSocket, WebSocketAcceptor},
};
use crate::congestion::CongestionControl;

/// Connections beyond the viewers: those that are shaking hands, and those that are being refused.
const SPARE_CONNECTIONS: usize = 16;
/// The same of one address.
const SPARE_PER_ADDRESS: usize = 4;
/// Bytes of connections that wait to be accepted, each and together.
const INCOMING_BYTES: (u64, u64) = (8 << 10, 1 << 20);
/// How long viewers may take to leave when the server closes.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);

/// How streams are served.
#[derive(Debug)]
pub struct ServerConfig {
    /// Address and port; port 0 takes any that is free.
    pub bind: SocketAddr,
    /// Who the server says it is.
    pub identity: Identity,
    /// What it grants.
    pub limits: ServerLimits,
    /// The scheduler of every viewer.
    pub policy: PolicyKind,
    /// What governs how much is on its way to each viewer by QUIC; to one by WebSocket, TCP does.
    pub congestion: CongestionControl,
    /// A link to put before every viewer.
    pub impairment: Option<Impairment>,
    /// Whether viewers may change the scheduler and the link of their own sessions.
    pub viewer_conditions: bool,
}

/// Why nothing can be served.
#[derive(Debug, thiserror::Error)]
pub enum ServerError {
    /// There is no stream.
    #[error("no stream is offered")]
    NoStream,
    /// A stream cannot be offered.
    #[error(transparent)]
    ServedStream(#[from] ServedStreamError),
    /// The certificate does not serve.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// The port cannot be opened.
    #[error("{address}: cannot listen: {error}")]
    Bind {
        /// Where.
        address: SocketAddr,
        /// Why.
        error: io::Error,
    },
    /// The link is illegal.
    #[error("impairment: {0}")]
    Impairment(#[from] PathError),
}

/// What a server has counted besides its viewers.
#[derive(Clone, Debug, Default, PartialEq, Eq, Serialize)]
pub struct ServerReport {
    /// Viewers served.
    pub viewers: u64,
    /// Handshakes that failed, those of addresses that never answer and of first packets that were sent again
    /// after their connection was over among them.
    pub failed_handshakes: u64,
    /// Connections turned away before a handshake, for there were too many, or too many from their address.
    pub turned_away: u64,
    /// Connections that had to show first that their address is theirs.
    pub retried: u64,
    /// Datagrams that were no QUIC, or of a version or for connections that never were.
    pub stray_datagrams: u64,
    /// Refusals by code, before a session or in one.
    pub refused: BTreeMap<String, u64>,
}

/// A server on its port.
#[derive(Debug)]
pub struct Server {
    endpoint: Endpoint,
    shared: Arc<Shared>,
    pin: Pin,
    strays: Arc<Strays>,
    /// Connections, whatever is said on them.
    connections: Arc<PerAddress>,
    entrance: WebSocketAcceptor,
    entering: mpsc::Receiver<AcceptedWebSocket>,
    ended: mpsc::UnboundedReceiver<Ended>,
    stop: watch::Sender<bool>,
}

/// What every connection's task sees.
#[derive(Debug)]
struct Shared {
    offers: Vec<Arc<ServedStream>>,
    limits: ServerLimits,
    policy: PolicyKind,
    /// Links of the socket, if it has any.
    links: Option<Arc<Links>>,
    /// Whether viewers may change their own.
    viewer_conditions: bool,
    slots: Arc<Semaphore>,
    viewers: Arc<PerAddress>,
    failed_handshakes: AtomicU64,
    ended: mpsc::UnboundedSender<Ended>,
    stopping: watch::Receiver<bool>,
}

/// What the task of a connection says at its end.
#[derive(Debug)]
struct Ended {
    viewer: Option<ViewerReport>,
    refused: Option<RefusalCode>,
}

impl Server {
    /// Opens the port. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`ServerError`].
    pub fn bind(config: ServerConfig, offers: Vec<ServedStream>) -> Result<Self, ServerError> {
        Self::on(Self::open(config.bind)?, config, offers)
    }

    /// Opens the port alone: one that cannot be had is known before streams are made.
    ///
    /// # Errors
    /// [`ServerError::Bind`].
    pub fn open(address: SocketAddr) -> Result<UdpSocket, ServerError> {
        UdpSocket::bind(address).map_err(|error| ServerError::Bind { address, error })
    }

    /// Serves on `socket`, which was opened at [`ServerConfig::bind`]. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`ServerError`].
    pub fn on(
        socket: UdpSocket,
        config: ServerConfig,
        offers: Vec<ServedStream>,
    ) -> Result<Self, ServerError> {
        if offers.is_empty() {
            return Err(ServerError::NoStream);
        }
        for (at, offer) in offers.iter().enumerate() {
            if offers[..at].iter().any(|before| before.name() == offer.name()) {
                return Err(ServedStreamError::Twice { name: offer.name().to_owned() }.into());
            }
        }
        let ServerConfig { bind, identity, limits, policy, congestion, impairment, viewer_conditions } =
            config;
        let pin = identity.pin();
        let ids =
            u64::from_le_bytes(*identity.secret(b"dgs connection ids").first_chunk().unwrap_or(&[0; 8]));
        // A client whose server was killed and is back hears at once that its connection is gone.
        let resets = hmac::Key::new(hmac::HMAC_SHA256, &identity.secret(b"dgs stateless reset"));
        let mut server = quinn::ServerConfig::with_crypto(Arc::new(identity.server()?));
        server
            .transport_config(limits.transport(congestion))
            .max_incoming(limits.max_viewers + SPARE_CONNECTIONS)
            .incoming_buffer_size(INCOMING_BYTES.0)
            .incoming_buffer_size_total(INCOMING_BYTES.1);
        let failed = |error| ServerError::Bind { address: bind, error };
        let runtime = Arc::new(TokioRuntime);
        let strays = Arc::new(Strays::new(ids));
        let socket = runtime.wrap_udp_socket(socket).map_err(failed)?;
        let mut socket: Arc<dyn AsyncUdpSocket> = Arc::new(CountingSocket::new(socket, strays.clone()));
        let mut links = None;
        if impairment.is_some() || viewer_conditions {
            let impaired = ImpairedSocket::new(socket, impairment, limits.max_viewers)?;
            links = Some(impaired.links());
            socket = Arc::new(impaired);
        }
        let mut endpoint = EndpointConfig::new(Arc::new(resets));
        endpoint
            .cid_generator(move || Box::new(HashedConnectionIdGenerator::from_key(ids)))
            .supported_versions(vec![VERSION])
            // So that what lacks the bit is no QUIC.
            .grease_quic_bit(false);
        let endpoint = Endpoint::new_with_abstract_socket(endpoint, Some(server), socket, runtime);
        let endpoint = endpoint.map_err(failed)?;
        let (ended_sender, ended) = mpsc::unbounded_channel();
        let (stop, stopping) = watch::channel(false);
        let shared = Arc::new(Shared {
            offers: offers.into_iter().map(Arc::new).collect(),
            slots: Arc::new(Semaphore::new(limits.max_viewers)),
            viewers: PerAddress::new(limits.max_viewers_per_address),
            limits,
            policy,
            links,
            viewer_conditions,
            failed_handshakes: AtomicU64::new(0),
            ended: ended_sender,
            stopping,
        });
        let of_address = shared.limits.max_viewers_per_address + SPARE_PER_ADDRESS;
        let (entrance, entering) =
            WebSocketAcceptor::new(shared.limits.max_viewers + SPARE_CONNECTIONS, of_address);
        let connections = PerAddress::new(of_address);
        Ok(Self { endpoint, shared, pin, strays, connections, entrance, entering, ended, stop })
    }

    /// Where it listens.
    ///
    /// # Errors
    /// If the socket does not say.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.endpoint.local_addr()
    }

    /// By what clients know it.
    pub fn pin(&self) -> Pin {
        self.pin
    }

    /// Where a page's server lets WebSockets in.
    pub fn entrance(&self) -> WebSocketAcceptor {
        self.entrance.clone()
    }

    /// Names of the streams.
    pub fn names(&self) -> impl Iterator<Item = &str> {
        self.shared.offers.iter().map(|offer| offer.name())
    }

    /// Serves until `stop` ends; `on_end` gets what every viewer got. All connections are closed with a
    /// reason before this returns.
    pub async fn run(
        mut self,
        stop: impl Future<Output = ()>,
        mut on_end: impl FnMut(&ViewerReport),
    ) -> ServerReport {
        let mut report = ServerReport::default();
        let mut tasks = JoinSet::new();
        let mut stop = std::pin::pin!(stop);
        loop {
            tokio::select! {
                incoming = self.endpoint.accept() => match incoming {
                    Some(incoming) => self.admit(incoming, &mut tasks, &mut report),
                    None => break,
                },
                Some(entering) = self.entering.recv() => {
                    tasks.spawn(serve_socket(entering, self.shared.clone()));
                }
                Some(ended) = self.ended.recv() => report.enter(&ended, &mut on_end),
                Some(_) = tasks.join_next() => {}
                () = &mut stop => break,
            }
        }
        self.endpoint.set_server_config(None);
        // Every viewer gets the refusal `closing`; a task that does not end in time is dropped with its
        // connection.
        let _ = self.stop.send(true);
        let all = async { while tasks.join_next().await.is_some() {} };
        let _ = timeout(CLOSE_TIMEOUT, all).await;
        tasks.shutdown().await;
        while let Ok(ended) = self.ended.try_recv() {
            report.enter(&ended, &mut on_end);
        }
        self.endpoint.close(code(RefusalCode::Closing), b"the server is closing");
        let _ = timeout(CLOSE_TIMEOUT, self.endpoint.wait_idle()).await;
        report.failed_handshakes = self.shared.failed_handshakes.load(Ordering::Relaxed);
        report.stray_datagrams = self.strays.count();
        report
    }

    /// Takes a connection on, or has it prove its address, or turns it away.
    fn admit(&self, incoming: Incoming, tasks: &mut JoinSet<()>, report: &mut ServerReport) {
        let limits = &self.shared.limits;
        let (open, address) = (self.endpoint.open_connections(), incoming.remote_address().ip());
        let crowded = open >= limits.max_viewers.div_ceil(2)
            || self.connections.count(address) >= limits.max_viewers_per_address.div_ceil(2);
        if open >= limits.max_viewers + SPARE_CONNECTIONS {
            report.turned_away += 1;
            incoming.refuse();
        } else if crowded && !incoming.remote_address_validated() && incoming.may_retry() {
            report.retried += 1;
            // Whoever cannot retry after all is not there.
            let _ = incoming.retry();
        } else if let Some(place) = self.connections.take(address) {
            tasks.spawn(serve(incoming, self.shared.clone(), place));
        } else {
            report.turned_away += 1;
            incoming.refuse();
        }
    }
}

/// A viewer's place among all, and among those of its address.
type Seat = (OwnedSemaphorePermit, Place);

fn code(code: RefusalCode) -> VarInt {
    u32::from(code.number()).into()
}

impl ServerReport {
    fn enter(&mut self, ended: &Ended, on_end: &mut impl FnMut(&ViewerReport)) {
        if let Some(code) = ended.refused {
            *self.refused.entry(code.to_string()).or_default() += 1;
        }
        if let Some(viewer) = &ended.viewer {
            self.viewers += 1;
            on_end(viewer);
        }
    }
}

/// One connection from its first packet to its last.
async fn serve(incoming: Incoming, shared: Arc<Shared>, _place: Place) {
    let connection = match incoming.accept() {
        Ok(connecting) => timeout(shared.limits.idle, connecting).await.ok().and_then(Result::ok),
        Err(_) => None,
    };
    let Some(connection) = connection else {
        shared.failed_handshakes.fetch_add(1, Ordering::Relaxed);
        return;
    };
    let opening = async { Channel::accept(&connection).await.map(by_quic) };
    if let Some(refusal) = attend(opening, &shared).await {
        close(&connection, refusal.code.number().into(), &refusal.sentence);
    }
}

/// One WebSocket from its first frame to its last.
async fn serve_socket(entering: AcceptedWebSocket, shared: Arc<Shared>) {
    let AcceptedWebSocket { socket, address, place } = entering;
    let (opened, carrying) = by_socket(socket, address);
    let attending = attend(std::future::ready(Ok(opened)), &shared);
    tokio::join!(carrying, attending);
    drop(place);
}

/// One session on what `opening` becomes; a refusal where there is nothing to say it on.
async fn attend(opening: impl Future<Output = Result<Opened, Closed>>, shared: &Shared) -> Option<Refusal> {
    let mut stopping = shared.stopping.clone();
    let greeted = tokio::select! {
        greeted = greeting(opening, shared.limits.hello_wait) => greeted,
        _ = stopping.changed() => {
            let sentence = "the server is closing".to_owned();
            Err(NoSession::before(Refusal { code: RefusalCode::Closing, sentence }))
        }
    };
    let (viewer, end) = match greeted.and_then(|greeting| shared.greet(greeting)) {
        Ok((greeting, offer, seat)) => {
            let Greeting { carrier, ending, send, control, start_us, .. } = greeting;
            let (limits, policy, links) = (shared.limits.clone(), shared.policy, shared.links.clone());
            let may_change = shared.viewer_conditions;
            let session = Session {
                carrier,
                ending,
                send,
                control,
                offer,
                limits,
                policy,
                links,
                may_change,
                stopping,
            };
            let (viewer, end) = session.run(start_us).await;
            drop(seat);
            (Some(viewer), end)
        }
        Err(NoSession { end, opened: Some((ending, send)) }) => {
            end_session(ending, send, &end).await;
            (None, end)
        }
        Err(NoSession { end, opened: None }) => {
            let refused = end.refused();
            // Nobody listens any more once the server has closed.
            let _ = shared.ended.send(Ended { viewer: None, refused });
            return match end {
                End::Refused(refusal) => Some(refusal),
                End::Bye | End::Gone(_) => None,
            };
        }
    };
    let _ = shared.ended.send(Ended { viewer, refused: end.refused() });
    None
}

impl Shared {
    /// The stream that is wanted, and a place to watch it.
    fn greet(&self, greeting: Greeting) -> Result<(Greeting, Arc<ServedStream>, Seat), NoSession> {
        let offer = match &greeting.stream {
            StreamChoice::Name(name) => self.offers.iter().find(|offer| offer.name() == name),
            StreamChoice::Index(index) => self.offers.get(usize::from(*index)),
        };
        let Some(offer) = offer else {
            let names: Vec<&str> = self.offers.iter().map(|offer| offer.name()).collect();
            let wanted = match &greeting.stream {
                StreamChoice::Name(name) => format!("called {name}"),
                StreamChoice::Index(index) => format!("of number {index}"),
            };
            let sentence = format!("there is no stream {wanted}; there are {}", names.join(", "));
            return Err(greeting.refused(RefusalCode::UnknownStream, sentence));
        };
        let address = greeting.carrier.address().ip();
        let Some(place) = self.viewers.take(address) else {
            let most = self.limits.max_viewers_per_address;
            let sentence = format!("all {most} places for viewers from {address} are taken");
            return Err(greeting.refused(RefusalCode::Full, sentence));
        };
        match self.slots.clone().try_acquire_owned() {
            Ok(slot) => Ok((greeting, offer.clone(), (slot, place))),
            Err(_) => {
                let sentence = format!("all {} places are taken", self.limits.max_viewers);
                Err(greeting.refused(RefusalCode::Full, sentence))
            }
        }
    }
}
