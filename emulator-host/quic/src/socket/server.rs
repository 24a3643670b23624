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
use quinn::{Endpoint, EndpointConfig, Incoming, Runtime as _, TokioRuntime, VarInt};
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
    served_stream::{ServedStream, ServedStreamError},
    viewer::{End, Session, ViewerReport, end_session},
    web_socket_acceptor::{AcceptedWebSocket, WebSocketAcceptor},
};

/// Connections beyond the viewers: those that are shaking hands, and those that are being refused.
const SPARE_CONNECTIONS: usize = 16;
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
    /// Handshakes that failed.
    pub failed_handshakes: u64,
    /// Connections turned away before a handshake, for there were too many.
    pub turned_away: u64,
    /// Connections that had to show first that their address is theirs.
    pub retried: u64,
    /// Refusals by code, before a session or in one.
    pub refused: BTreeMap<String, u64>,
}

/// A server on its port.
#[derive(Debug)]
pub struct Server {
    endpoint: Endpoint,
    shared: Arc<Shared>,
    pin: Pin,
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
    /// Where viewers' own links are; `None` where they may not change any.
    links: Option<Arc<Links>>,
    slots: Arc<Semaphore>,
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
        if offers.is_empty() {
            return Err(ServerError::NoStream);
        }
        for (at, offer) in offers.iter().enumerate() {
            if offers[..at].iter().any(|before| before.name() == offer.name()) {
                return Err(ServedStreamError::Twice { name: offer.name().to_owned() }.into());
            }
        }
        let ServerConfig { bind, identity, limits, policy, impairment, viewer_conditions } = config;
        let pin = identity.pin();
        let mut server = quinn::ServerConfig::with_crypto(Arc::new(identity.server()?));
        server
            .transport_config(limits.transport())
            .max_incoming(limits.max_viewers + SPARE_CONNECTIONS)
            .incoming_buffer_size(INCOMING_BYTES.0)
            .incoming_buffer_size_total(INCOMING_BYTES.1);
        let failed = |error| ServerError::Bind { address: bind, error };
        let socket = UdpSocket::bind(bind).map_err(failed)?;
        let runtime = Arc::new(TokioRuntime);
        let mut socket = runtime.wrap_udp_socket(socket).map_err(failed)?;
        let mut links = None;
        if impairment.is_some() || viewer_conditions {
            let impaired = ImpairedSocket::new(socket, impairment)?;
            links = viewer_conditions.then(|| impaired.links());
            socket = Arc::new(impaired);
        }
        let endpoint =
            Endpoint::new_with_abstract_socket(EndpointConfig::default(), Some(server), socket, runtime)
                .map_err(failed)?;
        let (ended_sender, ended) = mpsc::unbounded_channel();
        let (stop, stopping) = watch::channel(false);
        let shared = Arc::new(Shared {
            offers: offers.into_iter().map(Arc::new).collect(),
            slots: Arc::new(Semaphore::new(limits.max_viewers)),
            limits,
            policy,
            links,
            failed_handshakes: AtomicU64::new(0),
            ended: ended_sender,
            stopping,
        });
        let (entrance, entering) = WebSocketAcceptor::new(shared.limits.max_viewers + SPARE_CONNECTIONS);
        Ok(Self { endpoint, shared, pin, entrance, entering, ended, stop })
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
        report
    }

    /// Takes a connection on, or has it prove its address, or turns it away.
    fn admit(&self, incoming: Incoming, tasks: &mut JoinSet<()>, report: &mut ServerReport) {
        let (open, most) = (self.endpoint.open_connections(), self.shared.limits.max_viewers);
        if open >= most + SPARE_CONNECTIONS {
            report.turned_away += 1;
            incoming.refuse();
        } else if open >= most.div_ceil(2) && !incoming.remote_address_validated() && incoming.may_retry() {
            report.retried += 1;
            // Whoever cannot retry after all is not there.
            let _ = incoming.retry();
        } else {
            tasks.spawn(serve(incoming, self.shared.clone()));
        }
    }
}

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
async fn serve(incoming: Incoming, shared: Arc<Shared>) {
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
        Ok((greeting, offer, slot)) => {
            let Greeting { carrier, ending, send, control, start_us, .. } = greeting;
            let (limits, policy, links) = (shared.limits.clone(), shared.policy, shared.links.clone());
            let session = Session { carrier, ending, send, control, offer, limits, policy, links, stopping };
            let (viewer, end) = session.run(start_us).await;
            drop(slot);
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
    fn greet(
        &self,
        greeting: Greeting,
    ) -> Result<(Greeting, Arc<ServedStream>, OwnedSemaphorePermit), NoSession> {
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
        match self.slots.clone().try_acquire_owned() {
            Ok(slot) => Ok((greeting, offer.clone(), slot)),
            Err(_) => {
                let sentence = format!("all {} places are taken", self.limits.max_viewers);
                Err(greeting.refused(RefusalCode::Full, sentence))
            }
        }
    }
}
