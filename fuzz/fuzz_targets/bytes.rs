//! `cargo +nightly fuzz run bytes`: see `fuzz::bytes`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::bytes(data));

#[cfg(not(fuzzing))]
fn main() {}
