//! Publishes at relays of Media over QUIC and plays from them, in builds that can.

#[cfg(not(feature = "moq"))]
mod absent;
#[cfg(feature = "moq")]
mod present;

#[cfg(feature = "moq")]
pub(super) use dgs_quic::moq::play;

#[cfg(not(feature = "moq"))]
pub(super) use absent::{check, play, publish};
#[cfg(feature = "moq")]
pub(super) use present::{check, publish};
