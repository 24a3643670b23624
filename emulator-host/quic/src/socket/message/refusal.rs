//! Refusals say why a server ends a session or lets none begin.

use super::super::printable::printable;

/// Why a server ends or refuses a session.
#[derive(Clone, Debug, PartialEq, Eq, thiserror::Error)]
#[error("{} ({code})", printable(.sentence))]
pub struct Refusal {
    /// For programs.
    pub code: RefusalCode,
    /// For people, as it was received: control characters are shown by another character.
    pub sentence: String,
}

/// Kinds of refusal. The same numbers are the application error codes with which a connection is closed.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum RefusalCode {
    /// The version of the session messages is not known here.
    Version,
    /// There is no such stream.
    UnknownStream,
    /// As many viewers as allowed are there.
    Full,
    /// A message that is none, or one out of turn.
    Message,
    /// Nothing came for too long.
    Silence,
    /// More came than allowed.
    Flood,
    /// The server is closing.
    Closing,
}

impl RefusalCode {
    const ALL: [(Self, u8, &'static str); 7] = [
        (Self::Version, 1, "version"),
        (Self::UnknownStream, 2, "unknown stream"),
        (Self::Full, 3, "full"),
        (Self::Message, 4, "message"),
        (Self::Silence, 5, "silence"),
        (Self::Flood, 6, "flood"),
        (Self::Closing, 7, "closing"),
    ];

    /// The number on the wire.
    pub fn number(self) -> u8 {
        Self::ALL.iter().find(|entry| entry.0 == self).map_or(0, |entry| entry.1)
    }

    /// The code of this number.
    pub fn of(number: u64) -> Option<Self> {
        Self::ALL.iter().find(|entry| u64::from(entry.1) == number).map(|entry| entry.0)
    }
}

impl std::fmt::Display for RefusalCode {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str(Self::ALL.iter().find(|entry| entry.0 == *self).map_or("", |entry| entry.2))
    }
}
