//! `cargo +nightly fuzz run ksplat`: see `fuzz::ksplat`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::ksplat(data));

#[cfg(not(fuzzing))]
fn main() {}
