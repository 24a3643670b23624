//! Parses and writes the messages of the control stream (SESSION.md): bounded, typed, without a panic.
//!
//! A message is a kind, a length and a body. Its kind bounds its length, so that nothing is stored for a
//! length that is only claimed: memory follows the bytes that came.

mod conditions;
mod fields;
mod refusal;

use std::marker::PhantomData;

use codec_core::internals::limits::MAX_RECEIPT_BYTES;

use self::fields::Fields;
pub use self::{
    conditions::{Conditions, Granted, ViewerLink},
    fields::MessageError,
    refusal::{Refusal, RefusalCode},
};

/// Name of the protocol in the handshake (ALPN).
pub const ALPN: &[u8] = b"dgs/0";
/// Version of the session messages.
pub const VERSION: u8 = 0;
/// Longest name of a stream, bytes.
pub const MAX_NAME_BYTES: usize = 64;
/// Longest sentence of a refusal, bytes.
pub const MAX_SENTENCE_BYTES: usize = 1000;
/// Longest manifest message that a session carries, bytes.
pub const MAX_MANIFEST_BYTES: usize = 1 << 24;
/// Longest receipt with its round, bytes.
const MAX_ROUND_RECEIPT_BYTES: usize = 4 + MAX_RECEIPT_BYTES;
/// Kind and length.
const HEAD_BYTES: usize = 5;
/// Shortest DGSM message.
const MIN_MANIFEST_BYTES: usize = 21;

const HELLO: u8 = 0x01;
const SEEK: u8 = 0x02;
const BYE: u8 = 0x03;
const STREAMS: u8 = 0x04;
const RECEIPT: u8 = 0x05;
const CONDITIONS: u8 = 0x06;
const MANIFEST: u8 = 0x81;
const REFUSAL: u8 = 0x82;
const BEGIN: u8 = 0x83;
const GRANTED: u8 = 0x84;

/// Which stream a client wants.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum StreamChoice {
    /// By name; see [`is_name`].
    Name(String),
    /// By its place in the server's list, from 0.
    Index(u16),
}

/// What a client says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ClientMessage {
    /// The first message: what to play, and from where. It begins round 0.
    Hello {
        /// The stream.
        stream: StreamChoice,
        /// Time in the clip, microseconds.
        start_us: u64,
    },
    /// Begins another round of playout.
    Seek {
        /// Number of the round, above that of the round before.
        round: u32,
        /// Time in the clip, microseconds.
        start_us: u64,
    },
    /// The client has seen enough.
    Bye,
    /// Media comes in streams from here on: no datagrams pass.
    Streams,
    /// What a datagram of the client would hold: a round and a receipt.
    Receipt(Vec<u8>),
    /// Begins another round, under other conditions.
    Conditions {
        /// Number of the round, above that of the round before.
        round: u32,
        /// Time in the clip, microseconds.
        start_us: u64,
        /// They hold for this and all later rounds.
        conditions: Conditions,
    },
}

/// What a server says.
#[derive(Clone, Debug, PartialEq, Eq)]
pub enum ServerMessage {
    /// The DGSM message of the stream.
    Manifest(Vec<u8>),
    /// There is no session.
    Refusal(Refusal),
    /// The stream grows: a round begins at the newest window, whatever was asked for.
    Begin {
        /// The round.
        round: u32,
        /// A time of that window's first frame, microseconds.
        start_us: u64,
    },
    /// What of the conditions of a round holds.
    Granted {
        /// The round.
        round: u32,
        /// What holds.
        granted: Granted,
    },
}

/// Whether `text` can name a stream: 1 to [`MAX_NAME_BYTES`] letters, digits, `.`, `_` and `-` of ASCII.
pub fn is_name(text: &str) -> bool {
    let legal = |byte: u8| byte.is_ascii_alphanumeric() || b"._-".contains(&byte);
    (1..=MAX_NAME_BYTES).contains(&text.len()) && text.bytes().all(legal)
}

/// Messages of one side.
pub trait Message: Sized {
    /// Kinds, for errors.
    const KINDS: &'static str;

    /// Name of a kind, and least and most bytes of its body.
    fn shape(kind: u8) -> Option<(&'static str, usize, usize)>;

    /// Reads a body whose length fits its kind.
    ///
    /// # Errors
    /// A field that is out of range.
    fn parse(kind: u8, body: &[u8]) -> Result<Self, MessageError>;

    /// Appends the message to `out`.
    fn write(&self, out: &mut Vec<u8>);

    /// The message as bytes.
    fn to_bytes(&self) -> Vec<u8> {
        let mut out = Vec::new();
        self.write(&mut out);
        out
    }
}

/// Takes the bytes of a control stream as they come and gives whole messages.
#[derive(Debug)]
pub struct MessageReader<M> {
    bytes: Vec<u8>,
    message: PhantomData<M>,
}

impl<M> Default for MessageReader<M> {
    fn default() -> Self {
        Self { bytes: Vec::new(), message: PhantomData }
    }
}

impl<M: Message> MessageReader<M> {
    /// Takes from the front of `input` what the current message still needs; the message once it is whole.
    /// After `None`, `input` is empty.
    ///
    /// # Errors
    /// Bytes that are no message; the stream makes no sense after them.
    pub fn take(&mut self, input: &mut &[u8]) -> Result<Option<M>, MessageError> {
        if !self.fill(HEAD_BYTES, input) {
            return Ok(None);
        }
        let mut head = Fields::new("message", &self.bytes);
        let (kind, found) = (head.byte()?, head.word()?);
        let (message, least, most) =
            M::shape(kind).ok_or(MessageError::Kind { found: kind, allowed: M::KINDS })?;
        let length = found as usize;
        if !(least..=most).contains(&length) {
            return Err(MessageError::Length { message, found, least, most });
        }
        if !self.fill(HEAD_BYTES + length, input) {
            return Ok(None);
        }
        let whole = std::mem::take(&mut self.bytes);
        M::parse(kind, whole.get(HEAD_BYTES..).unwrap_or(&[])).map(Some)
    }

    /// Whether part of a message has come.
    pub fn is_inside(&self) -> bool {
        !self.bytes.is_empty()
    }

    /// Moves bytes until there are `wanted`; whether there are.
    fn fill(&mut self, wanted: usize, input: &mut &[u8]) -> bool {
        let missing = wanted.saturating_sub(self.bytes.len()).min(input.len());
        let (taken, rest) = input.split_at(missing);
        self.bytes.extend_from_slice(taken);
        *input = rest;
        self.bytes.len() >= wanted
    }
}

/// Appends a message of `kind` whose body `write` appends.
fn framed(out: &mut Vec<u8>, kind: u8, write: impl FnOnce(&mut Vec<u8>)) {
    out.push(kind);
    let at = out.len();
    out.extend_from_slice(&[0; 4]);
    write(out);
    let length = (out.len() - at - 4) as u32;
    out[at..at + 4].copy_from_slice(&length.to_le_bytes());
}

impl Message for ClientMessage {
    const KINDS: &'static str =
        "0x01 hello, 0x02 seek, 0x03 bye, 0x04 streams, 0x05 receipt, 0x06 conditions";

    fn shape(kind: u8) -> Option<(&'static str, usize, usize)> {
        match kind {
            HELLO => Some(("hello", 12, 11 + MAX_NAME_BYTES)),
            SEEK => Some(("seek", 12, 12)),
            BYE => Some(("bye", 0, 0)),
            STREAMS => Some(("streams", 0, 0)),
            RECEIPT => Some(("receipt", 4, MAX_ROUND_RECEIPT_BYTES)),
            CONDITIONS => Some(("conditions", 12 + conditions::BYTES, 12 + conditions::BYTES)),
            _ => None,
        }
    }

    fn parse(kind: u8, body: &[u8]) -> Result<Self, MessageError> {
        match kind {
            HELLO => hello(Fields::new("hello", body)),
            SEEK => {
                let mut fields = Fields::new("seek", body);
                let (round, start_us) = (fields.word()?, fields.number(8)?);
                fields.end()?;
                Ok(Self::Seek { round, start_us })
            }
            BYE => {
                Fields::new("bye", body).end()?;
                Ok(Self::Bye)
            }
            STREAMS => {
                Fields::new("streams", body).end()?;
                Ok(Self::Streams)
            }
            RECEIPT => Ok(Self::Receipt(body.to_vec())),
            CONDITIONS => {
                let mut fields = Fields::new("conditions", body);
                let (round, start_us) = (fields.word()?, fields.number(8)?);
                let conditions = Conditions::parse(&mut fields)?;
                fields.end()?;
                Ok(Self::Conditions { round, start_us, conditions })
            }
            _ => Err(MessageError::Kind { found: kind, allowed: Self::KINDS }),
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::Hello { stream, start_us } => framed(out, HELLO, |out| {
                out.push(VERSION);
                out.extend_from_slice(&start_us.to_le_bytes());
                match stream {
                    StreamChoice::Name(name) => {
                        // A name longer than allowed is written as it is, and refused by who reads it.
                        out.extend_from_slice(&[0, name.len().min(255) as u8]);
                        out.extend_from_slice(name.as_bytes());
                    }
                    StreamChoice::Index(index) => {
                        out.push(1);
                        out.extend_from_slice(&index.to_le_bytes());
                    }
                }
            }),
            Self::Seek { round, start_us } => framed(out, SEEK, |out| {
                out.extend_from_slice(&round.to_le_bytes());
                out.extend_from_slice(&start_us.to_le_bytes());
            }),
            Self::Bye => framed(out, BYE, |_| ()),
            Self::Streams => framed(out, STREAMS, |_| ()),
            Self::Receipt(datagram) => framed(out, RECEIPT, |out| out.extend_from_slice(datagram)),
            Self::Conditions { round, start_us, conditions } => framed(out, CONDITIONS, |out| {
                out.extend_from_slice(&round.to_le_bytes());
                out.extend_from_slice(&start_us.to_le_bytes());
                conditions.write(out);
            }),
        }
    }
}

/// The body of a hello.
fn hello(mut fields: Fields<'_>) -> Result<ClientMessage, MessageError> {
    let illegal =
        |field, found: u64, allowed| MessageError::Field { message: "hello", field, found, allowed };
    let version = fields.byte()?;
    if version != VERSION {
        return Err(illegal("version", version.into(), "0"));
    }
    let start_us = fields.number(8)?;
    let stream = match fields.byte()? {
        0 => {
            let len = fields.byte()?;
            let name = fields.text(len.into(), "name")?;
            if !is_name(name) {
                let allowed = "1 to 64 letters, digits, '.', '_', '-'";
                return Err(illegal("name length, or one of its characters,", len.into(), allowed));
            }
            StreamChoice::Name(name.to_owned())
        }
        1 => StreamChoice::Index(fields.number(2)? as u16),
        other => return Err(illegal("choice", other.into(), "0 name, 1 index")),
    };
    fields.end()?;
    Ok(ClientMessage::Hello { stream, start_us })
}

impl MessageError {
    /// The refusal that answers such bytes.
    pub fn refusal(&self) -> Refusal {
        let code = match self {
            Self::Field { field: "version", .. } => RefusalCode::Version,
            _ => RefusalCode::Message,
        };
        Refusal { code, sentence: self.to_string() }
    }
}

impl Message for ServerMessage {
    const KINDS: &'static str = "0x81 manifest, 0x82 refusal, 0x83 begin, 0x84 granted";

    fn shape(kind: u8) -> Option<(&'static str, usize, usize)> {
        match kind {
            MANIFEST => Some(("manifest", MIN_MANIFEST_BYTES, MAX_MANIFEST_BYTES)),
            REFUSAL => Some(("refusal", 2, 1 + MAX_SENTENCE_BYTES)),
            BEGIN => Some(("begin", 12, 12)),
            GRANTED => Some(("granted", 5, 5)),
            _ => None,
        }
    }

    fn parse(kind: u8, body: &[u8]) -> Result<Self, MessageError> {
        match kind {
            MANIFEST => Ok(Self::Manifest(body.to_vec())),
            REFUSAL => {
                let mut fields = Fields::new("refusal", body);
                let number = fields.byte()?;
                let code = RefusalCode::of(number.into()).ok_or(MessageError::Field {
                    message: "refusal",
                    field: "code",
                    found: number.into(),
                    allowed: "1 to 7",
                })?;
                let sentence = fields.text(body.len() - 1, "sentence")?.to_owned();
                Ok(Self::Refusal(Refusal { code, sentence }))
            }
            BEGIN => {
                let mut fields = Fields::new("begin", body);
                let (round, start_us) = (fields.word()?, fields.number(8)?);
                fields.end()?;
                Ok(Self::Begin { round, start_us })
            }
            GRANTED => {
                let mut fields = Fields::new("granted", body);
                let (round, granted) = (fields.word()?, Granted::parse(&mut fields)?);
                fields.end()?;
                Ok(Self::Granted { round, granted })
            }
            _ => Err(MessageError::Kind { found: kind, allowed: Self::KINDS }),
        }
    }

    fn write(&self, out: &mut Vec<u8>) {
        match self {
            Self::Manifest(message) => framed(out, MANIFEST, |out| out.extend_from_slice(message)),
            Self::Refusal(refusal) => framed(out, REFUSAL, |out| {
                out.push(refusal.code.number());
                let most = refusal.sentence.floor_char_boundary(MAX_SENTENCE_BYTES);
                out.extend_from_slice(&refusal.sentence.as_bytes()[..most]);
            }),
            Self::Begin { round, start_us } => framed(out, BEGIN, |out| {
                out.extend_from_slice(&round.to_le_bytes());
                out.extend_from_slice(&start_us.to_le_bytes());
            }),
            Self::Granted { round, granted } => framed(out, GRANTED, |out| {
                out.extend_from_slice(&round.to_le_bytes());
                out.push(granted.flags());
            }),
        }
    }
}

#[cfg(test)]
mod tests;
