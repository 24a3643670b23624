//! Media streams carry packets where no datagrams pass: each in a unidirectional stream of its own.
//!
//! QUIC repeats what is lost of a stream, and streams do not wait for each other. What is on its way is
//! bounded by congestion control, so that nothing is queued ahead of the scheduler, and what has not arrived
//! within [`LATE`] is given up.

use std::{
    sync::{
        Arc,
        atomic::{AtomicU64, Ordering},
    },
    time::Duration,
};

use bytes::Bytes;
use quinn::{Connection, ConnectionError, RecvStream, SendStream, VarInt, WriteError};
use tokio::{
    sync::{Mutex, Notify, mpsc},
    task::{JoinHandle, JoinSet},
    time::timeout,
};

use super::served_stream::MAX_MEDIA_BYTES;

/// Streams of media that may be open towards a client.
pub(super) const MEDIA_STREAMS: u32 = 128;
/// A packet that has not arrived after this long is given up: it could not be shown any more, or is repeated
/// by the scheduler.
const LATE: Duration = Duration::from_secs(1);
/// Packets that wait to be read.
const WAITING: usize = 1024;

/// Packets on their way to a viewer.
#[derive(Debug)]
pub(super) struct OutgoingMedia {
    connection: Connection,
    /// What stands before the packet in each stream.
    head: Bytes,
    waiting: Arc<Waiting>,
}

/// Bytes that have not arrived.
#[derive(Debug, Default)]
struct Waiting {
    bytes: AtomicU64,
    fewer: Notify,
}

impl OutgoingMedia {
    pub(super) fn new(connection: &Connection, head: Bytes) -> Self {
        Self { connection: connection.clone(), head, waiting: Arc::default() }
    }

    pub(super) fn head(&self) -> Bytes {
        self.head.clone()
    }

    /// Becomes ready once the packet is on its way.
    pub(super) async fn send(&self, packet: &[u8]) -> Result<(), ConnectionError> {
        let bytes = (self.head.len() + packet.len()) as u64;
        self.room(bytes).await;
        let mut stream = self.connection.open_uni().await?;
        // The control stream goes first.
        let _ = stream.set_priority(-1);
        let writing = async {
            stream.write_all(&self.head).await?;
            stream.write_all(packet).await
        };
        match timeout(LATE, writing).await {
            Ok(Ok(())) => {}
            Ok(Err(WriteError::ConnectionLost(error))) => return Err(error),
            // The client does not want this one.
            Ok(Err(_)) => return Ok(()),
            // It has no room for it.
            Err(_) => {
                let _ = stream.reset(VarInt::from_u32(0));
                return Ok(());
            }
        }
        if stream.finish().is_ok() {
            self.waiting.bytes.fetch_add(bytes, Ordering::Relaxed);
            tokio::spawn(arrival(stream, bytes, self.waiting.clone()));
        }
        Ok(())
    }

    /// Waits until `bytes` more may be on their way: as many as congestion control lets out, and one packet
    /// always.
    async fn room(&self, bytes: u64) {
        loop {
            let fewer = self.waiting.fewer.notified();
            let waiting = self.waiting.bytes.load(Ordering::Relaxed);
            if waiting == 0 || waiting + bytes <= self.connection.stats().path.cwnd {
                return;
            }
            fewer.await;
        }
    }
}

/// Ends when the packet has arrived, is not wanted, or is given up.
async fn arrival(mut stream: SendStream, bytes: u64, waiting: Arc<Waiting>) {
    if timeout(LATE, stream.stopped()).await.is_err() {
        // One that has arrived meanwhile cannot be reset.
        let _ = stream.reset(VarInt::from_u32(0));
    }
    waiting.bytes.fetch_sub(bytes, Ordering::Relaxed);
    waiting.fewer.notify_one();
}

/// Packets that come from a server. It ends when this is dropped.
#[derive(Debug)]
pub(super) struct IncomingMedia {
    packets: Mutex<mpsc::Receiver<Bytes>>,
    task: JoinHandle<()>,
}

impl IncomingMedia {
    /// Those on `connection`, whose streams begin with `head`.
    pub(super) fn of(connection: &Connection, head: Bytes) -> Self {
        let (found, packets) = mpsc::channel(WAITING);
        let task = tokio::spawn(accept(connection.clone(), head, found));
        Self { packets: Mutex::new(packets), task }
    }

    /// The next packet; never one after the end of the connection, which is said elsewhere.
    pub(super) async fn next(&self) -> Bytes {
        match self.packets.lock().await.recv().await {
            Some(packet) => packet,
            None => std::future::pending().await,
        }
    }
}

impl Drop for IncomingMedia {
    fn drop(&mut self) {
        self.task.abort();
    }
}

/// Reads every stream that the server opens: as many at once as the transport allows.
async fn accept(connection: Connection, head: Bytes, found: mpsc::Sender<Bytes>) {
    let mut streams = JoinSet::new();
    while let Ok(stream) = connection.accept_uni().await {
        streams.spawn(packet(stream, head.clone(), found.clone()));
        while streams.try_join_next().is_some() {}
    }
}

/// Reads one packet; a stream that holds more, or belongs to no session here, is dropped, which stops it.
async fn packet(mut stream: RecvStream, head: Bytes, found: mpsc::Sender<Bytes>) {
    let Ok(bytes) = stream.read_to_end(head.len() + MAX_MEDIA_BYTES).await else { return };
    if bytes.starts_with(&head) {
        let _ = found.send(Bytes::from(bytes).slice(head.len()..)).await;
    }
}
