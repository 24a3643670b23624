//! Carries sessions of `emulator-host` over QUIC.

mod clock;
mod congestion;
pub mod http;
#[cfg(feature = "moq")]
pub mod moq;
pub mod socket;
pub mod virtual_time;

pub use congestion::CongestionControl;
