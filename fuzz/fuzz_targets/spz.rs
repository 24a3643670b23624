//! `cargo +nightly fuzz run spz`: see `fuzz::spz`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::spz(data));

#[cfg(not(fuzzing))]
fn main() {}
