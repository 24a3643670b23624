//! Carries sessions of `emulator-host` over QUIC.

pub mod http;
pub mod socket;
pub mod virtual_time;
