//! `cargo +nightly fuzz run trace`: see `fuzz::trace`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::trace(data));

#[cfg(not(fuzzing))]
fn main() {}
