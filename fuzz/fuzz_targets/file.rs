//! `cargo +nightly fuzz run file`: see `fuzz::file`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::file(data));

#[cfg(not(fuzzing))]
fn main() {}
