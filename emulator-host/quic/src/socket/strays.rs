//! Counts datagrams that reach a server's port and are no QUIC that it speaks: the endpoint drops them
//! without a word.

use std::{
    fmt, io,
    net::SocketAddr,
    pin::Pin,
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    task::{Context, Poll},
};

use quinn::{
    AsyncUdpSocket, UdpPoller,
    udp::{RecvMeta, Transmit},
};
use quinn_proto::{ConnectionId, ConnectionIdGenerator as _, HashedConnectionIdGenerator};

/// The version that is spoken (RFC 9000).
pub(super) const VERSION: u32 = 1;
/// Bytes of a connection id of the generator.
const ID_BYTES: usize = 8;
/// Shortest packet with a short header: first byte, connection id, four bytes of number and payload, tag.
const SHORTEST: usize = 1 + ID_BYTES + 4 + 16;
/// Bits of the first byte: the header is long; the packet is QUIC.
const LONG: u8 = 0x80;
const FIXED: u8 = 0x40;
/// Longest connection id.
const MAX_ID: u8 = 20;

/// A socket whose stray datagrams are counted.
pub(super) struct CountingSocket {
    inner: Arc<dyn AsyncUdpSocket>,
    strays: Arc<Strays>,
}

/// How many there were, and what tells the server's own connection ids from others.
pub(super) struct Strays {
    count: AtomicU64,
    ids: HashedConnectionIdGenerator,
}

impl Strays {
    /// None yet; `key` is that of the endpoint's connection ids.
    pub(super) fn new(key: u64) -> Self {
        Self { count: AtomicU64::new(0), ids: HashedConnectionIdGenerator::from_key(key) }
    }

    pub(super) fn count(&self) -> u64 {
        self.count.load(Ordering::Relaxed)
    }

    /// Whether `datagram` can be nothing of a connection, old or new.
    fn is_stray(&self, datagram: &[u8]) -> bool {
        match datagram {
            [first, ..] if first & FIXED == 0 => true,
            [first, a, b, c, d, id_bytes, ..] if first & LONG != 0 => {
                u32::from_be_bytes([*a, *b, *c, *d]) != VERSION || *id_bytes > MAX_ID
            }
            [first, rest @ ..] if first & LONG == 0 && datagram.len() >= SHORTEST => {
                self.ids.validate(&ConnectionId::new(&rest[..ID_BYTES])).is_err()
            }
            _ => true,
        }
    }
}

impl CountingSocket {
    pub(super) fn new(inner: Arc<dyn AsyncUdpSocket>, strays: Arc<Strays>) -> Self {
        Self { inner, strays }
    }
}

impl fmt::Debug for Strays {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Strays").field("count", &self.count).finish_non_exhaustive()
    }
}

impl fmt::Debug for CountingSocket {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("CountingSocket").field("inner", &self.inner).field("strays", &self.strays).finish()
    }
}

impl AsyncUdpSocket for CountingSocket {
    fn create_io_poller(self: Arc<Self>) -> Pin<Box<dyn UdpPoller>> {
        self.inner.clone().create_io_poller()
    }

    fn try_send(&self, transmit: &Transmit<'_>) -> io::Result<()> {
        self.inner.try_send(transmit)
    }

    fn poll_recv(
        &self,
        cx: &mut Context<'_>,
        bufs: &mut [io::IoSliceMut<'_>],
        meta: &mut [RecvMeta],
    ) -> Poll<io::Result<usize>> {
        let received = self.inner.poll_recv(cx, bufs, meta);
        if let Poll::Ready(Ok(messages)) = &received {
            let mut strays = 0;
            for (buf, meta) in bufs.iter().zip(meta.iter()).take(*messages) {
                let bytes = &buf[..meta.len.min(buf.len())];
                strays += bytes
                    .chunks(meta.stride.max(1))
                    .filter(|datagram| self.strays.is_stray(datagram))
                    .count();
            }
            if strays > 0 {
                self.strays.count.fetch_add(strays as u64, Ordering::Relaxed);
            }
        }
        received
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
