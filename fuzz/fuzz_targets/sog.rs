//! `cargo +nightly fuzz run sog`: see `fuzz::sog`.
#![cfg_attr(fuzzing, no_main)]

#[cfg(fuzzing)]
libfuzzer_sys::fuzz_target!(|data: &[u8]| fuzz::sog(data));

#[cfg(not(fuzzing))]
fn main() {}
