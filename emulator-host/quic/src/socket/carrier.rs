//! A carrier takes a session to a viewer and knows the path: QUIC, WebTransport on it, or a WebSocket.

use std::{net::SocketAddr, pin::Pin, time::Duration};

use bytes::Bytes;
use quinn::{SendDatagramError, SendStream};

use super::{
    channel::{self, Channel, Closed, Path, QuicCloser},
    control::{Control, Source},
    message::ClientMessage,
    web_socket::{self, Socket, SocketChannel, SocketCloser, SocketWriter},
};
use crate::congestion::PathWatch;

/// What a session runs on.
#[derive(Debug)]
pub(super) enum SessionTransport {
    Quic(Channel),
    Socket(SocketChannel),
}

/// Why a datagram has not left.
#[derive(Debug)]
pub(super) enum NotSent {
    /// There is nowhere to send it.
    Closed(Closed),
    /// Datagrams like this one never leave.
    Refused(SendDatagramError),
}

/// Resolves once a datagram was sent.
pub(super) type SendFuture<'c> = Pin<Box<dyn Future<Output = Result<(), NotSent>> + Send + 'c>>;

/// How a session comes to its end, from either side.
pub(super) enum SessionCloser {
    Quic(QuicCloser),
    Socket(SocketCloser),
}

/// The writing half of a control stream.
pub(super) enum ControlWriter {
    Quic(SendStream),
    Socket(SocketWriter),
}

/// A carrier, its end, and both halves of its control stream.
pub(super) type Opened = (SessionTransport, SessionCloser, ControlWriter, Control<ClientMessage>);

/// What QUIC carries.
pub(super) fn by_quic((channel, ending, (send, receive)): channel::Opened) -> Opened {
    let control = Control::new(receive);
    (SessionTransport::Quic(channel), SessionCloser::Quic(ending), ControlWriter::Quic(send), control)
}

/// What a WebSocket carries, as long as what comes beside it is polled.
pub(super) fn by_socket(socket: Socket, address: SocketAddr) -> (Opened, impl Future<Output = ()> + Send) {
    let (channel, ending, writer, control, carrying) = web_socket::open(socket, address);
    let control = Control::of(Source::Socket(control));
    let opened = (
        SessionTransport::Socket(channel),
        SessionCloser::Socket(ending),
        ControlWriter::Socket(writer),
        control,
    );
    (opened, carrying)
}

impl SessionTransport {
    /// Where the viewer is.
    pub(super) fn address(&self) -> SocketAddr {
        match self {
            Self::Quic(channel) => channel.connection().remote_address(),
            Self::Socket(channel) => channel.address(),
        }
    }

    /// Whether what it sends goes through links of the server's socket.
    pub(super) fn is_impaired_by_links(&self) -> bool {
        matches!(self, Self::Quic(_))
    }

    /// What is known of the path once `arrived` bytes of media are known to have arrived.
    pub(super) fn path(&self, arrived: u64) -> Path {
        match self {
            Self::Quic(channel) => channel.path(),
            Self::Socket(channel) => channel.path(arrived),
        }
    }

    /// What watches the path, where the transport tells of it.
    pub(super) fn watch(&self) -> Option<PathWatch> {
        match self {
            Self::Quic(channel) => channel.watch(),
            Self::Socket(_) => None,
        }
    }

    /// A datagram was handed to the transport.
    pub(super) fn on_media_taken(&self) {
        if let Self::Quic(channel) = self
            && let Some(watch) = channel.watch()
        {
            watch.set_waiting(channel.waiting());
        }
    }

    /// Ready once the transport has learnt something of the path. Dropping the future loses nothing.
    pub(super) async fn news(&self) {
        match self.watch() {
            Some(watch) => watch.news().await,
            None => std::future::pending().await,
        }
    }

    /// The emulated link to the viewer has changed.
    pub(super) fn reset_least_rtt(&self) {
        if let Self::Quic(channel) = self {
            channel.reset_least_rtt();
        }
    }

    /// Round trip, smoothed.
    pub(super) fn rtt(&self) -> Duration {
        match self {
            Self::Quic(channel) => channel.connection().rtt(),
            Self::Socket(channel) => channel.path(0).rtt,
        }
    }

    /// Bytes that have left, of all kinds.
    pub(super) fn sent_bytes(&self) -> u64 {
        match self {
            Self::Quic(channel) => channel.connection().stats().udp_tx.bytes,
            Self::Socket(channel) => channel.sent_bytes(),
        }
    }

    /// Sends media in streams from here on. A WebSocket has none, and repeats what is lost by itself.
    pub(super) fn send_in_streams(&self) {
        if let Self::Quic(channel) = self {
            channel.send_in_streams();
        }
    }

    /// Whether what is lost comes again without anybody's doing.
    pub(super) fn repeats_what_is_lost(&self) -> bool {
        match self {
            Self::Quic(channel) => channel.sends_in_streams(),
            Self::Socket(_) => true,
        }
    }

    /// Becomes ready once the transport has taken the datagram.
    pub(super) fn send_when_there_is_room(&self, bytes: Bytes) -> SendFuture<'_> {
        match self {
            Self::Quic(channel) if channel.sends_in_streams() => {
                Box::pin(async move { channel.send_as_stream(bytes).await.map_err(NotSent::Closed) })
            }
            Self::Quic(channel) => {
                let departure = channel.send_when_there_is_room(bytes);
                Box::pin(async move {
                    departure.await.map_err(|error| match error {
                        SendDatagramError::ConnectionLost(error) => NotSent::Closed(error.into()),
                        error => NotSent::Refused(error),
                    })
                })
            }
            Self::Socket(channel) => {
                Box::pin(async move { channel.send(bytes).await.map_err(NotSent::Closed) })
            }
        }
    }

    /// The next datagram; an empty one where something came that belongs to no session here.
    pub(super) async fn read(&self) -> Result<Bytes, Closed> {
        match self {
            Self::Quic(channel) => Ok(channel.read().await?),
            Self::Socket(channel) => channel.read().await,
        }
    }
}

impl SessionCloser {
    /// Waits until the peer has closed, or the connection is gone. Dropping the future loses nothing.
    pub(super) async fn closed(&mut self) -> Closed {
        match self {
            Self::Quic(ending) => ending.closed().await,
            // The end of the control stream says so, after all that was said before it.
            Self::Socket(_) => std::future::pending().await,
        }
    }

    /// Closes with `code`, and says why.
    pub(super) async fn close(self, code: u32, reason: &str) {
        match self {
            Self::Quic(ending) => ending.close(code, reason).await,
            Self::Socket(ending) => ending.close(code, reason).await,
        }
    }
}

impl ControlWriter {
    /// Writes as much of `bytes` as there is room for; nothing once nobody reads any more. Dropping the
    /// future loses nothing.
    pub(super) async fn write(&mut self, bytes: &[u8]) -> Option<usize> {
        match self {
            Self::Quic(send) => send.write(bytes).await.ok(),
            Self::Socket(writer) => writer.write(bytes).await,
        }
    }

    /// Writes the last message, and waits until it has arrived, or has left where no more is known.
    pub(super) async fn finish(mut self, message: &[u8]) {
        let mut rest = message;
        while !rest.is_empty() {
            let Some(written) = self.write(rest).await else { return };
            rest = &rest[written..];
        }
        if let Self::Quic(mut send) = self
            && send.finish().is_ok()
        {
            let _ = send.stopped().await;
        }
    }
}
