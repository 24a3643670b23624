//! Settings of a client, and errors of its playback.

use std::time::Duration;

use dgs_player::Caps;
use emulator_host::{
    Nanos,
    session::{Startup, StartupRule},
};

use super::{
    channel::Closed,
    identity::{IdentityError, Pin, Trust},
    locator::Locator,
    message::{Conditions, Refusal},
    printable::printable,
};

/// What to play, and how.
#[derive(Clone, Debug)]
pub struct ClientConfig {
    /// Where.
    pub locator: Locator,
    /// By what the server is known.
    pub trust: Trust,
    /// Time in the clip to start at, microseconds.
    pub start_us: u64,
    /// Whether the clip begins again when it is over.
    pub loops: bool,
    /// End after so long.
    pub duration: Option<Duration>,
    /// Streams larger than this are refused.
    pub caps: Caps,
    /// When playout starts.
    pub startup: Startup,
    /// For how long the server may say nothing: not answer, not send a manifest, be gone.
    pub silence: Duration,
    /// Whether media is to come in streams from the beginning, for networks that drop datagrams. Otherwise it
    /// does once none have come.
    pub streams: bool,
    /// What the server is to change in this session: its scheduler, an emulated link. What it grants of that,
    /// the report says; media that comes before it has answered is not used.
    pub conditions: Option<Conditions>,
    /// Times that a lost connection is made again without a frame shown in between; playout goes on from
    /// where it is then.
    pub reconnects: u32,
}

impl ClientConfig {
    /// Plays all of `locator` once.
    pub fn new(locator: Locator, trust: Trust) -> Self {
        Self {
            locator,
            trust,
            start_us: 0,
            loops: false,
            duration: None,
            caps: Caps::HOST,
            startup: Startup { rule: StartupRule::BaseGroups(0.95), max_wait: Nanos::from_s(5) },
            silence: Duration::from_secs(10),
            streams: false,
            conditions: None,
            reconnects: 3,
        }
    }
}

/// Why nothing was played, or not to the end.
#[derive(Debug, thiserror::Error)]
pub enum PlayError {
    /// The host has no address.
    #[error("{host}: no such host")]
    Host {
        /// Its name.
        host: String,
    },
    /// No socket can be opened.
    #[error("cannot open a socket: {0}")]
    Socket(std::io::Error),
    /// The authority's file cannot be used.
    #[error(transparent)]
    Identity(#[from] IdentityError),
    /// The server is not the one that the pin names.
    #[error("the server's certificate is {found}; the pin is {wanted}")]
    WrongPin {
        /// SHA-256 of its certificate.
        found: Pin,
        /// The pin.
        wanted: Pin,
    },
    /// The server's certificate is not of the authority, or the handshake failed otherwise.
    #[error("the handshake failed: {}", printable(.0))]
    Handshake(String),
    /// The server refuses.
    #[error("the server refuses: {0}")]
    Refused(Refusal),
    /// What the server says is not a session.
    #[error("the server says nonsense: {}", printable(.0))]
    Nonsense(String),
    /// The manifest is another than on the connection before.
    #[error("the stream has changed: play again to see what is served by this name now")]
    Changed,
    /// The manifest is refused.
    #[error("the manifest is refused: {0}")]
    Manifest(codec_core::Error),
    /// The server has said nothing for too long.
    #[error("the server said nothing for {ms} ms")]
    Silence {
        /// How long.
        ms: u128,
    },
    /// The time to play is over, and no manifest has come.
    #[error("no manifest came within {ms} ms, the time to play")]
    TimeUp {
        /// How long.
        ms: u128,
    },
    /// Nothing more has come of a stream that grows.
    #[error("nothing more of the stream came for {ms} ms")]
    Stalled {
        /// How long.
        ms: u128,
    },
    /// A relay does not take the session, or ends it.
    #[error("the relay: {}", printable(.0))]
    Relay(String),
    /// Nobody publishes the stream at the relay.
    #[error("nobody publishes {name} there; waited for {ms} ms")]
    Unpublished {
        /// The stream.
        name: String,
        /// How long.
        ms: u128,
    },
    /// Who published the stream is gone.
    #[error("the broadcast has ended: {}", printable(.0))]
    Ended(String),
    /// The connection is gone.
    #[error("the connection is gone: {0}")]
    Lost(Closed),
}
