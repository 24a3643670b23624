//! Serves and plays streams over UDP sockets: QUIC by `quinn`, the sender and receiver of `emulator-host`,
//! WebTransport for browsers on the same port, WebSockets for those whose network lets no UDP through.
//!
//! A server offers streams by name; a client opens one control stream, gets the manifest on it and media in
//! datagrams, and answers with receipts. `SESSION.md` beside this crate's `Cargo.toml` defines every byte.

mod carrier;
mod channel;
mod client;
mod control;
mod conversation;
mod greeting;
mod identity;
mod impair;
mod limits;
mod locator;
mod media_streams;
pub mod message;
mod per_address;
mod playback;
mod printable;
mod round;
mod scheme;
mod screen;
mod served_stream;
mod server;
mod settings;
mod strays;
#[cfg(test)]
mod tests;
mod viewer;
mod web;
mod web_socket;
mod web_socket_acceptor;

pub use channel::Closed;
pub use client::{Played, play};
#[cfg(feature = "moq")]
pub(crate) use client::{connect, play_over};
pub use identity::{Identity, IdentityError, Pin, PinError, Trust};
pub use impair::Impairment;
pub use limits::ServerLimits;
pub use locator::{DEFAULT_PORT, Locator, LocatorError};
pub use message::{Conditions, Granted, ViewerLink};
pub(crate) use per_address::PerAddress;
#[cfg(feature = "moq")]
pub(crate) use playback::Playback;
#[cfg(feature = "moq")]
pub(crate) use printable::printable;
pub use scheme::Scheme;
pub use screen::{FrameShown, FrameSink, NullSink, PlayReport, RoundRequest};
#[cfg(feature = "moq")]
pub(crate) use served_stream::{Content, middle_us, starts};
pub use served_stream::{LiveFeed, MAX_MEDIA_BYTES, ServedStream, ServedStreamError};
pub use server::{Server, ServerConfig, ServerError, ServerReport};
pub use settings::{ClientConfig, PlayError};
pub use viewer::ViewerReport;
pub use web::WebError;
pub(crate) use web_socket::config as socket_config;
pub use web_socket_acceptor::WebSocketAcceptor;
