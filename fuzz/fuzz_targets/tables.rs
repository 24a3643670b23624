//! `cargo +nightly fuzz run tables`: see `fuzz::tables`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::tables(data));

#[cfg(not(fuzzing))]
fn main() {}
