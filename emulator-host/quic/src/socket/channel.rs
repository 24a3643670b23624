//! Carries a session, its control stream and its datagrams, over QUIC itself or over WebTransport on it.

use std::{
    borrow::Cow,
    sync::atomic::{AtomicBool, Ordering},
    time::{Duration, Instant},
};

use bytes::Bytes;
use emulator_host::Rate;
use quinn::{
    Connection, ConnectionError, RecvStream, SendDatagram, SendDatagramError, SendStream, VarInt,
    crypto::rustls::HandshakeData,
};
use tokio::time::timeout;
use url::Url;
use web_transport_proto::{error_from_http3, error_to_http3};

use super::{
    limits::SEND_BUFFER_BYTES,
    media_streams::{IncomingMedia, OutgoingMedia},
    message::{Refusal, RefusalCode},
    printable::printable,
    web::{self, Closing, WebClose, WebError, WebSession},
};
use crate::congestion::{PathWatch, Watched};

/// How long a peer may take to hear why a WebTransport session is closed.
const CLOSE_TIMEOUT: Duration = Duration::from_millis(500);

/// Why a connection or the session on it is over.
#[derive(Clone, Debug, thiserror::Error)]
pub enum Closed {
    /// The connection is gone.
    #[error("{}", printable(.0))]
    Connection(ConnectionError),
    /// The peer has closed the WebTransport session.
    #[error("the session was closed with code {code}: {reason:?}")]
    Session {
        /// Its code.
        code: u32,
        /// Its reason.
        reason: String,
    },
    /// What the peer speaks is not WebTransport.
    #[error("no WebTransport: {}", printable(.0))]
    Web(WebError),
    /// The WebSocket has ended.
    #[error("the WebSocket has ended")]
    Socket,
}

/// What is known of the path to a peer.
#[derive(Clone, Copy, Debug)]
pub(super) struct Path {
    /// Round trip: its smoothed mean, the least of late, and the newest if it is known.
    pub(super) rtt: Duration,
    pub(super) least_rtt: Duration,
    /// How long ago the least was measured.
    pub(super) least_rtt_age: Duration,
    pub(super) newest_rtt: Option<Duration>,
    /// Mean deviation of the round trip, if it is known.
    pub(super) rtt_variation: Option<Duration>,
    /// Estimated rate, if something is known of it.
    pub(super) rate: Option<Rate>,
    /// Bytes of all kinds on their way, and of media that wait in the transport, if that is known.
    pub(super) in_flight: Option<u64>,
    /// Most bytes on their way, as far as congestion control says.
    pub(super) window_bytes: u64,
    /// Bytes of the largest datagram.
    pub(super) datagram_bytes: u64,
}

// Neither names its cause as a source: whoever prints causes would print what the peer says as it is.
impl From<ConnectionError> for Closed {
    fn from(error: ConnectionError) -> Self {
        Self::Connection(error)
    }
}

impl From<WebError> for Closed {
    fn from(error: WebError) -> Self {
        match error {
            WebError::Gone(error) => Self::Connection(error),
            error => Self::Web(error),
        }
    }
}

impl Closed {
    /// The code that the peer has closed with.
    pub(super) fn code(&self) -> Option<u64> {
        self.said().map(|(code, _)| code)
    }

    /// The refusal that the peer has closed with.
    pub(super) fn refusal(&self) -> Option<Refusal> {
        let (code, reason) = self.said()?;
        RefusalCode::of(code).map(|code| Refusal { code, sentence: reason.into_owned() })
    }

    /// Code and reason that the peer has closed with.
    fn said(&self) -> Option<(u64, Cow<'_, str>)> {
        match self {
            Self::Connection(ConnectionError::ApplicationClosed(close)) => {
                let code = close.error_code.into_inner();
                let code = error_from_http3(code).map_or(code, u64::from);
                Some((code, String::from_utf8_lossy(&close.reason)))
            }
            Self::Session { code, reason } => Some((u64::from(*code), reason.into())),
            Self::Connection(_) | Self::Web(_) | Self::Socket => None,
        }
    }
}

/// A connection on which a session runs.
#[derive(Debug)]
pub(super) struct Channel {
    connection: Connection,
    /// What stands before each datagram: nothing, or the number of the WebTransport session.
    head: Bytes,
    /// Whether media leaves in streams although datagrams could be sent.
    in_streams: AtomicBool,
    outgoing: OutgoingMedia,
    /// Media that a server sends in streams.
    incoming: Option<IncomingMedia>,
}

/// How a session comes to its end, from either side.
pub(super) struct QuicCloser {
    connection: Connection,
    web: Option<Box<WebCloser>>,
}

/// The session to close, and what becomes of it when the peer does.
struct WebCloser {
    session: WebSession,
    /// Nothing once the peer has.
    closing: Option<Closing>,
}

/// A channel, its end, and its control stream.
pub(super) type Opened = (Channel, QuicCloser, (SendStream, RecvStream));

impl Channel {
    /// Waits for the control stream of a client, by the protocol that it has chosen in the handshake.
    pub(super) async fn accept(connection: &Connection) -> Result<Opened, Closed> {
        if !is_web(connection) {
            let control = connection.accept_bi().await?;
            return Ok(Self::new(connection, None, control));
        }
        let (session, closing) = WebSession::accept(connection).await?;
        let control = session.accept_stream(connection).await?;
        Ok(Self::new(connection, Some((session, closing)), control))
    }

    /// Opens the control stream to a server; over WebTransport at `url` if there is one.
    pub(super) async fn open(connection: &Connection, url: Option<Url>) -> Result<Opened, Closed> {
        let (mut channel, ending, control) = match url {
            None => Self::new(connection, None, connection.open_bi().await?),
            Some(url) => {
                let (session, closing) = WebSession::open(connection, url).await?;
                let control = session.open_stream(connection).await?;
                Self::new(connection, Some((session, closing)), control)
            }
        };
        channel.incoming = Some(IncomingMedia::of(connection, channel.outgoing.head()));
        Ok((channel, ending, control))
    }

    fn new(
        connection: &Connection,
        web: Option<(WebSession, Closing)>,
        control: (SendStream, RecvStream),
    ) -> Opened {
        let head = web.as_ref().map_or_else(Bytes::new, |(session, _)| session.datagram_head());
        let stream_head = web.as_ref().map_or_else(Bytes::new, |(session, _)| session.media_head());
        let channel = Self {
            connection: connection.clone(),
            head,
            in_streams: AtomicBool::new(false),
            outgoing: OutgoingMedia::new(connection, stream_head),
            incoming: None,
        };
        let web = web.map(|(session, closing)| Box::new(WebCloser { session, closing: Some(closing) }));
        (channel, QuicCloser { connection: connection.clone(), web }, control)
    }

    /// The connection below, for what it knows of the path.
    pub(super) fn connection(&self) -> &Connection {
        &self.connection
    }

    /// What QUIC knows of the path.
    pub(super) fn path(&self) -> Path {
        let path = self.connection.stats().path;
        let known = self.watch().map(|watch| watch.state());
        Path {
            rtt: path.rtt,
            least_rtt: known.and_then(|known| known.least_rtt).unwrap_or(path.min_rtt),
            least_rtt_age: known
                .and_then(|known| known.least_rtt_at)
                .map_or(Duration::ZERO, |at| at.elapsed()),
            newest_rtt: known.and_then(|known| known.newest_rtt),
            rtt_variation: known.and_then(|known| known.rtt_variation),
            rate: known.and_then(|known| known.rate),
            in_flight: known.map(|known| known.in_flight + self.waiting()),
            window_bytes: path.cwnd,
            datagram_bytes: u64::from(path.current_mtu),
        }
    }

    /// Bytes of datagrams that the transport of a server has and has not sent.
    pub(super) fn waiting(&self) -> u64 {
        SEND_BUFFER_BYTES.saturating_sub(self.connection.datagram_send_buffer_space()) as u64
    }

    /// The emulated link to the peer has changed: its least round trip is measured anew.
    pub(super) fn reset_least_rtt(&self) {
        if let Some(watch) = self.watch() {
            watch.reset_least_rtt(Instant::now());
        }
    }

    /// What a server knows of the path; a client watches none.
    pub(super) fn watch(&self) -> Option<PathWatch> {
        let controller =
            self.connection.congestion_state().into_any().downcast::<Watched<PathWatch>>().ok()?;
        Some(controller.observer)
    }

    /// Becomes ready once the transport has taken the datagram.
    pub(super) fn send_when_there_is_room(&self, bytes: Bytes) -> SendDatagram<'_> {
        self.connection.send_datagram_wait(self.framed(bytes))
    }

    /// Sends a datagram; an older one that waits is dropped for it.
    pub(super) fn send(&self, bytes: Bytes) -> Result<(), SendDatagramError> {
        self.connection.send_datagram(self.framed(bytes))
    }

    /// Media leaves in streams from here on.
    pub(super) fn send_in_streams(&self) {
        self.in_streams.store(true, Ordering::Relaxed);
    }

    /// Whether media leaves in streams: it was wished, or the peer takes no datagrams.
    pub(super) fn sends_in_streams(&self) -> bool {
        self.in_streams.load(Ordering::Relaxed) || self.connection.max_datagram_size().is_none()
    }

    /// Becomes ready once the transport has taken the datagram in a stream of its own.
    pub(super) async fn send_as_stream(&self, bytes: Bytes) -> Result<(), Closed> {
        Ok(self.outgoing.send(&bytes).await?)
    }

    /// The next datagram, or what came in its place in a stream; an empty one where something came that
    /// belongs to no session here.
    pub(super) async fn read(&self) -> Result<Bytes, ConnectionError> {
        let datagram = async {
            let datagram = self.connection.read_datagram().await?;
            Ok::<_, ConnectionError>(web::without_head(datagram, &self.head))
        };
        let Some(incoming) = &self.incoming else { return datagram.await };
        tokio::select! {
            datagram = datagram => datagram,
            media = incoming.next() => Ok(media),
        }
    }

    fn framed(&self, bytes: Bytes) -> Bytes {
        if self.head.is_empty() { bytes } else { web::with_head(&self.head, &bytes) }
    }
}

impl QuicCloser {
    /// Waits until the peer has closed, or the connection is gone. Dropping the future loses nothing.
    pub(super) async fn closed(&mut self) -> Closed {
        let Some(web) = &mut self.web else { return self.connection.closed().await.into() };
        tokio::select! {
            error = self.connection.closed() => error.into(),
            WebClose { code, reason } = peer_closes(&mut web.closing) => Closed::Session { code, reason },
        }
    }

    /// Closes with `code`, and says why.
    pub(super) async fn close(self, code: u32, reason: &str) {
        if let Some(WebCloser { mut session, closing }) = self.web.map(|web| *web) {
            // A browser that hears of it closes the connection. If that ended before, it would hide the code
            // from the page.
            let is_first = closing.is_some();
            let said = async {
                session.close(code, reason).await;
                if is_first {
                    self.connection.closed().await;
                }
            };
            let _ = timeout(CLOSE_TIMEOUT, said).await;
        }
        close(&self.connection, code, reason);
    }
}

/// How the peer closes; never ready if it has closed before.
async fn peer_closes(closing: &mut Option<Closing>) -> WebClose {
    let Some(waiting) = closing else { return std::future::pending().await };
    let closed = waiting.await;
    *closing = None;
    closed
}

/// Closes a connection on which there is no session yet, or no more.
pub(super) fn close(connection: &Connection, code: u32, reason: &str) {
    let number = if is_web(connection) { VarInt::from_u64(error_to_http3(code)) } else { Ok(code.into()) };
    connection.close(number.unwrap_or(VarInt::MAX), reason.as_bytes());
}

/// Whether the handshake has agreed on HTTP/3.
fn is_web(connection: &Connection) -> bool {
    let data = connection.handshake_data().and_then(|data| data.downcast::<HandshakeData>().ok());
    data.and_then(|data| data.protocol).is_some_and(|protocol| protocol == web::ALPN)
}
