//! Offers a site on a TCP port: accepts, limits, counts and closes connections.

use std::{
    io,
    net::{SocketAddr, TcpListener as StdListener},
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use hyper::{Request, body::Incoming, http, server::conn::http1, service::service_fn};
use hyper_util::rt::{TokioIo, TokioTimer};
use serde::Serialize;
use tokio::{
    net::{TcpListener, TcpStream},
    sync::{Semaphore, watch},
    task::JoinSet,
    time::{sleep, timeout},
};

use super::{
    answer::{Answer, answer},
    progress::Progress,
    site::Site,
    upgrade,
};
use crate::socket::{PerAddress, WebSocketAcceptor};

/// How long answers may take to end when the server closes.
const CLOSE_TIMEOUT: Duration = Duration::from_secs(2);
/// How long to wait when the system gives no more connections.
const EXHAUSTED: Duration = Duration::from_millis(50);

/// What an HTTP server grants.
#[derive(Clone, Copy, Debug)]
pub struct HttpLimits {
    /// Connections at once; more are closed at once.
    pub max_connections: usize,
    /// Those of one address, or of one network of IPv6 (/64).
    pub max_connections_per_address: usize,
    /// Bytes of a request's head, at least 8192.
    pub head_bytes: usize,
    /// From the start of a connection, or the end of the last answer, to the end of a request's head.
    pub head_wait: Duration,
    /// Time within which a waiting client must take 16 KiB of an answer.
    pub progress: Duration,
}

impl Default for HttpLimits {
    /// 256 connections, 64 of one address, 16 KiB, 10 s, 10 s.
    fn default() -> Self {
        let ten = Duration::from_secs(10);
        Self {
            max_connections: 256,
            max_connections_per_address: 64,
            head_bytes: 16 << 10,
            head_wait: ten,
            progress: ten,
        }
    }
}

/// Where and how a site is served.
#[derive(Debug)]
pub struct HttpConfig {
    /// Address and port; port 0 takes any that is free.
    pub bind: SocketAddr,
    /// What it grants.
    pub limits: HttpLimits,
}

/// Why a site is not served.
#[derive(Debug, thiserror::Error)]
#[error("{address}: cannot listen for HTTP: {error}")]
pub struct HttpError {
    address: SocketAddr,
    error: io::Error,
}

/// What an HTTP server has counted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize)]
pub struct HttpReport {
    /// Connections taken.
    pub connections: u64,
    /// Connections closed at once, for there were too many, in all or of their address.
    pub turned_away: u64,
    /// Requests answered, refusals included.
    pub requests: u64,
    /// Connections ended because a head or the progress of an answer took too long.
    pub slow: u64,
    /// Connections ended because what came is no request that is served here.
    pub malformed: u64,
}

#[derive(Debug, Default)]
struct Counts {
    requests: AtomicU64,
    slow: AtomicU64,
    malformed: AtomicU64,
}

/// A site on its port.
#[derive(Debug)]
pub struct HttpServer {
    listener: TcpListener,
    site: Arc<Site>,
    entrance: Option<WebSocketAcceptor>,
    limits: HttpLimits,
    counts: Arc<Counts>,
}

impl HttpServer {
    /// Opens the port. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`HttpError`].
    pub fn bind(config: &HttpConfig, site: Site) -> Result<Self, HttpError> {
        Self::on(Self::open(config.bind)?, config, site)
    }

    /// Opens the port alone: one that cannot be had is known before there is a site.
    ///
    /// # Errors
    /// [`HttpError`].
    pub fn open(address: SocketAddr) -> Result<StdListener, HttpError> {
        StdListener::bind(address).map_err(|error| HttpError { address, error })
    }

    /// Serves on `listener`, which was opened at [`HttpConfig::bind`]. Must be called inside a tokio runtime.
    ///
    /// # Errors
    /// [`HttpError`].
    pub fn on(listener: StdListener, config: &HttpConfig, site: Site) -> Result<Self, HttpError> {
        let failed = |error| HttpError { address: config.bind, error };
        listener.set_nonblocking(true).map_err(failed)?;
        let listener = TcpListener::from_std(listener).map_err(failed)?;
        let (site, limits) = (Arc::new(site), config.limits);
        Ok(Self { listener, site, entrance: None, limits, counts: Arc::default() })
    }

    /// Lets WebSockets under `/session` in through `entrance`.
    #[must_use]
    pub fn with_sessions(self, entrance: WebSocketAcceptor) -> Self {
        Self { entrance: Some(entrance), ..self }
    }

    /// Where it listens.
    ///
    /// # Errors
    /// If the socket does not say.
    pub fn local_addr(&self) -> io::Result<SocketAddr> {
        self.listener.local_addr()
    }

    /// Serves until `stop` ends. Answers that have begun are ended, within two seconds, before this returns.
    pub async fn run(self, stop: impl Future<Output = ()>) -> HttpReport {
        let mut report = HttpReport::default();
        let places = Arc::new(Semaphore::new(self.limits.max_connections.min(Semaphore::MAX_PERMITS)));
        let of_address = PerAddress::new(self.limits.max_connections_per_address);
        let mut tasks = JoinSet::new();
        let (closing, closes) = watch::channel(false);
        let mut stop = std::pin::pin!(stop);
        loop {
            tokio::select! {
                accepted = self.listener.accept() => match accepted {
                    Ok((stream, address)) => {
                        let place = places.clone().try_acquire_owned().ok();
                        let Some(place) = place.zip(of_address.take(address.ip())) else {
                            report.turned_away += 1;
                            continue;
                        };
                        report.connections += 1;
                        let (site, entrance) = (self.site.clone(), self.entrance.clone());
                        let answering = Answering { site, entrance, address, counts: self.counts.clone() };
                        tasks.spawn(serve(stream, answering, self.limits, closes.clone(), place));
                    }
                    // No memory or no file handle is free, or the client is gone already.
                    Err(_) => sleep(EXHAUSTED).await,
                },
                Some(_) = tasks.join_next() => {}
                () = &mut stop => break,
            }
        }
        drop(self.listener);
        let _ = closing.send(true);
        let all = async { while tasks.join_next().await.is_some() {} };
        let _ = timeout(CLOSE_TIMEOUT, all).await;
        tasks.shutdown().await;
        report.requests = self.counts.requests.load(Ordering::Relaxed);
        report.slow = self.counts.slow.load(Ordering::Relaxed);
        report.malformed = self.counts.malformed.load(Ordering::Relaxed);
        report
    }
}

/// What a connection's requests are answered from.
struct Answering {
    site: Arc<Site>,
    entrance: Option<WebSocketAcceptor>,
    address: SocketAddr,
    counts: Arc<Counts>,
}

impl Answering {
    fn answer(&self, mut request: Request<Incoming>) -> Result<Answer, http::Error> {
        self.counts.requests.fetch_add(1, Ordering::Relaxed);
        match &self.entrance {
            Some(entrance) if request.uri().path() == upgrade::PATH => {
                upgrade::upgrade(&mut request, entrance, self.address)
            }
            _ => answer(&self.site, request.method(), request.uri().path(), request.headers()),
        }
    }
}

/// One connection from its first request to its last, which gives `place` back.
async fn serve(
    stream: TcpStream,
    answering: Answering,
    limits: HttpLimits,
    mut closes: watch::Receiver<bool>,
    place: impl Send,
) {
    // What is written is whole answers; nothing is gained by waiting for more.
    let _ = stream.set_nodelay(true);
    let service = service_fn(|request| std::future::ready(answering.answer(request)));
    let mut builder = http1::Builder::new();
    builder.timer(TokioTimer::new()).header_read_timeout(limits.head_wait).max_buf_size(limits.head_bytes);
    let io = TokioIo::new(Progress::new(stream, limits.progress));
    let mut connection = std::pin::pin!(builder.serve_connection(io, service).with_upgrades());
    let served = tokio::select! {
        served = &mut connection => served,
        _ = closes.changed() => {
            connection.as_mut().graceful_shutdown();
            connection.await
        }
    };
    // Before the connection is dropped: a client that sees it closed finds room for another.
    drop(place);
    let Err(error) = served else { return };
    if error.is_timeout() || is_stall(&error) {
        answering.counts.slow.fetch_add(1, Ordering::Relaxed);
    } else if error.is_parse() {
        answering.counts.malformed.fetch_add(1, Ordering::Relaxed);
    }
}

/// Whether the connection ended for want of progress.
fn is_stall(error: &hyper::Error) -> bool {
    let source = std::error::Error::source(error).and_then(|source| source.downcast_ref::<io::Error>());
    source.is_some_and(|error| error.kind() == io::ErrorKind::TimedOut)
}
