//! Reads messages from the control stream as its bytes come.

use bytes::{Buf, Bytes};
use quinn::{ReadError, RecvStream};
use tokio::sync::mpsc;

use super::message::{Message, MessageError, MessageReader};

/// Most bytes taken from the transport at once.
const CHUNK_BYTES: usize = 4096;

/// The reading half of a control stream.
#[derive(Debug)]
pub(super) struct Control<M> {
    source: Source,
    reader: MessageReader<M>,
    rest: Bytes,
}

/// Where the bytes come from.
#[derive(Debug)]
pub(super) enum Source {
    Quic(RecvStream),
    Socket(mpsc::Receiver<Bytes>),
}

/// Why there is no further message.
#[derive(Debug, thiserror::Error)]
pub(super) enum ControlError {
    /// The bytes are no message.
    #[error(transparent)]
    Message(#[from] MessageError),
    /// The stream ended inside a message.
    #[error("the control stream ends inside a message")]
    Cut,
    /// The connection is gone.
    #[error(transparent)]
    Lost(#[from] ReadError),
}

impl<M: Message> Control<M> {
    pub(super) fn new(stream: RecvStream) -> Self {
        Self::of(Source::Quic(stream))
    }

    pub(super) fn of(source: Source) -> Self {
        Self { source, reader: MessageReader::default(), rest: Bytes::new() }
    }

    /// The next message; `None` at the end of the stream. Dropping the future loses nothing.
    pub(super) async fn next(&mut self) -> Result<Option<M>, ControlError> {
        loop {
            let mut input = &self.rest[..];
            let message = self.reader.take(&mut input)?;
            let left = input.len();
            self.rest.advance(self.rest.len() - left);
            if message.is_some() {
                return Ok(message);
            }
            let chunk = match &mut self.source {
                Source::Quic(stream) => stream.read_chunk(CHUNK_BYTES, true).await?.map(|chunk| chunk.bytes),
                Source::Socket(frames) => frames.recv().await,
            };
            match chunk {
                Some(bytes) => self.rest = bytes,
                None if self.reader.is_inside() => return Err(ControlError::Cut),
                None => return Ok(None),
            }
        }
    }
}
