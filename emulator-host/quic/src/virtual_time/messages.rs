//! Sends control messages while media flows, one on a stream of its own each, and times them.

use emulator_host::Nanos;
use quinn_proto::{Connection, Dir, StreamId};

/// Bytes of a message.
const BYTES: usize = 200;
/// When the first is written: the manifest, whose stream is the first, is then there or on its way.
const BEGIN: Nanos = Nanos::from_s(2);
/// Until the next try where the peer allows no further stream.
const RETRY: Nanos = Nanos::from_ms(1);

/// Writes the messages.
pub(super) struct MessageWriter {
    interval: Nanos,
    next_at: Nanos,
    /// When each was written.
    written: Vec<Nanos>,
}

impl MessageWriter {
    /// Writes none.
    pub(super) fn none() -> Self {
        Self { interval: Nanos::MAX, next_at: Nanos::MAX, written: Vec::new() }
    }

    /// Writes one every `interval`, which is positive.
    pub(super) fn every(interval: Nanos) -> Self {
        Self { interval, next_at: BEGIN, written: Vec::new() }
    }

    /// When [`Self::write`] has something to do.
    pub(super) fn next_at(&self) -> Nanos {
        self.next_at
    }

    /// Hands the transport what is due at `now`.
    pub(super) fn write(&mut self, connection: &mut Connection, now: Nanos) {
        while self.next_at <= now {
            let Some(stream) = connection.streams().open(Dir::Uni) else {
                self.next_at = now + RETRY;
                return;
            };
            let mut stream = connection.send_stream(stream);
            // A stream that the peer has stopped, or that has no room, loses its message: it never arrives.
            let _ = stream.write(&[0; BYTES]);
            let _ = stream.finish();
            self.written.push(now);
            self.next_at += self.interval;
        }
    }
}

/// Reads the messages.
#[derive(Default)]
pub(super) struct MessageReader {
    /// Streams that have begun.
    open: Vec<StreamId>,
    /// Which messages were read to their end, counted from zero, and when.
    arrived: Vec<(u64, Nanos)>,
}

impl MessageReader {
    /// Reads what has arrived by `now` on streams after the manifest's, which has been accepted.
    pub(super) fn read(&mut self, connection: &mut Connection, now: Nanos) {
        while let Some(stream) = connection.streams().accept(Dir::Uni) {
            self.open.push(stream);
        }
        let arrived = &mut self.arrived;
        self.open.retain(|id| {
            let mut stream = connection.recv_stream(*id);
            let Ok(mut chunks) = stream.read(true) else { return false };
            let is_whole = loop {
                match chunks.next(usize::MAX) {
                    Ok(Some(_)) => {}
                    Ok(None) => break true,
                    Err(_) => break false,
                }
            };
            // Whether more may be sent is the transport's affair: the next transmission says so.
            let _ = chunks.finalize();
            if is_whole {
                arrived.push((id.index().saturating_sub(1), now));
            }
            !is_whole
        });
    }

    /// How long each message that `writer` wrote took until it was read, in the order of arrival.
    pub(super) fn times(&self, writer: &MessageWriter) -> Vec<Nanos> {
        let taken = self.arrived.iter().filter_map(|(number, at)| {
            let written = writer.written.get(usize::try_from(*number).ok()?)?;
            Some(*at - *written)
        });
        taken.collect()
    }
}
