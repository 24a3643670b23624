//! `cargo +nightly fuzz run forged`: see `fuzz::forged`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::forged(data));

#[cfg(not(fuzzing))]
fn main() {}
