//! Runs a session over real QUIC in virtual time: `quinn-proto` at both ends, the emulator's links between.
//!
//! The sender and the receiver of media are those of the model ([`emulator_host::session`]); under them lies
//! a real transport with real TLS, so a run shows where the model of it is wrong. The manifest travels on a
//! reliable stream, media in datagrams that are chosen one at a time when the last has left, receipts in
//! datagrams back; [`control_times`] sends control messages beside them. No socket and no clock takes part.
//!
//! The connection is set up over the bare delays of the path before the session's time begins, so that a
//! link's trace starts at the same moment as in the model; [`handshake`] measures that part over the whole
//! path. What the transport does not tell stays zero in the report: spurious losses and probe timeouts.
//!
//! One seed gives one run: connection ids and packet numbers come from the seed. Keys differ from run to run,
//! sizes and times do not.

mod end;
mod messages;
mod receiving;
mod run;
mod sending;
mod tls;
mod wire;

use emulator_host::{Nanos, SessionError};

pub use run::{control_times, handshake, run, simulate, simulate_with};

/// Why a run cannot be made.
#[derive(Debug, thiserror::Error)]
pub enum VirtualError {
    /// The configuration is illegal for every transport.
    #[error(transparent)]
    Session(#[from] SessionError),
    /// The configuration asks for what this transport does not do.
    #[error("{field} is {found}; over quinn-proto it must be {allowed}")]
    Unsupported {
        /// Which part of the configuration.
        field: &'static str,
        /// What it is.
        found: String,
        /// What it may be.
        allowed: &'static str,
    },
    /// Keys, certificates or the configuration made of them were refused.
    #[error("setting up TLS: {0}")]
    Tls(String),
    /// The transport refused to connect.
    #[error("connecting: {0}")]
    Connect(String),
    /// The two ends did not come to terms in time.
    #[error("no connection within {within}")]
    Handshake {
        /// Virtual time spent.
        within: Nanos,
    },
}
