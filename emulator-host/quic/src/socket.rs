//! Serves and plays streams over UDP sockets: QUIC by `quinn`, the sender and receiver of `emulator-host`.
//!
//! `SESSION.md` beside this crate's `Cargo.toml` defines every byte.

mod identity;
mod impair;
mod locator;
pub mod message;

pub use identity::{Identity, IdentityError, Pin, PinError, Trust};
pub use impair::Impairment;
pub use locator::{DEFAULT_PORT, Locator, LocatorError};
