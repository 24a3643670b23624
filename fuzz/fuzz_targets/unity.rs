//! `cargo +nightly fuzz run unity`: see `fuzz::unity`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::unity(data));

#[cfg(not(fuzzing))]
fn main() {}
