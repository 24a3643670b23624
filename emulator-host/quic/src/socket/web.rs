//! Opens a WebTransport session on a QUIC connection: HTTP/3's settings, the CONNECT stream, its capsules.
//!
//! A browser speaks this instead of ALPN `dgs/0`. One session to a connection; what HTTP/3 has besides (other
//! requests, QPACK's streams, unidirectional streams of a client) is neither read nor answered.
//!
//! `web-transport-proto` writes and reads the frames; streams and datagrams stay those of `quinn`, so that a
//! session is the same over both; `web-transport-quinn` has stream types of its own.

use std::{future::Future, pin::Pin};

use bytes::{Buf as _, Bytes, BytesMut};
use quinn::{Connection, ConnectionError, RecvStream, SendStream};
use url::Url;
use web_transport_proto::{
    Capsule, CapsuleError, ConnectError, ConnectRequest, ConnectResponse, Frame, Http3CapsuleReader,
    Settings, SettingsError, StreamUni, VarInt,
};

/// Name of HTTP/3 in the handshake (ALPN).
pub(super) const ALPN: &[u8] = b"h3";
/// Most bytes of a reason in a capsule that closes a session.
const MAX_REASON_BYTES: usize = 1024;
/// Longest variable-length integer.
const MAX_INTEGER_BYTES: usize = 8;

/// Why there is no session.
#[derive(Clone, Debug, thiserror::Error)]
pub enum WebError {
    /// The connection is gone.
    #[error(transparent)]
    Gone(#[from] ConnectionError),
    /// HTTP/3's settings are none, or without WebTransport.
    #[error("HTTP/3 settings: {0}")]
    Settings(String),
    /// The request, or the answer to it, is none of WebTransport.
    #[error("CONNECT: {0}")]
    Connect(#[from] ConnectError),
    /// The first stream of the session does not say that it is one.
    #[error("a stream of the session begins with {0}")]
    Stream(String),
}

impl From<SettingsError> for WebError {
    fn from(error: SettingsError) -> Self {
        Self::Settings(error.to_string())
    }
}

/// How the peer has closed a session.
#[derive(Clone, Debug, PartialEq, Eq)]
pub(super) struct WebClose {
    pub(super) code: u32,
    pub(super) reason: String,
}

/// Resolves when the peer closes the session, to how it did.
pub(super) type Closing = Pin<Box<dyn Future<Output = WebClose> + Send>>;

/// A session.
pub(super) struct WebSession {
    /// Number of the CONNECT stream.
    id: VarInt,
    /// Our half of the CONNECT stream.
    connect: SendStream,
    /// Both settings streams: HTTP/3 forbids that they end.
    _settings: (SendStream, RecvStream),
}

impl WebSession {
    /// Waits for a client's request for a session and grants it. Its path is not looked at: hello says what
    /// is wanted.
    pub(super) async fn accept(connection: &Connection) -> Result<(Self, Closing), WebError> {
        let settings = settings(connection).await?;
        let (mut connect, mut requests) = connection.accept_bi().await?;
        ConnectRequest::read(&mut requests).await?;
        ConnectResponse::OK.write(&mut connect).await?;
        Ok(Self::new(connect, requests, settings))
    }

    /// Asks for a session at `url`.
    pub(super) async fn open(connection: &Connection, url: Url) -> Result<(Self, Closing), WebError> {
        let settings = settings(connection).await?;
        let (mut connect, mut answers) = connection.open_bi().await?;
        ConnectRequest::new(url).write(&mut connect).await?;
        ConnectResponse::read(&mut answers).await?;
        Ok(Self::new(connect, answers, settings))
    }

    fn new(connect: SendStream, capsules: RecvStream, settings: (SendStream, RecvStream)) -> (Self, Closing) {
        // A stream's number fits: it came as such an integer.
        let id = VarInt::from_u64(quinn::VarInt::from(connect.id()).into_inner()).unwrap_or(VarInt::MAX);
        (Self { id, connect, _settings: settings }, Box::pin(closing(capsules)))
    }

    /// What stands before the bytes of a bidirectional stream of the session.
    fn stream_head(&self) -> Vec<u8> {
        let mut head = Vec::new();
        Frame::WEBTRANSPORT.0.encode(&mut head);
        self.id.encode(&mut head);
        head
    }

    /// What stands before each datagram of the session: a quarter of its number (RFC 9297, section 2.1).
    pub(super) fn datagram_head(&self) -> Bytes {
        let mut head = BytesMut::new();
        VarInt::from_u64(self.id.into_inner() / 4).unwrap_or(VarInt::MAX).encode(&mut head);
        head.freeze()
    }

    /// What stands before the bytes of a unidirectional stream of the session.
    pub(super) fn media_head(&self) -> Bytes {
        let mut head = BytesMut::new();
        StreamUni::WEBTRANSPORT.encode(&mut head);
        self.id.encode(&mut head);
        head.freeze()
    }

    /// The first stream that the client opens in the session.
    pub(super) async fn accept_stream(
        &self,
        connection: &Connection,
    ) -> Result<(SendStream, RecvStream), WebError> {
        let (send, mut receive) = connection.accept_bi().await?;
        for (what, expected) in [("kind", Frame::WEBTRANSPORT.0), ("session", self.id)] {
            let found = integer(&mut receive).await.map_err(WebError::Stream)?;
            if found != expected {
                let (found, expected) = (found.into_inner(), expected.into_inner());
                return Err(WebError::Stream(format!("{what} {found:#x}, allowed {expected:#x}")));
            }
        }
        Ok((send, receive))
    }

    /// Opens a stream in the session.
    pub(super) async fn open_stream(
        &self,
        connection: &Connection,
    ) -> Result<(SendStream, RecvStream), WebError> {
        let (mut send, receive) = connection.open_bi().await?;
        let written = send.write_all(&self.stream_head()).await;
        written.map_err(|error| WebError::Stream(error.to_string()))?;
        Ok((send, receive))
    }

    /// Says `code` and `reason` to the peer and waits until that has arrived.
    pub(super) async fn close(&mut self, code: u32, reason: &str) {
        let mut reason = reason.to_owned();
        while reason.len() > MAX_REASON_BYTES {
            reason.pop();
        }
        let (mut capsule, mut frame) = (Vec::new(), Vec::new());
        Capsule::CloseWebTransportSession { code, reason }.encode(&mut capsule);
        Frame::DATA.0.encode(&mut frame);
        VarInt::from_u32(capsule.len() as u32).encode(&mut frame);
        frame.extend_from_slice(&capsule);
        if self.connect.write_all(&frame).await.is_ok() && self.connect.finish().is_ok() {
            let _ = self.connect.stopped().await;
        }
    }
}

/// Exchanges settings: each side says on a stream of its own that it speaks WebTransport.
async fn settings(connection: &Connection) -> Result<(SendStream, RecvStream), WebError> {
    let said = async {
        let mut settings = Settings::default();
        settings.enable_webtransport(1);
        let mut send = connection.open_uni().await?;
        settings.write(&mut send).await?;
        Ok::<_, WebError>(send)
    };
    let heard = async {
        let mut receive = connection.accept_uni().await?;
        if Settings::read(&mut receive).await?.supports_webtransport() == 0 {
            return Err(WebError::Settings("without WebTransport".to_owned()));
        }
        Ok(receive)
    };
    tokio::try_join!(said, heard)
}

/// Reads capsules until the session is closed; whatever else is read means nothing.
async fn closing(stream: RecvStream) -> WebClose {
    let mut capsules = Http3CapsuleReader::new(stream);
    loop {
        match capsules.read().await {
            Ok(Some(Capsule::CloseWebTransportSession { code, reason })) => return WebClose { code, reason },
            Ok(Some(_)) => {}
            // An end without a capsule is one of code 0.
            Ok(None) | Err(CapsuleError::Io(_)) => return WebClose { code: 0, reason: String::new() },
            Err(error) => {
                return WebClose { code: 0, reason: format!("the CONNECT stream has no capsules: {error}") };
            }
        }
    }
}

/// One variable-length integer (RFC 9000, section 16).
async fn integer(stream: &mut RecvStream) -> Result<VarInt, String> {
    let mut bytes = [0; MAX_INTEGER_BYTES];
    let (first, rest) = bytes.split_at_mut(1);
    stream.read_exact(first).await.map_err(|error| error.to_string())?;
    let len = 1usize << (first[0] >> 6);
    stream.read_exact(&mut rest[..len - 1]).await.map_err(|error| error.to_string())?;
    VarInt::decode(&mut &bytes[..len]).map_err(|error| error.to_string())
}

/// A datagram without its head; without anything if it is of no such session.
pub(super) fn without_head(mut datagram: Bytes, head: &[u8]) -> Bytes {
    if datagram.starts_with(head) {
        datagram.advance(head.len());
        datagram
    } else {
        Bytes::new()
    }
}

/// `bytes` after `head`.
pub(super) fn with_head(head: &[u8], bytes: &[u8]) -> Bytes {
    [head, bytes].concat().into()
}
