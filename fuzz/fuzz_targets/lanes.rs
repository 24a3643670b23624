//! `cargo +nightly fuzz run lanes`: see `fuzz::lanes`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::lanes(data));

#[cfg(not(fuzzing))]
fn main() {}
