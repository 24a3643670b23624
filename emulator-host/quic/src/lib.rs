//! Carries sessions of `emulator-host` over QUIC.

pub mod socket;
