//! `cargo +nightly fuzz run control`: see `fuzz::control`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::control(data));

#[cfg(not(fuzzing))]
fn main() {}
