//! `cargo +nightly fuzz run splat`: see `fuzz::splat`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::splat(data));

#[cfg(not(fuzzing))]
fn main() {}
