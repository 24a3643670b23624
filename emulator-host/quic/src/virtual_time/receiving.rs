//! Receives media over a connection, and sends receipts back in datagrams.

use bytes::Bytes;
use emulator_host::{Nanos, PacketGraph, PacketIndex, SessionConfig, session::Viewer};
use quinn_proto::{Dir, StreamId};

use super::{end::End, messages::MessageReader};

/// The viewer and its end of the connection.
pub(super) struct Receiving<'a> {
    pub(super) end: End,
    pub(super) viewer: Viewer<'a>,
    /// Control messages beside the manifest.
    pub(super) messages: MessageReader,
    graph: &'a PacketGraph,
    ack_every: u32,
    max_ack_delay: Nanos,
    stream: Option<StreamId>,
    manifest_bytes: usize,
    /// Media and pieces of the manifest that no receipt has followed.
    unreported: u32,
    receipt_at: Nanos,
}

impl<'a> Receiving<'a> {
    /// The session begins: `end` is connected.
    pub(super) fn new(end: End, viewer: Viewer<'a>, graph: &'a PacketGraph, config: &SessionConfig) -> Self {
        Self {
            end,
            viewer,
            messages: MessageReader::default(),
            graph,
            ack_every: config.ack_every,
            max_ack_delay: config.max_ack_delay,
            stream: None,
            manifest_bytes: 0,
            unreported: 0,
            receipt_at: Nanos::MAX,
        }
    }

    pub(super) fn next_time(&mut self) -> Nanos {
        self.end.next_time().min(self.receipt_at).min(self.viewer.playout().next_time())
    }

    /// Takes what has arrived.
    pub(super) fn take(&mut self, now: Nanos) {
        while let Some(packet) = self.next_media() {
            self.viewer.media(packet, now);
            self.arrived(now);
        }
        if let Some((bytes, complete)) = self.read_manifest() {
            self.viewer.control(bytes, complete);
            self.arrived(now);
        }
        if self.stream.is_some()
            && let Some(connection) = self.end.connection()
        {
            self.messages.read(connection, now);
        }
    }

    /// Starts playout if what it waits for is there; the sender is to know at once.
    pub(super) fn start_if_ready(&mut self, now: Nanos) {
        if self.viewer.start_if_ready(now) {
            self.receipt_at = now;
        }
    }

    /// The next UDP payload that leaves at `now`.
    pub(super) fn poll(&mut self, now: Nanos) -> Option<&[u8]> {
        if self.receipt_at <= now {
            self.receipt_at = Nanos::MAX;
            self.unreported = 0;
            let mut receipt = Vec::new();
            self.viewer.receipt(&mut receipt);
            if let Some(connection) = self.end.connection() {
                // An older receipt that still waits gives way: this one repeats its news.
                let _ = connection.datagrams().send(Bytes::from(receipt), true);
            }
        }
        self.end.transmit(now)?;
        Some(self.end.sent())
    }

    fn arrived(&mut self, now: Nanos) {
        self.unreported += 1;
        let due = self.unreported >= self.ack_every;
        self.receipt_at = if due { now } else { self.receipt_at.min(now + self.max_ack_delay) };
    }

    /// The next packet that has arrived; datagrams that name none are passed over.
    fn next_media(&mut self) -> Option<PacketIndex> {
        let connection = self.end.connection()?;
        while let Some(datagram) = connection.datagrams().recv() {
            let index = datagram.first_chunk().map(|first| PacketIndex(u32::from_be_bytes(*first)));
            if let Some(index) = index.filter(|index| index.at() < self.graph.packets().len()) {
                return Some(index);
            }
        }
        None
    }

    /// Distinct bytes of the manifest so far and whether that is all, if there are new ones.
    fn read_manifest(&mut self) -> Option<(usize, bool)> {
        let whole = self.graph.manifest_bytes() as usize;
        let connection = self.end.connection()?;
        while connection.poll().is_some() {}
        if self.stream.is_none() {
            self.stream = connection.streams().accept(Dir::Uni);
        }
        let stream = self.stream.filter(|_| self.manifest_bytes < whole)?;
        let mut stream = connection.recv_stream(stream);
        let mut chunks = stream.read(false).ok()?;
        let before = self.manifest_bytes;
        while let Ok(Some(chunk)) = chunks.next(usize::MAX) {
            self.manifest_bytes += chunk.bytes.len();
        }
        // Whether more may be sent is the transport's affair: the next transmission says so.
        let _ = chunks.finalize();
        (self.manifest_bytes > before).then_some((self.manifest_bytes, self.manifest_bytes >= whole))
    }
}
