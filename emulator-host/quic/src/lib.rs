//! Carries sessions of `emulator-host` over QUIC.

pub mod socket;
pub mod virtual_time;
