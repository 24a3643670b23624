//! emulator-host
