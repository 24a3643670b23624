//! `cargo +nightly fuzz run receipt`: see `fuzz::receipt`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::receipt(data));

#[cfg(not(fuzzing))]
fn main() {}
