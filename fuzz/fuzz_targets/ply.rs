//! `cargo +nightly fuzz run ply`: see `fuzz::ply`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::ply(data));

#[cfg(not(fuzzing))]
fn main() {}
