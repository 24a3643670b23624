//! `cargo +nightly fuzz run cauchy`: see `fuzz::cauchy`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::cauchy(data));

#[cfg(not(fuzzing))]
fn main() {}
